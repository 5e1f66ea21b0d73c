//! The radial power spectrum of a raster with gaps, its slope and its entropy (paper 2.2.3, equations 10 to 12).
//!
//! The mean, weighted by a symmetric Hann window times the mask w, is taken away; cells without a value become 0;
//! P = |F(w z)|^2 / sum w^2. Radial bins are df = 1 / (shorter extent) wide and centred on k df, k = 1 up to the Nyquist
//! frequency; corners beyond are dropped.

use crate::noise::sector::Sector;
use rockface_core::numerics::fft::{AlongRows, C64, Fft2};
use rockface_core::numerics::linear_fit::{Line, fit_line};
use rockface_core::numerics::portable_math;

/// The radially averaged power spectrum.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Centre frequencies, cycles a unit of the cell size (1/m), M of them.
    pub frequency: Vec<f64>,
    /// Mean power of the samples in the bin, square of the unit of the values.
    pub power: Vec<f64>,
    /// Samples in the bin, of the full plane.
    pub samples: Vec<f64>,
    /// The Nyquist frequency in bins: half the cells of the shorter side.
    pub nyquist_bins: f64,
}

/// Logarithmic bins the slope is fitted to.
const SLOPE_BINS: usize = 16;
/// First radial bin used for the slope.
const SLOPE_FROM: f64 = 4.0;

impl Spectrum {
    /// Entropy of the power normalised to sum 1, natural logarithm (equations 11 and 12).
    pub fn entropy(&self) -> f64 {
        let total: f64 = self.power.iter().sum();
        let shares = self.power.iter().map(|p| p / total).filter(|p| *p > 0.0);
        -shares.map(|p| p * portable_math::log(p)).sum::<f64>()
    }

    /// Entropy as a share of its largest value ln M.
    pub fn entropy_normalised(&self) -> f64 {
        self.entropy() / portable_math::log(self.power.len() as f64)
    }

    /// Line through ln P over ln f from 4 df to half the Nyquist frequency, both included.
    ///
    /// Radial bins are first averaged (P, and ln f) in 16 bins of equal width in ln f; otherwise the many bins at high
    /// frequencies would outweigh the others. `None` where fewer than two of these have samples and power.
    pub fn slope(&self) -> Option<Line> {
        let step = self.frequency.first()?;
        let to = 0.5 * self.nyquist_bins;
        let width = portable_math::log(to / SLOPE_FROM) / SLOPE_BINS as f64;
        let edge =
            |bin: usize| if bin == SLOPE_BINS { to } else { SLOPE_FROM * portable_math::exp(width * bin as f64) };
        let mut points = Vec::new();
        for bin in 0..SLOPE_BINS {
            // A whole k that meets an edge belongs above it, however the edge was rounded.
            let reaches = |k: f64, edge: f64| k >= edge * (1.0 - 1e-12);
            let last = bin + 1 == SLOPE_BINS;
            let inside = |k: f64| reaches(k, edge(bin)) && if last { k <= to } else { !reaches(k, edge(bin + 1)) };
            let members: Vec<usize> = (0..self.power.len()).filter(|i| inside((i + 1) as f64)).collect();
            let n = members.len() as f64;
            let power: f64 = members.iter().map(|i| self.power[*i]).sum::<f64>() / n;
            let log_k: f64 = members.iter().map(|i| portable_math::log((i + 1) as f64)).sum::<f64>() / n;
            if !members.is_empty() && power > 0.0 {
                points.push((log_k + portable_math::log(*step), portable_math::log(power)));
            }
        }
        fit_line(&points)
    }
}

/// The spectrum of `columns` columns of values by row (NaN = none); `cell` is the side of a cell.
///
/// `None` where the shorter side has fewer than two cells or no weight falls on cells with a value.
pub fn spectrum(values: &[f32], columns: usize, cell: f64) -> Option<Spectrum> {
    spectra(values, columns, cell, &[]).map(|(all, _)| all)
}

/// The spectrum over all directions, and those of the frequencies in the [`Sector`] about each of some directions (degrees
/// counter-clockwise from the rows' direction), whose bins without samples have no power (NaN). A field that varies fast along
/// X has its power about 0 degrees.
pub fn spectra(values: &[f32], columns: usize, cell: f64, directions_deg: &[f64]) -> Option<(Spectrum, Vec<Spectrum>)> {
    let rows = values.len() / columns;
    let shorter = columns.min(rows);
    if shorter < 2 {
        return None;
    }
    let (across, down) = (hann(columns), hann(rows));
    let (mean, weight_squares) = weighted_mean(values, &across, &down)?;
    let fft = Fft2::new(columns, rows);
    let transformed = fft.along_real_rows(rows, |row, cells| {
        for (column, out) in cells.iter_mut().enumerate() {
            let value = values[row * columns + column];
            *out = if value.is_nan() { 0.0 } else { across[column] * down[row] * (f64::from(value) - mean) };
        }
    });
    let sectors = directions_deg.iter().map(|deg| Some(Sector::about(*deg)));
    let sectors: Vec<Option<Sector>> = std::iter::once(None).chain(sectors).collect();
    let spectrum = |sums: Vec<[f64; 2]>| Spectrum {
        frequency: (1..sums.len()).map(|k| k as f64 / (cell * shorter as f64)).collect(),
        power: sums[1..].iter().map(|[n, p]| p / (n * weight_squares)).collect(),
        samples: sums[1..].iter().map(|[n, _]| *n).collect(),
        nyquist_bins: 0.5 * shorter as f64,
    };
    let mut spectra = radial_sums(&transformed, [columns, rows], &sectors).into_iter().map(spectrum);
    Some((spectra.next()?, spectra.collect()))
}

/// Samples and power by radial bin, from 0, for each of some sectors.
fn radial_sums(transformed: &AlongRows, [columns, rows]: [usize; 2], sectors: &[Option<Sector>]) -> Vec<Vec<[f64; 2]>> {
    let bins = columns.min(rows) / 2;
    let of_column = |kx: usize, line: &[C64]| {
        let of_sector = |sector: &Option<Sector>| column_bins(line, kx, columns, bins, *sector);
        sectors.iter().map(of_sector).collect::<Vec<_>>()
    };
    let mut sums = vec![vec![[0.0; 2]; bins + 1]; sectors.len()];
    for column in transformed.map_columns(of_column) {
        for (sums, add) in sums.iter_mut().zip(column) {
            sums.iter_mut().zip(add).for_each(|(sum, add)| *sum = [sum[0] + add[0], sum[1] + add[1]]);
        }
    }
    sums
}

/// Samples and power by radial bin in one column of the half plane; inner columns stand for their mirror image too.
fn column_bins(line: &[C64], kx: usize, columns: usize, bins: usize, sector: Option<Sector>) -> Vec<[f64; 2]> {
    let rows = line.len();
    let shorter = columns.min(rows) as f64;
    let copies = if kx == 0 || 2 * kx == columns { 1.0 } else { 2.0 };
    let x = kx as f64 * shorter / columns as f64;
    let mut sums = vec![[0.0; 2]; bins + 1];
    for (ky, value) in line.iter().enumerate() {
        let y = ky.min(rows - ky) as f64 * shorter / rows as f64;
        let bin = ((x * x + y * y).sqrt() + 0.5).floor() as usize;
        let down = if 2 * ky > rows { -y } else { y };
        if (1..=bins).contains(&bin) && sector.is_none_or(|sector| sector.contains(x, down)) {
            sums[bin] = [sums[bin][0] + copies, sums[bin][1] + copies * value.norm_sqr()];
        }
    }
    sums
}

/// The symmetric Hann window: 0 at the first and last of `n` cells.
fn hann(n: usize) -> Vec<f64> {
    let turn = std::f64::consts::TAU / (n.max(2) - 1) as f64;
    (0..n).map(|i| 0.5 - 0.5 * portable_math::cos(turn * i as f64)).collect()
}

/// Mean of the values under the windowed mask, and the sum of its squares.
fn weighted_mean(values: &[f32], across: &[f64], down: &[f64]) -> Option<(f64, f64)> {
    let (mut weights, mut squares, mut sum) = (0.0, 0.0, 0.0);
    for (line, wy) in values.chunks_exact(across.len()).zip(down) {
        for (value, wx) in line.iter().zip(across).filter(|(value, _)| !value.is_nan()) {
            let w = wx * wy;
            (weights, squares, sum) = (weights + w, squares + w * w, sum + w * f64::from(*value));
        }
    }
    (squares > 0.0).then(|| (sum / weights, squares))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    fn noise(columns: usize, rows: usize) -> Vec<f32> {
        let field = Key([8; 32]).field();
        (0..columns * rows).map(|i| field.normal((i % columns) as i32, (i / columns) as i32) as f32).collect()
    }

    #[test]
    fn white_noise_is_flat() {
        let found = spectrum(&noise(250, 200), 250, 0.01).unwrap();
        assert_eq!((found.power.len(), found.nyquist_bins), (100, 100.0));
        let slope = found.slope().unwrap().slope;
        assert!(slope.abs() < 0.1, "slope {slope}");
        assert!(found.entropy_normalised() > 0.98);
        let level =
            found.power.iter().zip(&found.samples).map(|(p, n)| p * n).sum::<f64>() / found.samples.iter().sum::<f64>();
        assert!((level - 1.0).abs() < 0.03, "power is the variance: {level}");
    }

    #[test]
    fn a_wave_lies_in_its_own_bin() {
        let wave = |i: usize| portable_math::sin(std::f64::consts::TAU * 12.0 * (i % 120) as f64 / 120.0) as f32;
        let values: Vec<f32> = (0..120 * 120).map(wave).collect();
        let found = spectrum(&values, 120, 0.5).unwrap();
        let strongest = (0..60).max_by(|a, b| found.power[*a].total_cmp(&found.power[*b])).unwrap();
        assert_eq!(strongest + 1, 12);
        assert!((found.frequency[11] - 12.0 / 60.0).abs() < 1e-15);
    }

    #[test]
    fn a_wave_has_its_power_along_itself() {
        // Crests run up to the right (rows go down), so it varies fastest at 135 degrees.
        let wave = |i: usize| {
            let turns = 9.0 * ((i % 100) as f64 + (i / 100) as f64) / 100.0;
            portable_math::sin(std::f64::consts::TAU * turns) as f32
        };
        let values: Vec<f32> = (0..10_000).map(wave).collect();
        let (all, sectors) = spectra(&values, 100, 1.0, &[0.0, 45.0, 90.0, 135.0]).unwrap();
        let power =
            |s: &Spectrum| s.power.iter().zip(&s.samples).filter(|(_, n)| **n > 0.0).map(|(p, n)| p * n).sum::<f64>();
        assert!(power(&sectors[3]) > 0.95 * power(&all));
        assert!((sectors.iter().map(power).sum::<f64>() / power(&all) - 1.0).abs() < 0.01);
    }

    #[test]
    fn summed_noise_has_the_slope_of_its_filter() {
        // Differences of neighbours along both axes have |1 - e^ix|^2 |1 - e^iy|^2: power grows towards high frequencies.
        let white = noise(201, 201);
        let at = |r: usize, c: usize| white[r * 201 + c];
        let rough: Vec<f32> = (0..200 * 200)
            .map(|i| (i / 200, i % 200))
            .map(|(r, c)| at(r, c) - at(r + 1, c) - at(r, c + 1) + at(r + 1, c + 1))
            .collect();
        let slope = spectrum(&rough, 200, 1.0).unwrap().slope().unwrap().slope;
        assert!((3.5..4.2).contains(&slope), "slope {slope}");
    }

    #[test]
    fn nothing_to_transform_is_none() {
        assert_eq!(spectrum(&[1.0; 5], 5, 1.0), None);
        assert_eq!(spectrum(&[f32::NAN; 25], 5, 1.0), None);
    }
}
