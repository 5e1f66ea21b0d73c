//! Undistorted rays along one row of a depth map, each found from the one before it.

use crate::kernel::camera::{Camera, full_pixel};

/// Finds the rays of a row from left to right; columns may be left out. A ray depends on those found before it in its
/// row only in its last bits, and on no other row.
pub struct RayRow<'a> {
    camera: &'a Camera,
    downscale: u32,
    /// Distorted normalised y of the row.
    yd: f64,
    near: Option<[f64; 2]>,
}

impl<'a> RayRow<'a> {
    /// The rays of a row of an image reduced by `downscale`.
    pub fn new(camera: &'a Camera, row: usize, downscale: u32) -> Self {
        let [_, v] = full_pixel(0, row, downscale);
        Self { camera, downscale, yd: camera.distorted_y(v), near: None }
    }

    /// Undistorted normalised coordinates of the centre of a pixel; `None` where the distortion has no inverse.
    #[inline]
    pub fn ray(&mut self, column: usize) -> Option<[f64; 2]> {
        let [u, _] = full_pixel(column, 0, self.downscale);
        self.near = self.camera.normalised_in_row(u, self.yd, self.near);
        self.near
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Sensor;
    use crate::testing::{image_at, small_sensor};

    #[test]
    fn rays_of_a_row_are_those_of_its_pixels() {
        let sensor = Sensor { k: [-0.3, 0.2, 0.0, 0.0], p: [0.01, 0.0], b2: 0.4, ..small_sensor() };
        let camera = Camera::new(&sensor, &image_at("a", [0.0; 3], [0.0; 3]));
        let mut row = RayRow::new(&camera, 3, 2);
        for column in (0..30).filter(|column| column % 7 != 2) {
            let [x, y] = row.ray(column).unwrap();
            let [ex, ey] = camera.normalised(full_pixel(column, 3, 2)).unwrap();
            assert!((x - ex).abs() < 1e-15 && (y - ey).abs() < 1e-15);
        }
    }
}
