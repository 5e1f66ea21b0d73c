//! Contrast of a field of noise: how much the energy of its details varies over the face, level by level.
//!
//! Fine details come in bursts. A mixture of fields, and the difference of two, is more even than each of them; a power of the local rms gives
//! the details of a level their variation back. Coarser levels stay as they are, so that the tails of the values hardly grow.

use crate::matching::noise::ensemble::log_strength_at;
use rockface_core::artefact::{Contrast, Noise};
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math;

/// Deviations of the Gaussians that part a field into levels, finest first, cells.
pub const LEVELS_CELLS: [f64; 3] = [0.7, 1.4, 2.8];
/// Deviations of its level within which energy is averaged.
const AROUND: f64 = 0.75;

/// A level of a field.
struct Level {
    /// What the Gaussian takes away.
    details: Vec<f64>,
    /// Mean square of the details around each cell.
    energy: Vec<f64>,
    /// What the Gaussian leaves.
    rest: Vec<f64>,
}

/// The finest level of a field whose gaps are NaN.
fn level(field: &[f64], columns: usize, cells: f64) -> Level {
    let narrow = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value as f32).collect::<Vec<f32>>();
    let smooth = smoothed(&narrow(&mut field.iter().copied()), columns, cells);
    let details: Vec<f64> = field.iter().zip(&smooth).map(|(value, smooth)| value - smooth).collect();
    let energy = smoothed(&narrow(&mut details.iter().map(|d| d * d)), columns, AROUND * cells);
    let rest = field.iter().zip(smooth).map(|(value, smooth)| if value.is_nan() { f64::NAN } else { smooth }).collect();
    Level { details, energy, rest }
}

/// Classes of place on a map of strength: values that are given for the middle of each hold between them too.
#[derive(Debug)]
pub struct Classes<'a> {
    /// Logarithm of the strength at the middle of each class, ascending.
    middles: &'a [f64],
    /// Logarithm of the strength of each cell.
    logs: Vec<f64>,
}

impl<'a> Classes<'a> {
    /// The classes of a model.
    pub fn of(noise: &'a Noise) -> Self {
        let log = |strength: &f32| portable_math::log(f64::from(*strength).max(1e-12));
        Self { middles: &noise.class_log_strength, logs: noise.strength.iter().map(log).collect() }
    }

    /// The value at a cell of those at the middles of classes.
    fn at(&self, values: &[f64], cell: usize) -> f64 {
        log_strength_at(self.middles, values, self.logs[cell])
    }

    /// Logarithm of the mean of a square over the cells nearest to each class; a class without cells has that of the one before.
    fn log_means(&self, square: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut sums = vec![[0.0; 2]; self.middles.len()];
        for (cell, log) in self.logs.iter().enumerate() {
            let above = self.middles.partition_point(|middle| middle <= log).min(self.middles.len() - 1);
            let below = above.saturating_sub(1);
            let nearest = if log - self.middles[below] < self.middles[above] - log { below } else { above };
            let [count, sum] = &mut sums[nearest];
            (*count, *sum) = (*count + 1.0, *sum + square(cell));
        }
        let all = sums.iter().fold([0.0; 2], |all, sums| [all[0] + sums[0], all[1] + sums[1]]);
        let log = |[count, sum]: [f64; 2]| (sum > 0.0).then(|| portable_math::log(sum / count));
        let mut before = log(all).unwrap_or(0.0);
        sums.into_iter()
            .map(|sums| {
                before = log(sums).unwrap_or(before);
                before
            })
            .collect()
    }
}

/// A field without gaps, the details of each level times `(local rms / rms)^power`. Each level keeps its energy in each class of place.
pub fn contrasted(field: Vec<f64>, columns: usize, contrast: &[Contrast], classes: &Classes) -> Vec<f64> {
    let mut sum = vec![0.0; field.len()];
    let mut rest = field;
    for Contrast { cells, powers, .. } in contrast {
        let level = level(&rest, columns, *cells);
        let usual = classes.log_means(|cell| level.energy[cell]);
        let raised = |(cell, value): (usize, &f64)| {
            let log_energy = portable_math::log(level.energy[cell].max(1e-12)) - classes.at(&usual, cell);
            value * portable_math::exp(0.5 * classes.at(powers, cell) * log_energy)
        };
        let raised: Vec<f64> = level.details.iter().enumerate().map(raised).collect();
        let square = |values: &[f64], cell: usize| values[cell] * values[cell];
        let (before, after) =
            (classes.log_means(|c| square(&level.details, c)), classes.log_means(|c| square(&raised, c)));
        let scale: Vec<f64> = before.iter().zip(after).map(|(before, after)| 0.5 * (before - after)).collect();
        let scaled = |cell: usize| raised[cell] * portable_math::exp(classes.at(&scale, cell));
        sum.iter_mut().enumerate().for_each(|(cell, sum)| *sum += scaled(cell));
        rest = level.rest;
    }
    sum.iter().zip(rest).map(|(sum, rest)| sum + rest).collect()
}

/// How much the local rms of a field's details varies within each class of place, level by level: the logarithm of its variance over its mean
/// square. Gaps are NaN. 0 is the highest; details of the same strength everywhere have the lowest, ln(1e-12).
pub fn variation(field: &[f64], columns: usize, levels_cells: &[f64], class: &[u8], classes: usize) -> Vec<Vec<f64>> {
    let mut rest = field.to_vec();
    let one = |cells: &f64| {
        let level = level(&rest, columns, *cells);
        let mut sums = vec![[0.0; 3]; classes];
        let known = level.energy.iter().zip(&level.details).zip(class).filter(|((_, value), _)| !value.is_nan());
        for ((energy, _), class) in known {
            let [count, rms, square] = &mut sums[usize::from(*class)];
            (*count, *rms, *square) = (*count + 1.0, *rms + energy.sqrt(), *square + energy);
        }
        rest = level.rest;
        let share =
            |[count, rms, square]: [f64; 3]| if square > 0.0 { 1.0 - rms * rms / (count * square) } else { 0.0 };
        sums.into_iter().map(|sums| portable_math::log(share(sums).max(1e-12))).collect()
    };
    levels_cells.iter().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn bursts_of_fine_details_are_set_apart_and_coarse_ones_stay() {
        let (columns, rows) = (96, 80);
        let random = Key([5; 32]).field();
        let burst = |i: usize| if (i % columns / 8 + i / columns / 8).is_multiple_of(2) { 1.5 } else { 1.0 };
        let wave = |i: usize| 3.0 * portable_math::sincos((i % columns) as f64 * 0.1).0;
        let value = |i: usize| wave(i) + burst(i) * random.normal((i % columns) as i32, (i / columns) as i32);
        let field: Vec<f64> = (0..columns * rows).map(value).collect();
        let levels = |power: f64| LEVELS_CELLS.map(|cells| Contrast { cells, powers: vec![power], growth: vec![0.0] });
        let of = |field: &[f64], power: f64| {
            contrasted(
                field.to_vec(),
                columns,
                &levels(power),
                &Classes { middles: &[0.0], logs: vec![0.0; field.len()] },
            )
        };
        let with = of(&field, 1.0);
        let varies = |field: &[f64]| variation(field, columns, &LEVELS_CELLS, &vec![0; field.len()], 1);
        let (before, after) = (varies(&field), varies(&with));
        assert!(after[0][0] > before[0][0] + 0.5 && after[1][0] > before[1][0] + 0.3, "{before:?} {after:?}");
        // The wave is coarser than all levels: the same after it is smoothed.
        let coarse = |field: &[f64]| smoothed(&field.iter().map(|v| *v as f32).collect::<Vec<_>>(), columns, 6.0);
        let largest = coarse(&field).iter().zip(coarse(&with)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(largest < 0.3, "{largest}");
        let none = of(&field, 0.0);
        assert!(field.iter().zip(none).all(|(a, b)| (a - b).abs() < 1e-5));
        assert!(of(&vec![0.0; 7680], 1.0).iter().all(|value| value.abs() < 1e-9));
    }

    #[test]
    fn gaps_have_no_say_in_the_variation() {
        let random = Key([7; 32]).field();
        let field: Vec<f64> = (0..4800).map(|i| random.normal(i % 80, i / 80)).collect();
        let gappy: Vec<f64> = field.iter().enumerate().map(|(i, v)| if i % 80 < 20 { f64::NAN } else { *v }).collect();
        let [whole, part] = [field, gappy].map(|field| variation(&field, 80, &LEVELS_CELLS, &[0; 4800], 1));
        assert!(whole.iter().zip(&part).all(|(a, b)| (a[0] - b[0]).abs() < 0.4), "{whole:?} {part:?}");
    }
}
