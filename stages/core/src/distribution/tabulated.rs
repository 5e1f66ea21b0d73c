//! Distributions given by numbers: weighted values, a piecewise linear density, a sample.

use std::borrow::Cow;

use crate::numerics::quantile::of_sorted;

/// One of a few values, by weights; `None` where there is none.
pub fn discrete(values: &[f64], weights: Option<&[f64]>, u: f64) -> Option<f64> {
    match weights {
        Some(weights) => values.get(chosen(weights, u)?).copied(),
        None => values.get(((u * values.len() as f64) as usize).min(values.len().checked_sub(1)?)).copied(),
    }
}

/// The position that a share `u` of the sum of weights falls into; `None` where every weight is zero.
pub fn chosen(weights: &[f64], u: f64) -> Option<usize> {
    let total: f64 = weights.iter().sum();
    let mut left = u * total;
    for (index, weight) in weights.iter().enumerate() {
        if left < *weight {
            return Some(index);
        }
        left -= weight;
    }
    // Rounding may leave a hair over the last weight.
    weights.iter().rposition(|weight| *weight > 0.0)
}

/// A sample: one of its values, or between its order statistics (type 7 of Hyndman and Fan 1996).
pub fn samples(values: &[f64], smooth: bool, u: f64) -> Option<f64> {
    let ascending = ascending(values);
    if smooth { of_sorted(&ascending, u) } else { discrete(&ascending, None, u) }
}

/// Values in ascending order, so that more `u` never gives less; no copy where they are so already.
fn ascending(values: &[f64]) -> Cow<'_, [f64]> {
    if values.is_sorted() {
        return Cow::Borrowed(values);
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    Cow::Owned(sorted)
}

/// A density linear between the points of a table and zero outside, of any scale.
pub fn density(x: &[f64], p: &[f64], u: f64) -> Option<f64> {
    let area = |i: usize| 0.5 * (p[i] + p[i + 1]) * (x[i + 1] - x[i]);
    let areas: Vec<f64> = (0..x.len().checked_sub(1)?).map(area).collect();
    let total: f64 = areas.iter().sum();
    let at = chosen(&areas, u)?;
    let before: f64 = areas[..at].iter().sum();
    let wanted = (u * total - before).clamp(0.0, areas[at]);
    let width = x[at + 1] - x[at];
    // p t + (q - p) t^2 / 2 = wanted / width, solved without cancellation.
    let (slope, rest) = (p[at + 1] - p[at], wanted / width);
    let root = (p[at] * p[at] + 2.0 * slope * rest).max(0.0).sqrt();
    let share = if rest > 0.0 { 2.0 * rest / (p[at] + root) } else { 0.0 };
    Some(x[at] + share.clamp(0.0, 1.0) * width)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_choose_by_their_share() {
        let weights = [1.0, 0.0, 3.0];
        assert_eq!([0.0, 0.249, 0.25, 0.999].map(|u| chosen(&weights, u)), [Some(0), Some(0), Some(2), Some(2)]);
        assert_eq!(chosen(&[0.0, 0.0], 0.5), None);
        assert_eq!(discrete(&[], None, 0.5), None);
    }

    #[test]
    fn a_flat_density_is_uniform_and_a_tent_is_symmetric() {
        assert_eq!(density(&[2.0, 3.0, 6.0], &[5.0, 5.0, 5.0], 0.5), Some(4.0));
        let tent = |u: f64| density(&[-1.0, 0.0, 1.0], &[0.0, 1.0, 0.0], u).unwrap();
        assert!((tent(0.125) + 0.5).abs() < 1e-15 && (tent(0.875) - 0.5).abs() < 1e-15);
        assert!(tent(0.5).abs() < 1e-15);
    }
}
