//! Mean and spread of features as functions of parameters, learnt from simulations at some points.
//!
//! Around the reference each feature is a polynomial of the parameters, linear, or quadratic where there are simulations enough, by
//! weighted least squares. What is left over is the spread: the logarithm of its variance is linear in the parameters (gamma
//! regression with a ridge, since one simulation says little about a variance), and the correlation of what is left is the same
//! everywhere. Parameters are scaled: -1 and 1 are the ends of the range of the simulations.

use nalgebra::{Cholesky, DMatrix, DVector};
use rockface_core::numerics::portable_math;

/// A polynomial for the mean of each feature, a log-linear one for its variance, one correlation matrix.
#[derive(Debug, Clone)]
pub struct Surrogate {
    quadratic: bool,
    /// Coefficients by term (row) and feature (column).
    coefficients: DMatrix<f64>,
    /// Inverse of the weighted products of terms.
    inverse: DMatrix<f64>,
    /// Coefficients of the log-variance of each feature, and their covariance.
    variances: Vec<(DVector<f64>, DMatrix<f64>)>,
    /// Correlation of what is left over.
    pub correlation: DMatrix<f64>,
    /// Number of simulations of equal weight that would say as much.
    pub effective: f64,
}

/// Ridge on the coefficients of the mean, as a share of a simulation.
const RIDGE: f64 = 1e-6;
/// Least mean square of the terms along any direction.
const LEAST_VARIED: f64 = 1e-6;
/// Prior deviation of the change of a log-variance over half the range of a parameter: a factor of two in the deviation is 1.4.
const VARIANCE_SLOPE: f64 = 0.7;
/// Newton steps of the gamma regression, and the longest.
const STEPS: usize = 40;
/// Least share of a residual that is not used up by the fit.
const LEAST_FREE: f64 = 0.05;

impl Surrogate {
    /// Fits rows of scaled parameters and features with their weights; `None` where some direction was not varied.
    pub fn fit(parameters: &[Vec<f64>], features: &[Vec<f64>], weights: &[f64]) -> Option<Self> {
        let q = parameters.first()?.len();
        let total: f64 = weights.iter().sum();
        let weights: Vec<f64> = weights.iter().map(|w| w * weights.len() as f64 / total).collect();
        let effective = weights.len() as f64 * weights.len() as f64 / weights.iter().map(|w| w * w).sum::<f64>();
        let enough = effective >= 2.0 * terms(&vec![0.0; q], true).len() as f64;
        // Points at the corners of a box tell a square from nothing; such points leave the polynomial linear.
        let (quadratic, design, products) =
            [true, false].into_iter().filter(|quadratic| enough || !quadratic).find_map(|quadratic| {
                let design: Vec<Vec<f64>> = parameters.iter().map(|x| terms(x, quadratic)).collect();
                let products = weighted_products(&design, &weights);
                let smallest = products.clone().symmetric_eigen().eigenvalues.min();
                (smallest > LEAST_VARIED * weights.len() as f64).then_some((quadratic, design, products))
            })?;
        let count = products.nrows();
        let inverse = Cholesky::new(products + DMatrix::identity(count, count) * RIDGE)?.inverse();
        let p = features[0].len();
        let moment = |t: usize, j: usize| -> f64 {
            design.iter().zip(features).zip(&weights).map(|((d, z), w)| w * d[t] * z[j]).sum()
        };
        let coefficients = product(&inverse, &DMatrix::from_fn(count, p, moment));
        let mut found = Self {
            quadratic,
            coefficients,
            inverse,
            variances: Vec::new(),
            correlation: DMatrix::identity(p, p),
            effective,
        };
        found.learn_spread(parameters, features, &weights, &design)?;
        Some(found)
    }

    fn learn_spread(
        &mut self,
        parameters: &[Vec<f64>],
        features: &[Vec<f64>],
        weights: &[f64],
        design: &[Vec<f64>],
    ) -> Option<()> {
        let p = features[0].len();
        let free: Vec<f64> = design
            .iter()
            .zip(weights)
            .map(|(d, w)| (1.0 - w * quadratic_form(&self.inverse, d)).max(LEAST_FREE).sqrt())
            .collect();
        let left: Vec<Vec<f64>> = parameters
            .iter()
            .zip(features)
            .zip(&free)
            .map(|((x, z), free)| self.mean(x).iter().zip(z).map(|(m, z)| (z - m) / free).collect())
            .collect();
        let linear: Vec<Vec<f64>> = parameters.iter().map(|x| terms(x, false)).collect();
        for j in 0..p {
            let squares: Vec<f64> = left.iter().map(|e| (e[j] * e[j]).max(f64::MIN_POSITIVE)).collect();
            self.variances.push(gamma_regression(&linear, &squares, weights)?);
        }
        let standard: Vec<Vec<f64>> = parameters
            .iter()
            .zip(&left)
            .map(|(x, e)| self.log_deviation(x).iter().zip(e).map(|((l, _), e)| e / portable_math::exp(*l)).collect())
            .collect();
        let moment = |i: usize, j: usize| standard.iter().zip(weights).map(|(u, w)| w * u[i] * u[j]).sum::<f64>();
        let size: Vec<f64> = (0..p).map(|j| moment(j, j).sqrt()).collect();
        self.correlation = DMatrix::from_fn(p, p, |i, j| {
            if i == j { 1.0 } else { moment(i.min(j), i.max(j)) / (size[i] * size[j]).max(f64::MIN_POSITIVE) }
        });
        Some(())
    }

    /// The mean features at parameters.
    pub fn mean(&self, x: &[f64]) -> Vec<f64> {
        let terms = terms(x, self.quadratic);
        self.coefficients.column_iter().map(|c| c.iter().zip(&terms).map(|(c, t)| c * t).sum()).collect()
    }

    /// The variance of the mean at parameters, as a share of that of one simulation.
    pub fn leverage(&self, x: &[f64]) -> f64 {
        quadratic_form(&self.inverse, &terms(x, self.quadratic))
    }

    /// The logarithm of the deviation of each feature at parameters, and the variance of that logarithm.
    pub fn log_deviation(&self, x: &[f64]) -> Vec<(f64, f64)> {
        let terms = terms(x, false);
        let value = |c: &DVector<f64>| 0.5 * c.iter().zip(&terms).map(|(c, t)| c * t).sum::<f64>();
        self.variances.iter().map(|(c, covariance)| (value(c), 0.25 * quadratic_form(covariance, &terms))).collect()
    }

    /// The change of feature `j` with scaled parameter `a` at a point, and its standard error.
    pub fn slope(&self, x: &[f64], a: usize, j: usize) -> (f64, f64) {
        let step = 1e-3;
        let moved = |by: f64| {
            let mut x = x.to_vec();
            x[a] += by;
            terms(&x, self.quadratic)
        };
        let change: Vec<f64> = moved(step).iter().zip(moved(-step)).map(|(u, l)| (u - l) / (2.0 * step)).collect();
        let slope = change.iter().zip(self.coefficients.column(j).iter()).map(|(t, c)| t * c).sum();
        let deviation = portable_math::exp(self.log_deviation(x)[j].0);
        (slope, deviation * quadratic_form(&self.inverse, &change).max(0.0).sqrt())
    }

    /// The change of the logarithm of the deviation of feature `j` with scaled parameter `a`.
    pub fn spread_slope(&self, a: usize, j: usize) -> f64 {
        0.5 * self.variances[j].0[a + 1]
    }
}

/// 1, the parameters and, where quadratic, their products.
fn terms(x: &[f64], quadratic: bool) -> Vec<f64> {
    let mut terms: Vec<f64> = std::iter::once(1.0).chain(x.iter().copied()).collect();
    if quadratic {
        for (i, first) in x.iter().enumerate() {
            terms.extend(x[i..].iter().map(|second| first * second));
        }
    }
    terms
}

/// Summed here and not by a matrix product, whose kernels depend on the processor.
fn product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(a.nrows(), b.ncols(), |i, j| (0..a.ncols()).map(|k| a[(i, k)] * b[(k, j)]).sum())
}

fn weighted_products(design: &[Vec<f64>], weights: &[f64]) -> DMatrix<f64> {
    let count = design.first().map_or(0, Vec::len);
    let sum = |i: usize, j: usize| design.iter().zip(weights).map(|(d, w)| w * d[i] * d[j]).sum::<f64>();
    DMatrix::from_fn(count, count, |i, j| sum(i.min(j), i.max(j)))
}

/// The quadratic form x' A x.
fn quadratic_form(a: &DMatrix<f64>, x: &[f64]) -> f64 {
    let row = |i: usize| x.iter().enumerate().map(|(j, x)| a[(i, j)] * x).sum::<f64>();
    x.iter().enumerate().map(|(i, x)| x * row(i)).sum()
}

/// Coefficients of the logarithm of an expected square, linear in the terms, and their covariance: squares are a variance times a
/// chi-square of one degree of freedom, and slopes have a normal prior.
fn gamma_regression(design: &[Vec<f64>], squares: &[f64], weights: &[f64]) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let count = design.first()?.len();
    let total: f64 = weights.iter().sum();
    let mean = squares.iter().zip(weights).map(|(s, w)| s * w).sum::<f64>() / total;
    let mut found = DVector::zeros(count);
    found[0] = portable_math::log(mean.max(f64::MIN_POSITIVE));
    let prior = |t: usize| if t == 0 { 0.0 } else { 1.0 / (VARIANCE_SLOPE * VARIANCE_SLOPE) };
    let mut covariance = DMatrix::zeros(count, count);
    for _ in 0..STEPS {
        let ratio = |(d, s): (&Vec<f64>, &f64)| {
            s / portable_math::exp(d.iter().zip(found.iter()).map(|(d, c)| d * c).sum::<f64>().clamp(-700.0, 700.0))
        };
        let ratios: Vec<f64> = design.iter().zip(squares).map(ratio).collect();
        let gradient = DVector::from_fn(count, |t, _| {
            let pull: f64 = design.iter().zip(&ratios).zip(weights).map(|((d, u), w)| 0.5 * w * (u - 1.0) * d[t]).sum();
            pull - prior(t) * found[t]
        });
        // The expected curvature: it is positive wherever the step starts.
        let half: Vec<f64> = weights.iter().map(|w| 0.5 * w).collect();
        let mut curvature = weighted_products(design, &half);
        (0..count).for_each(|t| curvature[(t, t)] += prior(t));
        covariance = Cholesky::new(curvature)?.inverse();
        let step = product(&covariance, &DMatrix::from_column_slice(count, 1, gradient.as_slice()));
        let longest = step.amax();
        let share = if longest > 1.0 { 1.0 / longest } else { 1.0 };
        (0..count).for_each(|t| found[t] += share * step[(t, 0)]);
        if longest < 1e-9 {
            break;
        }
    }
    Some((found, covariance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    fn points(n: i32) -> Vec<Vec<f64>> {
        let field = Key([3; 32]).field();
        (0..n).map(|i| (0..2).map(|j| field.normal(i, j).clamp(-1.5, 1.5) / 1.5).collect()).collect()
    }

    #[test]
    fn a_linear_world_is_learnt_with_its_slopes() {
        let parameters = points(12);
        let truth = |x: &[f64]| vec![1.0 + 2.0 * x[0], -3.0 + x[0] - x[1], 0.5 * x[1]];
        let features: Vec<Vec<f64>> = parameters.iter().map(|x| truth(x)).collect();
        let found = Surrogate::fit(&parameters, &features, &[1.0; 12]).unwrap();
        assert!((found.mean(&[0.3, -0.7])[1] + 2.0).abs() < 1e-4);
        assert!((found.slope(&[0.0, 0.0], 0, 0).0 - 2.0).abs() < 1e-4);
        assert!(found.slope(&[0.0, 0.0], 1, 0).0.abs() < 1e-4);
    }

    #[test]
    fn curvature_and_a_spread_that_grows_are_learnt_from_many() {
        let (parameters, field) = (points(400), Key([4; 32]).field());
        let feature = |(i, x): (usize, &Vec<f64>)| {
            let spread = portable_math::exp(0.8 * x[1] - 1.0);
            vec![x[0] * x[0] + spread * field.normal(i as i32, 0), 0.1 * field.normal(i as i32, 1)]
        };
        let features: Vec<Vec<f64>> = parameters.iter().enumerate().map(feature).collect();
        let found = Surrogate::fit(&parameters, &features, &[1.0; 400]).unwrap();
        assert!((found.mean(&[0.9, 0.0])[0] - 0.81).abs() < 0.15 && found.mean(&[0.0, 0.0])[0].abs() < 0.1);
        assert!((found.spread_slope(1, 0) - 0.8).abs() < 0.2 && found.spread_slope(0, 0).abs() < 0.2);
        assert!((found.log_deviation(&[0.0, 0.0])[0].0 + 1.0).abs() < 0.15);
        assert!(found.correlation[(0, 1)].abs() < 0.2 && found.leverage(&[0.0, 0.0]) < 0.05);
    }

    #[test]
    fn a_parameter_that_was_not_varied_is_no_surrogate() {
        let parameters = vec![vec![1.0, 0.5], vec![-1.0, 0.5], vec![0.0, 0.5], vec![0.5, 0.5]];
        assert!(Surrogate::fit(&parameters, &[vec![0.0], vec![1.0], vec![2.0], vec![0.5]], &[1.0; 4]).is_none());
    }
}
