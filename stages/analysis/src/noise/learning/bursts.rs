//! The bursts with which fine details of draws of a model vary from cell to cell as those of the rasters do.

use rayon::prelude::*;

use crate::noise::learning::whitening::{CLASSES, Places, Whitened};
use crate::noise::structure;
use rockface_core::artefact::{Bursts, GAP};

/// Largest variance of the logarithm of a burst.
const MOST: f64 = 0.6;
/// The variance that is tried first, beside none.
const FIRST_TRIAL: f64 = 0.2;
/// Rounds in which the line through the last two trials gives the next variance.
const ROUNDS: usize = 3;
/// Smallest growth of the variation that a correction assumes. Usual growths are 0.5 to 0.9; chance makes them smaller in a class of few cells, which
/// would get bursts that are far too strong.
const LEAST_GROWTH: f64 = 0.4;
/// Least change of a variance that says how the variation grows.
const LEAST_CHANGE: f64 = 0.02;

/// A number for each class of place.
pub type ByClass = [f64; CLASSES];

/// Mean variation of the finest details of whitened rasters, with the strength of each place; NaN where no raster has any.
pub fn variation(whitened: &[&Whitened], columns: usize, places: &Places) -> ByClass {
    let one = |whitened: &&Whitened| {
        let value = |((value, weight), strength): ((&f32, &u8), &f32)| {
            if weight & GAP == 0 { f64::from(*value) * f64::from(*strength) } else { f64::NAN }
        };
        let field: Vec<f64> = whitened.field.iter().zip(&whitened.weights).zip(&places.strength).map(value).collect();
        structure::variation(&field, columns, &places.class, CLASSES)
    };
    let all: Vec<Vec<f64>> = whitened.par_iter().map(one).collect();
    std::array::from_fn(|class| {
        let known = || all.iter().map(|found| found[class]).filter(|variation| !variation.is_nan());
        known().sum::<f64>() / known().count() as f64
    })
}

/// Makes up for what a survey loses of the variation (its logarithm, 0 where nothing is lost).
pub fn make_up(bursts: &mut Bursts, lost: impl Fn(usize) -> f64) {
    for (class, (variance, growth)) in bursts.log_variance.iter_mut().zip(&bursts.growth).enumerate() {
        if *growth > 0.0 {
            *variance = (*variance + lost(class) / growth.max(LEAST_GROWTH)).clamp(0.0, MOST);
        }
    }
}

/// The same bursts in all classes of place.
pub fn even(log_variance: f64) -> Bursts {
    Bursts { log_variance: vec![log_variance; CLASSES], ..Bursts::none(CLASSES) }
}

/// The bursts for which `trial` comes to the variation that is wanted, by secants, all classes at once.
pub fn fitted(wanted: &ByClass, mut trial: impl FnMut(&Bursts) -> ByClass) -> Bursts {
    let mut before = even(0.0);
    let mut found_before = trial(&before);
    let mut now = even(FIRST_TRIAL);
    for _ in 0..ROUNDS {
        let found = trial(&now);
        let mut next = now.clone();
        for class in 0..CLASSES {
            let change = now.log_variance[class] - before.log_variance[class];
            let growth = if change.abs() < LEAST_CHANGE {
                now.growth[class]
            } else {
                (found[class] - found_before[class]) / change
            };
            let variance = now.log_variance[class] + (wanted[class] - found[class]) / growth.max(LEAST_GROWTH);
            // Where nothing is known of the variation there are no bursts to fit.
            let known = !variance.is_nan();
            next.log_variance[class] = if known { variance.clamp(0.0, MOST) } else { 0.0 };
            next.growth[class] = if known { growth } else { 0.0 };
        }
        (before, found_before, now) = (now, found, next);
    }
    now
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variances_are_found_where_the_variation_grows_with_them() {
        let law = |bursts: &Bursts| {
            std::array::from_fn(|k| 0.8 * bursts.log_variance[k] / (1.0 + bursts.log_variance[k]) - 1.5)
        };
        let truth: Vec<f64> = (0..CLASSES).map(|class| 0.08 * class as f64).collect();
        let found = fitted(&law(&Bursts { log_variance: truth.clone(), ..Bursts::none(CLASSES) }), law);
        for (found, truth) in found.log_variance.iter().zip(&truth) {
            assert!((found - truth).abs() < 0.01, "{found} {truth}");
        }
        assert!(fitted(&[f64::NAN; CLASSES], law) == even(0.0));
        // Noise that no bursts make uneven enough has the strongest, and a mixture that is uneven enough has none.
        assert!(fitted(&[0.0; CLASSES], |_| [-5.0; CLASSES]).log_variance == [MOST; CLASSES]);
        assert!(fitted(&[-9.0; CLASSES], law).log_variance == [0.0; CLASSES]);
    }
}
