//! Scale-dependent roughness: what a Gaussian filter takes away, over its width (paper 2.2.4, equations 13 and 14).

use rayon::prelude::*;

use super::line::{Line, fit_line};
use super::precise;

/// Roughness over smoothing scales.
#[derive(Debug, Clone, PartialEq)]
pub struct Roughness {
    /// Standard deviations of the filter, in the unit of the cell size (m).
    pub sigma: Vec<f64>,
    /// Root mean square of values minus smoothed values, over the cells with a value; unit of the values.
    pub rms: Vec<f64>,
}

impl Roughness {
    /// Line `ln R = a + b ln sigma`; `None` for fewer than two scales or a roughness of 0.
    pub fn power_law(&self) -> Option<Line> {
        let points: Vec<_> =
            self.sigma.iter().zip(&self.rms).map(|(s, r)| (precise::log(*s), precise::log(*r))).collect();
        if points.iter().all(|(x, y)| x.is_finite() && y.is_finite()) { fit_line(&points) } else { None }
    }

    /// ln R of the fitted line at the geometric mean of the scales: the intercept where the data are.
    pub fn reference_intercept(&self, line: &Line) -> f64 {
        let mean = self.sigma.iter().map(|s| precise::log(*s)).sum::<f64>() / self.sigma.len() as f64;
        line.intercept + line.slope * mean
    }
}

/// Where the filter is cut off, in standard deviations.
const TRUNCATION: f64 = 4.0;

/// Roughness of `columns` columns of values by row (NaN = none), for filters of `scales_cells` cells; `cell` is the side
/// of a cell. Gaps and what lies beyond the edge have no weight (normalised convolution). `mean` only centres the values.
pub fn roughness(values: &[f32], columns: usize, cell: f64, scales_cells: &[f64], mean: f64) -> Roughness {
    let centred: Vec<f64> = values.iter().map(|v| if v.is_nan() { 0.0 } else { f64::from(*v) - mean }).collect();
    let mask: Vec<f64> = values.iter().map(|v| if v.is_nan() { 0.0 } else { 1.0 }).collect();
    let rms = scales_cells.iter().map(|scale| residual(&centred, &mask, columns, *scale)).collect();
    Roughness { sigma: scales_cells.iter().map(|scale| scale * cell).collect(), rms }
}

/// The values under a Gaussian of `scale` cells, gaps without weight; 0 where nothing is in reach.
pub fn smoothed(values: &[f32], columns: usize, scale: f64) -> Vec<f64> {
    let filled: Vec<f64> = values.iter().map(|v| if v.is_nan() { 0.0 } else { f64::from(*v) }).collect();
    let mask: Vec<f64> = values.iter().map(|v| if v.is_nan() { 0.0 } else { 1.0 }).collect();
    let (sums, weights) = convolved(&filled, &mask, columns, scale);
    sums.iter().zip(weights).map(|(sum, weight)| if weight > 0.0 { sum / weight } else { 0.0 }).collect()
}

/// A field and its mask under a Gaussian of `scale` cells.
fn convolved(field: &[f64], mask: &[f64], columns: usize, scale: f64) -> (Vec<f64>, Vec<f64>) {
    let rows = field.len() / columns;
    let kernel = half_kernel(scale);
    let smooth = |field: &[f64]| filter_rows(&filter_rows(field, columns, &kernel), rows, &kernel);
    rayon::join(|| smooth(field), || smooth(mask))
}

fn residual(centred: &[f64], mask: &[f64], columns: usize, scale: f64) -> f64 {
    let rows = centred.len() / columns;
    let (sums, weights) = convolved(centred, mask, columns, scale);
    let of_row = |row: usize| {
        let cells = row * columns..(row + 1) * columns;
        let mut total = (0.0, 0.0);
        for i in cells.filter(|i| mask[*i] > 0.0) {
            let d = centred[i] - sums[i] / weights[i];
            total = (total.0 + d * d, total.1 + 1.0);
        }
        total
    };
    let lines: Vec<(f64, f64)> = (0..rows).into_par_iter().map(of_row).collect();
    let (squares, count) = lines.iter().fold((0.0, 0.0), |(s, n), line| (s + line.0, n + line.1));
    (squares / count).sqrt()
}

/// Weights at distances 0, 1, 2, ... cells; over both sides they add up to 1.
fn half_kernel(scale: f64) -> Vec<f64> {
    let radius = (TRUNCATION * scale + 0.5).floor() as usize;
    let weight = |k: usize| precise::exp(-0.5 * (k as f64 / scale) * (k as f64 / scale));
    let kernel: Vec<f64> = (0..=radius).map(weight).collect();
    let total = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
    kernel.iter().map(|w| w / total).collect()
}

/// Outputs computed together, so that their sums stay in registers.
const LANES: usize = 8;

/// Filters each row of `columns` cells, with zeros beyond its ends, and returns the result transposed.
fn filter_rows(field: &[f64], columns: usize, kernel: &[f64]) -> Vec<f64> {
    let radius = kernel.len() - 1;
    let mut lines = vec![0.0; field.len()];
    lines.par_chunks_mut(columns).zip(field.par_chunks(columns)).for_each(|(out, line)| {
        let mut padded = vec![0.0; columns + 2 * radius + LANES];
        padded[radius..radius + columns].copy_from_slice(line);
        for (block, out) in out.chunks_mut(LANES).enumerate() {
            let sums = convolve(&padded[block * LANES..], kernel);
            out.copy_from_slice(&sums[..out.len()]);
        }
    });
    transpose(&lines, columns)
}

/// Rows become columns; eight at a time, so that reading stays within cache lines.
fn transpose(field: &[f64], columns: usize) -> Vec<f64> {
    let rows = field.len() / columns;
    let mut transposed = vec![0.0; field.len()];
    transposed.par_chunks_mut(rows * LANES).enumerate().for_each(|(block, lines)| {
        let count = lines.len() / rows;
        for (row, cells) in field.chunks_exact(columns).enumerate() {
            for (lane, cell) in cells[block * LANES..block * LANES + count].iter().enumerate() {
                lines[lane * rows + row] = *cell;
            }
        }
    });
    transposed
}

/// Eight neighbouring outputs; the first one's centre is `input[kernel.len() - 1]`.
fn convolve(input: &[f64], kernel: &[f64]) -> [f64; LANES] {
    let radius = kernel.len() - 1;
    let mut sums = [0.0; LANES];
    for lane in 0..LANES {
        sums[lane] = kernel[0] * input[radius + lane];
    }
    for (k, weight) in kernel.iter().enumerate().skip(1) {
        let (left, right) = (&input[radius - k..][..LANES], &input[radius + k..][..LANES]);
        for lane in 0..LANES {
            sums[lane] += weight * (left[lane] + right[lane]);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::random::Key;

    #[test]
    fn equals_the_definition_on_a_field_with_gaps() {
        let (columns, rows, scale) = (13, 9, 1.5);
        let field = Key([4; 32]).field();
        let gap = |i: usize| field.words(i as i32, 1)[0].is_multiple_of(4);
        let values: Vec<f32> =
            (0..columns * rows).map(|i| if gap(i) { f32::NAN } else { field.normal(i as i32, 0) as f32 }).collect();
        let weight = |a: usize, b: usize| {
            let d = a.abs_diff(b);
            if d > 6 { 0.0 } else { precise::exp(-0.5 * (d * d) as f64 / (scale * scale)) }
        };
        let (mut squares, mut count) = (0.0, 0.0);
        for i in (0..values.len()).filter(|i| !values[*i].is_nan()) {
            let (mut sum, mut total) = (0.0, 0.0);
            for j in (0..values.len()).filter(|j| !values[*j].is_nan()) {
                let w = weight(i % columns, j % columns) * weight(i / columns, j / columns);
                (sum, total) = (sum + w * f64::from(values[j]), total + w);
            }
            let d = f64::from(values[i]) - sum / total;
            (squares, count) = (squares + d * d, count + 1.0);
        }
        let found = roughness(&values, columns, 1.0, &[scale], 0.2).rms[0];
        assert!((found - f64::sqrt(squares / count)).abs() < 1e-13);
    }

    #[test]
    fn white_noise_hardly_depends_on_the_scale_and_a_plane_does() {
        let field = Key([6; 32]).field();
        let noise: Vec<f32> = (0..22_500).map(|i| field.normal(i % 150, i / 150) as f32).collect();
        let scales = [1.0, 2.0, 4.0, 8.0];
        let white = roughness(&noise, 150, 0.01, &scales, 0.0);
        // Variance that is left: 1 - 2 w0^2 + sum w^2 with the kernel's centre w0 = 1 / (2 pi s^2), sum w^2 = 1 / (4 pi s^2).
        for (scale, rms) in scales.iter().zip(&white.rms).skip(1) {
            let left = 1.0 - 0.75 / (std::f64::consts::PI * scale * scale);
            assert!((rms - left.sqrt()).abs() < 0.02, "{scale}: {rms}");
        }
        let line = white.power_law().unwrap();
        assert!(line.slope > 0.0 && line.slope < 0.08);
        let at_mean = white.reference_intercept(&line);
        assert!((at_mean - (line.intercept + line.slope * precise::log(0.01 * 8f64.sqrt()))).abs() < 1e-12);
    }

    #[test]
    fn a_constant_field_has_no_power_law() {
        assert_eq!(roughness(&[2.0; 100], 10, 1.0, &[1.0, 2.0], 2.0).power_law(), None);
    }
}
