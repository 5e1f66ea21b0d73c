//! Draws acquisitions from a noise model: the whitened fields of some members mixed with smooth random weights.
//!
//! A new field is `W(x) = sum_j g_j(x) w_j(x) W_j(x) / sqrt(sum_j (g_j w_j)^2)` over donors j, with independent normal fields
//! `g_j` and weights `w_j` that fall to 0 in gaps: a localised ensemble, as in ensemble Kalman filters (Hamill, Whitaker and
//! Snyder 2001). It keeps the covariance of the members wherever that differs from place to place, without a parameter for it.
//! Bands of frequency then give it the amplitudes of one member, and classes of place its strength. Models without fields
//! start from white noise instead.

use rand::{Rng, RngExt};

use crate::matching::noise::matcher::Keys;
use crate::matching::noise::modulation::smooth_field;
use rockface_core::artefact::{Member, Noise};
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
    /// Whitened field, `rows x columns` from the top.
    pub field: Vec<f64>,
    /// Logarithm of the factor on the strength, for each class of place.
    pub log_strength: Vec<f64>,
    /// Whether it is a bad acquisition.
    pub bad: bool,
}

/// Draws an acquisition of a model from the streams `noise-acquisition`, `noise-weights-<donor>` and `noise-white` of `keys`.
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
        some(&good, noise.donors, &mut generator)
    };
    let jitter = keys("noise-jitter", "").field();
    let jittered = |values: &[f64], first: usize| -> Vec<f64> {
        let with = |(i, value): (usize, &f64)| value + noise.jitter[first + i] * jitter.normal((first + i) as i32, 0);
        values.iter().enumerate().map(with).collect()
    };
    let log_strength = jittered(&member.log_strength, 0);
    let wanted = jittered(&member.log_amplitude, noise.class_log_strength.len());
    let (mixed, present) = if noise.has_fields() {
        (mixture(noise, &donors, keys), mean_log_amplitude(noise, &donors))
    } else {
        (white(noise, &keys("noise-white", "").field()), vec![0.0; wanted.len()])
    };
    let log_gain: Vec<f64> = wanted.iter().zip(&present).map(|(wanted, present)| wanted - present).collect();
    let field = Bands::new(noise.grid.columns, noise.grid.rows, noise.bands()).filter(&mixed, &log_gain);
    Drawn { field, log_strength, bad: of_bad }
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

/// Logarithm of the root of the mean power of some members in each band.
fn mean_log_amplitude(noise: &Noise, donors: &[usize]) -> Vec<f64> {
    let members: Vec<&Member> = donors.iter().map(|donor| &noise.members[*donor]).collect();
    let power = |band: usize, member: &&Member| portable_math::exp(2.0 * member.field_log_amplitude[band]);
    let mean = |band: usize| members.iter().map(|member| power(band, member)).sum::<f64>() / members.len() as f64;
    (0..noise.bands()).map(|band| 0.5 * portable_math::log(mean(band))).collect()
}

/// The whitened fields of the donors, mixed.
fn mixture(noise: &Noise, donors: &[usize], keys: Keys) -> Vec<f64> {
    let (columns, cells) = (noise.grid.columns, noise.grid.cells());
    let extent = [columns as f64, noise.grid.rows as f64];
    let (common, local) = (noise.common_share.sqrt(), (1.0 - noise.common_share).sqrt());
    let (mut sums, mut squares) = (vec![0.0; cells], vec![0.0; cells]);
    for donor in donors {
        let name = &noise.members[*donor].name;
        let key = keys("noise-weights", name);
        let smooth = smooth_field(&key, noise.length_cells, [0.0; 2], extent);
        let constant = common * keys("noise-weights-common", name).field().normal(0, 0);
        let (values, weights) = (&noise.fields[*donor], &noise.weights[*donor]);
        for (i, (value, weight)) in values.iter().zip(weights).enumerate().filter(|(_, (_, weight))| **weight > 0) {
            let position = [(i % columns) as f64, (i / columns) as f64];
            let g = (constant + local * smooth.at(position)) * f64::from(*weight) / 255.0;
            sums[i] += g * f64::from(*value);
            squares[i] += g * g;
        }
    }
    sums.iter().zip(&squares).map(|(sum, square)| if *square > 0.0 { sum / square.sqrt() } else { 0.0 }).collect()
}

fn white(noise: &Noise, field: &Field) -> Vec<f64> {
    let columns = noise.grid.columns;
    (0..noise.grid.cells()).map(|i| field.normal((i % columns) as i32, (i / columns) as i32)).collect()
}
