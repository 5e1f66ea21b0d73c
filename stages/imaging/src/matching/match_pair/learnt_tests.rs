//! Noise of a learnt model in `match-pair`: strength by place, one error for both images, a face that changes, refusals.

use super::tests::{Scene, convergent, pairs, scene};
use super::*;
use rockface_core::artefact::{Artefact, Contrast, Frame, Grid, Member, Mesh, Noun, Pair, ReliefLaw};
use rockface_core::numerics::portable_math;
use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
use serde_json::{Value, json};

const SIDE: usize = 60;

/// A parametric model over 12 x 12 m of a plane: 0.1 px of an acquisition left of the middle, 0.3 px right of it, and 2 px
/// where a metre of relief is.
pub fn model() -> Noise {
    let grid = Grid { columns: SIDE, rows: SIDE, cell_m: 0.2, left_m: -6.0, top_m: 6.0 };
    let member = Member {
        name: "a".into(),
        bad: false,
        log_strength: vec![0.0; 2],
        trend_m: [0.0; 10],
        log_amplitude: vec![0.0; 4],
        field_log_amplitude: vec![0.0; 4],
        skewness: 0.0,
    };
    Noise {
        frame: Frame::Wall,
        grid,
        donors: 1,
        length_cells: 10.0,
        common_share: 0.3,
        bad_share: 0.0,
        class_log_strength: vec![-2.3, -1.2],
        jitter: 0.0,
        sharpness: 1,
        contrast: Contrast::none(),
        log_gain: vec![0.0; 4],
        relief: ReliefLaw { flat_px: 0.1, gain_px_m: 2.0, window_cells: 2 },
        asymmetry_gain: [0.0; 3],
        gap_gain: 1.0,
        gap_variety: 1.0,
        skewness_gain: 2.0,
        members: vec![member],
        orders: [vec![0], vec![0]],
        strength: (0..SIDE * SIDE).map(|i| if i % SIDE < SIDE / 2 { 0.1 } else { 0.3 }).collect(),
        elevation: vec![0.0; SIDE * SIDE],
        bend_shapes: Vec::new(),
        trend_weights: vec![1.0; SIDE * SIDE],
        parametric: None,
        fields: Vec::new(),
        weights: Vec::new(),
    }
}

fn plane() -> Mesh {
    height_mesh(60, [-12.0, 12.0, -12.0, 12.0], |_, _| 0.0)
}

/// A plane with a niche of 1.2 m by 1.2 m, 0.6 m deep, left of the middle.
fn niche() -> Mesh {
    height_mesh(
        120,
        [-12.0, 12.0, -12.0, 12.0],
        |x, y| if (-3.1..-1.9).contains(&x) && y.abs() < 0.6 { -0.6 } else { 0.0 },
    )
}

fn run(scene: &Scene, noise: Option<Noise>, with: &Value) -> Result<Depth, StageError> {
    let mut inputs = vec![
        ("first", Artefact::Depth(scene.depths[0].clone())),
        ("second", Artefact::Depth(scene.depths[1].clone())),
        ("noisy", Artefact::Cameras(scene.noisy.clone())),
        ("pairs", Artefact::Pairs(pairs())),
    ];
    inputs.extend(noise.map(|noise| ("noise", Artefact::Noise(noise))));
    let outputs = run_stage::<MatchPair>(&TestHost::default(), with, &inputs)?.into_inner();
    Ok(Depth::of(&outputs["depth"]).unwrap().clone())
}

/// Place on the face and error of disparity of every matched pixel.
fn errors(scene: &Scene, side: Side, noise: &Noise) -> Vec<([f64; 2], f64)> {
    let of = if side == Side::First { "first" } else { "second" };
    let map = run(scene, Some(noise.clone()), &json!({"noise": "learnt", "channels": true, "of": of})).unwrap();
    let ideal = &scene.depths[side];
    let camera = crate::camera::model::Camera::of_depth(ideal);
    let place = |i: usize| {
        let pixel = crate::camera::model::full_pixel(i % ideal.width, i / ideal.width, ideal.downscale);
        let point = camera.unproject(camera.normalised(pixel).unwrap(), f64::from(ideal.z[i]));
        ([point.x, point.y], f64::from(map.channels["noise.local"][i]))
    };
    (0..ideal.z.len()).filter(|i| map.z[*i].is_finite()).map(place).collect()
}

fn rms(errors: &[([f64; 2], f64)], inside: impl Fn([f64; 2]) -> bool) -> f64 {
    let squares: Vec<f64> = errors.iter().filter(|(place, _)| inside(*place)).map(|(_, e)| e * e).collect();
    assert!(squares.len() > 20, "{}", squares.len());
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn the_noise_has_the_strength_of_its_place_and_is_one_for_both_images() {
    let scene = scene(convergent(small_sensor()), &plane(), 1);
    let noise = model();
    let first = errors(&scene, Side::First, &noise);
    for (left, expected) in [(true, 0.1), (false, 0.3)] {
        let found = rms(&first, |[x, y]| (x < 0.0) == left && x.abs() < 6.0 && y.abs() < 6.0);
        // White noise loses some of its strength between the cells.
        assert!((0.8..1.1).contains(&(found / expected)), "{left}: {found}");
    }
    // Where points of both images are near the middle of a cell, they have much the same error; draws of their own would not be correlated.
    let cell = |[x, y]: [f64; 2]| ((x / 0.2).floor() as i32, (y / 0.2).floor() as i32);
    let of_first: std::collections::BTreeMap<_, f64> = first.iter().map(|(place, e)| (cell(*place), *e)).collect();
    let inside = |[x, y]: [f64; 2]| {
        (x.abs() % 0.2 - 0.1).abs() < 0.05 && (y.abs() % 0.2 - 0.1).abs() < 0.05 && x.abs() < 5.9 && y.abs() < 5.9
    };
    let both: Vec<(f64, f64)> = errors(&scene, Side::Second, &noise)
        .iter()
        .filter(|(place, _)| inside(*place))
        .filter_map(|(place, e)| of_first.get(&cell(*place)).map(|other| (*e, *other)))
        .collect();
    let sum = |of: fn(&(f64, f64)) -> f64| both.iter().map(of).sum::<f64>();
    let correlation = sum(|(a, b)| a * b) / (sum(|(a, _)| a * a) * sum(|(_, b)| b * b)).sqrt();
    assert!(both.len() > 50 && correlation > 0.5, "the correlation is {correlation} of {}", both.len());
}

#[test]
fn a_niche_gets_the_noise_of_its_new_relief_and_the_rest_stays() {
    let cameras = || convergent(small_sensor());
    let noise = model();
    let (before, after) = (
        errors(&scene(cameras(), &plane(), 1), Side::First, &noise),
        errors(&scene(cameras(), &niche(), 1), Side::First, &noise),
    );
    let near = |[x, y]: [f64; 2]| (-3.3..-1.7).contains(&x) && y.abs() < 0.8;
    let (was, is) = (rms(&before, near), rms(&after, near));
    assert!(is > 2.0 * was, "{was} {is}");
    let far = |[x, y]: [f64; 2]| x > 0.0 && x < 5.0 && y.abs() < 5.0;
    let (was, is) = (rms(&before, far), rms(&after, far));
    assert!((is - was).abs() < 1e-6, "{was} {is}");
}

#[test]
fn pairs_of_other_bases_see_one_error_of_elevation() {
    // The bases are 2, 3 and 6 m: a survey of all three is worth 3 m, so that the model's pixels count double for 6 m and two thirds for 2 m.
    let image = |name: &str, x: f64| image_at(name, [x, 0.0, 20.0], [0.0; 3]);
    let images = vec![image("left", -2.0), image("right", 0.0), image("far", 1.0), image("farthest", 4.0)];
    let cameras = Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images };
    let pair =
        |second: &str| Pair { name: format!("left+{second}"), second: second.into(), ..pairs().pairs[0].clone() };
    let survey = Pairs { pairs: ["right", "far", "farthest"].map(pair).to_vec() };
    let plane = plane();
    let of_pair = |second: usize| {
        let pick = |i: usize| cameras.images[i].clone();
        let two = scene(Cameras { images: vec![pick(0), pick(second)], ..cameras.clone() }, &plane, 1);
        let inputs = [
            ("first", Artefact::Depth(two.depths[0].clone())),
            ("second", Artefact::Depth(two.depths[1].clone())),
            ("noisy", Artefact::Cameras(cameras.clone())),
            ("pairs", Artefact::Pairs(survey.clone())),
            ("noise", Artefact::Noise(model())),
        ];
        let with = json!({"noise": "learnt", "channels": true, "pair": survey.pairs[second - 1].name});
        let outputs = run_stage::<MatchPair>(&TestHost::default(), &with, &inputs).unwrap().into_inner();
        Depth::of(&outputs["depth"]).unwrap().clone()
    };
    let maps = [1, 2, 3].map(of_pair);
    let mut compared = 0;
    for i in 0..maps[0].z.len() {
        let [a, b, c] = [0, 1, 2].map(|m: usize| (maps[m].z[i], maps[m].channels["noise.local"][i]));
        if [a, b, c].iter().any(|(z, px)| z.is_nan() || px.abs() < 0.01) {
            continue;
        }
        // Elevations to a hundredth of their error, which is centimetres; pixels by their bases.
        let error_m = (a.0 - 20.0).abs();
        assert!((b.0 - a.0).abs() < 0.02 * error_m && (c.0 - a.0).abs() < 0.02 * error_m, "{i}: {a:?} {b:?} {c:?}");
        assert!((a.1 / b.1 - 2.0 / 3.0).abs() < 0.02 && (c.1 / b.1 - 2.0).abs() < 0.04, "{i}: {a:?} {b:?} {c:?}");
        compared += 1;
    }
    assert!(compared > 300, "{compared}");
}

#[test]
fn replicates_take_the_strengths_of_the_members_in_turn() {
    let scene = scene(convergent(small_sensor()), &plane(), 1);
    let mut noise = model();
    noise.members = [0.0, 1.0, 2.0].map(|log| Member { log_strength: vec![log; 2], ..noise.members[0].clone() }).into();
    noise.orders = [vec![2, 0, 1], vec![1, 2, 0]];
    let strength = |acquisition: u32, replicate: u32| {
        let with = json!({"noise": "learnt", "channels": true, "acquisition": acquisition, "replicate": replicate});
        let map = run(&scene, Some(noise.clone()), &with).unwrap();
        let known = map.channels["noise.local"].iter().map(|px| f64::from(*px)).filter(|px| !px.is_nan());
        let squares: Vec<f64> = known.map(|px| px * px).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let weakest = strength(0, 1);
    for (acquisition, logs) in [(0, [2.0, 0.0, 1.0, 2.0]), (1, [1.0, 2.0, 0.0, 1.0])] {
        for (replicate, log) in logs.into_iter().enumerate() {
            let found = portable_math::log(strength(acquisition, replicate as u32) / weakest);
            // Fields of one acquisition are somewhat stronger or weaker than those of another by chance.
            assert!((found - log).abs() < 0.4, "{acquisition} {replicate}: {found}");
        }
    }
}

#[test]
fn model_and_parameters_must_fit() {
    let scene = scene(convergent(small_sensor()), &plane(), 1);
    let refused = |noise: Option<Noise>, with: Value| run(&scene, noise, &with).unwrap_err().message;
    assert!(refused(None, json!({"noise": "learnt"})).contains("needs a model at port `noise`"));
    assert!(refused(Some(model()), json!({})).contains("the paper's noise is asked for"));
    assert!(refused(Some(model()), json!({"noise": "learnt", "matcher": {}})).contains("holds all noise"));
    for name in ["acquisition", "replicate"] {
        let expected = format!("`{name}` numbers the draws of a learnt model");
        assert!(refused(None, json!({name: 1})).contains(&expected));
    }
    let world = Noise { frame: Frame::World, ..model() };
    assert!(refused(Some(world), json!({"noise": "learnt"})).contains("in the world frame"));
}

#[test]
fn half_the_resolution_halves_the_pixels_and_keeps_the_metres() {
    let full = errors(&scene(convergent(small_sensor()), &plane(), 1), Side::First, &model());
    let half = errors(&scene(convergent(small_sensor()), &plane(), 2), Side::First, &model());
    let right = |[x, y]: [f64; 2]| x > 0.0 && x < 6.0 && y.abs() < 6.0;
    let ratio = rms(&half, right) / rms(&full, right);
    assert!((ratio - 0.5).abs() < 0.1, "{ratio}");
}
