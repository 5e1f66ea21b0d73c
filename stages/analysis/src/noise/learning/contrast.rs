//! The contrast with which draws of a model have details that vary over the face as those of the rasters do.

use rayon::prelude::*;

use crate::noise::learning::whitening::{CLASSES, Places, Whitened};
use rockface_core::artefact::{Contrast, GAP};
use rockface_imaging::matching::noise::contrast::{LEVELS_CELLS, variation as of_field};

/// Levels of details that have a contrast.
pub const LEVELS: usize = LEVELS_CELLS.len();
/// Range of the power of the local rms.
const POWERS: [f64; 2] = [-0.9, 2.0];
/// The power that is tried first, beside none.
const FIRST_TRIAL: f64 = 0.5;
/// Rounds in which the line through the last two trials gives the next power.
const ROUNDS: usize = 2;
/// Least growth of the variation with the power that says something.
const LEAST_SLOPE: f64 = 0.05;

/// A number for each level of details and class of place.
pub type ByLevel = [[f64; CLASSES]; LEVELS];

/// Mean variation of the details of whitened rasters.
pub fn variation(whitened: &[&Whitened], columns: usize, places: &Places) -> ByLevel {
    let one = |whitened: &&Whitened| {
        let value = |(value, weight): (&f32, &u8)| if weight & GAP == 0 { f64::from(*value) } else { f64::NAN };
        let field: Vec<f64> = whitened.field.iter().zip(&whitened.weights).map(value).collect();
        of_field(&field, columns, &LEVELS_CELLS, &places.class, CLASSES)
    };
    let all: Vec<Vec<Vec<f64>>> = whitened.par_iter().map(one).collect();
    let mean = |level: usize, class: usize| all.iter().map(|found| found[level][class]).sum::<f64>() / all.len() as f64;
    std::array::from_fn(|level| std::array::from_fn(|class| mean(level, class)))
}

/// Powers of the local rms, and how the variation grows with them.
#[derive(Debug, Clone, PartialEq)]
pub struct Powers {
    /// The powers.
    pub powers: ByLevel,
    /// Growth of the variation with the power; 0: not known.
    pub growth: ByLevel,
}

impl Powers {
    /// One power everywhere.
    pub fn even(power: f64) -> Self {
        Self { powers: [[power; CLASSES]; LEVELS], growth: [[0.0; CLASSES]; LEVELS] }
    }

    /// As a model has them.
    pub fn contrast(&self) -> Vec<Contrast> {
        let levels = LEVELS_CELLS.into_iter().zip(&self.powers).zip(&self.growth);
        levels
            .map(|((cells, powers), growth)| Contrast { cells, powers: powers.to_vec(), growth: growth.to_vec() })
            .collect()
    }
}

/// Makes up for what a survey loses of the variation (its logarithm, 0 where nothing is lost), within the range of powers.
pub fn make_up(contrast: &mut [Contrast], lost: impl Fn(usize, usize) -> f64) {
    for (level, contrast) in contrast.iter_mut().enumerate() {
        for (class, (power, growth)) in contrast.powers.iter_mut().zip(&contrast.growth).enumerate() {
            if *growth >= LEAST_SLOPE {
                *power = (*power + lost(level, class) / growth).clamp(POWERS[0], POWERS[1]);
            }
        }
    }
}

/// The powers for which `trial` comes to the variation that is wanted, by secants, all at once.
pub fn fitted(wanted: &ByLevel, mut trial: impl FnMut(&Powers) -> ByLevel) -> Powers {
    let mut before = Powers::even(0.0);
    let mut found_before = trial(&before);
    let mut now = Powers::even(FIRST_TRIAL);
    for _ in 0..ROUNDS {
        let found = trial(&now);
        let mut next = now.clone();
        for (level, class) in (0..LEVELS).flat_map(|level| (0..CLASSES).map(move |class| (level, class))) {
            let at = |values: &ByLevel| values[level][class];
            let step = at(&now.powers) - at(&before.powers);
            // Without a step the growth found before stands.
            let growth = if step == 0.0 { at(&now.growth) } else { (at(&found) - at(&found_before)) / step };
            let power = at(&now.powers) + (at(wanted) - at(&found)) / growth.max(LEAST_SLOPE);
            next.powers[level][class] = power.clamp(POWERS[0], POWERS[1]);
            next.growth[level][class] = growth;
        }
        (before, found_before, now) = (now, found, next);
    }
    now
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_found_where_the_variation_grows_with_them() {
        let law = |powers: &Powers| powers.powers.map(|level| level.map(|p| 1.4 * (1.0 + p) - 0.1 * p * p - 3.0));
        let truth = [0.8, 0.1, -0.4].map(|power| std::array::from_fn(|class| power - 0.1 * class as f64));
        let found = fitted(&law(&Powers { powers: truth, ..Powers::even(0.0) }), law).powers;
        for (found, truth) in found.iter().flatten().zip(truth.iter().flatten()) {
            assert!((found - truth).abs() < 0.02, "{found} {truth}");
        }
        // Noise that no contrast makes uneven enough has the highest.
        let highest = [[POWERS[1]; CLASSES]; LEVELS];
        assert!(fitted(&[[0.0; CLASSES]; LEVELS], |_| [[-5.0; CLASSES]; LEVELS]).powers == highest);
    }
}
