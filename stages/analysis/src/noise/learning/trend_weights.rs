//! How much each place of a face says of the trends of its rasters.
//!
//! By ordinary least squares the noise of a noisy part would bend the trend in quiet parts too. What a trend is in a place is known as well
//! as the noise around it is weak, so cells count by the inverse of its variance (weighted least squares).

use crate::noise::learning::differences::level;
use rockface_core::StageError;
use rockface_core::artefact::Band;
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math::{exp, log};
use rockface_core::numerics::trend::Trend;

/// Deviation of the Gaussian under which noise is compared, as a share of the shorter side: trends are as wide as the face.
const SCALE: f64 = 0.1;
/// Least variance around a place, as a share of that of all places: an area of equal values has no noise, and would alone say what the trend is.
const LEAST_VARIANCE: f64 = 0.01;
/// Rounds: the noise of quiet places shows when trends no longer follow that of noisy ones.
const ROUNDS: usize = 3;

/// Rasters without their trends.
pub struct Level {
    /// Differences, metres.
    pub rasters_m: Vec<Vec<f32>>,
    /// Their trends, metres.
    pub trends_m: Vec<Trend>,
    /// Weights of cells in the trends; 1 is that of noise of the usual variance.
    pub weights: Vec<f32>,
}

/// Differences without their trends, in which each cell counts by the inverse of the variance of the noise around it.
///
/// # Errors
/// Those of [`level`].
pub fn weighed(bands: &[&Band], columns: usize, step_m: &[f32]) -> Result<Level, StageError> {
    let mut weights = Vec::new();
    let (mut rasters_m, mut trends_m) = level(bands, columns, step_m, &weights)?;
    for _ in 0..ROUNDS {
        weights = of_noise(&rasters_m, columns);
        drop(rasters_m);
        (rasters_m, trends_m) = level(bands, columns, step_m, &weights)?;
    }
    Ok(Level { rasters_m, trends_m, weights })
}

/// The weights that follow from rasters without trends. What the first half and the second half of the rasters do not agree on is chance, and draws
/// weights back to those of even noise (reliability by split halves: Spearman 1910, Brown 1910).
fn of_noise(level: &[Vec<f32>], columns: usize) -> Vec<f32> {
    let (first, second) = level.split_at(level.len().div_ceil(2));
    let halves = [first, second].map(|half| log_variances(half, columns));
    let both = || halves[0].iter().zip(&halves[1]).filter(|(a, b)| !(a.is_nan() || b.is_nan()));
    let count = both().count().max(1) as f64;
    let (sum_a, sum_b) = both().fold((0.0, 0.0), |(sum_a, sum_b), (a, b)| (sum_a + a, sum_b + b));
    let (mean_a, mean_b) = (sum_a / count, sum_b / count);
    let (mut own_a, mut own_b, mut common) = (0.0, 0.0, 0.0);
    for (a, b) in both().map(|(a, b)| (a - mean_a, b - mean_b)) {
        (own_a, own_b, common) = (own_a + a * a, own_b + b * b, common + a * b);
    }
    let agreement = if common > 0.0 { common / (own_a * own_b).sqrt() } else { 0.0 };
    let reliability = 2.0 * agreement / (1.0 + agreement);
    let weight = |(a, b): (&f64, &f64)| {
        let departure = 0.5 * (a - mean_a + b - mean_b);
        if departure.is_nan() { 1.0 } else { exp(-reliability * departure).clamp(LEAST_VARIANCE, 1.0 / LEAST_VARIANCE) }
    };
    halves[0].iter().zip(&halves[1]).map(|(a, b)| weight((a, b)) as f32).collect()
}

/// Logarithm of the variance of noise around each cell over that of all; NaN where nothing is known. Each raster counts by its own variance, so that a bad
/// one does not outweigh the others.
fn log_variances(level: &[Vec<f32>], columns: usize) -> Vec<f64> {
    let cells = level.first().map_or(0, Vec::len);
    let (mut sums, mut counts) = (vec![0.0f32; cells], vec![0u32; cells]);
    for raster in level {
        let known = || raster.iter().filter(|value| !value.is_nan()).map(|value| f64::from(*value));
        let inverse = known().count() as f64 / known().map(|value| value * value).sum::<f64>();
        for ((sum, count), value) in sums.iter_mut().zip(&mut counts).zip(raster).filter(|(_, value)| !value.is_nan()) {
            *sum += (inverse * f64::from(*value) * f64::from(*value)) as f32;
            *count += 1;
        }
    }
    let mean = |(sum, count): (&f32, &u32)| if *count > 0 { sum / *count as f32 } else { f32::NAN };
    let squares: Vec<f32> = sums.iter().zip(&counts).map(mean).collect();
    let side = columns.min(cells / columns) as f64;
    // Nothing is known within reach where the mean is 0.
    let of = |variance: f64| if variance > 0.0 { log(variance.max(LEAST_VARIANCE)) } else { f64::NAN };
    smoothed(&squares, columns, SCALE * side).into_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    const COLUMNS: usize = 80;
    const ROWS: usize = 60;

    /// Rasters of noise that is `times` as strong in the right half, correlated over some cells.
    fn rasters(times: f32) -> Vec<Band> {
        let one = |k: u8| {
            let field = Key([k; 32]).field();
            let white: Vec<f32> =
                (0..COLUMNS * ROWS).map(|i| field.normal((i % COLUMNS) as i32, (i / COLUMNS) as i32) as f32).collect();
            let strength = |i: usize| if i % COLUMNS < COLUMNS / 2 { 1.0 } else { times };
            let values = smoothed(&white, COLUMNS, 4.0);
            let values = values.iter().enumerate().map(|(i, value)| *value as f32 * strength(i)).collect();
            Band { name: format!("r{k}"), values }
        };
        (0..12).map(one).collect()
    }

    /// Root mean square of the left half of the trends of rasters over that of what they were made of.
    fn leak(weights: &[f32], bands: &[Band]) -> f64 {
        let references: Vec<&Band> = bands.iter().collect();
        let level = level(&references, COLUMNS, &vec![1.0; COLUMNS * ROWS], weights).unwrap().0;
        let left = |values: &[f32]| -> Vec<f64> {
            values.iter().enumerate().filter(|(i, _)| i % COLUMNS < COLUMNS / 2).map(|(_, v)| f64::from(*v)).collect()
        };
        let (mut trend, mut whole) = (0.0, 0.0);
        for (band, level) in bands.iter().zip(&level) {
            for (value, level) in left(&band.values).into_iter().zip(left(level)) {
                trend += (value - level) * (value - level);
                whole += value * value;
            }
        }
        (trend / whole).sqrt()
    }

    #[test]
    fn noise_of_one_half_leaves_the_trends_of_the_other_alone() {
        let bands = rasters(8.0);
        let references: Vec<&Band> = bands.iter().collect();
        let found = weighed(&references, COLUMNS, &vec![1.0; COLUMNS * ROWS]).unwrap();
        let (alike, weighed) = (leak(&[], &bands), leak(&found.weights, &bands));
        assert!(alike > 1.2 && weighed < 0.6 * alike, "{alike} {weighed}");
        // The weights of the two halves are as their variances are, within the limit.
        let at = |column: usize| f64::from(found.weights[ROWS / 2 * COLUMNS + column]);
        let ratio = at(5) / at(COLUMNS - 5);
        assert!((30.0..100.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn places_of_even_noise_count_alike_and_those_without_any_no_more_than_others() {
        let bands = rasters(1.0);
        let references: Vec<&Band> = bands.iter().collect();
        let found = weighed(&references, COLUMNS, &vec![1.0; COLUMNS * ROWS]).unwrap();
        assert!(found.weights.iter().all(|weight| (0.7..1.4).contains(weight)));
        let empty = of_noise(&[vec![f32::NAN; 4], vec![f32::NAN, 1.0, -1.0, f32::NAN]], 2);
        assert!(empty.iter().all(|weight| (weight - 1.0).abs() < 1e-6), "{empty:?}");
        let masked: Vec<f32> = (0..COLUMNS * ROWS).map(|i| if i % COLUMNS < 60 { 0.0 } else { 1.0 }).collect();
        let largest = of_noise(&[masked.clone(), masked], COLUMNS).into_iter().fold(0.0, f32::max);
        assert!(largest <= 1.0 / LEAST_VARIANCE as f32, "{largest}");
    }
}
