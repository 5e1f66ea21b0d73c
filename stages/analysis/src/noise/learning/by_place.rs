//! How the strength of draws departs from that of the rasters from place to place: where gaps, classes of place or donors make it so, the map of
//! strength has to make up for it.

use rayon::prelude::*;

use crate::noise::learning::departure::{Departure, Mean};
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math::{exp, log};

/// Deviations of the Gaussians over which strengths are compared one after the other, as a share of the shorter side of the rasters: what is a few per
/// cent of a wide part of the face would be chance near a cell.
const SCALES: [f64; 3] = [0.1, 0.05, 0.025];
/// Largest logarithm of a factor on the strength: a tenth of it, or ten times.
const MOST: f64 = 2.3;

/// Factors on the strength of each cell that take draws to the strength of the rasters, but for what may be chance of the draws. Rasters have NaN in gaps.
pub fn factors(real: &[&[f32]], drawn: &[Vec<f32>], columns: usize) -> Vec<f64> {
    let log_factors = from_coarse_to_fine(real, drawn, columns, |wanted, found| {
        let logs = |of: &[f64]| -> Vec<[f64; 1]> {
            of.iter().filter(|square| **square > 0.0).map(|square| [0.5 * log(*square)]).collect()
        };
        let (wanted, found) = (logs(wanted), logs(found));
        let known = wanted.len() >= 2 && found.len() >= 2;
        known.then(|| Departure::of(Mean::of(&wanted, 0).exact(), Mean::of(&found, 0)))
    });
    log_factors.into_iter().map(exp).collect()
}

/// Factors on the strength of each cell that make up for what is lost of rasters, each beside what is left of it; they change the strength of places
/// relative to each other, not that of them all.
pub fn lost(rasters: &[Vec<f32>], left: &[Vec<f32>], columns: usize) -> Vec<f64> {
    let rasters: Vec<&[f32]> = rasters.iter().map(Vec::as_slice).collect();
    let log_factors = from_coarse_to_fine(&rasters, left, columns, |whole, left| {
        let both = whole.iter().zip(left).filter(|(whole, left)| **whole > 0.0 && **left > 0.0);
        let lost: Vec<[f64; 1]> = both.map(|(whole, left)| [0.5 * log(whole / left)]).collect();
        let none = Mean { value: 0.0, squared_error: 0.0 };
        (lost.len() >= 2).then(|| Departure::of(Mean::of(&lost, 0), none))
    });
    let mean = log_factors.iter().sum::<f64>() / log_factors.len() as f64;
    log_factors.into_iter().map(|log_factor| exp(log_factor - mean)).collect()
}

/// Logarithms of factors on the strength of each cell by the departure of the mean squares near it, which are 0 where a raster has no value in reach.
fn from_coarse_to_fine(
    wanted: &[&[f32]],
    found: &[Vec<f32>],
    columns: usize,
    departure: impl Fn(&[f64], &[f64]) -> Option<Departure> + Sync,
) -> Vec<f64> {
    let cells = found[0].len();
    let side = columns.min(cells / columns) as f64;
    let wanted: Vec<Vec<f32>> = wanted.iter().map(|raster| squares(raster)).collect();
    let mut found: Vec<Vec<f32>> = found.iter().map(|raster| squares(raster)).collect();
    let mut log_factors = vec![0.0; cells];
    for scale in SCALES {
        let near = |squares: &Vec<f32>| -> Vec<f32> {
            smoothed(squares, columns, scale * side).into_iter().map(|square| square as f32).collect()
        };
        let local = |of: &[Vec<f32>]| -> Vec<Vec<f32>> { of.par_iter().map(near).collect() };
        let (near_wanted, near_found) = (local(&wanted), local(&found));
        let at = |of: &[Vec<f32>], cell: usize| of.iter().map(|raster| f64::from(raster[cell])).collect::<Vec<f64>>();
        let one = |cell: usize| {
            let departure = departure(&at(&near_wanted, cell), &at(&near_found, cell));
            departure.map_or(0.0, |departure| departure.certain(1.0))
        };
        let more: Vec<f64> = (0..cells).into_par_iter().map(one).collect();
        log_factors.iter_mut().zip(&more).for_each(|(log_factor, more)| *log_factor += more);
        found.par_iter_mut().for_each(|squares| {
            squares
                .iter_mut()
                .zip(&more)
                .for_each(|(square, more)| *square = (f64::from(*square) * exp(2.0 * more)) as f32);
        });
    }
    log_factors.into_iter().map(|log_factor: f64| log_factor.clamp(-MOST, MOST)).collect()
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
        let found = factors(&real, &drawn, columns);
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
