//! Intervals of the size that is found with a probability, by the likelihood of all curves that have this probability there.

use nalgebra::{Matrix2, Vector2};
use rockface_core::numerics::{logistic, portable_math};

use super::detectability::{LEAST_INFORMATION, SLOPE_RIDGE, log_probability};

/// Half the 95 % quantile of chi squared of one degree of freedom.
const SIGNIFICANT: f64 = 1.920_729;
/// First step outwards, decades of the size; the step from which on nothing bounds an interval; halvings of the last one.
const FIRST_STEP: f64 = 0.05;
const UNBOUNDED: f64 = 20.0;
const HALVINGS: usize = 14;
/// Steps towards the likeliest curve at most, the gain below which there are no more, and the smallest part of a step that is tried.
const STEPS: usize = 60;
const SETTLED: f64 = 1e-6;
const LEAST_STEP: f64 = 1e-4;

/// The likelihood of the size t that is found with a probability p, on curves `c / (1 + exp(-(a + b x)))` with any b and c, c <= 1.
///
/// With `e = a + b t`, a curve that has p at t has `c = p (1 + exp(-e))`: slope b and e are free, but for `e >= ln(p / (1 - p))`.
#[derive(Clone, Copy)]
pub struct Profile<'a> {
    /// Logarithms of the sizes of the changes.
    pub x: &'a [f64],
    /// Whether each was found.
    pub found: &'a [bool],
    /// The probability.
    pub probability: f64,
    /// Logarithm of the largest likelihood of any curve.
    pub best: f64,
    /// Of the likeliest curve whose ceiling is below 1, however little it gains: a + b x, as a and b.
    pub with_ceiling: [f64; 2],
}

impl Profile<'_> {
    /// The ends of the interval of 95 % about the size at the likeliest curve, of which slope and e are given, as logarithms; `None`
    /// where there is no end.
    pub fn ends(&self, at: f64, curve: Vector2<f64>) -> [Option<f64>; 2] {
        [-1.0, 1.0].map(|side| self.end(at, curve, side))
    }

    fn end(&self, at: f64, curve: Vector2<f64>, side: f64) -> Option<f64> {
        let mut inside = (at, curve);
        let mut step = FIRST_STEP;
        while let Some(curve) = self.reaches(at + side * step, &inside) {
            inside = (at + side * step, curve);
            step *= 2.0;
            if step > UNBOUNDED {
                return None;
            }
        }
        let mut outside = at + side * step;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside.0 + outside);
            match self.reaches(middle, &inside) {
                Some(curve) => inside = (middle, curve),
                None => outside = middle,
            }
        }
        Some(inside.0)
    }

    /// The likeliest curve with the probability at t, where it is not significantly less likely than the likeliest of all; looked
    /// for from the curve of another t.
    fn reaches(&self, t: f64, (near_t, near): &(f64, Vector2<f64>)) -> Option<Vector2<f64>> {
        let is_likely = |curve: &Vector2<f64>| self.log_likelihood(t, curve) >= self.best - SIGNIFICANT;
        let least_e = self.least_e();
        // The rise stays where it is, the odds at t do, or the ceiling is 1; or the rise is that of the likeliest curve with a ceiling,
        // which another climb need not find.
        let rise = near[1] + near[0] * (t - near_t);
        let [a, b] = self.with_ceiling;
        let starts = [(near[0], rise), (near[0], near[1]), (near[0], least_e), (b, a + b * t)];
        starts.iter().map(|(slope, e)| self.climb(t, Vector2::new(*slope, e.max(least_e)))).find(is_likely)
    }

    /// The logarithm of the odds of the probability, with which the ceiling is 1.
    fn least_e(&self) -> f64 {
        portable_math::log(self.probability / (1.0 - self.probability))
    }

    fn ceiling(&self, e: f64) -> f64 {
        (self.probability * (1.0 + portable_math::exp(-e))).min(1.0)
    }

    fn log_likelihood(&self, t: f64, curve: &Vector2<f64>) -> f64 {
        let ceiling = self.ceiling(curve[1]);
        let p = |x: f64| ceiling * logistic::probability(curve[1] + curve[0] * (x - t));
        self.x.iter().zip(self.found).map(|(x, found)| log_probability(p(*x), *found)).sum()
    }

    /// The log-likelihood, less what keeps a slope finite that has no likeliest value.
    fn objective(&self, t: f64, curve: &Vector2<f64>) -> f64 {
        self.log_likelihood(t, curve) - 0.5 * SLOPE_RIDGE * curve[0] * curve[0]
    }

    /// The likeliest curve near a start, by Fisher's scoring with halved steps; e stays at its end where it would pass it.
    fn climb(&self, t: f64, mut curve: Vector2<f64>) -> Vector2<f64> {
        let least_e = self.least_e();
        let mut height = self.objective(t, &curve);
        for _ in 0..STEPS {
            let (score, information) = self.derivatives(t, &curve);
            let is_held = curve[1] <= least_e && score[1] <= 0.0;
            let whole = if is_held { None } else { information.cholesky().map(|root| root.solve(&score)) };
            let step = whole.unwrap_or_else(|| Vector2::new(score[0] / information[(0, 0)], 0.0));
            let part = |share: f64| {
                let next = curve + step * share;
                Vector2::new(next[0], next[1].max(least_e))
            };
            let shares = std::iter::successors(Some(1.0), |share| Some(0.5 * share)).take_while(|s| *s > LEAST_STEP);
            let higher = shares.map(part).map(|next| (next, self.objective(t, &next))).find(|(_, next)| *next > height);
            let Some((next, reached)) = higher else { break };
            let gain = reached - height;
            (curve, height) = (next, reached);
            if gain < SETTLED {
                break;
            }
        }
        curve
    }

    /// The slopes of the objective, and the information.
    fn derivatives(&self, t: f64, curve: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let ceiling = self.ceiling(curve[1]);
        let mut score = Vector2::new(-SLOPE_RIDGE * curve[0], 0.0);
        let mut information = Matrix2::from_diagonal(&Vector2::new(SLOPE_RIDGE, LEAST_INFORMATION));
        for (x, found) in self.x.iter().zip(self.found) {
            let s = logistic::probability(curve[1] + curve[0] * (x - t));
            let p = ceiling * s;
            let by = Vector2::new(p * (1.0 - s) * (x - t), s * (self.probability - p));
            let variance = (p * (1.0 - p)).max(LEAST_INFORMATION);
            score += by * ((f64::from(u8::from(*found)) - p) / variance);
            information += by * by.transpose() / variance;
        }
        (score, information)
    }
}

#[cfg(test)]
mod tests;
