//! `match-image` against `match-pair`, the sharing of noise, and refusals, on a row of small images.

use super::*;
use crate::camera::model::Camera;
use crate::depth::depth_buffer::{Drawing, draw, rounded};
use rockface_core::artefact::{Artefact, Frame, Mesh, Noun, Sensor};
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
use rockface_core::{Later, Point};
use rockface_raster::robust_mean::{Measured, fuse};
use serde_json::{Value, json};
use std::sync::{Arc, Mutex};

struct Block {
    noisy: Cameras,
    depths: Vec<Depth>,
    pairs: Pairs,
}

/// Images `a`, `b`, ... in a row 2 m apart, 20 m before a surface; every two of them a pair.
fn block(count: u8, sensor: &Sensor, mesh: &Mesh) -> Block {
    let name = |i: u8| char::from(b'a' + i).to_string();
    let place = |i: u8| [2.0 * f64::from(i) - f64::from(count) + 1.0, 0.1 * f64::from(i % 2), 20.0];
    let turn = |i: u8| [0.01, -0.03 * (f64::from(i) - 0.5 * f64::from(count - 1)), 0.02];
    let images: Vec<Image> = (0..count).map(|i| image_at(&name(i), place(i), turn(i))).collect();
    let cameras = Cameras { frame: Frame::Wall, sensors: vec![sensor.clone()], images };
    let pair = |first: u8, second: u8| Pair {
        name: format!("{}+{}", name(first), name(second)),
        first: name(first),
        second: name(second),
        baseline_m: 2.0,
        distance_m: 20.0,
        convergence_rad: 0.1,
        overlap: 0.8,
    };
    let pairs = (0..count).flat_map(|i| (i + 1..count).map(move |j| (i, j))).map(|(i, j)| pair(i, j)).collect();
    let depths = cameras.images.iter().map(|image| project(mesh, sensor, image)).collect();
    Block { noisy: cameras, depths, pairs: Pairs { pairs } }
}

fn project(mesh: &Mesh, sensor: &Sensor, image: &Image) -> Depth {
    let drawing = Drawing { downscale: 1, safe_border_px: 0.0, front_only: true, window_m: None };
    let buffer = draw(mesh, &Camera::new(sensor, image), &drawing);
    let z = buffer.z_m.iter().map(|z| rounded(*z)).collect();
    let (width, height) = (buffer.width, buffer.height);
    let (sensor, image) = (sensor.clone(), image.clone());
    Depth { frame: Frame::Wall, sensor, image, downscale: 1, width, height, z, channels: BTreeMap::new() }
}

fn wavy() -> Mesh {
    height_mesh(60, [-14.0, 14.0, -12.0, 12.0], |x, y| 0.05 * x * y + 0.3 * x - 0.02 * y * y)
}

fn lens() -> Sensor {
    Sensor { k: [-0.2, 0.1, 0.0, 0.0], p: [0.002, -0.001], b1: 0.5, b2: 0.3, ..small_sensor() }
}

fn run(block: &Block, host: &TestHost, with: &Value) -> Result<Depth, StageError> {
    run_with_errors(block, host, with, None)
}

fn run_with_errors(block: &Block, host: &TestHost, with: &Value, errors: Option<Depth>) -> Result<Depth, StageError> {
    let mut inputs: Vec<(&str, Artefact)> =
        vec![("noisy", Artefact::Cameras(block.noisy.clone())), ("pairs", Artefact::Pairs(block.pairs.clone()))];
    inputs.extend(block.depths.iter().map(|depth| ("depths", Artefact::Depth(depth.clone()))));
    inputs.extend(errors.map(|map| ("errors", Artefact::Depth(map))));
    let outputs = run_stage::<MatchImage>(host, with, &inputs)?.into_inner();
    Ok(Depth::of(&outputs["depth"]).unwrap().clone())
}

fn matched(block: &Block, with: &Value) -> Depth {
    run(block, &TestHost::default(), with).unwrap()
}

/// What `match-pair` makes of a pair of the block.
fn single(block: &Block, pair: &Pair, with: &Value) -> Depth {
    single_with_errors(block, pair, with, None)
}

fn single_with_errors(block: &Block, pair: &Pair, with: &Value, errors: Option<Depth>) -> Depth {
    let mut inputs = Inputs::default();
    let depth = |name: &str| block.depths.iter().find(|depth| depth.image.name == name).unwrap().clone();
    for (port, artefact) in [
        ("first", Artefact::Depth(depth(&pair.first))),
        ("second", Artefact::Depth(depth(&pair.second))),
        ("noisy", Artefact::Cameras(block.noisy.clone())),
        ("pairs", Artefact::Pairs(Pairs { pairs: vec![pair.clone()] })),
    ] {
        inputs.push(port, Point::new(), Arc::new(artefact));
    }
    errors.into_iter().for_each(|map| inputs.push("errors", Point::new(), Arc::new(Artefact::Depth(map))));
    let stage = rockface_core::testing::stage(crate::matching::STAGES, "match-pair");
    let outputs = stage.run(with, &inputs, &Context::new(&TestHost::default())).unwrap().into_inner();
    Depth::of(&outputs["depth"]).unwrap().clone()
}

#[test]
fn one_pair_is_what_match_pair_makes_bit_for_bit() {
    let mut block = block(2, &lens(), &wavy());
    block.noisy.images[1] = image_at("b", [1.002, 0.1, 20.0], [0.0101, -0.0151, 0.02]);
    block.noisy.sensors[0].k[0] += 0.001;
    for (image, of) in [("a", "first"), ("b", "second")] {
        for matcher in [json!(null), json!({"local_length_px": 3, "window": {}, "relief": {}, "holes": {"share": 0.1}})]
        {
            let noise = json!({"sigma_local_px": 0.3, "sigma_regular_px": 0.4, "spacing_px": 9, "matcher": matcher});
            let (mut one, mut all) = (noise.clone(), noise);
            one["of"] = of.into();
            (all["image"], all["channels"]) = (image.into(), json!([]));
            assert_eq!(matched(&block, &all), single(&block, &block.pairs.pairs[0], &one));
        }
    }
}

#[test]
fn errors_of_ones_own_are_those_of_match_pair_and_may_differ_by_pair() {
    let block = block(3, &lens(), &wavy());
    let with = |image: &str| json!({"image": image, "sigma_local_px": 0.3, "sigma_regular_px": 0.4, "spacing_px": 9, "channels": []});
    let errors = |image: usize, channels: &[(&str, f32)]| {
        let mut map = block.depths[image].clone();
        let values = |scale: f32| (0..map.z.len()).map(|pixel| scale * (pixel % 7) as f32).collect();
        map.channels = channels.iter().map(|(name, scale)| ((*name).to_owned(), values(*scale))).collect();
        map
    };
    let run = |pairs: &[&Pair], image: &str, errors: Option<Depth>| {
        let pairs = Pairs { pairs: pairs.iter().map(|pair| (*pair).clone()).collect() };
        let block = Block { noisy: block.noisy.clone(), depths: block.depths.clone(), pairs };
        run_with_errors(&block, &TestHost::default(), &with(image), errors)
    };
    let pair = |name: &str| block.pairs.pairs.iter().find(|pair| pair.name == name).unwrap().clone();
    let (first, second) = (pair("a+b"), pair("b+c"));

    // One pair: what `match-pair` makes of the same errors.
    let noise = json!({"sigma_local_px": 0.3, "sigma_regular_px": 0.4, "spacing_px": 9});
    let of_pair = |pair: &Pair, map: Depth| single_with_errors(&block, pair, &noise, Some(map));
    let own = || errors(0, &[("error_px", 0.05)]);
    assert_eq!(run(&[&first], "a", Some(own())).unwrap(), of_pair(&first, own()));
    assert_ne!(run(&[&first], "a", Some(own())).unwrap(), run(&[&first], "a", None).unwrap());

    // Two pairs of `b`, each with a channel of its own: alone each is what its channel makes of it.
    let two = || errors(1, &[("error_px.a+b", 0.05), ("error_px.b+c", -0.04)]);
    for (pair, scale) in [(&first, 0.05), (&second, -0.04)] {
        let alone = run(&[pair], "b", Some(errors(1, &[("error_px", scale)]))).unwrap();
        assert_eq!(run(&[pair], "b", Some(two())).unwrap(), alone);
    }
    let both = run(&[&first, &second], "b", Some(two())).unwrap();
    assert_ne!(both, run(&[&first, &second], "b", None).unwrap());

    let said = run(&[&first], "b", Some(own())).unwrap_err().message;
    assert!(said.contains("`errors` is of image `a`"), "{said}");
}

#[test]
fn only_the_image_and_its_partners_are_read() {
    let mut block = block(4, &lens(), &wavy());
    block.pairs.pairs.retain(|pair| ["a+b", "b+c", "c+d"].contains(&pair.name.as_str()));
    let read = Mutex::new(Vec::new());
    let mut inputs = Inputs::default();
    for depth in &block.depths {
        let (name, value) = (depth.image.name.clone(), Arc::new(Artefact::Depth(depth.clone())));
        let point = Point::from([("image".to_owned(), name.clone())]);
        let read = &read;
        let later = Later::new(move || {
            read.lock().unwrap().push(name.clone());
            Ok(value.clone())
        });
        inputs.push_later("depths", point, Arc::new(later));
    }
    inputs.push("noisy", Point::new(), Arc::new(block.noisy.clone().into()));
    inputs.push("pairs", Point::new(), Arc::new(block.pairs.clone().into()));
    let with = json!({"image": "a"});
    let params = MatchImageParams::decode(&with).unwrap();
    let outputs = MatchImage::run(&params, &inputs, &Context::new(&TestHost::default())).unwrap().into_inner();
    assert_eq!(*read.lock().unwrap(), ["a", "b"]);
    assert_eq!(Depth::of(&outputs["depth"]).unwrap(), &matched(&block, &with));
}

#[test]
fn a_map_of_strength_is_for_matchers_with_terms_and_acts_where_it_is_strong() {
    let block = block(3, &lens(), &wavy());
    let grid = rockface_core::artefact::Grid { columns: 2, rows: 1, cell_m: 20.0, left_m: -20.0, top_m: 10.0 };
    let strength = Raster::single(grid, Frame::Wall, "strength", "", vec![0.0, 2.0]);
    let run = |with: &Value, strength: Option<&Raster>| {
        let mut inputs: Vec<(&str, Artefact)> =
            vec![("noisy", Artefact::Cameras(block.noisy.clone())), ("pairs", Artefact::Pairs(block.pairs.clone()))];
        inputs.extend(block.depths.iter().map(|depth| ("depths", Artefact::Depth(depth.clone()))));
        inputs.extend(strength.map(|raster| ("strength", Artefact::Raster(raster.clone()))));
        let outputs = run_stage::<MatchImage>(&TestHost::default(), with, &inputs)?.into_inner();
        Ok::<_, StageError>(Depth::of(&outputs["depth"]).unwrap().clone())
    };
    // Little noise, so that depth is linear in it.
    let mut with = json!({"image": "b", "sigma_local_px": 0.001, "sigma_regular_px": 0, "rejection": 50});
    assert!(run(&with, Some(&strength)).unwrap_err().message.contains("no use for `strength`"));
    with["matcher"] = json!({});
    let (mapped, plain) = (run(&with, Some(&strength)).unwrap(), run(&with, None).unwrap());
    let camera = Camera::new(&block.noisy.sensors[0], &block.noisy.images[1]);
    let mut checked = [0; 2];
    for (i, ideal) in block.depths[1].z.iter().enumerate().filter(|(i, _)| !mapped.z[*i].is_nan()) {
        let ray = camera.normalised(crate::camera::model::full_pixel(i % 60, i / 60, 1)).unwrap();
        let x = camera.unproject(ray, f64::from(*ideal)).x;
        let (with, without) = (f64::from(mapped.z[i] - ideal), f64::from(plain.z[i] - ideal));
        if x < -0.1 {
            assert!(with.abs() < 1e-5, "pixel {i}: {with}");
            checked[0] += 1;
        } else if x > 0.1 {
            assert!((with - 2.0 * without).abs() < 0.02 * without.abs() + 1e-5, "pixel {i}: {with} {without}");
            checked[1] += 1;
        }
    }
    assert!(checked.iter().all(|count| *count > 500), "{checked:?}");
}

#[test]
fn several_pairs_are_the_fusion_of_their_maps() {
    let block = block(4, &lens(), &wavy());
    // Errors of about a centimetre.
    let noise = json!({"sigma_local_px": 0.003, "sigma_regular_px": 0.004, "spacing_px": 9});
    let mut with = noise.clone();
    (with["image"], with["channels"]) = ("b".into(), json!(["sigma", "pairs"]));
    let map = matched(&block, &with);
    let of_b: Vec<(Depth, f64)> = (block.pairs.pairs.iter())
        .filter(|pair| pair.first == "b" || pair.second == "b")
        .map(|pair| {
            let mut with = noise.clone();
            with["of"] = if pair.first == "b" { "first" } else { "second" }.into();
            (single(&block, pair, &with), f64::from(pair.second.as_bytes()[0] - pair.first.as_bytes()[0]))
        })
        .collect();
    let rule = fusion(&MatchImageParams::decode(&with).unwrap(), 1).rule;
    let mut compared = 0;
    for (i, z) in map.z.iter().enumerate() {
        // Sigma goes by the baseline: half of it, half the precision.
        let given = of_b.iter().filter(|(map, _)| map.z[i].is_finite());
        let mut values: Vec<Measured> =
            given.map(|(map, steps)| Measured::new(f64::from(map.z[i]), 0.1 / steps)).collect();
        let count = values.len();
        let Some(expected) = fuse(&mut values, &rule) else {
            assert!(z.is_nan());
            continue;
        };
        if expected.count == count && map.channels["pairs"][i] as usize == count {
            assert!((f64::from(*z) - expected.value.value_m).abs() < 3e-4, "pixel {i}: {z} {expected:?}");
            compared += 1;
        }
        assert!(map.channels["sigma"][i] > 0.0);
    }
    assert!(compared > 1000, "{compared}");
}

/// Rms error of image `c` of five before a plane, metres, where all of its four pairs see it.
fn rms(with: &Value) -> f64 {
    let sensor = Sensor { width_px: 320, height_px: 120, f: 300.0, cx: 159.5, cy: 59.5, ..small_sensor() };
    let plane = height_mesh(2, [-60.0, 60.0, -60.0, 60.0], |_, _| 0.0);
    let block = block(5, &sensor, &plane);
    let map = matched(&block, with);
    let pairs = &map.channels["pairs"];
    let errors: Vec<f64> = (map.z.iter().zip(&block.depths[2].z).zip(pairs))
        .filter(|(_, pairs)| **pairs > 3.5)
        .map(|((z, ideal), _)| f64::from(z - ideal))
        .collect();
    assert!(errors.len() > 5_000, "{}", errors.len());
    (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn noise_of_pairs_averages_away_and_noise_of_images_stays() {
    let with = |sharing: Value| json!({"image": "c", "sigma_local_px": 0.2, "sigma_regular_px": 0, "rejection": 50, "channels": ["pairs"], "noise_sharing": sharing});
    let (pair, image) = (rms(&with(json!("pair"))), rms(&with(json!("image"))));
    let mix = rms(&with(json!({"mix": {"image_share": 0.5}})));
    // Baselines of 2, 2, 4 and 4 m at 20 m and 300 px: weights 1, 1, 4, 4 of (0.67 m / px x 0.2)^-2.
    let expected = 0.2 * 20.0 * 20.0 / (300.0 * 2.0) / 10f64.sqrt();
    assert!((pair / expected - 1.0).abs() < 0.05, "{pair} instead of {expected}");
    // The image's own half adds up with the signs of the baselines: it shows in pairs on both sides with opposite sign.
    assert!((mix - pair).abs() < 0.5 * pair && image > 0.0, "{pair} {mix} {image}");
}

#[test]
fn noise_of_images_goes_by_the_direction_of_the_partner() {
    let sensor = Sensor { width_px: 160, height_px: 160, f: 150.0, cx: 79.5, cy: 79.5, ..small_sensor() };
    let plane = height_mesh(2, [-60.0, 60.0, -60.0, 60.0], |_, _| 0.0);
    let places = [("c", [0.0, 0.0]), ("east", [2.0, 0.0]), ("west", [-2.0, 0.0]), ("north", [0.0, 2.0])];
    let images = places.map(|(name, [x, y])| image_at(name, [x, y, 20.0], [0.0; 3])).to_vec();
    let depths: Vec<Depth> = images.iter().map(|image| project(&plane, &sensor, image)).collect();
    let noisy = Cameras { frame: Frame::Wall, sensors: vec![sensor.clone()], images };
    // Errors of depth of the image in the middle, from one pair.
    let errors = |first: &str, second: &str, noise: Value| {
        let mut pairs = block(2, &sensor, &plane).pairs;
        (pairs.pairs[0].first, pairs.pairs[0].second) = (first.into(), second.into());
        let mut with = noise;
        (with["image"], with["noise_sharing"], with["spacing_px"]) = ("c".into(), "image".into(), 4.into());
        let map = matched(&Block { noisy: noisy.clone(), depths: depths.clone(), pairs }, &with);
        map.z.iter().zip(&depths[0].z).map(|(z, ideal)| f64::from(z - ideal)).collect::<Vec<f64>>()
    };
    let correlation = |one: &[f64], other: &[f64]| {
        let both: Vec<[f64; 2]> =
            one.iter().zip(other).map(|(a, b)| [*a, *b]).filter(|[a, b]| a.is_finite() && b.is_finite()).collect();
        assert!(both.len() > 10_000, "{}", both.len());
        let sum = |i: usize, j: usize| both.iter().map(|pair| pair[i] * pair[j]).sum::<f64>();
        sum(0, 1) / (sum(0, 0) * sum(1, 1)).sqrt()
    };
    for noise in [
        json!({"sigma_local_px": 0.01, "sigma_regular_px": 0}),
        json!({"sigma_local_px": 0, "sigma_regular_px": 0.01}),
        json!({"sigma_local_px": 0.01, "sigma_regular_px": 0, "matcher": {"local_length_px": 2}}),
    ] {
        let [east, west, north] = ["east", "west", "north"].map(|partner| errors("c", partner, noise.clone()));
        // Half of the variance is that of the image in the middle.
        let (opposite, across) = (correlation(&east, &west), correlation(&east, &north));
        assert!((opposite + 0.5).abs() < 0.1 && across.abs() < 0.1, "{noise}: {opposite} {across}");
        for (partner, errors_there) in [("east", &east), ("north", &north)] {
            let swapped = errors(partner, "c", noise.clone());
            assert!(correlation(errors_there, &swapped) > 0.999, "{noise}: {partner}");
        }
    }
}

#[test]
fn without_noise_the_truth_comes_back_and_threads_change_nothing() {
    let block = block(3, &lens(), &wavy());
    let map = matched(&block, &json!({"image": "b", "sigma_local_px": 0, "sigma_regular_px": 0}));
    let mut seen = 0;
    for (z, ideal) in map.z.iter().zip(&block.depths[1].z).filter(|(z, _)| !z.is_nan()) {
        assert!((z - ideal).abs() <= f32::EPSILON * 16.0, "{z} instead of {ideal}");
        seen += 1;
    }
    assert!(seen > 2000, "{seen}");
    let bytes = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| matched(&block, &json!({"image": "b", "channels": ["pairs"]})).encode().unwrap())
    };
    assert_eq!(bytes(1), bytes(3));
}

#[test]
fn it_says_what_does_not_fit() {
    let base = || block(3, &small_sensor(), &wavy());
    let error = |block: &Block, with: Value| run(block, &TestHost::default(), &with).unwrap_err().message;
    let with = || json!({"image": "b"});
    assert!(error(&base(), json!({"image": "z"})).contains("0 depth maps of image `z`"));
    let mut bad = base();
    bad.pairs.pairs.retain(|pair| pair.name == "a+c");
    assert!(error(&bad, with()).contains("`b` is in none of the 1 pairs"));
    bad = base();
    bad.depths.remove(0);
    assert!(error(&bad, with()).contains("0 depth maps of image `a`, which pair `a+b` needs"));
    bad = base();
    bad.depths.push(bad.depths[2].clone());
    assert!(error(&bad, with()).contains("2 depth maps of image `c`"));
    bad = base();
    bad.noisy.images.pop();
    assert!(error(&bad, with()).contains("no image `c`"));
    bad = base();
    bad.depths[1].z.fill(f32::NAN);
    assert!(error(&bad, with()).contains("none of its 2 pairs gives it a depth"));
    bad = base();
    bad.depths[0].z.fill(f32::NAN);
    let host = TestHost::default();
    assert!(run(&bad, &host, &with()).is_ok());
    assert!(host.warnings()[0].contains("pair `a+b`: the two images have no point in common"));
    let with = json!({"image": "b", "matcher": {"image_share": 0.2}, "noise_sharing": "image"});
    let faults = rockface_core::AnyStage::check(&rockface_core::Row::<MatchImage>::new(), &with).unwrap_err();
    assert_eq!(faults[0].path, ["noise_sharing"]);
}
