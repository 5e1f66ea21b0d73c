//! What the draws of a model have too much or too little of, and the correction of its acquisitions that makes up for it.

use crate::noise::learning::acquisitions::Shares;
use crate::noise::learning::departure::{Departure, Mean, of_another};
use crate::noise::learning::whitening::{BANDS, Whitened};
use rockface_core::artefact::Noise;

/// Least and most of the variance of a figure over rasters that acquisitions differ by.
const LEAST_OWN: f64 = 0.1;
const MOST_OWN: f64 = 4.0;

/// What the draws of a model say that it should have otherwise.
pub struct Correction {
    /// Part of the deviation of each figure that acquisitions differ by.
    pub own: Vec<f64>,
    /// How much the mean of the draws exceeds that of the rasters, figure by figure, without what may be chance.
    pub excess: Vec<f64>,
}

impl Correction {
    /// None, of so many figures.
    pub fn none(figures: usize) -> Self {
        Self { own: vec![1.0; figures], excess: vec![0.0; figures] }
    }

    /// From the usual rasters and draws of a model whose acquisitions are all alike.
    pub fn of(real: &[&Whitened], drawn: &[Whitened]) -> Self {
        let drawn: Vec<&Whitened> = drawn.iter().collect();
        Self { own: own_shares(real, &drawn), excess: excess(real, &drawn, Mean::of) }
    }

    /// Takes off what draws with this correction still miss of the mean and of the variety of the usual rasters, without what may be chance.
    pub fn refine(&mut self, real: &[&Whitened], drawn: &[Whitened], known: &Known) {
        let drawn: Vec<&Whitened> = drawn.iter().collect();
        let excess = excess(real, &drawn, |rows, k| Mean::given(rows, k, &known.draws[k], known.usual[k]));
        self.excess.iter_mut().zip(excess).for_each(|(all, more)| *all += more);
        let wider = of_another(real.len());
        let one = |(wanted, drawn): (f64, f64)| if wanted > 0.0 { (1.0 - drawn / wanted).max(-1.0) } else { 0.0 };
        let lacking: Vec<f64> =
            variances(real).into_iter().map(|real| wider * real).zip(variances(&drawn)).map(one).collect();
        let (strengths, amplitudes) = lacking.split_at(lacking.len() - BANDS);
        let mean = strengths.iter().sum::<f64>() / strengths.len() as f64;
        let changes = strengths.iter().map(|_| mean).chain(near(amplitudes));
        // Relative standard error of a variance of normal figures.
        let relative = (2.0 / (drawn.len() as f64 - 1.0)).sqrt();
        for (own, lacking) in self.own.iter_mut().zip(changes) {
            let change = Departure { difference: lacking, error: relative * (1.0 - lacking) }.certain(1.0);
            *own = (*own * *own + change).clamp(LEAST_OWN, MOST_OWN).sqrt();
        }
    }
}

/// What the figures of draws follow from: the strengths and amplitudes that their members have.
pub struct Known {
    /// Figure by figure, the mean of the two members of each draw.
    draws: Vec<Vec<f64>>,
    /// Figure by figure, the mean of all usual members.
    usual: Vec<f64>,
}

impl Known {
    /// Of the first draws of a model, none of which is bad.
    pub fn of(noise: &Noise, shares: &Shares, count: usize) -> Self {
        let figures = |member: &usize| {
            let member = &noise.members[*member];
            shares.apart(&member.log_strength, &member.log_amplitude)
        };
        let [first, second] = noise.orders.each_ref().map(|order| order.iter().map(figures).collect::<Vec<_>>());
        let of_draw = |i: usize, k: usize| 0.5 * (first[i % first.len()][k] + second[i % second.len()][k]);
        let all = 0..first[0].len();
        Self {
            draws: all.clone().map(|k| (0..count).map(|i| of_draw(i, k)).collect()).collect(),
            usual: all.map(|k| Mean::of(&first, k).value).collect(),
        }
    }
}

/// How much the mean of draws, by `mean`, exceeds that of rasters, figure by figure, without what may be chance.
fn excess(real: &[&Whitened], drawn: &[&Whitened], mean: impl Fn(&[Vec<f64>], usize) -> Mean) -> Vec<f64> {
    let [real, drawn] = [real, drawn].map(|all| all.iter().map(|w| w.apart()).collect::<Vec<_>>());
    // The mean of the rasters is what the draws should have: it is no estimate.
    let departure = |k: usize| Departure::of(mean(&drawn, k), Mean::of(&real, k).exact());
    (0..real[0].len()).map(|k| departure(k).certain(1.0)).collect()
}

/// Part of the deviation of each figure over the rasters that acquisitions differ by: what draws of acquisitions that are all alike vary is the
/// chance of single fields, which every draw has anew. The part of each class of place is drawn halfway towards the mean of all, that of each
/// band towards its neighbours, since few rasters say little of a variance.
fn own_shares(real: &[&Whitened], alike: &[&Whitened]) -> Vec<f64> {
    let wider = of_another(real.len());
    let one =
        |(real, chance): (f64, f64)| if real > 0.0 { (wider - chance / real).clamp(LEAST_OWN, wider) } else { 1.0 };
    let shares: Vec<f64> = variances(real).into_iter().zip(variances(alike)).map(one).collect();
    let (strengths, amplitudes) = shares.split_at(shares.len() - BANDS);
    let mean = strengths.iter().sum::<f64>() / strengths.len() as f64;
    let strengths = strengths.iter().map(|share| 0.5 * (share + mean));
    strengths.chain(near(amplitudes)).map(f64::sqrt).collect()
}

/// Variance over rasters of each of their figures apart.
pub fn variances(rasters: &[&Whitened]) -> Vec<f64> {
    let rows: Vec<Vec<f64>> = rasters.iter().map(|raster| raster.apart()).collect();
    (0..rows[0].len()).map(|k| Mean::of(&rows, k).squared_error * rows.len() as f64).collect()
}

/// Values of bands, each with half the weight and its neighbours with the rest.
fn near(bands: &[f64]) -> Vec<f64> {
    let last = bands.len() - 1;
    let one = |k: usize| 0.25 * (bands[k.saturating_sub(1)] + 2.0 * bands[k] + bands[(k + 1).min(last)]);
    (0..bands.len()).map(one).collect()
}
