//! Bands of frequency of a raster: amplitudes in bands of equal width in ln f, and a filter that multiplies them.
//!
//! Band b of n is centred on `f0 (0.5 / f0)^((b + 0.5) / (n - 1))` cycles a cell, where f0 is one cycle over the shorter side, so that the
//! last one lies beyond 0.5, where only waves across both axes are; between centres weights are linear in ln f, beyond the outermost ones
//! constant. White noise of unit variance has power 1 in all.

use crate::numerics::fft::{C64, Fft2};
use crate::numerics::portable_math;

/// The bands of rasters of one size.
pub struct Bands {
    /// Number of bands, at least 2.
    pub count: usize,
    forward: Fft2,
    backward: Fft2,
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
        Self { count, forward: Fft2::new(columns, rows), backward: Fft2::new(rows, columns), places }
    }

    /// Cells of a raster.
    fn cells(&self) -> usize {
        self.forward.columns * self.forward.rows
    }

    /// The band below a frequency, and the weight of the one above it.
    fn place(&self, kx: usize, ky: usize) -> (usize, f64) {
        let (columns, rows) = (self.forward.columns, self.forward.rows);
        let at = self.places[kx.min(columns - kx) * (rows / 2 + 1) + ky.min(rows - ky)];
        let below = (at as usize).min(self.count - 2);
        (below, at - below as f64)
    }

    /// The spectrum of a raster, column by column.
    fn spectrum(&self, values: &[f64]) -> Vec<C64> {
        let (columns, rows) = (self.forward.columns, self.forward.rows);
        self.forward.forward(rows, columns, |row, line| {
            line.iter_mut().zip(&values[row * columns..]).for_each(|(cell, value)| *cell = C64::new(*value, 0.0));
        })
    }

    /// Mean power in each band, that of white noise of unit variance being 1. The mean of the raster takes no part.
    pub fn power(&self, values: &[f64]) -> Vec<f64> {
        let mut sums = vec![[0.0; 2]; self.count];
        for (kx, column) in self.spectrum(values).chunks_exact(self.forward.rows).enumerate() {
            for (ky, amplitude) in column.iter().enumerate().skip(usize::from(kx == 0)) {
                let (below, above) = self.place(kx, ky);
                for (band, weight) in [(below, 1.0 - above), (below + 1, above)] {
                    sums[band][0] += weight * amplitude.norm_sqr();
                    sums[band][1] += weight;
                }
            }
        }
        sums.iter().map(|[power, weight]| power / (weight.max(1e-12) * self.cells() as f64)).collect()
    }

    /// How much of the variance of white noise lies in each band; adds up to 1.
    pub fn shares(&self) -> Vec<f64> {
        let mut shares = vec![0.0; self.count];
        for kx in 0..self.forward.columns {
            for ky in usize::from(kx == 0)..self.forward.rows {
                let (below, above) = self.place(kx, ky);
                shares[below] += 1.0 - above;
                shares[below + 1] += above;
            }
        }
        let total: f64 = shares.iter().sum();
        shares.iter().map(|share| share / total).collect()
    }

    /// Multiplies the amplitudes of a raster by `exp(log_gain)`, interpolated between bands.
    pub fn filter(&self, values: &[f64], log_gain: &[f64]) -> Vec<f64> {
        let (columns, rows) = (self.forward.columns, self.forward.rows);
        let spectrum = self.spectrum(values);
        // The inverse of a transform is the conjugate of the transform of the conjugate.
        let back = self.backward.forward(columns, rows, |kx, line| {
            for (ky, cell) in line.iter_mut().enumerate() {
                let (below, above) = self.place(kx, ky);
                let gain = portable_math::exp(log_gain[below] * (1.0 - above) + log_gain[below + 1] * above);
                *cell = spectrum[kx * rows + ky].conj() * gain;
            }
        });
        back.iter().map(|value| value.re / self.cells() as f64).collect()
    }

    /// Correlation of a raster with itself at lags of 0, 1, 2, ... cells, mean over rows and columns, up to half the shorter side;
    /// as if the raster went on cyclically.
    pub fn correlation(&self, values: &[f64]) -> Vec<f64> {
        let (columns, rows) = (self.forward.columns, self.forward.rows);
        let mut power = self.spectrum(values);
        power.truncate(self.forward.half() * rows);
        power.iter_mut().for_each(|value| *value = C64::new(value.norm_sqr(), 0.0));
        power[0] = C64::default();
        let lags = (columns.min(rows) / 2).max(1);
        let lines = self.forward.inverse_even(power, lags, |row, line| {
            let along: Vec<f64> =
                if row == 0 { line[..lags].iter().map(|value| value.re).collect() } else { Vec::new() };
            (line[0].re, along)
        });
        let variance = lines[0].0.max(1e-300);
        let along = &lines[0].1;
        lines.iter().zip(along).map(|((down, _), along)| 0.5 * (down + along) / variance).collect()
    }
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
        let same = bands.filter(&noise, &[0.0; 6]);
        assert!(noise.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!((bands.shares().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_filter_multiplies_the_amplitudes_of_its_band() {
        let bands = Bands::new(90, 120, 5);
        let noise = white(90, 120);
        let before = bands.power(&noise);
        let after = bands.power(&bands.filter(&noise, &[0.4; 5]));
        assert!(before.iter().zip(&after).all(|(a, b)| (b / a - portable_math::exp(0.8)).abs() < 1e-9));
        let low = bands.filter(&noise, &[1.0, 1.0, 0.0, -3.0, -6.0]);
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
