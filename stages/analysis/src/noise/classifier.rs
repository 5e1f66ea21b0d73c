//! Ridge logistic regression on standardised features, and the area under a ROC curve with its error.

use nalgebra::{Cholesky, DMatrix, DVector};
use rockface_core::numerics::logistic::{self, Regression};
use rockface_core::numerics::normal::NORMAL_975;

/// The area under a ROC curve and its standard error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Auc {
    /// Probability that a positive scores higher than a negative; ties count half.
    pub auc: f64,
    /// Standard error by the method of the three authors of Biometrics 44, 837 (1988).
    pub error: f64,
}

impl Auc {
    /// 95 % interval, cut to 0..1.
    pub fn interval(&self) -> (f64, f64) {
        let half = NORMAL_975 * self.error;
        ((self.auc - half).max(0.0), (self.auc + half).min(1.0))
    }
}

/// The area from the scores of the two classes, each of at least two.
pub fn area(negative: &[f64], positive: &[f64]) -> Auc {
    let wins = |p: f64, n: f64| if p > n { 1.0 } else { 0.5 * f64::from(u8::from((p - n).abs() <= 0.0)) };
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let of_positive: Vec<f64> =
        positive.iter().map(|p| mean(&negative.iter().map(|n| wins(*p, *n)).collect::<Vec<_>>())).collect();
    let of_negative: Vec<f64> =
        negative.iter().map(|n| mean(&positive.iter().map(|p| wins(*p, *n)).collect::<Vec<_>>())).collect();
    let variance = |values: &[f64]| {
        let m = mean(values);
        values.iter().map(|v| (v - m) * (v - m)).sum::<f64>() / ((values.len() - 1) as f64 * values.len() as f64)
    };
    Auc { auc: mean(&of_positive), error: (variance(&of_positive) + variance(&of_negative)).sqrt() }
}

/// A fitted classifier on standardised features; a positive score speaks for the second class.
#[derive(Debug, Clone, PartialEq)]
pub struct Logistic {
    standard: Standard,
    /// Score of a row whose features are all at their means.
    pub intercept: f64,
    /// Weight of each standardised feature; 0 where it does not vary.
    pub weights: Vec<f64>,
}

/// Keeps the first step of the intercept finite.
const DAMPING: f64 = 1e-9;
/// Added to products of rows, as a share of their mean, since centred rows are dependent.
const JITTER: f64 = 1e-9;

impl Logistic {
    /// Fits a logistic regression: both classes count the same, and `ridge / 2` times the sum of squared weights (without the
    /// intercept) is added to the mean log-loss times the number of rows.
    pub fn fit(classes: [&[&[f64]]; 2], ridge: f64) -> Self {
        let rows: Vec<&[f64]> = classes.iter().flat_map(|class| class.iter().copied()).collect();
        let standard = Standard::of(&rows);
        let design: Vec<Vec<f64>> = rows.iter().map(|row| standard.scores(row)).collect();
        let importance = importance(classes.map(<[_]>::len));
        let happened: Vec<bool> = (0..rows.len()).map(|i| i >= classes[0].len()).collect();
        let few = if design.first().is_some_and(|row| row.len() > rows.len()) { span(&design) } else { None };
        let reduced = few.as_ref().map_or(&design, |(coordinates, _)| coordinates);
        let with_intercept: Vec<Vec<f64>> =
            reduced.iter().map(|row| std::iter::once(1.0).chain(row.iter().copied()).collect()).collect();
        let regression = Regression {
            design: &with_intercept,
            happened: &happened,
            importance: &importance,
            ridge,
            damping: DAMPING,
        };
        let weights = logistic::fit(&regression).weights;
        let intercept = weights.get(0).copied().unwrap_or(0.0);
        let weights = DVector::from_iterator(weights.len().saturating_sub(1), weights.iter().skip(1).copied());
        let weights = match &few {
            Some((_, lower)) => back(&design, lower, &weights),
            None => weights.iter().copied().collect(),
        };
        Self { standard, intercept, weights }
    }

    /// The score of a raster: the logarithm of its odds to be of the second class.
    pub fn score(&self, values: &[f64]) -> f64 {
        let x = self.standard.scores(values);
        self.intercept + x.iter().zip(&self.weights).map(|(x, w)| x * w).sum::<f64>()
    }
}

/// How much each row counts, so that both classes count the same: half the number of rows over the size of its class.
pub fn importance(counts: [usize; 2]) -> Vec<f64> {
    let all = (counts[0] + counts[1]) as f64;
    counts.iter().flat_map(|count| std::iter::repeat_n(0.5 * all / *count as f64, *count)).collect()
}

/// Coordinates of rows in the space they span, which has fewer dimensions than features: L of X X' = L L'. A ridge is the same there.
fn span(design: &[Vec<f64>]) -> Option<(Vec<Vec<f64>>, DMatrix<f64>)> {
    let n = design.len();
    let product = |i: usize, j: usize| design[i].iter().zip(&design[j]).map(|(a, b)| a * b).sum::<f64>();
    let mut gram = DMatrix::from_fn(n, n, |i, j| if j <= i { product(i, j) } else { 0.0 });
    gram.fill_upper_triangle_with_lower_triangle();
    let jitter = JITTER * gram.trace().max(f64::MIN_POSITIVE) / n as f64;
    let lower = Cholesky::new(gram + DMatrix::identity(n, n) * jitter)?.l();
    Some((lower.row_iter().map(|row| row.iter().copied().collect()).collect(), lower))
}

/// Weights of features from those of the coordinates: X' a with L' a = v.
fn back(design: &[Vec<f64>], lower: &DMatrix<f64>, weights: &DVector<f64>) -> Vec<f64> {
    let shares = lower.transpose().solve_upper_triangular(weights).unwrap_or_else(|| DVector::zeros(weights.len()));
    let weight = |j: usize| design.iter().zip(shares.iter()).map(|(row, a)| a * row[j]).sum();
    (0..design[0].len()).map(weight).collect()
}

/// Mean and deviation (divided by n) of features.
#[derive(Debug, Clone, PartialEq)]
pub struct Standard {
    mean: Vec<f64>,
    deviation: Vec<f64>,
}

impl Standard {
    /// Those of some rows.
    pub fn of(rows: &[&[f64]]) -> Self {
        let (mean, deviation) = moments(rows, rows.first().map_or(0, |row| row.len()));
        Self { mean, deviation }
    }

    /// The standardised features of a row; 0 for a feature that does not vary.
    pub fn scores(&self, row: &[f64]) -> Vec<f64> {
        let z = |j: usize| if self.deviation[j] > 0.0 { (row[j] - self.mean[j]) / self.deviation[j] } else { 0.0 };
        (0..row.len()).map(z).collect()
    }
}

fn moments(rows: &[&[f64]], p: usize) -> (Vec<f64>, Vec<f64>) {
    let n = rows.len() as f64;
    let mean: Vec<f64> = (0..p).map(|j| rows.iter().map(|row| row[j]).sum::<f64>() / n).collect();
    let deviation = |j: usize| {
        let largest = rows.iter().map(|row| row[j].abs()).fold(0.0, f64::max);
        let s = (rows.iter().map(|row| (row[j] - mean[j]) * (row[j] - mean[j])).sum::<f64>() / n).sqrt();
        if s > 1e-12 * largest { s } else { 0.0 }
    };
    let deviation = (0..p).map(deviation).collect();
    (mean, deviation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    fn sample(n: i32, seed: u8, shift: f64) -> Vec<Vec<f64>> {
        let field = Key([seed; 32]).field();
        (0..n).map(|i| (0..4).map(|j| field.normal(i, j) + if j == 0 { shift } else { 0.0 }).collect()).collect()
    }

    #[test]
    fn the_area_by_hand_and_its_error_by_the_known_case() {
        let found = area(&[1.0, 2.0, 3.0], &[2.0, 4.0]);
        // Of six pairs four are won and one is tied.
        assert!((found.auc - 4.5 / 6.0).abs() < 1e-12);
        assert!(area(&[0.0, 1.0], &[2.0, 3.0]).error.abs() < 1e-12);
    }

    #[test]
    fn more_features_than_rows_give_the_same_weights_as_the_same_features_twice() {
        // Twelve rows of 4 features are fitted directly; repeated six times each, 24 features exceed the rows: each copy gets a
        // sixth of the weight at six times the ridge.
        let (a, b) = (sample(6, 1, 0.0), sample(6, 2, 1.0));
        let slices = |rows: &[Vec<f64>], times: usize| rows.iter().map(|row| row.repeat(times)).collect::<Vec<_>>();
        let fit = |times: usize, ridge: f64| {
            let classes = [slices(&a, times), slices(&b, times)];
            let rows = classes.each_ref().map(|class| class.iter().map(Vec::as_slice).collect::<Vec<_>>());
            Logistic::fit([&rows[0], &rows[1]], ridge)
        };
        let (few, many) = (fit(1, 1.0), fit(6, 6.0));
        for j in 0..4 {
            assert!((few.weights[j] - 6.0 * many.weights[j + 8]).abs() < 1e-6, "{few:?} {many:?}");
        }
        assert!((few.score(&a[0]) - many.score(&a[0].repeat(6))).abs() < 1e-6);
    }
}
