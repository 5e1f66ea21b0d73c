//! Epipolar rectification of a calibrated pair onto the plane along the baseline that both images face best.
//!
//! Rows of the rectifying rotation: `b` along the baseline from the first to the second projection centre, `n` the
//! normalised part of the summed optical axes across `b`, and `y = n x b` between them. The plane maximises the sum of
//! the cosines to both axes (paper 2.1.2, Algorithm 2 lines 7 and 8; after Fusiello, Trucco and Verri 2000, made
//! symmetric). The principal distance keeps the mean area of a pixel at the principal points.

use nalgebra::{Matrix3, Vector3};

use crate::camera::model::Camera;
use crate::matching::side::Side;
use rockface_core::StageError;
use rockface_core::numerics::simd::Lanes;

/// The rectified geometry of a pair; positions are pixels of the depth-map level.
#[derive(Debug, Clone, PartialEq)]
pub struct Rectification {
    /// Principal distance of both rectified images, pixels.
    pub focal_px: f64,
    /// Principal point x of the first and second rectified image, pixels.
    pub centre_x_px: [f64; 2],
    /// Principal point y of both, pixels.
    pub centre_y_px: f64,
    /// Distance of the projection centres, metres.
    pub baseline_m: f64,
    /// Rotations from the camera frames of the first and second image to the rectified frame.
    pub rectified_from_camera: [Matrix3<f64>; 2],
}

/// A ray of an image in its rectified image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placed<T = f64> {
    /// Rectified position, pixels.
    pub position_px: [T; 2],
    /// Depth across the rectified plane of the ray's point at depth 1 in its own image.
    pub slant: T,
}

impl Rectification {
    /// The rectification of two cameras whose images are reduced by `downscale`; the first is the left one.
    ///
    /// Fails where the centres coincide, where the pair moves along its view, and where the axes diverge.
    pub fn new(cameras: [&Camera; 2], downscale: u32) -> Result<Self, StageError> {
        let base = cameras[1].centre() - cameras[0].centre();
        let baseline_m = base.norm();
        if baseline_m < 1e-9 {
            return Err(StageError::new(format!("the two projection centres coincide ({baseline_m} m apart)"))
                .hint("such a pair measures no depth: remove it from `pairs`, or check the positions of the cameras"));
        }
        let rotation = rectifying_rotation(cameras, &(base / baseline_m))?;
        let rectified_from_camera = cameras.map(|camera| rotation * camera.camera_from_object().transpose());
        let focal_px = area_keeping_focal(cameras, &rectified_from_camera)? / f64::from(downscale);
        let mut rectification =
            Self { focal_px, centre_x_px: [0.0; 2], centre_y_px: 0.0, baseline_m, rectified_from_camera };
        rectification.centre_images(cameras, f64::from(downscale))?;
        Ok(rectification)
    }

    /// Moves the principal points so that image centres map to image centres; rows stay common.
    fn centre_images(&mut self, cameras: [&Camera; 2], downscale: f64) -> Result<(), StageError> {
        let mut centre_y = [0.0; 2];
        for side in Side::BOTH {
            let camera = cameras[side];
            let (w, h) = (f64::from(camera.sensor().width_px), f64::from(camera.sensor().height_px));
            let centre = camera.normalised([(w - 1.0) / 2.0, (h - 1.0) / 2.0]);
            let Some(Placed { position_px: [x, y], .. }) = centre.and_then(|xy| self.place(side, xy)) else {
                let image = side.array("first", "second")[0];
                return Err(StageError::new(format!("the centre of the {image} image cannot be rectified"))
                    .hint("check focal length, principal point and distortion of its sensor"));
            };
            self.centre_x_px[side] = (w / downscale - 1.0) / 2.0 - x;
            centre_y[side] = (h / downscale - 1.0) / 2.0 - y;
        }
        self.centre_y_px = 0.5 * (centre_y[0] + centre_y[1]);
        Ok(())
    }

    /// Rectifies undistorted normalised coordinates of image `side`; `None` beyond the horizon of the rectified plane.
    #[inline]
    pub fn place(&self, side: Side, [x, y]: [f64; 2]) -> Option<Placed> {
        let ray = self.rectified_from_camera[side] * Vector3::new(x, y, 1.0);
        let scale = self.focal_px / ray.z;
        let position_px = [ray.x * scale + self.centre_x_px[side], ray.y * scale + self.centre_y_px];
        (ray.z > 0.0).then_some(Placed { position_px, slant: ray.z })
    }

    /// As [`Rectification::place`], for several rays; NaN beyond the horizon.
    #[inline(always)]
    pub fn place_lanes(&self, side: Side, [x, y]: [Lanes; 2]) -> Placed<Lanes> {
        let r = &self.rectified_from_camera[side];
        let along = |row: usize| x * r[(row, 0)] + y * r[(row, 1)] + r[(row, 2)];
        let (ray, depth) = ([along(0), along(1)], along(2));
        let slant = depth.where_positive(depth);
        let scale = Lanes::all(self.focal_px) / slant;
        Placed { position_px: [ray[0] * scale + self.centre_x_px[side], ray[1] * scale + self.centre_y_px], slant }
    }

    /// Rectified pixels along the baseline of one image pixel at the principal point of image `side`.
    pub fn pixels_along_base(&self, side: Side, camera: &Camera) -> Option<f64> {
        let sensor = camera.sensor();
        let at = |dx: f64, dy: f64| {
            let ray = camera.normalised([sensor.cx + dx, sensor.cy + dy])?;
            self.place(side, ray).map(|placed| placed.position_px[0])
        };
        let across = |dx: f64, dy: f64| Some(at(dx, dy)? - at(-dx, -dy)?);
        let (x, y) = (across(0.5, 0.0)?, across(0.0, 0.5)?);
        Some((x * x + y * y).sqrt())
    }

    /// Depth across the rectified plane of a disparity `x1 - x2`, metres; `None` at or beyond infinity.
    pub fn distance_m(&self, disparity_px: f64) -> Option<f64> {
        Some(self.focal_px * self.baseline_m / self.parallax_px(disparity_px)?)
    }

    /// A disparity without the shift of the principal points, pixels; `None` at or beyond infinity.
    #[inline]
    pub fn parallax_px(&self, disparity_px: f64) -> Option<f64> {
        let parallax = disparity_px - self.shift_px();
        (parallax > 0.0).then_some(parallax)
    }

    /// Disparity of a point at infinity: the shift of the principal points, pixels.
    #[inline]
    pub fn shift_px(&self) -> f64 {
        self.centre_x_px[0] - self.centre_x_px[1]
    }
}

fn rectifying_rotation(cameras: [&Camera; 2], base: &Vector3<f64>) -> Result<Matrix3<f64>, StageError> {
    let [first, second] = cameras.map(|camera| camera.camera_from_object().row(2).transpose());
    let axes = first + second;
    let across = axes - base * axes.dot(base);
    if across.norm() < 0.1 {
        let share = across.norm() / 2.0;
        let text = format!("the baseline runs along the view (sine of the angle between them {share:.3})");
        return Err(StageError::new(text).hint(
            "such a pair cannot be rectified: remove it from `pairs`, or let `select-pairs` choose pairs side by side",
        ));
    }
    let normal = across.normalize();
    let down = normal.cross(base);
    Ok(Matrix3::from_rows(&[base.transpose(), down.transpose(), normal.transpose()]))
}

/// Mean of `f_i cos^1.5`, the principal distance at which a rectified pixel has the area of an image pixel.
fn area_keeping_focal(cameras: [&Camera; 2], rectified: &[Matrix3<f64>; 2]) -> Result<f64, StageError> {
    let mut sum = 0.0;
    for (camera, rotation) in cameras.into_iter().zip(rectified) {
        let cosine = rotation[(2, 2)];
        if cosine < 0.1 {
            let text = format!("the views of the two images diverge (cosine to the common plane {cosine:.3})");
            return Err(StageError::new(text).hint(
                "such a pair cannot be rectified: remove it from `pairs`, or let `select-pairs` limit the convergence",
            ));
        }
        sum += camera.sensor().f * cosine * cosine.sqrt();
    }
    Ok(0.5 * sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector4};
    use rockface_core::artefact::Sensor;
    use rockface_core::testing::{image_at, small_sensor};

    fn camera(centre: [f64; 3], turn: [f64; 3]) -> Camera {
        let sensor = Sensor { k: [-0.2, 0.05, 0.0, 0.0], p: [0.001, 0.002], b1: 0.4, ..small_sensor() };
        Camera::new(&sensor, &image_at("a", centre, turn))
    }

    fn pair() -> [Camera; 2] {
        [camera([-3.0, 0.1, 20.0], [0.02, 0.1, 0.03]), camera([3.0, -0.2, 20.5], [-0.03, -0.12, -0.05])]
    }

    #[test]
    fn rows_agree_and_the_reprojection_matrix_finds_the_point() {
        let [first, second] = pair();
        let r = Rectification::new([&first, &second], 2).unwrap();
        let offset = r.centre_x_px[0] - r.centre_x_px[1];
        #[rustfmt::skip]
        let q = Matrix4::new(
            1.0, 0.0, 0.0, -r.centre_x_px[0],
            0.0, 1.0, 0.0, -r.centre_y_px,
            0.0, 0.0, 0.0, r.focal_px,
            0.0, 0.0, 1.0 / r.baseline_m, -offset / r.baseline_m,
        );
        for point in [[0.0, 0.0, 0.0], [1.5, -2.0, 3.0], [-2.0, 1.0, -5.0]].map(Vector3::from) {
            let ray = |c: &Camera| c.normalised(c.project(&point).unwrap()).unwrap();
            let placed = (r.place(Side::First, ray(&first)).unwrap(), r.place(Side::Second, ray(&second)).unwrap());
            let (left, right) = placed;
            assert!((left.position_px[1] - right.position_px[1]).abs() < 1e-9);
            let d = left.position_px[0] - right.position_px[0];
            let h = q * Vector4::new(left.position_px[0], left.position_px[1], d, 1.0);
            let rotation = r.rectified_from_camera[0] * first.camera_from_object();
            let reprojected = first.centre() + rotation.tr_mul(&(h.xyz() / h.w));
            assert!((reprojected - point).norm() < 1e-9);
            let depth = r.distance_m(d).unwrap() / left.slant;
            assert!((depth - first.to_camera(&point).z).abs() < 1e-9);
        }
    }

    #[test]
    fn image_centres_stay_centres_and_pixels_keep_their_area() {
        let [first, second] = pair();
        let r = Rectification::new([&first, &second], 1).unwrap();
        let place = |u, v| r.place(Side::First, first.normalised([u, v]).unwrap()).unwrap().position_px;
        assert!((place(29.5, 19.5)[0] - 29.5).abs() < 1e-9);
        let ([ax, ay], [bx, by], [cx, cy]) = (place(29.5, 19.5), place(30.5, 19.5), place(29.5, 20.5));
        let area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
        assert!((area - 1.0).abs() < 0.02, "area {area}");
    }

    #[test]
    fn impossible_pairs_are_refused() {
        let at = |centre, turn| camera(centre, turn);
        let error = |a: &Camera, b: &Camera| Rectification::new([a, b], 1).unwrap_err().message;
        let first = at([0.0, 0.0, 20.0], [0.0; 3]);
        assert!(error(&first, &first).contains("coincide"));
        assert!(error(&first, &at([0.0, 0.0, 10.0], [0.0; 3])).contains("along the view"));
        assert!(error(&first, &at([5.0, 0.0, 20.0], [3.0, 0.0, 0.0])).contains("diverge"));
    }
}
