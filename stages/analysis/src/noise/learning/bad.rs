//! Tells bad acquisitions (motion blur, haze) from the others by robust deviations.
//!
//! A raster is bad if its noise is stronger than usual by more than a number of robust deviations, or if it is stronger than the
//! median and its spectrum, or how its strength is shared between classes of place, is that unusual (root of the mean squared
//! deviation over bands, or over classes).

use crate::noise::learning::whitening::{Places, Stack, Whitened, whiten};
use rockface_core::numerics::marginal::NORMAL_MAD;
use rockface_core::numerics::quantile::median;

/// Smallest robust deviation of a logarithm that counts.
const LEAST_DEVIATION: f64 = 0.03;
/// Rounds until the bad ones no longer change.
const ROUNDS: usize = 4;

/// Places, whitened rasters, and which of them are bad. Bad ones have no say in the places.
pub fn parted(stack: &Stack, cut: f64) -> (Places, Vec<Whitened>, Vec<bool>) {
    let mut bad = vec![false; stack.rasters.len()];
    let mut round = 1;
    loop {
        let places = stack.places(&bad.iter().map(|bad| !bad).collect::<Vec<_>>());
        let whitened = whiten(stack.rasters, stack.columns, &places);
        let found = unusual(&whitened, &bad, cut);
        if found == bad || round == ROUNDS {
            return (places, whitened, bad);
        }
        (bad, round) = (found, round + 1);
    }
}

/// Which rasters are bad, judged by the median and deviation of those that were not bad before.
fn unusual(whitened: &[Whitened], before: &[bool], cut: f64) -> Vec<bool> {
    let level = |w: &Whitened| w.log_strength.iter().sum::<f64>() / w.log_strength.len() as f64;
    let rows: Vec<Vec<f64>> = whitened
        .iter()
        .map(|w| {
            let level = level(w);
            let classes = w.log_strength.iter().map(|class| class - level);
            std::iter::once(level).chain(classes).chain(w.log_amplitude.iter().copied()).collect()
        })
        .collect();
    let classes = whitened[0].log_strength.len();
    let scales: Vec<[f64; 2]> = (0..rows[0].len())
        .map(|column| {
            let usual = rows.iter().zip(before).filter(|(_, bad)| !**bad).map(|(row, _)| row[column]);
            let [middle, deviation] = robust(&usual.collect::<Vec<_>>());
            [middle, deviation.max(LEAST_DEVIATION)]
        })
        .collect();
    let judge = |row: &Vec<f64>| {
        let z: Vec<f64> =
            row.iter().zip(&scales).map(|(value, [middle, deviation])| (value - middle) / deviation).collect();
        let rms = |values: &[f64]| (values.iter().map(|z| z * z).sum::<f64>() / values.len() as f64).sqrt();
        let shape = rms(&z[1..=classes]).max(rms(&z[1 + classes..]));
        z[0] > cut || (z[0] > 0.0 && shape > cut)
    };
    let found: Vec<bool> = rows.iter().map(judge).collect();
    // Most acquisitions are usual; if not, the cut says nothing.
    let many = found.iter().filter(|bad| **bad).count() * 2 > found.len();
    if many { before.to_vec() } else { found }
}

/// Median, and 1.4826 times the median absolute deviation.
pub fn robust(values: &[f64]) -> [f64; 2] {
    let middle = median(&mut values.to_vec()).unwrap_or(0.0);
    let mut distances: Vec<f64> = values.iter().map(|value| (value - middle).abs()).collect();
    [middle, NORMAL_MAD * median(&mut distances).unwrap_or(0.0)]
}
