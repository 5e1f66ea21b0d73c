//! The exact isotropic variogram of a raster with gaps: every pair of cells counts, by Fourier transforms.
//!
//! With m the mask, z the centred values and q = z^2: N = corr(m, m) counts the pairs of every lag vector, and
//! S = corr(q, m) + corr(m, q) - 2 corr(z, z) sums their squared differences (Marcotte 1996, Computers & Geosciences
//! 22), so Matheron's estimator is S / 2N. Lag vectors of length h fall into the bin of the nearest whole number of cells.

use crate::noise::sector::Sector;
use rockface_core::numerics::fft::{AlongRows, C64, Fft2, fast_size};

/// The empirical variogram, one entry a lag bin that has pairs.
#[derive(Debug, Clone, PartialEq)]
pub struct Variogram {
    /// Mean length of the lags in the bin, weighted by pairs; cells.
    pub lag_cells: Vec<f64>,
    /// Half the mean squared difference, square of the unit of the values.
    pub gamma: Vec<f64>,
    /// Number of pairs of cells in the bin.
    pub pairs: Vec<f64>,
}

/// The variogram of `columns` columns of values by row (NaN = none) up to `max_lag` cells.
///
/// `mean` and `deviation` are those of the values; they only keep the sums well scaled. Bin k (1 to `max_lag`) takes the
/// lags with `k - 0.5 <= |h| < k + 0.5`.
pub fn variogram(values: &[f32], columns: usize, max_lag: usize, mean: f64, deviation: f64) -> Variogram {
    binned(values, columns, max_lag, [mean, deviation], &|_, _| true)
}

/// The variogram of the lags in the [`Sector`] about a direction, degrees counter-clockwise from the rows' direction.
pub fn directional(values: &[f32], columns: usize, max_lag: usize, moments: [f64; 2], direction_deg: f64) -> Variogram {
    let sector = Sector::about(direction_deg);
    binned(values, columns, max_lag, moments, &|dx, dy| sector.contains(dx, dy))
}

/// The variogram of the lag vectors (columns, rows down) that `takes` says count.
fn binned(
    values: &[f32],
    columns: usize,
    max_lag: usize,
    [mean, deviation]: [f64; 2],
    takes: &(dyn Fn(f64, f64) -> bool + Sync),
) -> Variogram {
    let rows = values.len() / columns;
    let fft = Fft2::new(fast_size(columns + max_lag), fast_size(rows + max_lag));
    let scaled = |v: f32| if v.is_nan() { None } else { Some((f64::from(v) - mean) / deviation) };
    let line = |row: usize| &values[row * columns..(row + 1) * columns];
    let mask_and_value = fft.along_rows(rows, |row, cells| {
        for (cell, value) in cells.iter_mut().zip(line(row)) {
            *cell = scaled(*value).map_or(C64::default(), |z| C64::new(1.0, z));
        }
    });
    let squares = fft.along_real_rows(rows, |row, cells| {
        for (cell, value) in cells.iter_mut().zip(line(row)) {
            *cell = scaled(*value).map_or(0.0, |z| z * z);
        }
    });
    let norm = 1.0 / (fft.columns as f64 * fft.rows as f64);
    let sums = fft.inverse_even(
        max_lag.min(rows - 1) + 1,
        |first, lines| combined(&fft, [&mask_and_value, &squares], first, lines),
        |dy, lags| row_bins(lags, dy, [max_lag, columns], norm, takes),
    );
    let mut bins = vec![[0.0; 3]; max_lag + 1];
    for row in sums {
        bins.iter_mut().zip(row).for_each(|(bin, add)| bin.iter_mut().zip(add).for_each(|(b, a)| *b += a));
    }
    finish(&bins, deviation * deviation)
}

/// Columns of the spectrum of N + i S, from one on, of mask + i values and of the squares.
fn combined(fft: &Fft2, [packed, squares]: [&AlongRows; 2], first: usize, lines: &mut [C64]) {
    let (columns, rows) = (fft.columns, fft.rows);
    squares.columns(first.., lines);
    let [mut here, mut opposite] = [0; 2].map(|_| vec![C64::default(); lines.len()]);
    packed.columns(first.., &mut here);
    packed.columns((first..).map(|kx| (columns - kx) % columns), &mut opposite);
    let packed = here.chunks_exact(rows).zip(opposite.chunks_exact(rows));
    for (line, (here, opposite)) in lines.chunks_exact_mut(rows).zip(packed) {
        for (ky, (cell, here)) in line.iter_mut().zip(here).enumerate() {
            let there = opposite[(rows - ky) % rows].conj();
            let mask = (here + there) * 0.5;
            let value = (here - there) * 0.5;
            *cell = C64::new(mask.norm_sqr(), 2.0 * (*cell * mask.conj()).re - 2.0 * value.norm_sqr());
        }
    }
}

/// Pairs, pairs times lag and squared differences by bin, of all lags with this dy. A pair is counted once: dy > 0, or
/// dy = 0 and dx > 0.
fn row_bins(
    lags: &[C64],
    dy: usize,
    [max_lag, columns]: [usize; 2],
    norm: f64,
    takes: &(dyn Fn(f64, f64) -> bool + Sync),
) -> Vec<[f64; 3]> {
    let mut bins = vec![[0.0; 3]; max_lag + 1];
    let reach = max_lag.min(columns - 1);
    let mut add = |dx: usize, sign: f64, cell: C64| {
        let length = ((dx * dx + dy * dy) as f64).sqrt();
        let bin = (length + 0.5).floor() as usize;
        // Counts are whole numbers; rounding takes away what the transform added.
        let pairs = (cell.re * norm).round();
        if bin <= max_lag && pairs > 0.0 && takes(sign * dx as f64, dy as f64) {
            let [n, nh, s] = &mut bins[bin];
            *n += pairs;
            *nh += pairs * length;
            *s += cell.im * norm;
        }
    };
    for dx in 0..=reach {
        if dx > 0 {
            add(dx, 1.0, lags[dx]);
        }
        if dx > 0 && dy > 0 {
            add(dx, -1.0, lags[lags.len() - dx]);
        } else if dy > 0 {
            add(0, 1.0, lags[0]);
        }
    }
    bins
}

fn finish(bins: &[[f64; 3]], variance: f64) -> Variogram {
    let mut found = Variogram { lag_cells: Vec::new(), gamma: Vec::new(), pairs: Vec::new() };
    for [n, nh, s] in bins.iter().skip(1).filter(|bin| bin[0] > 0.0) {
        found.lag_cells.push(nh / n);
        found.gamma.push((s / (2.0 * n)).max(0.0) * variance);
        found.pairs.push(*n);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rockface_core::numerics::random::Key;

    fn brute_force(values: &[f32], columns: usize, max_lag: usize) -> Variogram {
        let mut bins = vec![[0.0; 3]; max_lag + 1];
        for (i, a) in values.iter().enumerate() {
            for (j, b) in values.iter().enumerate().skip(i + 1) {
                let (dy, dx) = ((j / columns).abs_diff(i / columns), (j % columns).abs_diff(i % columns));
                let length = ((dx * dx + dy * dy) as f64).sqrt();
                let bin = (length + 0.5).floor() as usize;
                if bin <= max_lag && !a.is_nan() && !b.is_nan() {
                    let d = f64::from(*a) - f64::from(*b);
                    bins[bin] = [bins[bin][0] + 1.0, bins[bin][1] + length, bins[bin][2] + d * d];
                }
            }
        }
        finish(&bins, 1.0)
    }

    fn compare(values: &[f32], columns: usize, max_lag: usize) {
        let fast = variogram(values, columns, max_lag, 0.3, 1.7);
        let slow = brute_force(values, columns, max_lag);
        assert_eq!(fast.pairs, slow.pairs);
        for i in 0..slow.gamma.len() {
            assert!((fast.lag_cells[i] - slow.lag_cells[i]).abs() <= 1e-12 * slow.lag_cells[i]);
            assert!((fast.gamma[i] - slow.gamma[i]).abs() <= 1e-12 * slow.gamma[i].max(1.0));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn equals_the_sum_over_all_pairs(columns in 1usize..23, rows in 1usize..23, max_lag in 1usize..20, seed: u8) {
            let field = Key([seed; 32]).field();
            let gap = |i: usize| field.words(i as i32, 9)[0].is_multiple_of(5);
            let value = |i: usize| if gap(i) { f32::NAN } else { field.normal(i as i32, 0) as f32 };
            let values: Vec<f32> = (0..columns * rows).map(value).collect();
            compare(&values, columns, max_lag);
        }
    }

    #[test]
    fn a_ramp_has_its_variogram_along_itself_and_sectors_share_the_pairs() {
        // Rises by 1 a column and by 1 a row upwards: steepest at 45 degrees.
        let ramp: Vec<f32> = (0..900).map(|i| (i % 30) as f32 - (i / 30) as f32).collect();
        let along = directional(&ramp, 30, 8, [0.0, 1.0], 45.0);
        let across = directional(&ramp, 30, 8, [0.0, 1.0], 135.0);
        assert!(along.gamma[7] > 8.0 * across.gamma[7], "{} {}", along.gamma[7], across.gamma[7]);
        let all = variogram(&ramp, 30, 8, 0.0, 1.0);
        let sectors = [0.0, 45.0, 90.0, 135.0].map(|deg| directional(&ramp, 30, 8, [0.0, 1.0], deg));
        let pairs = |v: &Variogram| v.pairs.iter().sum::<f64>();
        assert!((sectors.iter().map(pairs).sum::<f64>() - pairs(&all)).abs() < 0.5);
    }

    #[test]
    fn white_noise_is_flat_and_a_ramp_is_a_parabola() {
        let field = Key([5; 32]).field();
        let noise: Vec<f32> = (0..10_000).map(|i| field.normal(i % 100, i / 100) as f32).collect();
        let flat = variogram(&noise, 100, 20, 0.0, 1.0);
        assert!(flat.gamma.iter().all(|g| (g - 1.0).abs() < 0.04), "{:?}", flat.gamma);
        let ramp: Vec<f32> = (0..400).map(|i| (i % 20) as f32).collect();
        compare(&ramp, 20, 6);
    }
}
