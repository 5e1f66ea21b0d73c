//! Acquisitions from differences: what one epoch brings to the noise of a difference of two.
//!
//! The variance of a difference is the sum of those of its two epochs, so the noise of one is weaker by sqrt 2. The logarithm of the
//! strength of a difference is close to the mean of those of its epochs, so it varies less by sqrt 2; and it lies above this mean by
//! half the variance between epochs. The same holds for its amplitude in each band. Neighbours of a chain share an epoch; that leaves
//! both factors as they are. A bad difference is a usual epoch and a bad one, whose variance is what the usual one does not explain.

use crate::noise::learning::departure::Mean;
use crate::noise::learning::whitening::Whitened;
use rockface_core::artefact::Member;
use rockface_core::numerics::bands::log_rms;
use rockface_core::numerics::portable_math::{exp, log};
use rockface_core::numerics::trend::Trend;

/// Part of the variance of a bad difference that its bad epoch has at least.
const LEAST_BAD_PART: f64 = 0.5;

/// How acquisitions are drawn from those that are known.
#[derive(Debug, Clone)]
pub struct Acquisitions {
    /// The acquisitions that are known.
    pub members: Vec<Member>,
    /// Probability that an acquisition is bad.
    pub bad_share: f64,
}

/// The difference an acquisition is taken from.
#[derive(Debug, Clone)]
pub struct Source {
    /// Its name.
    pub name: String,
    /// The trend that registration left in it, metres, as a member has it.
    pub trend_m: Trend,
    /// Its asymmetry: offset and tilts of its trend less those that most cells agree on, metres.
    pub asymmetry_m: [f64; 3],
    /// Its skewness.
    pub skewness: f64,
}

/// How the variety of acquisitions follows from that of differences. Figures are those that [`Shares::apart`] gives.
#[derive(Debug, Clone, Copy)]
pub struct Variety<'a> {
    /// Deviation of the jitter as a share of that of the members, which are drawn together accordingly, so that the variance stays.
    pub jitter: f64,
    /// Part of the deviation of each figure of the differences that is not chance of single fields, which every draw has anew.
    pub own: &'a [f64],
    /// What the mean of each figure of draws was found to have too much.
    pub excess: &'a [f64],
}

/// Shares of the power of noise.
#[derive(Debug, Clone)]
pub struct Shares {
    /// Of each class of place, in noise of the usual strength.
    pub classes: Vec<f64>,
    /// Of each band of frequency, in white noise.
    pub bands: Vec<f64>,
}

impl Shares {
    /// What varies by itself, of the factors on the strength by class of place and the amplitudes by band of noise of unit variance (all logarithms):
    /// strengths over the level of all places, then amplitudes times that level.
    pub fn apart(&self, log_strength: &[f64], log_amplitude: &[f64]) -> Vec<f64> {
        let level = log_rms(log_strength, &self.classes);
        let relative = log_strength.iter().map(|log| log - level);
        relative.chain(log_amplitude.iter().map(|log| log + level)).collect()
    }

    /// Factors on the strength and amplitudes of noise of unit variance: the level is the power of all bands, whatever the strengths have in common.
    fn together(&self, apart: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let (relative, absolute) = apart.split_at(self.classes.len());
        let (common, level) = (log_rms(relative, &self.classes), log_rms(absolute, &self.bands));
        (relative.iter().map(|log| log - common + level).collect(), absolute.iter().map(|log| log - level).collect())
    }
}

/// Acquisitions from whitened differences.
pub fn acquisitions(
    sources: &[Source],
    whitened: &[Whitened],
    bad: &[bool],
    shares: &Shares,
    variety: Variety,
) -> Acquisitions {
    let classes = shares.classes.len();
    let row = |w: &Whitened| -> Vec<f64> { w.log_strength.iter().chain(&w.log_amplitude).copied().collect() };
    let apart = |w: &Whitened| shares.apart(&w.log_strength, &w.log_amplitude);
    let usual: Vec<&Whitened> = whitened.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(w, _)| w).collect();
    let mean = |rows: &[Vec<f64>]| (0..rows[0].len()).map(|c| Mean::of(rows, c).value).collect::<Vec<f64>>();
    let rows: Vec<Vec<f64>> = usual.iter().map(|w| apart(w)).collect();
    let (apart_mean, usual_mean) = (mean(&rows), mean(&usual.iter().map(|w| row(w)).collect::<Vec<_>>()));
    let squares = |c: usize| rows.iter().map(|row| (row[c] - apart_mean[c]) * (row[c] - apart_mean[c])).sum::<f64>();
    let between = |c: usize| std::f64::consts::SQRT_2 * variety.own[c];
    let narrowing = 1.0 / (1.0 + variety.jitter * variety.jitter).sqrt();
    let half = -0.5 * std::f64::consts::LN_2;
    let of_usual = |w: &Whitened| {
        let one = |(c, value): (usize, &f64)| {
            let level = if c < classes { 0.0 } else { half };
            let excess =
                0.5 * between(c) * between(c) * squares(c) / (usual.len() as f64 - 1.0).max(1.0) + variety.excess[c];
            apart_mean[c] + between(c) * narrowing * (value - apart_mean[c]) + level - excess
        };
        shares.together(&apart(w).iter().enumerate().map(one).collect::<Vec<f64>>())
    };
    let member = |((source, w), bad): ((&Source, &Whitened), &bool)| {
        let (log_strength, log_amplitude) = if *bad { of_bad(&row(w), &usual_mean, shares) } else { of_usual(w) };
        Member {
            name: source.name.clone(),
            bad: *bad,
            trend_m: source.trend_m,
            log_strength,
            log_amplitude,
            field_log_amplitude: w.log_amplitude.clone(),
            skewness: source.skewness,
        }
    };
    let members = sources.iter().zip(whitened).zip(bad).map(member).collect();
    let count = bad.iter().filter(|bad| **bad).count() as f64;
    // A bad epoch spoils the two differences it takes part in.
    let bad_share = 0.5 * count / bad.len() as f64;
    Acquisitions { members, bad_share }
}

/// The bad epoch of a bad difference.
fn of_bad(row: &[f64], usual: &[f64], shares: &Shares) -> (Vec<f64>, Vec<f64>) {
    let classes = shares.classes.len();
    let rest = |whole: f64, usual: f64| (2.0 * whole - usual).max(2.0 * LEAST_BAD_PART * whole);
    let strength = |k: usize| 0.5 * log(0.5 * rest(exp(2.0 * row[k]), exp(2.0 * usual[k])));
    let level = |values: &[f64]| exp(2.0 * values[..classes].iter().sum::<f64>() / classes as f64);
    let (whole, part) = (level(row), level(usual));
    let power = |c: usize| rest(whole * exp(2.0 * row[c]), part * exp(2.0 * usual[c]));
    let amplitudes: Vec<f64> = (classes..row.len()).map(|c| 0.5 * log(power(c))).collect();
    let level = log_rms(&amplitudes, &shares.bands);
    ((0..classes).map(strength).collect(), amplitudes.iter().map(|log| log - level).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn whitened(strength: f64, amplitudes: [f64; 2]) -> Whitened {
        Whitened {
            log_strength: vec![strength],
            field: Vec::new(),
            weights: Vec::new(),
            log_amplitude: amplitudes.to_vec(),
            raster_log_amplitude: amplitudes.to_vec(),
            log_rms: strength,
        }
    }

    fn shares() -> Shares {
        Shares { classes: vec![1.0], bands: vec![0.3, 0.7] }
    }

    fn sources(count: usize) -> Vec<Source> {
        (0..count)
            .map(|i| Source { name: format!("d{i}"), trend_m: [0.0; 10], asymmetry_m: [0.0; 3], skewness: 0.0 })
            .collect()
    }

    #[test]
    fn two_epochs_make_up_the_variance_of_their_difference() {
        let rasters: Vec<Whitened> = (0..12).map(|i| whitened(if i % 2 == 0 { 0.1 } else { -0.1 }, [0.0; 2])).collect();
        let variety = Variety { jitter: 0.0, own: &[1.0; 3], excess: &[0.0; 3] };
        let found = acquisitions(&sources(12), &rasters, &[false; 12], &shares(), variety);
        assert!(found.bad_share == 0.0);
        let draws: Vec<f64> = found.members.iter().map(|member| member.log_strength[0]).collect();
        let deviation = (draws[0] - draws[1]) / 2.0;
        assert!((deviation - 0.1 * std::f64::consts::SQRT_2).abs() < 1e-12);
        // All differences of two of them: their mean log rms is that of the rasters.
        let pairs = draws.iter().flat_map(|a| draws.iter().map(move |b| 0.5 * log(exp(2.0 * a) + exp(2.0 * b))));
        assert!((pairs.sum::<f64>() / 144.0).abs() < 0.005);
    }

    #[test]
    fn a_level_that_is_chance_of_coarse_waves_leaves_fine_noise_alone() {
        // The coarse band varies, the fine one has the same amplitude in all.
        let raster = |i: usize| {
            let coarse = if i.is_multiple_of(2) { 0.3 } else { -0.3 };
            let strength = 0.5 * log(0.3 * exp(2.0 * coarse) + 0.7);
            whitened(strength, [coarse - strength, -strength])
        };
        let rasters: Vec<Whitened> = (0..12).map(raster).collect();
        let variety = Variety { jitter: 0.0, own: &[0.9, 0.3, 0.8], excess: &[0.0, 0.1, -0.2] };
        let found = acquisitions(&sources(12), &rasters, &[false; 12], &shares(), variety).members;
        let absolute =
            |band: usize| found.iter().map(|m| m.log_strength[0] + m.log_amplitude[band]).collect::<Vec<_>>();
        let (coarse, fine) = (absolute(0), absolute(1));
        assert!(fine.iter().all(|log| (log - 0.2 + 0.5 * std::f64::consts::LN_2).abs() < 1e-12), "{fine:?}");
        let between = 0.3 * std::f64::consts::SQRT_2;
        assert!((coarse[0] - coarse[1] - 0.6 * between).abs() < 1e-12, "{coarse:?}");
        for member in &found {
            let [a, b] = [0, 1].map(|band| exp(2.0 * member.log_amplitude[band]));
            assert!((0.3 * a + 0.7 * b - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_bad_epoch_has_what_the_usual_one_does_not_explain() {
        let mut rasters: Vec<Whitened> = (0..9).map(|_| whitened(0.0, [0.0; 2])).collect();
        rasters.push(whitened(0.5 * log(5.0), [0.2, -0.1]));
        let bad: Vec<bool> = (0..10).map(|i| i == 9).collect();
        let variety = Variety { jitter: 0.4, own: &[0.9; 3], excess: &[0.0; 3] };
        let found = acquisitions(&sources(10), &rasters, &bad, &shares(), variety);
        assert!((found.bad_share - 0.05).abs() < 1e-12);
        let epochs = exp(2.0 * found.members[9].log_strength[0]) + exp(2.0 * found.members[0].log_strength[0]);
        assert!((epochs - 5.0).abs() < 1e-9, "{epochs}");
        let amplitude = &found.members[9].log_amplitude;
        assert!((0.3 * exp(2.0 * amplitude[0]) + 0.7 * exp(2.0 * amplitude[1]) - 1.0).abs() < 1e-9);
    }
}
