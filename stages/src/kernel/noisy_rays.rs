//! The rays that a camera with a wrong interior orientation takes the rays of the true one for.

use crate::kernel::camera::Camera;
use crate::kernel::whole::floor;

/// Image pixels between the places where the step from the true ray to the noisy one is known.
const SPACING_PX: f64 = 32.0;

/// Finds noisy rays of pixels whose true rays are known. The step from one to the other changes slowly over the image: a table of
/// it tells the noisy ray to 1e-8 or so, and Newton's method the rest. A ray depends on no other.
#[derive(Debug, Clone)]
pub struct NoisyRays {
    columns: usize,
    rows: usize,
    /// Noisy less true normalised coordinates at every [`SPACING_PX`] pixels from the first; NaN where there are none.
    steps: Vec<[f64; 2]>,
}

impl NoisyRays {
    /// The table of a camera and its true one.
    pub fn new(camera: &Camera, noisy: &Camera) -> Self {
        let count = |pixels: u32| (f64::from(pixels) / SPACING_PX).ceil() as usize + 2;
        let (columns, rows) = (count(camera.sensor().width_px), count(camera.sensor().height_px));
        let step = |at: usize| {
            // The first stands half a pixel or more before the image, the last beyond it.
            let place = |n: usize| (n as f64 - 0.5) * SPACING_PX;
            let pixel = [place(at % columns), place(at / columns)];
            match (camera.normalised(pixel), noisy.normalised(pixel)) {
                (Some(truth), Some(noisy)) => [noisy[0] - truth[0], noisy[1] - truth[1]],
                _ => [f64::NAN; 2],
            }
        };
        Self { columns, rows, steps: (0..columns * rows).map(step).collect() }
    }

    /// Undistorts a position with the noisy interior orientation; `true_ray` is what the true one makes of it.
    #[inline]
    pub fn ray(&self, noisy: &Camera, pixel: [f64; 2], true_ray: [f64; 2]) -> Option<[f64; 2]> {
        let near = self
            .step(pixel)
            .and_then(|step| noisy.normalised_near(pixel, [true_ray[0] + step[0], true_ray[1] + step[1]]));
        near.or_else(|| noisy.normalised(pixel))
    }

    /// The step at a position, between the four places around it.
    #[inline]
    fn step(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = pixel.map(|p| p / SPACING_PX + 0.5);
        let (column, row) = (floor(x), floor(y));
        let (tx, ty) = (x - f64::from(column), y - f64::from(row));
        let (column, row) = (column as usize, row as usize);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Sensor;
    use crate::testing::{image_at, small_sensor};

    #[test]
    fn rays_are_those_of_their_pixels() {
        let sensor = Sensor { k: [-0.3, 0.2, 0.0, 0.0], p: [0.01, 0.0], b2: 0.4, ..small_sensor() };
        let wrong = Sensor { f: sensor.f * 1.001, k: [-0.305, 0.21, 0.0, 0.0], cx: sensor.cx + 0.3, ..sensor.clone() };
        let camera = |sensor: &Sensor| Camera::new(sensor, &image_at("a", [0.0; 3], [0.0; 3]));
        let (camera, noisy) = (camera(&sensor), camera(&wrong));
        let rays = NoisyRays::new(&camera, &noisy);
        // The outermost corners of the image, all of it, and what lies beyond the table.
        for i in 0..400 {
            let pixel = [f64::from(i % 20) * 3.15 - 0.5, f64::from(i / 20) * 2.1 - 0.5];
            let [x, y] = rays.ray(&noisy, pixel, camera.normalised(pixel).unwrap()).unwrap();
            let [ex, ey] = noisy.normalised(pixel).unwrap();
            assert!((x - ex).abs() < 1e-15 && (y - ey).abs() < 1e-15, "{i}: {x} {ex} {y} {ey}");
        }
        assert_eq!(rays.ray(&noisy, [-90.0, 3.0], [0.0; 2]), noisy.normalised([-90.0, 3.0]));
    }
}
