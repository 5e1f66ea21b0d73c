//! Surveys that cannot be: every fault is told by the step that meets it, with the values and a way out; and one block that is
//! the same for any number of jobs and however little memory there is.

use rockface_core::artefact::Raster;
use rockface_engine::run::Options;
use rockface_engine::watch::Event;
use serde_json::{Value, json};

use crate::lab::Bench;

const PAIR: &str = "
rockface: 1
seed: 1
steps:
  face:    {stage: synthesise-face, with: {width_m: 8, height_m: 5, spacing_m: 0.1}}
  survey:  {stage: import-cameras, with: {path: cameras.json}}
  pairs:   {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}}
  left:    {stage: project-depth, in: {mesh: face.mesh, cameras: survey.cameras}, with: {image: left}}
  right:   {stage: project-depth, in: {mesh: face.mesh, cameras: survey.cameras}, with: {image: right}}
  adjust:  {stage: estimate-covariance, in: {cameras: survey.cameras, mesh: face.mesh}, with: {tie_points: 50, control_points: 4}}
  noisy:   {stage: perturb-cameras, in: {cameras: survey.cameras, covariance: adjust.covariance}}
  matched: {stage: match-pair, in: {first: left.depth, second: right.depth, noisy: noisy.cameras, pairs: pairs.pairs}}
  cells:   {stage: grid-depth, in: {depth: matched.depth}, with: {cell_m: 0.05, sigma_m: 0.02}}
  block:   {stage: fuse-grids, in: {grids: cells.grid}, with: {min_images: 1}}
  volume:  {stage: fuse-volume, in: {depths: matched.depth}, with: {voxel_m: 0.05, min_images: 1}}
";

/// Two cameras at X = -x and x, Z = z, that look along -Z, with a radial distortion.
fn cameras(x: f64, z: f64, k1: f64) -> Value {
    let image = |name: &str, x: f64| json!({"name": name, "sensor": 0, "camera_from_object": [0.0, 1.0, 0.0, 0.0], "centre_m": [x, 0.0, z]});
    let sensor = json!({"name": "c", "width_px": 160, "height_px": 120, "f": 130.0, "cx": 79.5, "cy": 59.5, "b1": 0.0,
        "b2": 0.0, "k": [k1, 0.0, 0.0, 0.0], "p": [0.0, 0.0]});
    json!({"frame": "wall", "sensors": [sensor], "images": [image("left", -x), image("right", x)]})
}

/// What failed: step, message and hint.
fn failures(cameras: &Value, set: &[&str]) -> Vec<(String, String)> {
    let bench = Bench::rocks();
    std::fs::write(bench.folder.path().join("cameras.json"), cameras.to_string()).unwrap();
    let ran = bench.run_with(PAIR, set, &Options { jobs: 2, keep_going: true, ..Options::default() });
    let told = |event: &Event| match event {
        Event::Failed { step, message, hint, .. } => {
            Some((step.clone(), format!("{message}; {}", hint.as_deref().expect(message))))
        }
        _ => None,
    };
    ran.events.iter().filter_map(told).collect()
}

fn check(cameras: &Value, set: &[&str], step: &str, pieces: &[&str]) {
    let failures = failures(cameras, set);
    let said = failures.iter().find(|(failed, _)| failed == step);
    let (_, said) = said.unwrap_or_else(|| panic!("`{step}` did not fail: {failures:?}"));
    for piece in pieces {
        assert!(said.contains(piece), "missing `{piece}` in: {said}");
    }
}

#[test]
fn cameras_behind_the_face() {
    check(&cameras(1.0, -10.0, 0.0), &[], "left", &["image `left` sees nothing", "behind the camera"]);
    check(&cameras(1.0, -10.0, 0.0), &[], "pairs", &["no two of 2 images", "check frames"]);
}

#[test]
fn a_pair_without_overlap() {
    let list = "steps.pairs.with={list: [left+right]}";
    check(
        &cameras(3.5, 4.0, 0.0),
        &[list],
        "pairs",
        &["`left+right` is no stereo pair", "no part of the face is in both"],
    );
}

#[test]
fn a_covariance_that_is_not_determined() {
    let free = "steps.adjust.with.control_points=0";
    check(
        &cameras(1.0, 10.0, 0.0),
        &[free],
        "adjust",
        &["not determined", "7 of the block as a whole", "`control_points`"],
    );
}

#[test]
fn distortion_that_folds_back() {
    // What lies before the fold is surveyed, with a warning; here it is all of the outline that does not.
    assert_eq!(failures(&cameras(1.0, 10.0, -2.5), &[]), []);
    let bench = Bench::rocks();
    std::fs::write(bench.folder.path().join("cameras.json"), cameras(1.0, 10.0, -2.5).to_string()).unwrap();
    let ran = bench.run(PAIR, &[]);
    let warned = |event: &Event| matches!(event, Event::Warning { text, .. } if text.contains("folds back before 4 of its 4 corners"));
    assert!(ran.events.iter().any(warned));
}

#[test]
fn images_that_see_nothing_of_the_window() {
    let window = "steps.cells.with.window_m=[50, 60, 0, 5]";
    check(&cameras(1.0, 10.0, 0.0), &[window], "block", &["none of 1 grids has a value", "`window_m`"]);
    let window = "steps.volume.with.window_m=[50, 60, 0, 5]";
    check(&cameras(1.0, 10.0, 0.0), &[window], "volume", &["none of 1 depth maps has a depth in the window"]);
}

/// Five images in a row, three of whose pairs each are matched; everything but the surface is let go.
const BLOCK: &str = "
rockface: 1
seed: 5
axes:
  image: {from: survey.cameras, reseeds: false}
steps:
  face:    {stage: synthesise-face, with: {width_m: 10, height_m: 5, spacing_m: 0.05}}
  survey:  {stage: plan-survey, in: {mesh: face.mesh}, with: {block: strips, width_px: 160, height_px: 120, focal_px: 130, distance_m: 8, columns: 5, rows: 1}}
  pairs:   {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}, with: {neighbours: 3}}
  noisy:   {stage: perturb-cameras, in: {cameras: survey.cameras}, with: {model: independent, independent: {position_m: [0.001, 0.001, 0.001]}}}
  seen:    {stage: project-depth, keep: false, with: {image: '${image}'}, in: {mesh: face.mesh, cameras: survey.cameras}}
  matched: {stage: match-image, keep: false, with: {image: '${image}', sigma_local_px: 0.05, sigma_regular_px: 0.05, spacing_px: 12}, in: {depths: {each: seen.depth, over: [image]}, noisy: noisy.cameras, pairs: pairs.pairs}}
  cells:   {stage: grid-depth, keep: false, with: {cell_m: 0.1}, in: {depth: matched.depth}}
  surface: {stage: fuse-grids, in: {grids: {each: cells.grid, over: [image]}}}
  volume:  {stage: fuse-volume, with: {voxel_m: 0.05}, in: {depths: {each: matched.depth, over: [image]}}}
  solid:   {stage: rasterise-dem, with: {cell_m: 0.1, method: tin}, in: {surface: volume.mesh, grid: surface.raster}}
";

#[test]
fn two_ways_to_fuse_agree() {
    let bench = Bench::rocks();
    let ran = bench.run(BLOCK, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events.last());
    let band = |label: &str| ran.value::<Raster>(&bench.store, label, "raster").bands.swap_remove(0).values;
    let pairs = band("surface").into_iter().zip(band("solid"));
    let mut apart: Vec<f32> = pairs.map(|(one, other)| (one - other).abs()).filter(|d| d.is_finite()).collect();
    apart.sort_by(f32::total_cmp);
    assert!(apart.len() > 1500, "{} cells", apart.len());
    // A pixel of disparity is worth 0.3 m, the noise 2 cm in each image; at steps a cell holds both sides.
    let (half, most) = (apart[apart.len() / 2], apart[apart.len() * 9 / 10]);
    assert!(half < 0.015 && most < 0.1, "{half} m, {most} m");
}

#[test]
fn a_block_is_the_same_for_any_jobs_and_memory() {
    let digests = |jobs: usize, memory_bytes: usize| {
        let ran = Bench::rocks().run_with(BLOCK, &[], &Options { jobs, memory_bytes, ..Options::default() });
        assert!(!ran.summary.failed, "{:?}", ran.events.last());
        assert!(ran.warnings().is_empty(), "{:?}", ran.warnings());
        ran.digests()
    };
    let whole = digests(1, 1 << 32);
    assert_eq!(digests(3, 1 << 32), whole);
    // With next to no memory every depth map goes through the store.
    assert_eq!(digests(2, 1 << 10), whole);
}
