//! Noise of a model without fields: white noise with a spectrum that depends on how strong the noise of a place is, and at edges of the face what a
//! lateral shift of its elevations makes.
//!
//! Where a face is steep, a matcher that finds a point a little beside its place errs by `z(x + d) - z(x)` (Handa and others 2014, ICRA; Barron and
//! Malik 2013, CVPR). Such errors go along edges and not across them, so a shift in Y is correlated farther along X, and one in X along Y.
//! What a shift makes is divided by its own deviation, so that the strength by place stays the one that was learnt.

use rayon::prelude::*;

use crate::matching::noise::matcher::Keys;
use crate::matching::noise::modulation::smooth_field;
use crate::matching::noise::spline::{Spline, mirrored};
use rockface_core::artefact::{LateralShift, Noise, Parametric, PlaceSpectrum};
use rockface_core::numerics::bands::{Bands, at_other_bands};
use rockface_core::numerics::gaussian::{half_kernel, smooth_columns, smooth_rows, smoothed};
use rockface_core::numerics::marginal;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::quantile::median;
use rockface_core::numerics::random::Field;
use rockface_core::numerics::simd::{LANES, Lanes};
use rockface_core::numerics::trend::without_trend;

/// The shorter side over that by which a drawn field is wider than the face: a filter by frequency makes a field that goes on at its other side, and
/// noise does not.
const WIDER: usize = 2;
/// Deviation of the Gaussian that fills elevations which are unknown, cells.
const FILLING_CELLS: f64 = 6.0;
/// Least deviation of an elevation that a shift can change, as a part of `half_m`.
const LEAST_DEVIATION: f64 = 1e-3;

/// Columns and rows of the field that is drawn for a face of some columns and rows.
pub fn drawn_size([columns, rows]: [usize; 2]) -> [usize; 2] {
    let more = columns.min(rows).div_ceil(WIDER);
    [columns + more, rows + more]
}

/// White noise of some columns and rows.
pub fn white([columns, rows]: [usize; 2], field: &Field) -> Vec<f64> {
    (0..columns * rows).map(|i| field.normal((i % columns) as i32, (i / columns) as i32)).collect()
}

/// The part of a field of [`drawn_size`] that lies on the face, of some columns and rows, without its trend: whitened fields are learnt without their
/// trends, which registration left and `draw-registration` gives back.
pub fn level_part(wide: &[f64], [columns, rows]: [usize; 2]) -> Vec<f64> {
    let [wide_columns, _] = drawn_size([columns, rows]);
    let part: Vec<f64> = wide.chunks_exact(wide_columns).take(rows).flat_map(|row| &row[..columns]).copied().collect();
    let rounded: Vec<f32> = part.iter().map(|value| *value as f32).collect();
    without_trend(&rounded, columns, &[]).map_or(part, |level| level.into_iter().map(f64::from).collect())
}

/// Which spectrum and how much of a shift the noise of each cell of a face has.
#[derive(Debug, Clone)]
pub struct Ground {
    /// Place among the spectra of the model: between the one below and the one above.
    places: Vec<f32>,
    edges: Option<Edges>,
}

impl Ground {
    /// Of a face with these strengths (pixels) and elevations (metres, NaN where unknown), cell by cell of the model.
    pub fn new(parametric: &Parametric, strength: &[f32], elevation: &[f32], columns: usize) -> Self {
        let known: Vec<f64> = parametric.spectra.iter().map(|spectrum| spectrum.log_strength).collect();
        let place = |strength: &f32| place_among(&known, portable_math::log(f64::from(strength.max(1e-12)))) as f32;
        let edges = parametric.shift.map(|shift| Edges::new(shift, elevation, columns));
        Self { places: strength.iter().map(place).collect(), edges }
    }

    /// Of the face that a model was learnt on; none for models with fields.
    pub fn of(noise: &Noise) -> Option<Self> {
        let parametric = noise.parametric.as_ref()?;
        Some(Self::new(parametric, &noise.strength, &noise.elevation, noise.grid.columns))
    }
}

/// Place of a value among ascending ones: whole at each of them, linear between, and at the ends beyond.
fn place_among(ascending: &[f64], value: f64) -> f64 {
    let above = ascending.partition_point(|known| *known <= value);
    if above == 0 || above == ascending.len() {
        return above.saturating_sub(1) as f64;
    }
    let (low, high) = (ascending[above - 1], ascending[above]);
    (above - 1) as f64 + (value - low) / (high - low).max(1e-12)
}

/// What a lateral shift makes of the elevations of a face.
#[derive(Debug, Clone)]
pub struct Edges {
    /// The shift.
    pub shift: LateralShift,
    /// Metres above the middle one.
    elevation: Spline,
    columns: usize,
    /// Mean elevation under the shift, metres above the middle one.
    mean_m: Vec<f64>,
    /// Deviation of the elevation under the shift, metres.
    deviation_m: Vec<f64>,
    /// Whether the elevation of a cell is known.
    known: Vec<bool>,
}

impl Edges {
    /// For elevations in metres, NaN where unknown.
    pub fn new(shift: LateralShift, elevation: &[f32], columns: usize) -> Self {
        let above = above_middle(elevation, columns);
        let kernel = half_kernel(shift.deviation_cells);
        let under = |values: &[f64]| smooth_columns(&smooth_rows(values, columns, &kernel), columns, &kernel);
        let mean_m = under(&above);
        let squares = under(&above.iter().map(|z| z * z).collect::<Vec<_>>());
        let deviation_m = squares.iter().zip(&mean_m).map(|(square, mean)| (square - mean * mean).max(0.0).sqrt());
        Self {
            shift,
            deviation_m: deviation_m.collect(),
            mean_m,
            known: elevation.iter().map(|z| !z.is_nan()).collect(),
            elevation: Spline::new(above.iter().map(|z| *z as f32).collect(), columns),
            columns,
        }
    }

    /// For a shift of the same deviation.
    #[must_use]
    pub fn with(&self, shift: LateralShift) -> Self {
        Self { shift, ..self.clone() }
    }

    /// Deviation of the elevation under the shift, metres; 0 where it is unknown.
    pub fn deviations_m(&self) -> impl Iterator<Item = f64> {
        self.deviation_m.iter().zip(&self.known).map(|(deviation_m, known)| if *known { *deviation_m } else { 0.0 })
    }

    /// The part of the variance of the noise of a cell that is owed to the shift.
    fn variance_share(&self, cell: usize) -> f64 {
        let LateralShift { share, half_m, .. } = self.shift;
        let square = self.deviation_m[cell] * self.deviation_m[cell];
        if self.known[cell] && square > 0.0 { share * square / (square + half_m * half_m) } else { 0.0 }
    }

    /// What shifts make of a field of some columns and rows whose upper left part is the face, of unit variance, and the part of the noise's variance it
    /// is owed; beyond the edges of the face it goes on mirrored. Streams `noise-shift`.
    pub fn field(&self, [columns, rows]: [usize; 2], keys: Keys) -> Vec<[f64; 2]> {
        let extent = [columns as f64, rows as f64];
        let shifts =
            ["x", "y"].map(|axis| smooth_field(&keys("noise-shift", axis), self.shift.across_cells, [0.0; 2], extent));
        // Elevations of a level edge change with a shift in Y, which goes along the edge.
        let along = self.shift.across_cells / self.shift.length_cells;
        let least = LEAST_DEVIATION * self.shift.half_m;
        let mut field = vec![[0.0; 2]; columns * rows];
        field.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
            let own_row = mirrored(row as f64 + 0.5, self.mean_m.len() / self.columns) * self.columns;
            for (block, line) in line.chunks_mut(LANES).enumerate() {
                let at = [Lanes::of(|lane| (block * LANES + lane) as f64 + 0.5), Lanes::all(row as f64 + 0.5)];
                let drawn = [shifts[0].at_lanes([at[0], at[1] * along]), shifts[1].at_lanes([at[0] * along, at[1]])];
                let moved = [0, 1].map(|axis| at[axis] + drawn[axis] * self.shift.deviation_cells);
                let z = self.elevation.at_lanes(moved);
                for (lane, value) in line.iter_mut().enumerate() {
                    let cell = own_row + mirrored(at[0][lane], self.columns);
                    let unit = (z[lane] - self.mean_m[cell]) / self.deviation_m[cell].max(least);
                    *value = [unit, self.variance_share(cell)];
                }
            }
        });
        field
    }
}

/// Elevations above the middle one, whose squares do not hide how little a shift changes them, with gaps filled.
fn above_middle(elevation: &[f32], columns: usize) -> Vec<f64> {
    let mut known = marginal::known(elevation);
    let (whole, middle) = (known.len() == elevation.len(), median(&mut known).unwrap_or(0.0));
    let above: Vec<f32> = elevation.iter().map(|z| (f64::from(*z) - middle) as f32).collect();
    // Where nothing is in reach the filling is 0, the middle.
    let filling = if whole { Vec::new() } else { smoothed(&above, columns, FILLING_CELLS) };
    let one = |(i, z): (usize, &f32)| if z.is_nan() { filling[i] } else { f64::from(*z) };
    above.iter().enumerate().map(one).collect()
}

/// A field of [`drawn_size`] for a face: filtered white noise, and what shifts make. About of unit variance.
///
/// Streams `noise-shift`.
pub fn field(
    parametric: &Parametric,
    ground: &Ground,
    white: &[f64],
    [columns, rows]: [usize; 2],
    [own_columns, own_rows]: [usize; 2],
    keys: Keys,
) -> Vec<f64> {
    let bands = Bands::new(columns, rows, parametric.spectra[0].log_amplitude.len());
    let white = bands.spectrum(white);
    let filtered = |spectrum: &PlaceSpectrum| {
        let (from, to) = (own_columns.min(own_rows), columns.min(rows));
        let mut field = white.clone().filtered(&at_other_bands(&spectrum.log_amplitude, from, to, 1.0));
        let rms = product(&field, &field).sqrt().max(f64::MIN_POSITIVE);
        field.iter_mut().for_each(|value| *value /= rms);
        field
    };
    let fields: Vec<Vec<f64>> = parametric.spectra.iter().map(filtered).collect();
    let alike: Vec<f64> = fields.windows(2).map(|pair| product(&pair[0], &pair[1])).collect();
    let mut mixed = vec![0.0; columns * rows];
    mixed.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        let own_row = mirrored(row as f64 + 0.5, own_rows) * own_columns;
        for (column, value) in line.iter_mut().enumerate() {
            let cell = own_row + mirrored(column as f64 + 0.5, own_columns);
            let place = f64::from(ground.places[cell]);
            let (below, i) = (place as usize, row * columns + column);
            let (low, high) = (1.0 - (place - below as f64), place - below as f64);
            *value = match fields.get(below + 1) {
                Some(above) if high > 0.0 => {
                    let variance = low * low + high * high + 2.0 * low * high * alike[below];
                    (low * fields[below][i] + high * above[i]) / variance.max(1e-12).sqrt()
                }
                _ => fields[below][i],
            };
        }
    });
    if let Some(edges) = &ground.edges {
        let shifted = edges.field([columns, rows], keys);
        for (value, [unit, share]) in mixed.iter_mut().zip(shifted) {
            *value = *value * (1.0 - share).sqrt() + unit * share.sqrt();
        }
    }
    mixed
}

/// Mean product of two fields.
fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / a.len() as f64
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that are exact
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    const COLUMNS: usize = 120;
    const ROWS: usize = 90;

    /// A face with a level edge of a metre in the middle of its height, drawn out over some cells.
    fn edge() -> Vec<f32> {
        let height = |row: f64| 300.0 + ((row - 45.0) / 6.0).clamp(-0.5, 0.5);
        (0..COLUMNS * ROWS).map(|i| height((i / COLUMNS) as f64 + 0.5) as f32).collect()
    }

    fn shift() -> LateralShift {
        LateralShift { deviation_cells: 1.0, length_cells: 8.0, across_cells: 2.0, share: 0.8, half_m: 0.02 }
    }

    fn keys(seed: u8) -> impl Fn(&str, &str) -> Key {
        move |purpose, item| {
            let mut key = [seed; 32];
            key[..2].copy_from_slice(&[purpose.len() as u8, item.bytes().last().unwrap_or(0)]);
            Key(key)
        }
    }

    #[test]
    fn a_shift_makes_noise_of_unit_variance_that_goes_along_edges_and_not_across_them() {
        let edges = Edges::new(shift(), &edge(), COLUMNS);
        let (mut square, mut along, mut across, mut count) = (0.0, 0.0, 0.0, 0.0);
        for seed in 0..60 {
            let field = edges.field([COLUMNS, ROWS], &keys(seed));
            assert!(field[3 * COLUMNS][1] < 1e-6);
            for column in 0..COLUMNS - 6 {
                let [here, right, below] =
                    [(45, column), (45, column + 6), (51, column)].map(|(row, column)| field[row * COLUMNS + column]);
                (square, count) = (square + here[0] * here[0], count + 1.0);
                (along, across) = (along + here[0] * right[0], across + here[0] * below[0]);
                assert!((0.75..0.8).contains(&here[1]), "{here:?}");
            }
        }
        let [square, along, across] = [square, along, across].map(|sum| sum / count);
        assert!((square - 1.0).abs() < 0.15, "{square}");
        // A shift that goes on along the edge for 8 cells is felt 6 cells beyond it by its tail alone.
        assert!(along > 0.6 && across < along, "{along} {across}");
    }

    #[test]
    fn faces_without_relief_or_elevations_have_no_edges() {
        for elevation in [vec![5.0; COLUMNS * ROWS], vec![f32::NAN; COLUMNS * ROWS]] {
            let edges = Edges::new(shift(), &elevation, COLUMNS);
            let field = edges.field([COLUMNS + 9, ROWS + 9], &keys(1));
            assert!(field.iter().all(|value| *value == [0.0, 0.0]));
        }
        let mut gap = edge();
        gap[45 * COLUMNS + 60] = f32::NAN;
        let edges = Edges::new(shift(), &gap, COLUMNS);
        let field = edges.field([COLUMNS, ROWS], &keys(1));
        assert!(field[45 * COLUMNS + 60][1] == 0.0 && field[45 * COLUMNS + 59][1] > 0.7);
    }

    #[test]
    fn quiet_places_have_one_spectrum_and_noisy_ones_another() {
        let spectrum = |log_strength: f64, fine: f64| PlaceSpectrum {
            log_strength,
            log_amplitude: (0..5).map(|band| if band < 3 { 0.0 } else { fine }).collect(),
        };
        let parametric = Parametric { spectra: vec![spectrum(-2.0, -4.0), spectrum(-1.0, 0.0)], shift: None };
        let strength: Vec<f32> =
            (0..COLUMNS * ROWS).map(|i| if i % COLUMNS < COLUMNS / 2 { 0.05 } else { 0.9 }).collect();
        let ground = Ground::new(&parametric, &strength, &vec![0.0; COLUMNS * ROWS], COLUMNS);
        let own = [COLUMNS, ROWS];
        let size = drawn_size(own);
        let white = white(size, &Key([3; 32]).field());
        let drawn = field(&parametric, &ground, &white, size, own, &keys(1));
        let steps = |columns: std::ops::Range<usize>| {
            let rows = drawn.chunks_exact(size[0]).take(ROWS);
            let steps = rows.flat_map(|row| columns.clone().map(|column| row[column + 1] - row[column]));
            (steps.map(|step| step * step).sum::<f64>() / (ROWS * columns.len()) as f64).sqrt()
        };
        let (quiet, noisy) = (steps(5..COLUMNS / 2 - 5), steps(COLUMNS / 2 + 5..COLUMNS - 5));
        assert!(quiet < 0.5 && (noisy - std::f64::consts::SQRT_2).abs() < 0.1, "{quiet} {noisy}");
    }

    #[test]
    fn places_lie_between_the_spectra_that_are_known() {
        let at = |value: f64| place_among(&[-2.0, -1.0, 1.0], value);
        assert_eq!([-3.0, -2.0, -1.5, -1.0, 0.0, 1.0, 4.0].map(at), [0.0, 0.0, 0.5, 1.0, 1.5, 2.0, 2.0]);
    }
}
