//! The chain from face to difference against what is known of it: the truth, and the geometry's own arithmetic.

use rockface_core::artefact::Raster;

use crate::lab::{Bench, Ran};

/// A rough face, its noise-free survey, and the DEM of both.
const NOISE_FREE: &str = "
rockface: 1
seed: 3
steps:
  face: {stage: synthesise-face, with: {width_m: 5, height_m: 4, spacing_m: 0.04}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}, with: {width_px: 900, height_px: 720, focal_px: 2900, distance_m: 20, baseline_m: 7}}
  pairs: {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}}
  left: {stage: project-depth, with: {image: left}, in: {mesh: face.mesh, cameras: survey.cameras}}
  right: {stage: project-depth, with: {image: right}, in: {mesh: face.mesh, cameras: survey.cameras}}
  matched: {stage: match-pair, in: {first: left.depth, second: right.depth, noisy: survey.cameras, pairs: pairs.pairs}, with: {sigma_local_px: 0, sigma_regular_px: 0}}
  surface: {stage: fuse-depth, in: {depth: matched.depth}}
  truth: {stage: rasterise-dem, in: {surface: face.mesh}, with: {method: tin, cell_m: 0.02, window_m: [-1.5, 1.5, -1.2, 1.2]}}
  seen: {stage: rasterise-dem, in: {surface: surface.surface}, with: {method: tin, cell_m: 0.02, window_m: [-1.5, 1.5, -1.2, 1.2]}}
  error: {stage: difference-dem, in: {reference: truth.raster, comparison: seen.raster}}
";

/// A plane at the Hunter Valley station: f 19540 px, baseline 32.6 m, distance 87 m.
const PLANE: &str = "
rockface: 1
seed: 11
params: {method: mean, minimum: 2}
axes:
  epoch: {items: [pre, post]}
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 4, spacing_m: 0.5, relief_m: 0, joints: []}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}, with: {width_px: 880, height_px: 880, focal_px: 19540, distance_m: 87, baseline_m: 32.6}}
  pairs: {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}}
  left: {stage: project-depth, with: {image: left}, in: {mesh: face.mesh, cameras: survey.cameras}}
  right: {stage: project-depth, with: {image: right}, in: {mesh: face.mesh, cameras: survey.cameras}}
  matched: {stage: match-pair, over: [epoch], in: {first: left.depth, second: right.depth, noisy: survey.cameras, pairs: pairs.pairs}, with: {sigma_local_px: 0.7, sigma_regular_px: 0.7, spacing_px: 50}}
  surface: {stage: fuse-depth, in: {depth: matched.depth}}
  dem: {stage: rasterise-dem, in: {surface: surface.surface}, with: {method: '${method}', minimum_points: '${minimum}', cell_m: 0.01, window_m: [-1.7, 1.7, -1.7, 1.7]}}
  change: {stage: difference-dem, in: {reference: 'dem.raster[epoch=pre]', comparison: 'dem.raster[epoch=post]'}}
";

fn values(bench: &Bench, ran: &Ran, label: &str) -> Vec<f64> {
    assert!(!ran.summary.failed, "{:?}", ran.events.last());
    let raster: Raster = ran.value(&bench.store, label, "raster");
    raster.bands[0].values.iter().filter(|v| v.is_finite()).map(|v| f64::from(*v)).collect()
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0)).sqrt()
}

#[test]
fn a_noise_free_survey_leaves_only_sampling_error() {
    let bench = Bench::rocks();
    let ran = bench.run(NOISE_FREE, &[]);
    let errors = values(&bench, &ran, "error");
    assert!(errors.len() > 150 * 120 * 95 / 100, "{} cells", errors.len());
    // Pixels are 6.9 mm apart, mesh vertices 40 mm: away from edges both surfaces are the same planes.
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let (median, p95) = (sizes[sizes.len() / 2], sizes[sizes.len() * 95 / 100]);
    println!("noise-free: median |error| {median:.2e} m, 95 % {p95:.2e} m, deviation {:.2e} m", deviation(&errors));
    assert!(median < 2e-5 && p95 < 2e-3, "median {median}, 95 % {p95}");
}

#[test]
fn the_hunter_valley_plane_has_the_predicted_noise() {
    // Predicted from error propagation: 10.9 mm for cell means, 12.7 mm for a TIN.
    for (method, predicted_m) in [("mean", 0.0109), ("tin", 0.0127)] {
        let bench = Bench::rocks();
        let ran = bench.run(PLANE, &[&format!("params.method={method}")]);
        let found = deviation(&values(&bench, &ran, "change"));
        println!("{method}: deviation {found:.5} m, predicted {predicted_m} m");
        assert!((found / predicted_m - 1.0).abs() < 0.10, "{method}: {found} m, predicted {predicted_m} m");
    }
}

#[test]
fn a_change_of_the_matching_noise_leaves_ideal_depths_alone() {
    let bench = Bench::rocks();
    bench.run(PLANE, &[]);
    let again = bench.run(PLANE, &["steps.matched.with.sigma_local_px=0.5"]);
    let of = |step: &str| format!("{step}[epoch=post]");
    for step in ["matched", "surface", "dem"] {
        assert!(again.executed().contains(&of(step)), "{step} should run: {:?}", again.executed());
    }
    assert_eq!(again.executed().len(), 2 * 3 + 1);
    // A parameter that leaves an output equal: the wave stops there.
    let wave = bench.run(PLANE, &["steps.surface.with.step_factor=40"]);
    assert_eq!(wave.executed(), ["surface[epoch=post]", "surface[epoch=pre]"]);
}

#[test]
fn same_bytes_at_one_and_two_jobs_and_others_from_another_seed() {
    let run = |jobs, set: &[&str]| {
        let bench = Bench::rocks();
        let options = rockface_engine::run::Options { jobs, ..Default::default() };
        bench.run_with(PLANE, set, &options).digests()
    };
    let one = run(1, &[]);
    assert_eq!(one, run(2, &[]));
    let other = run(2, &["seed=12"]);
    let differing =
        one.iter().zip(&other).filter(|(a, b)| a != b).map(|(a, _)| a.split(['[', '.']).next().unwrap_or_default());
    let mut steps: Vec<&str> = differing.collect();
    steps.dedup();
    // A plane without relief gives the same depths from any seed; the noise on them differs.
    steps.retain(|step| *step != "face");
    assert_eq!(steps, ["matched", "surface", "dem", "change"]);
}
