//! What one row of an image shows, found once for all pairs of the image: true points, and the noisy rays they are taken for.

use nalgebra::Vector3;

use crate::artefact::Depth;
use crate::kernel::camera::Camera;
use crate::kernel::ray_row::RayRow;

/// A pixel that shows something.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OwnPixel {
    /// Its column in the depth map.
    pub column: usize,
    /// The true point, in the frame of the cameras, metres.
    pub point_m: Vector3<f64>,
    /// Undistorted normalised coordinates of the pixel in the noisy camera.
    pub noisy_ray: [f64; 2],
}

/// The pixels of a row that show something, from left to right.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnRow {
    /// The row in the depth map.
    pub row: usize,
    /// Its pixels.
    pub pixels: Vec<OwnPixel>,
}

impl OwnRow {
    /// A row of an ideal depth map, by its true and its noisy camera.
    pub fn new(depth: &Depth, camera: &Camera, noisy: &Camera, row: usize) -> Self {
        let values = &depth.z[row * depth.width..(row + 1) * depth.width];
        let same_interior = noisy.has_interior_of(camera);
        let mut rays = RayRow::new(camera, row, depth.downscale);
        let mut noisy_rays = RayRow::new(noisy, row, depth.downscale);
        let mut pixels = Vec::with_capacity(values.len());
        for (column, z) in values.iter().enumerate().filter(|(_, z)| z.is_finite()) {
            let Some(ray) = rays.ray(column) else { continue };
            let noisy_ray = if same_interior { Some(ray) } else { noisy_rays.ray(column) };
            let Some(noisy_ray) = noisy_ray else { continue };
            pixels.push(OwnPixel { column, point_m: camera.unproject(ray, f64::from(*z)), noisy_ray });
        }
        Self { row, pixels }
    }
}
