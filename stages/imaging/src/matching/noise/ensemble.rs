//! Draws acquisitions from a noise model: the whitened fields of some members mixed with smooth random weights.
//!
//! A new field is `W(x) = sum_j a_j(x) W_j(x) / sqrt(sum_ij a_i c_ij a_j)` over donors j, with `a_j = g_j w_j`, independent normal fields
//! `g_j`, raised to a power with their sign, weights `w_j` that fall to 0 in gaps, and the correlation `c_ij` of the fields of two donors, which
//! may share an epoch: a localised ensemble, as in ensemble Kalman filters (Hamill, Whitaker and Snyder 2001). It keeps the covariance of the
//! members wherever that differs from place to place, without a parameter for it. A sum of fields is more even than each of them: its
//! details are given contrast, and the field the skewness of one member, to either side. Where the strongest donor of a place has a gap, the acquisition has one with the probability that makes the gaps of
//! a difference as frequent as they were. Bands of frequency then give it the amplitudes of one member, and classes of place its strength. Models
//! without fields start from noise of the spectra of its places instead, which loses the trend that it has, and have only their gaps from donors.

use rand::{Rng, RngExt};
use rayon::prelude::*;

use crate::matching::noise::contrast::{with_contrast, with_gains};
use crate::matching::noise::matcher::Keys;
use crate::matching::noise::modulation::smooth_field;
use crate::matching::noise::paper::SmoothNoise;
use crate::matching::noise::parametric::{self, Ground, drawn_size, level_part, white};
use crate::matching::noise::skewness::with_skewness;
use rockface_core::artefact::{GAP, Member, Noise};
use rockface_core::numerics::bands::{Bands, at_other_bands, log_rms};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, vectorised};

/// Logarithm of the factor on the strength between the middles of classes of place; constant beyond the outermost.
pub fn log_strength_at(middles: &[f64], values: &[f64], log_strength: f64) -> f64 {
    let above = middles.partition_point(|middle| *middle <= log_strength);
    if above == 0 || above == middles.len() {
        return values[above.saturating_sub(1)];
    }
    let (low, high) = (middles[above - 1], middles[above]);
    let share = (log_strength - low) / (high - low).max(1e-12);
    values[above - 1] * (1.0 - share) + values[above] * share
}

/// An acquisition that was drawn.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// Whitened field, `rows x columns` from the top; NaN in gaps.
    pub field: Vec<f64>,
    /// Logarithm of the factor on the strength, for each class of place.
    pub log_strength: Vec<f64>,
    /// Whether it is a bad acquisition.
    pub bad: bool,
}

impl Drawn {
    /// Errors of disparity for a map of strength (pixels of the full image), pixels of the full image; NaN in gaps.
    pub fn errors_px(&self, noise: &Noise, strength: &[f32]) -> Vec<f32> {
        let value = |(unit, strength_px): (&f64, &f32)| {
            let strength_px = f64::from(*strength_px);
            if strength_px <= 0.0 {
                return 0.0;
            }
            let log = log_strength_at(&noise.class_log_strength, &self.log_strength, portable_math::log(strength_px));
            (unit * strength_px * portable_math::exp(log)) as f32
        };
        self.field.iter().zip(strength).map(value).collect()
    }
}

/// Which acquisition of a series of surveys is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Numbers {
    /// Its number in the order of the surveys of a comparison; none: it stands alone.
    pub acquisition: Option<u32>,
    /// Its number among the replicates of the comparison; none: it knows of no others.
    pub replicate: Option<u32>,
}

/// Draws an acquisition of a model from the streams `noise-acquisition`, `noise-jitter`, `noise-weights`, `noise-weights-common`,
/// `noise-white` and `noise-shift` of `keys`. `ground` is that of the face, for models that have one ([`Ground::of`]).
///
/// One with an even number in its comparison mixes only fields of the first half of the members, one with an odd number those of the second half,
/// so that two acquisitions that are compared have none in common: where both had the same one their noise would cancel, or double. Replicates
/// take strengths and amplitudes of the members in turn, so that a few have the mean and the variety of the model (balanced bootstrap: Davison,
/// Hinkley and Schechtman 1986); without a number the member is drawn at random.
pub fn draw(noise: &Noise, ground: Option<&Ground>, numbers: Numbers, keys: Keys) -> Drawn {
    let mut generator = keys("noise-acquisition", "").generator();
    let (bad, good) = noise.by_class();
    let of_bad = generator.random::<f64>() < noise.bad_share && !bad.is_empty();
    let class = if of_bad { &bad } else { &good };
    let any = class[generator.random_range(0..class.len())];
    let order = &noise.orders[numbers.acquisition.unwrap_or(0) as usize % 2];
    let place = match numbers.replicate {
        Some(replicate) if !of_bad => order[replicate as usize % order.len()],
        _ => any,
    };
    let (member, number) = (&noise.members[place], numbers.acquisition);
    // A bad acquisition takes all bad donors and, where those are few, good ones in addition.
    let donors = if of_bad {
        let rest = some(own_half(&good, number), noise.donors.saturating_sub(bad.len()), &mut generator);
        some(&bad, noise.donors, &mut generator).into_iter().chain(rest).collect()
    } else {
        nearest(&noise.members, member, own_half(&good, number), noise.donors)
    };
    let random = keys("noise-jitter", "").field();
    let jittered = |values: fn(&Member) -> &[f64]| -> Vec<f64> {
        let departure = noise.departure(&good, &random, values);
        values(member).iter().zip(departure).map(|(value, departure)| value + departure).collect()
    };
    let log_strength = jittered(|member| &member.log_strength);
    let grid = noise.grid;
    let mixed = noise.has_gaps().then(|| {
        let gaps = Gaps::of(noise, (!of_bad).then_some(place), &donors, &mut generator);
        mixture(noise, &donors, &gaps, keys)
    });
    let mixed = mixed.unwrap_or_default();
    let (begun, [columns, rows]) = if noise.has_fields() {
        (mixed.field, [grid.columns, grid.rows])
    } else {
        let own = [grid.columns, grid.rows];
        let size = drawn_size(own);
        let white = white(size, &keys("noise-white", "").field());
        let field = match noise.parametric.as_ref().zip(ground) {
            Some((parametric, ground)) => parametric::field(parametric, ground, &white, size, own, keys),
            None => white,
        };
        (field, size)
    };
    // Which of two surveys is the later one is chance, and with it the side to which their difference is skewed.
    let skewness = if generator.random() { member.skewness } else { -member.skewness };
    let uneven = with_contrast(begun, columns, &noise.contrast);
    let uneven = with_skewness(uneven, columns, noise.skewness_gain * skewness);
    let bands = Bands::new(columns, rows, noise.bands());
    // The bands of the model, where the field is wider.
    let own = (!noise.has_fields()).then(|| Bands::new(grid.columns, grid.rows, noise.bands()));
    let at_bands_drawn = |values: Vec<f64>| match own {
        None => values,
        Some(_) => at_other_bands(&values, grid.columns.min(grid.rows), columns.min(rows), 1.0),
    };
    let shares = own.as_ref().unwrap_or(&bands).shares();
    let wanted = at_bands_drawn(of_unit_variance(jittered(|member| &member.log_amplitude), &shares));
    let log_gain = at_bands_drawn(noise.log_gain.clone());
    let spectrum = bands.spectrum(&uneven);
    drop(uneven);
    let present = spectrum.power();
    let gain = |band: usize| wanted[band] - 0.5 * portable_math::log(present[band].max(1e-12)) + log_gain[band];
    let filtered = spectrum.filtered(&(0..noise.bands()).map(gain).collect::<Vec<f64>>());
    let mut field = with_gains(filtered, columns, &noise.contrast);
    if !noise.has_fields() {
        field = level_part(&field, [grid.columns, grid.rows]);
    }
    mixed.gaps.into_iter().for_each(|cell| field[cell] = f64::NAN);
    Drawn { field, log_strength, bad: of_bad }
}

/// Logarithms of the amplitudes of bands, shifted alike so that the noise has unit variance: how strong an acquisition is say its strengths alone.
fn of_unit_variance(mut log_amplitude: Vec<f64>, shares: &[f64]) -> Vec<f64> {
    let level = log_rms(&log_amplitude, shares);
    log_amplitude.iter_mut().for_each(|log| *log -= level);
    log_amplitude
}

/// The members whose fields an acquisition of this number may have: the first half for even numbers, the second for odd ones, all without a
/// number. Halves and not every other member, since neighbours of a chain share an epoch.
fn own_half(members: &[usize], number: Option<u32>) -> &[usize] {
    if members.len() < 2 {
        return members;
    }
    let (first, second) = members.split_at(members.len() / 2);
    match number {
        None => members,
        Some(number) if number % 2 == 0 => first,
        Some(_) => second,
    }
}

/// The members of a class that are most like one, the nearest first: by the distance between their strengths and amplitudes, each over its
/// deviation within the class.
fn nearest(members: &[Member], member: &Member, class: &[usize], count: usize) -> Vec<usize> {
    let rows: Vec<Vec<f64>> = class.iter().map(|i| members[*i].figures().collect()).collect();
    let wanted: Vec<f64> = member.figures().collect();
    let variance = |k: usize| {
        let mean = rows.iter().map(|row| row[k]).sum::<f64>() / rows.len() as f64;
        rows.iter().map(|row| (row[k] - mean) * (row[k] - mean)).sum::<f64>() / rows.len() as f64
    };
    let variances: Vec<f64> = (0..wanted.len()).map(variance).collect();
    let squared = |row: &[f64], k: usize| {
        if variances[k] > 0.0 { (row[k] - wanted[k]) * (row[k] - wanted[k]) / variances[k] } else { 0.0 }
    };
    let distance = |row: &Vec<f64>| (0..wanted.len()).map(|k| squared(row, k)).sum::<f64>();
    let mut order: Vec<(f64, usize)> = rows.iter().map(distance).zip(class.iter().copied()).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order.into_iter().take(count).map(|(_, i)| i).collect()
}

/// Some of a list, each at most once (the beginning of a Fisher-Yates shuffle); all where there are no more.
fn some(list: &[usize], count: usize, generator: &mut impl Rng) -> Vec<usize> {
    let mut list = list.to_vec();
    let count = count.min(list.len());
    for i in 0..count {
        let other = generator.random_range(i..list.len());
        list.swap(i, other);
    }
    list.truncate(count);
    list
}

/// A mixture of whitened fields.
#[derive(Default)]
struct Mixed {
    /// Zero where the model has no fields.
    field: Vec<f64>,
    /// Cells without a value.
    gaps: Vec<usize>,
}

/// The whitened fields of the donors, mixed.
fn mixture(noise: &Noise, donors: &[usize], gaps_of: &Gaps, keys: Keys) -> Mixed {
    let (columns, cells) = (noise.grid.columns, noise.grid.cells());
    let extent = [columns as f64, noise.grid.rows as f64];
    let (common, local) = (noise.common_share.sqrt(), (1.0 - noise.common_share).sqrt());
    // Without fields the donors say only where the acquisition has gaps.
    let none = if noise.has_fields() { Vec::new() } else { vec![0.0; cells] };
    let donor = |(donor, coin): (&usize, &Option<f64>)| {
        let name = &noise.members[*donor].name;
        Donor {
            values: noise.fields.get(*donor).unwrap_or(&none),
            weights: &noise.weights[*donor],
            coin: *coin,
            constant: common * keys("noise-weights-common", name).field().normal(0, 0),
            smooth: smooth_field(&keys("noise-weights", name), noise.length_cells, [0.0; 2], extent),
        }
    };
    let donors: Vec<Donor> = donors.iter().zip(&gaps_of.coins).map(donor).collect();
    let correlations = correlations(&donors);
    let mut field = vec![0.0; cells];
    let mut gaps = vec![false; cells];
    let rows = field.par_chunks_mut(columns).zip(gaps.par_chunks_mut(columns)).enumerate();
    let sharpness = noise.sharpness;
    rows.for_each_init(Vec::new, |shares, (row, (field, gaps))| {
        let (donors, correlations) = (&donors, &correlations);
        let counts = &gaps_of.probability[row * columns..(row + 1) * columns];
        vectorised(MixedRow { donors, correlations, counts, local, sharpness, row, shares, field, gaps });
    });
    let gaps = (0..cells).filter(|cell| gaps[*cell]).collect();
    Mixed { field, gaps }
}

/// One row of a mixture.
struct MixedRow<'a> {
    donors: &'a [Donor<'a>],
    correlations: &'a [Vec<f64>],
    /// Probability with which a gap of a donor is one of the acquisition.
    counts: &'a [f64],
    /// Factor on the part of the weights that varies.
    local: f64,
    sharpness: u32,
    row: usize,
    /// Room for the weights of the donors.
    shares: &'a mut Vec<Lanes>,
    field: &'a mut [f64],
    gaps: &'a mut [bool],
}

impl Work for MixedRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { donors, correlations, counts, local, sharpness, row, shares, field, gaps } = self;
        let columns = field.len();
        for (block, (field, gaps)) in field.chunks_mut(LANES).zip(gaps.chunks_mut(LANES)).enumerate() {
            let column = block * LANES;
            let at = [Lanes::of(|lane| (column + lane) as f64), Lanes::all(row as f64)];
            let mut sum = Lanes::all(0.0);
            let mut strongest = [0.0f64; LANES];
            shares.clear();
            for donor in donors {
                let here = row * columns + column..row * columns + column + field.len();
                let (values, weights) = (&donor.values[here.clone()], &donor.weights[here]);
                let g = raised(donor.smooth.at_lanes(at) * local + donor.constant, sharpness);
                if let Some(coin) = donor.coin {
                    for (lane, gap) in gaps.iter_mut().enumerate() {
                        if g[lane].abs() > strongest[lane] {
                            strongest[lane] = g[lane].abs();
                            *gap = weights[lane] & GAP != 0 && coin < counts[column + lane];
                        }
                    }
                }
                let weight = Lanes::of(|lane| weights.get(lane).map_or(0.0, |weight| f64::from(weight & !GAP)));
                let share = g * weight / f64::from(!GAP);
                sum = sum + share * Lanes::of(|lane| values.get(lane).map_or(0.0, |value| f64::from(*value)));
                shares.push(share);
            }
            let variance = variance(shares, correlations);
            let value = variance.choose(|variance| variance > 0.0, sum / variance.sqrt(), Lanes::all(0.0));
            field.iter_mut().enumerate().for_each(|(lane, cell)| *cell = value[lane]);
        }
    }
}

/// A member whose field is mixed into an acquisition.
struct Donor<'a> {
    values: &'a [f32],
    weights: &'a [u8],
    /// Even draw that decides whether its gaps count; none: they never do.
    coin: Option<f64>,
    /// Part of its weight that is the same over the face.
    constant: f64,
    /// Part that varies.
    smooth: SmoothNoise,
}

/// Correlations of the fields of each donor with those before it.
fn correlations(donors: &[Donor]) -> Vec<Vec<f64>> {
    let product = |a: &Donor, b: &Donor| -> f64 {
        let rows = a.values.chunks(CHUNK).zip(b.values.chunks(CHUNK));
        rows.map(|(a, b)| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>()).sum()
    };
    let squares: Vec<f64> = donors.iter().map(|donor| product(donor, donor).max(f64::MIN_POSITIVE)).collect();
    let of = |j: usize| (0..j).map(|i| product(&donors[i], &donors[j]) / (squares[i] * squares[j]).sqrt()).collect();
    (0..donors.len()).into_par_iter().map(of).collect()
}

/// Cells whose products are added up by themselves.
const CHUNK: usize = 4096;
/// Least variance of a mixture as a part of what it is without correlation.
const LEAST_VARIANCE: f64 = 0.1;

/// Variance of a sum of fields of unit variance with these weights.
#[inline(always)]
fn variance<const N: usize>(weights: &[Lanes<N>], correlations: &[Vec<f64>]) -> Lanes<N> {
    let (mut alone, mut together) = (Lanes::all(0.0), Lanes::all(0.0));
    for (weight, row) in weights.iter().zip(correlations) {
        let mut common = Lanes::all(0.0);
        for (correlation, other) in row.iter().zip(weights) {
            common = common + *other * *correlation;
        }
        alone = alone + *weight * *weight;
        together = together + *weight * common;
    }
    (alone + together * 2.0).at_least(alone * LEAST_VARIANCE)
}

/// Which gaps of its donors an acquisition has.
struct Gaps {
    /// Probability with which a gap of a donor is one of the acquisition, cell by cell.
    probability: Vec<f64>,
    /// Even draw of each donor: its gaps count where it is below the probability. The draws of the donors are spread evenly (stratified), so that their chance
    /// does not hide how an acquisition differs from others. A bad acquisition has no gaps of good donors.
    coins: Vec<Option<f64>>,
}

impl Gaps {
    /// A gap of a difference was one of the acquisition asked for with a probability that follows from the share p of gaps at its cell: a usual acquisition
    /// has `a = 1 - sqrt(1 - p)`, times the model's gain of gaps, and a bad one, whose differences have the share b, `1 - (1 - b) / (1 - a)`. One with the
    /// strengths of a usual member has more gaps than others where the member had, by the model's power. Cells without a value in any difference have none in an
    /// acquisition.
    fn of(noise: &Noise, usual_member: Option<usize>, donors: &[usize], generator: &mut impl Rng) -> Self {
        let (bad, good) = noise.by_class();
        let [of_bad, of_good] = [&bad, &good].map(|class| gap_counts(noise, class));
        let relative = usual_member.map_or(1.0, |member| relative_gaps(noise, member, donors, &good, &of_good));
        let gain = noise.gap_gain * relative;
        let share = |count: u32, class: &[usize]| f64::from(count) / class.len().max(1) as f64;
        let of = |(in_bad, in_good): (&u32, &u32)| {
            let (bad_share, good_share) = (share(*in_bad, &bad), share(*in_good, &good));
            // What no raster shows, no acquisition does, whatever the gain.
            if good_share >= 1.0 {
                return 1.0;
            }
            let left = (1.0 - good_share).sqrt();
            let (own, share) = if usual_member.is_some() {
                (1.0 - left, good_share)
            } else {
                ((1.0 - (1.0 - bad_share) / left).max(0.0), bad_share)
            };
            if share > 0.0 { gain * own / share } else { 0.0 }
        };
        let places: Vec<usize> = (0..donors.len()).collect();
        let strata = some(&places, donors.len(), generator);
        let coin = |(stratum, donor): (usize, &usize)| {
            let coin = (stratum as f64 + generator.random::<f64>()) / donors.len() as f64;
            (usual_member.is_some() || noise.members[*donor].bad).then_some(coin)
        };
        let coins = strata.into_iter().zip(donors).map(coin).collect();
        Self { probability: of_bad.iter().zip(&of_good).map(of).collect(), coins }
    }
}

/// How many members of a class have a gap in each cell.
fn gap_counts(noise: &Noise, class: &[usize]) -> Vec<u32> {
    let mut counts = vec![0u32; noise.grid.cells()];
    for member in class {
        counts.iter_mut().zip(&noise.weights[*member]).for_each(|(count, weight)| *count += u32::from(*weight >> 7));
    }
    counts
}

/// Least share of gaps over the mean one that a member counts as having.
const LEAST_RELATIVE_GAPS: f64 = 0.01;

/// Share of gaps that an acquisition with the strengths of a usual member should have, over that of its donors; of cells that some usual difference shows.
fn relative_gaps(noise: &Noise, member: usize, donors: &[usize], good: &[usize], counts: &[u32]) -> f64 {
    let all = good.len() as u32;
    let gaps = |member: usize| {
        let weights = noise.weights[member].iter().zip(counts);
        weights.map(|(weight, count)| u32::from(*weight & GAP != 0 && *count < all)).sum::<u32>()
    };
    let mean = |members: &[usize]| members.iter().map(|i| f64::from(gaps(*i))).sum::<f64>() / members.len() as f64;
    let (usual, of_donors) = (mean(good), mean(donors));
    if usual <= 0.0 || of_donors <= 0.0 {
        return 1.0;
    }
    let relative = (f64::from(gaps(member)) / usual).max(LEAST_RELATIVE_GAPS);
    portable_math::exp(noise.gap_variety * portable_math::log(relative)) * usual / of_donors
}

/// `|g|^power` with the sign of g.
#[inline(always)]
fn raised(g: Lanes, power: u32) -> Lanes {
    let size = g.map(f64::abs);
    let mut product = g;
    for _ in 1..power {
        product = product * size;
    }
    product
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that are exact
mod tests {
    use super::*;

    #[test]
    fn donors_are_those_that_are_most_like_the_member_chosen() {
        let member = |strength: f64, amplitude: f64| Member {
            name: String::new(),
            bad: false,
            trend_m: [0.0; 10],
            log_strength: vec![strength],
            log_amplitude: vec![amplitude, 0.0],
            field_log_amplitude: vec![0.0; 2],
            skewness: 0.0,
        };
        // Amplitudes vary ten times as much as strengths: each counts over its own deviation.
        let members =
            [(0.0, 0.0), (0.1, 1.0), (0.02, 0.1), (0.09, 0.2), (0.1, 0.9), (5.0, 5.0)].map(|(s, a)| member(s, a));
        let class = [0, 1, 2, 3, 4];
        assert_eq!(nearest(&members, &members[1], &class, 2), [1, 4]);
        assert_eq!(nearest(&members, &members[0], &class, 3), [0, 2, 3]);
        assert_eq!(nearest(&members, &members[0], &class, 9).len(), 5);
    }

    #[test]
    fn acquisitions_that_are_compared_have_no_donor_in_common() {
        let members = [0, 1, 3, 4, 7];
        assert_eq!(own_half(&members, None), members);
        assert_eq!((own_half(&members, Some(0)), own_half(&members, Some(3))), (&members[..2], &members[2..]));
        assert_eq!([Some(0), Some(1)].map(|number| own_half(&members[..1], number)), [&[0], &[0]]);
    }

    #[test]
    fn donors_that_are_alike_or_opposite_leave_the_variance_of_a_mixture_as_it_is() {
        let correlations = [vec![], vec![-0.5], vec![0.25, 0.0]];
        let variance = |weights: &[f64], correlations: &[Vec<f64>]| {
            variance(&weights.iter().map(|weight| Lanes::from([*weight])).collect::<Vec<_>>(), correlations)[0]
        };
        assert!((variance(&[1.0, 1.0, 2.0], &correlations) - (6.0 - 1.0 + 1.0)).abs() < 1e-12);
        assert!((variance(&[1.0, -1.0, 0.0], &correlations) - 3.0).abs() < 1e-12);
        // Fields that nearly cancel are not blown up.
        assert!((variance(&[1.0, 1.0], &[vec![], vec![-1.0]]) - 0.2).abs() < 1e-12);
    }

    #[test]
    fn amplitudes_say_how_coarse_noise_is_and_not_how_strong() {
        let found = of_unit_variance(vec![0.5, -0.3], &[0.25, 0.75]);
        let power = 0.25 * portable_math::exp(2.0 * found[0]) + 0.75 * portable_math::exp(2.0 * found[1]);
        assert!((power - 1.0).abs() < 1e-12 && (found[0] - found[1] - 0.8).abs() < 1e-12);
    }

    #[test]
    fn powers_keep_the_sign() {
        let raised = |g: f64, power: u32| raised(Lanes::all(g), power)[0];
        assert_eq!([raised(-2.0, 1), raised(-2.0, 4), raised(3.0, 2)], [-2.0, -16.0, 9.0]);
    }
}
