//! The pixels of one row of a rectified image: the paper's grid of disparities, which differs from pair to pair.
//!
//! A pixel of the rectified image is a ray of the noisy camera; this is a position in the image, and this a ray of the true
//! camera, on which the true point lies at the ideal depth of the position (paper 2.1.2, Algorithm 2 lines 7 to 12).

use nalgebra::Vector3;

use crate::camera::depth_window::{DepthWindow, pixel_at};
use crate::camera::model::Camera;
use crate::camera::orientation::quaternion;
use crate::matching::pair_geometry::PairGeometry;
use crate::matching::pixel_row::PixelRow;
use crate::matching::rectification::Rectification;
use crate::matching::side::Side;
use rockface_core::artefact::{Depth, Image, Sensor};
use rockface_core::numerics::simd::Number;

/// Normalised coordinates of a pixel of rectified image `side`.
#[inline(always)]
pub fn rectified_ray<T: Number>(rectification: &Rectification, side: Side, [column, row]: [T; 2]) -> [T; 2] {
    let f = rectification.focal_px;
    [(column - rectification.centre_x_px[side]) / f, (row - rectification.centre_y_px) / f]
}

/// Position of a ray of the noisy camera in the depth map, pixels of the map.
fn position(depth: &Depth, noisy: &Camera, noisy_ray: [f64; 2]) -> Option<[f64; 2]> {
    let scale = 1.0 / f64::from(depth.downscale);
    Some(noisy.pixel(noisy_ray)?.map(|p| (p + 0.5) * scale - 0.5))
}

/// Index of the pixel of the depth map in which a ray of the noisy camera lies.
pub fn source_pixel(depth: &Depth, noisy: &Camera, noisy_ray: [f64; 2]) -> Option<usize> {
    pixel_at(depth.width, depth.height, position(depth, noisy, noisy_ray)?)
}

/// A row of rectified image `side`, which has the size of the depth map.
pub fn rectified_row(geometry: &PairGeometry, side: Side, row: usize) -> PixelRow {
    let (depth, camera, noisy) = (geometry.ideal[side], &geometry.cameras[side], &geometry.noisy[side]);
    let rectification = &geometry.rectification;
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
    let mut pixels = PixelRow::empty(row, depth.width);
    for column in 0..depth.width {
        if let Some((point_m, noisy_ray)) = pixel(column) {
            pixels.push(column, &point_m, noisy_ray);
        }
    }
    pixels
}

/// The camera of rectified image `side`: no distortion, the rotation of the pair, the centre of the noisy image `noisy`.
pub fn rectified_camera(geometry: &PairGeometry, side: Side, noisy: &Image) -> (Sensor, Image) {
    let rectification = &geometry.rectification;
    let scale = f64::from(geometry.ideal[side].downscale);
    let full = |centre_px: f64| (centre_px + 0.5) * scale - 0.5;
    let sensor = Sensor {
        f: rectification.focal_px * scale,
        cx: full(rectification.centre_x_px[side]),
        cy: full(rectification.centre_y_px),
        b1: 0.0,
        b2: 0.0,
        k: [0.0; 4],
        p: [0.0; 2],
        ..geometry.noisy[side].sensor().clone()
    };
    let mut image = Image { sensor: 0, ..noisy.clone() };
    image.set_rotation(&quaternion(&(rectification.rectified_from_camera[side] * noisy.matrix())));
    (sensor, image)
}
