//! How likely a change is found, by its size, shape and place: shares in classes, and a logistic curve.

use nalgebra::{Matrix3, Vector2, Vector3};
use rockface_core::numerics::logistic::{self, Regression};
use rockface_core::numerics::{portable_math, quantile};

use super::profile_likelihood::Profile;

/// Determinant of the second derivatives of the likelihood below which there is no finite optimum.
pub(super) const LEAST_INFORMATION: f64 = 1e-12;
/// Growth of twice the log-likelihood from which on a ceiling is taken.
const CEILING_GAIN: f64 = 2.706;
/// Keeps the slope of a curve with a ceiling finite: half of it times the square of the slope is taken from the log-likelihood.
pub(super) const SLOPE_RIDGE: f64 = 1e-4;
/// Steps towards the likeliest curve at most, the gain below which there are no more, and the smallest part of a step that is tried.
const STEPS: usize = 200;
const SETTLED: f64 = 1e-10;
const LEAST_STEP: f64 = 1e-6;

/// A class of a property.
#[derive(Debug, Clone, PartialEq)]
pub struct Class {
    /// Its lower end; NaN for words.
    pub from: f64,
    /// Its upper end; NaN for words.
    pub to: f64,
    /// The rows in it.
    pub rows: Vec<usize>,
}

/// Puts numbers into `count` classes: of equal width in the logarithm where all are positive and spread over more than a factor
/// of ten, of equal width otherwise. Classes at the ends of the range may not be empty; between them they may.
pub fn classes(values: &[Option<f64>], count: usize) -> Vec<Class> {
    let known: Vec<f64> = values.iter().flatten().copied().filter(|x| x.is_finite()).collect();
    let fold = |pick: fn(f64, f64) -> f64| known.iter().copied().reduce(pick);
    let (Some(low), Some(high)) = (fold(f64::min), fold(f64::max)) else { return Vec::new() };
    let logarithmic = low > 0.0 && high > 10.0 * low;
    let scaled = |x: f64| if logarithmic { portable_math::log10(x) } else { x };
    let (first, last) = (scaled(low), scaled(high));
    let count = if last > first { count.max(1) } else { 1 };
    let width = (last - first) / count as f64;
    let end = |step: usize| match step {
        0 => low,
        step if step == count => high,
        step if logarithmic => portable_math::pow(10.0, first + width * step as f64),
        step => first + width * step as f64,
    };
    let mut classes: Vec<Class> =
        (0..count).map(|step| Class { from: end(step), to: end(step + 1), rows: Vec::new() }).collect();
    for (row, value) in values.iter().enumerate() {
        if let Some(value) = value.filter(|x| x.is_finite()) {
            let step = if width > 0.0 { ((scaled(value) - first) / width) as usize } else { 0 };
            classes[step.min(count - 1)].rows.push(row);
        }
    }
    classes
}

/// The probability that a change is found, by the decimal logarithm of a property: p = c / (1 + exp(-(a + b log10 x))).
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// b: how much the logarithm of the odds grows where the property is ten times as large.
    pub slope: f64,
    /// Standard error of b.
    pub slope_se: f64,
    /// c: what the probability tends to. 1 unless the changes say that some are missed whatever their size.
    pub ceiling: f64,
    /// Twice the logarithm of the likelihood, less that of a probability which does not depend on the property.
    pub gain: f64,
    /// The logarithm of the property in the middle of the changes.
    centre: f64,
    /// The logarithm of the odds there, less that of the ceiling.
    at_centre: f64,
    /// Logarithm of the largest likelihood with any ceiling.
    best: f64,
    /// As `at_centre` and `slope`: of the likeliest curve with a ceiling, also where it is not taken.
    with_ceiling: [f64; 2],
    /// Logarithms of the property, less `centre`, and whether each change was found.
    x: Vec<f64>,
    found: Vec<bool>,
}

impl Curve {
    /// Whether the property matters beyond chance, as a slope does that is two standard errors from 0.
    pub fn is_certain(&self) -> bool {
        self.gain > 4.0
    }

    /// Where a change is found with this probability; `None` where that is not reached at any size.
    pub fn at(&self, probability: f64) -> Option<f64> {
        Some(portable_math::pow(10.0, self.logarithm_at(probability)?))
    }

    /// The ends of the interval of 95 % of [`Curve::at`]: all sizes for which some curve with this probability there, whatever its
    /// slope and ceiling, has a likelihood that the largest one does not significantly exceed. `None` for an end that nothing bounds,
    /// as where no size at all might be found with this probability.
    pub fn interval(&self, probability: f64) -> [Option<f64>; 2] {
        let Some(at) = self.logarithm_at(probability) else { return [None; 2] };
        let profile =
            Profile { x: &self.x, found: &self.found, probability, best: self.best, with_ceiling: self.with_ceiling };
        let e = portable_math::log(probability / (self.ceiling - probability));
        let ends = profile.ends(at - self.centre, Vector2::new(self.slope, e));
        ends.map(|end| end.map(|end| portable_math::pow(10.0, self.centre + end)))
    }

    fn logarithm_at(&self, probability: f64) -> Option<f64> {
        let odds = probability / (self.ceiling - probability);
        let is_reached = odds.is_finite() && odds > 0.0;
        is_reached.then(|| self.centre + (portable_math::log(odds) - self.at_centre) / self.slope)
    }
}

/// Fits the curve by maximum likelihood; `None` where all or none are found, where the property separates both without error,
/// so that no finite curve is the likeliest, or where the property does not matter.
///
/// A ceiling below 1 is taken where twice the logarithm of the likelihood grows by more than 2.71 with it: the 95 % quantile of that
/// gain where there is none, as the ceiling is at the end of its range then (Self and Liang 1987).
pub fn curve(values: &[f64], found: &[bool]) -> Option<Curve> {
    let x: Vec<f64> = values.iter().map(|value| portable_math::log10(*value)).collect();
    let centre = quantile::quantile(&x, 0.5)?;
    let x: Vec<f64> = x.iter().map(|x| x - centre).collect();
    let design: Vec<Vec<f64>> = x.iter().map(|x| vec![1.0, *x]).collect();
    let importance = vec![1.0; x.len()];
    let regression = Regression { design: &design, happened: found, importance: &importance, ridge: 0.0, damping: 0.0 };
    let fit = logistic::fit(&regression);
    let information = &fit.information;
    let determinant = information[(0, 0)] * information[(1, 1)] - information[(0, 1)] * information[(0, 1)];
    let (a, b) = (fit.weights[0], fit.weights[1]);
    if !fit.settled || determinant.is_nan() || determinant < LEAST_INFORMATION || b.abs() <= 1e-9 {
        return None;
    }
    let share = found.iter().filter(|found| **found).count() as f64 / found.len() as f64;
    let flat = found.iter().map(|found| log_probability(share, *found)).sum::<f64>();
    let changes = Changes { x: &x, found };
    let with_ceiling = changes.with_ceiling(a, b);
    let plain = changes.log_likelihood(&Vector3::new(a, b, f64::INFINITY));
    let covariance = [[information[(1, 1)], -information[(0, 1)]], [-information[(0, 1)], information[(0, 0)]]];
    let covariance = Matrix3::from_fn(|i, j| if i < 2 && j < 2 { covariance[i][j] / determinant } else { 0.0 });
    let best = with_ceiling.as_ref().map_or(plain, |(_, likelihood, _)| likelihood.max(plain));
    let likeliest = with_ceiling.as_ref().map_or([a, b], |(theta, _, _)| [theta[0], theta[1]]);
    let (theta, ceiling, likelihood, covariance) = match with_ceiling {
        Some((theta, likelihood, covariance)) if 2.0 * (likelihood - plain) > CEILING_GAIN => {
            (theta, logistic::probability(theta[2]), likelihood, covariance)
        }
        _ => (Vector3::new(a, b, 0.0), 1.0, plain, covariance),
    };
    let slope_se = covariance[(1, 1)].sqrt();
    let gain = 2.0 * (likelihood - flat);
    let (slope, at_centre) = (theta[1], theta[0]);
    let found = found.to_vec();
    Some(Curve { slope, slope_se, ceiling, gain, centre, at_centre, best, with_ceiling: likeliest, x, found })
}

/// The logarithm of the probability of what was seen.
pub(super) fn log_probability(p: f64, found: bool) -> f64 {
    portable_math::log(if found { p } else { 1.0 - p }.max(f64::MIN_POSITIVE))
}

/// Logarithms of a property, less that in their middle, and whether each change was found.
#[derive(Clone, Copy)]
struct Changes<'a> {
    x: &'a [f64],
    found: &'a [bool],
}

impl Changes<'_> {
    /// Of `at_centre`, the slope and the logarithm of the odds of the ceiling.
    fn log_likelihood(&self, theta: &Vector3<f64>) -> f64 {
        let ceiling = if theta[2].is_finite() { logistic::probability(theta[2]) } else { 1.0 };
        let each = self.x.iter().zip(self.found);
        each.map(|(x, found)| log_probability(ceiling * logistic::probability(theta[0] + theta[1] * x), *found)).sum()
    }

    /// [`Changes::log_likelihood`], less what keeps a slope finite that has no likeliest value.
    fn objective(&self, theta: &Vector3<f64>) -> f64 {
        self.log_likelihood(theta) - 0.5 * SLOPE_RIDGE * theta[1] * theta[1]
    }

    /// The likeliest curve with a ceiling, its log-likelihood and covariance, by Fisher's scoring with halved steps from some ceilings
    /// and slopes; `a` and `b` are those of the curve without one.
    fn with_ceiling(&self, a: f64, b: f64) -> Option<(Vector3<f64>, f64, Matrix3<f64>)> {
        let starts = [(0.95, 1.0), (0.85, 2.0), (0.7, 3.0)];
        let starts = starts.map(|(c, steeper)| Vector3::new(a, steeper * b, portable_math::log(c / (1.0 - c))));
        let ends = starts.into_iter().filter_map(|start| self.climb(start));
        let (theta, information) =
            ends.max_by(|(one, _), (other, _)| self.objective(one).total_cmp(&self.objective(other)))?;
        Some((theta, self.log_likelihood(&theta), information.try_inverse()?))
    }

    /// Climbs to the likeliest curve near a start; with the information there.
    fn climb(&self, mut theta: Vector3<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let mut height = self.objective(&theta);
        for _ in 0..STEPS {
            let (score, information) = self.derivatives(&theta);
            let step = information.cholesky()?.solve(&score);
            let mut share = 1.0;
            let next = loop {
                let next = theta + step * share;
                let higher = self.objective(&next);
                if higher >= height {
                    break Some((next, higher));
                }
                share *= 0.5;
                if share < LEAST_STEP {
                    break None;
                }
            };
            let Some((next, higher)) = next else { return Some((theta, information)) };
            let gain = higher - height;
            (theta, height) = (next, higher);
            if gain < SETTLED {
                return Some((theta, self.derivatives(&theta).1));
            }
        }
        None
    }

    /// The slopes of the objective, and the information.
    fn derivatives(&self, theta: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let c = logistic::probability(theta[2]);
        let mut score = Vector3::new(0.0, -SLOPE_RIDGE * theta[1], 0.0);
        let mut information = Matrix3::from_diagonal(&Vector3::new(LEAST_INFORMATION, SLOPE_RIDGE, LEAST_INFORMATION));
        for (x, found) in self.x.iter().zip(self.found) {
            let s = logistic::probability(theta[0] + theta[1] * x);
            let p = c * s;
            let by = Vector3::new(p * (1.0 - s), p * (1.0 - s) * x, p * (1.0 - c));
            let variance = (p * (1.0 - p)).max(LEAST_INFORMATION);
            score += by * ((f64::from(u8::from(*found)) - p) / variance);
            information += by * by.transpose() / variance;
        }
        (score, information)
    }
}

#[cfg(test)]
mod tests {
    use rand::Rng;

    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn classes_are_logarithmic_where_the_range_is_wide() {
        let found = classes(&[Some(0.001), Some(0.02), Some(1.0), None], 3);
        assert_eq!(found.iter().map(|class| class.rows.clone()).collect::<Vec<_>>(), [vec![0], vec![1], vec![2]]);
        assert!((found[0].to - 0.01).abs() < 1e-12 && (found[2].to - 1.0).abs() < 1e-15);
        let linear = classes(&[Some(-1.0), Some(0.4), Some(1.0)], 2);
        assert_eq!((linear[0].to, linear[1].rows.len()), (0.0, 2));
        assert_eq!(classes(&[Some(2.0), Some(2.0)], 5).len(), 1);
        assert!(classes(&[None], 5).is_empty());
    }

    /// A hundred changes of each of 21 volumes, found in the share c / (1 + exp(-(8 + 4 log10 v))).
    fn changes(c: f64) -> (Vec<f64>, Vec<bool>) {
        let volumes: Vec<f64> = (0..2100).map(|i| portable_math::pow(10.0, -4.0 + f64::from(i / 100) * 0.2)).collect();
        let share = |v: f64| c / (1.0 + portable_math::exp(-(8.0 + 4.0 * portable_math::log10(v))));
        let found = volumes.iter().enumerate().map(|(i, v)| ((i % 100) as f64) < (100.0 * share(*v)).round()).collect();
        (volumes, found)
    }

    #[test]
    fn a_logistic_curve_comes_back() {
        let (volumes, found) = changes(1.0);
        let fit = curve(&volumes, &found).unwrap();
        let [half, most] = [0.5, 0.9].map(|p| fit.at(p).unwrap());
        assert!(
            fit.ceiling > 0.999_999 && (fit.slope - 4.0).abs() < 0.1 && (half / 0.01 - 1.0).abs() < 0.02,
            "{fit:?}"
        );
        assert!(most > half && fit.slope_se < 0.3 && fit.is_certain());
        let [low, high] = fit.interval(0.9).map(Option::unwrap);
        assert!(low < most && most < high && high < 1.2 * most, "{low} {most} {high}");
    }

    #[test]
    fn some_are_missed_whatever_their_size() {
        let (volumes, found) = changes(0.85);
        let fit = curve(&volumes, &found).unwrap();
        assert!((fit.ceiling - 0.85).abs() < 0.02 && (fit.slope - 4.0).abs() < 0.4, "{fit:?}");
        // 0.5 = 0.85 / (1 + exp(-(8 + 4 log10 v)))
        let half = portable_math::pow(10.0, (portable_math::log(0.5 / 0.35) - 8.0) / 4.0);
        let [low, high] = fit.interval(0.5).map(Option::unwrap);
        assert!(low < half && half < high && high < 1.4 * low, "{low} {half} {high}");
        assert_eq!((fit.at(0.9), fit.interval(0.9)), (None, [None; 2]));
    }

    /// Shares of samples of so many changes whose intervals hold the size found with a probability; those without a limit do not count.
    fn coverage(ceiling: f64, count: usize, probability: f64, samples: u8) -> f64 {
        let truth = portable_math::log(probability / (ceiling - probability)) / 3.0 - 1.5;
        let (mut given, mut held) = (0.0, 0.0);
        for sample in 0..samples {
            let mut generator = Key([sample; 32]).generator();
            let mut uniform = || f64::from(generator.next_u32()) / 4_294_967_296.0;
            let drawn: Vec<(f64, bool)> = (0..count)
                .map(|_| {
                    let x = 4.0 * uniform() - 3.5;
                    (portable_math::pow(10.0, x), uniform() < ceiling * logistic::probability(3.0 * (x + 1.5)))
                })
                .collect();
            let (sizes, found): (Vec<f64>, Vec<bool>) = drawn.into_iter().unzip();
            let Some(fit) = curve(&sizes, &found).filter(|fit| fit.at(probability).is_some()) else { continue };
            let [low, high] = fit.interval(probability).map(|end| end.map(portable_math::log10));
            given += 1.0;
            held += f64::from(u8::from(low.is_none_or(|low| low <= truth) && high.is_none_or(|high| truth <= high)));
        }
        held / given
    }

    #[test]
    fn intervals_hold_the_truth_where_some_are_missed_whatever_their_size() {
        // 91 and 97 %; by the covariance of a curve whose ceiling is known it was 80 to 89 %.
        let shares = [0.5, 0.75].map(|probability| coverage(0.8, 100, probability, 250));
        assert!(shares.iter().all(|share| *share >= 0.9), "{shares:?}");
        // A ceiling of 75 % is likely here, and with that no size is found with this probability.
        let (volumes, found) = changes(0.8);
        let few = |values: &[f64]| values.iter().step_by(42).copied().collect::<Vec<f64>>();
        let found: Vec<bool> = found.iter().step_by(42).copied().collect();
        let fit = curve(&few(&volumes), &found).unwrap();
        assert!(fit.at(0.75).is_some());
        let [low, high] = fit.interval(0.75);
        assert!(low.is_some() && high.is_none(), "{low:?} {high:?}");
    }

    #[test]
    fn a_sharp_rise_below_a_ceiling_has_a_place() {
        let volumes: Vec<f64> = (0..200).map(|i| portable_math::pow(10.0, f64::from(i) * 0.01)).collect();
        let found: Vec<bool> = (0..200).map(|i| i >= 100 && i % 7 != 3).collect();
        let fit = curve(&volumes, &found).unwrap();
        assert!((fit.ceiling - 6.0 / 7.0).abs() < 0.02 && fit.is_certain(), "{fit:?}");
        let half = fit.at(0.5).unwrap();
        assert!((half / 10.0 - 1.0).abs() < 0.1 && fit.at(0.9).is_none(), "{half}");
    }

    #[test]
    fn no_curve_where_all_or_none_are_found_or_all_is_clear() {
        let volumes = [0.1, 0.2, 0.3, 0.4];
        assert_eq!(curve(&volumes, &[true; 4]), None);
        assert_eq!(curve(&volumes, &[false; 4]), None);
        assert_eq!(curve(&volumes, &[false, false, true, true]), None);
        assert_eq!(curve(&[], &[]), None);
    }
}
