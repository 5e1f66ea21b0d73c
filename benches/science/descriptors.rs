//! The ten descriptors of a raster with gaps, and the exact variogram of a smaller one pair by pair by scikit-gstat.

use rockface_analysis::noise::descriptors::{Settings, describe};
use rockface_analysis::noise::detrend::Detrend;
use rockface_analysis::noise::robust_variogram::Estimator;
use rockface_analysis::noise::variogram::variogram;
use rockface_analysis::noise::variogram_model::Shape;
use rockface_core::artefact::Grid;
use rockface_core::numerics::random::Key;

use crate::measure;
use crate::peer::{Peer, check};
use crate::row::Row;

/// Standard deviation of the noise, metres.
const NOISE_M: f64 = 0.01;

/// Measures and prints the row of all descriptors: variogram exact to 600 cells' lag, spectrum, roughness at six scales.
pub fn measure() {
    let [columns, rows] = [3560, 2900];
    let grid = Grid { columns, rows, cell_m: 0.01, left_m: 0.0, top_m: 0.0 };
    let values = noise(columns, rows);
    let describe = || describe(&values, &grid, &settings()).expect("the raster can be described");
    let (found, cost) = measure::measure(describe);
    let what = format!("ten descriptors, {columns} x {rows} cells with gaps, {} lags", found.lags_m.len());
    Row { what: &what, cost, peer: None, check: "" }.print();
}

/// Measures and prints the row of the variogram.
pub fn measure_variogram() {
    let ([columns, rows], longest) = ([300, 300], 20);
    let values = noise(columns, rows);
    let (found, cost) = measure::measure(|| variogram(&values, columns, longest, 0.0, NOISE_M));
    let peer = Peer::new();
    peer.give("values.f4", &values);
    peer.give("size.u4", &[columns as u32, longest as u32]);
    let answer = peer.work("variogram", &[]);
    let check = check(&answer, |_| {
        let theirs = peer.take::<f64>("gamma.f8");
        assert_eq!(found.gamma.len(), theirs.len());
        let apart = found.gamma.iter().zip(&theirs).map(|(a, b)| (a / b - 1.0).abs());
        format!("greatest difference {:.0e} of the value, {longest} bins", apart.fold(0.0, f64::max))
    });
    let pairs = found.pairs.iter().sum::<f64>() / 1e6;
    let what = format!("exact variogram, {columns} x {rows} cells with gaps, {pairs:.0} M pairs");
    Row { what: &what, cost, peer: Some(&answer), check: &check }.print();
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
    let value = |x: i32, y: i32| if gap(x, y) { f32::NAN } else { (NOISE_M * field.normal(x, y)) as f32 };
    (0..rows as i32).flat_map(|y| (0..columns as i32).map(move |x| (x, y))).map(|(x, y)| value(x, y)).collect()
}
