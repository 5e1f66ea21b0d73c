//! What share of rasters an acceptance test lets through: of the reference, of others, and of a perfect simulator.

use rockface_core::numerics::beta;
use rockface_core::numerics::proportion::rounded;

use super::mahalanobis::bound;

/// The share of values at or below a threshold.
pub fn share_below(values: &[f64], threshold: f64) -> f64 {
    values.iter().filter(|v| **v <= threshold).count() as f64 / values.len() as f64
}

/// The share of reference values above a distance: the paper's compatibility score, exactly 0 beyond all of them.
pub fn score(reference: &[f64], d2: f64) -> f64 {
    1.0 - share_below(reference, d2)
}

/// The share of a perfect simulator's rasters that a test is expected to accept, for normal features without ridge.
///
/// The threshold is the `quantile` of the in-sample distances of `n` reference rasters with `p` features, which follow
/// (n - 1)^2 / n Beta(p / 2, (n - p - 1) / 2); distances of new rasters from the same distribution follow
/// p (n^2 - 1) / (n (n - p)) F(p, n - p) (Gnanadesikan and Kettenring 1972, Biometrics 28). `None` for n < p + 2.
pub fn perfect_acceptance(n: usize, p: usize, quantile: f64) -> Option<f64> {
    if p == 0 || n < p + 2 {
        return None;
    }
    let (nf, pf) = (n as f64, p as f64);
    let threshold = bound(n) * beta::quantile(0.5 * pf, 0.5 * (nf - pf - 1.0), quantile);
    // F <= x exactly where a Beta variable is at most p x / (p x + n - p).
    let px = threshold * nf * (nf - pf) / (nf * nf - 1.0);
    Some(rounded(beta::cumulative(0.5 * pf, 0.5 * (nf - pf), px / (px + nf - pf))))
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_simulator_is_not_accepted_as_often_as_the_quantile_says() {
        // Monte Carlo figures, two digits.
        let cases = [
            (39, 10, [0.60, 0.67, 0.78]),
            (39, 6, [0.76, 0.83, 0.91]),
            (39, 8, [0.69, 0.76, 0.86]),
            (26, 8, [0.55, 0.61, 0.71]),
            (26, 10, [0.41, 0.47, 0.56]),
        ];
        for (n, p, expected) in cases {
            for (quantile, expected) in [0.90, 0.95, 0.99].into_iter().zip(expected) {
                let found = perfect_acceptance(n, p, quantile).unwrap();
                assert!((found - expected).abs() < 0.012, "{n} {p} {quantile}: {found}");
            }
        }
        assert_eq!(perfect_acceptance(11, 10, 0.95), None);
    }

    #[test]
    fn the_threshold_of_39_normal_rasters_is_as_tabulated() {
        for (level, expected) in [(0.90, 14.7), (0.95, 16.2), (0.99, 19.2)] {
            assert!((bound(39) * beta::quantile(5.0, 14.0, level) - expected).abs() < 0.06);
        }
        assert!((bound(39) - 37.026).abs() < 1e-3);
    }

    #[test]
    fn far_away_the_score_is_exactly_zero() {
        let reference = [1.0, 2.0, 3.0, 4.0];
        assert_eq!([0.5, 2.0, 9.0].map(|d2| score(&reference, d2)), [1.0, 0.5, 0.0]);
    }
}
