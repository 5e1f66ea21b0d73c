//! Draws have the strength of the model, and gaps where the DEM has them.

use serde_json::json;

use super::*;
use crate::noise::learn_noise::tests::{CLEAN, COLUMNS, ROWS, grid, survey};
use rockface_core::artefact::{Artefact, Frame, Noun};
use rockface_core::testing::{TestHost, run_stage, small_sensor};

fn drawn(seed: u64, dem: &Raster) -> Result<Raster, StageError> {
    let (cameras, pairs) = survey();
    let inputs = [
        ("noise", Artefact::Noise(CLEAN.clone())),
        ("dem", dem.clone().into()),
        ("cameras", cameras.into()),
        ("pairs", pairs.into()),
    ];
    let outputs = run_stage::<DrawNoise>(&TestHost::seeded(seed), &json!({}), &inputs)?.into_inner();
    Ok(Raster::of(&outputs["raster"]).unwrap().clone())
}

fn flat() -> Raster {
    Raster::single(grid(), Frame::Wall, "elevation", "dem", vec![0.0; COLUMNS * ROWS])
}

#[test]
fn the_difference_of_two_draws_has_the_strength_of_the_model() {
    let step_m = 20.0 * 20.0 / (small_sensor().f * 2.0);
    let (mut squares, mut wanted) = (0.0, 0.0);
    for number in 0..20 {
        let [pre, post] = [0, 1].map(|epoch| drawn(2 * number + epoch, &flat()).unwrap());
        let cells = pre.bands[0].values.iter().zip(&post.bands[0].values).zip(&CLEAN.strength);
        for ((pre, post), strength_px) in cells.filter(|((pre, post), _)| !(*pre - *post).is_nan()) {
            let difference_px = f64::from(post - pre) / step_m;
            squares += difference_px * difference_px;
            wanted += f64::from(*strength_px) * f64::from(*strength_px);
        }
    }
    let ratio = (squares / wanted).sqrt();
    assert!((0.85..1.15).contains(&ratio), "{ratio}");
}

#[test]
fn a_draw_keeps_the_elevations_and_the_gaps_of_the_dem() {
    let mut dem = flat();
    dem.bands[0].values.iter_mut().for_each(|z| *z = 3.0);
    dem.bands[0].values[7] = f32::NAN;
    let raster = drawn(1, &dem).unwrap();
    assert!(raster.bands[0].values[7].is_nan() && raster.quantity == "elevation");
    let known: Vec<f64> = raster.bands[0].values.iter().filter(|z| !z.is_nan()).map(|z| f64::from(*z)).collect();
    assert!((known.iter().sum::<f64>() / known.len() as f64 - 3.0).abs() < 0.01);
}

#[test]
fn a_model_of_another_grid_is_refused() {
    let mut dem = flat();
    dem.grid.left_m += 1.0;
    assert!(drawn(1, &dem).unwrap_err().message.contains("not those of `dem`"));
}
