//! Empirical quantiles: type 7 of Hyndman and Fan (1996), linear between the order statistics; or the nearest of the values.

use rayon::prelude::*;

/// The quantile of level `q` (0 to 1) of finite values; `None` where there are none.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    of_sorted(&sorted, q)
}

/// The quantile of values already in ascending order.
pub fn of_sorted(sorted: &[f64], q: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let position = q.clamp(0.0, 1.0) * last as f64;
    let below = position.floor() as usize;
    let share = position - below as f64;
    let upper = sorted[(below + 1).min(last)];
    Some(sorted[below] + share * (upper - sorted[below]))
}

/// The median, found in linear time; the order of `values` changes.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let count = values.len();
    if count == 0 {
        return None;
    }
    let (below, upper, _) = values.select_nth_unstable_by(count / 2, f64::total_cmp);
    let upper = *upper;
    if count % 2 == 1 {
        return Some(upper);
    }
    let lower = below.iter().copied().max_by(f64::total_cmp)?;
    Some(0.5 * (lower + upper))
}

/// The value whose rank is nearest to a share `q` (0 to 1) of the finite values, in linear time; `None` where there are none.
pub fn nearest_rank(values: impl Iterator<Item = f32> + Clone, q: f64) -> Option<f64> {
    let counts = move |half: Half| Counts::of(values.clone(), half);
    Some(f64::from(select(counts, |count| ((count - 1) as f64 * q).round() as usize)?.0))
}

/// The greater of the middle values of the finite ones, and how many these are; `None` where there are none.
pub fn upper_median(values: &[f32]) -> Option<(f64, usize)> {
    let counts = |half: Half| {
        let parts = values.par_chunks(VALUES_AT_A_TIME).map(|values| Counts::of(values.iter().copied(), half));
        parts.reduce(Counts::none, Counts::and)
    };
    let (median, count) = select(counts, |count| count / 2)?;
    Some((f64::from(median), count))
}

/// Values that are one task.
const VALUES_AT_A_TIME: usize = 1 << 21;

/// The value of a rank (from 0) that depends on how many there are, and that number; goes through the values twice, each time by half of their bits.
fn select(counts: impl Fn(Half) -> Counts, rank: impl Fn(usize) -> usize) -> Option<(f32, usize)> {
    let first = counts(Half::Upper);
    let count = first.total();
    if count == 0 {
        return None;
    }
    let (upper, rank) = first.find(rank(count))?;
    let (lower, _) = counts(Half::LowerOf(upper)).find(rank)?;
    Some((of_ordered((upper << 16) | lower), count))
}

/// Bits in ascending order of the values: negative ones turned round, positive ones above them.
fn ordered_bits(value: f32) -> u32 {
    let bits = value.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | (1 << 31) }
}

/// The value that has such bits.
fn of_ordered(bits: u32) -> f32 {
    f32::from_bits(if bits >> 31 == 1 { bits & !(1 << 31) } else { !bits })
}

/// Which half of the bits values are counted by.
#[derive(Debug, Clone, Copy)]
enum Half {
    Upper,
    /// The lower one of those that have this upper one.
    LowerOf(u32),
}

/// How many values have each of the numbers of 16 bits.
struct Counts(Vec<usize>);

impl Counts {
    fn none() -> Self {
        Self(vec![0; 1 << 16])
    }

    /// Counts the finite values.
    fn of(values: impl Iterator<Item = f32>, half: Half) -> Self {
        let mut counts = Self::none();
        let bits = values.filter(|value| value.is_finite()).map(ordered_bits);
        match half {
            Half::Upper => bits.for_each(|bits| counts.0[(bits >> 16) as usize] += 1),
            Half::LowerOf(upper) => {
                bits.filter(|bits| bits >> 16 == upper).for_each(|bits| counts.0[(bits & 0xffff) as usize] += 1);
            }
        }
        counts
    }

    fn and(mut self, other: Self) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(count, more)| *count += more);
        self
    }

    fn total(&self) -> usize {
        self.0.iter().sum()
    }

    /// The number that the value of a rank has, and its rank among those that have the same.
    fn find(&self, rank: usize) -> Option<(u32, usize)> {
        let mut below = 0;
        for (number, count) in self.0.iter().enumerate() {
            if rank < below + count {
                return Some((number as u32, rank - below));
            }
            below += count;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::portable_math;
    use proptest::prelude::*;

    #[test]
    fn agrees_with_numpy_on_a_small_sample() {
        let values = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0];
        assert_eq!(quantile(&values, 0.0), Some(1.0));
        assert_eq!(quantile(&values, 0.5), Some(3.5));
        assert_eq!(quantile(&values, 0.95), Some(8.0));
        assert_eq!(quantile(&values, 1.0), Some(9.0));
        assert_eq!(quantile(&[], 0.5), None);
    }

    #[test]
    fn keeps_35_37_and_38_of_39_as_table_a1_does() {
        let values: Vec<f64> = (0..39).map(f64::from).collect();
        let kept = |q: f64| values.iter().filter(|v| **v <= quantile(&values, q).unwrap()).count();
        assert_eq!([kept(0.90), kept(0.95), kept(0.99)], [35, 37, 38]);
    }

    #[test]
    fn the_nearest_rank_skips_what_is_no_number() {
        let values = [3.0, f32::NAN, 1.0, 2.0, f32::INFINITY, 5.0, 4.0];
        assert_eq!(nearest_rank(values.into_iter(), 0.5), Some(3.0));
        assert_eq!(nearest_rank([f32::NAN].into_iter(), 0.5), None);
    }

    proptest! {
        #[test]
        fn the_median_is_the_half_quantile(values in prop::collection::vec(-1e3f64..1e3, 1..50)) {
            let half = quantile(&values, 0.5).unwrap();
            let found = median(&mut values.clone()).unwrap();
            prop_assert!((half - found).abs() <= 1e-12 * half.abs().max(1.0));
        }
    }

    proptest! {
        #[test]
        fn counting_finds_what_sorting_finds(values in prop::collection::vec(-3.0f64..3.0, 1..60), scale in -20i32..20, around in prop::sample::select(vec![0.0, 50.0])) {
            let scale = portable_math::exp(f64::from(scale));
            let values: Vec<f32> = values.iter().map(|value| (around + value * scale) as f32).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            prop_assert_eq!(upper_median(&values), Some((f64::from(sorted[sorted.len() / 2]), sorted.len())));
            prop_assert_eq!(nearest_rank(values.iter().copied(), 0.0), Some(f64::from(sorted[0])));
        }
    }

    #[test]
    fn no_values_have_no_rank() {
        assert_eq!(upper_median(&[f32::NAN]), None);
        assert_eq!(upper_median(&[f32::NAN, 2.0, -0.0, 0.0, f32::INFINITY]), Some((0.0, 3)));
        assert_eq!(nearest_rank([f32::NAN, 2.0, 1.0, f32::INFINITY].into_iter(), 1.0), Some(2.0));
    }
}
