//! Bursts of the fine details of a field of noise, which mixing evens out.
//!
//! The details (what a Gaussian takes away) are multiplied by a log-normal random field with a correlation over about a cell, whose mean square
//! is 1. Coarser noise stays as it is, so that the tails of the values hardly grow.

use rockface_core::artefact::Bursts;
use rockface_core::numerics::gaussian::{half_kernel, smoothed};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Field;

/// A field without gaps whose details burst; `log_variance` is the variance of the logarithm of the factor at a cell.
pub fn with_bursts(
    mut field: Vec<f64>,
    columns: usize,
    bursts: &Bursts,
    log_variance: impl Fn(usize) -> f64,
    random: &Field,
) -> Vec<f64> {
    if bursts.log_variance.iter().all(|variance| *variance <= 0.0) {
        return field;
    }
    let narrow: Vec<f32> = field.iter().map(|value| *value as f32).collect();
    let smooth = smoothed(&narrow, columns, bursts.details_cells);
    let unit = unit_field(random, columns, field.len() / columns, bursts.length_cells);
    for (cell, value) in field.iter_mut().enumerate() {
        let variance = log_variance(cell);
        let factor = portable_math::exp(variance.sqrt() * unit[cell] - variance);
        *value = smooth[cell] + (*value - smooth[cell]) * factor;
    }
    field
}

/// White noise under a Gaussian of some cells, of unit variance but near the edges.
fn unit_field(random: &Field, columns: usize, rows: usize, cells: f64) -> Vec<f64> {
    let mut white = vec![0.0f32; columns * rows];
    white.chunks_mut(columns).enumerate().for_each(|(row, line)| random.fill_row(0, row as i32, line));
    let kernel = half_kernel(cells);
    let variance = kernel[0] * kernel[0] + 2.0 * kernel[1..].iter().map(|weight| weight * weight).sum::<f64>();
    smoothed(&white, columns, cells).into_iter().map(|value| value / variance).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    #[allow(clippy::float_cmp)] // to the bit
    fn details_burst_and_keep_their_variance_and_coarse_waves_stay() {
        let (columns, rows) = (160, 120);
        let random = Key([7; 32]).field();
        let fine: Vec<f64> =
            (0..columns * rows).map(|i| random.normal((i % columns) as i32, (i / columns) as i32)).collect();
        let of = |field: Vec<f64>, variance: f64| {
            let bursts = Bursts { log_variance: vec![variance], ..Bursts::none(1) };
            with_bursts(field, columns, &bursts, |_| variance, &Key([8; 32]).field())
        };
        let moments = |field: &[f64]| {
            let mean = |of: fn(f64) -> f64| field.iter().map(|v| of(v * v)).sum::<f64>() / field.len() as f64;
            let (second, fourth) = (mean(|square| square), mean(|square| square * square));
            (second, fourth / (second * second))
        };
        assert_eq!(of(fine.clone(), 0.0), fine);
        // The fourth moment of a log-normal factor of mean square 1 is exp(4 variance): 2.7.
        let ((before, _), (after, kurtosis)) = (moments(&fine), moments(&of(fine.clone(), 0.25)));
        assert!((after / before - 1.0).abs() < 0.1 && (5.0..9.0).contains(&kurtosis), "{after} {before} {kurtosis}");
        let coarse = |field: &[f64]| smoothed(&field.iter().map(|v| *v as f32).collect::<Vec<_>>(), columns, 6.0);
        let wave = |i: usize| portable_math::sin((i % columns) as f64 / 20.0);
        let both: Vec<f64> = fine.iter().enumerate().map(|(i, fine)| wave(i) + 0.1 * fine).collect();
        let changes = coarse(&both).into_iter().zip(coarse(&of(both, 0.25))).map(|(a, b)| (a - b).abs());
        assert!(changes.fold(0.0, f64::max) < 0.02);
    }
}
