//! Variogram estimators that outliers hardly move, from a sample of pairs of cells.

use rayon::prelude::*;

use crate::noise::variogram::Variogram;
use rockface_core::choice;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::quantile::median;
use rockface_core::numerics::random::{Field, Key};

choice! {
    /// How gamma is estimated from the differences of pairs.
    pub enum Estimator {
        /// Half the mean square, over all pairs (Matheron 1962).
        Matheron = "matheron",
        /// From the mean square root (Cressie and Hawkins 1980).
        CressieHawkins = "cressie_hawkins",
        /// From the median (Dowd 1984).
        Dowd = "dowd",
    }
}

/// Pairs of a lag bin that are looked at.
const PAIRS: usize = 4000;
/// Places that are tried for each of them: gaps and the edge cost tries.
const TRIES: usize = 40;

impl Estimator {
    /// Puts the robust estimate in place of Matheron's in every bin of a variogram of these values; a bin without sampled pairs
    /// keeps what it has.
    ///
    /// Pairs are drawn evenly over cells and lag vectors of the bin from a fixed stream, so rasters of one grid are compared at the
    /// same pairs.
    pub fn refine(self, variogram: &mut Variogram, values: &[f32], columns: usize) {
        if self == Self::Matheron {
            return;
        }
        let field = Key(*b"pairs of the robust variograms..").field();
        let refined: Vec<Option<f64>> = variogram
            .lag_cells
            .par_iter()
            .map(|lag| self.estimate(&mut differences(values, columns, lag.round(), &field)))
            .collect();
        for (gamma, refined) in variogram.gamma.iter_mut().zip(refined) {
            *gamma = refined.unwrap_or(*gamma);
        }
    }

    /// gamma from absolute differences; `None` without any.
    fn estimate(self, differences: &mut [f64]) -> Option<f64> {
        let n = differences.len() as f64;
        match self {
            _ if differences.is_empty() => None,
            Self::Matheron => Some(0.5 * differences.iter().map(|d| d * d).sum::<f64>() / n),
            Self::CressieHawkins => {
                let mean = differences.iter().map(|d| d.sqrt()).sum::<f64>() / n;
                Some(0.5 * mean * mean * mean * mean / (0.457 + 0.494 / n + 0.045 / (n * n)))
            }
            Self::Dowd => median(differences).map(|m| 0.5 * 2.198 * m * m),
        }
    }
}

/// Absolute differences of pairs whose distance rounds to `lag` cells.
fn differences(values: &[f32], columns: usize, lag: f64, field: &Field) -> Vec<f64> {
    let rows = values.len() / columns;
    let mut found = Vec::with_capacity(PAIRS);
    for item in 0..PAIRS * TRIES {
        if found.len() == PAIRS {
            break;
        }
        let words = field.words(item as i32, lag as i32);
        let unit = |word: u32| f64::from(word) / 4_294_967_296.0;
        let length = lag - 0.5 + unit(words[0]);
        let (sin, cos) = portable_math::sincos(std::f64::consts::TAU * unit(words[1]));
        let (dx, dy) = ((length * cos).round(), (length * sin).round());
        if ((dx * dx + dy * dy).sqrt() + 0.5).floor() as i64 != lag as i64 {
            continue;
        }
        let (x, y) = ((unit(words[2]) * columns as f64).floor(), (unit(words[3]) * rows as f64).floor());
        let (ox, oy) = (x + dx, y + dy);
        if ox < 0.0 || oy < 0.0 || ox >= columns as f64 || oy >= rows as f64 {
            continue;
        }
        let value = |x: f64, y: f64| f64::from(values[y as usize * columns + x as usize]);
        let difference = (value(x, y) - value(ox, oy)).abs();
        if !difference.is_nan() {
            found.push(difference);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::variogram::variogram;

    #[test]
    fn normal_noise_has_its_variance_by_every_estimator_and_outliers_move_only_matheron() {
        let field = Key([5; 32]).field();
        let mut noise: Vec<f32> = (0..90_000).map(|i| field.normal(i % 300, i / 300) as f32).collect();
        let curve = |values: &[f32], estimator: Estimator| {
            let mut found = variogram(values, 300, 10, 0.0, 1.0);
            estimator.refine(&mut found, values, 300);
            found.gamma.iter().sum::<f64>() / found.gamma.len() as f64
        };
        for estimator in [Estimator::CressieHawkins, Estimator::Dowd] {
            assert!((curve(&noise, estimator) - 1.0).abs() < 0.05, "{estimator:?}: {}", curve(&noise, estimator));
        }
        for value in noise.iter_mut().step_by(100) {
            *value = 30.0;
        }
        assert!(curve(&noise, Estimator::Matheron) > 5.0);
        assert!(curve(&noise, Estimator::CressieHawkins) < 1.4 && curve(&noise, Estimator::Dowd) < 1.15);
        noise.fill(f32::NAN);
        assert!(Estimator::Dowd.estimate(&mut differences(&noise, 300, 3.0, &field)).is_none());
    }
}
