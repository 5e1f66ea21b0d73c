//! Fits how the strength of the noise depends on the relief of the face, for places whose geometry changes later.

use rockface_core::artefact::ReliefLaw;
use rockface_core::numerics::golden_section::{Inner, golden_section};
use rockface_core::numerics::portable_math::{exp, log};
use rockface_core::numerics::quantile::median;
use rockface_imaging::matching::noise::changed_face::{Window, relief_m};

/// Intervals of relief, of equally many cells each.
const INTERVALS: usize = 20;
/// Golden sections of the search for the ratio of both parts.
const SECTIONS: usize = 40;

/// Relief of every cell, metres.
pub fn reliefs_m(elevation: &[f32], window: &Window) -> Vec<f64> {
    (0..elevation.len()).map(|cell| relief_m(elevation, window, cell)).collect()
}

/// Least squares of ln strength over medians in intervals of relief: `strength = sqrt(flat^2 + (gain relief)^2)`.
pub fn fit(strength: &[f32], reliefs_m: &[f64], window_cells: usize) -> ReliefLaw {
    let mut order: Vec<usize> = (0..strength.len()).filter(|i| strength[*i] > 0.0).collect();
    order.sort_by(|a, b| reliefs_m[*a].total_cmp(&reliefs_m[*b]).then(a.cmp(b)));
    let points: Vec<[f64; 2]> = order
        .chunks(order.len().div_ceil(INTERVALS).max(1))
        .filter_map(|cells| {
            let relief = median(&mut cells.iter().map(|i| reliefs_m[*i]).collect::<Vec<_>>())?;
            let strength = median(&mut cells.iter().map(|i| log(f64::from(strength[*i]))).collect::<Vec<_>>())?;
            Some([relief, strength])
        })
        .collect();
    let flat = |ratio: f64| {
        points.iter().map(|[relief, log_s]| log_s - grown(ratio, *relief)).sum::<f64>() / points.len().max(1) as f64
    };
    let cost = |log_ratio: f64| {
        let ratio = exp(log_ratio);
        let level = flat(ratio);
        points.iter().map(|[relief, log_s]| log_s - level - grown(ratio, *relief)).map(|rest| rest * rest).sum()
    };
    // Growth by the reciprocal of the relief, from a thousandth of the largest relief to a thousand times it.
    let largest = points.last().map_or(0.0, |[relief, _]| *relief);
    if largest <= 0.0 {
        return ReliefLaw { flat_px: exp(flat(0.0)), gain_px_m: 0.0, window_cells };
    }
    let ratio = exp(golden_section(cost, log(1e-3 / largest), log(1e3 / largest), SECTIONS, Inner::Reused));
    let flat_px = exp(flat(ratio));
    ReliefLaw { flat_px, gain_px_m: ratio * flat_px, window_cells }
}

/// Logarithm of the growth with the relief.
fn grown(ratio: f64, relief_m: f64) -> f64 {
    0.5 * log(1.0 + ratio * relief_m * (ratio * relief_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_strength_and_gain_come_back() {
        let reliefs: Vec<f64> = (0..2000).map(|i| 0.0001 * f64::from(i)).collect();
        let truth = |g: f64| (0.04f64 + 9.0 * g * g).sqrt() as f32;
        let strength: Vec<f32> = reliefs.iter().map(|g| truth(*g)).collect();
        let law = fit(&strength, &reliefs, 4);
        assert!((law.flat_px - 0.2).abs() < 0.002 && (law.gain_px_m - 3.0).abs() < 0.03, "{law:?}");
        let flat = fit(&strength, &vec![0.0; 2000], 4);
        assert!(flat.gain_px_m == 0.0 && flat.flat_px > 0.2, "{flat:?}");
    }
}
