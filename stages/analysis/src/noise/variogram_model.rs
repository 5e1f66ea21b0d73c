//! Fits nugget, sill and range to an empirical variogram (paper 2.2.2).
//!
//! The model is `gamma(h) = c0 + c f(h / a)`. For a given a it is linear in c0 and c, so these follow from a small
//! least-squares problem with both kept at or above zero, and only a is searched (variable projection, Golub and
//! Pereyra 1973): first on a fine logarithmic grid over all lengths that make sense, then by golden section. There is
//! no starting value that could be wrong.

use super::variogram::Variogram;
use crate::noise::nested_variogram;
use rockface_core::choice;
use rockface_core::numerics::golden_section::{Inner, golden_section};
use rockface_core::numerics::portable_math;

choice! {
    /// The shape f of a variogram model.
    pub enum Shape {
        /// f(x) = 1 - exp(-x).
        Exponential = "exponential",
        /// f(x) = 1.5 x - 0.5 x^3 up to 1.
        Spherical = "spherical",
        /// f(x) = 1 - exp(-x^2).
        Gaussian = "gaussian",
        /// f(x) = 1 - exp(-x^alpha), alpha fitted between 0.5 and 2.
        Stable = "stable",
        /// Two exponential structures, one within the other.
        Nested = "nested",
    }
}

impl Shape {
    fn value(self, x: f64, exponent: f64) -> f64 {
        match self {
            Self::Stable => 1.0 - portable_math::exp(-portable_math::pow(x, exponent)),
            Self::Exponential | Self::Nested => 1.0 - portable_math::exp(-x),
            Self::Gaussian => 1.0 - portable_math::exp(-x * x),
            Self::Spherical if x >= 1.0 => 1.0,
            Self::Spherical => 1.5 * x - 0.5 * x * x * x,
        }
    }

    /// The x where f reaches `level`, 0 <= level < 1.
    fn inverse(self, level: f64, exponent: f64) -> f64 {
        match self {
            Self::Stable => portable_math::pow(-portable_math::log(1.0 - level), 1.0 / exponent),
            Self::Exponential | Self::Nested => -portable_math::log(1.0 - level),
            Self::Gaussian => (-portable_math::log(1.0 - level)).sqrt(),
            // With x = 2 sin t, 1.5 x - 0.5 x^3 = sin 3t.
            Self::Spherical => 2.0 * portable_math::sin(portable_math::asin(level) / 3.0),
        }
    }
}

/// A fitted variogram model; lengths in the unit of the lags, variances in that of gamma.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Model {
    /// The function f that the correlated part follows.
    pub shape: Shape,
    /// c0: variance at vanishing distance, exactly 0 at its bound.
    pub nugget: f64,
    /// c: variance of the correlated part.
    pub partial_sill: f64,
    /// a: length parameter.
    pub length: f64,
    /// alpha of the stable shape; 1 for the others.
    pub exponent: f64,
    /// Variance and length of the second, longer structure of the nested shape; 0 for the others.
    pub second: [f64; 2],
}

/// Share of the sill at which the range is taken (paper 2.2.2).
const RANGE_LEVEL: f64 = 0.95;

impl Model {
    /// A model of one structure.
    pub fn new(shape: Shape, nugget: f64, partial_sill: f64, length: f64) -> Self {
        Self { shape, nugget, partial_sill, length, exponent: 1.0, second: [0.0; 2] }
    }

    /// gamma at a distance.
    pub fn gamma(&self, h: f64) -> f64 {
        let [sill, length] = self.second;
        let second = if sill > 0.0 { sill * self.shape.value(h / length, 1.0) } else { 0.0 };
        self.nugget + self.partial_sill * self.shape.value(h / self.length, self.exponent) + second
    }

    /// The whole sill: c0 + c, and the variance of the second structure.
    pub fn sill(&self) -> f64 {
        self.nugget + self.partial_sill + self.second[0]
    }

    /// Distance where gamma reaches 95 % of the whole sill; 0 where the nugget alone does.
    pub fn range95(&self) -> f64 {
        let level = RANGE_LEVEL * self.sill() - self.nugget;
        if level <= 0.0 { 0.0 } else { self.reach(level) }
    }

    /// Distance where the correlated part alone reaches 95 % of its own sill.
    pub fn range_structural(&self) -> f64 {
        if self.second[0] > 0.0 {
            self.reach(RANGE_LEVEL * (self.sill() - self.nugget))
        } else {
            self.length * self.shape.inverse(RANGE_LEVEL, self.exponent)
        }
    }

    /// Distance where the correlated part has this variance.
    fn reach(&self, variance: f64) -> f64 {
        if self.second[0] <= 0.0 {
            return self.length * self.shape.inverse(variance / self.partial_sill, self.exponent);
        }
        let (mut low, mut high) = (0.0, 40.0 * self.length.max(self.second[1]));
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if self.gamma(middle) - self.nugget < variance { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

/// Steps of the logarithmic grid over a.
const GRID: usize = 160;
/// Golden sections of a bracket: 60 leave less of it than the square root of the rounding error.
pub(super) const SECTIONS: usize = 60;

/// Fits a model by weighted least squares with weights pairs / h^2; `None` for fewer than three bins.
///
/// a is searched from a twentieth of the shortest to ten times the longest lag; alpha of the stable shape by golden section, and
/// the nested shape by `noise::nested_variogram`.
pub fn fit(lags: &[f64], empirical: &Variogram, shape: Shape) -> Option<Model> {
    if lags.len() < 3 {
        return None;
    }
    let weights: Vec<f64> = empirical.pairs.iter().zip(lags).map(|(n, h)| n / (h * h)).collect();
    if shape == Shape::Nested {
        return nested_variogram::fit(lags, &empirical.gamma, &weights);
    }
    let problem = |exponent: f64| Problem { lags, gamma: &empirical.gamma, weights: &weights, shape, exponent };
    if shape == Shape::Stable {
        let exponent = golden_section(|exponent| problem(exponent).best().1, 0.5, 2.0, SECTIONS, Inner::Reused);
        return Some(problem(exponent).best().0);
    }
    Some(problem(1.0).best().0)
}

struct Problem<'a> {
    lags: &'a [f64],
    gamma: &'a [f64],
    weights: &'a [f64],
    shape: Shape,
    exponent: f64,
}

impl Problem<'_> {
    /// The best model of this exponent, and its weighted sum of squares.
    fn best(&self) -> (Model, f64) {
        let lags = self.lags;
        let (low, high) = (portable_math::log(lags[0] / 20.0), portable_math::log(lags[lags.len() - 1] * 10.0));
        let at = |step: usize| low + (high - low) * step as f64 / GRID as f64;
        let cost = |log_length: f64| self.solve(portable_math::exp(log_length)).1;
        let costs = (0..=GRID).map(|step| (cost(at(step)), step));
        let best = costs.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, step)| step);
        let length =
            golden_section(cost, at(best.saturating_sub(1)), at((best + 1).min(GRID)), SECTIONS, Inner::Reused);
        self.solve(portable_math::exp(length))
    }

    /// The best model with this length parameter, and its weighted sum of squares.
    fn solve(&self, length: f64) -> (Model, f64) {
        let f: Vec<f64> = self.lags.iter().map(|h| self.shape.value(h / length, self.exponent)).collect();
        let (mut w, mut wf, mut wff, mut wg, mut wfg) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for ((f, g), weight) in f.iter().zip(self.gamma).zip(self.weights) {
            w += weight;
            wf += weight * f;
            wff += weight * f * f;
            wg += weight * g;
            wfg += weight * f * g;
        }
        let determinant = w * wff - wf * wf;
        let (mut nugget, mut partial) = if determinant > 1e-12 * w * wff {
            ((wff * wg - wf * wfg) / determinant, (w * wfg - wf * wg) / determinant)
        } else {
            // No lag is short enough to see a rise: all of it is nugget.
            (wg / w, 0.0)
        };
        if nugget < 0.0 {
            (nugget, partial) = (0.0, wfg / wff);
        } else if partial < 0.0 {
            (nugget, partial) = (wg / w, 0.0);
        }
        let cost = f.iter().zip(self.gamma).zip(self.weights).fold(0.0, |sum, ((f, g), weight)| {
            let residual = nugget + partial * f - g;
            sum + weight * residual * residual
        });
        (Model { exponent: self.exponent, ..Model::new(self.shape, nugget, partial, length) }, cost)
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;

    fn curve(model: &Model) -> (Vec<f64>, Variogram) {
        let lags: Vec<f64> = (1..=100).map(|k| 0.01 * f64::from(k)).collect();
        let gamma = lags.iter().map(|h| model.gamma(*h)).collect();
        let empirical = Variogram { lag_cells: lags.iter().map(|h| h * 100.0).collect(), gamma, pairs: vec![1.0; 100] };
        (lags, empirical)
    }

    #[test]
    fn a_known_model_comes_back() {
        for shape in [Shape::Exponential, Shape::Spherical, Shape::Gaussian] {
            for nugget in [0.0, 2e-5] {
                let truth = Model::new(shape, nugget, 1e-4, 0.123);
                let (lags, empirical) = curve(&truth);
                let found = fit(&lags, &empirical, shape).unwrap();
                assert!((found.length - truth.length).abs() < 1e-6, "{found:?}");
                assert!((found.nugget - truth.nugget).abs() < 1e-10 && (found.sill() - truth.sill()).abs() < 1e-10);
                assert!((found.gamma(found.range95()) - 0.95 * found.sill()).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn practical_ranges_of_the_structure_are_the_known_multiples() {
        let range = |shape| Model::new(shape, 0.3, 1.0, 1.0).range_structural();
        assert!((range(Shape::Exponential) - 2.995_732).abs() < 1e-6);
        assert!((range(Shape::Spherical) - 0.811_401).abs() < 1e-6);
        assert!((range(Shape::Gaussian) - 1.730_818).abs() < 1e-6);
    }

    #[test]
    fn the_exponent_of_a_stable_model_comes_back() {
        for exponent in [0.8, 1.5] {
            let truth = Model { exponent, ..Model::new(Shape::Stable, 2e-5, 1e-4, 0.123) };
            let (lags, empirical) = curve(&truth);
            let found = fit(&lags, &empirical, Shape::Stable).unwrap();
            assert!((found.exponent - exponent).abs() < 1e-3 && (found.length - 0.123).abs() < 1e-3, "{found:?}");
            assert!((found.gamma(found.range95()) - 0.95 * found.sill()).abs() < 1e-12);
        }
    }

    #[test]
    fn pure_nugget_has_no_range_and_a_negative_nugget_is_clipped() {
        let flat = Model::new(Shape::Exponential, 1.0, 0.0, 0.1);
        assert_eq!(flat.range95(), 0.0);
        let (lags, mut empirical) = curve(&Model { nugget: 0.0, partial_sill: 1.0, ..flat });
        empirical.gamma.iter_mut().for_each(|g| *g = (*g - 0.05).max(0.0));
        assert_eq!(fit(&lags, &empirical, Shape::Exponential).unwrap().nugget, 0.0);
        assert_eq!(fit(&lags[..2], &empirical, Shape::Exponential), None);
    }
}
