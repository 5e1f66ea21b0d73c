//! What one row of a rectified image shows: the paper's grid of disparities, one of its own for every pair.
//!
//! A pixel of the rectified image is a ray of the noisy camera, which is a position in the image, which is a ray of the true
//! camera; the true point lies on that one, at the ideal depth there (SCIENCE B1; paper 2.1.2, Algorithm 2 lines 7 to 12).

use nalgebra::Vector3;

use super::rectification::Rectification;
use crate::camera::depth_window::{DepthWindow, pixel_at};
use crate::camera::model::Camera;
use crate::camera::orientation::quaternion;
use crate::matching::pixel_row::OwnRow;
use rockface_core::artefact::{Depth, Image, Sensor};
use rockface_core::numerics::simd::Number;

/// Normalised coordinates of a pixel of rectified image `side`.
#[inline(always)]
pub fn rectified_ray<T: Number>(rectification: &Rectification, side: usize, [column, row]: [T; 2]) -> [T; 2] {
    let f = rectification.focal_px;
    [(column - rectification.centre_x_px[side]) / f, (row - rectification.centre_y_px) / f]
}

/// Where a ray of the noisy camera lies in the depth map, pixels of the map.
fn position(depth: &Depth, noisy: &Camera, noisy_ray: [f64; 2]) -> Option<[f64; 2]> {
    let scale = 1.0 / f64::from(depth.downscale);
    Some(noisy.pixel(noisy_ray)?.map(|p| (p + 0.5) * scale - 0.5))
}

/// The pixel of the depth map a ray of the noisy camera lies in, as an index.
pub fn source_pixel(depth: &Depth, noisy: &Camera, noisy_ray: [f64; 2]) -> Option<usize> {
    pixel_at(depth.width, depth.height, position(depth, noisy, noisy_ray)?)
}

/// A row of rectified image `side`, of the size of the depth map, by the true and the noisy camera.
pub fn rectified_row(
    depth: &Depth,
    [camera, noisy]: [&Camera; 2],
    rectification: &Rectification,
    side: usize,
    row: usize,
) -> OwnRow {
    let window = DepthWindow::of(depth);
    let back = rectification.rectified_from_camera[side].transpose();
    let scale = f64::from(depth.downscale);
    let pixel = |column: usize| {
        let [x, y] = rectified_ray(rectification, side, [column as f64, row as f64]);
        let ray = back * Vector3::new(x, y, 1.0);
        let noisy_ray = (ray.z > 0.0).then(|| [ray.x / ray.z, ray.y / ray.z])?;
        let position = position(depth, noisy, noisy_ray)?;
        let z_m = window.z_at(position)?;
        let true_ray = camera.normalised_near(position.map(|p| (p + 0.5) * scale - 0.5), noisy_ray)?;
        Some((camera.unproject(true_ray, z_m), noisy_ray))
    };
    let mut own = OwnRow::empty(row, depth.width);
    for column in 0..depth.width {
        if let Some((point_m, noisy_ray)) = pixel(column) {
            own.push(column, &point_m, noisy_ray);
        }
    }
    own
}

/// The camera of rectified image `side`: no distortion, the rotation of the pair, the centre of the noisy image.
pub fn rectified_camera(
    rectification: &Rectification,
    side: usize,
    depth: &Depth,
    noisy: (&Sensor, &Image),
) -> (Sensor, Image) {
    let scale = f64::from(depth.downscale);
    let full = |centre_px: f64| (centre_px + 0.5) * scale - 0.5;
    let sensor = Sensor {
        f: rectification.focal_px * scale,
        cx: full(rectification.centre_x_px[side]),
        cy: full(rectification.centre_y_px),
        b1: 0.0,
        b2: 0.0,
        k: [0.0; 4],
        p: [0.0; 2],
        ..noisy.0.clone()
    };
    let mut image = Image { sensor: 0, ..noisy.1.clone() };
    image.set_rotation(&quaternion(&(rectification.rectified_from_camera[side] * noisy.1.matrix())));
    (sensor, image)
}
