//! Detection against exact ground truth: nothing is missed without noise, and thresholds cost volume with it.

use rockface_core::artefact::{Inventory, Table};

use crate::lab::{Bench, Ran};

/// Blocks out of a smooth face, where no niche hides behind what is left, its exact elevations before and after on 1 cm, and what a
/// difference of them shows.
const EXACT: &str = "
rockface: 1
seed: 5
steps:
  face:   {stage: synthesise-face, with: {width_m: 5, height_m: 4, spacing_m: 0.04, relief_m: 0, joints: [], roughness_m: 0.004}}
  blocks: {stage: generate-blocks, with: {classes: [{name: slab, shape: prism, size: {volume: {volume_m3: {power_law: {exponent: 0.6, min: 0.01, max: 0.1}}, depth_ratio: 0.4}}}]}}
  zone:   {stage: mask-safe-zone, with: {offset_m: 0.3}, in: {mesh: face.mesh}}
  fallen: {stage: remove-blocks, in: {mesh: face.mesh, blocks: blocks.blocks, zone: zone.zone}, with: {count: 12, min_depth_m: 0.03, overlap_buffer_m: 0.06, cell_m: 0.01, direction: z}}
  before: {stage: rasterise-dem, with: {cell_m: 0.01, method: tin, window_m: [-2.4, 2.4, -1.9, 1.9]}, in: {surface: face.mesh}}
  after:  {stage: rasterise-dem, with: {method: tin}, in: {surface: fallen.mesh, grid: before.raster}}
  change: {stage: difference-dem, in: {reference: before.raster, comparison: after.raster}}
  found:  {stage: detect-raster, with: {lod: {fixed: {lod_m: 0.0005}}, min_width_m: 0, min_area_m2: 0}, in: {difference: change.raster, reference: before.raster}}
  coarse: {stage: detect-raster, with: {lod: {fixed: {lod_m: 0.03}}, min_width_m: 0.04}, in: {difference: change.raster, reference: before.raster}}
  score:  {stage: score-detections, in: {truth: fallen.truth, detections: found.detections, grid: change.raster}}
  cut:    {stage: score-detections, in: {truth: fallen.truth, detections: coarse.detections, grid: change.raster}}
  cloud:  {stage: detect-voxels, with: {voxel_m: 0.01}, in: {reference: before.raster, comparison: after.raster}}
  boxed:  {stage: score-detections, in: {truth: fallen.truth, detections: cloud.detections, grid: change.raster}}
";

fn number(bench: &Bench, ran: &Ran, step: &str, name: &str) -> f64 {
    let table: Table = ran.value(&bench.store, step, "summary");
    table.rows[0][table.column(name).unwrap_or_else(|| panic!("no column {name}"))].number().unwrap_or(f64::NAN)
}

#[test]
fn without_noise_all_is_found_with_its_volume() {
    let bench = Bench::rocks();
    let ran = bench.run(EXACT, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events.last());
    let of = |step: &str, name: &str| number(&bench, &ran, step, name);
    assert!(of("score", "truths") >= 12.0);
    let expected = [of("score", "recall"), of("score", "precision"), of("score", "recall_1to1")];
    assert!(expected.iter().all(|share| (share - 1.0).abs() < 1e-12), "{expected:?}");
    let error = of("score", "volume_error_mean_abs");
    assert!(error < 0.02, "mean |volume error| {error}");
    let truth: Inventory = ran.value(&bench.store, "score", "truth");
    let overlap: Vec<f64> = truth.numbers("iou").unwrap().into_iter().flatten().collect();
    assert!(overlap.iter().all(|iou| *iou > 0.9), "{overlap:?}");
    // Voxels of a centimetre find them too, and no false ones.
    assert!((of("boxed", "recall") - 1.0).abs() < 1e-12 && (of("boxed", "precision") - 1.0).abs() < 1e-12);
}

#[test]
fn a_threshold_takes_volume_away_from_every_change() {
    let bench = Bench::rocks();
    let ran = bench.run(EXACT, &[]);
    let error = number(&bench, &ran, "cut", "volume_error_median");
    assert!((-0.5..0.0).contains(&error), "{error}");
    assert!((number(&bench, &ran, "cut", "precision") - 1.0).abs() < 1e-12);
}

/// Two surveys of an event, and blocks made of what they show, taken out again.
const REPLICA: &str = "
rockface: 1
seed: 5
steps:
  face:   {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.05, roughness_m: 0}}
  blocks: {stage: generate-blocks, with: {classes: [{name: slab, shape: prism, size: {volume: {volume_m3: 0.02, depth_ratio: 0.4}}, align: normal}]}}
  zone:   {stage: mask-safe-zone, with: {offset_m: 0.3}, in: {mesh: face.mesh}}
  fallen: {stage: remove-blocks, in: {mesh: face.mesh, blocks: blocks.blocks, zone: zone.zone}, with: {count: 4, min_depth_m: 0.05, overlap_buffer_m: 0.1, cell_m: 0.02}}
  before: {stage: rasterise-dem, with: {cell_m: 0.02, method: tin, window_m: [-1.9, 1.9, -1.4, 1.4]}, in: {surface: face.mesh}}
  after:  {stage: rasterise-dem, with: {method: tin}, in: {surface: fallen.mesh, grid: before.raster}}
  change: {stage: difference-dem, in: {reference: before.raster, comparison: after.raster}}
  found:  {stage: detect-raster, with: {lod: {fixed: {lod_m: 0.005}}}, in: {difference: change.raster, reference: before.raster}}
  copies: {stage: reconstruct-blocks, in: {detections: found.detections, reference: before.raster, comparison: after.raster}}
  again:  {stage: remove-blocks, with: {direction: z, cell_m: 0.02}, in: {mesh: face.mesh, blocks: copies.blocks}}
  score:  {stage: score-detections, in: {truth: again.truth, detections: found.detections, grid: change.raster}}
";

#[test]
fn an_event_is_replicated_from_what_was_seen_of_it() {
    let bench = Bench::rocks();
    let ran = bench.run(REPLICA, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events.last());
    let of = |name: &str| number(&bench, &ran, "score", name);
    assert!(of("truths") >= 4.0 && (of("recall") - 1.0).abs() < 1e-12, "{} {}", of("truths"), of("recall"));
    assert!(
        of("volume_error_mean_abs") < 0.15 && of("iou_mean") > 0.9,
        "{} {}",
        of("volume_error_mean_abs"),
        of("iou_mean")
    );
}
