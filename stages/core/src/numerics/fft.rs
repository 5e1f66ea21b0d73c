//! Two-dimensional Fourier transforms of real fields, with the work on known zeros and on mirrored halves left out.
//!
//! The scalar planner is used, so results do not depend on what vector units the processor has; rows and columns are
//! transformed in parallel into disjoint slices, so they do not depend on the thread count either.

use std::sync::Arc;

use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlannerScalar};

/// A complex number of the transform.
pub type C64 = Complex<f64>;

/// Columns gathered together, so that reading them from rows stays within cache lines.
const BLOCK: usize = 8;

/// Transforms of one size.
pub struct Fft2 {
    /// Columns of the (padded) field.
    pub columns: usize,
    /// Rows of the (padded) field.
    pub rows: usize,
    along_row: [Arc<dyn Fft<f64>>; 2],
    along_column: [Arc<dyn Fft<f64>>; 2],
}

/// The smallest size from `at_least` on whose only prime factors are 2, 3 and 5: transforms of such sizes are fast.
pub fn fast_size(at_least: usize) -> usize {
    let smooth = |mut n: usize| {
        for factor in [2, 3, 5] {
            while n.is_multiple_of(factor) {
                n /= factor;
            }
        }
        n == 1
    };
    let mut size = at_least.max(1);
    while !smooth(size) {
        size += 1;
    }
    size
}

impl Fft2 {
    /// Plans transforms of `columns` x `rows` cells.
    pub fn new(columns: usize, rows: usize) -> Self {
        let mut planner = FftPlannerScalar::new();
        let mut both = |n| [planner.plan_fft_forward(n), planner.plan_fft_inverse(n)];
        Self { columns, rows, along_row: both(columns), along_column: both(rows) }
    }

    /// Columns 0 to n / 2: all that a field of real values needs.
    pub fn half(&self) -> usize {
        self.columns / 2 + 1
    }

    /// The rows of a field that is zero beyond `filled` rows, transformed; `fill` writes one of these rows.
    pub fn along_rows(&self, filled: usize, fill: impl Fn(usize, &mut [C64]) + Sync) -> AlongRows<'_> {
        let mut field = vec![C64::default(); filled * self.columns];
        field.par_chunks_mut(self.columns).enumerate().for_each(|(row, line)| {
            fill(row, line);
            self.along_row[0].process(line);
        });
        AlongRows { fft: self, field, filled, in_pairs: false }
    }

    /// The same of a real field. Two rows go through one transform, as its real and its imaginary part; symmetry parts them again.
    pub fn along_real_rows(&self, filled: usize, fill: impl Fn(usize, &mut [f64]) + Sync) -> AlongRows<'_> {
        let mut field = vec![C64::default(); filled.div_ceil(2) * self.columns];
        field.par_chunks_mut(self.columns).enumerate().for_each(|(pair, line)| {
            let mut rows = vec![0.0; 2 * self.columns];
            let (even, odd) = rows.split_at_mut(self.columns);
            fill(2 * pair, even);
            if 2 * pair + 1 < filled {
                fill(2 * pair + 1, odd);
            }
            line.iter_mut().zip(even).zip(odd).for_each(|((cell, re), im)| *cell = C64::new(*re, *im));
            self.along_row[0].process(line);
        });
        AlongRows { fft: self, field, filled, in_pairs: true }
    }

    /// The spectrum of a real field: columns 0 to n / 2, column by column; element `kx * rows + ky`.
    pub fn forward_real(&self, filled: usize, fill: impl Fn(usize, &mut [f64]) + Sync) -> Vec<C64> {
        let rows = self.along_real_rows(filled, fill);
        let mut spectrum = vec![C64::default(); self.half() * self.rows];
        spectrum.par_chunks_mut(self.rows * BLOCK).enumerate().for_each(|(block, lines)| {
            rows.columns(block * BLOCK.., lines);
        });
        spectrum
    }

    /// Turns the half spectrum of a real field, as [`Fft2::forward_real`] gives it, back into the field, without the factor 1 / (columns rows).
    ///
    /// Two rows go through one transform, as its real and its imaginary part.
    pub fn inverse_real(&self, mut spectrum: Vec<C64>) -> Vec<f64> {
        spectrum.par_chunks_mut(self.rows * BLOCK).for_each(|lines| self.along_column[1].process(lines));
        let mut field = vec![0.0; self.columns * self.rows];
        field.par_chunks_mut(self.columns * BLOCK).enumerate().for_each(|(block, field)| {
            let rows = field.len() / self.columns;
            let mut lines = vec![C64::default(); rows.div_ceil(2) * self.columns];
            for kx in 0..self.half() {
                let cells = &spectrum[kx * self.rows + block * BLOCK..][..rows];
                let mirrored = (self.columns - kx) % self.columns;
                for (line, pair) in lines.chunks_exact_mut(self.columns).zip(cells.chunks(2)) {
                    let (even, odd) = (pair[0], pair.get(1).copied().unwrap_or_default());
                    line[mirrored] = C64::new(even.re + odd.im, odd.re - even.im);
                    line[kx] = C64::new(even.re - odd.im, even.im + odd.re);
                }
            }
            self.along_row[1].process(&mut lines);
            for (row, line) in field.chunks_exact_mut(self.columns).enumerate() {
                let cells = &lines[row / 2 * self.columns..][..self.columns];
                let part = |cell: &C64| if row % 2 == 0 { cell.re } else { cell.im };
                line.iter_mut().zip(cells).for_each(|(value, cell)| *value = part(cell));
            }
        });
        field
    }

    /// Turns the half spectrum of a field back into its first rows, without the factor 1 / (columns rows).
    ///
    /// The spectrum must be that of two even real fields a + i b, as of autocorrelations: `spectrum(-k) = spectrum(k)`. `fill` writes
    /// some of its columns, from one on. `take` is handed each of the rows 0 to `wanted - 1` and its results are returned in that order.
    pub fn inverse_even<T: Send>(
        &self,
        wanted: usize,
        fill: impl Fn(usize, &mut [C64]) + Sync,
        take: impl Fn(usize, &[C64]) -> T + Sync,
    ) -> Vec<T> {
        // Of each column only these rows are kept, and those that mirror them.
        let mut kept = vec![C64::default(); self.half() * 2 * wanted];
        kept.par_chunks_mut(2 * wanted * BLOCK).enumerate().for_each(|(block, kept)| {
            let mut lines = vec![C64::default(); kept.len() / (2 * wanted) * self.rows];
            fill(block * BLOCK, &mut lines);
            self.along_column[1].process(&mut lines);
            for (kept, line) in kept.chunks_exact_mut(2 * wanted).zip(lines.chunks_exact(self.rows)) {
                let (first, mirrored) = kept.split_at_mut(wanted);
                first.copy_from_slice(&line[..wanted]);
                mirrored.iter_mut().enumerate().for_each(|(row, cell)| *cell = line[(self.rows - row) % self.rows]);
            }
        });
        let rows_of = |block: usize| {
            let first = block * BLOCK;
            let count = BLOCK.min(wanted - first);
            let mut lines = vec![C64::default(); count * self.columns];
            for kx in 0..self.columns {
                let (column, part) = if kx < self.half() { (kx, 0) } else { (self.columns - kx, wanted) };
                let cells = &kept[column * 2 * wanted + part + first..][..count];
                lines.iter_mut().skip(kx).step_by(self.columns).zip(cells).for_each(|(cell, from)| *cell = *from);
            }
            self.along_row[1].process(&mut lines);
            let rows = lines.chunks_exact(self.columns).enumerate();
            rows.map(|(row, line)| take(first + row, line)).collect::<Vec<T>>()
        };
        (0..wanted.div_ceil(BLOCK)).into_par_iter().flat_map_iter(rows_of).collect()
    }
}

/// A field whose rows are transformed and whose columns are not: the spectrum is made of it column by column.
pub struct AlongRows<'a> {
    fft: &'a Fft2,
    field: Vec<C64>,
    filled: usize,
    /// Two real rows are the real and the imaginary part of one.
    in_pairs: bool,
}

impl AlongRows<'_> {
    /// Writes some columns of the spectrum, one after the other, as many as there is room for.
    pub fn columns(&self, which: impl IntoIterator<Item = usize>, lines: &mut [C64]) {
        let (columns, rows) = (self.fft.columns, self.fft.rows);
        let which: Vec<usize> = which.into_iter().take(lines.len() / rows).collect();
        lines.chunks_exact_mut(rows).for_each(|line| line[self.filled..].fill(C64::default()));
        for (at, cells) in self.field.chunks_exact(columns).enumerate() {
            for (line, kx) in lines.chunks_exact_mut(rows).zip(&which) {
                if !self.in_pairs {
                    line[at] = cells[*kx];
                    continue;
                }
                let (here, there) = (cells[*kx], cells[(columns - kx) % columns].conj());
                let (sum, difference) = (here + there, here - there);
                line[2 * at] = sum * 0.5;
                if 2 * at + 1 < self.filled {
                    line[2 * at + 1] = C64::new(0.5 * difference.im, -0.5 * difference.re);
                }
            }
        }
        self.fft.along_column[0].process(lines);
    }

    /// What `take` makes of each of the columns 0 to n / 2 of the spectrum, in their order.
    pub fn map_columns<T: Send>(&self, take: impl Fn(usize, &[C64]) -> T + Sync) -> Vec<T> {
        let (half, rows) = (self.fft.half(), self.fft.rows);
        let of_block = |block: usize| {
            let first = block * BLOCK;
            let mut lines = vec![C64::default(); BLOCK.min(half - first) * rows];
            self.columns(first.., &mut lines);
            let columns = lines.chunks_exact(rows).enumerate();
            columns.map(|(column, line)| take(first + column, line)).collect::<Vec<T>>()
        };
        (0..half.div_ceil(BLOCK)).into_par_iter().flat_map_iter(of_block).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::portable_math;

    fn sample(row: usize, column: usize) -> f64 {
        ((row * 7 + column * 3) % 11) as f64 - 4.0
    }

    #[test]
    fn agrees_with_the_definition() {
        let (columns, rows, filled) = (6, 5, 3);
        let fft = Fft2::new(columns, rows);
        let fill = |row: usize, line: &mut [C64]| {
            line.iter_mut().enumerate().for_each(|(column, cell)| *cell = C64::new(sample(row, column), 0.0));
        };
        let mut spectrum = vec![C64::default(); fft.half() * rows];
        fft.along_rows(filled, fill).columns(0.., &mut spectrum);
        for kx in 0..fft.half() {
            for ky in 0..rows {
                let mut sum = C64::default();
                for row in 0..filled {
                    for column in 0..columns {
                        let turns = (kx * column) as f64 / columns as f64 + (ky * row) as f64 / rows as f64;
                        let (sin, cos) = portable_math::sincos(-std::f64::consts::TAU * turns);
                        sum += C64::new(cos, sin) * sample(row, column);
                    }
                }
                assert!((sum - spectrum[kx * rows + ky]).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn real_rows_go_in_pairs() {
        for (columns, rows, filled) in [(6, 5, 3), (7, 4, 4), (1, 3, 1), (8, 6, 0)] {
            let fft = Fft2::new(columns, rows);
            let whole = fft.along_rows(filled, |row, line| {
                line.iter_mut().enumerate().for_each(|(column, cell)| *cell = C64::new(sample(row, column), 0.0));
            });
            let one: Vec<C64> = whole.map_columns(|_, line| line.to_vec()).concat();
            let two = fft.forward_real(filled, |row, line| {
                line.iter_mut().enumerate().for_each(|(column, cell)| *cell = sample(row, column));
            });
            assert!(one.iter().zip(&two).all(|(a, b)| (a - b).norm() < 1e-12));
        }
    }

    #[test]
    fn the_inverse_of_a_power_spectrum_is_the_cyclic_autocorrelation() {
        for (columns, rows) in [(6, 4), (5, 7), (1, 3)] {
            let fft = Fft2::new(columns, rows);
            let fill = |row: usize, line: &mut [C64]| {
                line.iter_mut().enumerate().for_each(|(column, cell)| *cell = C64::new(sample(row, column), 0.0));
            };
            let transformed = fft.along_rows(rows, fill);
            let power = |first: usize, lines: &mut [C64]| {
                transformed.columns(first.., lines);
                lines.iter_mut().for_each(|c| *c = C64::new(c.norm_sqr(), -2.0 * c.norm_sqr()));
            };
            let lags = fft.inverse_even(rows, power, |_, line| line.to_vec());
            for (dy, line) in lags.iter().enumerate() {
                for (dx, lag) in line.iter().enumerate() {
                    let pair = |row: usize, column: usize| {
                        sample(row, column) * sample((row + dy) % rows, (column + dx) % columns)
                    };
                    let sum: f64 =
                        (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))).map(|(r, c)| pair(r, c)).sum();
                    let found = lag / (columns * rows) as f64;
                    assert!((found - C64::new(sum, -2.0 * sum)).norm() < 1e-11);
                }
            }
        }
    }

    #[test]
    fn fast_sizes_have_small_factors() {
        assert_eq!([1, 7, 910, 840, 1025].map(fast_size), [1, 8, 960, 864, 1080]);
    }
}
