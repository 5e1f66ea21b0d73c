//! Draws acquisitions from a noise model: the whitened fields of some members mixed with smooth random weights.
//!
//! A new field is `W(x) = sum_j g_j(x) w_j(x) W_j(x) / sqrt(sum_j (g_j w_j)^2)` over donors j, with independent normal fields
//! `g_j`, raised to a power with their sign, and weights `w_j` that fall to 0 in gaps: a localised ensemble, as in ensemble Kalman filters
//! (Hamill, Whitaker and Snyder 2001). It keeps the covariance of the members wherever that differs from place to place, without a
//! parameter for it. A sum of fields is more even than each of them: contrast gives energy its variation back. Where the strongest
//! donor of a place has a gap, the acquisition has one with the probability that makes the gaps of a difference as frequent as they were.
//! Bands of frequency then give it the amplitudes of one member, and classes of place its strength. Models without fields start from
//! white noise instead.

use rand::{Rng, RngExt};

use crate::matching::noise::contrast::{Classes, contrasted};
use crate::matching::noise::matcher::Keys;
use crate::matching::noise::modulation::smooth_field;
use rockface_core::artefact::{GAP, Member, Noise};
use rockface_core::numerics::bands::Bands;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Field;

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

/// Draws an acquisition of a model from the streams `noise-acquisition`, `noise-jitter`, `noise-weights`, `noise-weights-common` and
/// `noise-white` of `keys`.
pub fn draw(noise: &Noise, keys: Keys) -> Drawn {
    let mut generator = keys("noise-acquisition", "").generator();
    let (bad, good): (Vec<usize>, Vec<usize>) = (0..noise.members.len()).partition(|i| noise.members[*i].bad);
    let of_bad = generator.random::<f64>() < noise.bad_share && !bad.is_empty();
    let class = if of_bad { &bad } else { &good };
    let member = &noise.members[class[generator.random_range(0..class.len())]];
    // A bad acquisition takes all bad donors and, where those are few, good ones in addition.
    let donors = if of_bad {
        let rest = some(&good, noise.donors.saturating_sub(bad.len()), &mut generator);
        some(&bad, noise.donors, &mut generator).into_iter().chain(rest).collect()
    } else {
        nearest(&noise.members, member, &good, noise.donors)
    };
    let random = keys("noise-jitter", "").field();
    let jittered = |values: fn(&Member) -> &[f64]| -> Vec<f64> {
        let departure = noise.departure(&good, &random, values);
        values(member).iter().zip(departure).map(|(value, departure)| value + departure).collect()
    };
    let (log_strength, wanted) = (jittered(|member| &member.log_strength), jittered(|member| &member.log_amplitude));
    let mixed = if noise.has_fields() {
        let coins: Vec<f64> = donors.iter().map(|_| generator.random()).collect();
        mixture(noise, &donors, &coins, keys)
    } else {
        Mixed { field: white(noise, &keys("noise-white", "").field()), gaps: Vec::new() }
    };
    let columns = noise.grid.columns;
    let mixed_field = contrasted(mixed.field, columns, &noise.contrast, &Classes::of(noise));
    let bands = Bands::new(columns, noise.grid.rows, noise.bands());
    let present = bands.power(&mixed_field);
    let gain = |band: usize| wanted[band] - 0.5 * portable_math::log(present[band].max(1e-12)) + noise.log_gain[band];
    let mut field = bands.filter(&mixed_field, &(0..noise.bands()).map(gain).collect::<Vec<f64>>());
    mixed.gaps.into_iter().for_each(|cell| field[cell] = f64::NAN);
    Drawn { field, log_strength, bad: of_bad }
}

/// The members of a class that are most like one of them, that one first: by the distance between their strengths and amplitudes, each over its
/// deviation within the class.
fn nearest(members: &[Member], member: &Member, class: &[usize], count: usize) -> Vec<usize> {
    let figures =
        |member: &Member| -> Vec<f64> { member.log_strength.iter().chain(&member.log_amplitude).copied().collect() };
    let rows: Vec<Vec<f64>> = class.iter().map(|i| figures(&members[*i])).collect();
    let wanted = figures(member);
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
struct Mixed {
    field: Vec<f64>,
    /// Cells without a value.
    gaps: Vec<usize>,
}

/// The whitened fields of the donors, mixed; `coins` decide, donor by donor, whether its gaps count.
fn mixture(noise: &Noise, donors: &[usize], coins: &[f64], keys: Keys) -> Mixed {
    let (columns, cells) = (noise.grid.columns, noise.grid.cells());
    let extent = [columns as f64, noise.grid.rows as f64];
    let (common, local) = (noise.common_share.sqrt(), (1.0 - noise.common_share).sqrt());
    let counts = gap_probability(noise);
    let (mut sums, mut squares) = (vec![0.0; cells], vec![0.0; cells]);
    let mut strongest = vec![(0.0f64, false); cells];
    for (donor, coin) in donors.iter().zip(coins) {
        let name = &noise.members[*donor].name;
        let key = keys("noise-weights", name);
        let smooth = smooth_field(&key, noise.length_cells, [0.0; 2], extent);
        let constant = common * keys("noise-weights-common", name).field().normal(0, 0);
        let (values, weights) = (&noise.fields[*donor], &noise.weights[*donor]);
        for (i, (value, weight)) in values.iter().zip(weights).enumerate() {
            let position = [(i % columns) as f64, (i / columns) as f64];
            let g = raised(constant + local * smooth.at(position), noise.sharpness);
            if g.abs() > strongest[i].0 {
                strongest[i] = (g.abs(), weight & GAP != 0 && *coin < counts[i]);
            }
            let g = g * f64::from(weight & !GAP) / f64::from(!GAP);
            sums[i] += g * f64::from(*value);
            squares[i] += g * g;
        }
    }
    let field = sums.iter().zip(&squares).map(|(sum, square)| if *square > 0.0 { sum / square.sqrt() } else { 0.0 });
    let gaps = (0..cells).filter(|i| strongest[*i].1).collect();
    Mixed { field: field.collect(), gaps }
}

/// Probability with which a gap of a difference was one of the acquisition asked for, cell by cell: with a share p of gaps in the differences
/// an acquisition has `1 - sqrt(1 - p)`.
fn gap_probability(noise: &Noise) -> Vec<f64> {
    let mut counts = vec![0u32; noise.grid.cells()];
    for weights in &noise.weights {
        counts.iter_mut().zip(weights).for_each(|(count, weight)| *count += u32::from(*weight >> 7));
    }
    let of = |count: u32| {
        let share = f64::from(count) / noise.weights.len() as f64;
        if share > 0.0 { (1.0 - (1.0 - share).sqrt()) / share } else { 0.0 }
    };
    let by_count: Vec<f64> = (0..=noise.weights.len() as u32).map(of).collect();
    counts.into_iter().map(|count| by_count[count as usize]).collect()
}

/// `|g|^power` with the sign of g.
fn raised(g: f64, power: u32) -> f64 {
    (1..power).fold(g, |product, _| product * g.abs())
}

fn white(noise: &Noise, field: &Field) -> Vec<f64> {
    let columns = noise.grid.columns;
    (0..noise.grid.cells()).map(|i| field.normal((i % columns) as i32, (i / columns) as i32)).collect()
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
            plane_m: [0.0; 3],
            log_strength: vec![strength],
            log_amplitude: vec![amplitude, 0.0],
            field_log_amplitude: vec![0.0; 2],
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
    fn powers_keep_the_sign() {
        assert_eq!([raised(-2.0, 1), raised(-2.0, 4), raised(3.0, 2)], [-2.0, -16.0, 9.0]);
    }
}
