//! Contrast of the details of a field of noise, which mixing evens out.
//!
//! Gaussians of growing deviation take the field apart into levels of details along x, along y and diagonal, as a Haar pyramid does without leaving
//! out cells. The details of a level are multiplied by powers of their own size and of the strength of those around, so that strong places become
//! stronger and weak ones weaker: the joint statistics of coefficients at neighbouring places and levels are what makes a texture (Portilla and
//! Simoncelli 2000).

use rayon::prelude::*;

use rockface_core::artefact::{Contrast, LevelContrast};
use rockface_core::numerics::gaussian::{half_kernel, smooth_columns, smooth_rows, smoothed};
use rockface_core::numerics::portable_math::{exp, exp_lanes, log_lanes};
use rockface_core::numerics::simd::{LANES, Lanes, Work, vectorised};

/// Deviations of the Gaussians under which the squares of details are the strength near and farther around, in deviations of that of the level.
const LOCAL: [f64; 2] = [1.5, 6.0];
/// Least part of the mean square that a square counts as.
const LEAST_SQUARE: f64 = 1e-3;
/// Largest factor on a detail.
const MOST_FACTOR: f64 = 6.0;

/// Details of one level: along x, along y and diagonal.
type Details = [Vec<f64>; 3];

/// A field without gaps whose details have contrast; the mean square of each level and orientation stays.
pub fn with_contrast(field: Vec<f64>, columns: usize, contrast: &Contrast) -> Vec<f64> {
    let is_none = |level: &LevelContrast| level.own_power.iter().chain(&level.local_power).all(|p| p.abs() <= 0.0);
    changed(field, columns, contrast, is_none, |details, level, cells| {
        raise(details, level, columns, LOCAL.map(|scale| scale * cells));
    })
}

/// A field without gaps whose details have the gains of their orientation.
pub fn with_gains(field: Vec<f64>, columns: usize, contrast: &Contrast) -> Vec<f64> {
    let is_none = |level: &LevelContrast| level.log_gain.iter().all(|gain| gain.abs() <= 0.0);
    changed(field, columns, contrast, is_none, |details, level, _| {
        for (details, log_gain) in details.iter_mut().zip(level.log_gain) {
            let gain = exp(log_gain);
            details.iter_mut().for_each(|detail| *detail *= gain);
        }
    })
}

/// A field whose details `change` has changed, level by level.
fn changed(
    field: Vec<f64>,
    columns: usize,
    contrast: &Contrast,
    is_none: impl Fn(&LevelContrast) -> bool,
    change: impl Fn(&mut Details, &LevelContrast, f64),
) -> Vec<f64> {
    if contrast.levels.iter().all(&is_none) {
        return field;
    }
    let mut coarse = field;
    let mut sum = vec![0.0; coarse.len()];
    for (k, level) in contrast.levels.iter().enumerate() {
        let cells = contrast.finest_cells * f64::from(1u32 << k);
        let (mut details, coarser) = apart(&coarse, columns, &half_kernel(cells));
        if !is_none(level) {
            change(&mut details, level, cells);
        }
        details.iter().for_each(|details| sum.iter_mut().zip(details).for_each(|(sum, detail)| *sum += detail));
        coarse = coarser;
    }
    sum.iter().zip(coarse).map(|(details, rest)| details + rest).collect()
}

/// The details of a field, and what is left of it; they add up to the field.
fn apart(field: &[f64], columns: usize, kernel: &[f64]) -> (Details, Vec<f64>) {
    let (along_x, along_y) = (smooth_rows(field, columns, kernel), smooth_columns(field, columns, kernel));
    let rest = smooth_columns(&along_x, columns, kernel);
    let minus = |a: &[f64]| a.iter().zip(&rest).map(|(a, rest)| a - rest).collect::<Vec<f64>>();
    let (x, y) = (minus(&along_y), minus(&along_x));
    let diagonal = |i: usize| field[i] - rest[i] - x[i] - y[i];
    let diagonal = (0..field.len()).map(diagonal).collect();
    ([x, y, diagonal], rest)
}

/// Multiplies details by powers of their own size and of the strength around.
fn raise(details: &mut Details, powers: &LevelContrast, columns: usize, local_cells: [f64; 2]) {
    let mean_square = |details: &[f64]| details.iter().map(|d| d * d).sum::<f64>() / details.len() as f64;
    let before = details.each_ref().map(|details| mean_square(details).max(f64::MIN_POSITIVE));
    let square = |i: usize| (0..3).map(|o| details[o][i] * details[o][i] / before[o]).sum::<f64>() / 3.0;
    let squares: Vec<f32> = (0..details[0].len()).map(|i| square(i) as f32).collect();
    let mut local = vec![0.0; squares.len()];
    for (power, cells) in powers.local_power.into_iter().zip(local_cells).filter(|(power, _)| power.abs() > 0.0) {
        let around = smoothed(&squares, columns, cells);
        let pieces = local.par_chunks_mut(PIECE).zip(around.par_chunks(PIECE));
        pieces.for_each(|(local, around)| vectorised(AddLogs { local, around, power }));
    }
    for ((details, before), own_power) in details.iter_mut().zip(before).zip(powers.own_power) {
        let pieces = details.par_chunks_mut(PIECE).zip(local.par_chunks(PIECE));
        pieces.for_each(|(details, local)| vectorised(Raise { details, local, own_power, before }));
        let level = (before / mean_square(details).max(f64::MIN_POSITIVE)).sqrt();
        details.iter_mut().for_each(|detail| *detail *= level);
    }
}

/// Cells that a task works on.
const PIECE: usize = 1 << 13;
/// Largest logarithm of a factor, either way; more would be beyond [`MOST_FACTOR`], or nothing.
const MOST_LOG: f64 = 700.0;

/// Logarithm of a square, or of the least one.
#[inline(always)]
fn log_square(square: Lanes) -> Lanes {
    log_lanes(square.map(|square| square.max(LEAST_SQUARE)))
}

/// Adds the logarithms of the strength around cells, times a power.
struct AddLogs<'a> {
    local: &'a mut [f64],
    around: &'a [f64],
    power: f64,
}

impl Work for AddLogs<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { local, around, power } = self;
        for (local, around) in local.chunks_mut(LANES).zip(around.chunks(LANES)) {
            let sum = Lanes::first_of(local) + log_square(Lanes::first_of(around)) * power;
            local.copy_from_slice(&sum.each()[..local.len()]);
        }
    }
}

/// Multiplies details by the power of their own size and of the strength around them.
struct Raise<'a> {
    details: &'a mut [f64],
    /// Logarithms of the factors by the strength around.
    local: &'a [f64],
    own_power: f64,
    /// Mean square of the details.
    before: f64,
}

impl Work for Raise<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { details, local, own_power, before } = self;
        for (details, local) in details.chunks_mut(LANES).zip(local.chunks(LANES)) {
            let detail = Lanes::first_of(details);
            let own = log_square(detail * detail / before) * own_power;
            let log = (own + Lanes::first_of(local)) * 0.5;
            let factor = exp_lanes(log.map(|log| log.clamp(-MOST_LOG, MOST_LOG)));
            let raised = detail * factor.map(|factor| factor.min(MOST_FACTOR));
            details.copy_from_slice(&raised.each()[..details.len()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::portable_math;
    use rockface_core::numerics::random::Key;

    #[test]
    #[allow(clippy::float_cmp)] // to the bit
    fn strong_details_become_stronger_and_coarse_waves_stay() {
        let (columns, rows) = (160, 120);
        let random = Key([7; 32]).field();
        let fine: Vec<f64> =
            (0..columns * rows).map(|i| random.normal((i % columns) as i32, (i / columns) as i32)).collect();
        let of = |field: Vec<f64>, own_power: f64| {
            let level = LevelContrast { own_power: [own_power; 3], ..LevelContrast::default() };
            with_contrast(field, columns, &Contrast { levels: vec![level], ..Contrast::none() })
        };
        let moments = |field: &[f64]| {
            let mean = |of: fn(f64) -> f64| field.iter().map(|v| of(v * v)).sum::<f64>() / field.len() as f64;
            let (second, fourth) = (mean(|square| square), mean(|square| square * square));
            (second, fourth / (second * second))
        };
        assert_eq!(of(fine.clone(), 0.0), fine);
        let (before, _) = moments(&fine);
        let (after, kurtosis) = moments(&of(fine.clone(), 0.5));
        let (_, even) = moments(&of(fine.clone(), -0.3));
        assert!(
            (after / before - 1.0).abs() < 0.1 && kurtosis > 3.6 && even < 2.8,
            "{after} {before} {kurtosis} {even}"
        );
        let coarse =
            |field: &[f64]| smoothed(&field.iter().map(|value| *value as f32).collect::<Vec<_>>(), columns, 6.0);
        let wave = |i: usize| portable_math::sin((i % columns) as f64 / 20.0);
        let both: Vec<f64> = fine.iter().enumerate().map(|(i, fine)| wave(i) + 0.1 * fine).collect();
        let changes = coarse(&both).into_iter().zip(coarse(&of(both, 0.5))).map(|(a, b)| (a - b).abs());
        assert!(changes.fold(0.0, f64::max) < 0.02);
    }

    #[test]
    fn parts_add_up_and_gains_change_their_orientation_alone() {
        let (columns, rows) = (60, 50);
        let random = Key([9; 32]).field();
        let field: Vec<f64> =
            (0..columns * rows).map(|i| random.normal((i % columns) as i32, (i / columns) as i32)).collect();
        let (details, rest) = apart(&field, columns, &half_kernel(0.7));
        let sum = |i: usize| details.iter().map(|details| details[i]).sum::<f64>() + rest[i];
        assert!((0..field.len()).all(|i| (sum(i) - field[i]).abs() < 1e-12));
        let level = LevelContrast { log_gain: [0.2, 0.0, 0.0], ..LevelContrast::default() };
        let found = with_gains(field.clone(), columns, &Contrast { levels: vec![level], ..Contrast::none() });
        let gain = portable_math::exp(0.2) - 1.0;
        assert!((0..field.len()).all(|i| (found[i] - field[i] - gain * details[0][i]).abs() < 1e-12));
        // Stripes that alternate from column to column are details along x.
        let stripes: Vec<f64> = (0..columns * rows).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let (details, _) = apart(&stripes, columns, &half_kernel(0.7));
        assert!(details[0][columns * 20 + 20] > 0.8 && details[1][columns * 20 + 20].abs() < 1e-12);
    }
}
