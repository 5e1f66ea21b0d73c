//! Effects of a matcher's window on a depth map: noise on relief, smoothing, and growth of the nearer side of a step.
//!
//! Windows are squares of `2 half + 1` pixels; pixels without depth or beyond the edge do not count. Computations use the
//! inverse depth, to which disparity is proportional.

use rayon::prelude::*;

use rockface_core::artefact::Depth;

/// Standard deviation of the inverse depth within the window of every pixel, 1/m; NaN where the pixel has no depth.
///
/// On a plane it is the gradient times `sqrt(half (half + 1) / 3)`; across a step that fills half of the window, half of the step.
pub fn relief(depth: &Depth, half: usize) -> Vec<f32> {
    per_pixel(depth, |column, row, centre| {
        let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for_window(depth, column, row, half, |inverse| {
            let d = inverse - centre;
            (n, sum, squares) = (n + 1.0, sum + d, squares + d * d);
        });
        ((squares - sum * sum / n) / n).max(0.0).sqrt()
    })
}

/// How the window changes the depth that is matched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowEffects {
    /// Half width of the window over which disparity is averaged, pixels; 0: none.
    pub smoothing_px: usize,
    /// How far the nearer side of a depth step grows over the farther one, pixels; 0: not at all.
    pub fattening_px: usize,
    /// Smallest step that grows, metres.
    pub step_m: f64,
}

/// Depths after the effects of the window, metres: the depth of a surface within reach that is at least `step_m` nearer;
/// elsewhere the mean over the smoothing window.
pub fn seen_depth(depth: &Depth, effects: &WindowEffects) -> Vec<f32> {
    per_pixel(depth, |column, row, centre| {
        let mut nearest = centre;
        for_window(depth, column, row, effects.fattening_px, |inverse| nearest = nearest.max(inverse));
        if 1.0 / centre - 1.0 / nearest >= effects.step_m && effects.fattening_px > 0 {
            return 1.0 / nearest;
        }
        let (mut n, mut sum) = (0.0, 0.0);
        for_window(depth, column, row, effects.smoothing_px, |inverse| (n, sum) = (n + 1.0, sum + (inverse - centre)));
        1.0 / (centre + sum / n)
    })
}

fn per_pixel(depth: &Depth, value: impl Fn(usize, usize, f64) -> f64 + Sync) -> Vec<f32> {
    let mut values = vec![f32::NAN; depth.z.len()];
    values.par_chunks_mut(depth.width.max(1)).enumerate().for_each(|(row, line)| {
        let depths_m = &depth.z[row * depth.width..(row + 1) * depth.width];
        for (column, out) in line.iter_mut().enumerate().filter(|(column, _)| depths_m[*column].is_finite()) {
            *out = value(column, row, 1.0 / f64::from(depths_m[column])) as f32;
        }
    });
    values
}

fn for_window(depth: &Depth, column: usize, row: usize, half: usize, mut take: impl FnMut(f64)) {
    let range = |centre: usize, size: usize| centre.saturating_sub(half)..(centre + half + 1).min(size);
    for row in range(row, depth.height) {
        for column in range(column, depth.width) {
            let z = depth.z[row * depth.width + column];
            if z.is_finite() {
                take(1.0 / f64::from(z));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::{image_at, small_sensor};

    /// A map of 20 x 20 pixels with a given inverse depth.
    fn map(inverse: impl Fn(usize, usize) -> f64) -> Depth {
        let z = (0..400).map(|i| (1.0 / inverse(i % 20, i / 20)) as f32).collect();
        let (sensor, image) = (small_sensor(), image_at("a", [0.0; 3], [0.0; 3]));
        Depth { frame: Frame::Wall, sensor, image, downscale: 1, width: 20, height: 20, z, channels: [].into() }
    }

    #[test]
    fn relief_of_a_slope_and_of_a_step() {
        let slope = relief(&map(|column, _| 0.1 + 1e-4 * column as f64), 2);
        assert!((f64::from(slope[10 * 20 + 10]) / (1e-4 * 2f64.sqrt()) - 1.0).abs() < 1e-3);
        let step = relief(&map(|column, _| if column < 10 { 0.1 } else { 0.2 }), 1);
        assert!(step[5].abs() < 1e-9);
        // Two of three columns on one side: sqrt(2) / 3 of the step.
        assert!((f64::from(step[10 * 20 + 9]) / (0.1 * 2f64.sqrt() / 3.0) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn the_near_side_grows_by_the_reach_and_holes_stay() {
        let mut depth = map(|column, _| if column < 10 { 0.1 } else { 0.2 });
        depth.z[3] = f32::NAN;
        let effects = WindowEffects { smoothing_px: 0, fattening_px: 2, step_m: 1.0 };
        let seen = seen_depth(&depth, &effects);
        assert_eq!([7, 8, 9, 10].map(|column| seen[100 + column].round() as u32), [10, 5, 5, 5]);
        assert!(seen[3].is_nan() && (seen[2] - 10.0).abs() < 1e-5);
        let smooth = seen_depth(&depth, &WindowEffects { smoothing_px: 1, fattening_px: 0, ..effects });
        assert!((1.0 / smooth[109] - 0.4 / 3.0).abs() < 1e-6, "{}", 1.0 / smooth[109]);
    }
}
