//! Confidence intervals of proportions.

use super::beta;
use super::normal::NORMAL_975;

/// Wilson's 95 % interval for a probability of which `accepted` of `n` trials succeeded (Wilson 1927).
pub fn wilson_interval(accepted: usize, n: usize) -> (f64, f64) {
    let (k, n) = (accepted as f64, n as f64);
    let z2 = NORMAL_975 * NORMAL_975;
    let centre = (k + 0.5 * z2) / (n + z2);
    let half = NORMAL_975 / (n + z2) * (k * (n - k) / n + 0.25 * z2).sqrt();
    ((centre - half).max(0.0), (centre + half).min(1.0))
}

/// The exact 95 % interval of Clopper and Pearson (1934) for the same; never too narrow.
pub fn exact_interval(accepted: usize, n: usize) -> (f64, f64) {
    let (k, n) = (accepted as f64, n as f64);
    let low = if accepted == 0 { 0.0 } else { beta::quantile(k, n - k + 1.0, 0.025) };
    let high = if k >= n { 1.0 } else { beta::quantile(k + 1.0, n - k, 0.975) };
    (rounded(low), rounded(high))
}

/// Nine decimals, fewer than the incomplete beta function is good for.
pub fn rounded(x: f64) -> f64 {
    (x * 1e9).round() / 1e9
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;

    #[test]
    fn wilson_by_hand() {
        let (low, high) = wilson_interval(46, 50);
        assert!((low - 0.811_7).abs() < 1e-3 && (high - 0.968_4).abs() < 1e-3, "{low} {high}");
        assert_eq!(wilson_interval(0, 10).0, 0.0);
        assert_eq!(wilson_interval(10, 10).1, 1.0);
    }

    #[test]
    fn exact_intervals_by_the_book() {
        let (low, high) = exact_interval(46, 50);
        assert!((low - 0.807_66).abs() < 1e-4 && (high - 0.977_77).abs() < 1e-4, "{low} {high}");
        assert_eq!(exact_interval(0, 10), (0.0, 0.308_497_108));
    }
}
