//! Derivatives of the collinearity equations by exterior orientation, interior orientation and object point.

use nalgebra::Vector3;

use crate::camera::model::{Camera, distort, distortion_jacobian};
use crate::camera::orientation_parameters::{EXTERIOR, INTERIOR};

/// A pixel and its derivatives; rows are u and v.
#[derive(Debug, Clone, PartialEq)]
pub struct Partials {
    /// The pixel, first centre at (0, 0).
    pub pixel: [f64; 2],
    /// By rx, ry, rz (left, camera frame, px/rad) and X, Y, Z of the projection centre (px/m).
    pub exterior: [[f64; EXTERIOR.len()]; 2],
    /// By f, cx, cy, b1, b2 (px/px) and k1 to k4, p1, p2 (px).
    pub interior: [[f64; INTERIOR.len()]; 2],
    /// By X, Y, Z of the object point, px/m.
    pub point: [[f64; 3]; 2],
}

impl Partials {
    /// The derivatives at an object point; `None` where it has no pixel.
    pub fn new(camera: &Camera, point: &Vector3<f64>) -> Option<Self> {
        let local = camera.to_camera(point);
        let pixel = camera.project_from_camera(&local)?;
        let s = camera.sensor();
        let (x, y, z) = (local.x / local.z, local.y / local.z, local.z);
        let [[dxx, dxy], [dyx, dyy]] = distortion_jacobian(s, x, y);
        let fx = s.f + s.b1;
        // Pixel by normalised undistorted coordinates.
        let [[a, b], [c, d]] = [[fx * dxx + s.b2 * dyx, fx * dxy + s.b2 * dyy], [s.f * dyx, s.f * dyy]];
        // Pixel by the point in the camera frame.
        let by_local = [[a, b], [c, d]].map(|[p, q]| Vector3::new(p / z, q / z, -(p * x + q * y) / z));
        let rotation = camera.camera_from_object();
        let by_point = by_local.map(|row| rotation.tr_mul(&row));
        let by_rotation = by_local.map(|row| local.cross(&row));
        let row = |i: usize| {
            let (turn, shift) = (by_rotation[i], -by_point[i]);
            [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
        };
        let interior = interior(camera, x, y);
        Some(Self { pixel, exterior: [row(0), row(1)], interior, point: by_point.map(Into::into) })
    }
}

fn interior(camera: &Camera, x: f64, y: f64) -> [[f64; INTERIOR.len()]; 2] {
    let s = camera.sensor();
    let [xd, yd] = distort(s, x, y);
    let r2 = x * x + y * y;
    let by = |dx: f64, dy: f64| [(s.f + s.b1) * dx + s.b2 * dy, s.f * dy];
    let radial = [r2, r2 * r2, r2 * r2 * r2, r2 * r2 * r2 * r2].map(|power| by(x * power, y * power));
    let p1 = by(2.0 * x * y, r2 + 2.0 * y * y);
    let p2 = by(r2 + 2.0 * x * x, 2.0 * x * y);
    let [k1, k2, k3, k4] = radial;
    let columns = [[xd, yd], [1.0, 0.0], [0.0, 1.0], [xd, 0.0], [yd, 0.0], k1, k2, k3, k4, p1, p2];
    [columns.map(|column| column[0]), columns.map(|column| column[1])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::orientation_parameters::{Parameter, correct};
    use proptest::prelude::*;
    use rockface_core::artefact::{Cameras, Frame, Sensor};
    use rockface_core::testing::{image_at, small_sensor};

    fn block() -> Cameras {
        let sensor = Sensor { b1: 0.3, b2: -0.2, k: [-0.1, 0.05, 0.02, -0.01], p: [2e-3, -1e-3], ..small_sensor() };
        let images = vec![image_at("a", [1.0, -2.0, 20.0], [0.1, -0.05, 0.4])];
        Cameras { frame: Frame::Wall, sensors: vec![sensor], images }
    }

    fn project(cameras: &Cameras, point: &Vector3<f64>) -> [f64; 2] {
        Camera::new(&cameras.sensors[0], &cameras.images[0]).project(point).unwrap()
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_differences(x in -4.0..6.0f64, y in -4.0..1.0f64, z in -1.0..1.0f64) {
            let (cameras, point) = (block(), Vector3::new(x, y, z));
            let found = Partials::new(&Camera::new(&cameras.sensors[0], &cameras.images[0]), &point).unwrap();
            let by = |parameter: Parameter, step: f64| {
                let at = |step: f64| project(&correct(&cameras, &[(parameter, step)]).unwrap(), &point);
                let (high, low) = (at(step), at(-step));
                [0, 1].map(|row: usize| (high[row] - low[row]) / (2.0 * step))
            };
            for (place, step) in [1e-5, 1e-5, 1e-5, 1e-4, 1e-4, 1e-4].into_iter().enumerate() {
                let numeric = by(Parameter::Exterior(0, place), step);
                for (row, value) in numeric.iter().enumerate() {
                    prop_assert!((found.exterior[row][place] - value).abs() < 1e-5, "{} {} {}", place, found.exterior[row][place], value);
                }
            }
            for place in 0..INTERIOR.len() {
                let numeric = by(Parameter::Interior(0, place), 1e-4);
                for (row, value) in numeric.iter().enumerate() {
                    prop_assert!((found.interior[row][place] - value).abs() < 1e-7, "{} {}", place, value);
                }
            }
            for axis in 0..3 {
                let step = |size: f64| { let mut moved = point; moved[axis] += size; project(&cameras, &moved) };
                let (high, low) = (step(1e-4), step(-1e-4));
                for row in 0..2 {
                    prop_assert!((found.point[row][axis] - (high[row] - low[row]) / 2e-4).abs() < 1e-6);
                }
            }
        }
    }
}
