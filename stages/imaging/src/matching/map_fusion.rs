//! Robust fusion of several measurements of one quantity: the depths of a pixel from its pairs, or the elevations of a cell
//! from its images.
//!
//! The centre is the weighted median with weights `1 / sigma^2`. A value is rejected if its distance from the centre exceeds a
//! multiple of the larger of its sigma and the robust deviation (1.4826 times the median absolute deviation). The fused value
//! is the weighted mean or the weighted median of the others (paper 2.1.2, Algorithm 2 line 21).

use rockface_core::choice;
use rockface_core::numerics::simd::{Lanes, Number};

choice! {
    /// How values that agree become one.
    pub enum Averaging {
        /// Their mean, weighted by the inverse of their variances.
        Mean = "mean",
        /// Their weighted median: it follows no outlier, and is some 25 % noisier.
        Median = "median",
    }
}

/// A value with its expected standard deviation, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The value, metres.
    pub value_m: f64,
    /// Its expected standard deviation, metres; positive.
    pub sigma_m: f64,
    /// Weight in an average: `1 / sigma_m^2`.
    weight: f64,
}

impl Measured {
    /// A value and its expected standard deviation.
    #[inline]
    pub fn new(value_m: f64, sigma_m: f64) -> Self {
        Self { value_m, sigma_m, weight: 1.0 / (sigma_m * sigma_m) }
    }
}

/// How values are fused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// How the values that are not rejected are averaged.
    pub averaging: Averaging,
    /// A value is rejected beyond this many robust deviations, or sigmas of the value where those are larger.
    pub rejection: f64,
    /// Distance from the centre within which no value is rejected, metres.
    pub tolerance_m: f64,
    /// Fewest values that must remain.
    pub minimum: usize,
}

/// The result of a fusion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fused {
    /// The fused value, with the standard deviation of a mean of independent errors.
    pub value: Measured,
    /// How many values were not rejected.
    pub count: usize,
}

/// To be multiplied with the median absolute deviation: the standard deviation of normal errors.
const ROBUST: f64 = 1.482_602_218_505_602;

/// Fuses values, and reorders them. `None` where too few remain.
pub fn fuse(values: &mut [Measured], rule: &Rule) -> Option<Fused> {
    if values.len() < rule.minimum.max(1) {
        return None;
    }
    if let [only] = values {
        return Some(Fused { value: *only, count: 1 });
    }
    values.sort_unstable_by(|a, b| a.value_m.total_cmp(&b.value_m).then(a.sigma_m.total_cmp(&b.sigma_m)));
    let centre_m = weighted_median(values);
    let robust_m = rule.rejection * ROBUST * middle_deviation(values, centre_m);
    let mut count = 0;
    for i in 0..values.len() {
        let allowed_m = robust_m.max(rule.rejection * values[i].sigma_m).max(rule.tolerance_m);
        if (values[i].value_m - centre_m).abs() <= allowed_m {
            values[count] = values[i];
            count += 1;
        }
    }
    let kept = &values[..count];
    if count < rule.minimum.max(1) {
        return None;
    }
    let weight: f64 = kept.iter().map(|v| v.weight).sum();
    let value_m = match rule.averaging {
        Averaging::Mean => centre_m + kept.iter().map(|v| v.weight * (v.value_m - centre_m)).sum::<f64>() / weight,
        Averaging::Median => weighted_median(kept),
    };
    Some(Fused { value: Measured { value_m, sigma_m: 1.0 / weight.sqrt(), weight }, count })
}

/// Most values of a pixel that are fused together with those of other pixels.
pub const MOST_TOGETHER: usize = 8;

/// Values of several pixels, those of one pixel in the same lane.
#[derive(Debug, Clone)]
pub struct Together {
    /// Values, metres; the first `len` are given, infinite where a pixel has none.
    values_m: [Lanes; MOST_TOGETHER],
    /// Their expected standard deviations, metres; infinite where a pixel has none.
    sigmas_m: [Lanes; MOST_TOGETHER],
    len: usize,
}

/// What the fusion of several pixels results in.
#[derive(Debug, Clone)]
pub struct FusedTogether {
    /// Fused values, metres; NaN where too few values remain.
    pub values_m: Lanes,
    /// Standard deviations of means of independent errors, metres.
    pub sigmas_m: Lanes,
    /// How many values were not rejected.
    pub counts: Lanes,
    /// How many values there were.
    pub given: Lanes,
}

impl Default for Together {
    /// No values yet.
    #[inline(always)]
    fn default() -> Self {
        let none = [Lanes::all(f64::INFINITY); MOST_TOGETHER];
        Self { values_m: none, sigmas_m: none, len: 0 }
    }
}

impl Together {
    /// Adds one value a pixel with its expected standard deviation, NaN where a pixel has none.
    #[inline(always)]
    pub fn push(&mut self, values_m: Lanes, sigmas_m: Lanes) {
        let none = Lanes::all(f64::INFINITY);
        self.values_m[self.len] = values_m.choose(f64::is_nan, none, values_m);
        self.sigmas_m[self.len] = values_m.choose(f64::is_nan, none, sigmas_m);
        self.len += 1;
    }

    /// Fuses the values of every pixel by their weighted mean: the bits of [`fuse`].
    #[inline(always)]
    pub fn fuse(mut self, rule: &Rule) -> FusedTogether {
        self.sort();
        let len = self.len;
        let (values, sigmas) = (&self.values_m[..len], &self.sigmas_m[..len]);
        let zero = Lanes::all(0.0);
        let mut weights = [zero; MOST_TOGETHER];
        let (mut total, mut given) = (zero, zero);
        for (weight, (value, sigma)) in weights.iter_mut().zip(values.iter().zip(sigmas)) {
            *weight = Lanes::all(1.0) / (*sigma * *sigma);
            total = total + *weight;
            given = given + value.map(|value| if value < f64::INFINITY { 1.0 } else { 0.0 });
        }
        let centre = self.medians(&weights[..len], total * 0.5);
        let mut deviations = [zero; MOST_TOGETHER];
        for (deviation, value) in deviations.iter_mut().zip(values) {
            *deviation = (*value - centre).map(f64::abs);
        }
        let robust = lower_medians(deviations, len, given) * (rule.rejection * ROBUST);
        let (mut weight, mut shift, mut counts) = (zero, zero, zero);
        for i in 0..len {
            let allowed = robust.at_least(sigmas[i] * rule.rejection).at_least(Lanes::all(rule.tolerance_m));
            let is_kept = Lanes::of(|lane| {
                let fits = values[i][lane] < f64::INFINITY && deviations[i][lane] <= allowed[lane];
                if fits { 1.0 } else { 0.0 }
            });
            let kept = |lanes: Lanes| is_kept.choose(|kept| kept > 0.0, lanes, zero);
            weight = weight + kept(weights[i]);
            shift = shift + kept(weights[i] * (values[i] - centre));
            counts = counts + is_kept;
        }
        let alone = |only: Lanes, others: Lanes| given.choose(|given| given <= 1.0, only, others);
        let values_m = alone(values[0], centre + shift / weight);
        let sigmas_m = alone(sigmas[0], Lanes::all(1.0) / weight.sqrt());
        let counts = alone(Lanes::all(1.0), counts);
        let least = rule.minimum.max(1) as f64;
        let values_m = given.with(counts, f64::min).choose(|count| count < least, Lanes::NONE, values_m);
        FusedTogether { values_m, sigmas_m, counts, given }
    }

    /// Sorts the values of every pixel, equal ones by their deviation.
    #[inline(always)]
    fn sort(&mut self) {
        for end in 1..self.len {
            for i in (0..end).rev() {
                let [a, b] = [self.values_m[i], self.values_m[i + 1]];
                let [s, t] = [self.sigmas_m[i], self.sigmas_m[i + 1]];
                let swaps = Lanes::of(|lane| {
                    let swap = a[lane] > b[lane] || (a[lane] >= b[lane] && s[lane] > t[lane]);
                    if swap { 1.0 } else { 0.0 }
                });
                let pick = |yes: Lanes, no: Lanes| swaps.choose(|swap| swap > 0.0, yes, no);
                [self.values_m[i], self.values_m[i + 1]] = [pick(b, a), pick(a, b)];
                [self.sigmas_m[i], self.sigmas_m[i + 1]] = [pick(t, s), pick(s, t)];
            }
        }
    }

    /// The weighted medians of sorted values; as `weighted_median`.
    #[inline(always)]
    fn medians(&self, weights: &[Lanes], half: Lanes) -> Lanes {
        let mut passed = Lanes::all(0.0);
        let (mut median, mut last) = (Lanes::NONE, Lanes::NONE);
        for (i, weight) in weights.iter().enumerate() {
            let value = self.values_m[i];
            let next = if i + 1 < weights.len() { self.values_m[i + 1] } else { Lanes::all(f64::INFINITY) };
            passed = passed + *weight;
            let between = (value + next) * 0.5;
            median = Lanes::of(|lane| {
                let is_split = passed[lane] >= half[lane] && next[lane] < f64::INFINITY;
                let here = if passed[lane] > half[lane] {
                    value[lane]
                } else if is_split {
                    between[lane]
                } else {
                    f64::NAN
                };
                if median[lane].is_nan() { here } else { median[lane] }
            });
            last = value.choose(|value| value < f64::INFINITY, value, last);
        }
        median.choose(f64::is_nan, last, median)
    }
}

/// The lower median of the first `given` of each lane, of unsorted numbers that are infinite where there is none.
#[inline(always)]
fn lower_medians(mut numbers: [Lanes; MOST_TOGETHER], len: usize, given: Lanes) -> Lanes {
    let mut median = Lanes::NONE;
    // Sorted only up to the middle.
    for i in 0..len.div_ceil(2) {
        for other in i + 1..len {
            let [a, b] = [numbers[i], numbers[other]];
            numbers[i] = a.with(b, |a, b| if a < b { a } else { b });
            numbers[other] = a.with(b, |a, b| if a < b { b } else { a });
        }
        let [odd, even] = [2 * i + 1, 2 * i + 2].map(|count| count as f64);
        let number = numbers[i];
        median = Lanes::of(|lane| if given[lane] >= odd && given[lane] <= even { number[lane] } else { median[lane] });
    }
    median
}

/// The weighted median of sorted values; the mean of two where the weight is split exactly in half.
fn weighted_median(sorted: &[Measured]) -> f64 {
    let half = 0.5 * sorted.iter().map(|v| v.weight).sum::<f64>();
    let mut passed = 0.0;
    for (i, value) in sorted.iter().enumerate() {
        passed += value.weight;
        if passed > half {
            return value.value_m;
        }
        if passed >= half && i + 1 < sorted.len() {
            return 0.5 * (value.value_m + sorted[i + 1].value_m);
        }
    }
    sorted[sorted.len() - 1].value_m
}

/// Median of the absolute deviations of sorted values (the lower one of an even number), found from both ends inwards.
fn middle_deviation(sorted: &[Measured], centre_m: f64) -> f64 {
    let (mut low, mut high) = (0, sorted.len() - 1);
    // The largest deviation is at one of the two ends; remove half of them.
    for _ in 0..sorted.len() / 2 {
        if centre_m - sorted[low].value_m >= sorted[high].value_m - centre_m { low += 1 } else { high -= 1 }
    }
    (centre_m - sorted[low].value_m).abs().max((sorted[high].value_m - centre_m).abs())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rockface_core::numerics::random::Key;
    use rockface_core::numerics::simd::{LANES, Work, vectorised};

    const RULE: Rule = Rule { averaging: Averaging::Mean, rejection: 3.0, tolerance_m: 0.0, minimum: 1 };

    fn measured(values: &[(f64, f64)]) -> Vec<Measured> {
        values.iter().map(|(value_m, sigma_m)| Measured::new(*value_m, *sigma_m)).collect()
    }

    fn fused(values: &[(f64, f64)], rule: &Rule) -> Option<(f64, usize)> {
        fuse(&mut measured(values), rule).map(|f| (f.value.value_m, f.count))
    }

    #[test]
    fn one_value_passes_as_it_is_and_two_are_weighted() {
        assert_eq!(fused(&[(0.1, 0.3)], &RULE), Some((0.1, 1)));
        let (mean, count) = fused(&[(1.0, 0.1), (1.2, 0.2)], &RULE).unwrap();
        assert!((mean - 1.04).abs() < 1e-12 && count == 2);
        let sigma = fuse(&mut measured(&[(1.0, 0.1), (1.2, 0.1)]), &RULE).unwrap().value.sigma_m;
        assert!((sigma - 0.1 / 2f64.sqrt()).abs() < 1e-15);
        assert_eq!(fused(&[(1.0, 0.1)], &Rule { minimum: 2, ..RULE }), None);
        assert_eq!(fused(&[], &RULE), None);
    }

    struct All<'a>(&'a [Vec<(f64, f64)>], usize, &'a Rule);

    impl Work for All<'_> {
        type Output = FusedTogether;

        #[inline(always)]
        fn run(self) -> FusedTogether {
            let mut together = Together::default();
            for i in 0..self.1 {
                let part = |of: fn(&(f64, f64)) -> f64| Lanes::of(|lane| self.0[lane].get(i).map_or(f64::NAN, of));
                together.push(part(|v| v.0), part(|v| v.1));
            }
            together.fuse(self.2)
        }
    }

    proptest! {
        #[test]
        fn pixels_together_have_the_bits_of_each_alone(
            pixels in prop::collection::vec(prop::collection::vec((0u8..40, 1u8..5, prop::bool::weighted(0.1)), 0..=MOST_TOGETHER), LANES),
            minimum in 0usize..4, tolerance_m in prop::sample::select(vec![0.0, 0.02]),
        ) {
            let value = |(value, sigma, is_far): &(u8, u8, bool)| {
                (20.0 + f64::from(*value) / 640.0 + if *is_far { 5.0 } else { 0.0 }, f64::from(*sigma) * 0.01)
            };
            let pixels: Vec<Vec<(f64, f64)>> = pixels.iter().map(|pixel| pixel.iter().map(value).collect()).collect();
            let rule = Rule { tolerance_m, minimum, ..RULE };
            let most = pixels.iter().map(Vec::len).max().unwrap_or(0).max(1);
            let together = vectorised(All(&pixels, most, &rule));
            for (lane, pixel) in pixels.iter().enumerate() {
                let alone = fuse(&mut measured(pixel), &rule);
                let found = (!together.values_m[lane].is_nan()).then(|| {
                    let [value_m, sigma_m] = [together.values_m[lane], together.sigmas_m[lane]];
                    (value_m.to_bits(), sigma_m.to_bits(), together.counts[lane] as usize)
                });
                let alone = alone.map(|f| (f.value.value_m.to_bits(), f.value.sigma_m.to_bits(), f.count));
                prop_assert_eq!(found, alone);
                prop_assert_eq!(together.given[lane] as usize, pixel.len());
            }
        }
    }

    #[test]
    fn a_blunder_is_rejected_in_any_order() {
        let values = [(1.0, 0.01), (9.0, 0.01), (1.01, 0.01), (0.99, 0.01)];
        let (mean, count) = fused(&values, &RULE).unwrap();
        assert!((mean - 1.0).abs() < 1e-12 && count == 3, "{mean} {count}");
        let turned: Vec<_> = values.iter().rev().copied().collect();
        assert_eq!(fused(&turned, &RULE).unwrap(), (mean, count));
        assert_eq!(fused(&values, &Rule { tolerance_m: 10.0, ..RULE }).unwrap().1, 4);
        assert_eq!(fused(&values, &Rule { minimum: 4, ..RULE }), None);
    }

    #[test]
    fn the_weighted_median_follows_the_weight() {
        let rule = Rule { averaging: Averaging::Median, rejection: 100.0, ..RULE };
        assert_eq!(fused(&[(1.0, 1.0), (2.0, 1.0), (5.0, 1.0)], &rule), Some((2.0, 3)));
        assert_eq!(fused(&[(1.0, 1.0), (2.0, 1.0)], &rule), Some((1.5, 2)));
        assert_eq!(fused(&[(1.0, 0.1), (2.0, 1.0), (3.0, 1.0)], &rule), Some((1.0, 3)));
    }

    #[test]
    fn the_median_of_deviations_is_the_textbooks() {
        let field = Key([1; 32]).field();
        for n in 1..20 {
            let mut values: Vec<f64> = (0..n).map(|i| field.normal(i, n)).collect();
            values.sort_by(f64::total_cmp);
            let centre = 0.3;
            let mut deviations: Vec<f64> = values.iter().map(|v| (v - centre).abs()).collect();
            deviations.sort_by(f64::total_cmp);
            let sorted = measured(&values.iter().map(|v| (*v, 1.0)).collect::<Vec<_>>());
            let expected = deviations[(n as usize - 1) / 2];
            assert!((middle_deviation(&sorted, centre) - expected).abs() < 1e-15, "{n}");
        }
    }

    #[test]
    fn four_pairs_halve_the_noise() {
        let field = Key([7; 32]).field();
        let mut squares = 0.0;
        for i in 0..20_000 {
            let draw = |k: i32| (0.02 * field.normal(4 * i + k, 0), 0.02);
            let (mean, _) = fused(&[draw(0), draw(1), draw(2), draw(3)], &RULE).unwrap();
            squares += mean * mean;
        }
        let ratio = (squares / 20_000.0).sqrt() / 0.01;
        // Rejection of a few good values raises the noise by 2 %.
        assert!((ratio - 1.02).abs() < 0.03, "{ratio}");
    }
}
