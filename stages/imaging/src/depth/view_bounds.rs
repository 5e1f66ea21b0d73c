//! What lies beside the field of view of a camera as a whole, and need not be projected.

use nalgebra::Vector3;

use crate::camera::model::Camera;

/// Pixels between the places along the edge of an image whose rays are looked at.
const STEP_PX: f64 = 8.0;

/// Bounds of the normalised coordinates of all pixels of an image.
///
/// A plane through the projection centre bounds a half-space: a triangle whose corners all lie beyond one of the four planes is met by no
/// ray of the image, before the camera as well as behind it.
#[derive(Debug, Clone, Copy)]
pub struct ViewBounds {
    /// Least and largest x.
    x: [f64; 2],
    /// Least and largest y.
    y: [f64; 2],
}

impl ViewBounds {
    /// Those of a camera; without bounds where the edge of its image has places that no ray comes from.
    ///
    /// Distortion maps the inside of the fold one to one, so that the rays of all pixels lie within those of the edge. Between two places
    /// that are looked at, the edge goes no farther than from one to the other.
    pub fn of(camera: &Camera) -> Self {
        let sensor = camera.sensor();
        let (right, bottom) = (f64::from(sensor.width_px), f64::from(sensor.height_px));
        let along = |length: f64| {
            let steps = (length / STEP_PX).ceil();
            (0..=steps as u64).map(move |step| length * (step as f64 / steps) - 0.5)
        };
        let horizontal = [-0.5, bottom - 0.5].map(|v| along(right).map(move |u| [u, v]).collect::<Vec<_>>());
        let vertical = [-0.5, right - 0.5].map(|u| along(bottom).map(move |v| [u, v]).collect::<Vec<_>>());
        let (mut bounds, mut margin) = ([[f64::INFINITY, f64::NEG_INFINITY]; 2], [0.0f64; 2]);
        for edge in horizontal.iter().chain(&vertical) {
            let mut last: Option<[f64; 2]> = None;
            for pixel in edge {
                let Some(ray) = camera.normalised(*pixel) else { return Self::NONE };
                for axis in 0..2 {
                    let [low, high] = bounds[axis];
                    bounds[axis] = [low.min(ray[axis]), high.max(ray[axis])];
                    margin[axis] = margin[axis].max(last.map_or(0.0, |last| (ray[axis] - last[axis]).abs()));
                }
                last = Some(ray);
            }
        }
        let [x, y] = [0, 1].map(|axis| [bounds[axis][0] - margin[axis], bounds[axis][1] + margin[axis]]);
        Self { x, y }
    }

    /// No bounds: nothing lies beyond them.
    const NONE: Self = Self { x: [f64::NAN; 2], y: [f64::NAN; 2] };

    /// The planes that a point of the camera frame, metres, lies beyond, a bit each; points that share one are on the same side of it.
    #[inline(always)]
    pub fn beyond(&self, point: &Vector3<f64>) -> u8 {
        let Self { x: [left, right], y: [top, bottom] } = *self;
        u8::from(point.x < left * point.z)
            | u8::from(point.x > right * point.z) << 1
            | u8::from(point.y < top * point.z) << 2
            | u8::from(point.y > bottom * point.z) << 3
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rockface_core::artefact::{Image, Sensor};

    fn camera(k: [f64; 2], p: [f64; 2]) -> Camera {
        let (k, name) = ([k[0], k[1], 0.0, 0.0], String::new());
        let sensor = Sensor {
            name: name.clone(),
            width_px: 300,
            height_px: 200,
            f: 240.0,
            cx: 148.0,
            cy: 101.5,
            b1: 0.0,
            b2: 0.0,
            k,
            p,
        };
        let image = Image { name, sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: [0.0; 3] };
        Camera::new(&sensor, &image)
    }

    proptest! {
        #[test]
        fn no_ray_of_a_pixel_lies_beyond(
            k1 in -0.3f64..0.3, k2 in -0.1f64..0.1, p1 in -0.01f64..0.01, p2 in -0.01f64..0.01, z in 0.1f64..50.0) {
            let camera = camera([k1, k2], [p1, p2]);
            let bounds = ViewBounds::of(&camera);
            for (u, v) in (0..300).flat_map(|u| (0..200).map(move |v| (u, v))).filter(|(u, v)| (u + v) % 7 == 0) {
                if let Some([x, y]) = camera.normalised([f64::from(u), f64::from(v)]) {
                    prop_assert_eq!(bounds.beyond(&Vector3::new(x * z, y * z, z)), 0);
                }
            }
        }
    }

    #[test]
    fn what_lies_beside_the_image_is_beyond_and_without_bounds_nothing_is() {
        let bounds = ViewBounds::of(&camera([-0.1, 0.02], [0.001, 0.0]));
        let beyond = |x: f64, y: f64, z: f64| bounds.beyond(&Vector3::new(x, y, z));
        assert_eq!([beyond(-1.0, 0.0, 1.0), beyond(1.0, 0.0, 1.0)], [1, 2]);
        assert_eq!([beyond(0.0, -1.0, 1.0), beyond(0.0, 1.0, 1.0)], [4, 8]);
        assert_eq!(beyond(1.0, 1.0, 1.0), 10);
        // A point behind the camera is beyond all planes or none of a pair.
        assert_eq!(beyond(0.0, 0.0, -1.0), 15);
        let folded = ViewBounds::of(&camera([-1.5, 0.0], [0.0, 0.0]));
        assert_eq!(folded.beyond(&Vector3::new(-100.0, 7.0, 1.0)), 0);
    }
}
