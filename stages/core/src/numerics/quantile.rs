//! Empirical quantiles: type 7 of Hyndman and Fan (1996), linear between the order statistics; or the nearest of the values.

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
    let finite = values.filter(|value| value.is_finite()).map(f64::from);
    Some(select(finite, |count| ((count - 1) as f64 * q).round() as usize)?.0)
}

/// The greater of the middle values, and how many values there are; `None` where there are none.
pub fn upper_median(values: impl Iterator<Item = f64> + Clone) -> Option<(f64, usize)> {
    select(values, |count| count / 2)
}

/// The value of a rank (from 0) that depends on how many there are, and that number; goes through the values three times, each time
/// by further bits, and copies only those that agree in the first 32.
fn select(values: impl Iterator<Item = f64> + Clone, rank: impl Fn(usize) -> usize) -> Option<(f64, usize)> {
    let first = Counts::of(values.clone(), |bits| Some(bits >> 48));
    let count = first.total();
    if count == 0 {
        return None;
    }
    let (upper, rank) = first.find(rank(count))?;
    let second = Counts::of(values.clone(), |bits| (bits >> 48 == upper).then_some(bits >> 32));
    let (lower, rank) = second.find(rank)?;
    let wanted = (upper << 16) | lower;
    let mut alike: Vec<f64> = Vec::with_capacity(second.0[lower as usize]);
    alike.extend(values.filter(|value| ordered_bits(*value) >> 32 == wanted));
    Some((*alike.select_nth_unstable_by(rank, f64::total_cmp).1, count))
}

/// Bits in ascending order of the values: negative ones turned round, positive ones above them.
fn ordered_bits(value: f64) -> u64 {
    let bits = value.to_bits();
    if bits >> 63 == 1 { !bits } else { bits | (1 << 63) }
}

/// How many values have each of the numbers of 16 bits.
struct Counts(Vec<usize>);

impl Counts {
    /// Counts values by the last 16 bits of what their bits give, where they give something.
    fn of(values: impl Iterator<Item = f64>, number: impl Fn(u64) -> Option<u64>) -> Self {
        let mut counts = vec![0; 1 << 16];
        values
            .filter_map(|value| number(ordered_bits(value)))
            .for_each(|number| counts[(number & 0xffff) as usize] += 1);
        Self(counts)
    }

    fn total(&self) -> usize {
        self.0.iter().sum()
    }

    /// The number that the value of a rank has, and its rank among those that have the same.
    fn find(&self, rank: usize) -> Option<(u64, usize)> {
        let mut below = 0;
        for (number, count) in self.0.iter().enumerate() {
            if rank < below + count {
                return Some((number as u64, rank - below));
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
            let values: Vec<f64> = values.iter().map(|value| around + value * scale).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            prop_assert_eq!(upper_median(values.iter().copied()), Some((sorted[sorted.len() / 2], sorted.len())));
        }
    }

    #[test]
    fn no_values_have_no_rank() {
        assert_eq!(upper_median(std::iter::empty()), None);
        assert_eq!(nearest_rank([f32::NAN, 2.0, 1.0, f32::INFINITY].into_iter(), 1.0), Some(2.0));
    }
}
