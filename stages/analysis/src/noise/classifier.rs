//! Can a classifier tell simulated rasters from real ones? Ridge logistic regression, cross-validated, and the area under
//! its ROC curve (classifier two-sample test, Lopez-Paz and Oquab 2017).

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
    mean: Vec<f64>,
    deviation: Vec<f64>,
    /// Intercept.
    pub intercept: f64,
    /// Weight of each standardised feature; 0 where it does not vary.
    pub weights: Vec<f64>,
}

/// Keeps the first step of the intercept finite.
const DAMPING: f64 = 1e-9;

impl Logistic {
    /// Fits a logistic regression: both classes count the same, and `ridge / 2` times the sum of squared weights (without the
    /// intercept) is added to the mean log-loss times the number of rows.
    pub fn fit(classes: [&[&[f64]]; 2], ridge: f64) -> Self {
        let rows: Vec<&[f64]> = classes.iter().flat_map(|class| class.iter().copied()).collect();
        let (mean, deviation) = moments(&rows, rows.first().map_or(0, |row| row.len()));
        let design: Vec<Vec<f64>> = rows.iter().map(|row| standardised(row, &mean, &deviation)).collect();
        let counts = classes.map(<[_]>::len);
        let happened: Vec<bool> = (0..rows.len()).map(|i| i >= counts[0]).collect();
        let importance: Vec<f64> =
            happened.iter().map(|second| 0.5 * rows.len() as f64 / counts[usize::from(*second)] as f64).collect();
        let regression =
            Regression { design: &design, happened: &happened, importance: &importance, ridge, damping: DAMPING };
        let weights = logistic::fit(&regression).weights;
        let intercept = weights.get(0).copied().unwrap_or(0.0);
        Self { mean, deviation, intercept, weights: weights.iter().skip(1).copied().collect() }
    }

    /// The score of a raster: the logarithm of its odds to be of the second class.
    pub fn score(&self, values: &[f64]) -> f64 {
        let x = standardised(values, &self.mean, &self.deviation);
        self.intercept + x[1..].iter().zip(&self.weights).map(|(x, w)| x * w).sum::<f64>()
    }
}

/// 1 and the standardised features; 0 for a feature that does not vary.
fn standardised(row: &[f64], mean: &[f64], deviation: &[f64]) -> Vec<f64> {
    let z = |j: usize| if deviation[j] > 0.0 { (row[j] - mean[j]) / deviation[j] } else { 0.0 };
    std::iter::once(1.0).chain((0..row.len()).map(z)).collect()
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

/// Scores of every row of both classes by classifiers that did not see it: fold k of a class is its k-th run of rows, so that
/// rows that stand side by side and may share an epoch mostly fall into one fold.
pub fn cross_validated(classes: [&[Vec<f64>]; 2], folds: usize, ridge: f64) -> [Vec<f64>; 2] {
    let fold = |class: usize, row: usize| row * folds / classes[class].len();
    let mut scores = classes.map(|class| vec![0.0; class.len()]);
    for held_out in 0..folds {
        let training = |class: usize| -> Vec<&[f64]> {
            let rows = classes[class].iter().enumerate();
            rows.filter(|(row, _)| fold(class, *row) != held_out).map(|(_, values)| values.as_slice()).collect()
        };
        let model = Logistic::fit([&training(0), &training(1)], ridge);
        for (class, rows) in classes.iter().enumerate() {
            for (row, values) in rows.iter().enumerate().filter(|(row, _)| fold(class, *row) == held_out) {
                scores[class][row] = model.score(values);
            }
        }
    }
    scores
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
    fn equal_samples_cannot_be_told_apart_and_shifted_ones_can() {
        let auc = |shift: f64| {
            let (a, b) = (sample(200, 1, 0.0), sample(200, 2, shift));
            let scores = cross_validated([&a, &b], 5, 1.0);
            area(&scores[0], &scores[1])
        };
        let same = auc(0.0);
        assert!(same.interval().0 < 0.5 && same.auc < 0.58, "{same:?}");
        // A shift of d deviations has area Phi(d / sqrt 2): 0.7602 at 1.
        let apart = auc(1.0);
        assert!((apart.auc - 0.760).abs() < 0.06, "{apart:?}");
    }

    #[test]
    fn constant_features_and_separable_classes_are_no_trouble() {
        let constant = |x: f64| -> Vec<Vec<f64>> { (0..10).map(|i| vec![7.0, x + 0.01 * f64::from(i)]).collect() };
        let (a, b) = (constant(0.0), constant(5.0));
        let scores = cross_validated([&a, &b], 5, 1.0);
        assert!((area(&scores[0], &scores[1]).auc - 1.0).abs() < 1e-12);
    }
}
