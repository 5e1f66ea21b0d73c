//! The score that rasters like the references themselves would have.

use rockface_core::numerics::beta;

/// The median of S = 1 - (share of references at most as far) over rasters of the same process as n references, by p features.
///
/// Not one half: a new raster lies farther from a model than the rasters that made it. For normal features the distance of a new one is
/// p (n^2 - 1) / (n (n - p)) F(p, n - p), that of a reference (n - 1)^2 / n Beta(p / 2, (n - p - 1) / 2). `None` unless n > p + 1.
pub fn median_of_a_perfect_simulator(references: f64, features: usize) -> Option<f64> {
    let (n, p) = (references, features as f64);
    if p < 1.0 || n <= p + 1.0 {
        return None;
    }
    let x = beta::quantile(0.5 * p, 0.5 * (n - p), 0.5);
    let d2 = (n * n - 1.0) / n * x / (1.0 - x);
    let share = (d2 * n / ((n - 1.0) * (n - 1.0))).min(1.0);
    let beyond = 1.0 - beta::cumulative(0.5 * p, 0.5 * (n - p - 1.0), share);
    // Scores are counts of n references: of two neighbouring ones the larger is the median.
    Some((beyond * n).ceil() / n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::mahalanobis::{distance, fit};
    use rockface_core::numerics::quantile::quantile;
    use rockface_core::numerics::random::Key;

    #[test]
    fn the_paper_s_sites_have_medians_far_below_one_half() {
        let score = |n: f64, p: usize| median_of_a_perfect_simulator(n, p).unwrap();
        assert!((score(39.0, 10) - 0.20).abs() < 0.01, "{}", score(39.0, 10));
        assert!((score(26.0, 9) - 0.12).abs() < 0.01, "{}", score(26.0, 9));
        assert!((score(1e5, 10) - 0.5).abs() < 1e-3);
        assert_eq!(median_of_a_perfect_simulator(9.0, 9), None);
    }

    #[test]
    fn simulated_references_and_trials_have_that_median() {
        let (n, p, rounds) = (39i32, 10, 60);
        let names: Vec<String> = (0..p).map(|j| format!("f{j}")).collect();
        let field = Key([7; 32]).field();
        let draw = |round: i32, i: i32| (0..p as i32).map(|j| field.normal(round * 1000 + i, j)).collect::<Vec<f64>>();
        let mut scores = Vec::new();
        for round in 0..rounds {
            let rows: Vec<Vec<f64>> = (0..n).map(|i| draw(round, i)).collect();
            let model = fit(&names, &rows, 1e-6).unwrap();
            for i in 0..20 {
                let d2 = distance(&model, &draw(round, 500 + i)).d2;
                let nearer = model.reference_d2.iter().filter(|d| **d <= d2).count();
                scores.push(1.0 - nearer as f64 / f64::from(n));
            }
        }
        let median = quantile(&scores, 0.5).unwrap();
        let expected = median_of_a_perfect_simulator(f64::from(n), p).unwrap();
        assert!((median - expected).abs() < 0.06, "{median} {expected}");
    }
}
