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

    /// The spectrum of a field that is zero beyond `filled` rows; `fill` writes one of these rows.
    ///
    /// Returns the first `wanted` columns of the spectrum, column by column: element `kx * rows + ky`.
    pub fn forward(&self, filled: usize, wanted: usize, fill: impl Fn(usize, &mut [C64]) + Sync) -> Vec<C64> {
        let mut field = vec![C64::default(); filled * self.columns];
        field.par_chunks_mut(self.columns).enumerate().for_each(|(row, line)| {
            fill(row, line);
            self.along_row[0].process(line);
        });
        let mut spectrum = vec![C64::default(); wanted * self.rows];
        spectrum.par_chunks_mut(self.rows * BLOCK).enumerate().for_each(|(block, lines)| {
            for (row, cells) in field.chunks_exact(self.columns).enumerate() {
                let count = lines.len() / self.rows;
                for (j, cell) in cells[block * BLOCK..block * BLOCK + count].iter().enumerate() {
                    lines[j * self.rows + row] = *cell;
                }
            }
            self.along_column[0].process(lines);
        });
        spectrum
    }

    /// The spectrum of a real field that is zero beyond `filled` rows: columns 0 to n / 2, as [`Fft2::forward`].
    ///
    /// Two rows go through one transform, as its real and its imaginary part; symmetry parts them again.
    pub fn forward_real(&self, filled: usize, fill: impl Fn(usize, &mut [f64]) + Sync) -> Vec<C64> {
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
        let mut spectrum = vec![C64::default(); self.half() * self.rows];
        spectrum.par_chunks_mut(self.rows * BLOCK).enumerate().for_each(|(block, lines)| {
            let count = lines.len() / self.rows;
            for (pair, cells) in field.chunks_exact(self.columns).enumerate() {
                for j in 0..count {
                    let kx = block * BLOCK + j;
                    let (here, there) = (cells[kx], cells[(self.columns - kx) % self.columns].conj());
                    let (sum, difference) = (here + there, here - there);
                    let at = j * self.rows + 2 * pair;
                    lines[at] = sum * 0.5;
                    if 2 * pair + 1 < filled {
                        lines[at + 1] = C64::new(0.5 * difference.im, -0.5 * difference.re);
                    }
                }
            }
            self.along_column[0].process(lines);
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
    /// The spectrum must be that of two even real fields a + i b, as of autocorrelations: `spectrum(-k) = spectrum(k)`.
    /// `take` is handed each of the rows 0 to `wanted - 1` and its results are returned in that order.
    pub fn inverse_even<T: Send>(
        &self,
        mut spectrum: Vec<C64>,
        wanted: usize,
        take: impl Fn(usize, &[C64]) -> T + Sync,
    ) -> Vec<T> {
        spectrum.par_chunks_mut(self.rows * BLOCK).for_each(|lines| self.along_column[1].process(lines));
        let row_of = |row: usize| {
            let mut line = vec![C64::default(); self.columns];
            let mirrored = (self.rows - row) % self.rows;
            for (kx, cell) in line.iter_mut().enumerate() {
                let from =
                    if kx < self.half() { kx * self.rows + row } else { (self.columns - kx) * self.rows + mirrored };
                *cell = spectrum[from];
            }
            self.along_row[1].process(&mut line);
            take(row, &line)
        };
        (0..wanted).into_par_iter().map(row_of).collect()
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
        let spectrum = fft.forward(filled, fft.half(), fill);
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
            let one = fft.forward(filled, fft.half(), |row, line| {
                line.iter_mut().enumerate().for_each(|(column, cell)| *cell = C64::new(sample(row, column), 0.0));
            });
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
            let mut power = fft.forward(rows, fft.half(), fill);
            for c in &mut power {
                *c = C64::new(c.norm_sqr(), -2.0 * c.norm_sqr());
            }
            let lags = fft.inverse_even(power, rows, |_, line| line.to_vec());
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
