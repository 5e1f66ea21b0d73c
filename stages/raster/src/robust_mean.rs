//! Robust fusion of several measurements of one quantity: the depths of a pixel from its pairs, or the elevations of a cell
//! from its images.
//!
//! The centre is the weighted median with weights `1 / sigma^2`. A value is rejected if its distance from the centre exceeds a
//! multiple of the larger of its sigma and the robust deviation (1.4826 times the median absolute deviation). The fused value
//! is the weighted mean or the weighted median of the others (paper 2.1.2, Algorithm 2 line 21).

use rockface_core::choice;
use rockface_core::numerics::marginal::NORMAL_MAD;

choice! {
    /// How values that agree become one.
    pub enum Averaging {
        /// Their mean, weighted by the inverse of their variances.
        Mean = "mean",
        /// Their weighted median: it follows no outlier, and is some 25 % noisier.
        Median = "median",
    }
}

/// A value with its expected standard deviation, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The value, metres.
    pub value_m: f64,
    /// Its expected standard deviation, metres; positive.
    pub sigma_m: f64,
    /// Weight in an average: `1 / sigma_m^2`.
    weight: f64,
}

impl Measured {
    /// A value and its expected standard deviation.
    #[inline]
    pub fn new(value_m: f64, sigma_m: f64) -> Self {
        Self { value_m, sigma_m, weight: 1.0 / (sigma_m * sigma_m) }
    }

    /// A value whose weight is known.
    #[inline]
    pub fn weighted(value_m: f64, sigma_m: f64, weight: f64) -> Self {
        Self { value_m, sigma_m, weight }
    }
}

/// How values are fused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// How the values that are not rejected are averaged.
    pub averaging: Averaging,
    /// A value is rejected beyond this many robust deviations, or sigmas of the value where those are larger.
    pub rejection: f64,
    /// Distance from the centre within which no value is rejected, metres.
    pub tolerance_m: f64,
    /// Fewest values that must remain.
    pub minimum: usize,
}

/// The result of a fusion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fused {
    /// The fused value, with the standard deviation of a mean of independent errors.
    pub value: Measured,
    /// How many values were not rejected.
    pub count: usize,
}

/// Fuses values, and reorders them. `None` where too few remain.
pub fn fuse(values: &mut [Measured], rule: &Rule) -> Option<Fused> {
    if values.len() < rule.minimum.max(1) {
        return None;
    }
    if let [only] = values {
        return Some(Fused { value: *only, count: 1 });
    }
    values.sort_unstable_by(|a, b| a.value_m.total_cmp(&b.value_m).then(a.sigma_m.total_cmp(&b.sigma_m)));
    let centre_m = weighted_median(values);
    let robust_m = rule.rejection * NORMAL_MAD * middle_deviation(values, centre_m);
    let mut count = 0;
    for i in 0..values.len() {
        let allowed_m = robust_m.max(rule.rejection * values[i].sigma_m).max(rule.tolerance_m);
        if (values[i].value_m - centre_m).abs() <= allowed_m {
            values[count] = values[i];
            count += 1;
        }
    }
    let kept = &values[..count];
    if count < rule.minimum.max(1) {
        return None;
    }
    let weight: f64 = kept.iter().map(|v| v.weight).sum();
    let value_m = match rule.averaging {
        Averaging::Mean => centre_m + kept.iter().map(|v| v.weight * (v.value_m - centre_m)).sum::<f64>() / weight,
        Averaging::Median => weighted_median(kept),
    };
    Some(Fused { value: Measured { value_m, sigma_m: 1.0 / weight.sqrt(), weight }, count })
}

/// The weighted median of sorted values; the mean of two where the weight is split exactly in half.
fn weighted_median(sorted: &[Measured]) -> f64 {
    let half = 0.5 * sorted.iter().map(|v| v.weight).sum::<f64>();
    let mut passed = 0.0;
    for (i, value) in sorted.iter().enumerate() {
        passed += value.weight;
        if passed > half {
            return value.value_m;
        }
        if passed >= half && i + 1 < sorted.len() {
            return 0.5 * (value.value_m + sorted[i + 1].value_m);
        }
    }
    sorted[sorted.len() - 1].value_m
}

/// Median of the absolute deviations of sorted values (the lower one of an even number), found from both ends inwards.
fn middle_deviation(sorted: &[Measured], centre_m: f64) -> f64 {
    let (mut low, mut high) = (0, sorted.len() - 1);
    // The largest deviation is at one of the two ends; remove half of them.
    for _ in 0..sorted.len() / 2 {
        if centre_m - sorted[low].value_m >= sorted[high].value_m - centre_m { low += 1 } else { high -= 1 }
    }
    (centre_m - sorted[low].value_m).abs().max((sorted[high].value_m - centre_m).abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    const RULE: Rule = Rule { averaging: Averaging::Mean, rejection: 3.0, tolerance_m: 0.0, minimum: 1 };

    fn measured(values: &[(f64, f64)]) -> Vec<Measured> {
        values.iter().map(|(value_m, sigma_m)| Measured::new(*value_m, *sigma_m)).collect()
    }

    fn fused(values: &[(f64, f64)], rule: &Rule) -> Option<(f64, usize)> {
        fuse(&mut measured(values), rule).map(|f| (f.value.value_m, f.count))
    }

    #[test]
    fn one_value_passes_as_it_is_and_two_are_weighted() {
        assert_eq!(fused(&[(0.1, 0.3)], &RULE), Some((0.1, 1)));
        let (mean, count) = fused(&[(1.0, 0.1), (1.2, 0.2)], &RULE).unwrap();
        assert!((mean - 1.04).abs() < 1e-12 && count == 2);
        let sigma = fuse(&mut measured(&[(1.0, 0.1), (1.2, 0.1)]), &RULE).unwrap().value.sigma_m;
        assert!((sigma - 0.1 / 2f64.sqrt()).abs() < 1e-15);
        assert_eq!(fused(&[(1.0, 0.1)], &Rule { minimum: 2, ..RULE }), None);
        assert_eq!(fused(&[], &RULE), None);
    }

    #[test]
    fn a_blunder_is_rejected_in_any_order() {
        let values = [(1.0, 0.01), (9.0, 0.01), (1.01, 0.01), (0.99, 0.01)];
        let (mean, count) = fused(&values, &RULE).unwrap();
        assert!((mean - 1.0).abs() < 1e-12 && count == 3, "{mean} {count}");
        let turned: Vec<_> = values.iter().rev().copied().collect();
        assert_eq!(fused(&turned, &RULE).unwrap(), (mean, count));
        assert_eq!(fused(&values, &Rule { tolerance_m: 10.0, ..RULE }).unwrap().1, 4);
        assert_eq!(fused(&values, &Rule { minimum: 4, ..RULE }), None);
    }

    #[test]
    fn the_weighted_median_follows_the_weight() {
        let rule = Rule { averaging: Averaging::Median, rejection: 100.0, ..RULE };
        assert_eq!(fused(&[(1.0, 1.0), (2.0, 1.0), (5.0, 1.0)], &rule), Some((2.0, 3)));
        assert_eq!(fused(&[(1.0, 1.0), (2.0, 1.0)], &rule), Some((1.5, 2)));
        assert_eq!(fused(&[(1.0, 0.1), (2.0, 1.0), (3.0, 1.0)], &rule), Some((1.0, 3)));
    }

    #[test]
    fn the_median_of_deviations_is_the_textbooks() {
        let field = Key([1; 32]).field();
        for n in 1..20 {
            let mut values: Vec<f64> = (0..n).map(|i| field.normal(i, n)).collect();
            values.sort_by(f64::total_cmp);
            let centre = 0.3;
            let mut deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
            deviations.sort_by(f64::total_cmp);
            let sorted = measured(&values.iter().map(|v| (*v, 1.0)).collect::<Vec<_>>());
            let expected = deviations[(n as usize - 1) / 2];
            assert!((middle_deviation(&sorted, centre) - expected).abs() < 1e-15, "{n}");
        }
    }

    #[test]
    fn four_pairs_halve_the_noise() {
        let field = Key([7; 32]).field();
        let mut squares = 0.0;
        for i in 0..20_000 {
            let draw = |k: i32| (0.02 * field.normal(4 * i + k, 0), 0.02);
            let (mean, _) = fused(&[draw(0), draw(1), draw(2), draw(3)], &RULE).unwrap();
            squares += mean * mean;
        }
        let ratio = (squares / 20_000.0).sqrt() / 0.01;
        // Rejection of a few good values raises the noise by 2 %.
        assert!((ratio - 1.02).abs() < 0.03, "{ratio}");
    }
}
