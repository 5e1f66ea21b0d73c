//! Rates of many comparisons: pooled, averaged, and how far they would move had other epochs been drawn.

use rand::Rng;

use super::score::{Counts, f1};
use rockface_core::numerics::proportion::exact_interval;
use rockface_core::numerics::quantile;
use rockface_core::numerics::random::Key;

/// One number and its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The number; NaN where it has none.
    pub value: f64,
    /// The 2.5 % and 97.5 % quantiles over resamples; NaN where none has a value, and of a single epoch, which says nothing of others.
    pub ends: [f64; 2],
}

/// Precision, recall and F1.
pub type Rates = [Option<f64>; 3];

/// Rates of the counts of all epochs together.
pub fn pooled(epochs: &[Counts]) -> Rates {
    let sum = epochs.iter().fold(Counts::default(), |sum, epoch| sum.plus(epoch));
    [sum.precision(), sum.recall(), sum.f1()]
}

/// Means of the rates of the epochs that have them; F1 is that of the two means, 2 P R / (P + R).
pub fn averaged(epochs: &[Counts]) -> Rates {
    let [precision, recall] = [Counts::precision, Counts::recall].map(|rate| mean(epochs.iter().filter_map(rate)));
    [precision, recall, f1(precision, recall)]
}

/// The mean of the F1 of the epochs that have one.
pub fn mean_f1(epochs: &[Counts]) -> Option<f64> {
    mean(epochs.iter().filter_map(Counts::f1))
}

/// The mean of numbers; `None` where there are none.
pub fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    (count > 0.0).then(|| sum / count)
}

/// Draws of epochs with replacement, `resamples` times; equal for equal keys and numbers of epochs, so that detectors are
/// compared on the same draws.
pub fn draws(key: Key, epochs: usize, resamples: usize) -> Vec<Vec<usize>> {
    let mut generator = key.generator();
    let mut draw = |_| ((u64::from(generator.next_u32()) * epochs as u64) >> 32) as usize;
    (0..resamples).map(|_| (0..epochs).map(&mut draw).collect()).collect()
}

/// A number of the epochs, with its interval over the draws (percentile bootstrap, Efron 1979).
pub fn interval<T: Clone>(epochs: &[T], draws: &[Vec<usize>], number: impl Fn(&[T]) -> Option<f64>) -> Interval {
    let of = |draw: &Vec<usize>| number(&draw.iter().map(|place| epochs[*place].clone()).collect::<Vec<T>>());
    let several = if epochs.len() > 1 { draws } else { &[] };
    let mut drawn: Vec<f64> = several.iter().filter_map(of).collect();
    drawn.sort_by(f64::total_cmp);
    let end = |level: f64| quantile::of_sorted(&drawn, level).unwrap_or(f64::NAN);
    Interval { value: number(epochs).unwrap_or(f64::NAN), ends: [end(0.025), end(0.975)] }
}

/// Rates nearer than this to 0 or 1 have too narrow an interval over draws of epochs: where all epochs are alike, it has no width at all.
const NEAR_END: f64 = 0.05;

/// Precision, recall or F1, by its place in [`Rates`], with its interval over the draws; near 0 and 1, and where all draws are alike, it is
/// no narrower than that of the counts of all epochs together (Clopper and Pearson 1934; F1: that of the ends of both).
pub fn rate_interval(
    epochs: &[Counts],
    draws: &[Vec<usize>],
    place: usize,
    number: impl Fn(&[Counts]) -> Option<f64>,
) -> Interval {
    let found = interval(epochs, draws, number);
    let [low, high] = found.ends;
    let has_width = high - low > 1e-9;
    let is_near_end = found.value < NEAR_END || found.value > 1.0 - NEAR_END;
    if low.is_nan() || (has_width && !is_near_end) {
        return found;
    }
    let [exact_low, exact_high] = exact(epochs)[place].unwrap_or(found.ends);
    Interval { ends: [low.min(exact_low), high.max(exact_high)], ..found }
}

/// Exact intervals of precision, recall and F1 of all counts together, taken as independent.
fn exact(epochs: &[Counts]) -> [Option<[f64; 2]>; 3] {
    let sum = epochs.iter().fold(Counts::default(), |sum, epoch| sum.plus(epoch));
    let of = |hits: usize, others: usize| (hits + others > 0).then(|| exact_interval(hits, hits + others).into());
    let [precision, recall]: [Option<[f64; 2]>; 2] =
        [of(sum.true_positives, sum.false_positives), of(sum.found, sum.missed)];
    // Without a detection precision may be anything.
    let end = |end: usize| f1(Some(precision.unwrap_or([0.0, 1.0])[end]), Some(recall.unwrap_or([0.0, 1.0])[end]));
    let both = precision.or(recall).and_then(|_| Some([end(0)?, end(1)?]));
    [precision, recall, both]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_all_is_found_the_interval_is_that_of_the_counts() {
        let all = [epoch(3, 0, 0); 20];
        let draws = draws(Key([4; 32]), 20, 500);
        let recall = |epochs: &[Counts]| rate_interval(epochs, &draws, 1, |c| pooled(c)[1]);
        let found = recall(&all);
        // 60 of 60: 0.025^(1/60).
        assert!((found.ends[0] - 0.940_4).abs() < 1e-3 && found.ends[1] > 1.0 - 1e-12, "{found:?}");
        let f1 = rate_interval(&all, &draws, 2, mean_f1);
        assert!((f1.ends[0] - 0.940_4).abs() < 1e-3, "{f1:?}");
        let none = recall(&[epoch(0, 0, 3); 20]);
        assert!(none.ends[0].abs() < 1e-12 && (none.ends[1] - 0.059_6).abs() < 1e-3, "{none:?}");
        // In the middle it is that of the epochs, and of a single one there is none.
        let mut half = [epoch(1, 1, 1); 20];
        half[3] = epoch(2, 0, 0);
        let plain = interval(&half, &draws, |c| pooled(c)[1]);
        assert_eq!(recall(&half), plain);
        assert!(recall(&all[..1]).ends[0].is_nan());
    }

    fn epoch(true_positives: usize, false_positives: usize, missed: usize) -> Counts {
        Counts { true_positives, false_positives, found: true_positives, missed }
    }

    #[test]
    fn pooled_and_averaged_differ_as_they_should() {
        let epochs = [epoch(1, 0, 0), epoch(1, 3, 3), Counts { missed: 2, ..Counts::default() }];
        // Together 2 of 5 detections are true, and 2 of 7 changes are found.
        let [p, r, f] = pooled(&epochs).map(Option::unwrap);
        assert!((p - 0.4).abs() < 1e-12 && (r - 2.0 / 7.0).abs() < 1e-12 && (f - 1.0 / 3.0).abs() < 1e-12);
        // The last has no precision.
        let [p, r, f] = averaged(&epochs).map(Option::unwrap);
        assert!((p - 0.625).abs() < 1e-12 && (r - 1.25 / 3.0).abs() < 1e-12 && (f - 0.5).abs() < 1e-12);
        assert!((mean_f1(&epochs).unwrap() - 1.25 / 3.0).abs() < 1e-12);
        assert_eq!(averaged(&[]), [None; 3]);
    }

    #[test]
    fn the_interval_holds_the_spread_of_the_mean() {
        let epochs: Vec<f64> = (0..10).map(f64::from).collect();
        let draws = draws(Key([3; 32]), 10, 4000);
        assert!(draws.iter().flatten().all(|place| *place < 10));
        let found = interval(&epochs, &draws, |values| mean(values.iter().copied()));
        // Standard error of a mean of ten draws from 0 to 9: sqrt(8.25 / 10) = 0.908.
        assert!((found.value - 4.5).abs() < 1e-12);
        assert!((found.ends[0] - (4.5 - 1.78)).abs() < 0.2 && (found.ends[1] - (4.5 + 1.78)).abs() < 0.2, "{found:?}");
        assert!(interval(&[1.0], &[], |_| None).value.is_nan());
        let single = interval(&[1.0], &[vec![0]], |values| mean(values.iter().copied()));
        assert!(single.value > 0.9 && single.ends.iter().all(|end| end.is_nan()));
    }
}
