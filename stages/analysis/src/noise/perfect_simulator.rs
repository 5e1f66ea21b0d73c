//! How many rasters of a perfect simulator pass the acceptance test, by direct simulation of references and trials.
//!
//! The share that passes is not known: threshold, mean and covariance come from few references, and all trials share them. So the
//! count is wider than binomial: at 39 references, 10 features and 39 trials its standard deviation is 4.6, not 2.9. Here whole
//! tests are drawn: references and trials from one distribution, the model fitted to the references, the trials counted. The
//! distributions are elliptical with the eigenvalues of the references: lighter than normal (Pearson type II), normal, Student t of 6
//! and of 3 degrees of freedom, and normal with 8 % of rasters three times as far. Which of them the references come from is
//! read off two figures of theirs: their leave-one-out share and their kurtosis (mean squared D2, Mardia 1970). The tests drawn whose
//! references have nearly the same two figures are the predictive distribution (approximate Bayesian computation: Beaumont,
//! Zhang and Balding 2002, Genetics 162). References that share epochs are drawn as a chain, moving averages of two epochs, and the
//! rasters tested as averages of two epochs of their own.
//!
//! The draws have a fixed key: they are a way to integrate, and the same test gives the same band.

use rayon::prelude::*;
use rockface_core::artefact::GroupModel;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::quantile::{of_sorted, quantile};
use rockface_core::numerics::random::{Field, Key};

use super::acceptance_rate::share_below;

/// What decides how many rasters of a perfect simulator pass.
#[derive(Debug, Clone)]
pub struct Setting {
    /// Number of reference rasters.
    pub references: usize,
    /// Number of rasters tested.
    pub trials: usize,
    /// Eigenvalues of the covariance of the standardised features.
    pub eigenvalues: Vec<f64>,
    /// Ridge of the test.
    pub ridge: f64,
    /// Size of the correlation of features of references that follow each other in a chain; 0 without one.
    pub chain_correlation: f64,
    /// Number of features whose correlation is negative, as that of an offset is.
    pub opposed: usize,
}

/// How many rasters of a perfect simulator are to be expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expectation {
    /// Expected share of rasters that pass.
    pub share: f64,
    /// Smallest count of the 95 % band.
    pub low: usize,
    /// Largest count of the band.
    pub high: usize,
    /// Ends of the 95 % band of the median D2; `None` where nothing is known of it.
    pub median_d2: Option<[f64; 2]>,
}

impl Expectation {
    /// Whether a count lies in the band.
    pub fn holds(&self, accepted: usize) -> bool {
        (self.low..=self.high).contains(&accepted)
    }
}

/// Coverage wanted of a band.
const COVERAGE: f64 = 0.95;
/// Share of the tests drawn that count, the nearest ones.
const NEAREST: f64 = 0.15;
/// Tests drawn at most, and at least where there are many rasters.
const TESTS: (usize, usize) = (5000, 1000);
/// Multiplications spent on all of them, about.
const WORK: usize = 100_000_000;
const KEY: Key = Key(*b"rasters of a perfect simulator 1");

/// The distributions that features may have.
#[derive(Debug, Clone, Copy)]
enum Family {
    Light,
    Normal,
    Student(u8),
    Contaminated,
}

const FAMILIES: [Family; 5] =
    [Family::Light, Family::Normal, Family::Student(6), Family::Student(3), Family::Contaminated];
/// Share of far rasters, as the normal quantile below which a draw makes one: 8 %.
const FAR_BELOW: f64 = -1.405_071_560_309_632_7;
const FAR: f64 = 3.0;

/// One test drawn: what its references look like, and by quantile what they say and how many trials pass.
#[derive(Debug, Clone)]
struct Drawn {
    log_kurtosis: f64,
    levels: Vec<(f64, usize)>,
    /// Median D2 of the trials.
    median_d2: f64,
}

/// Tests of a perfect simulator at some quantiles.
#[derive(Debug, Clone)]
pub struct Simulated {
    trials: usize,
    /// Whether the kurtosis of the references says anything. Of three, and of no more than one for each feature and one, it is the same
    /// whatever they are but for the ridge.
    has_kurtosis: bool,
    drawn: Vec<Drawn>,
}

impl Setting {
    /// The setting of a group of features. `chained` is the model that the correlation along a chain is taken from, that of all
    /// features: few features say little.
    pub fn of(model: &GroupModel, chained: &GroupModel, ridge: f64, trials: usize) -> Self {
        let n = model.reference_d2.len();
        let chain_correlation = pooled_correlation(&chained.chain_correlation, n);
        let opposed =
            if chain_correlation > 0.0 { model.chain_correlation.iter().filter(|r| **r < 0.0).count() } else { 0 };
        Self { references: n, trials, eigenvalues: model.eigenvalues.clone(), ridge, chain_correlation, opposed }
    }

    /// Draws tests and counts what passes at each quantile.
    pub fn simulate(&self, quantiles: &[f64]) -> Simulated {
        let p = self.eigenvalues.len();
        let each = (self.references + self.trials + 1) * (p * p + 20 * p);
        let tests = (WORK / each.max(1)).clamp(TESTS.1, TESTS.0);
        let drawn = (0..tests).into_par_iter().filter_map(|test| self.draw(test, quantiles)).collect();
        Simulated { trials: self.trials, has_kurtosis: self.references > 3.max(p + 1), drawn }
    }

    fn draw(&self, test: usize, quantiles: &[f64]) -> Option<Drawn> {
        let p = self.eigenvalues.len();
        let mut draws = Draws { field: KEY.field(), test: test as i32, next: 0, spare: None };
        let family = FAMILIES[test % FAMILIES.len()];
        let mut references = self.references(family, &mut draws);
        let mut trials: Vec<Vec<f64>> = (0..self.trials).map(|_| self.trial(family, &mut draws)).collect();
        let n = references.len() as f64;
        let mean: Vec<f64> = (0..p).map(|j| references.iter().map(|row| row[j]).sum::<f64>() / n).collect();
        for row in references.iter_mut().chain(&mut trials) {
            row.iter_mut().zip(&mean).for_each(|(x, m)| *x -= m);
        }
        let factor = cholesky(&references, p, self.ridge)?;
        let d2 = |rows: &[Vec<f64>]| rows.iter().map(|row| length2(&factor, row)).collect::<Vec<f64>>();
        let (reference_d2, trial_d2) = (d2(&references), d2(&trials));
        let mut sorted = reference_d2.clone();
        sorted.sort_by(f64::total_cmp);
        let loo: Vec<f64> = reference_d2.iter().map(|d2| leave_one_out(*d2, n)).collect();
        let level = |quantile: &f64| {
            let threshold = of_sorted(&sorted, *quantile).unwrap_or(f64::NAN);
            (share_below(&loo, threshold), trial_d2.iter().filter(|d2| **d2 <= threshold).count())
        };
        Some(Drawn {
            log_kurtosis: log_kurtosis(&reference_d2),
            levels: quantiles.iter().map(level).collect(),
            median_d2: quantile(&trial_d2, 0.5).unwrap_or(f64::NAN),
        })
    }

    /// References; those of a chain share their epochs with their neighbours.
    fn references(&self, family: Family, draws: &mut Draws) -> Vec<Vec<f64>> {
        if self.chain_correlation <= 0.0 {
            return (0..self.references).map(|_| self.raster(family, draws)).collect();
        }
        let epochs: Vec<Vec<f64>> = (0..=self.references).map(|_| self.raster(family, draws)).collect();
        epochs.windows(2).map(|pair| self.comparison(&pair[0], &pair[1])).collect()
    }

    /// A raster like the references, and with nothing that they have.
    fn trial(&self, family: Family, draws: &mut Draws) -> Vec<f64> {
        if self.chain_correlation <= 0.0 {
            return self.raster(family, draws);
        }
        let (first, second) = (self.raster(family, draws), self.raster(family, draws));
        self.comparison(&first, &second)
    }

    /// The comparison of two epochs of a chain: their weighted sum, so that neighbours have the correlation of the chain.
    fn comparison(&self, first: &[f64], second: &[f64]) -> Vec<f64> {
        let r = self.chain_correlation;
        let weight = (0.5 * (1.0 + (1.0 - 4.0 * r * r).max(0.0).sqrt())).sqrt();
        let other = (1.0 - weight * weight).sqrt();
        let sign = |j: usize| if j < self.opposed { -1.0 } else { 1.0 };
        first.iter().zip(second).enumerate().map(|(j, (a, b))| weight * a + sign(j) * other * b).collect()
    }

    /// Features of one raster, or of one epoch of a chain, along the principal axes of the references.
    fn raster(&self, family: Family, draws: &mut Draws) -> Vec<f64> {
        let mut z: Vec<f64> = self.eigenvalues.iter().map(|_| draws.normal()).collect();
        let factor = match family {
            Family::Light => {
                let square: f64 = z.iter().map(|x| x * x).sum();
                ((z.len() + 4) as f64 / (square + draws.chi_square(4))).sqrt()
            }
            Family::Normal => 1.0,
            Family::Student(nu) => (f64::from(nu - 2) / draws.chi_square(nu)).sqrt(),
            Family::Contaminated => {
                let distance = if draws.normal() < FAR_BELOW { FAR } else { 1.0 };
                distance / (0.92 + 0.08 * FAR * FAR).sqrt()
            }
        };
        z.iter_mut().zip(&self.eigenvalues).for_each(|(x, e)| *x *= factor * e.max(0.0).sqrt());
        z
    }
}

impl Simulated {
    /// What a perfect simulator would have at quantile number `level`, given the distances of the real references.
    pub fn expectation(&self, level: usize, leave_one_out_share: f64, reference_d2: &[f64]) -> Expectation {
        if self.drawn.is_empty() {
            // No covariance had an inverse: every count is possible.
            return Expectation { share: f64::NAN, low: 0, high: self.trials, median_d2: None };
        }
        let weights = self.weights(level, leave_one_out_share, log_kurtosis(reference_d2));
        let mut mass = vec![0.0; self.trials + 1];
        for (drawn, weight) in self.drawn.iter().zip(&weights) {
            mass[drawn.levels[level].1] += weight;
        }
        let total: f64 = mass.iter().sum();
        mass.iter_mut().for_each(|m| *m /= total);
        let mean: f64 = mass.iter().enumerate().map(|(k, m)| k as f64 * m).sum();
        let (low, high) = band(&mass);
        let medians = self.drawn.iter().zip(&weights).map(|(drawn, weight)| (drawn.median_d2, *weight));
        Expectation { share: mean / self.trials.max(1) as f64, low, high, median_d2: middle(medians.collect()) }
    }

    /// 1 for a test whose references look like the real ones, falling to 0 at the farthest of the nearest share.
    fn weights(&self, level: usize, share: f64, log_kurtosis: f64) -> Vec<f64> {
        let shares: Vec<f64> = self.drawn.iter().map(|drawn| drawn.levels[level].0).collect();
        let kurtoses: Vec<f64> = self.drawn.iter().map(|drawn| drawn.log_kurtosis).collect();
        let off = |values: &[f64], at: f64| {
            let spread = deviation(values);
            let off = move |x: &f64| if spread > 0.0 { ((x - at) / spread) * ((x - at) / spread) } else { 0.0 };
            values.iter().map(off).collect::<Vec<f64>>()
        };
        let mut distance = off(&shares, share);
        if self.has_kurtosis {
            distance.iter_mut().zip(off(&kurtoses, log_kurtosis)).for_each(|(sum, off)| *sum += off);
        }
        let mut sorted = distance.clone();
        sorted.sort_by(f64::total_cmp);
        let reach = of_sorted(&sorted, NEAREST).unwrap_or(0.0);
        let weight = |d: &f64| if reach > 0.0 { (1.0 - d / reach).max(0.0) } else { f64::from(u8::from(*d <= reach)) };
        let weights: Vec<f64> = distance.iter().map(weight).collect();
        if weights.iter().sum::<f64>() > 0.0 {
            return weights;
        }
        distance.iter().map(|d| f64::from(u8::from(*d <= reach))).collect()
    }
}

/// The number of independent references that say as much about mean and spread: fewer than there are where they share epochs, n / (1 +
/// 2 r^2) with the correlation r of neighbours (Bartlett 1946).
pub fn effective_references(model: &GroupModel) -> f64 {
    let n = model.reference_d2.len();
    let r = pooled_correlation(&model.chain_correlation, n);
    n as f64 / (1.0 + 2.0 * r * r)
}

/// The size of the correlation along a chain, from those of all features: their mean square, less what chance adds.
fn pooled_correlation(correlations: &[f64], n: usize) -> f64 {
    if correlations.is_empty() {
        return 0.0;
    }
    let square = correlations.iter().map(|r| r * r).sum::<f64>() / correlations.len() as f64;
    (square - 1.0 / n as f64).max(0.0).sqrt().min(0.5)
}

/// The logarithm of the mean squared D2.
fn log_kurtosis(d2: &[f64]) -> f64 {
    portable_math::log((d2.iter().map(|d| d * d).sum::<f64>() / d2.len() as f64).max(f64::MIN_POSITIVE))
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n).sqrt()
}

/// The run of the likeliest counts whose probability is nearest to the coverage wanted.
fn band(mass: &[f64]) -> (usize, usize) {
    let (mut low, mut covered) = (0, mass[0]);
    for (k, m) in mass.iter().enumerate() {
        if *m > covered {
            (low, covered) = (k, *m);
        }
    }
    let mut high = low;
    while covered < COVERAGE {
        let below = low.checked_sub(1).map(|k| mass[k]);
        let above = mass.get(high + 1).copied();
        let next = below.unwrap_or(-1.0).max(above.unwrap_or(-1.0));
        if next < 0.0 || covered + next - COVERAGE > COVERAGE - covered {
            break;
        }
        covered += next;
        if below.is_some_and(|m| m >= next) { low -= 1 } else { high += 1 }
    }
    (low, high)
}

/// The middle 95 % of values with weights.
fn middle(mut weighted: Vec<(f64, f64)>) -> Option<[f64; 2]> {
    weighted.retain(|(value, weight)| value.is_finite() && *weight > 0.0);
    weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = weighted.iter().map(|(_, weight)| weight).sum();
    let at = |share: f64| {
        let mut below = 0.0;
        let reached = weighted.iter().find(|(_, weight)| {
            below += weight;
            below >= share * total
        });
        reached.or(weighted.last()).map(|(value, _)| *value)
    };
    Some([at(0.5 * (1.0 - COVERAGE))?, at(0.5 * (1.0 + COVERAGE))?])
}

/// D2 of a reference to the model of all others, from its D2 to the model of all (exact but for a ridge, of which it is within a
/// share of 1 / n).
fn leave_one_out(d2: f64, n: f64) -> f64 {
    let rest = (n - 1.0) * (n - 1.0) - n * d2;
    if rest > 0.0 { n * n * (n - 2.0) * d2 / ((n - 1.0) * rest) } else { f64::INFINITY }
}

/// The lower triangle L of the covariance plus ridge, L L' = S + lambda I, by rows.
fn cholesky(centred: &[Vec<f64>], p: usize, ridge: f64) -> Option<Vec<f64>> {
    let n = centred.len() as f64;
    let mut factor = vec![0.0; p * p];
    for i in 0..p {
        for j in 0..=i {
            let covariance = centred.iter().map(|row| row[i] * row[j]).sum::<f64>() / (n - 1.0);
            let known: f64 = (0..j).map(|k| factor[i * p + k] * factor[j * p + k]).sum();
            let rest = covariance - known;
            factor[i * p + j] = if i == j { (rest + ridge).sqrt() } else { rest / factor[j * p + j] };
        }
        if factor[i * p + i].is_nan() || factor[i * p + i] <= 0.0 {
            return None;
        }
    }
    Some(factor)
}

/// x' (L L')^-1 x.
fn length2(factor: &[f64], x: &[f64]) -> f64 {
    let p = x.len();
    let mut y = vec![0.0; p];
    for i in 0..p {
        let known: f64 = (0..i).map(|k| factor[i * p + k] * y[k]).sum();
        y[i] = (x[i] - known) / factor[i * p + i];
    }
    y.iter().map(|y| y * y).sum()
}

/// Normal draws of one test, in order.
struct Draws {
    field: Field,
    test: i32,
    next: i32,
    spare: Option<f64>,
}

impl Draws {
    fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let [first, second] = self.field.normals(self.next, self.test);
        self.next += 1;
        self.spare = Some(second);
        first
    }

    fn chi_square(&mut self, degrees: u8) -> f64 {
        (0..degrees).map(|_| self.normal()).map(|x| x * x).sum()
    }
}

#[cfg(test)]
mod tests;
