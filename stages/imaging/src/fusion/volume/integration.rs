//! Adds depth maps to a volume of signed distances, one after the other: the bits do not depend on the number of threads.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::blocks::{SIDE, VOXELS, Volume};
use crate::camera::model::Camera;
use rockface_core::artefact::Depth;

/// Sigma that has weight 1, metres.
const UNIT_SIGMA_M: f64 = 0.01;

/// A depth map prepared for lookups.
struct View<'a> {
    depth: &'a Depth,
    camera: Camera,
    sigma: Option<&'a [f32]>,
    /// Least and largest depth, metres.
    range_m: [f64; 2],
    pinhole: bool,
}

/// Adds a depth map; weights are `1 / sigma^2` where a map of sigma (metres) is given, 1 elsewhere.
///
/// A voxel gets the distance along its ray from the map's surface, in truncations: 1 far before it; nothing further than one
/// truncation behind it.
pub fn integrate(volume: &mut Volume, depth: &Depth, sigma: Option<&[f32]>) {
    let seen = depth.z.iter().filter(|z| Depth::is_seen(**z));
    let range_m = seen.fold([f64::INFINITY, 0.0], |[a, b], z| [a.min(f64::from(*z)), b.max(f64::from(*z))]);
    let sensor = &depth.sensor;
    let pinhole = sensor.k.iter().chain(&sensor.p).all(|coefficient| coefficient.abs() <= 0.0);
    let view = View { depth, camera: Camera::of_depth(depth), sigma, range_m, pinhole };
    let layout = volume.layout;
    let blocks = (volume.keys.par_iter())
        .zip(volume.distance.par_chunks_mut(VOXELS))
        .zip(volume.weight.par_chunks_mut(VOXELS))
        .zip(volume.maps.par_chunks_mut(VOXELS));
    blocks.with_min_len(64).for_each(|(((key, distance), weight), maps)| {
        let first = Vector3::from(key.map(|a| f64::from(a * SIDE) * layout.voxel_m));
        let corner = view.camera.to_camera(&first);
        let steps = [0, 1, 2].map(|axis| view.camera.camera_from_object().column(axis) * layout.voxel_m);
        if !view.may_see(&corner, &steps, layout.truncation_m) {
            return;
        }
        for voxel in 0..VOXELS {
            let [i, j, k] = [voxel & 7, voxel >> 3 & 7, voxel >> 6].map(|n| n as f64);
            let at = corner + steps[0] * i + steps[1] * j + steps[2] * k;
            if let Some((along, share)) = view.distance(&at, layout.truncation_m) {
                distance[voxel] += share * along;
                weight[voxel] += share;
                maps[voxel] = maps[voxel].saturating_add(1);
            }
        }
    });
}

impl View<'_> {
    /// Whether a block with this first corner and these steps in the camera frame can be seen and is near the surface.
    fn may_see(&self, corner: &Vector3<f64>, steps: &[Vector3<f64>; 3], truncation_m: f64) -> bool {
        let middle = corner + (steps[0] + steps[1] + steps[2]) * 3.5;
        let radius_m = 0.5 * 3f64.sqrt() * f64::from(SIDE) * steps[0].norm();
        if middle.z - radius_m > self.range_m[1] + truncation_m || middle.z - radius_m < 0.1 * self.range_m[0] {
            return false;
        }
        let Some([u, v]) = self.camera.project_from_camera(&middle) else { return false };
        let sensor = &self.depth.sensor;
        // Twice the radius leaves room for the lens.
        let margin = 2.0 * radius_m / (middle.z - radius_m) * sensor.f + 2.0;
        let (width, height) = (f64::from(sensor.width_px), f64::from(sensor.height_px));
        u > -margin && v > -margin && u < width + margin && v < height + margin
    }

    /// Distance of a point in the camera frame before the surface, in truncations, and its weight.
    fn distance(&self, at: &Vector3<f64>, truncation_m: f64) -> Option<(f32, f32)> {
        if at.z <= 0.0 {
            return None;
        }
        let [x, y] = [at.x / at.z, at.y / at.z];
        let sensor = &self.depth.sensor;
        let [u, v] = if self.pinhole {
            [sensor.cx + (sensor.f + sensor.b1) * x + sensor.b2 * y, sensor.cy + sensor.f * y]
        } else {
            self.camera.pixel([x, y])?
        };
        // Half a pixel up and rounded down is the nearest pixel; what lies left of the image is negative before rounding.
        let scale = f64::from(self.depth.downscale);
        let (column, row) = ((u + 0.5) / scale, (v + 0.5) / scale);
        if column < 0.0 || row < 0.0 || column >= self.depth.width as f64 || row >= self.depth.height as f64 {
            return None;
        }
        let pixel = row as usize * self.depth.width + column as usize;
        let z = f64::from(self.depth.z[pixel]);
        // A comparison with NaN is false.
        let behind = (at.z - z) * (1.0 + x * x + y * y).sqrt();
        if !(behind <= truncation_m && z > 0.0) {
            return None;
        }
        let weight = self.sigma.map_or(1.0, |sigma| {
            let ratio = UNIT_SIGMA_M / f64::from(sigma[pixel]);
            ratio * ratio
        });
        weight.is_finite().then(|| ((-behind / truncation_m).min(1.0) as f32, weight as f32))
    }
}
