//! One pixel of a depth map: its position in the image, its ray, its point.

use crate::camera::model::{Camera, full_pixel};
use rockface_core::artefact::Depth;

/// One pixel of a depth map, in the frame of its camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPixel {
    /// Position of its centre in the full image, pixels from the centre of the first.
    pub full_px: [f64; 2],
    /// Undistorted normalised coordinates of its ray.
    pub ray: [f64; 2],
    /// Depth along the optical axis, metres.
    pub z_m: f64,
    /// Distance along the ray, metres.
    pub range_m: f64,
    /// The object point in the frame of the depth map, metres.
    pub point_m: [f64; 3],
}

/// The pixel of a depth map at a column and row; `None` outside the map, or where it has no depth.
pub fn pixel(depth: &Depth, column: usize, row: usize) -> Option<DepthPixel> {
    let inside = column < depth.width && row < depth.height;
    let z_m = f64::from(*depth.z.get(row * depth.width + column).filter(|z| inside && z.is_finite())?);
    let camera = Camera::of_depth(depth);
    let full_px = full_pixel(column, row, depth.downscale);
    let ray = camera.normalised(full_px)?;
    let range_m = z_m * (ray[0] * ray[0] + ray[1] * ray[1] + 1.0).sqrt();
    Some(DepthPixel { full_px, ray, z_m, range_m, point_m: camera.unproject(ray, z_m).into() })
}
