//! Whether volumes are those of a power law: how often volumes drawn from it lie as far from the law that is fitted to them.

use rayon::prelude::*;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;

use super::power_law;
use super::power_law::PowerLaw;

/// Sets of volumes drawn.
const DRAWS: i32 = 250;
/// Volumes up to which `V_min` is chosen anew in each set; of more it stays, since a choice takes a fit for each volume.
const CHOSEN_ANEW: usize = 1200;
const KEY: Key = Key(*b"volumes drawn from a power law 1");

/// The share of sets of volumes drawn from a law whose distance to the law fitted to them is at least that of the volumes.
///
/// A set has as many volumes: each from the law with the share of those from `V_min` up, else one of those below, with replacement. `minimum` and `least`
/// are those the law was fitted with; without a minimum each set has its own, of up to 1200 volumes. The draws have a fixed key: the same volumes give the
/// same share.
///
/// # References
/// Clauset, A., Shalizi, C. R., Newman, M. E. J. (2009), Power-law distributions in empirical data, SIAM Review 51, 661-703, section 4.1.
pub fn p_value(volumes: &[f64], law: &PowerLaw, minimum: Option<f64>, least: usize) -> f64 {
    let minimum = minimum.or((volumes.len() > CHOSEN_ANEW).then_some(law.minimum));
    let as_far = |set: &i32| {
        let drawn = drawn(volumes, law, minimum.is_some(), *set);
        power_law::fit(&drawn, minimum, law.maximum, least).is_none_or(|found| found.distance >= law.distance)
    };
    let count = (0..DRAWS).into_par_iter().filter(as_far).count();
    (count + 1) as f64 / f64::from(DRAWS + 1)
}

/// One set of volumes, ascending; those from `V_min` up only, as many as there are, or all.
fn drawn(volumes: &[f64], law: &PowerLaw, from_minimum: bool, set: i32) -> Vec<f64> {
    let field = KEY.field();
    let (below, above) = volumes.split_at(law.below);
    let count = if from_minimum { above.len() } else { volumes.len() };
    let beyond = law.maximum.map_or(0.0, |maximum| portable_math::pow(maximum / law.minimum, -law.exponent));
    let one = |i: usize| {
        let words = field.words(i as i32, set);
        let share = |word: u32| (f64::from(word) + 0.5) / 4_294_967_296.0;
        let is_below = !from_minimum && share(words[0]) * (volumes.len() as f64) < below.len() as f64;
        if is_below {
            return below[(share(words[1]) * below.len() as f64) as usize];
        }
        law.minimum * portable_math::pow(1.0 - share(words[1]) * (1.0 - beyond), -1.0 / law.exponent)
    };
    let mut drawn: Vec<f64> = (0..count).map(one).collect();
    // Rounding may put the largest one a little beyond what there can be.
    if let Some(maximum) = law.maximum {
        drawn.iter_mut().for_each(|volume| *volume = volume.min(maximum));
    }
    drawn.sort_by(f64::total_cmp);
    drawn
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Volumes of a law of exponent 0.7 from 0.01 up.
    fn volumes(count: usize, seed: u8) -> Vec<f64> {
        let field = Key([seed; 32]).field();
        let share = |i: usize| (f64::from(field.words(i as i32, 0)[0]) + 0.5) / 4_294_967_296.0;
        let mut volumes: Vec<f64> = (0..count).map(|i| 0.01 * portable_math::pow(share(i), -1.0 / 0.7)).collect();
        volumes.sort_by(f64::total_cmp);
        volumes
    }

    fn p_of(volumes: &[f64], minimum: Option<f64>, maximum: Option<f64>) -> f64 {
        p_value(volumes, &power_law::fit(volumes, minimum, maximum, 10).unwrap(), minimum, 10)
    }

    #[test]
    fn volumes_of_a_law_are_seldom_far_from_it() {
        for minimum in [Some(0.01), None] {
            let p: Vec<f64> = (0..20).map(|seed| p_of(&volumes(60, seed), minimum, None)).collect();
            let far = p.iter().filter(|p| **p < 0.1).count();
            let mean = p.iter().sum::<f64>() / 20.0;
            assert!(far <= 6 && (0.3..0.7).contains(&mean), "{p:?}");
        }
    }

    #[test]
    fn volumes_of_no_law_are_far_from_it() {
        // Two volumes only, evenly spread ones, and a lognormal.
        let two: Vec<f64> = (0..300).map(|i| if i < 150 { 0.01 } else { 1.0 }).collect();
        let even: Vec<f64> = (0..300).map(|i| 0.01 + 0.99 * (f64::from(i) + 0.5) / 300.0).collect();
        let field = Key([7; 32]).field();
        let mut lognormal: Vec<f64> = (0..300).map(|i| 0.05 * portable_math::exp(field.normal(i, 0))).collect();
        lognormal.sort_by(f64::total_cmp);
        for volumes in [two, even, lognormal] {
            let p = p_of(&volumes, Some(volumes[0]), None);
            assert!(p < 0.01, "{p}");
        }
    }

    #[test]
    fn draws_end_at_the_largest_volume() {
        let mut bounded = volumes(200, 3);
        bounded.retain(|volume| *volume <= 1.0);
        let law = power_law::fit(&bounded, Some(0.01), Some(1.0), 10).unwrap();
        assert!(drawn(&bounded, &law, true, 4).iter().all(|volume| (0.01..=1.0).contains(volume)));
        assert!(p_of(&bounded, Some(0.01), Some(1.0)) > 0.05);
    }
}
