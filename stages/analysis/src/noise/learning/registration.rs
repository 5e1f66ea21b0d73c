//! What registration leaves in a difference: part of it follows from the asymmetry of the noise.
//!
//! Registration leaves out points that are far off, so it aligns what most cells agree on. Noise that is stronger on one side than on the
//! other then leaves an offset, and a tilt where it does so in one part of the face more than in another.

use crate::noise::learning::acquisitions::Source;
use crate::noise::learning::departure::{Departure, Mean};
use rockface_core::numerics::linear_fit::fit_line;

/// Most times its asymmetry that registration leaves.
const MOST_SLOPE: f64 = 6.0;
/// Most that a gain is raised because draws are less asymmetric than the rasters.
const MOST_RATIO: f64 = 3.0;

/// Takes what follows from their asymmetry off the trends of the sources that are not bad, and gives the gains of the asymmetry of draws.
///
/// `drawn` are the asymmetries of draws, in the numbers of a plane, metres.
pub fn part(sources: &mut [Source], bad: &[bool], drawn: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let usual = || sources.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(source, _)| source);
        let points: Vec<(f64, f64)> = usual().map(|source| (source.asymmetry_m[k], source.trend_m[k])).collect();
        let of_rasters: Vec<[f64; 3]> = usual().map(|source| source.asymmetry_m).collect();
        let gain = slope(&points).clamp(-MOST_SLOPE, MOST_SLOPE);
        sources.iter_mut().for_each(|source| source.trend_m[k] -= gain * source.asymmetry_m[k]);
        let ratio = deviation(&of_rasters, k) / deviation(drawn, k);
        if ratio.is_finite() { gain * ratio.clamp(1.0 / MOST_RATIO, MOST_RATIO) } else { gain }
    })
}

/// Slope of a line, without what may be chance: 0 within its standard error.
fn slope(points: &[(f64, f64)]) -> f64 {
    let Some(line) = fit_line(points) else { return 0.0 };
    let squared_error = line.slope * line.slope * (1.0 - line.r2) / line.r2 / (points.len() as f64 - 2.0);
    let certain = Departure { difference: line.slope, error: squared_error.sqrt() }.certain(1.0);
    if certain.is_finite() { certain } else { 0.0 }
}

/// Deviation of number `k` of some planes.
fn deviation(planes: &[[f64; 3]], k: usize) -> f64 {
    (Mean::of(planes, k).squared_error * planes.len() as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn what_follows_from_the_asymmetry_comes_off_the_trends() {
        let random = Key([3; 32]).field();
        let asymmetries: Vec<[f64; 3]> = (0..26).map(|i| std::array::from_fn(|k| random.normal(i, k as i32))).collect();
        let source = |(i, asymmetry): (usize, &[f64; 3])| {
            let asymmetry_m = *asymmetry;
            let rest = |k: i32| 0.3 * random.normal(i as i32, 10 + k);
            let plane_m = [1.4 * asymmetry[0] + rest(0), rest(1), 2.0 + rest(2) - asymmetry[2]];
            let mut trend_m = [0.1; 10];
            trend_m[..3].copy_from_slice(&plane_m);
            Source { name: format!("r{i}"), trend_m, asymmetry_m, skewness: 0.0 }
        };
        let mut sources: Vec<Source> = asymmetries.iter().enumerate().map(source).collect();
        let mut bad = [false; 26];
        (sources[4].trend_m, bad[4]) = ([90.0; 10], true);
        let drawn: Vec<[f64; 3]> = asymmetries.iter().map(|asymmetry| asymmetry.map(|a| 0.5 * a)).collect();
        let gain = part(&mut sources, &bad, &drawn);
        assert!((gain[0] - 2.8).abs() < 0.4 && gain[1].abs() < 0.15 && (gain[2] + 2.0).abs() < 0.4, "{gain:?}");
        let left: Vec<[f64; 3]> = sources
            .iter()
            .zip(bad)
            .filter(|(_, bad)| !bad)
            .map(|(source, _)| std::array::from_fn(|k| source.trend_m[k]))
            .collect();
        assert!(deviation(&left, 0) < 0.4, "{}", deviation(&left, 0));
        // Three rasters on no line say nothing.
        assert!(slope(&[(0.0, 0.0), (1.0, 5.0), (2.0, 0.1)]).abs() < 1e-12);
    }
}
