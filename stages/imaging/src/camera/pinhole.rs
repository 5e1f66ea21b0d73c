//! Depth maps resampled to a camera without distortion, with normals: the input of other programs' fusion.
//!
//! On a plane, inverse depth is an affine function of the ray. The depth on a ray of the new pixel grid is that of the nearest
//! old pixel, extrapolated by the slope of the inverse depth about it: exact on planes, and the noise of a pixel is neither
//! averaged nor mixed with that of its neighbours.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::camera::depth_window::{DepthWindow, STEP, Slope, pixel_at};
use crate::camera::model::Camera;
use rockface_core::artefact::{Depth, Sensor};

/// Side of the squares of pixels that share a regression where windows are wide.
const BLOCK: usize = 4;

/// A depth map on the pixels of a camera without distortion. Pixel centres are whole numbers, the first is (0, 0).
#[derive(Debug, Clone, PartialEq)]
pub struct PinholeMap {
    /// Number of columns of the resampled map.
    pub width: usize,
    /// Number of rows of the resampled map.
    pub height: usize,
    /// Principal distances along x and y, pixels of the map.
    pub focal_px: [f64; 2],
    /// Principal point, pixels of the map.
    pub centre_px: [f64; 2],
    /// Depth along the optical axis, metres, by row from the top; NaN where there is none.
    pub z: Vec<f32>,
}

impl PinholeMap {
    /// The map of an image without its distortion, of the same size. A sensor without distortion and skew keeps the bits of its
    /// depths. The bits do not depend on the number of threads.
    pub fn of(depth: &Depth) -> Self {
        let (sensor, scale) = (&depth.sensor, f64::from(depth.downscale));
        let mut map = Self {
            width: depth.width,
            height: depth.height,
            focal_px: [(sensor.f + sensor.b1) / scale, sensor.f / scale],
            centre_px: [sensor.cx, sensor.cy].map(|c| (c + 0.5) / scale - 0.5),
            z: depth.z.clone(),
        };
        if !is_plain(sensor) {
            map.z = map.carried(depth);
        }
        map
    }

    /// Normalised coordinates of the ray of a position.
    pub fn ray(&self, [column, row]: [f64; 2]) -> [f64; 2] {
        [(column - self.centre_px[0]) / self.focal_px[0], (row - self.centre_px[1]) / self.focal_px[1]]
    }

    /// The pixel, as an index, and the position of a point in the camera frame; `None` behind the camera and outside.
    pub fn place(&self, point: &Vector3<f64>) -> Option<(usize, [f64; 2])> {
        let at = |i: usize| self.focal_px[i] * point[i] / point.z + self.centre_px[i];
        let position = [at(0), at(1)];
        let index = pixel_at(self.width, self.height, position)?;
        (point.z > 0.0).then_some((index, position))
    }

    /// Depths of a distorted map on the rays of this one.
    fn carried(&self, depth: &Depth) -> Vec<f32> {
        let camera = Camera::of_depth(depth);
        let source = DepthWindow::of(depth);
        let scale = 1.0 / f64::from(depth.downscale);
        let value = |row: usize, column: usize| {
            let pixel = camera.pixel(self.ray([column as f64, row as f64]))?;
            source.z_at(pixel.map(|p| (p + 0.5) * scale - 0.5)).map(|z| z as f32)
        };
        let row = |row: usize| (0..self.width).map(move |column| value(row, column).unwrap_or(f32::NAN));
        (0..self.height).into_par_iter().flat_map_iter(row).collect()
    }

    /// Unit normals in the camera frame, towards the camera, by regression over windows of `2 reach + 1` pixels a side;
    /// NaN without a depth. An isolated pixel has a normal along its ray. The bits do not depend on the number of threads.
    pub fn normals(&self, reach: usize) -> Vec<[f32; 3]> {
        let window = DepthWindow { z: &self.z, width: self.width, height: self.height, reach };
        let block = if reach >= BLOCK { BLOCK } else { 1 };
        let mut normals = vec![[f32::NAN; 3]; self.z.len()];
        normals.par_chunks_mut(block * self.width).enumerate().for_each(|(band, rows)| {
            for first in (0..self.width).step_by(block) {
                self.fill_block(&window, [band * block, first], block, rows);
            }
        });
        normals
    }

    /// Fills the normals of a block; `rows` begins at its first row.
    fn fill_block(&self, window: &DepthWindow, [top, left]: [usize; 2], block: usize, rows: &mut [[f32; 3]]) {
        let (bottom, right) = ((top + block).min(self.height), (left + block).min(self.width));
        let z_at = |row: usize, column: usize| f64::from(self.z[row * self.width + column]);
        let middle = [(top + block / 2).min(bottom - 1), (left + block / 2).min(right - 1)];
        let mut pixels = (top..bottom).flat_map(|row| (left..right).map(move |column| [row, column]));
        let seed = std::iter::once(middle).chain(pixels.clone()).find(|[row, column]| z_at(*row, *column).is_finite());
        let Some(seed) = seed else { return };
        let seed_z = z_at(seed[0], seed[1]);
        let shared = self.normal(window, seed, seed_z);
        pixels.by_ref().filter(|[row, column]| z_at(*row, *column).is_finite()).for_each(|pixel| {
            let z = z_at(pixel[0], pixel[1]);
            let same = (z - seed_z).abs() <= STEP * seed_z;
            let normal = if same { shared } else { self.normal(window, pixel, z) };
            rows[(pixel[0] - top) * self.width + pixel[1]] = normal;
        });
    }

    /// The normal about a pixel at depth `z_m`: with inverse depth a x + b y + c over the rays (x, y, 1), that of the plane
    /// is (a, b, c).
    fn normal(&self, window: &DepthWindow, [row, column]: [usize; 2], z_m: f64) -> [f32; 3] {
        let plane = window.slope(row, column, z_m).map_or_else(
            || {
                let [x, y] = self.ray([column as f64, row as f64]);
                Vector3::new(x, y, 1.0)
            },
            |Slope { inverse, across, down }| {
                let [from_x, from_y] = [self.centre_px[0] - column as f64, self.centre_px[1] - row as f64];
                let at_axis = inverse + across * from_x + down * from_y;
                Vector3::new(across * self.focal_px[0], down * self.focal_px[1], at_axis)
            },
        );
        let unit = -plane.normalize();
        [unit.x as f32, unit.y as f32, unit.z as f32]
    }
}

/// Whether a sensor maps rays to pixels by principal distances and point alone.
fn is_plain(sensor: &Sensor) -> bool {
    sensor.b2 == 0.0 && sensor.k.iter().chain(&sensor.p).all(|coefficient| *coefficient == 0.0)
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::camera::model::full_pixel;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::{image_at, small_sensor};

    /// The depth map of the plane n . X = d of the camera frame.
    fn plane(sensor: Sensor, normal: Vector3<f64>, d: f64, downscale: u32) -> Depth {
        let image = image_at("a", [0.0; 3], [0.0; 3]);
        let camera = Camera::new(&sensor, &image);
        let (width, height) = ((60 / downscale) as usize, (40 / downscale) as usize);
        let z = |at: usize| {
            let [x, y] = camera.normalised(full_pixel(at % width, at / width, downscale)).unwrap();
            (d / normal.dot(&Vector3::new(x, y, 1.0))) as f32
        };
        let z = (0..width * height).map(z).collect();
        Depth { frame: Frame::Wall, sensor, image, downscale, width, height, z, channels: BTreeMap::new() }
    }

    #[test]
    fn a_plane_stays_a_plane_without_its_distortion() {
        // 100 pixels to the principal distance: within half a pixel this lens bends by more than a real one does in ten,
        // and within half a cell of two pixels by four times that.
        let sensor = Sensor { k: [-0.3, 0.2, 0.0, 0.0], p: [0.01, -0.005], b1: 1.5, b2: 0.7, ..small_sensor() };
        let normal = Vector3::new(0.3, -0.2, 0.9).normalize();
        for downscale in [1, 2] {
            let map = PinholeMap::of(&plane(sensor.clone(), normal, 15.0, downscale));
            let mut seen = 0;
            for (at, z) in map.z.iter().enumerate().filter(|(_, z)| !z.is_nan()) {
                let [x, y] = map.ray([(at % map.width) as f64, (at / map.width) as f64]);
                let truth = 15.0 / normal.dot(&Vector3::new(x, y, 1.0));
                let bound_m = 1e-4 * f64::from(downscale * downscale);
                assert!((f64::from(*z) - truth).abs() < bound_m, "{z} instead of {truth}");
                seen += 1;
            }
            assert!(seen * 10 > map.z.len() * 9, "{seen} of {}", map.z.len());
            for reach in [2, 8] {
                for estimate in map.normals(reach).iter().filter(|n| !n[0].is_nan()) {
                    assert!((Vector3::from(*estimate).map(f64::from) + normal).norm() < 5e-3);
                }
            }
        }
    }

    #[test]
    fn without_distortion_every_bit_stays() {
        let depth = plane(small_sensor(), Vector3::new(0.1, 0.0, 1.0), 20.0, 2);
        let map = PinholeMap::of(&depth);
        assert_eq!(map.z, depth.z);
        assert!((map.focal_px[0] - 50.0).abs() < 1e-12 && (map.centre_px[0] - 14.5).abs() < 1e-12);
        let camera = Camera::of_depth(&depth);
        let [x, y] = camera.normalised(full_pixel(3, 5, 2)).unwrap();
        let [mx, my] = map.ray([3.0, 5.0]);
        assert!((x - mx).abs() < 1e-15 && (y - my).abs() < 1e-15);
        assert_eq!(map.place(&Vector3::new(x * 20.0, y * 20.0, 20.0)).unwrap().0, 5 * 30 + 3);
        assert!(map.place(&Vector3::new(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn a_step_is_not_bridged_and_a_lone_pixel_faces_the_camera() {
        let mut depth = plane(small_sensor(), Vector3::z(), 20.0, 1);
        for (at, z) in depth.z.iter_mut().enumerate() {
            *z = match at % 60 {
                0..30 => 20.0,
                _ if at == 20 * 60 + 50 => 40.0,
                _ => 25.0,
            };
        }
        let map = PinholeMap::of(&depth);
        let normals = map.normals(8);
        for (at, normal) in normals.iter().enumerate().filter(|(at, _)| *at != 20 * 60 + 50) {
            assert!((normal[2] + 1.0).abs() < 1e-6, "{at}: {normal:?}");
        }
        let [x, y] = map.ray([50.0, 20.0]);
        let alone = Vector3::from(normals[20 * 60 + 50]).map(f64::from);
        assert!((alone + Vector3::new(x, y, 1.0).normalize()).norm() < 1e-6);
    }
}
