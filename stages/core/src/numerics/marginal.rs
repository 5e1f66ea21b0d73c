//! Statistics of the values of a raster without regard to where they lie (paper 2.2.1, equations 5 to 8).

use super::quantile::median;

/// Makes the median absolute deviation a standard deviation for normal values: 1 / quantile(3/4).
pub const NORMAL_MAD: f64 = 1.482_602_218_505_602;

/// Marginal statistics of the cells that have a value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Marginal {
    /// Cells with a value.
    pub count: usize,
    /// Mean, in the unit of the values (equation 5).
    pub mean: f64,
    /// Standard deviation with N - 1 (equation 6).
    pub deviation: f64,
    /// Sum of cubed deviations over `N s^3` (equation 7); NaN for constant values.
    pub skewness: f64,
    /// Sum of fourth powers over `N s^4`, less 3 (equation 8); NaN for constant values.
    pub excess_kurtosis: f64,
    /// Normalised median absolute deviation from the median (Hoehle and Hoehle 2009).
    pub nmad: f64,
}

/// Statistics of the values that are not NaN; `None` for fewer than two.
pub fn marginal(values: &[f32]) -> Option<Marginal> {
    let mut finite = known(values);
    let found = moments(&finite)?;
    Some(Marginal { nmad: normalised_mad(&mut finite), ..found })
}

/// [`Marginal::skewness`] alone, in less time.
pub fn skewness(values: &[f32]) -> Option<f64> {
    moments(&known(values)).map(|found| found.skewness)
}

/// [`Marginal::nmad`] alone, in less time; NaN without values.
pub fn nmad(values: &[f32]) -> f64 {
    normalised_mad(&mut known(values))
}

/// The values that are not NaN, in their order.
pub fn known(values: &[f32]) -> Vec<f64> {
    // A list that grows as it is filled takes three times the memory while it moves.
    let mut known = Vec::with_capacity(values.len());
    known.extend(values.iter().filter(|v| !v.is_nan()).map(|v| f64::from(*v)));
    known
}

/// Everything but the median absolute deviation, which is NaN.
fn moments(finite: &[f64]) -> Option<Marginal> {
    let count = finite.len();
    if count < 2 {
        return None;
    }
    let n = count as f64;
    let first = finite.iter().sum::<f64>() / n;
    // A second pass removes what rounding left in the first.
    let mean = first + finite.iter().map(|v| v - first).sum::<f64>() / n;
    let mut powers = [0.0; 3];
    for value in finite {
        let d = value - mean;
        let square = d * d;
        powers = [powers[0] + square, powers[1] + square * d, powers[2] + square * square];
    }
    let variance = powers[0] / (n - 1.0);
    let deviation = variance.sqrt();
    Some(Marginal {
        count,
        mean,
        deviation,
        skewness: powers[1] / (n * variance * deviation),
        excess_kurtosis: powers[2] / (n * variance * variance) - 3.0,
        nmad: f64::NAN,
    })
}

fn normalised_mad(values: &mut [f64]) -> f64 {
    let Some(centre) = median(values) else { return f64::NAN };
    for value in values.iter_mut() {
        *value = (*value - centre).abs();
    }
    NORMAL_MAD * median(values).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random::Key;

    #[test]
    fn a_small_sample_by_hand() {
        let found = marginal(&[1.0, f32::NAN, 2.0, 4.0, 9.0]).unwrap();
        assert_eq!((found.count, found.mean), (4, 4.0));
        assert!((found.deviation - (38.0f64 / 3.0).sqrt()).abs() < 1e-14);
        let s = found.deviation;
        assert!((found.skewness - (-27.0 - 8.0 + 125.0) / (4.0 * s * s * s)).abs() < 1e-14);
        assert!((found.excess_kurtosis - ((81.0 + 16.0 + 625.0) / (4.0 * s * s * s * s) - 3.0)).abs() < 1e-14);
        assert!((found.nmad - NORMAL_MAD * 1.5).abs() < 1e-14);
        assert_eq!(skewness(&[1.0, f32::NAN, 2.0, 4.0, 9.0]), Some(found.skewness));
    }

    #[test]
    fn normal_values_have_no_skewness_and_equal_spreads() {
        let field = Key([3; 32]).field();
        let values: Vec<f32> = (0..40_000).map(|i| (0.5 + 2.0 * field.normal(i % 200, i / 200)) as f32).collect();
        let found = marginal(&values).unwrap();
        assert!((found.mean - 0.5).abs() < 0.04 && (found.deviation - 2.0).abs() < 0.03);
        assert!((found.nmad - found.deviation).abs() < 0.05);
        assert!(found.skewness.abs() < 0.04 && found.excess_kurtosis.abs() < 0.08);
    }

    #[test]
    fn too_few_values_have_no_statistics() {
        assert_eq!(marginal(&[1.0, f32::NAN]), None);
        assert!(marginal(&[1.0, 1.0]).unwrap().skewness.is_nan());
    }
}
