//! How the strength of draws departs from that of the rasters from place to place: where gaps, classes of place or donors make it so, the map of
//! strength has to make up for it.

use rayon::prelude::*;

use crate::noise::learning::departure::{Departure, Mean};
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math::{exp, log};

/// Deviation of the Gaussian over which strengths are compared, as a share of the shorter side of the rasters.
const SCALE: f64 = 0.025;
/// Largest logarithm of a factor on the strength: a tenth of it, or ten times.
const MOST: f64 = 2.3;

/// Factors on the strength of each cell that take draws to the strength of the rasters, but for what may be chance of the draws. Rasters have NaN in gaps.
pub fn factors(real: &[&[f32]], drawn: &[Vec<f32>], columns: usize) -> Vec<f64> {
    let cells = drawn[0].len();
    let scale = SCALE * columns.min(cells / columns) as f64;
    let local = |raster: &[f32]| smoothed(&squares(raster), columns, scale);
    let of_real: Vec<Vec<f64>> = real.par_iter().map(|raster| local(raster)).collect();
    let of_drawn: Vec<Vec<f64>> = drawn.par_iter().map(|raster| local(raster)).collect();
    let factor = |cell: usize| {
        // Where a raster has no value in reach the mean square is 0.
        let logs = |of: &[Vec<f64>]| -> Vec<[f64; 1]> {
            of.iter().map(|raster| raster[cell]).filter(|square| *square > 0.0).map(|s| [0.5 * log(s)]).collect()
        };
        let (wanted, found) = (logs(&of_real), logs(&of_drawn));
        if wanted.len() < 2 || found.len() < 2 {
            return 1.0;
        }
        let departure = Departure::of(Mean::of(&wanted, 0).exact(), Mean::of(&found, 0));
        exp(departure.certain(1.0).clamp(-MOST, MOST))
    };
    (0..cells).into_par_iter().map(factor).collect()
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
        let found = factors(&real, &rasters(40, 0.5), columns);
        assert!((found[8 * columns + 8] - 2.0).abs() < 0.3, "{}", found[8 * columns + 8]);
        let elsewhere: Vec<f64> = (0..columns * rows).filter(|i| i % columns > 40).map(|i| found[i]).collect();
        let mean = elsewhere.iter().sum::<f64>() / elsewhere.len() as f64;
        assert!((mean - 1.0).abs() < 0.03 && elsewhere.iter().all(|factor| (factor - 1.0).abs() < 0.3), "{mean}");
    }
}
