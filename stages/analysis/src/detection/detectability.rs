//! How likely a change is found, by its size, shape and place: shares in classes, and a logistic curve.

use rockface_core::numerics::logistic::{self, Regression};
use rockface_core::numerics::{portable_math, quantile};

/// Determinant of the second derivatives of the likelihood below which there is no finite optimum.
const LEAST_INFORMATION: f64 = 1e-12;

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

/// A logistic curve of the decimal logarithm of a property: p = 1 / (1 + exp(-(a + b log10 x))).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Logistic {
    /// a: logarithm of the odds where the property is 1.
    pub intercept: f64,
    /// b: how much that grows where the property is ten times as large.
    pub slope: f64,
    /// Standard error of b.
    pub slope_se: f64,
}

impl Logistic {
    /// Whether the property matters beyond chance: the slope is two standard errors from 0.
    pub fn is_certain(&self) -> bool {
        self.slope.abs() > 2.0 * self.slope_se
    }

    /// Where a change is found with this probability.
    pub fn at(&self, probability: f64) -> f64 {
        let logit = portable_math::log(probability / (1.0 - probability));
        portable_math::pow(10.0, (logit - self.intercept) / self.slope)
    }
}

/// Fits the curve by maximum likelihood; `None` where all or none are found, where the property separates both without error,
/// so that no finite curve is the likeliest, or where the property does not matter.
pub fn logistic(values: &[f64], found: &[bool]) -> Option<Logistic> {
    let x: Vec<f64> = values.iter().map(|value| portable_math::log10(*value)).collect();
    let centre = quantile::quantile(&x, 0.5)?;
    let design: Vec<Vec<f64>> = x.iter().map(|x| vec![1.0, x - centre]).collect();
    let importance = vec![1.0; x.len()];
    let regression = Regression { design: &design, happened: found, importance: &importance, ridge: 0.0, damping: 0.0 };
    let fit = logistic::fit(&regression);
    let information = &fit.information;
    let determinant = information[(0, 0)] * information[(1, 1)] - information[(0, 1)] * information[(0, 1)];
    let (a, b) = (fit.weights[0], fit.weights[1]);
    if !fit.settled || determinant.is_nan() || determinant < LEAST_INFORMATION || b.abs() <= 1e-9 {
        return None;
    }
    let slope_se = (information[(0, 0)] / determinant).sqrt();
    Some(Logistic { intercept: a - b * centre, slope: b, slope_se })
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn a_logistic_curve_comes_back() {
        let curve = Logistic { intercept: 8.0, slope: 4.0, slope_se: 0.0 };
        // A hundred changes of each of 21 volumes, found in the share the curve says.
        let volumes: Vec<f64> = (0..2100).map(|i| portable_math::pow(10.0, -4.0 + f64::from(i / 100) * 0.2)).collect();
        let share =
            |v: f64| 1.0 / (1.0 + portable_math::exp(-(curve.intercept + curve.slope * portable_math::log10(v))));
        let found: Vec<bool> =
            volumes.iter().enumerate().map(|(i, v)| ((i % 100) as f64) < (100.0 * share(*v)).round()).collect();
        let fit = logistic(&volumes, &found).unwrap();
        assert!((fit.slope - 4.0).abs() < 0.1 && (fit.at(0.5) / 0.01 - 1.0).abs() < 0.02, "{fit:?}");
        assert!(fit.at(0.9) > fit.at(0.5) && fit.slope_se < 0.3);
    }

    #[test]
    fn no_curve_where_all_or_none_are_found_or_all_is_clear() {
        let volumes = [0.1, 0.2, 0.3, 0.4];
        assert_eq!(logistic(&volumes, &[true; 4]), None);
        assert_eq!(logistic(&volumes, &[false; 4]), None);
        assert_eq!(logistic(&volumes, &[false, false, true, true]), None);
        assert_eq!(logistic(&[], &[]), None);
    }
}
