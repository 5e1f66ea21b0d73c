//! The depths that several pairs give the pixels of a row, fused many pixels at a time: the bits of [`fuse`] of each pixel.

use rockface_core::numerics::simd::{LANES, Lanes, Work, vectorised};

use rockface_core::numerics::marginal::NORMAL_MAD;
use rockface_raster::robust_mean::{Averaging, Fused, Measured, Rule, fuse};

/// Pixels that are fused together: their values stay in the fastest memory.
const BLOCK: usize = 64;

/// Pairs that see a block, beyond which its pixels are fused one by one: ranking in lanes compares every two depths of a pixel.
const MOST_RANKS: usize = 32;

/// One number for each pixel of a block.
type Numbers = [f64; BLOCK];

/// What one pair says of the pixels of a row.
#[derive(Clone)]
pub struct PairRow {
    /// Depths, metres; NaN where there is none.
    depth_m: Vec<f64>,
    /// Their expected standard deviations, metres.
    sigma_m: Vec<f64>,
}

impl PairRow {
    /// A row of some pixels without depths.
    pub fn new(width: usize) -> Self {
        Self { depth_m: vec![f64::NAN; width], sigma_m: vec![f64::NAN; width] }
    }

    /// Takes all depths away.
    pub fn clear(&mut self) {
        self.depth_m.fill(f64::NAN);
    }

    /// Sets the depth of a pixel and its expected standard deviation, metres.
    pub fn set(&mut self, column: usize, depth_m: f64, sigma_m: f64) {
        (self.depth_m[column], self.sigma_m[column]) = (depth_m, sigma_m);
    }

    /// Sets those of neighbouring pixels from `first` on.
    #[inline(always)]
    pub fn set_lanes(&mut self, first: usize, depth_m: Lanes, sigma_m: Lanes) {
        self.depth_m[first..first + LANES].copy_from_slice(&depth_m.each());
        self.sigma_m[first..first + LANES].copy_from_slice(&sigma_m.each());
    }
}

/// The depths of some pixels by rank; where a pixel has fewer depths than there are pairs, its last ones are infinite and without weight.
#[derive(Clone)]
struct Ranked {
    depth_m: Numbers,
    sigma_m: Numbers,
    weight: Numbers,
    /// Distance from the centre, metres.
    distance_m: Numbers,
    /// The distances by rank of their own.
    sorted_m: Numbers,
}

impl Ranked {
    const NONE: Self = Self {
        depth_m: [f64::INFINITY; BLOCK],
        sigma_m: [0.0; BLOCK],
        weight: [0.0; BLOCK],
        distance_m: [0.0; BLOCK],
        sorted_m: [0.0; BLOCK],
    };
}

/// Fuses the depths of rows by one rule.
pub struct RowFusion {
    rule: Rule,
    ranks: Vec<Ranked>,
    fused: FusedBlock,
    of_pixel: Vec<Measured>,
}

/// What some pixels come to.
struct FusedBlock {
    /// How many depths were given.
    given: Numbers,
    /// How many of them were averaged.
    kept: Numbers,
    value_m: Numbers,
    sigma_m: Numbers,
    weight: Numbers,
}

impl RowFusion {
    /// Fuses the depths of so many pairs.
    pub fn new(rule: Rule, pairs: usize) -> Self {
        let none = [0.0; BLOCK];
        let fused = FusedBlock { given: none, kept: none, value_m: none, sigma_m: none, weight: none };
        Self { rule, ranks: vec![Ranked::NONE; pairs], fused, of_pixel: Vec::with_capacity(pairs) }
    }

    /// Shows `take` every pixel that has a depth, from left to right: its column, how many depths it has, and what they come to; `None` where
    /// too few agree.
    pub fn fuse_row(&mut self, pairs: &[PairRow], mut take: impl FnMut(usize, usize, Option<Fused>)) {
        let width = pairs.first().map_or(0, |pair| pair.depth_m.len());
        for first in (0..width).step_by(BLOCK) {
            let count = BLOCK.min(width - first);
            vectorised(FuseBlock {
                pairs,
                first,
                count,
                rule: self.rule,
                ranks: &mut self.ranks,
                fused: &mut self.fused,
            });
            for pixel in 0..count {
                if self.fused.given[pixel] == 0.0 {
                    continue;
                }
                let fused =
                    if self.is_regular(pixel) { self.of_block(pixel) } else { self.one_by_one(pairs, first + pixel) };
                take(first + pixel, self.fused.given[pixel] as usize, fused);
            }
        }
    }

    /// Whether the block says what a pixel comes to. Medians look at one weight after the other, and what weights without a finite sum
    /// mean is left to what fuses single pixels.
    fn is_regular(&self, pixel: usize) -> bool {
        let FusedBlock { given, weight, .. } = &self.fused;
        let is_finite = weight[pixel] > 0.0 && weight[pixel] < f64::INFINITY;
        is_finite && (self.rule.averaging == Averaging::Mean || given[pixel] <= 1.0)
    }

    /// What a pixel of the block comes to.
    fn of_block(&self, pixel: usize) -> Option<Fused> {
        let FusedBlock { given, kept, value_m, sigma_m, weight } = &self.fused;
        let count = kept[pixel] as usize;
        let is_enough = count.min(given[pixel] as usize) >= self.rule.minimum.max(1);
        let value = Measured::weighted(value_m[pixel], sigma_m[pixel], weight[pixel]);
        is_enough.then_some(Fused { value, count })
    }

    fn one_by_one(&mut self, pairs: &[PairRow], column: usize) -> Option<Fused> {
        self.of_pixel.clear();
        let given = pairs.iter().filter(|pair| !pair.depth_m[column].is_nan());
        self.of_pixel.extend(given.map(|pair| Measured::new(pair.depth_m[column], pair.sigma_m[column])));
        fuse(&mut self.of_pixel, &self.rule)
    }
}

/// Fuses the depths of a block of pixels.
struct FuseBlock<'a> {
    pairs: &'a [PairRow],
    /// The first column of the block.
    first: usize,
    /// How many pixels it has.
    count: usize,
    rule: Rule,
    ranks: &'a mut [Ranked],
    fused: &'a mut FusedBlock,
}

impl Work for FuseBlock<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pairs, first, count, rule, ranks, fused } = self;
        fused.given = [0.0; BLOCK];
        let mut seen_by = 0;
        for pair in pairs {
            let (depth_m, sigma_m) = (&pair.depth_m[first..first + count], &pair.sigma_m[first..first + count]);
            // A pair that sees none of the pixels leaves its place to the next.
            seen_by += usize::from(enter(depth_m, sigma_m, &mut ranks[seen_by], &mut fused.given));
        }
        if seen_by > MOST_RANKS {
            // No weight: left to what fuses single pixels.
            fused.weight = [0.0; BLOCK];
            return;
        }
        let ranks = &mut ranks[..seen_by];
        for place in 0..ranks.len() {
            if let Some((least, others)) = ranks[place..].split_first_mut() {
                for other in others {
                    order(least, other);
                }
            }
        }
        let mut total = [0.0; BLOCK];
        for rank in &mut *ranks {
            weigh(rank, &mut total);
        }
        let centre_m = weighted_median(ranks, &total);
        for rank in &mut *ranks {
            measure(rank, &centre_m);
        }
        let middle_m = middle_distance(ranks, &fused.given);
        reject_and_average(ranks, &rule, &centre_m, &middle_m, fused);
        // A single depth is what it is, and its weight needs no sum.
        if let Some(only) = ranks.first() {
            for i in 0..BLOCK {
                let is_single = fused.given[i] <= 1.0;
                fused.value_m[i] = if is_single { only.depth_m[i] } else { fused.value_m[i] };
                fused.sigma_m[i] = if is_single { only.sigma_m[i] } else { fused.sigma_m[i] };
                fused.kept[i] = if is_single { 1.0 } else { fused.kept[i] };
                fused.weight[i] = if is_single { only.weight[i] } else { fused.weight[i] };
            }
        }
    }
}

/// Enters the depths of one pair, and counts them; whether there are any.
#[inline(always)]
fn enter(depth_m: &[f64], sigma_m: &[f64], rank: &mut Ranked, given: &mut Numbers) -> bool {
    let mut is_any = false;
    rank.depth_m[depth_m.len()..].fill(f64::INFINITY);
    for (i, (depth_m, sigma_m)) in depth_m.iter().zip(sigma_m).enumerate() {
        let is_given = !depth_m.is_nan();
        rank.depth_m[i] = if is_given { *depth_m } else { f64::INFINITY };
        rank.sigma_m[i] = *sigma_m;
        given[i] += if is_given { 1.0 } else { 0.0 };
        is_any |= is_given;
    }
    is_any
}

/// Puts the lesser of two depths first; of equal ones the one of the lesser sigma.
#[inline(always)]
#[allow(clippy::float_cmp)] // equal to the bit
fn order(one: &mut Ranked, other: &mut Ranked) {
    for i in 0..BLOCK {
        let (a, b) = ([one.depth_m[i], one.sigma_m[i]], [other.depth_m[i], other.sigma_m[i]]);
        #[allow(clippy::needless_bitwise_bool)] // branches would keep the loop from being vectorised
        let is_turned = (b[0] < a[0]) | ((b[0] == a[0]) & (b[1] < a[1]));
        (one.depth_m[i], one.sigma_m[i]) = (if is_turned { b[0] } else { a[0] }, if is_turned { b[1] } else { a[1] });
        (other.depth_m[i], other.sigma_m[i]) =
            (if is_turned { a[0] } else { b[0] }, if is_turned { a[1] } else { b[1] });
    }
}

/// Finds the weights of one rank, and adds them to those of the ranks before.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // several arrays side by side
fn weigh(rank: &mut Ranked, total: &mut Numbers) {
    for i in 0..BLOCK {
        let (depth_m, sigma_m) = (rank.depth_m[i], rank.sigma_m[i]);
        let weight = 1.0 / (sigma_m * sigma_m);
        rank.weight[i] = if depth_m < f64::INFINITY { weight } else { 0.0 };
        total[i] += rank.weight[i];
    }
}

/// The weighted median; the mean of two where the weight is split exactly in half.
#[inline(always)]
fn weighted_median(ranks: &[Ranked], total: &Numbers) -> Numbers {
    let (mut passed, mut median_m) = ([0.0; BLOCK], [f64::NAN; BLOCK]);
    for (place, rank) in ranks.iter().enumerate() {
        let next = ranks.get(place + 1).unwrap_or(&Ranked::NONE);
        for i in 0..BLOCK {
            let half = 0.5 * total[i];
            passed[i] += rank.weight[i];
            let (depth_m, next_m) = (rank.depth_m[i], next.depth_m[i]);
            let at_half = if next_m < f64::INFINITY { 0.5 * (depth_m + next_m) } else { f64::NAN };
            let found = if passed[i] > half {
                depth_m
            } else if passed[i] >= half {
                at_half
            } else {
                f64::NAN
            };
            median_m[i] = if median_m[i].is_nan() { found } else { median_m[i] };
        }
    }
    median_m
}

/// Finds the distances of one rank from the centre.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // several arrays side by side
fn measure(rank: &mut Ranked, centre_m: &Numbers) {
    for i in 0..BLOCK {
        let distance_m = (rank.depth_m[i] - centre_m[i]).abs();
        (rank.distance_m[i], rank.sorted_m[i]) = (distance_m, distance_m);
    }
}

/// The median of the distances from the centre, the lower one of an even number.
#[inline(always)]
fn middle_distance(ranks: &mut [Ranked], given: &Numbers) -> Numbers {
    let mut middle_m = [0.0; BLOCK];
    for place in 0..ranks.len().div_ceil(2) {
        if let Some((least, others)) = ranks[place..].split_first_mut() {
            for other in others {
                for i in 0..BLOCK {
                    let (a, b) = (least.sorted_m[i], other.sorted_m[i]);
                    least.sorted_m[i] = if b < a { b } else { a };
                    other.sorted_m[i] = if b < a { a } else { b };
                }
            }
            for i in 0..BLOCK {
                // The last of the places up to the middle that is one.
                let is_reached = 2.0 * place as f64 <= given[i] - 1.0;
                middle_m[i] = if is_reached { least.sorted_m[i] } else { middle_m[i] };
            }
        }
    }
    middle_m
}

/// Averages the depths that lie near enough to the centre, by their weights.
#[inline(always)]
fn reject_and_average(ranks: &[Ranked], rule: &Rule, centre_m: &Numbers, middle_m: &Numbers, fused: &mut FusedBlock) {
    let (mut kept, mut weight, mut moment) = ([0.0; BLOCK], [0.0; BLOCK], [0.0; BLOCK]);
    let robust = rule.rejection * NORMAL_MAD;
    for rank in ranks {
        for i in 0..BLOCK {
            let (robust_m, sigmas_m) = (robust * middle_m[i], rule.rejection * rank.sigma_m[i]);
            let allowed_m = if robust_m > sigmas_m { robust_m } else { sigmas_m };
            let allowed_m = if allowed_m > rule.tolerance_m { allowed_m } else { rule.tolerance_m };
            #[allow(clippy::needless_bitwise_bool)] // branches would keep the loop from being vectorised
            let is_kept = (rank.distance_m[i] <= allowed_m) & (rank.depth_m[i] < f64::INFINITY);
            kept[i] += if is_kept { 1.0 } else { 0.0 };
            weight[i] += if is_kept { rank.weight[i] } else { 0.0 };
            moment[i] += if is_kept { rank.weight[i] * (rank.depth_m[i] - centre_m[i]) } else { 0.0 };
        }
    }
    for i in 0..BLOCK {
        fused.kept[i] = kept[i];
        fused.value_m[i] = centre_m[i] + moment[i] / weight[i];
        fused.sigma_m[i] = 1.0 / weight[i].sqrt();
        fused.weight[i] = weight[i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rows of some pairs of 70 pixels, from values and sigmas of few sizes, so that some are equal.
    fn rows(values: &[(u8, u8)], pairs: usize) -> Vec<PairRow> {
        let mut rows = vec![PairRow::new(70); pairs];
        for (i, (value, sigma)) in values.iter().enumerate().filter(|(_, (value, _))| value % 4 > 0) {
            let sigma_m = 0.01 * f64::from(sigma % 5 + 1);
            rows[i % pairs].set(i / pairs, 20.0 + 0.013 * f64::from(value % 64), sigma_m);
        }
        rows
    }

    proptest! {
        #[test]
        fn a_row_has_the_bits_of_its_pixels(
            pairs in prop_oneof![4 => 1usize..10, 1 => Just(40usize)], minimum in 0usize..4, rejection in 0.3f64..4.0, tolerance in 0u8..3, by_median in any::<bool>(),
            values in prop::collection::vec((any::<u8>(), any::<u8>()), 0..630)) {
            let averaging = if by_median { Averaging::Median } else { Averaging::Mean };
            let rule = Rule { averaging, rejection, tolerance_m: 0.05 * f64::from(tolerance), minimum };
            let rows = rows(&values[..values.len().min(70 * pairs)], pairs);
            let mut found = Vec::new();
            let mut fusion = RowFusion::new(rule, pairs);
            fusion.fuse_row(&rows, |column, given, fused| found.push((column, given, fused)));
            let mut expected = Vec::new();
            for column in 0..70 {
                let given = rows.iter().filter(|row| !row.depth_m[column].is_nan()).count();
                if given > 0 {
                    expected.push((column, given, fusion.one_by_one(&rows, column)));
                }
            }
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_depth_without_a_deviation_is_left_to_the_pixel() {
        let rule = Rule { averaging: Averaging::Mean, rejection: 3.0, tolerance_m: 0.0, minimum: 1 };
        let mut rows = vec![PairRow::new(3); 2];
        rows[0].set(1, 20.0, 0.0);
        rows[1].set(1, 20.5, 0.1);
        let mut fusion = RowFusion::new(rule, 2);
        let mut found = Vec::new();
        fusion.fuse_row(&rows, |column, given, fused| found.push((column, given, fused.map(|fused| fused.count))));
        let expected = fusion.one_by_one(&rows, 1).map(|fused| fused.count);
        assert_eq!(found, [(1, 2, expected)]);
    }
}
