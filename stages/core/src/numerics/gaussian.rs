//! Gaussian filters of grids. What has no value has no weight (normalised convolution); grids without gaps are filtered in one direction at a time.

use rayon::prelude::*;

use crate::numerics::portable_math;
use crate::numerics::simd::{Lanes, Work, vectorised};

/// Where the filter is cut off, in standard deviations.
const TRUNCATION: f64 = 4.0;

/// Numbers filtered together, so that their sums stay in registers.
pub const LANES: usize = 16;
/// Rows of lanes whose sums are taken together.
const TILE: usize = 4;

/// The values under a Gaussian of `scale` cells, gaps without weight; 0 where nothing is in reach.
pub fn smoothed(values: &[f32], columns: usize, scale: f64) -> Vec<f64> {
    let kernel = half_kernel(scale);
    if !values.iter().any(|value| value.is_nan()) {
        return smoothed_whole(values, columns, &kernel);
    }
    let mean = |[sum, weight]: &[f64; 2]| if *weight > 0.0 { sum / weight } else { 0.0 };
    filtered::<2>(values, columns, &kernel, |sums, means| means.extend(sums.as_chunks().0.iter().map(mean)))
}

/// The same of a grid without gaps, whose weights depend on how near its edges are: the same bits.
fn smoothed_whole(values: &[f32], columns: usize, kernel: &[f64]) -> Vec<f64> {
    let mut smooth = filtered::<1>(values, columns, kernel, |sums, found| found.extend_from_slice(sums));
    // Rows that reach no edge have the weights of one of them.
    let (rows, radius) = (values.len() / columns, kernel.len() - 1);
    let distinct = rows.min(2 * radius + 1);
    let weights =
        filtered::<1>(&vec![1.0; distinct * columns], columns, kernel, |sums, found| found.extend_from_slice(sums));
    smooth.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        let alike = if row + radius < rows { row.min(radius) } else { row + distinct - rows };
        line.iter_mut().zip(&weights[alike * columns..]).for_each(|(sum, weight)| *sum /= weight);
    });
    smooth
}

/// A grid under a kernel in both directions; `push` adds the cells of a block, made of their sums.
fn filtered<const NUMBERS: usize>(
    values: &[f32],
    columns: usize,
    kernel: &[f64],
    push: impl Fn(&[f64; LANES], &mut Vec<f64>) + Sync,
) -> Vec<f64> {
    let block = FilteredRows::<NUMBERS>::BLOCK;
    let mut along = FilteredRows::<NUMBERS>::new(values.len() / columns, columns, kernel.len());
    along.filter(values, 0.0, kernel);
    let of_block = |place: usize| {
        let mut found = Pushed { push: &push, found: Vec::with_capacity(values.len() / columns * block) };
        along.filter_columns(kernel, place, &mut found);
        found.found
    };
    let blocks: Vec<Vec<f64>> = (0..columns.div_ceil(block)).into_par_iter().map(of_block).collect();
    let mut whole = vec![0.0; values.len()];
    whole.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        for (out, found) in line.chunks_mut(block).zip(&blocks) {
            out.copy_from_slice(&found[row * block..][..out.len()]);
        }
    });
    whole
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

/// Rows of a grid under a kernel, to be filtered along its columns. A cell has two numbers, its value and its weight, or where a
/// grid has no gaps its value alone.
pub struct FilteredRows<const NUMBERS: usize> {
    /// Blocks of columns, one after the other, each row by row, with zeros before its first row and after its last one.
    numbers: Vec<f64>,
    rows: usize,
    columns: usize,
    /// Numbers of a block before its first row, and after its last one.
    border: usize,
}

impl<const NUMBERS: usize> FilteredRows<NUMBERS> {
    /// Cells filtered together.
    pub const BLOCK: usize = LANES / NUMBERS;

    /// Room for a grid under kernels of up to `longest` weights.
    pub fn new(rows: usize, columns: usize, longest: usize) -> Self {
        let border = longest.saturating_sub(1) * LANES;
        let numbers = columns.div_ceil(Self::BLOCK) * (rows * LANES + 2 * border);
        Self { numbers: vec![0.0; numbers], rows, columns, border }
    }

    /// Numbers of a block, with both borders.
    fn block(&self) -> usize {
        self.rows * LANES + 2 * self.border
    }

    /// Filters each row of values, of which `mean` is taken off, with nothing beyond its ends.
    pub fn filter(&mut self, values: &[f32], mean: f64, kernel: &[f64]) {
        let (columns, reach, block, border) = (self.columns, kernel.len() - 1, self.block(), self.border);
        // A band has as many rows as a block has columns: together they have one number a lane.
        let mut bands: Vec<Vec<&mut [f64]>> = Vec::new();
        bands.resize_with(self.rows.div_ceil(Self::BLOCK), Vec::new);
        for numbers in self.numbers.chunks_exact_mut(block) {
            let pieces = numbers[border..block - border].chunks_mut(Self::BLOCK * LANES);
            bands.iter_mut().zip(pieces).for_each(|(band, piece)| band.push(piece));
        }
        let strip = || vec![Row::default(); columns + 2 * reach];
        let bands = bands.into_par_iter().zip(values.par_chunks(Self::BLOCK * columns));
        bands.for_each_init(strip, |strip, (mut band, values)| {
            for row in 0..Self::BLOCK {
                let line = values.chunks_exact(columns).nth(row).unwrap_or_default();
                let lanes = NUMBERS * row..NUMBERS * (row + 1);
                for (column, cell) in strip[reach..reach + columns].iter_mut().enumerate() {
                    let value = line.get(column).filter(|value| !value.is_nan());
                    let weighted = value.map_or([0.0; 2], |value| [f64::from(*value) - mean, 1.0]);
                    cell[lanes.clone()].copy_from_slice(&weighted[..NUMBERS]);
                }
            }
            vectorised(Strip { rows: strip, kernel, into: &mut ToColumns::<NUMBERS>(&mut band) });
        });
    }

    /// Filters a block of columns, with nothing beyond their ends, and hands over the numbers of its cells row by row.
    pub fn filter_columns(&self, kernel: &[f64], block: usize, into: &mut impl TakeRow) {
        let numbers = &self.numbers[block * self.block()..][..self.block()];
        let beyond = self.border - (kernel.len() - 1) * LANES;
        let (strip, _) = numbers[beyond..numbers.len() - beyond].as_chunks();
        vectorised(Strip { rows: strip, kernel, into });
    }
}

/// What takes the rows that are filtered. Implementations say `#[inline(always)]`: a closure is compiled by itself, without wide registers.
pub trait TakeRow {
    /// The numbers of a row.
    fn take(&mut self, row: usize, numbers: &[f64; LANES]);
}

/// The cells that `push` makes of the rows.
struct Pushed<'a, P> {
    push: &'a P,
    found: Vec<f64>,
}

impl<P: Fn(&[f64; LANES], &mut Vec<f64>)> TakeRow for Pushed<'_, P> {
    #[inline(always)]
    fn take(&mut self, _: usize, numbers: &[f64; LANES]) {
        (self.push)(numbers, &mut self.found);
    }
}

/// Rows of lanes that become columns of the blocks of a band.
struct ToColumns<'a, 'b, const NUMBERS: usize>(&'a mut [&'b mut [f64]]);

impl<const NUMBERS: usize> TakeRow for ToColumns<'_, '_, NUMBERS> {
    #[inline(always)]
    fn take(&mut self, column: usize, numbers: &[f64; LANES]) {
        let block = LANES / NUMBERS;
        let cell = NUMBERS * (column % block);
        for (row, numbers) in self.0[column / block].chunks_exact_mut(LANES).zip(numbers.chunks_exact(NUMBERS)) {
            row[cell..cell + NUMBERS].copy_from_slice(numbers);
        }
    }
}

/// A row of lanes.
type Row = [f64; LANES];

/// Rows of lanes that are filtered along each lane; those at both ends that the kernel does not fit around are no centres.
struct Strip<'a, T> {
    rows: &'a [Row],
    kernel: &'a [f64],
    into: &'a mut T,
}

impl<T: TakeRow> Work for Strip<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.filter::<4>();
    }

    #[inline(always)]
    fn run_wide(self) {
        self.filter::<8>();
    }
}

impl<T: TakeRow> Strip<'_, T> {
    /// Filters by `PART` lanes at a time, which fill a register.
    #[inline(always)]
    fn filter<const PART: usize>(self) {
        let places = self.rows.len() - 2 * (self.kernel.len() - 1);
        let mut place = 0;
        while place < places {
            let (mut sums, mut count) = ([[0.0; LANES]; TILE], TILE);
            if place + TILE <= places {
                sums = convolve::<PART, TILE>(&self.rows[place..], self.kernel);
            } else {
                [sums[0]] = convolve::<PART, 1>(&self.rows[place..], self.kernel);
                count = 1;
            }
            for (row, sums) in sums[..count].iter().enumerate() {
                self.into.take(place + row, sums);
            }
            place += count;
        }
    }
}

/// Some rows of lanes under the kernel, whose centre is the row `kernel.len() - 1` for the first of them. Rows under the kernel stay
/// in registers for as long as one of the sums needs them.
#[inline(always)]
fn convolve<const PART: usize, const ROWS: usize>(strip: &[Row], kernel: &[f64]) -> [Row; ROWS] {
    let centre = kernel.len() - 1;
    let mut found = [[0.0; LANES]; ROWS];
    for first in (0..LANES).step_by(PART) {
        let part = |row: &Row| Lanes::<PART>::first_of(&row[first..first + PART]);
        let mut sums = [Lanes::<PART>::NONE; ROWS];
        let (mut before, mut after) = (sums, sums);
        for row in 0..ROWS {
            let centre = part(&strip[centre + row]);
            (sums[row], before[row], after[row]) = (centre * kernel[0], centre, centre);
        }
        let rows = strip[..centre].iter().rev().zip(&strip[centre + ROWS..]);
        for (weight, (row_before, row_after)) in kernel[1..].iter().zip(rows) {
            for row in (1..ROWS).rev() {
                before[row] = before[row - 1];
            }
            before[0] = part(row_before);
            for row in 1..ROWS {
                after[row - 1] = after[row];
            }
            after[ROWS - 1] = part(row_after);
            for row in 0..ROWS {
                sums[row] = sums[row] + (before[row] + after[row]) * *weight;
            }
        }
        for row in 0..ROWS {
            found[row][first..first + PART].copy_from_slice(&sums[row].each());
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_without_gaps_have_the_weights_of_those_with_gaps() {
        // More rows than the kernel reaches, as many, and fewer.
        for (columns, rows) in [(21, 40), (19, 9), (16, 5), (3, 1)] {
            let values: Vec<f32> = (0..columns * rows).map(|i| ((i * i) % 17) as f32 - 8.0).collect();
            let kernel = half_kernel(1.1);
            let weighted = filtered::<2>(&values, columns, &kernel, |sums, means| {
                means.extend(sums.as_chunks().0.iter().map(|[sum, weight]| sum / weight));
            });
            assert_eq!(smoothed(&values, columns, 1.1), weighted);
        }
    }

    #[test]
    fn the_width_of_registers_changes_no_bit() {
        let kernel = half_kernel(1.3);
        let rows: Vec<Row> =
            (0..45).map(|row| std::array::from_fn(|lane| ((row * row + 3 * lane) % 17) as f64)).collect();
        let mut found =
            [(); 2].map(|()| Pushed { push: &|row: &Row, all: &mut Vec<f64>| all.extend(row), found: Vec::new() });
        let [narrow, wide] = &mut found;
        Strip { rows: &rows, kernel: &kernel, into: narrow }.filter::<4>();
        Strip { rows: &rows, kernel: &kernel, into: wide }.filter::<8>();
        let bits = |found: &Vec<f64>| found.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
        assert_eq!(narrow.found.len(), (45 - 2 * (kernel.len() - 1)) * LANES);
        assert_eq!(bits(&narrow.found), bits(&wide.found));
    }

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
