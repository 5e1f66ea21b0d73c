//! Magnitude and frequency: the power law of the largest volumes by maximum likelihood, and the curve of all of them.

use rockface_core::numerics::portable_math;

/// A power law N(>= V) = n (V / V_min)^-b of the volumes from a smallest one up, or up to a largest one
/// N(>= V) = n ((V / V_min)^-b - R^-b) / (1 - R^-b) with `R = V_max / V_min`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PowerLaw {
    /// Exponent b of the cumulative curve.
    pub exponent: f64,
    /// Its standard error: b/sqrt(n) without a largest volume.
    pub standard_error: f64,
    /// Smallest volume the law holds for, in the unit of the volumes.
    pub minimum: f64,
    /// Largest volume there can be, where there is one.
    pub maximum: Option<f64>,
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
        let share = |volume: f64| portable_math::pow(volume / self.minimum, -self.exponent);
        let above = self.maximum.map_or(0.0, share);
        self.count as f64 * (share(volume) - above) / (1.0 - above)
    }
}

/// Fits the law to the volumes from `minimum` up; without it, from the volume at which the law lies nearest to the rest,
/// which must be at least `least` volumes.
///
/// `volumes` are positive, ascending and at most `maximum`, where volumes can be no larger. `None` where fewer than `least` (or 2) volumes are
/// left, or all are equal, or where up to the maximum large volumes are as frequent as small ones.
///
/// # References
/// Clauset, A., Shalizi, C. R., Newman, M. E. J. (2009), Power-law distributions in empirical data, SIAM Review 51,
/// 661-703, equations 3.1 and 3.9; their exponent is b + 1. With a maximum: Aban, I. B., Meerschaert, M. M., Panorska, A. K. (2006),
/// Parameter estimation for the truncated Pareto distribution, Journal of the American Statistical Association 101, 270-277.
pub fn fit(volumes: &[f64], minimum: Option<f64>, maximum: Option<f64>, least: usize) -> Option<PowerLaw> {
    let logarithms: Vec<f64> = volumes.iter().map(|volume| portable_math::log(*volume)).collect();
    let least = least.max(2);
    let starts = (0..volumes.len()).filter(|i| *i == 0 || volumes[i - 1] < volumes[*i]);
    let starts: Vec<usize> = match minimum {
        Some(minimum) => vec![volumes.partition_point(|volume| *volume < minimum)],
        None => starts.collect(),
    };
    let fits = starts.into_iter().filter(|start| volumes.len() - start >= least).filter_map(|start| {
        let from = minimum.unwrap_or(volumes[start]);
        from_a_volume(&logarithms, start, from, maximum)
    });
    fits.reduce(|best, next| if next.distance < best.distance { next } else { best })
}

fn from_a_volume(logarithms: &[f64], start: usize, minimum: f64, maximum: Option<f64>) -> Option<PowerLaw> {
    let origin = portable_math::log(minimum);
    let tail = &logarithms[start..];
    let count = tail.len() as f64;
    let sum = tail.iter().fold(0.0, |sum, logarithm| sum + (logarithm - origin));
    if sum <= 0.0 {
        return None;
    }
    let span = maximum.map(|maximum| portable_math::log(maximum) - origin);
    let exponent = span.map_or(Some(count / sum), |span| bounded_exponent(sum / count, span))?;
    // What the law without a maximum has above it.
    let above = span.map_or(0.0, |span| portable_math::exp(-exponent * span));
    let mut distance = 0.0f64;
    for (place, logarithm) in tail.iter().enumerate() {
        let law = (1.0 - portable_math::exp(-exponent * (logarithm - origin))) / (1.0 - above);
        let (before, after) = (place as f64 / count, (place + 1) as f64 / count);
        distance = distance.max((law - before).abs()).max((after - law).abs());
    }
    // The information of one volume is that of the exponential law of its logarithm, less what the maximum takes.
    let lost = span.map_or(0.0, |span| span * span * above / ((1.0 - above) * (1.0 - above)));
    let standard_error = 1.0 / (count * (1.0 / (exponent * exponent) - lost)).sqrt();
    Some(PowerLaw { exponent, standard_error, minimum, maximum, count: tail.len(), below: start, distance })
}

/// The least exponent that is looked for: below, volumes are spread over their logarithms evenly, which is no law.
const LEAST_EXPONENT: f64 = 1e-3;
/// Halvings of the range of an exponent: to its last digit.
const HALVINGS: usize = 80;

/// The exponent at which logarithms of volumes up to a span have this mean: 1 / b - span / (exp(b span) - 1), which falls as b grows.
fn bounded_exponent(mean: f64, span: f64) -> Option<f64> {
    let mean_of = |b: f64| 1.0 / b - span / (portable_math::exp(b * span) - 1.0);
    // Without a maximum the mean is larger.
    let (mut low, mut high) = (LEAST_EXPONENT, 1.0 / mean);
    if mean <= 0.0 || mean_of(low) <= mean {
        return None;
    }
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if mean_of(middle) > mean { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
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
            let found = fit(&ideal(exponent, 0.02, 4000), Some(0.02), None, 10).unwrap();
            assert!((found.exponent / exponent - 1.0).abs() < 2e-3, "{found:?}");
            assert!((found.standard_error - found.exponent / 4000f64.sqrt()).abs() < 1e-12);
            assert!(found.distance < 2e-3 && (found.number_from(0.02) - 4000.0).abs() < 1e-9);
        }
    }

    #[test]
    fn volumes_with_a_largest_one_have_the_exponent_they_were_drawn_with() {
        // Quantiles at the middles of equal shares, up to a thousand times the smallest volume.
        for exponent in [0.3, 0.6, 1.4] {
            let above = portable_math::pow(1000.0, -exponent);
            let share = |i: usize| 1.0 - (1.0 - above) * (i as f64 + 0.5) / 4000.0;
            let volumes: Vec<f64> = (0..4000).map(|i| 0.02 * portable_math::pow(share(i), -1.0 / exponent)).collect();
            let found = fit(&volumes, Some(0.02), Some(20.0), 10).unwrap();
            assert!((found.exponent / exponent - 1.0).abs() < 3e-3, "{found:?}");
            assert!(found.distance < 2e-3 && (found.number_from(0.02) - 4000.0).abs() < 1e-9);
            assert!(found.number_from(20.0).abs() < 1e-9 && found.standard_error > found.exponent / 4000f64.sqrt());
            // Taken to have none, the law falls too steeply.
            assert!(fit(&volumes, Some(0.02), None, 10).unwrap().exponent > 1.0001 * found.exponent);
        }
        // As frequent from 1 to 2 as from 500 to 1000: no law.
        let even: Vec<f64> = (0..100).map(|i| portable_math::pow(1000.0, (f64::from(i) + 0.5) / 100.0)).collect();
        assert_eq!(fit(&even, Some(1.0), Some(1000.0), 10).filter(|law| law.exponent > 0.02), None);
    }

    #[test]
    fn the_published_formula_by_hand() {
        // b = n / sum ln(V / V_min) with V = 1, e, e^2: 3 / 3.
        let volumes = [1.0, std::f64::consts::E, std::f64::consts::E * std::f64::consts::E];
        let found = fit(&volumes, Some(1.0), None, 2).unwrap();
        assert!((found.exponent - 1.0).abs() < 1e-14 && found.below == 0);
        // Law: 0, 0.632, 0.865 against the steps 0, 1/3, 2/3, 1: farthest at the first.
        assert!((found.distance - 1.0 / 3.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn a_roll_over_is_left_below_the_smallest_volume() {
        let mut volumes: Vec<f64> = (1..400).map(|i| 0.02 * (f64::from(i) / 400.0).sqrt()).collect();
        volumes.extend(ideal(0.8, 0.02, 800));
        let found = fit(&volumes, None, None, 20).unwrap();
        assert!((found.minimum / 0.02 - 1.0).abs() < 0.1 && (found.exponent - 0.8).abs() < 0.05, "{found:?}");
        assert_eq!(found.count + found.below, volumes.len());
    }

    #[test]
    fn too_few_or_equal_volumes_give_no_law() {
        assert_eq!(fit(&[1.0, 2.0, 3.0], Some(2.5), None, 2), None);
        assert_eq!(fit(&[2.0; 30], None, None, 10), None);
        assert_eq!(fit(&[], None, None, 10), None);
    }

    #[test]
    fn the_curve_counts_from_the_largest() {
        assert_eq!(curve(&[1.0, 2.0, 2.0, 5.0]), [(5.0, 1), (2.0, 3), (1.0, 4)]);
    }
}
