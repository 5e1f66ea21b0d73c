//! Round trips, noise and refusals of `match-pair` on small scenes with known answers.

use super::*;
use crate::camera::model::{Camera, full_pixel};
use crate::depth::depth_buffer::{Drawing, draw, rounded};
use rockface_core::artefact::{Artefact, Frame, Mesh, Noun, Sensor};
use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
use serde_json::{Value, json};

pub(super) struct Scene {
    cameras: Cameras,
    pub(super) noisy: Cameras,
    pub(super) depths: [Depth; 2],
    buffers: [Vec<f64>; 2],
}

fn sensor() -> Sensor {
    Sensor { k: [-0.2, 0.1, 0.0, 0.0], p: [0.002, -0.001], b1: 0.5, b2: 0.3, ..small_sensor() }
}

pub(super) fn convergent(sensor: Sensor) -> Cameras {
    let left = image_at("left", [-2.0, 0.1, 20.0], [0.01, -0.1, 0.02]);
    let right = image_at("right", [2.0, -0.1, 20.3], [-0.02, 0.1, -0.03]);
    Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![left, right] }
}

pub(super) fn scene(cameras: Cameras, mesh: &Mesh, downscale: u32) -> Scene {
    let drawing = Drawing { downscale, safe_border_px: 0.0, front_only: true, window_m: None };
    let project = |image: &Image| {
        let sensor = cameras.sensor(image).clone();
        let buffer = draw(mesh, &Camera::new(&sensor, image), &drawing);
        let z = buffer.z_m.iter().map(|z| rounded(*z)).collect();
        let (width, height, channels) = (buffer.width, buffer.height, BTreeMap::new());
        let image = image.clone();
        (Depth { frame: Frame::Wall, sensor, image, downscale, width, height, z, channels }, buffer.z_m)
    };
    let [(first, a), (second, b)] = [project(&cameras.images[0]), project(&cameras.images[1])];
    Scene { noisy: cameras.clone(), cameras, depths: [first, second], buffers: [a, b] }
}

fn wavy() -> Mesh {
    height_mesh(60, [-12.0, 12.0, -12.0, 12.0], |x, y| 0.05 * x * y + 0.3 * x - 0.02 * y * y)
}

pub(super) fn pairs() -> Pairs {
    let (first, second) = ("left".to_owned(), "right".to_owned());
    let pair = Pair {
        name: "left+right".into(),
        first,
        second,
        baseline_m: 4.0,
        distance_m: 20.0,
        convergence_rad: 0.2,
        overlap: 0.9,
    };
    Pairs { pairs: vec![pair] }
}

fn run(scene: &Scene, host: &TestHost, with: &Value) -> Result<Depth, StageError> {
    let inputs = [
        ("first", Artefact::Depth(scene.depths[0].clone())),
        ("second", Artefact::Depth(scene.depths[1].clone())),
        ("noisy", Artefact::Cameras(scene.noisy.clone())),
        ("pairs", Artefact::Pairs(pairs())),
    ];
    let outputs = run_stage::<MatchPair>(host, with, &inputs)?.into_inner();
    Ok(Depth::of(&outputs["depth"]).unwrap().clone())
}

fn matched(scene: &Scene, with: &Value) -> Depth {
    run(scene, &TestHost::default(), with).unwrap()
}

const SILENT: &str = r#"{"sigma_local_px": 0, "sigma_regular_px": 0}"#;

fn silent(of: &str) -> Value {
    let mut with: Value = serde_json::from_str(SILENT).unwrap();
    with["of"] = of.into();
    with
}

#[test]
fn without_noise_the_truth_comes_back() {
    for downscale in [1, 2] {
        let scene = scene(convergent(sensor()), &wavy(), downscale);
        for (side, of) in ["first", "second"].into_iter().enumerate() {
            let host = TestHost::default();
            let map = run(&scene, &host, &silent(of)).unwrap();
            let mut seen = 0;
            for (z, ideal) in map.z.iter().zip(&scene.depths[side].z).filter(|(z, _)| !z.is_nan()) {
                // One float32 step at 20 m.
                assert!((z - ideal).abs() <= f32::EPSILON * 16.0, "{z} instead of {ideal}");
                seen += 1;
            }
            assert!(seen * 10 > map.z.len() * 6, "{seen} of {}", map.z.len());
            assert!(host.metric("y_parallax_rms").unwrap() < 1e-9);
        }
    }
}

/// The columns and depths of the matches of a row.
struct Listed(Vec<(usize, f64)>);

impl TakeMatches for Listed {
    fn take(&mut self, column: usize, matched: &Match) {
        self.0.push((column, matched.depth_m));
    }

    fn take_depths(&mut self, first: usize, depth_m: Lanes, _: Lanes) -> bool {
        self.0.extend((first..).zip(depth_m.each()));
        true
    }
}

#[test]
fn the_kernel_itself_is_exact_to_a_nanometre() {
    let scene = scene(convergent(sensor()), &wavy(), 1);
    let params = <MatchPairParams as rockface_core::params::ParamType>::decode(&silent("first")).unwrap();
    let host = TestHost::default();
    let ideal = [&scene.depths[0], &scene.depths[1]];
    let keys = |purpose: &str, item: &str| Context::new(&host).stream(purpose, item);
    let setup = params.matching.setup(Sampling::Image, NoisePorts::default()).unwrap();
    let matcher = setup.matcher("p", ideal, Side::First, &scene.noisy, None, &keys).unwrap();
    let mut rows: Vec<Listed> = (0..ideal[0].height).map(|_| Listed(Vec::new())).collect();
    matcher.match_image(&mut rows);
    for (row, Listed(matches)) in rows.iter().enumerate() {
        for (column, depth_m) in matches {
            let truth = f64::from(ideal[0].z[row * ideal[0].width + column]);
            assert!((depth_m - truth).abs() < 1e-9);
            assert!((truth - scene.buffers[0][row * ideal[0].width + column]).abs() < 2e-6);
        }
    }
}

#[test]
fn wrong_orientations_show_as_y_parallax_and_leave_the_ray_unchanged() {
    let mut scene = scene(convergent(sensor()), &wavy(), 1);
    scene.noisy.images[1] = image_at("right", [2.0, -0.098, 20.3], [-0.0208, 0.1, -0.03]);
    scene.noisy.sensors[0].k[0] += 0.001;
    let host = TestHost::default();
    let mut with = silent("first");
    with["channels"] = true.into();
    let map = run(&scene, &host, &with).unwrap();
    let rms = host.metric("y_parallax_rms").unwrap();
    assert!((0.05..0.3).contains(&rms), "{rms}");
    let dy: Vec<f32> = map.channels["y_parallax"].iter().copied().filter(|dy| !dy.is_nan()).collect();
    assert!(dy.iter().all(|dy| dy.is_finite()) && dy.len() > 1000);
    assert_eq!(map.sensor, scene.noisy.sensors[0]);
    scene.noisy.images[1] = image_at("right", [2.0, -0.1, 20.3], [-0.028, 0.1, -0.03]);
    assert!(!run(&scene, &host, &with).map(|_| host.warnings()).unwrap().is_empty());
    scene.noisy.images[1] = image_at("right", [2.0, -0.1, 20.3], [-0.1, 0.1, -0.03]);
    assert!(run(&scene, &host, &with).unwrap_err().message.contains("could not be matched"));
}

#[test]
fn y_parallax_counts_pixels_of_the_images_at_any_downscale() {
    let rms = |downscale: u32| {
        let mut scene = scene(convergent(sensor()), &wavy(), downscale);
        scene.noisy.images[1] = image_at("right", [2.0, -0.1, 20.3], [-0.028, 0.1, -0.03]);
        let host = TestHost::default();
        run(&scene, &host, &silent("first")).unwrap();
        host.metric("y_parallax_rms").unwrap()
    };
    assert!((rms(2) / rms(1) - 1.0).abs() < 0.05 && rms(1) > 0.5, "{} {}", rms(2), rms(1));
    let mut scene = scene(convergent(sensor()), &wavy(), 4);
    scene.noisy.images[1] = image_at("right", [2.0, -0.1, 20.3], [-0.1, 0.1, -0.03]);
    assert!(run(&scene, &TestHost::default(), &silent("first")).unwrap_err().message.contains("could not be matched"));
}

#[test]
fn noise_in_pixels_of_the_images_is_the_same_on_the_face() {
    let scene = scene(convergent(sensor()), &wavy(), 2);
    let image = json!({"pixels": "image", "sigma_local_px": 0.4, "sigma_regular_px": 0.6, "spacing_px": 18, "matcher": {"local_length_px": 4}});
    let map =
        json!({"sigma_local_px": 0.2, "sigma_regular_px": 0.3, "spacing_px": 9, "matcher": {"local_length_px": 2}});
    assert_eq!(matched(&scene, &image).z.len(), matched(&scene, &map).z.len());
    let bits = |with: &Value| matched(&scene, with).z.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&image), bits(&map));
    let error = |with: Value| run(&scene, &TestHost::default(), &with).unwrap_err().message;
    assert!(error(json!({"pixels": "image", "matcher": {"relief": {}}})).contains("whole pixels"));
}

#[test]
fn both_maps_of_a_pair_carry_the_same_error() {
    let scene = scene(convergent(sensor()), &wavy(), 1);
    let with = |of: &str| json!({"of": of, "channels": true, "spacing_px": 9, "sigma_local_px": 0.1});
    let (first, second) = (matched(&scene, &with("first")), matched(&scene, &with("second")));
    let cameras = [Camera::of_depth(&scene.depths[0]), Camera::of_depth(&scene.depths[1])];
    let mut compared = 0;
    for (i, z) in scene.depths[1].z.iter().enumerate().filter(|(i, _)| !second.z[*i].is_nan()) {
        let pixel = full_pixel(i % second.width, i / second.width, 1);
        let point = cameras[1].unproject(cameras[1].normalised(pixel).unwrap(), f64::from(*z));
        let [u, v] = cameras[0].project(&point).unwrap();
        let near = v.round() as usize * first.width + u.round() as usize;
        if first.z[near].is_nan() {
            continue;
        }
        let noise = |map: &Depth, name: &str, i: usize| map.channels[name][i];
        assert_eq!(noise(&second, "noise.local", i).to_bits(), noise(&first, "noise.local", near).to_bits());
        // Half a pixel apart on a field with nodes every 9 pixels.
        assert!((noise(&second, "noise.regular", i) - noise(&first, "noise.regular", near)).abs() < 0.35);
        compared += 1;
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn sigmas_scale_one_unit_field() {
    let scene = scene(convergent(small_sensor()), &wavy(), 1);
    let noise = |sigma: f64, name: &str| {
        let with = json!({"sigma_local_px": sigma, "sigma_regular_px": sigma, "channels": true});
        matched(&scene, &with).channels[name].clone()
    };
    for name in ["noise.local", "noise.regular"] {
        for (a, b) in noise(0.25, name).iter().zip(noise(0.5, name)).filter(|(a, _)| !a.is_nan()) {
            assert!((2.0 * a - b).abs() < 1e-6);
        }
    }
    assert!(!MatchPair::draws(&rockface_core::params::ParamType::decode(&silent("first")).unwrap()));
}

#[test]
fn terms_of_the_matcher_stand_without_the_papers_noise() {
    let scene = scene(convergent(small_sensor()), &wavy(), 1);
    for matcher in [json!({}), json!({"pixel_locking_px": 0.1}), json!({"texture": {}}), json!({"acquisition": {}})] {
        let mut with = silent("first");
        with["matcher"] = matcher;
        assert!(matched(&scene, &with).z.iter().any(|z| z.is_finite()));
    }
}

#[test]
fn a_distribution_that_correlated_noise_does_not_have_is_refused() {
    let faults = |with: Value| MatchPair::check(&rockface_core::params::ParamType::decode(&with).unwrap());
    let with = |length: f64| json!({"local_distribution": "laplace", "matcher": {"local_length_px": length}});
    assert!(faults(with(0.0)).is_empty());
    assert_eq!(faults(with(4.0))[0].path, ["local_distribution"]);
}

#[test]
fn channels_and_log_give_the_depth_across_the_rectified_plane() {
    let scene = scene(convergent(small_sensor()), &wavy(), 1);
    let mut with = silent("first");
    (with["channels"], with["sampling"]) = (true.into(), "rectified".into());
    let host = TestHost::default();
    let map = run(&scene, &host, &with).unwrap();
    let [focal, baseline, at_infinity] =
        ["rectified_focal", "baseline", "disparity_at_infinity"].map(|name| host.metric(name).unwrap());
    let both = map.z.iter().zip(&map.channels["disparity"]).filter(|(z, _)| z.is_finite());
    let off = |(z, disparity): (&f32, &f32)| f64::from(*z) - focal * baseline / (f64::from(*disparity) - at_infinity);
    assert!(both.map(off).all(|off| off.abs() < 1e-4));
}

#[test]
fn what_the_other_image_cannot_see_is_not_matched() {
    let mut mesh = height_mesh(1, [-30.0, 30.0, -30.0, 30.0], |_, _| 0.0);
    let ball = height_mesh(40, [-1.0, 1.0, -1.0, 1.0], |x, y| 4.0 + (2.2 - x * x - y * y).sqrt());
    mesh.triangles.extend(ball.triangles.iter().map(|t| t.map(|i| i + 4)));
    mesh.vertices.extend(ball.vertices);
    let scene = scene(convergent(small_sensor()), &mesh, 1);
    let map = matched(&scene, &silent("first"));
    let mut through = silent("first");
    through["occlusion"] = false.into();
    let through = matched(&scene, &through);
    let [left, right] = [0, 1].map(|i| Camera::new(&small_sensor(), &scene.cameras.images[i]));
    let mut hidden = 0;
    for (i, z) in through.z.iter().enumerate().filter(|(_, z)| !z.is_nan()) {
        let point = left.unproject(left.normalised(full_pixel(i % 60, i / 60, 1)).unwrap(), f64::from(*z));
        let back = right.centre() - point;
        // The ray to the right camera passes the raised patch well inside its outline.
        let at = point + back * ((5.0 - point.z) / back.z);
        if point.z < 1.0 && at.x.abs() < 0.6 && at.y.abs() < 0.6 {
            assert!(map.z[i].is_nan(), "pixel {i} is hidden");
            hidden += 1;
        } else if at.x.abs() > 1.6 || at.y.abs() > 1.6 {
            assert!(!map.z[i].is_nan(), "pixel {i} is seen");
        }
    }
    assert!(hidden > 20, "{hidden}");
}

/// Fronto-parallel plane at Z 87 m, f 19540 px, B 32.6 m: a pixel of disparity is worth 11.88 mm.
#[test]
fn a_hunter_valley_pair_has_the_predicted_depth_error() {
    let (w, h) = (900, 400);
    let sensor = |cx: f64| Sensor { width_px: w, height_px: h, f: 19_540.0, cx, cy: 200.0, ..small_sensor() };
    // The principal points are shifted so that two parallel views share their crop.
    let shift = 19_540.0 * 16.3 / 87.0;
    let images = vec![
        image_at("left", [-16.3, 0.0, 87.0], [0.0; 3]),
        Image { sensor: 1, ..image_at("right", [16.3, 0.0, 87.0], [0.0; 3]) },
    ];
    let sensors = vec![sensor(450.0 - shift), sensor(450.0 + shift)];
    let cameras = Cameras { frame: Frame::Wall, sensors, images };
    let mut scene = scene(cameras, &height_mesh(1, [-30.0, 30.0, -30.0, 30.0], |_, _| 0.0), 1);
    scene.depths.iter_mut().for_each(|depth| depth.image.sensor = 0);
    for (local, regular) in [(0.7f64, 0.0f64), (0.0, 0.6), (0.7, 0.6)] {
        let with = json!({"sigma_local_px": local, "sigma_regular_px": regular, "spacing_px": 5});
        let host = TestHost::default();
        let map = run(&scene, &host, &with).unwrap();
        assert!((host.metric("depth_per_disparity").unwrap() - 0.01188).abs() < 1e-5);
        let errors: Vec<f64> = map.z.iter().filter(|z| !z.is_nan()).map(|z| f64::from(*z) - 87.0).collect();
        let std = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let expected = 0.01188 * (local * local + 0.663 * regular * regular).sqrt();
        assert!((std / expected - 1.0).abs() < 0.02, "{std} instead of {expected}");
    }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let scene = scene(convergent(sensor()), &wavy(), 1);
    let bytes = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| matched(&scene, &json!({"channels": true, "of": "second"})).encode().unwrap())
    };
    assert_eq!(bytes(1), bytes(3));
}

#[test]
fn pixels_that_see_nothing_need_no_place_in_the_rectified_image() {
    // Beyond a radius of 0.337 this lens has no inverse: the corners of the image are farther out.
    let folding = Sensor { k: [-1.3, 0.0, 0.0, 0.0], ..small_sensor() };
    let small = height_mesh(60, [-2.0, 2.0, -1.5, 1.5], |x, _| 0.1 * x);
    let scene = scene(convergent(folding), &small, 1);
    assert!(Camera::of_depth(&scene.depths[0]).normalised([0.0, 0.0]).is_none());
    let deviation = |with: Value| {
        let errors: Vec<f64> = scene.depths[0]
            .z
            .iter()
            .zip(&matched(&scene, &with).z)
            .map(|(ideal, found)| f64::from(found - ideal))
            .collect();
        let errors: Vec<f64> = errors.into_iter().filter(|error| error.is_finite()).collect();
        assert!(errors.len() > 100, "{}", errors.len());
        (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
    };
    let quiet = deviation(json!({"sigma_local_px": 0, "sigma_regular_px": 0}));
    let smooth = deviation(json!({"sigma_local_px": 0, "sigma_regular_px": 0.5, "spacing_px": 10}));
    // Half a pixel of disparity is 0.5 m there.
    assert!(quiet < 1e-4 && smooth > 0.1 && smooth < 1.0, "{quiet} {smooth}");
}

#[test]
fn it_says_what_does_not_fit() {
    let base = || scene(convergent(small_sensor()), &wavy(), 2);
    let error = |scene: &Scene, with: Value| run(scene, &TestHost::default(), &with).unwrap_err().message;
    assert!(error(&base(), json!({"pair": "a+b"})).contains("no pair `a+b`"));
    let mut bad = base();
    bad.depths.swap(0, 1);
    assert!(error(&bad, json!({})).contains("`first` is the depth map of image `right`"));
    let hint = run(&bad, &TestHost::default(), &json!({})).unwrap_err().hint.unwrap();
    assert!(hint.contains("exchange `first` and `second`"), "{hint}");
    bad = base();
    bad.depths[1] = scene(convergent(small_sensor()), &wavy(), 1).depths[1].clone();
    assert!(error(&bad, json!({})).contains("downscale"));
    bad = base();
    bad.noisy.images.pop();
    assert!(error(&bad, json!({})).contains("no image `right`"));
    bad = base();
    bad.noisy.frame = Frame::World;
    assert!(error(&bad, json!({})).contains("world frame"));
    bad = base();
    bad.noisy.images[1].centre_m = bad.noisy.images[0].centre_m;
    let refusal = run(&bad, &TestHost::default(), &json!({})).unwrap_err();
    assert!(refusal.message.contains("pair `left+right`: the two projection centres coincide"), "{refusal}");
    assert!(refusal.hint.is_some_and(|hint| hint.contains("remove it from `pairs`")));
    bad = base();
    bad.depths[1].z.fill(f32::NAN);
    assert!(error(&bad, json!({})).contains("no point in common"));
}

/// Errors of a map over a plane 20 m away, in pixels of disparity, by row.
fn plane_errors(with: &Value, width: u32) -> (Vec<Option<f64>>, usize) {
    let sensor = Sensor { width_px: width, height_px: width, cx: f64::from(width) / 2.0, cy: 60.0, ..small_sensor() };
    let images = vec![image_at("left", [-0.2, 0.0, 20.0], [0.0; 3]), image_at("right", [0.2, 0.0, 20.0], [0.0; 3])];
    let cameras = Cameras { frame: Frame::Wall, sensors: vec![Sensor { f: 2000.0, ..sensor }], images };
    let scene = scene(cameras, &height_mesh(2, [-30.0, 30.0, -30.0, 30.0], |_, _| 0.0), 1);
    let host = TestHost::seeded(with.to_string().len() as u64);
    let map = run(&scene, &host, with).unwrap();
    let per_px = host.metric("depth_per_disparity").unwrap();
    let error = |z: &f32| z.is_finite().then(|| (20.0 - f64::from(*z)) / per_px);
    (map.z.iter().map(error).collect(), map.width)
}

fn correlation(errors: &[Option<f64>], lag: usize) -> f64 {
    let mean = |f: &dyn Fn(usize) -> Option<f64>| {
        let found: Vec<f64> = (0..errors.len() - lag).filter_map(f).collect();
        found.iter().sum::<f64>() / found.len() as f64
    };
    mean(&|i| Some(errors[i]? * errors[i + lag]?)) / mean(&|i| Some(errors[i]? * errors[i]?))
}

#[test]
fn terms_that_do_nothing_change_no_bit() {
    let scene = scene(convergent(sensor()), &wavy(), 1);
    for of in ["first", "second"] {
        let plain = matched(&scene, &json!({"of": of}));
        assert_eq!(matched(&scene, &json!({"of": of, "matcher": {}})), plain);
    }
}

#[test]
fn the_local_noise_has_the_correlation_asked_for() {
    let with = json!({"sigma_local_px": 0.5, "sigma_regular_px": 0, "matcher": {"local_length_px": 4}});
    let (errors, _) = plane_errors(&with, 400);
    for lag in [1, 2, 4, 8] {
        let expected = rockface_core::numerics::portable_math::exp(-(lag as f64) / 4.0);
        let found = correlation(&errors, lag);
        assert!((found - expected).abs() < 0.06, "lag {lag}: {found} instead of {expected}");
    }
}

#[test]
fn a_texture_stays_and_makes_the_tails_heavy() {
    let with = |seed: u32| json!({"sigma_local_px": 0.5, "sigma_regular_px": 0, "matcher": {"texture": {"log_sd": 0.5, "seed": seed}}});
    let (errors, _) = plane_errors(&with(1), 300);
    let moment = |power: usize| {
        errors.iter().flatten().map(|e| [*e; 4][..power].iter().product::<f64>()).sum::<f64>() / errors.len() as f64
    };
    // A log-normal deviation of logarithmic spread s has kurtosis 3 exp(4 s^2).
    let kurtosis = moment(4) / (moment(2) * moment(2));
    assert!(kurtosis > 5.0, "{kurtosis}");
    assert_eq!(plane_errors(&with(1), 60).0, plane_errors(&with(1), 60).0);
    assert_ne!(plane_errors(&with(1), 60).0, plane_errors(&with(2), 60).0);
}

#[test]
fn noise_is_stronger_at_a_ledge_and_holes_leave_gaps() {
    let mesh = height_mesh(240, [-3.0, 3.0, -3.0, 3.0], |x, _| if x < 0.0 { 0.0 } else { 0.3 });
    let mut scene = scene(convergent(small_sensor()), &mesh, 1);
    scene.noisy = scene.cameras.clone();
    let rms_at_ledge = |with: &Value| {
        let map = matched(&scene, with);
        let far = |(z, ideal): (&f32, &f32)| (z - ideal).is_finite().then(|| f64::from(z - ideal).abs());
        map.z.iter().zip(&scene.depths[0].z).filter_map(far).fold(0.0, f64::max)
    };
    let quiet = json!({"sigma_local_px": 0.01, "sigma_regular_px": 0});
    let relief = json!({"sigma_local_px": 0.01, "sigma_regular_px": 0, "matcher": {"relief": {"gain": 1, "power": 1}}});
    assert!(rms_at_ledge(&relief) > 3.0 * rms_at_ledge(&quiet));
    let holes = matched(&scene, &json!({"matcher": {"holes": {"share": 0.5, "length_px": 2}}}));
    let plain = matched(&scene, &json!({}));
    let count = |map: &Depth| map.z.iter().filter(|z| z.is_finite()).count();
    assert!(count(&holes) * 10 < count(&plain) * 8 && count(&holes) * 10 > count(&plain) * 2);
}

mod rectified;
