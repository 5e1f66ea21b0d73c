//! What registration leaves in a difference: part of it follows from the asymmetry of the noise.
//!
//! Registration leaves out points that are far off, so it aligns what most cells agree on. Noise that is stronger on one side than on the
//! other then leaves an offset, and a tilt where it does so in one part of the face more than in another.

use crate::noise::learning::acquisitions::Source;

/// Most times its asymmetry that registration leaves.
const MOST_SLOPE: f64 = 6.0;
/// Most that a gain is raised because draws are less asymmetric than the rasters.
const MOST_RATIO: f64 = 3.0;

/// Takes what follows from their asymmetry off the planes of the sources that are not bad, and gives the gains of the asymmetry of draws.
///
/// `drawn` are the asymmetries of draws, in the numbers of a plane, metres.
pub fn part(sources: &mut [Source], bad: &[bool], drawn: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|k| {
        let usual = sources.iter().zip(bad).filter(|(_, bad)| !**bad);
        let usual: Vec<(f64, f64)> = usual.map(|(source, _)| (source.asymmetry_m[k], source.plane_m[k])).collect();
        let gain = slope(&usual).clamp(-MOST_SLOPE, MOST_SLOPE);
        sources.iter_mut().for_each(|source| source.plane_m[k] -= gain * source.asymmetry_m[k]);
        let of_draws: Vec<f64> = drawn.iter().map(|asymmetry| asymmetry[k]).collect();
        let of_rasters: Vec<f64> = usual.iter().map(|(asymmetry, _)| *asymmetry).collect();
        let ratio = deviation(&of_rasters) / deviation(&of_draws);
        if ratio.is_finite() { gain * ratio.clamp(1.0 / MOST_RATIO, MOST_RATIO) } else { gain }
    })
}

/// Slope of a line, shrunk by its chance (after James and Stein 1961): 0 within its standard error.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (mean_x, mean_y) = points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0 / n, y + point.1 / n));
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in points.iter().map(|(x, y)| (x - mean_x, y - mean_y)) {
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
    }
    let slope = xy / xx;
    let squared_error = (yy - slope * xy).max(0.0) / (n - 2.0) / xx;
    let shrunk = slope * (1.0 - squared_error / (slope * slope)).max(0.0);
    if shrunk.is_finite() { shrunk } else { 0.0 }
}

fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (n - 1.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn what_follows_from_the_asymmetry_comes_off_the_planes() {
        let random = Key([3; 32]).field();
        let asymmetries: Vec<[f64; 3]> = (0..26).map(|i| std::array::from_fn(|k| random.normal(i, k as i32))).collect();
        let source = |(i, asymmetry): (usize, &[f64; 3])| {
            let asymmetry_m = *asymmetry;
            let rest = |k: i32| 0.3 * random.normal(i as i32, 10 + k);
            let plane_m = [1.4 * asymmetry[0] + rest(0), rest(1), 2.0 + rest(2) - asymmetry[2]];
            Source { name: format!("r{i}"), plane_m, asymmetry_m }
        };
        let mut sources: Vec<Source> = asymmetries.iter().enumerate().map(source).collect();
        let mut bad = [false; 26];
        (sources[4].plane_m, bad[4]) = ([90.0, -90.0, 90.0], true);
        let drawn: Vec<[f64; 3]> = asymmetries.iter().map(|asymmetry| asymmetry.map(|a| 0.5 * a)).collect();
        let gain = part(&mut sources, &bad, &drawn);
        assert!((gain[0] - 2.8).abs() < 0.4 && gain[1].abs() < 0.15 && (gain[2] + 2.0).abs() < 0.4, "{gain:?}");
        let left: Vec<f64> =
            sources.iter().zip(bad).filter(|(_, bad)| !bad).map(|(source, _)| source.plane_m[0]).collect();
        assert!(deviation(&left) < 0.4, "{}", deviation(&left));
        // Three rasters on no line say nothing.
        assert!(slope(&[(0.0, 0.0), (1.0, 5.0), (2.0, 0.1)]).abs() < 1e-12);
    }
}
