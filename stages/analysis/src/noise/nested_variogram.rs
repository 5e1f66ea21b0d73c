//! Fits a variogram of a nugget and two exponential structures, a short and a long one.
//!
//! For given lengths the model is linear in its three variances, which must not be negative: with so few of them every
//! set of active ones is tried. The lengths are searched on a logarithmic grid and then in turn by golden section.

use nalgebra::{Cholesky, Matrix3, Vector3};

use crate::noise::variogram_model::{Model, SECTIONS, Shape};
use rockface_core::numerics::golden_section::{Inner, golden_section};
use rockface_core::numerics::portable_math;

/// Steps of the grid over each length.
const GRID: usize = 28;
/// Rounds of golden section over both lengths.
const ROUNDS: usize = 6;

struct Problem<'a> {
    lags: &'a [f64],
    gamma: &'a [f64],
    weights: &'a [f64],
}

/// The best model; `None` where no variance is positive.
pub fn fit(lags: &[f64], gamma: &[f64], weights: &[f64]) -> Option<Model> {
    let problem = Problem { lags, gamma, weights };
    let (low, high) = (portable_math::log(lags[0] / 4.0), portable_math::log(lags[lags.len() - 1] * 2.0));
    let at = |step: usize| low + (high - low) * step as f64 / GRID as f64;
    let cost = |a: f64, b: f64| problem.solve(portable_math::exp(a), portable_math::exp(b)).1;
    let pairs = (0..GRID).flat_map(|i| (i + 1..=GRID).map(move |j| (i, j)));
    let (_, i, j) = pairs.map(|(i, j)| (cost(at(i), at(j)), i, j)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let (mut a, mut b) = (at(i), at(j));
    let mut width = (high - low) / GRID as f64;
    for _ in 0..ROUNDS {
        a = golden_section(|x| cost(x, b), a - width, a + width, SECTIONS, Inner::Reused);
        b = golden_section(|x| cost(a, x), b - width, b + width, SECTIONS, Inner::Reused);
        width *= 0.7;
    }
    let (short, long) = (portable_math::exp(a.min(b)), portable_math::exp(a.max(b)));
    let [nugget, first, second] = problem.solve(short, long).0;
    let model = Model::new(Shape::Nested, nugget, first, short);
    match (first > 0.0, second > 0.0) {
        (true, true) => Some(Model { second: [second, long], ..model }),
        (false, true) => Some(Model::new(Shape::Nested, nugget, second, long)),
        _ => (nugget + first > 0.0).then_some(model),
    }
}

impl Problem<'_> {
    /// The best variances for these lengths, and their weighted sum of squares.
    fn solve(&self, short: f64, long: f64) -> ([f64; 3], f64) {
        let rise = |h: f64, length: f64| 1.0 - portable_math::exp(-h / length);
        let (mut normal, mut right, mut square) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for ((h, g), w) in self.lags.iter().zip(self.gamma).zip(self.weights) {
            let x = Vector3::new(1.0, rise(*h, short), rise(*h, long));
            normal += x * x.transpose() * *w;
            right += x * (w * g);
            square += w * g * g;
        }
        let mut best = ([0.0; 3], square);
        for active in 1u8..8 {
            let used = |i: usize| active >> i & 1 == 1;
            let matrix =
                Matrix3::from_fn(|i, j| if used(i) && used(j) { normal[(i, j)] } else { f64::from(u8::from(i == j)) });
            let vector = Vector3::from_fn(|i, _| if used(i) { right[i] } else { 0.0 });
            let Some(found) = Cholesky::new(matrix).map(|c| c.solve(&vector)) else { continue };
            let cost = square - found.dot(&vector);
            if found.iter().all(|c| *c >= 0.0) && cost < best.1 {
                best = ([found[0], found[1], found[2]], cost);
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_structures_come_back() {
        let truth = Model { second: [4e-5, 0.6], ..Model::new(Shape::Nested, 1e-5, 1e-4, 0.04) };
        let lags: Vec<f64> = (1..=200).map(|k| 0.01 * f64::from(k)).collect();
        let gamma: Vec<f64> = lags.iter().map(|h| truth.gamma(*h)).collect();
        let weights: Vec<f64> = lags.iter().map(|h| 1.0 / h).collect();
        let found = fit(&lags, &gamma, &weights).unwrap();
        assert!((found.length / 0.04 - 1.0).abs() < 0.1 && (found.second[1] / 0.6 - 1.0).abs() < 0.1, "{found:?}");
        assert!((found.sill() / truth.sill() - 1.0).abs() < 0.02);
        assert!((found.gamma(found.range95()) / found.sill() - 0.95).abs() < 1e-9);
        assert!((found.range95() / truth.range95() - 1.0).abs() < 0.1);
    }

    #[test]
    fn one_structure_is_no_trouble() {
        let lags: Vec<f64> = (1..=50).map(f64::from).collect();
        let gamma: Vec<f64> = lags.iter().map(|h| 1.0 - portable_math::exp(-h / 5.0)).collect();
        let found = fit(&lags, &gamma, &[1.0; 50]).unwrap();
        assert!((found.sill() - 1.0).abs() < 0.02 && (found.range_structural() / 15.0 - 1.0).abs() < 0.05, "{found:?}");
    }
}
