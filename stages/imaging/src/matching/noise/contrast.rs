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
/// Deviation of the Gaussian under which the mean square of details stays, in the same unit.
const FAR: f64 = 24.0;
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
        raise(details, level, columns, cells);
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

/// Multiplies details by powers of their own size and of the strength around. Far around a place they stay as strong as they were: where on the face
/// noise is strong is not a matter of contrast.
fn raise(details: &mut Details, powers: &LevelContrast, columns: usize, cells: f64) {
    let mean_square = |details: &[f64]| details.iter().map(|d| d * d).sum::<f64>() / details.len() as f64;
    let before = details.each_ref().map(|details| mean_square(details).max(f64::MIN_POSITIVE));
    let squares = |details: &Details| -> Vec<f32> {
        let square = |i: usize| (0..3).map(|o| details[o][i] * details[o][i] / before[o]).sum::<f64>() / 3.0;
        (0..details[0].len()).map(|i| square(i) as f32).collect()
    };
    let old = squares(details);
    let mut local = vec![0.0; old.len()];
    for (power, scale) in powers.local_power.into_iter().zip(LOCAL).filter(|(power, _)| power.abs() > 0.0) {
        let around = widely_smoothed(&old, columns, scale * cells);
        let pieces = local.par_chunks_mut(PIECE).zip(around.par_chunks(PIECE));
        pieces.for_each(|(local, around)| vectorised(AddLogs { local, around, power }));
    }
    for ((details, before), own_power) in details.iter_mut().zip(before).zip(powers.own_power) {
        let pieces = details.par_chunks_mut(PIECE).zip(local.par_chunks(PIECE));
        pieces.for_each(|(details, local)| vectorised(Raise { details, local, own_power, before }));
    }
    let [old, new] = [old, squares(details)].map(|squares| widely_smoothed(&squares, columns, FAR * cells));
    let gain = |(old, new): (&f64, &f64)| (old.max(LEAST_SQUARE) / new.max(LEAST_SQUARE)).sqrt();
    let gains: Vec<f64> = old.iter().zip(&new).map(gain).collect();
    for (details, before) in details.iter_mut().zip(before) {
        details.iter_mut().zip(&gains).for_each(|(detail, gain)| *detail *= gain);
        let level = (before / mean_square(details).max(f64::MIN_POSITIVE)).sqrt();
        details.iter_mut().for_each(|detail| *detail *= level);
    }
}

/// Deviation of a Gaussian in blocks of cells whose means are taken first.
const IN_BLOCKS: f64 = 4.0;

/// Values without gaps under a Gaussian of `scale` cells; under wide ones first the means of blocks, then linearly between their middles, which
/// together spread as much.
fn widely_smoothed(values: &[f32], columns: usize, scale: f64) -> Vec<f64> {
    let sides = [columns, values.len() / columns];
    let side = (scale / IN_BLOCKS) as usize;
    if side < 2 || 2 * side > sides[0].min(sides[1]) {
        return smoothed(values, columns, scale);
    }
    // Blocks that differ by a cell at most.
    let blocks = sides.map(|cells| (cells + side / 2) / side);
    let begin = |axis: usize, block: usize| (block * sides[axis] + blocks[axis] / 2) / blocks[axis];
    let cells = |axis: usize, block: usize| begin(axis, block)..begin(axis, block + 1);
    let mut means = vec![0.0f32; blocks[0] * blocks[1]];
    means.par_chunks_mut(blocks[0]).enumerate().for_each(|(down, means)| {
        for (across, mean) in means.iter_mut().enumerate() {
            let (rows, within) = (cells(1, down), cells(0, across));
            let count = rows.len() * within.len();
            let row = |row: usize| &values[row * columns..][within.clone()];
            *mean = (rows.flat_map(row).map(|value| f64::from(*value)).sum::<f64>() / count as f64) as f32;
        }
    });
    // A block spreads by a variance of (side^2 - 1) / 12 cells, what lies between two of them by side^2 / 6.
    let area = values.len() as f64 / means.len() as f64;
    let left = scale * scale - (area - 1.0) / 12.0 - area / 6.0;
    let coarse = smoothed(&means, blocks[0], (left / area).sqrt());
    let place = |axis: usize, cell: usize| {
        let at = (cell as f64 + 0.5) * blocks[axis] as f64 / sides[axis] as f64 - 0.5;
        let at = at.clamp(0.0, (blocks[axis] - 1) as f64);
        let first = (at as usize).min(blocks[axis] - 2);
        (first, at - first as f64)
    };
    let across: Vec<(usize, f64)> = (0..columns).map(|column| place(0, column)).collect();
    let mut found = vec![0.0; values.len()];
    found.par_chunks_mut(columns).enumerate().for_each(|(row, found)| {
        let (above, down) = place(1, row);
        let rows = coarse[above * blocks[0]..][..2 * blocks[0]].split_at(blocks[0]);
        let line: Vec<f64> = rows.0.iter().zip(rows.1).map(|(above, below)| above + down * (below - above)).collect();
        for (value, (left, share)) in found.iter_mut().zip(&across) {
            *value = line[*left] + share * (line[left + 1] - line[*left]);
        }
    });
    found
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
    fn means_of_blocks_smooth_as_single_cells_do() {
        let (columns, rows) = (131, 97);
        let random = Key([8; 32]).field();
        let square = |i: usize| random.normal((i % columns) as i32, (i / columns) as i32);
        let squares: Vec<f32> = (0..columns * rows).map(|i| (square(i) * square(i)) as f32).collect();
        for scale in [2.0, 8.4, 16.8, 33.6] {
            let (exact, fast) = (smoothed(&squares, columns, scale), widely_smoothed(&squares, columns, scale));
            let deviation = |values: &mut dyn Iterator<Item = f64>| {
                let values: Vec<f64> = values.collect();
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64).sqrt()
            };
            let missed = deviation(&mut exact.iter().zip(&fast).map(|(a, b)| a - b));
            let varies = deviation(&mut exact.iter().copied());
            assert!(missed < 0.2 * varies, "{scale}: {missed} of {varies}");
        }
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
