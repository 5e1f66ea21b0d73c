//! Magnitude and frequency: the power law of the largest volumes by maximum likelihood, and the curve of all of them.

use rockface_core::numerics::portable_math;

/// A power law N(>= V) = n (V / V_min)^-b of the volumes from a smallest one up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PowerLaw {
    /// Exponent b of the cumulative curve.
    pub exponent: f64,
    /// Its standard error, b/sqrt(n).
    pub standard_error: f64,
    /// Smallest volume the law holds for, in the unit of the volumes.
    pub minimum: f64,
    /// Volumes from the smallest one up.
    pub count: usize,
    /// Volumes below it: the roll-over.
    pub below: usize,
    /// Largest distance between the law and the volumes as cumulative shares (Kolmogorov-Smirnov).
    pub distance: f64,
}

impl PowerLaw {
    /// Number of volumes from this one up, by the law.
    pub fn number_from(&self, volume: f64) -> f64 {
        self.count as f64 * portable_math::pow(volume / self.minimum, -self.exponent)
    }
}

/// Fits the law to the volumes from `minimum` up; without it, from the volume at which the law lies nearest to the rest,
/// which must be at least `least` volumes.
///
/// `volumes` are positive and ascending. `None` where fewer than `least` (or 2) volumes are left, or all are equal.
///
/// # References
/// Clauset, A., Shalizi, C. R., Newman, M. E. J. (2009), Power-law distributions in empirical data, SIAM Review 51,
/// 661-703, equations 3.1 and 3.9; their exponent is b + 1.
pub fn fit(volumes: &[f64], minimum: Option<f64>, least: usize) -> Option<PowerLaw> {
    let logarithms: Vec<f64> = volumes.iter().map(|volume| portable_math::log(*volume)).collect();
    let least = least.max(2);
    let starts = (0..volumes.len()).filter(|i| *i == 0 || volumes[i - 1] < volumes[*i]);
    let starts: Vec<usize> = match minimum {
        Some(minimum) => vec![volumes.partition_point(|volume| *volume < minimum)],
        None => starts.collect(),
    };
    let fits = starts.into_iter().filter(|start| volumes.len() - start >= least).filter_map(|start| {
        let from = minimum.unwrap_or(volumes[start]);
        from_a_volume(&logarithms, start, from)
    });
    fits.reduce(|best, next| if next.distance < best.distance { next } else { best })
}

fn from_a_volume(logarithms: &[f64], start: usize, minimum: f64) -> Option<PowerLaw> {
    let origin = portable_math::log(minimum);
    let tail = &logarithms[start..];
    let count = tail.len() as f64;
    let sum = tail.iter().fold(0.0, |sum, logarithm| sum + (logarithm - origin));
    if sum <= 0.0 {
        return None;
    }
    let exponent = count / sum;
    let mut distance = 0.0f64;
    for (place, logarithm) in tail.iter().enumerate() {
        let law = 1.0 - portable_math::exp(-exponent * (logarithm - origin));
        let (before, after) = (place as f64 / count, (place + 1) as f64 / count);
        distance = distance.max((law - before).abs()).max((after - law).abs());
    }
    let standard_error = exponent / count.sqrt();
    Some(PowerLaw { exponent, standard_error, minimum, count: tail.len(), below: start, distance })
}

/// The cumulative curve: each volume, the largest first, with the number of volumes at least as large.
///
/// `volumes` are ascending; equal ones give one point.
pub fn curve(volumes: &[f64]) -> Vec<(f64, usize)> {
    let firsts = (0..volumes.len()).filter(|i| *i == 0 || volumes[i - 1] < volumes[*i]);
    let mut curve: Vec<(f64, usize)> = firsts.map(|i| (volumes[i], volumes.len() - i)).collect();
    curve.reverse();
    curve
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Quantiles of a power law at the middles of equal shares.
    fn ideal(exponent: f64, minimum: f64, count: usize) -> Vec<f64> {
        let share = |i: usize| 1.0 - (i as f64 + 0.5) / count as f64;
        (0..count).map(|i| minimum * portable_math::pow(share(i), -1.0 / exponent)).collect()
    }

    #[test]
    fn the_exponent_of_an_ideal_sample_comes_back() {
        for exponent in [0.5, 0.9, 1.7] {
            let found = fit(&ideal(exponent, 0.02, 4000), Some(0.02), 10).unwrap();
            assert!((found.exponent / exponent - 1.0).abs() < 2e-3, "{found:?}");
            assert!((found.standard_error - found.exponent / 4000f64.sqrt()).abs() < 1e-12);
            assert!(found.distance < 2e-3 && (found.number_from(0.02) - 4000.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_published_formula_by_hand() {
        // b = n / sum ln(V / V_min) with V = 1, e, e^2: 3 / 3.
        let volumes = [1.0, std::f64::consts::E, std::f64::consts::E * std::f64::consts::E];
        let found = fit(&volumes, Some(1.0), 2).unwrap();
        assert!((found.exponent - 1.0).abs() < 1e-14 && found.below == 0);
        // Law: 0, 0.632, 0.865 against the steps 0, 1/3, 2/3, 1: farthest at the first.
        assert!((found.distance - 1.0 / 3.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn a_roll_over_is_left_below_the_smallest_volume() {
        let mut volumes: Vec<f64> = (1..400).map(|i| 0.02 * (f64::from(i) / 400.0).sqrt()).collect();
        volumes.extend(ideal(0.8, 0.02, 800));
        let found = fit(&volumes, None, 20).unwrap();
        assert!((found.minimum / 0.02 - 1.0).abs() < 0.1 && (found.exponent - 0.8).abs() < 0.05, "{found:?}");
        assert_eq!(found.count + found.below, volumes.len());
    }

    #[test]
    fn too_few_or_equal_volumes_give_no_law() {
        assert_eq!(fit(&[1.0, 2.0, 3.0], Some(2.5), 2), None);
        assert_eq!(fit(&[2.0; 30], None, 10), None);
        assert_eq!(fit(&[], None, 10), None);
    }

    #[test]
    fn the_curve_counts_from_the_largest() {
        assert_eq!(curve(&[1.0, 2.0, 2.0, 5.0]), [(5.0, 1), (2.0, 3), (1.0, 4)]);
    }
}
