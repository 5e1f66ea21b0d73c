//! Bands of frequency of a raster: amplitudes in bands of equal width in ln f, and a filter that multiplies them.
//!
//! Band b of n is centred on `f0 (0.5 / f0)^((b + 0.5) / (n - 1))` cycles a cell, where f0 is one cycle over the shorter side, so that the
//! last one lies beyond 0.5, where only waves across both axes are; between centres weights are linear in ln f, beyond the outermost ones
//! constant. White noise of unit variance has power 1 in all.

use rayon::prelude::*;

use crate::numerics::fft::{C64, Fft2};
use crate::numerics::portable_math;

/// The bands of rasters of one size.
pub struct Bands {
    /// Number of bands, at least 2.
    pub count: usize,
    fft: Fft2,
    /// Place of each frequency among the bands: those of the first half of the columns, for the first half of the rows each.
    places: Vec<f64>,
}

impl Bands {
    /// Bands of rasters of `columns` x `rows` cells, each at least 4; `count` is at least 2.
    pub fn new(columns: usize, rows: usize, count: usize) -> Self {
        let lowest = 1.0 / columns.min(rows) as f64;
        let width = portable_math::log(0.5 / lowest);
        let place = |kx: usize, ky: usize| {
            let (fx, fy) = (kx as f64 / columns as f64, ky as f64 / rows as f64);
            let share = portable_math::log((fx * fx + fy * fy).sqrt().max(lowest) / lowest) / width;
            (share * (count - 1) as f64 - 0.5).clamp(0.0, (count - 1) as f64)
        };
        let places = (0..=columns / 2).flat_map(|kx| (0..=rows / 2).map(move |ky| (kx, ky)));
        let places = places.map(|(kx, ky)| place(kx, ky)).collect();
        Self { count, fft: Fft2::new(columns, rows), places }
    }

    /// The band below a frequency of the first half of the columns, and the weight of the one above it.
    fn place(&self, kx: usize, ky: usize) -> (usize, f64) {
        let rows = self.fft.rows;
        let at = self.places[kx * (rows / 2 + 1) + ky.min(rows - ky)];
        let below = (at as usize).min(self.count - 2);
        (below, at - below as f64)
    }

    /// The spectrum of a raster.
    pub fn spectrum(&self, values: &[f64]) -> Spectrum<'_> {
        let (columns, rows) = (self.fft.columns, self.fft.rows);
        let row = |row: usize, line: &mut [f64]| line.copy_from_slice(&values[row * columns..(row + 1) * columns]);
        Spectrum { bands: self, amplitudes: self.fft.forward_real(rows, row) }
    }

    /// As [`Spectrum::power`].
    pub fn power(&self, values: &[f64]) -> Vec<f64> {
        self.spectrum(values).power()
    }

    /// How much of the variance of white noise lies in each band; adds up to 1.
    pub fn shares(&self) -> Vec<f64> {
        let weights = self.sums(|_| [1.0, 0.0]);
        let total: f64 = weights.iter().map(|[weight, _]| weight).sum();
        weights.iter().map(|[weight, _]| weight / total).collect()
    }

    /// Sums over all frequencies but that of the mean, band by band, of what `of` says of the places `kx * rows + ky`.
    fn sums(&self, of: impl Fn(usize) -> [f64; 2]) -> Vec<[f64; 2]> {
        let (columns, rows) = (self.fft.columns, self.fft.rows);
        let mut sums = vec![[0.0; 2]; self.count];
        for kx in 0..self.fft.half() {
            // Columns that are left out mirror the others.
            let times = if kx == 0 || 2 * kx == columns { 1.0 } else { 2.0 };
            for ky in usize::from(kx == 0)..rows {
                let (below, above) = self.place(kx, ky);
                let values = of(kx * rows + ky);
                for (band, weight) in [(below, times * (1.0 - above)), (below + 1, times * above)] {
                    sums[band].iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
        sums
    }

    /// Correlation of a raster with itself at lags of 0, 1, 2, ... cells, mean over rows and columns, up to half the shorter side;
    /// as if the raster went on cyclically.
    pub fn correlation(&self, values: &[f64]) -> Vec<f64> {
        let (columns, rows) = (self.fft.columns, self.fft.rows);
        let row = |row: usize, line: &mut [f64]| line.copy_from_slice(&values[row * columns..(row + 1) * columns]);
        let transformed = self.fft.along_real_rows(rows, row);
        let power = |first: usize, lines: &mut [C64]| {
            transformed.columns(first.., lines);
            lines.iter_mut().for_each(|value| *value = C64::new(value.norm_sqr(), 0.0));
            if first == 0 {
                lines[0] = C64::default();
            }
        };
        let lags = (columns.min(rows) / 2).max(1);
        let lines = self.fft.inverse_even(lags, power, |row, line| {
            let along: Vec<f64> =
                if row == 0 { line[..lags].iter().map(|value| value.re).collect() } else { Vec::new() };
            (line[0].re, along)
        });
        let variance = lines[0].0.max(1e-300);
        let along = &lines[0].1;
        lines.iter().zip(along).map(|((down, _), along)| 0.5 * (down + along) / variance).collect()
    }
}

/// The spectrum of a raster of real values.
#[derive(Clone)]
pub struct Spectrum<'a> {
    bands: &'a Bands,
    /// Amplitudes of the first half of the columns, column by column.
    amplitudes: Vec<C64>,
}

impl Spectrum<'_> {
    /// Mean power in each band, that of white noise of unit variance being 1. The mean of the raster takes no part.
    pub fn power(&self) -> Vec<f64> {
        let cells = (self.bands.fft.columns * self.bands.fft.rows) as f64;
        let sums = self.bands.sums(|at| [self.amplitudes[at].norm_sqr(), 1.0]);
        sums.iter().map(|[power, weight]| power / (weight.max(1e-12) * cells)).collect()
    }

    /// The raster with its amplitudes multiplied by `exp(log_gain)`, interpolated between bands.
    pub fn filtered(mut self, log_gain: &[f64]) -> Vec<f64> {
        let (rows, bands) = (self.bands.fft.rows, self.bands);
        let cells = (bands.fft.columns * rows) as f64;
        self.amplitudes.par_chunks_exact_mut(rows).enumerate().for_each(|(kx, column)| {
            for ky in 0..=rows / 2 {
                let (below, above) = bands.place(kx, ky);
                let gain = portable_math::exp(log_gain[below] * (1.0 - above) + log_gain[below + 1] * above) / cells;
                column[ky] *= gain;
                if ky > 0 && 2 * ky < rows {
                    column[rows - ky] *= gain;
                }
            }
        });
        bands.fft.inverse_real(self.amplitudes)
    }
}

/// Logarithm of the root mean square of what has these logarithms of amplitudes, each in its share of the whole.
pub fn log_rms(log_amplitude: &[f64], shares: &[f64]) -> f64 {
    let powers = log_amplitude.iter().zip(shares).map(|(log, share)| share * portable_math::exp(2.0 * log));
    0.5 * portable_math::log(powers.sum::<f64>().max(1e-12))
}

/// Values at the bands of rasters whose shorter side has `from` cells, at the bands of rasters with `to` cells: linear in ln f, constant
/// beyond the outermost bands. A cell of the former is worth `scale` cells of the latter.
pub fn at_other_bands(values: &[f64], from: usize, to: usize, scale: f64) -> Vec<f64> {
    let last = (values.len() - 1) as f64;
    let [width, other_width] = [from, to].map(|side| portable_math::log(0.5 * side as f64) / last);
    let value = |band: usize| {
        // ln f above the lowest frequency of the raster with `from` cells.
        let above = (band as f64 + 0.5) * other_width + portable_math::log(scale * from as f64 / to as f64);
        let at = (above / width - 0.5).clamp(0.0, last);
        let below = (at as usize).min(values.len() - 2);
        values[below] + (at - below as f64) * (values[below + 1] - values[below])
    };
    (0..values.len()).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random::Key;

    fn white(columns: usize, rows: usize) -> Vec<f64> {
        let field = Key([4; 32]).field();
        (0..columns * rows).map(|i| field.normal((i % columns) as i32, (i / columns) as i32)).collect()
    }

    #[test]
    fn white_noise_has_power_one_in_all_bands_and_no_gain_changes_nothing() {
        let bands = Bands::new(120, 90, 6);
        let noise = white(120, 90);
        assert!(
            bands.power(&noise).iter().skip(2).all(|power| (power - 1.0).abs() < 0.15),
            "{:?}",
            bands.power(&noise)
        );
        let same = bands.spectrum(&noise).filtered(&[0.0; 6]);
        assert!(noise.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((bands.shares().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_filter_multiplies_the_amplitudes_of_its_band() {
        // Sides of both parities.
        for (columns, rows) in [(5, 4), (4, 7), (9, 5)] {
            let (bands, noise) = (Bands::new(columns, rows, 3), white(columns, rows));
            let same = bands.spectrum(&noise).filtered(&[0.0; 3]);
            assert!(noise.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-12), "{columns} x {rows}");
        }
        let bands = Bands::new(90, 120, 5);
        let noise = white(90, 120);
        let before = bands.power(&noise);
        let after = bands.power(&bands.spectrum(&noise).filtered(&[0.4; 5]));
        assert!(before.iter().zip(&after).all(|(a, b)| (b / a - portable_math::exp(0.8)).abs() < 1e-9));
        let low = bands.spectrum(&noise).filtered(&[1.0, 1.0, 0.0, -3.0, -6.0]);
        assert!(bands.correlation(&low)[2] > 0.4 && bands.correlation(&noise)[2].abs() < 0.05);
        assert!((bands.correlation(&low)[0] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn values_are_found_at_the_same_frequency_in_bands_of_another_size() {
        let ln_f = |side: usize| -> Vec<f64> {
            let lowest = 1.0 / side as f64;
            let of = |b: usize| portable_math::log(lowest) + (b as f64 + 0.5) / 8.0 * portable_math::log(0.5 / lowest);
            (0..9).map(of).collect()
        };
        let (from, to) = (ln_f(200), ln_f(80));
        let same = at_other_bands(&from, 200, 200, 1.0);
        assert!(same.iter().zip(&from).all(|(a, b)| (a - b).abs() < 1e-12));
        let found = at_other_bands(&from, 200, 80, 1.0);
        assert!(found[..8].iter().zip(&to).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?} {to:?}");
        assert!((found[8] - from[8].min(to[8])).abs() < 1e-12);
        // Where a cell was worth two, a wave of the same number of new cells was one of half as many old ones.
        let wider = at_other_bands(&from, 200, 80, 2.0);
        assert!((wider[3] - to[3] - std::f64::consts::LN_2).abs() < 1e-12);
    }
}
