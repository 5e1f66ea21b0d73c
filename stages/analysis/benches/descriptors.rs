//! Cost of all descriptors of rasters with gaps: `cargo bench -p rockface-stages --bench descriptors`.
//!
//! A raster of 3560 x 2900 cells (variogram exact to 600 cells' lag, spectrum, roughness at six scales) should take less
//! than 6 s with two threads.

use std::time::Instant;

use rockface_analysis::noise::descriptors::{Settings, describe};
use rockface_analysis::noise::detrend::Detrend;
use rockface_analysis::noise::robust_variogram::Estimator;
use rockface_analysis::noise::variogram_model::Shape;
use rockface_core::artefact::Grid;
use rockface_core::numerics::random::Key;

fn main() {
    for [columns, rows] in [[630, 560], [800, 800], [3560, 2900]] {
        let grid = Grid { columns, rows, cell_m: 0.01, left_m: 0.0, top_m: 0.0 };
        let values = noise(columns, rows);
        let clock = Instant::now();
        let found = describe(&values, &grid, &settings()).expect("the raster can be described");
        println!("{columns} x {rows}: {:.2?}, {} lags", clock.elapsed(), found.lags_m.len());
    }
}

fn settings() -> Settings {
    Settings {
        max_lag_cells: None,
        shape: Shape::Exponential,
        estimator: Estimator::Matheron,
        detrend: Detrend::Mean,
        directions_deg: Vec::new(),
        scales_cells: vec![1.0, 2.0, 4.0, 8.0, 16.0, 32.0],
    }
}

/// White noise with a tenth of the cells missing in blocks.
fn noise(columns: usize, rows: usize) -> Vec<f32> {
    let field = Key([1; 32]).field();
    let gap = |x: i32, y: i32| field.words(x / 37, y / 41)[2].is_multiple_of(10);
    let value = |x: i32, y: i32| if gap(x, y) { f32::NAN } else { 0.01 * field.normal(x, y) as f32 };
    (0..rows as i32).flat_map(|y| (0..columns as i32).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect()
}
