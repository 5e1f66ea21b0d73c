//! Logistic regression by Newton's method, which here is iteratively reweighted least squares; with a ridge or without.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::portable_math;

/// Newton steps at most: a problem with a finite optimum takes fewer than ten.
const STEPS: usize = 60;
/// The largest part of a Newton step below which the weights have settled.
const SETTLED: f64 = 1e-10;
/// Least curvature of a row, so that rows that are all but certain leave a matrix that can be solved.
const LEAST_CURVATURE: f64 = 1e-12;

/// Rows whose event happens with probability `1 / (1 + exp(-x . weights))`, x being the features of a row.
#[derive(Debug, Clone, Copy)]
pub struct Regression<'a> {
    /// Features of each row; the first is 1, its weight is the intercept.
    pub design: &'a [Vec<f64>],
    /// Whether the event of each row happened.
    pub happened: &'a [bool],
    /// How much each row counts in the log-loss.
    pub importance: &'a [f64],
    /// `ridge / 2` times the sum of squared weights, without the intercept, is added to the log-loss; 0 for maximum likelihood.
    pub ridge: f64,
    /// Added to the curvature of the intercept: shortens its steps and leaves the optimum where it is.
    pub damping: f64,
}

/// The weights of a regression, and how well they are known.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// Weight of each feature.
    pub weights: DVector<f64>,
    /// Second derivatives of the loss at the last step; without a ridge its inverse is the covariance of the weights.
    pub information: DMatrix<f64>,
    /// Whether the weights settled. They do not where the features separate the rows without error and there is no ridge.
    pub settled: bool,
}

/// Finds the weights of least log-loss, with the ridge added.
pub fn fit(regression: &Regression) -> Fit {
    let count = regression.design.first().map_or(0, Vec::len);
    let mut fit = Fit { weights: DVector::zeros(count), information: DMatrix::zeros(count, count), settled: false };
    for _ in 0..STEPS {
        let gradient;
        (gradient, fit.information) = regression.derivatives(&fit.weights);
        let Some(step) = Cholesky::new(fit.information.clone()).map(|c| c.solve(&gradient)) else { break };
        fit.weights += &step;
        if step.amax() < SETTLED {
            fit.settled = true;
            break;
        }
    }
    fit
}

impl Regression<'_> {
    /// Gradient of the log-likelihood, less that of the ridge, and the second derivatives of the loss.
    fn derivatives(&self, weights: &DVector<f64>) -> (DVector<f64>, DMatrix<f64>) {
        let count = weights.len();
        let mut hessian = DMatrix::from_diagonal_element(count, count, self.ridge);
        let mut gradient: DVector<f64> = weights.clone() * -self.ridge;
        if count > 0 {
            (hessian[(0, 0)], gradient[0]) = (self.damping, 0.0);
        }
        for ((x, happened), importance) in self.design.iter().zip(self.happened).zip(self.importance) {
            let p = probability(x.iter().zip(weights.iter()).map(|(x, w)| x * w).sum());
            let curvature = importance * (p * (1.0 - p)).max(LEAST_CURVATURE);
            let slope = importance * (f64::from(u8::from(*happened)) - p);
            for a in 0..count {
                gradient[a] += slope * x[a];
                for b in 0..count {
                    hessian[(a, b)] += curvature * x[a] * x[b];
                }
            }
        }
        (gradient, hessian)
    }
}

/// The probability of these logarithmic odds.
pub fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + portable_math::exp(-log_odds.clamp(-40.0, 40.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of ten rows at 0 three happened, of ten at 1 eight.
    fn rows() -> (Vec<Vec<f64>>, Vec<bool>) {
        (0..20).map(|i| (vec![1.0, f64::from(i / 10)], i < 3 || (10..18).contains(&i))).unzip()
    }

    #[test]
    fn two_groups_by_hand() {
        let (design, happened) = rows();
        let regression =
            Regression { design: &design, happened: &happened, importance: &[1.0; 20], ridge: 0.0, damping: 0.0 };
        let found = fit(&regression);
        let logit = |p: f64| portable_math::log(p / (1.0 - p));
        assert!(found.settled);
        assert!(
            (found.weights[0] - logit(0.3)).abs() < 1e-12 && (found.weights[1] - logit(0.8) + logit(0.3)).abs() < 1e-12
        );
        // Variance of a difference of log-odds: the sum of 1 / (n p (1 - p)).
        let covariance = found.information.try_inverse().unwrap();
        assert!((covariance[(1, 1)] - (1.0 / 2.1 + 1.0 / 1.6)).abs() < 1e-9);
    }

    #[test]
    fn a_ridge_holds_weights_back_and_damping_does_not() {
        let (design, happened) = rows();
        let with = |ridge: f64, damping: f64| {
            fit(&Regression { design: &design, happened: &happened, importance: &[1.0; 20], ridge, damping })
        };
        let plain = with(0.0, 0.0);
        assert!((with(0.0, 0.1).weights - &plain.weights).amax() < 1e-9);
        let held = with(5.0, 0.0).weights[1];
        assert!(held > 0.0 && held < 0.6 * plain.weights[1], "{held}");
    }

    #[test]
    fn separated_rows_have_no_finite_optimum_without_a_ridge() {
        let design: Vec<Vec<f64>> = (0..6).map(|i| vec![1.0, f64::from(i)]).collect();
        let happened = [false, false, false, true, true, true];
        let with = |ridge: f64| {
            fit(&Regression { design: &design, happened: &happened, importance: &[1.0; 6], ridge, damping: 0.0 })
        };
        let loose = with(0.0);
        assert!(!loose.settled || loose.information.determinant() < 1e-12, "{loose:?}");
        assert!(with(1.0).settled);
    }
}
