//! The rays of pixels by a wrong interior orientation, from their rays by the true one.

use std::ops::{Add, Mul, Sub};

use crate::camera::model::Camera;
use rockface_core::numerics::simd::{LANES, Lanes, Number, both};

/// Distance of the nodes at which the difference between noisy and true rays is tabulated, image pixels.
const SPACING_PX: f64 = 32.0;

/// Finds noisy rays of pixels whose true rays are known. The difference of the two varies slowly over the image: a table gives the
/// noisy ray to about 1e-8, and Newton's method refines it. No ray depends on another one.
#[derive(Debug, Clone)]
pub struct NoisyRays {
    columns: usize,
    rows: usize,
    /// Noisy minus true normalised coordinates at the nodes; NaN where a camera has no ray.
    steps: Vec<[f64; 2]>,
}

impl NoisyRays {
    /// The table of a camera and its true one.
    pub fn new(camera: &Camera, noisy: &Camera) -> Self {
        let count = |pixels: u32| (f64::from(pixels) / SPACING_PX).ceil() as usize + 2;
        let (columns, rows) = (count(camera.sensor().width_px), count(camera.sensor().height_px));
        let step = |at: usize| {
            // The nodes enclose the image: the first lies before it, the last beyond it.
            let place = |n: usize| (n as f64 - 0.5) * SPACING_PX;
            let pixel = [place(at % columns), place(at / columns)];
            match (camera.normalised(pixel), noisy.normalised(pixel)) {
                (Some(truth), Some(noisy)) => [noisy[0] - truth[0], noisy[1] - truth[1]],
                _ => [f64::NAN; 2],
            }
        };
        Self { columns, rows, steps: (0..columns * rows).map(step).collect() }
    }

    /// Undistorts positions with the noisy interior orientation; `true_ray` are their rays by the true one. NaN without a ray.
    #[inline(always)]
    pub fn ray_lanes(&self, noisy: &Camera, pixel: [Lanes; 2], true_ray: [Lanes; 2]) -> [Lanes; 2] {
        let [x, y] = both(pixel, |p| p / SPACING_PX + 0.5);
        let [across, down] = both([x, y], |p| p.map(f64::floor));
        let step = self.step_lanes([across, down], [x - across, y - down]);
        let guess = [true_ray[0] + step[0], true_ray[1] + step[1]];
        let mut rays = noisy.normalised_near_lanes(pixel, guess);
        if rays[0].every(|x| !x.is_nan()) {
            return rays;
        }
        // Where Newton's method fails from the guess, search from the pixel itself.
        for lane in 0..LANES {
            if rays[0][lane].is_nan()
                && !pixel[0][lane].is_nan()
                && let Some([x, y]) = noisy.normalised(pixel.map(|p| p[lane]))
            {
                rays[0].set(lane, x);
                rays[1].set(lane, y);
            }
        }
        rays
    }

    /// Differences of both coordinates at each position, `t` behind the node across and down from the first; NaN beyond the nodes.
    #[inline(always)]
    fn step_lanes(&self, [across, down]: [Lanes; 2], t: [Lanes; 2]) -> [Lanes; 2] {
        let mut same = true;
        for lane in 1..LANES {
            same &= (across[lane] - across[0]).abs() < 0.5 && (down[lane] - down[0]).abs() < 0.5;
        }
        // Most often all positions lie between the same nodes.
        if same {
            let [a, b, c, d] = self.nodes_about(across[0], down[0]);
            return [between(t, [a[0], b[0], c[0], d[0]]), between(t, [a[1], b[1], c[1], d[1]])];
        }
        let mut about = [[Lanes::NONE; 4]; 2];
        for lane in 0..LANES {
            for (place, node) in self.nodes_about(across[lane], down[lane]).into_iter().enumerate() {
                (0..2).for_each(|i| about[i][place].set(lane, node[i]));
            }
        }
        [between(t, about[0]), between(t, about[1])]
    }

    /// Differences at the nodes above left, above right, below left and below right of a place; NaN beyond the nodes.
    #[inline(always)]
    fn nodes_about(&self, across: f64, down: f64) -> [[f64; 2]; 4] {
        let (column, row) = (across as usize, down as usize);
        if across >= 0.0 && down >= 0.0 && column + 1 < self.columns && row + 1 < self.rows {
            let at = row * self.columns + column;
            let below = at + self.columns;
            return [self.steps[at], self.steps[at + 1], self.steps[below], self.steps[below + 1]];
        }
        [[f64::NAN; 2]; 4]
    }
}

/// Linear in both directions between values above left, above right, below left and below right.
#[inline(always)]
fn between<T, M>([tx, ty]: [T; 2], [above_left, above_right, below_left, below_right]: [M; 4]) -> T
where
    T: Number + Add<M, Output = T> + Mul<M, Output = T>,
    M: Copy + Sub<Output = M>,
{
    let top = tx * (above_right - above_left) + above_left;
    let bottom = tx * (below_right - below_left) + below_left;
    top + ty * (bottom - top)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Sensor;
    use rockface_core::numerics::fast_round::floor;
    use rockface_core::testing::{image_at, small_sensor};

    /// One position at a time.
    impl NoisyRays {
        /// Undistorts a position with the noisy interior orientation; `true_ray` is what the true one makes of it.
        fn ray(&self, noisy: &Camera, pixel: [f64; 2], true_ray: [f64; 2]) -> Option<[f64; 2]> {
            let near = self
                .step(pixel)
                .and_then(|step| noisy.normalised_near(pixel, [true_ray[0] + step[0], true_ray[1] + step[1]]));
            near.or_else(|| noisy.normalised(pixel))
        }

        /// The step at a position, between the four places around it.
        fn step(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
            let [x, y] = pixel.map(|p| p / SPACING_PX + 0.5);
            let (column, row) = (floor(x), floor(y));
            let (tx, ty) = (x - f64::from(column), y - f64::from(row));
            let (column, row) = (usize::try_from(column).ok()?, usize::try_from(row).ok()?);
            if column + 1 >= self.columns || row + 1 >= self.rows {
                return None;
            }
            let at = row * self.columns + column;
            let (above, below) = (&self.steps[at..at + 2], &self.steps[at + self.columns..at + self.columns + 2]);
            let between = |i: usize| {
                let (top, bottom) =
                    (above[0][i] + tx * (above[1][i] - above[0][i]), below[0][i] + tx * (below[1][i] - below[0][i]));
                top + ty * (bottom - top)
            };
            let step = [between(0), between(1)];
            (!step[0].is_nan()).then_some(step)
        }
    }

    #[test]
    fn rays_are_those_of_their_pixels() {
        let sensor = Sensor { k: [-0.3, 0.2, 0.0, 0.0], p: [0.01, 0.0], b2: 0.4, ..small_sensor() };
        let wrong = Sensor { f: sensor.f * 1.001, k: [-0.305, 0.21, 0.0, 0.0], cx: sensor.cx + 0.3, ..sensor.clone() };
        let camera = |sensor: &Sensor| Camera::new(sensor, &image_at("a", [0.0; 3], [0.0; 3]));
        let (camera, noisy) = (camera(&sensor), camera(&wrong));
        let rays = NoisyRays::new(&camera, &noisy);
        // All of the image with its corners, and positions beyond the table.
        for i in 0..400 {
            let pixel = [f64::from(i % 20) * 3.15 - 0.5, f64::from(i / 20) * 2.1 - 0.5];
            let [x, y] = rays.ray(&noisy, pixel, camera.normalised(pixel).unwrap()).unwrap();
            let [ex, ey] = noisy.normalised(pixel).unwrap();
            assert!((x - ex).abs() < 1e-15 && (y - ey).abs() < 1e-15, "{i}: {x} {ex} {y} {ey}");
        }
        for beyond in [-90.0, -20.0] {
            assert_eq!(rays.ray(&noisy, [beyond, 3.0], [0.0; 2]), noisy.normalised([beyond, 3.0]));
        }
        let u = Lanes::from([-90.0, -20.0, 0.0, 3.7, f64::NAN, 31.2, 59.0, 300.0]);
        let pixels = [0, 1, 2, 3, 4, 5, 6, 7].map(|lane| [u[lane], 7.5]);
        let truth = pixels.map(|pixel| camera.normalised(pixel).unwrap_or([f64::NAN; 2]));
        let lanes = [0, 1].map(|i| Lanes::of(|lane| truth[lane][i]));
        let lanes = rays.ray_lanes(&noisy, [u, Lanes::all(7.5)], lanes);
        for lane in 0..LANES {
            let expected = rays.ray(&noisy, pixels[lane], truth[lane]).unwrap_or([f64::NAN; 2]);
            assert_eq!(lanes.map(|value| value[lane].to_bits()), expected.map(f64::to_bits), "{lane}");
        }
    }
}
