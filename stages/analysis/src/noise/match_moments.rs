//! Which parameters would give the mean and the spread of the features of the reference (simulated moments with both:
//! Econometrica 57, 995, 1989; dispersion as in quasi-likelihood: Annals of Statistics 11, 59, 1983).
//!
//! What is made small is `J = m' P m + h tr(P S) + sum of (ln s_j)^2 / tau^2`, with m the mean of the standardised features at some parameters, P
//! the inverse covariance of the test, S the covariance there, h the variance of the estimated mean as a share of S, and `s_j` the
//! deviation of feature j over that of the reference. The likelihood of the parameters is exp(-n J / 2 c), flat within the range searched; c, at least
//! 1, is what n J comes to at the best point for each degree of freedom, so that a family that does not fit has wide intervals, not
//! narrow ones around the wrong place.

use nalgebra::{Cholesky, DMatrix};
use rockface_core::artefact::GroupModel;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;

use super::points::halton;
use super::surrogate::Surrogate;

/// The logarithm of the factor between deviations that counts as a mean that is off by one deviation: 1.41.
const SPREAD: f64 = 0.346_573_590_279_972_64;
/// Where the mean is less certain than one simulation is, nothing is proposed.
const MOST_LEVERAGE: f64 = 1.0;
/// Points the search starts from, steps of the chain, and steps it forgets.
const STARTS: u64 = 2000;
const STEPS: i32 = 12_000;
const FORGOTTEN: i32 = 3000;
/// How often the chain learns its step while it is forgotten.
const LEARN: i32 = 1000;
/// Rasters drawn to predict what passes.
const DRAWN: i32 = 2000;
const CHAIN: Key = Key(*b"chain over parameters of a model");
const RASTERS: Key = Key(*b"rasters predicted for parameters");

/// The reference and what is known of the simulations.
pub struct Match<'a> {
    surrogate: &'a Surrogate,
    /// Inverse covariance of the test.
    inverse: DMatrix<f64>,
    /// Its inverse: covariance of the reference plus ridge.
    covariance: DMatrix<f64>,
    ridge: f64,
    /// Correlation of the features of one simulation to the next.
    correlation: DMatrix<f64>,
    /// Number of references, fewer where they share epochs.
    references: f64,
    /// Bounds of each scaled parameter: minus and plus this.
    reach: f64,
}

/// What a search over scaled parameters found.
#[derive(Debug, Clone)]
pub struct Found {
    /// Scaled parameters of the smallest J.
    pub best: Vec<f64>,
    /// Scaled parameters of the chain.
    pub chain: Vec<Vec<f64>>,
}

/// What a model is predicted to make at some parameters.
#[derive(Debug, Clone)]
pub struct Predicted {
    /// Mean of the standardised features.
    pub offset: Vec<f64>,
    /// What each adds to the D2 of the mean.
    pub contributions: Vec<f64>,
    /// D2 of the mean.
    pub d2: f64,
    /// Deviation of each feature over that of the reference, and the error of its logarithm.
    pub spread: Vec<(f64, f64)>,
    /// ln |S| / |S of the reference|.
    pub log_determinant_ratio: f64,
    /// Standardised features of rasters drawn from the prediction.
    pub rasters: Vec<Vec<f64>>,
}

impl<'a> Match<'a> {
    /// `None` where the covariance of the test has no inverse.
    pub fn new(surrogate: &'a Surrogate, model: &GroupModel, ridge: f64, references: f64, reach: f64) -> Option<Self> {
        let p = model.features.len();
        let inverse = DMatrix::from_fn(p, p, |i, j| model.inverse[i][j]);
        let covariance = Cholesky::new(inverse.clone())?.inverse();
        // Few simulations say little about correlations: what is missing is taken from the reference.
        let share = surrogate.effective / (surrogate.effective + p as f64);
        let size = |j: usize| (covariance[(j, j)] - ridge).max(f64::MIN_POSITIVE).sqrt();
        let real = |i: usize, j: usize| if i == j { 1.0 } else { covariance[(i, j)] / (size(i) * size(j)) };
        let mixed = |i: usize, j: usize| share * surrogate.correlation[(i, j)] + (1.0 - share) * real(i, j);
        let correlation = DMatrix::from_fn(p, p, mixed);
        Some(Self { surrogate, inverse, covariance, ridge, correlation, references, reach })
    }

    fn covariance_at(&self, logs: &[(f64, f64)]) -> DMatrix<f64> {
        let size: Vec<f64> = logs.iter().map(|(log, _)| portable_math::exp(*log)).collect();
        DMatrix::from_fn(size.len(), size.len(), |i, j| {
            size[i] * size[j] * self.correlation[(i, j)] + if i == j { self.ridge } else { 0.0 }
        })
    }

    /// The logarithm of `s_j`, the deviation of a feature over that of the reference.
    fn log_ratio(&self, j: usize, covariance: &DMatrix<f64>) -> f64 {
        0.5 * portable_math::log(covariance[(j, j)] / self.covariance[(j, j)])
    }

    /// J; infinite outside of the range and where the simulations say nothing.
    fn misfit(&self, x: &[f64]) -> f64 {
        let leverage = self.surrogate.leverage(x);
        if x.iter().any(|x| x.abs() > self.reach) || leverage > MOST_LEVERAGE {
            return f64::INFINITY;
        }
        let logs = self.surrogate.log_deviation(x);
        let covariance = self.covariance_at(&logs);
        let p = logs.len();
        let trace: f64 = (0..p).map(|i| (0..p).map(|j| self.inverse[(i, j)] * covariance[(j, i)]).sum::<f64>()).sum();
        let spread = |j: usize| {
            let log = self.log_ratio(j, &covariance);
            (log * log + logs[j].1) / (SPREAD * SPREAD)
        };
        let d2: f64 = self.contributions(&self.surrogate.mean(x)).iter().sum();
        d2 + leverage * trace + (0..p).map(spread).sum::<f64>()
    }

    fn contributions(&self, mean: &[f64]) -> Vec<f64> {
        let along = |i: usize| mean.iter().enumerate().map(|(j, m)| self.inverse[(i, j)] * m).sum::<f64>();
        mean.iter().enumerate().map(|(i, m)| m * along(i)).collect()
    }

    /// Searches the range and walks it (Metropolis et al. 1953). `None` where no point of the range is near enough to the simulations.
    pub fn search(&self, dimensions: usize) -> Option<Found> {
        let start = |k: u64| (0..dimensions).map(|j| self.reach * (2.0 * halton(k, j) - 1.0)).collect::<Vec<f64>>();
        let starts = (1..=STARTS).map(start).chain(std::iter::once(vec![0.0; dimensions]));
        let mut walk = Walk::at(starts.map(|x| (self.misfit(&x), x)).min_by(|a, b| a.0.total_cmp(&b.0))?)?;
        let p = self.inverse.nrows();
        let freedom = (2 * p).saturating_sub(dimensions).max(1) as f64;
        let mut chain: Vec<Vec<f64>> = Vec::new();
        for step in 0..STEPS {
            // The dispersion follows the best point until the chain is kept.
            if step % LEARN == 0 && step <= FORGOTTEN {
                walk.dispersion = (self.references * walk.best.0 / freedom).max(1.0);
                walk.learn(&chain);
                chain.clear();
            }
            walk.step(step, self);
            chain.push(walk.here.1.clone());
        }
        Some(Found { best: walk.best.1, chain })
    }

    /// What is predicted at some parameters.
    pub fn predict(&self, x: &[f64]) -> Predicted {
        let (offset, logs) = (self.surrogate.mean(x), self.surrogate.log_deviation(x));
        let covariance = self.covariance_at(&logs);
        let contributions = self.contributions(&offset);
        let spread = |j: usize| (portable_math::exp(self.log_ratio(j, &covariance)), logs[j].1.sqrt());
        Predicted {
            d2: contributions.iter().sum(),
            contributions,
            spread: (0..offset.len()).map(spread).collect(),
            log_determinant_ratio: log_determinant(&covariance) - log_determinant(&self.covariance),
            rasters: rasters(&offset, &covariance),
            offset,
        }
    }
}

fn log_determinant(matrix: &DMatrix<f64>) -> f64 {
    let Some(factor) = Cholesky::new(matrix.clone()) else { return f64::NAN };
    let factor = factor.l();
    2.0 * (0..matrix.nrows()).map(|i| portable_math::log(factor[(i, i)])).sum::<f64>()
}

/// Rasters drawn around a mean.
fn rasters(mean: &[f64], covariance: &DMatrix<f64>) -> Vec<Vec<f64>> {
    let Some(factor) = Cholesky::new(covariance.clone()).map(|factor| factor.l()) else { return Vec::new() };
    let field = RASTERS.field();
    let raster = |i: i32| {
        let e: Vec<f64> = (0..mean.len()).map(|j| field.normal(j as i32, i)).collect();
        (0..mean.len()).map(|j| mean[j] + (0..=j).map(|k| factor[(j, k)] * e[k]).sum::<f64>()).collect()
    };
    (0..DRAWN).map(raster).collect()
}

/// A random walk over parameters: misfit and place of the best and the present point.
struct Walk {
    best: (f64, Vec<f64>),
    here: (f64, Vec<f64>),
    step_size: Vec<f64>,
    dispersion: f64,
}

impl Walk {
    fn at(start: (f64, Vec<f64>)) -> Option<Self> {
        let step_size = vec![0.2; start.1.len()];
        start.0.is_finite().then(|| Self { best: start.clone(), here: start, step_size, dispersion: 1.0 })
    }

    /// Steps as wide as the walk has been, times what suits so many dimensions (Gelman, Roberts and Gilks 1996).
    fn learn(&mut self, chain: &[Vec<f64>]) {
        if chain.is_empty() {
            return;
        }
        let n = chain.len() as f64;
        let factor = 2.4 / (self.step_size.len() as f64).sqrt();
        for (j, size) in self.step_size.iter_mut().enumerate() {
            let mean = chain.iter().map(|x| x[j]).sum::<f64>() / n;
            let square = chain.iter().map(|x| (x[j] - mean) * (x[j] - mean)).sum::<f64>() / n;
            *size = (factor * square.sqrt()).clamp(1e-4, 1.0);
        }
    }

    fn step(&mut self, step: i32, of: &Match) {
        let field = CHAIN.field();
        let next: Vec<f64> = (0..self.step_size.len())
            .map(|j| self.here.1[j] + self.step_size[j] * field.normal(j as i32, step))
            .collect();
        let misfit = of.misfit(&next);
        let likelier = 0.5 * of.references / self.dispersion * (self.here.0 - misfit);
        let uniform = (f64::from(field.words(-1, step)[0]) + 0.5) / 4_294_967_296.0;
        if portable_math::log(uniform) < likelier {
            self.here = (misfit, next);
            if misfit < self.best.0 {
                self.best = self.here.clone();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::mahalanobis::fit;

    /// A world of three features: two follow a parameter each, the spread of the third follows the second.
    fn feature(x: &[f64], field: &rockface_core::numerics::random::Field, i: i32) -> Vec<f64> {
        let e = |j: i32| 0.3 * field.normal(j, i);
        vec![2.0 * x[0] + e(0), x[1] - x[0] + e(1), portable_math::exp(x[1]) * e(2)]
    }

    fn matched(truth: &[f64], shift: f64) -> (Found, Predicted) {
        let (real, simulated) = (Key([1; 32]).field(), Key([2; 32]).field());
        let names = ["a", "b", "c"].map(str::to_owned);
        let mut rows: Vec<Vec<f64>> = (0..40).map(|i| feature(truth, &real, i)).collect();
        rows.iter_mut().for_each(|row| row[2] += shift);
        let model = fit(&names, &rows, 1e-3).unwrap();
        let parameters: Vec<Vec<f64>> = (1..=120).map(|k| (0..2).map(|j| 2.0 * halton(k, j) - 1.0).collect()).collect();
        let z = |row: &[f64]| (0..3).map(|j| (row[j] - model.mean[j]) / model.deviation[j]).collect::<Vec<f64>>();
        let features: Vec<Vec<f64>> =
            parameters.iter().enumerate().map(|(i, x)| z(&feature(x, &simulated, i as i32))).collect();
        let surrogate = Surrogate::fit(&parameters, &features, &[1.0; 120]).unwrap();
        let matching = Match::new(&surrogate, &model, 1e-3, 40.0, 1.0).unwrap();
        let found = matching.search(2).unwrap();
        let predicted = matching.predict(&found.best);
        (found, predicted)
    }

    #[test]
    fn mean_and_spread_of_the_reference_are_found_with_intervals_that_hold_them() {
        let truth = [0.3, -0.4];
        let (found, predicted) = matched(&truth, 0.0);
        for j in 0..2 {
            let mut values: Vec<f64> = found.chain.iter().map(|x| x[j]).collect();
            values.sort_by(f64::total_cmp);
            let (low, high) = (values[values.len() / 50], values[values.len() * 49 / 50]);
            assert!(low < truth[j] && truth[j] < high && high - low < 0.6, "{j}: {low} {high}");
            assert!((found.best[j] - truth[j]).abs() < 0.25, "{:?}", found.best);
        }
        assert!(predicted.d2 < 1.0 && predicted.log_determinant_ratio.abs() < 1.5, "{predicted:?}");
        assert!(predicted.spread.iter().all(|(ratio, _)| (0.6..1.6).contains(ratio)));
    }

    #[test]
    fn a_feature_out_of_reach_is_seen_in_the_prediction() {
        let (_, predicted) = matched(&[0.0, 0.0], 5.0);
        assert!(
            predicted.offset[2] < -3.0 && predicted.contributions[2] > 10.0 && predicted.d2 > 10.0,
            "{predicted:?}"
        );
    }
}
