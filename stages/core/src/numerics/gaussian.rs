//! Gaussian filters of grids. What has no value has no weight (normalised convolution); grids without gaps are filtered in one direction at a time.

use rayon::prelude::*;

use crate::numerics::portable_math;
use crate::numerics::simd::{Work, vectorised};

/// Where the filter is cut off, in standard deviations.
const TRUNCATION: f64 = 4.0;

/// A value and its weight: those of a cell that has a value, or zeros, or sums of these.
pub type Weighted = [f64; 2];

/// Cells filtered together, so that their sums stay in registers.
pub const BLOCK: usize = 8;
/// Rows that one thread filters one after the other, so that it writes long pieces of each block.
const BAND: usize = 16;
/// Numbers in a block.
const LANES: usize = 2 * BLOCK;

/// The values under a Gaussian of `scale` cells, gaps without weight; 0 where nothing is in reach.
pub fn smoothed(values: &[f32], columns: usize, scale: f64) -> Vec<f64> {
    let kernel = half_kernel(scale);
    let mut along = FilteredRows::new(values.len() / columns, columns, kernel.len());
    along.filter(values, 0.0, &kernel);
    let mean = |[sum, weight]: Weighted| if weight > 0.0 { sum / weight } else { 0.0 };
    let of_block = |block: usize| {
        let mut means = Vec::with_capacity(values.len() / columns * BLOCK);
        along.filter_columns(&kernel, block, |_, sums| means.extend(sums.map(mean)));
        means
    };
    let blocks: Vec<Vec<f64>> = (0..columns.div_ceil(BLOCK)).into_par_iter().map(of_block).collect();
    let mut smooth = vec![0.0; values.len()];
    smooth.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        for (out, means) in line.chunks_mut(BLOCK).zip(&blocks) {
            out.copy_from_slice(&means[row * BLOCK..][..out.len()]);
        }
    });
    smooth
}

/// Weights of a Gaussian of `scale` cells at distances 0, 1, 2, ... cells; both sides together add up to 1.
pub fn half_kernel(scale: f64) -> Vec<f64> {
    let radius = (TRUNCATION * scale + 0.5).floor() as usize;
    let weight = |k: usize| portable_math::exp(-0.5 * (k as f64 / scale) * (k as f64 / scale));
    let kernel: Vec<f64> = (0..=radius).map(weight).collect();
    let total = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
    kernel.iter().map(|w| w / total).collect()
}

/// Values without gaps under a kernel of [`half_kernel`] along their rows; beyond their ends they go on as they end.
pub fn smooth_rows(field: &[f64], columns: usize, kernel: &[f64]) -> Vec<f64> {
    let mut smooth = vec![0.0; field.len()];
    smooth.par_chunks_mut(columns).zip(field.par_chunks(columns)).for_each(|(out, row)| {
        let padded: Vec<f64> = (0..columns + 2 * (kernel.len() - 1))
            .map(|i| row[i.saturating_sub(kernel.len() - 1).min(columns - 1)])
            .collect();
        for (k, weight) in kernel.iter().enumerate() {
            let (left, right) = (&padded[kernel.len() - 1 - k..], &padded[kernel.len() - 1 + k..]);
            let weight = if k == 0 { 0.5 * weight } else { *weight };
            out.iter_mut().zip(left.iter().zip(right)).for_each(|(out, (a, b))| *out += weight * (a + b));
        }
    });
    smooth
}

/// The same along its columns.
pub fn smooth_columns(field: &[f64], columns: usize, kernel: &[f64]) -> Vec<f64> {
    let rows = field.len() / columns;
    let mut smooth = vec![0.0; field.len()];
    smooth.par_chunks_mut(columns).enumerate().for_each(|(row, out)| {
        let line = |row: usize| &field[row * columns..(row + 1) * columns];
        for (k, weight) in kernel.iter().enumerate() {
            let (above, below) = (line(row.saturating_sub(k)), line((row + k).min(rows - 1)));
            let weight = if k == 0 { 0.5 * weight } else { *weight };
            out.iter_mut().zip(above.iter().zip(below)).for_each(|(out, (a, b))| *out += weight * (a + b));
        }
    });
    smooth
}

/// Rows of a grid under a kernel, to be filtered along its columns.
pub struct FilteredRows {
    /// Blocks of columns, one after the other, each row by row, with zeros before its first row and after its last one.
    cells: Vec<Weighted>,
    rows: usize,
    columns: usize,
    /// Cells of a block before its first row, and after its last one.
    border: usize,
}

impl FilteredRows {
    /// Room for a grid under kernels of up to `longest` weights.
    pub fn new(rows: usize, columns: usize, longest: usize) -> Self {
        let border = longest.saturating_sub(1) * BLOCK;
        let cells = columns.div_ceil(BLOCK) * (rows * BLOCK + 2 * border);
        Self { cells: vec![[0.0; 2]; cells], rows, columns, border }
    }

    /// Cells of a block, with both borders.
    fn block(&self) -> usize {
        self.rows * BLOCK + 2 * self.border
    }

    /// Filters each row of values, of which `mean` is taken off, with nothing beyond its ends.
    pub fn filter(&mut self, values: &[f32], mean: f64, kernel: &[f64]) {
        let (columns, radius, block, border) = (self.columns, kernel.len() - 1, self.block(), self.border);
        let wide = columns.next_multiple_of(BLOCK);
        let mut bands: Vec<Vec<&mut [Weighted]>> = Vec::new();
        bands.resize_with(self.rows.div_ceil(BAND), Vec::new);
        for cells in self.cells.chunks_exact_mut(block) {
            let pieces = cells[border..block - border].chunks_mut(BAND * BLOCK);
            bands.iter_mut().zip(pieces).for_each(|(band, piece)| band.push(piece));
        }
        bands.into_par_iter().zip(values.par_chunks(BAND * columns)).for_each(|(mut band, values)| {
            let mut padded = vec![[0.0; 2]; wide + 2 * radius];
            for (row, line) in values.chunks_exact(columns).enumerate() {
                for (cell, value) in padded[radius..].iter_mut().zip(line) {
                    *cell = if value.is_nan() { [0.0; 2] } else { [f64::from(*value) - mean, 1.0] };
                }
                vectorised(Row { padded: &padded, kernel, band: &mut band, place: row });
            }
        });
    }

    /// Filters a block of columns, with nothing beyond their ends, and hands over its cells row by row.
    pub fn filter_columns(&self, kernel: &[f64], block: usize, mut take: impl FnMut(usize, [Weighted; BLOCK])) {
        let cells = &self.cells[block * self.block()..][..self.block()];
        let strip = &cells[self.border - (kernel.len() - 1) * BLOCK..];
        vectorised(Columns { strip, rows: self.rows, kernel, take: &mut take });
    }
}

/// A row that is filtered into a band of rows.
struct Row<'a, 'b> {
    padded: &'a [Weighted],
    kernel: &'a [f64],
    /// The band's piece of each block.
    band: &'a mut [&'b mut [Weighted]],
    /// Which row of the band it is.
    place: usize,
}

impl Work for Row<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (block, cells) in self.band.iter_mut().enumerate() {
            cells[self.place * BLOCK..][..BLOCK].copy_from_slice(&convolve(
                &self.padded[block * BLOCK..],
                1,
                self.kernel,
            ));
        }
    }
}

/// A block of columns that is filtered.
struct Columns<'a, T> {
    strip: &'a [Weighted],
    rows: usize,
    kernel: &'a [f64],
    take: &'a mut T,
}

impl<T: FnMut(usize, [Weighted; BLOCK])> Work for Columns<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for row in 0..self.rows {
            (self.take)(row, convolve(&self.strip[row * BLOCK..], BLOCK, self.kernel));
        }
    }
}

/// A block of neighbours under the kernel, whose steps are `stride` cells of the input apart; the first one's centre is
/// `input[(kernel.len() - 1) * stride]`.
#[inline(always)]
fn convolve(input: &[Weighted], stride: usize, kernel: &[f64]) -> [Weighted; BLOCK] {
    let (input, centre) = (input.as_flattened(), 2 * (kernel.len() - 1) * stride);
    let mut sums = [0.0; LANES];
    for (sum, x) in sums.iter_mut().zip(&input[centre..][..LANES]) {
        *sum = kernel[0] * x;
    }
    for (k, weight) in kernel.iter().enumerate().skip(1) {
        let step = 2 * k * stride;
        let (before, after) = (&input[centre - step..][..LANES], &input[centre + step..][..LANES]);
        for lane in 0..LANES {
            sums[lane] += weight * (before[lane] + after[lane]);
        }
    }
    std::array::from_fn(|cell| [sums[2 * cell], sums[2 * cell + 1]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_without_gaps_go_on_as_they_end() {
        let (columns, rows) = (7, 9);
        let kernel = half_kernel(1.3);
        let field: Vec<f64> = (0..columns * rows).map(|i| ((i * i) % 17) as f64).collect();
        let turned = |field: &[f64], columns: usize| -> Vec<f64> {
            (0..columns).flat_map(|c| field.iter().skip(c).step_by(columns).copied().collect::<Vec<f64>>()).collect()
        };
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        let down = smooth_columns(&field, columns, &kernel);
        assert!(near(&turned(&down, columns), &smooth_rows(&turned(&field, columns), rows, &kernel)));
        assert!(near(&smooth_rows(&[2.5; 63], columns, &kernel), &[2.5; 63]));
        // Within a row: the sum over the kernel, with the ends repeated.
        let at = |column: i32| field[column.clamp(0, 6) as usize];
        let weight = |k: i32| kernel.get(k.unsigned_abs() as usize).copied().unwrap_or(0.0);
        let wanted: Vec<f64> = (0..7).map(|c| (-6..=6).map(|k| weight(k) * at(c + k)).sum()).collect();
        assert!(near(&smooth_rows(&field[..7], columns, &kernel), &wanted));
    }
}
