//! How the strength of draws departs from that of the rasters from place to place: where gaps, classes of place or donors make it so, the map of
//! strength has to make up for it.

use rayon::prelude::*;

use crate::noise::learning::departure::{Departure, Mean};
use crate::noise::learning::whitening::Places;
use rockface_core::artefact::Noise;
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math::{exp, log};

/// Deviations of the Gaussians over which strengths are compared one after the other, as a share of the shorter side of the rasters: what is a few per
/// cent of a wide part of the face would be chance near a cell.
const SCALES: [f64; 3] = [0.1, 0.05, 0.025];
/// Largest logarithm of a factor on the strength: a tenth of it, or ten times.
const MOST: f64 = 2.3;

/// The strength of some rasters around each cell, at each scale: what draws are compared with again and again.
pub struct Strengths {
    /// By scale and cell, the mean logarithm of the strength; `None` where fewer than two rasters have values in reach.
    log_strength: Vec<Vec<Option<Mean>>>,
    columns: usize,
}

impl Strengths {
    /// Strengths of rasters with NaN in gaps.
    pub fn of(rasters: &[&[f32]], columns: usize) -> Self {
        let squares: Vec<Vec<f32>> = rasters.iter().map(|raster| squares(raster)).collect();
        let means = |scale: f64| -> Vec<Option<Mean>> {
            let near = near(&squares, columns, scale);
            (0..squares[0].len()).into_par_iter().map(|cell| mean_log(near.iter().map(|raster| raster[cell]))).collect()
        };
        Self { log_strength: SCALES.into_iter().map(means).collect(), columns }
    }

    /// Factors on the strength of each cell that take draws to these strengths, but for what may be chance of the draws.
    pub fn factors(&self, drawn: &[Vec<f32>]) -> Vec<f64> {
        let log_factors = from_coarse_to_fine(drawn, self.columns, |scale, near, cell| {
            let (wanted, found) = (self.log_strength[scale][cell]?, mean_log(near.iter().map(|raster| raster[cell]))?);
            Some(Departure::of(wanted.exact(), found))
        });
        log_factors.into_iter().map(exp).collect()
    }
}

/// Mean logarithm of the strength, of mean squares that are 0 where a raster has no value in reach; `None` for fewer than two others.
fn mean_log(squares: impl Iterator<Item = f32>) -> Option<Mean> {
    let known = squares.filter(|square| *square > 0.0);
    let logs: Vec<[f64; 1]> = known.map(|square| [0.5 * log(f64::from(square))]).collect();
    (logs.len() >= 2).then(|| Mean::of(&logs, 0))
}

/// Factors on the strength of each cell that make up for what is lost of rasters, each beside what is left of it; they change the strength of places
/// relative to each other, not that of them all.
pub fn lost(rasters: &[Vec<f32>], left: &[Vec<f32>], columns: usize) -> Vec<f64> {
    let whole: Vec<Vec<f32>> = rasters.iter().map(|raster| squares(raster)).collect();
    let whole = SCALES.map(|scale| near(&whole, columns, scale));
    let log_factors = from_coarse_to_fine(left, columns, |scale, left, cell| {
        let both = whole[scale].iter().zip(left).map(|(whole, left)| (whole[cell], left[cell]));
        let both = both.filter(|(whole, left)| *whole > 0.0 && *left > 0.0);
        let lost: Vec<[f64; 1]> = both.map(|(whole, left)| [0.5 * log(f64::from(whole) / f64::from(left))]).collect();
        let none = Mean { value: 0.0, squared_error: 0.0 };
        (lost.len() >= 2).then(|| Departure::of(Mean::of(&lost, 0), none))
    });
    let mean = log_factors.iter().sum::<f64>() / log_factors.len() as f64;
    log_factors.into_iter().map(|log_factor| exp(log_factor - mean)).collect()
}

/// Logarithms of factors on the strength of each cell of rasters, by a departure at the number of a scale, from the mean squares near each cell.
fn from_coarse_to_fine(
    rasters: &[Vec<f32>],
    columns: usize,
    departure: impl Fn(usize, &[Vec<f32>], usize) -> Option<Departure> + Sync,
) -> Vec<f64> {
    let cells = rasters[0].len();
    let mut changed: Vec<Vec<f32>> = rasters.iter().map(|raster| squares(raster)).collect();
    let mut log_factors = vec![0.0f64; cells];
    for (number, scale) in SCALES.into_iter().enumerate() {
        let near = near(&changed, columns, scale);
        let one = |cell: usize| departure(number, &near, cell).map_or(0.0, |departure| departure.certain(1.0));
        let more: Vec<f64> = (0..cells).into_par_iter().map(one).collect();
        log_factors.iter_mut().zip(&more).for_each(|(log_factor, more)| *log_factor += more);
        let factors: Vec<f64> = more.iter().map(|more| exp(2.0 * more)).collect();
        changed.par_iter_mut().for_each(|squares| times(squares, &factors));
    }
    log_factors.into_iter().map(|log_factor| log_factor.clamp(-MOST, MOST)).collect()
}

/// Multiplies the map of strength of a model. Classes of place stay the same shares of the face: with the strengths of before, places of a face whose strength hardly differs
/// would all come to the weakest or the strongest of them, and have its factors.
pub fn strengthen(noise: &mut Noise, factors: &[f64]) {
    times(&mut noise.strength, factors);
    noise.class_log_strength = Places::of(noise.strength.clone()).middles;
}

/// Mean squares around each cell; 0 where no value is in reach.
fn near(squares: &[Vec<f32>], columns: usize, scale: f64) -> Vec<Vec<f32>> {
    let one = |squares: &Vec<f32>| -> Vec<f32> {
        let side = columns.min(squares.len() / columns) as f64;
        smoothed(squares, columns, scale * side).into_iter().map(|square| square as f32).collect()
    };
    squares.par_iter().map(one).collect()
}

/// Multiplies each value by a factor.
pub fn times(values: &mut [f32], factors: &[f64]) {
    values.iter_mut().zip(factors).for_each(|(value, factor)| *value = (f64::from(*value) * factor) as f32);
}

/// Squares of the departures from the mean.
fn squares(raster: &[f32]) -> Vec<f32> {
    let known = raster.iter().filter(|value| !value.is_nan()).map(|value| f64::from(*value));
    let (sum, count) = known.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    let mean = sum / count;
    raster.iter().map(|value| ((f64::from(*value) - mean) * (f64::from(*value) - mean)) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn draws_that_are_too_weak_in_a_corner_are_made_stronger_there_alone() {
        let (columns, rows) = (80, 60);
        let weak = |i: usize| i % columns < 24 && i / columns < 20;
        let rasters = |first: u8, factor: f64| -> Vec<Vec<f32>> {
            let one = |b: u8| {
                let noise = Key([b; 32]).field();
                let draw = |i: usize| noise.normal((i % columns) as i32, (i / columns) as i32);
                (0..columns * rows).map(|i| (draw(i) * if weak(i) { factor } else { 1.0 }) as f32).collect()
            };
            (first..first + 12).map(one).collect()
        };
        let mut real = rasters(0, 1.0);
        real.iter_mut().for_each(|raster| raster[5] = f32::NAN);
        let real: Vec<&[f32]> = real.iter().map(Vec::as_slice).collect();
        let drawn = rasters(40, 0.5);
        let found = Strengths::of(&real, columns).factors(&drawn);
        assert!((found[8 * columns + 8] - 2.0).abs() < 0.3, "{}", found[8 * columns + 8]);
        let elsewhere: Vec<f64> = (0..columns * rows).filter(|i| i % columns > 40).map(|i| found[i]).collect();
        let mean = elsewhere.iter().sum::<f64>() / elsewhere.len() as f64;
        assert!((mean - 1.0).abs() < 0.03 && elsewhere.iter().all(|factor| (factor - 1.0).abs() < 0.3), "{mean}");
        // What is lost of the same noise is no chance: the corner, beside the rest, is known well.
        let lost = lost(&rasters(40, 1.0), &drawn, columns);
        let (inside, outside) = (lost[8 * columns + 8], lost[40 * columns + 60]);
        assert!((inside / outside - 2.0).abs() < 0.02, "{inside} {outside}");
    }
}
