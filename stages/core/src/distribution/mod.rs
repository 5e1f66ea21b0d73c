//! Drawing numbers from distributions by inversion: one uniform draw gives one value, so draws can be addressed by name.

mod draws;
mod tabulated;

pub use draws::Draws;
pub use tabulated::chosen;

use crate::artefact::candidates::{Distribution, Exponential, LogNormal, PowerLaw, Quantity, TruncatedNormal};
use crate::numerics::normal::{normal_cdf, normal_quantile};
use crate::numerics::{beta, portable_math};

/// The value below which a share `u` (0 to 1, both excluded) of all draws lies, in the unit of the quantity.
///
/// A distribution that is still in a file has no quantile: `None`.
pub fn quantile(quantity: &Quantity, u: f64) -> Option<f64> {
    match quantity {
        Quantity::Fixed(value) => Some(*value),
        Quantity::Drawn(distribution) => of_distribution(distribution, u),
    }
}

fn of_distribution(distribution: &Distribution, u: f64) -> Option<f64> {
    Some(match distribution {
        Distribution::Constant(d) => d.value,
        Distribution::Uniform(d) => d.min + u * (d.max - d.min),
        Distribution::Normal(d) => d.mean + d.sd * normal_quantile(u),
        Distribution::TruncatedNormal(d) => truncated_normal(d, u),
        Distribution::LogNormal(d) => log_normal(d, u),
        Distribution::Exponential(d) => exponential(d, u),
        Distribution::Beta(d) => d.min + (d.max - d.min) * beta::quantile(d.a, d.b, u),
        Distribution::PowerLaw(d) => power_law(d, u),
        Distribution::Discrete(d) => return tabulated::discrete(&d.values, d.weights.as_deref(), u),
        Distribution::Density(d) => return tabulated::density(&d.x, &d.p, u),
        Distribution::Samples(d) => return tabulated::samples(&d.values, d.smooth, u),
        Distribution::File(_) => return None,
    })
}

/// The quantile of a standard normal kept between `low` and `high`; the upper tail is taken by symmetry, so that
/// bounds far above the mean lose no digits.
fn truncated_standard(low: f64, high: f64, u: f64) -> f64 {
    if low > 0.0 {
        return -truncated_standard(-high, -low, 1.0 - u);
    }
    let (from, to) = (normal_cdf(low), normal_cdf(high));
    normal_quantile(from + u * (to - from)).clamp(low, high)
}

fn truncated_normal(d: &TruncatedNormal, u: f64) -> f64 {
    let (low, high) = (d.min.unwrap_or(f64::NEG_INFINITY), d.max.unwrap_or(f64::INFINITY));
    let value = d.mean + d.sd * truncated_standard((low - d.mean) / d.sd, (high - d.mean) / d.sd, u);
    value.clamp(low, high)
}

fn log_normal(d: &LogNormal, u: f64) -> f64 {
    let standard = |bound: Option<f64>, none: f64| bound.map_or(none, |x| portable_math::log(x / d.median) / d.sigma);
    let z = truncated_standard(standard(d.min, f64::NEG_INFINITY), standard(d.max, f64::INFINITY), u);
    let value = d.median * portable_math::exp(d.sigma * z);
    value.clamp(d.min.unwrap_or(f64::MIN_POSITIVE), d.max.unwrap_or(f64::MAX))
}

fn exponential(d: &Exponential, u: f64) -> f64 {
    let kept = d.max.map_or(1.0, |max| 1.0 - portable_math::exp(-(max - d.min) / d.mean));
    let value = d.min - d.mean * portable_math::log(1.0 - u * kept);
    value.clamp(d.min, d.max.unwrap_or(f64::MAX))
}

fn power_law(d: &PowerLaw, u: f64) -> f64 {
    let kept = 1.0 - portable_math::pow(d.min / d.max, d.exponent);
    (d.min * portable_math::pow(1.0 - u * kept, -1.0 / d.exponent)).clamp(d.min, d.max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::ParamType;
    use serde_json::{Value, json};

    fn quantity(value: &Value) -> Quantity {
        Quantity::decode(value).unwrap()
    }

    /// Mean and variance by the midpoint rule over the quantile function.
    fn moments(value: &Value) -> (f64, f64) {
        let (quantity, n) = (quantity(value), 200_000);
        let draws: Vec<f64> =
            (0..n).map(|i| quantile(&quantity, (f64::from(i) + 0.5) / f64::from(n)).unwrap()).collect();
        let mean = draws.iter().sum::<f64>() / f64::from(n);
        (mean, draws.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / f64::from(n))
    }

    fn check(value: &Value, mean: f64, variance: f64) {
        let found = moments(value);
        let near = |a: f64, b: f64| (a - b).abs() <= 2e-4 * (1.0 + b.abs());
        assert!(near(found.0, mean) && near(found.1, variance), "{value}: {found:?}, expected {mean}, {variance}");
    }

    #[test]
    fn moments_are_those_of_the_textbook() {
        check(&json!(3.5), 3.5, 0.0);
        check(&json!({"constant": {"value": -2}}), -2.0, 0.0);
        check(&json!({"uniform": {"min": 1, "max": 4}}), 2.5, 0.75);
        check(&json!({"normal": {"mean": 5, "sd": 2}}), 5.0, 4.0);
        // Half normal: mean sqrt(2 / pi), variance 1 - 2 / pi.
        check(&json!({"truncated_normal": {"mean": 0, "sd": 1, "min": 0}}), 0.797_884_560_8, 0.363_380_227_6);
        // Symmetric truncation at one sigma: variance 1 - 2 phi(1) / (Phi(1) - Phi(-1)).
        check(&json!({"truncated_normal": {"mean": 2, "sd": 1, "min": 1, "max": 3}}), 2.0, 0.291_125_094_5);
        // exp(sigma^2 / 2) and (exp(sigma^2) - 1) exp(sigma^2).
        check(&json!({"log_normal": {"median": 1, "sigma": 0.5}}), 1.133_148_453_1, 0.364_695_843_4);
        check(&json!({"exponential": {"mean": 2, "min": 1}}), 3.0, 4.0);
        // Truncated at its mean: 1 - 1 / (e - 1).
        check(&json!({"exponential": {"mean": 1, "max": 1}}), 0.418_023_293_1, 0.079_326_470_6);
        check(&json!({"beta": {"a": 2, "b": 5}}), 2.0 / 7.0, 10.0 / (49.0 * 8.0));
        check(&json!({"beta": {"a": 0.5, "b": 0.5, "min": 1, "max": 3}}), 2.0, 0.5);
        // Bounded Pareto of exponent 2 on 1 to 10: mean 2 / 0.99 (1 - 0.1), second moment 2 ln 10 / 0.99.
        check(&json!({"power_law": {"exponent": 2, "min": 1, "max": 10}}), 1.818_181_818_2, 1.345_874_3);
        check(&json!({"discrete": {"values": [1, 5], "weights": [3, 1]}}), 2.0, 3.0);
        // A triangle from 0 to 1 rising to its right end: mean 2 / 3, variance 1 / 18.
        check(&json!({"density": {"x": [0, 1], "p": [0, 7]}}), 2.0 / 3.0, 1.0 / 18.0);
        check(&json!({"samples": {"values": [4, 1, 1]}}), 2.0, 2.0);
        check(&json!({"samples": {"values": [4, 1, 1], "smooth": true}}), 1.75, 0.9375);
    }

    #[test]
    fn quantiles_rise_and_stay_inside_the_support() {
        let all = [
            json!({"truncated_normal": {"mean": 0, "sd": 1, "min": 30, "max": 31}}),
            json!({"truncated_normal": {"mean": 0, "sd": 1, "max": -9}}),
            json!({"log_normal": {"median": 0.5, "sigma": 0.4, "min": 0.1, "max": 2}}),
            json!({"exponential": {"mean": 0.1, "min": 2, "max": 2.5}}),
            json!({"beta": {"a": 0.3, "b": 40}}),
            json!({"power_law": {"exponent": 0.6, "min": 0.001, "max": 100}}),
            json!({"density": {"x": [-1, 0, 0.5, 3], "p": [0, 2, 0, 1]}}),
        ];
        for value in &all {
            let quantity = quantity(value);
            let (low, high) = quantity.support();
            let values: Vec<f64> =
                (0..=1000).map(|i| quantile(&quantity, (f64::from(i) + 0.001) / 1000.1).unwrap()).collect();
            assert!(values.windows(2).all(|pair| pair[0] <= pair[1]), "{value}");
            assert!(values.iter().all(|x| (low..=high).contains(x)), "{value}");
            assert!(values[0] < values[1000], "{value}");
        }
    }
}
