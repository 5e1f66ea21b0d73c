//! Scale-dependent roughness: what a Gaussian filter takes away, over its width (paper 2.2.4, equations 13 and 14).

use rayon::prelude::*;

use rockface_core::numerics::gaussian::{FilteredRows, LANES, TakeRow, half_kernel};
use rockface_core::numerics::linear_fit::{Line, fit_line};
use rockface_core::numerics::portable_math;

/// Cells filtered together.
const BLOCK: usize = FilteredRows::<2>::BLOCK;

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
            self.sigma.iter().zip(&self.rms).map(|(s, r)| (portable_math::log(*s), portable_math::log(*r))).collect();
        if points.iter().all(|(x, y)| x.is_finite() && y.is_finite()) { fit_line(&points) } else { None }
    }

    /// ln R of the fitted line at the geometric mean of the scales: the intercept where the data are.
    pub fn reference_intercept(&self, line: &Line) -> f64 {
        let mean = self.sigma.iter().map(|s| portable_math::log(*s)).sum::<f64>() / self.sigma.len() as f64;
        line.intercept + line.slope * mean
    }
}

/// Roughness of `columns` columns of values by row (NaN = none), for filters of `scales_cells` cells; `cell` is the side
/// of a cell. Gaps and what lies beyond the edge have no weight (normalised convolution). `mean` only centres the values.
pub fn roughness(values: &[f32], columns: usize, cell: f64, scales_cells: &[f64], mean: f64) -> Roughness {
    let kernels: Vec<Vec<f64>> = scales_cells.iter().map(|scale| half_kernel(*scale)).collect();
    let longest = kernels.iter().map(Vec::len).max().unwrap_or(0);
    let mut along = FilteredRows::new(values.len() / columns, columns, longest);
    let rms = kernels.iter().map(|kernel| residual(values, columns, mean, kernel, &mut along)).collect();
    Roughness { sigma: scales_cells.iter().map(|scale| scale * cell).collect(), rms }
}

/// Root mean square of what a kernel takes away; `along` is room for the rows filtered.
fn residual(values: &[f32], columns: usize, mean: f64, kernel: &[f64], along: &mut FilteredRows<2>) -> f64 {
    along.filter(values, mean, kernel);
    let of_block = |block: usize| {
        let mut total = Residual { values, columns, mean, block, squares: [0.0; BLOCK], counts: [0.0; BLOCK] };
        along.filter_columns(kernel, block, &mut total);
        [total.squares.iter().sum(), total.counts.iter().sum()]
    };
    let blocks: Vec<[f64; 2]> = (0..columns.div_ceil(BLOCK)).into_par_iter().map(of_block).collect();
    let [squares, count] = blocks.iter().fold([0.0, 0.0], |sum, block| [sum[0] + block[0], sum[1] + block[1]]);
    (squares / count).sqrt()
}

/// Squares of what is left of the values of a block, and how many there are, by column.
struct Residual<'a> {
    values: &'a [f32],
    columns: usize,
    mean: f64,
    block: usize,
    squares: [f64; BLOCK],
    counts: [f64; BLOCK],
}

impl TakeRow for Residual<'_> {
    #[inline(always)]
    fn take(&mut self, row: usize, numbers: &[f64; LANES]) {
        let (begin, end) = (row * self.columns, (row + 1) * self.columns);
        let cells = &self.values[begin + self.block * BLOCK..end.min(begin + (self.block + 1) * BLOCK)];
        // A copy of a length that is known takes two instructions.
        let values: [f32; BLOCK] =
            cells.try_into().unwrap_or_else(|_| std::array::from_fn(|lane| *cells.get(lane).unwrap_or(&f32::NAN)));
        for (lane, value) in values.into_iter().enumerate() {
            let (sum, weight) = (numbers[2 * lane], numbers[2 * lane + 1]);
            let rest = f64::from(value) - self.mean - sum / weight;
            // Where there is no value the rest is NaN.
            let (square, one) = if rest.is_nan() { (0.0, 0.0) } else { (rest * rest, 1.0) };
            self.squares[lane] += square;
            self.counts[lane] += one;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn equals_the_definition_on_a_field_with_gaps() {
        let (columns, rows, scale) = (13, 9, 1.5);
        let field = Key([4; 32]).field();
        let gap = |i: usize| field.words(i as i32, 1)[0].is_multiple_of(4);
        let values: Vec<f32> =
            (0..columns * rows).map(|i| if gap(i) { f32::NAN } else { field.normal(i as i32, 0) as f32 }).collect();
        let weight = |a: usize, b: usize| {
            let d = a.abs_diff(b);
            if d > 6 { 0.0 } else { portable_math::exp(-0.5 * (d * d) as f64 / (scale * scale)) }
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
        assert!((at_mean - (line.intercept + line.slope * portable_math::log(0.01 * 8f64.sqrt()))).abs() < 1e-12);
    }

    #[test]
    fn a_constant_field_has_no_power_law() {
        assert_eq!(roughness(&[2.0; 100], 10, 1.0, &[1.0, 2.0], 2.0).power_law(), None);
    }
}
