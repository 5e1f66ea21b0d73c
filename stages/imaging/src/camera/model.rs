//! Collinearity: object points to pixels and back, with Brown-Conrady distortion and its exact inverse.

use nalgebra::{Matrix3, Vector3};

use rockface_core::artefact::{Depth, Image, Sensor};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::simd::{Lanes, Number, both};

/// Step below which the search for undistorted coordinates ends if it starts from a near guess.
const NEAR: f64 = 2e-8;
/// Step below which the search ends otherwise.
const FAR: f64 = 1e-9;
/// Most steps of such a search.
const MOST_STEPS: usize = 20;

/// A sensor and an image prepared for the projection of many points.
///
/// Pixel coordinates have the centre of the first pixel at (0, 0); the camera frame is x right, y down, z forward.
#[derive(Debug, Clone)]
pub struct Camera {
    sensor: Sensor,
    rotation: Matrix3<f64>,
    centre: Vector3<f64>,
    /// Squared radius (normalised, undistorted) at which the radial polynomial folds back.
    fold2: f64,
    /// Whether all coefficients of the distortion are zero.
    straight: bool,
}

impl Camera {
    /// A camera from its interior and exterior orientation.
    pub fn new(sensor: &Sensor, image: &Image) -> Self {
        let fold2 = fold_radius_squared(&sensor.k);
        let straight = sensor.k.iter().chain(&sensor.p).all(|coefficient| *coefficient == 0.0);
        Self { sensor: sensor.clone(), rotation: image.matrix(), centre: image.centre(), fold2, straight }
    }

    /// The camera of a depth map.
    pub fn of_depth(depth: &Depth) -> Self {
        Self::new(&depth.sensor, &depth.image)
    }

    /// The interior orientation it was made with.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Whether both cameras map rays to pixels alike: all of their interior orientations but the name is the same.
    pub fn has_interior_of(&self, other: &Self) -> bool {
        let name = other.sensor.name.clone();
        Sensor { name, ..self.sensor.clone() } == other.sensor
    }

    /// Whether it has no distortion.
    pub fn is_straight(&self) -> bool {
        self.straight
    }

    /// R, object to camera frame.
    pub fn camera_from_object(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    /// Projection centre, metres.
    pub fn centre(&self) -> Vector3<f64> {
        self.centre
    }

    /// An object point in the camera frame, metres.
    #[inline]
    pub fn to_camera(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * (point - self.centre)
    }

    /// The pixel of an object point; `None` behind the camera or beyond the fold of the distortion.
    pub fn project(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        self.project_from_camera(&self.to_camera(point))
    }

    /// The pixel of a point in the camera frame; `None` behind the camera or beyond the fold of the distortion.
    pub fn project_from_camera(&self, point: &Vector3<f64>) -> Option<[f64; 2]> {
        (point.z > 0.0).then(|| self.pixel([point.x / point.z, point.y / point.z])).flatten()
    }

    /// The pixel of undistorted normalised coordinates; `None` beyond the fold of the distortion.
    #[inline]
    pub fn pixel(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        if x * x + y * y >= self.fold2 {
            return None;
        }
        Some(self.affine(if self.straight { [x, y] } else { distort(&self.sensor, x, y) }))
    }

    /// The pixel of distorted normalised coordinates.
    #[inline(always)]
    fn affine<T: Number>(&self, [xd, yd]: [T; 2]) -> [T; 2] {
        let s = &self.sensor;
        [xd * (s.f + s.b1) + s.cx + yd * s.b2, yd * s.f + s.cy]
    }

    /// Undistorted normalised coordinates of a pixel; `None` where no point inside the fold maps to it.
    #[inline]
    pub fn normalised(&self, pixel: [f64; 2]) -> Option<[f64; 2]> {
        let [xd, yd] = self.distorted(pixel);
        self.undistort(xd, yd, [xd, yd], FAR)
    }

    /// As [`Camera::normalised`], searched from a near guess: much faster.
    #[inline]
    pub fn normalised_near(&self, pixel: [f64; 2], guess: [f64; 2]) -> Option<[f64; 2]> {
        let [xd, yd] = self.distorted(pixel);
        self.undistort(xd, yd, guess, NEAR)
    }

    /// Distorted normalised coordinates of a pixel.
    #[inline]
    fn distorted(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let yd = self.distorted_y(v);
        [self.distorted_x(u, yd), yd]
    }

    #[inline]
    fn distorted_x(&self, u: f64, yd: f64) -> f64 {
        let s = &self.sensor;
        (u - s.cx - s.b2 * yd) / (s.f + s.b1)
    }

    /// Distorted normalised y of the pixels of a row.
    #[inline]
    pub fn distorted_y(&self, v: f64) -> f64 {
        (v - self.sensor.cy) / self.sensor.f
    }

    /// As [`Camera::normalised`] for column `u` of a row whose distorted y is known, searched from a near guess if there is one.
    #[inline]
    pub fn normalised_in_row(&self, u: f64, yd: f64, guess: Option<[f64; 2]>) -> Option<[f64; 2]> {
        let xd = self.distorted_x(u, yd);
        let near = guess.and_then(|guess| self.undistort(xd, yd, guess, NEAR));
        near.or_else(|| self.undistort(xd, yd, [xd, yd], FAR))
    }

    /// Undistorted normalised coordinates of distorted ones, searched from a guess until a step is smaller than the last.
    #[inline]
    fn undistort(&self, xd: f64, yd: f64, guess: [f64; 2], last: f64) -> Option<[f64; 2]> {
        if self.straight { Some([xd, yd]) } else { self.solve_distortion(xd, yd, guess, last) }
    }

    /// Newton's method on the distortion with its analytic Jacobian, until a step is smaller than the last. What is left is the
    /// square of that step times half the second derivative over the first, some tenths for lenses of use: 1e-16 after 2e-8.
    #[inline]
    fn solve_distortion(&self, xd: f64, yd: f64, [mut x, mut y]: [f64; 2], last: f64) -> Option<[f64; 2]> {
        for _ in 0..MOST_STEPS {
            let [dx, dy] = newton_step(&self.sensor, [xd, yd], [x, y]);
            (x, y) = (x - dx, y - dy);
            if dx.abs().max(dy.abs()) < last {
                return (x * x + y * y < self.fold2).then_some([x, y]);
            }
        }
        None
    }

    /// As [`Camera::to_camera`], for several points.
    #[inline(always)]
    pub fn to_camera_lanes(&self, point: [Lanes; 3]) -> [Lanes; 3] {
        let r = &self.rotation;
        let [x, y, z] = [point[0] - self.centre.x, point[1] - self.centre.y, point[2] - self.centre.z];
        let along = |row: usize| x * r[(row, 0)] + y * r[(row, 1)] + z * r[(row, 2)];
        [along(0), along(1), along(2)]
    }

    /// As [`Camera::pixel`], for several rays; NaN beyond the fold of the distortion.
    #[inline(always)]
    pub fn pixel_lanes(&self, [x, y]: [Lanes; 2]) -> [Lanes; 2] {
        let bent = if self.straight { [x, y] } else { distort(&self.sensor, x, y) };
        let radius2 = x * x + y * y;
        both(self.affine(bent), |p| p.where_below(radius2, self.fold2))
    }

    /// As [`Camera::normalised_near`], for several pixels; NaN where it is `None`.
    #[inline(always)]
    pub fn normalised_near_lanes(&self, [u, v]: [Lanes; 2], guess: [Lanes; 2]) -> [Lanes; 2] {
        let s = &self.sensor;
        let yd = (v - s.cy) / s.f;
        self.undistort_lanes([(u - s.cx - yd * s.b2) / (s.f + s.b1), yd], guess, NEAR)
    }

    /// As [`Camera::normalised_in_row`] from near guesses only, for several columns; NaN where the search fails from there.
    #[inline(always)]
    pub fn normalised_in_row_lanes(&self, u: Lanes, yd: f64, guess: [Lanes; 2]) -> [Lanes; 2] {
        self.undistort_lanes(self.distorted_in_row_lanes(u, yd), guess, NEAR)
    }

    /// As [`Camera::normalised_in_row`] without a guess, for several columns; NaN where it is `None`.
    #[inline(always)]
    pub fn normalised_in_row_unguessed_lanes(&self, u: Lanes, yd: f64) -> [Lanes; 2] {
        let distorted = self.distorted_in_row_lanes(u, yd);
        self.undistort_lanes(distorted, distorted, FAR)
    }

    #[inline(always)]
    fn distorted_in_row_lanes(&self, u: Lanes, yd: f64) -> [Lanes; 2] {
        let s = &self.sensor;
        [(u - s.cx - s.b2 * yd) / (s.f + s.b1), Lanes::all(yd)]
    }

    /// As [`Camera::solve_distortion`], for several rays: each lane takes the steps it takes alone.
    #[inline(always)]
    fn undistort_lanes(&self, distorted: [Lanes; 2], [mut x, mut y]: [Lanes; 2], last: f64) -> [Lanes; 2] {
        if self.straight {
            return distorted;
        }
        // 1 in lanes where the search continues.
        let mut open = (x + y + distorted[0] + distorted[1]).map(|sum| if sum.is_nan() { 0.0 } else { 1.0 });
        for _ in 0..MOST_STEPS {
            let [dx, dy] = newton_step(&self.sensor, distorted, [x, y]);
            let open_step = |step: Lanes| step.with(open, |step, open| if open > 0.0 { step } else { 0.0 });
            (x, y) = (x - open_step(dx), y - open_step(dy));
            let longest = dx.with(dy, |dx, dy| dx.abs().max(dy.abs()));
            open = open.with(longest, |open, step| if step < last { 0.0 } else { open });
            if open.every(|open| open == 0.0) {
                break;
            }
        }
        let radius2 = (x * x + y * y).with(open, |radius2, open| if open > 0.0 { f64::INFINITY } else { radius2 });
        both([x, y], |solved| solved.where_below(radius2, self.fold2))
    }

    /// The object point at depth `z_m` (along the optical axis) on the ray of undistorted normalised coordinates.
    #[inline]
    pub fn unproject(&self, [x, y]: [f64; 2], z_m: f64) -> Vector3<f64> {
        self.centre + self.rotation.tr_mul(&Vector3::new(x * z_m, y * z_m, z_m))
    }

    /// As [`Camera::unproject`], for several rays: the same bits.
    #[inline(always)]
    pub fn unproject_lanes(&self, [x, y]: [Lanes; 2], z_m: Lanes) -> [Lanes; 3] {
        let r = &self.rotation;
        let (x, y) = (x * z_m, y * z_m);
        let along = |axis: usize| x * r[(0, axis)] + y * r[(1, axis)] + z_m * r[(2, axis)] + self.centre[axis];
        [along(0), along(1), along(2)]
    }

    /// Direction in the object frame of the ray of undistorted normalised coordinates; its length is that of (x, y, 1).
    pub fn direction(&self, [x, y]: [f64; 2]) -> Vector3<f64> {
        self.rotation.tr_mul(&Vector3::new(x, y, 1.0))
    }

    /// As [`Camera::direction`], of several rays: the same bits.
    #[inline(always)]
    pub fn direction_lanes(&self, [x, y]: [Lanes; 2]) -> [Lanes; 3] {
        let r = &self.rotation;
        let along = |axis: usize| x * r[(0, axis)] + y * r[(1, axis)] + r[(2, axis)];
        [along(0), along(1), along(2)]
    }

    /// Whether a pixel lies in the image, at least `border_px` from its outermost pixel centres.
    pub fn inside(&self, [u, v]: [f64; 2], border_px: f64) -> bool {
        let (w, h) = (f64::from(self.sensor.width_px), f64::from(self.sensor.height_px));
        let low = border_px - 0.5;
        u >= low && v >= low && u <= w - 1.0 - low && v <= h - 1.0 - low
    }
}

/// Image position of the centre of a depth-map pixel, in pixels of the full image.
#[inline]
pub fn full_pixel(column: usize, row: usize, downscale: u32) -> [f64; 2] {
    let s = f64::from(downscale);
    [(column as f64 + 0.5) * s - 0.5, (row as f64 + 0.5) * s - 0.5]
}

/// The outermost pixels (column, row) of a depth map.
pub fn outline(width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    let rows = (0..height).flat_map(move |row| [(0, row), (width - 1, row)]);
    (0..width).flat_map(move |column| [(column, 0), (column, height - 1)]).chain(rows)
}

#[inline(always)]
fn radial<T: Number>(k: &[f64; 4], r2: T) -> T {
    r2 * (r2 * (r2 * (r2 * k[3] + k[2]) + k[1]) + k[0]) + 1.0
}

/// Distorted normalised coordinates of undistorted ones; the fold is not checked.
#[inline(always)]
pub fn distort<T: Number>(s: &Sensor, x: T, y: T) -> [T; 2] {
    let (r2, [p1, p2]) = (x * x + y * y, s.p);
    let radial = radial(&s.k, r2);
    [
        x * radial + x * (2.0 * p1) * y + (r2 + x * 2.0 * x) * p2,
        y * radial + (r2 + y * 2.0 * y) * p1 + x * (2.0 * p2) * y,
    ]
}

/// Derivatives of the distorted normalised coordinates by the undistorted ones: rows x', y'.
#[inline(always)]
pub fn distortion_jacobian<T: Number>(s: &Sensor, x: T, y: T) -> [[T; 2]; 2] {
    let (r2, [p1, p2], k) = (x * x + y * y, s.p, &s.k);
    let radial = radial(k, r2);
    let slope = r2 * (r2 * (r2 * (4.0 * k[3]) + 3.0 * k[2]) + 2.0 * k[1]) + k[0];
    let cross = x * 2.0 * y * slope + x * (2.0 * p1) + y * (2.0 * p2);
    [
        [radial + x * 2.0 * x * slope + y * (2.0 * p1) + x * (6.0 * p2), cross],
        [cross, radial + y * 2.0 * y * slope + y * (6.0 * p1) + x * (2.0 * p2)],
    ]
}

/// The step of Newton's method that is subtracted from undistorted coordinates to make them distort to the given ones.
#[inline(always)]
fn newton_step<T: Number>(s: &Sensor, [xd, yd]: [T; 2], [x, y]: [T; 2]) -> [T; 2] {
    let [fx, fy] = distort(s, x, y);
    let (rx, ry) = (fx - xd, fy - yd);
    let [[a, b], [c, d]] = distortion_jacobian(s, x, y);
    // One division: how a step is rounded is far below what it is taken from.
    let inverse = (a * d - b * c).recip();
    [(d * rx - b * ry) * inverse, (a * ry - c * rx) * inverse]
}

/// First root in r^2 of `1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6 + 9 k4 r^8`, beyond which the distortion folds back.
///
/// Searched up to r = 4 (a field of view of 150 degrees); infinity where there is none.
fn fold_radius_squared(k: &[f64; 4]) -> f64 {
    let slope = |r2: f64| 1.0 + r2 * (3.0 * k[0] + r2 * (5.0 * k[1] + r2 * (7.0 * k[2] + r2 * 9.0 * k[3])));
    let steps = 4000;
    let at = |i: i32| 16.0 * f64::from(i) / f64::from(steps);
    let Some(i) = (1..=steps).find(|i| slope(at(*i)) <= 0.0) else { return f64::INFINITY };
    let (mut low, mut high) = (at(i - 1), at(i));
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if slope(middle) > 0.0 { low = middle } else { high = middle }
    }
    low
}

/// Rotation matrix of a rotation vector (axis times angle, radians), by Rodrigues' formula.
pub fn exponential(rotation: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = rotation.norm_squared();
    let (a, b) = if angle2 < 1e-12 {
        (1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0)
    } else {
        let angle = angle2.sqrt();
        (portable_math::sin(angle) / angle, (1.0 - portable_math::cos(angle)) / angle2)
    };
    let k = rotation.cross_matrix();
    Matrix3::identity() + k * a + k * k * b
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, UnitQuaternion};
    use proptest::prelude::*;

    fn sensor() -> Sensor {
        Sensor {
            name: "cam".into(),
            width_px: 1900,
            height_px: 1600,
            f: 4545.3,
            cx: 956.8,
            cy: 795.4,
            b1: 1.5,
            b2: -0.7,
            k: [-0.081, 0.115, 0.01, 0.0],
            p: [0.000_31, -0.000_17],
        }
    }

    fn camera(sensor: &Sensor) -> Camera {
        let mut image = Image {
            name: "a".into(),
            sensor: 0,
            camera_from_object: [1.0, 0.0, 0.0, 0.0],
            centre_m: [1.0, -2.0, 20.0],
        };
        image.set_rotation(&UnitQuaternion::from_rotation_matrix(&Rotation3::from_euler_angles(3.1, 0.08, -0.02)));
        Camera::new(sensor, &image)
    }

    proptest! {
        #[test]
        fn unproject_then_project_is_the_identity(u in -0.5..1899.5f64, v in -0.5..1599.5f64, z in 1.0..200.0f64) {
            let camera = camera(&sensor());
            let point = camera.unproject(camera.normalised([u, v]).unwrap(), z);
            let [pu, pv] = camera.project(&point).unwrap();
            prop_assert!((pu - u).abs() < 1e-9 && (pv - v).abs() < 1e-9);
            prop_assert!((camera.to_camera(&point).z - z).abs() < 1e-11 * z.max(20.0));
            let [x, y] = camera.normalised([u, v]).unwrap();
            let lanes = camera.unproject_lanes([Lanes::all(x), Lanes::all(y)], Lanes::all(z));
            let bits = lanes.map(|axis| axis[0].to_bits());
            prop_assert_eq!(bits, [point.x.to_bits(), point.y.to_bits(), point.z.to_bits()]);
        }

        #[test]
        fn the_jacobian_is_the_derivative(x in -0.3..0.3f64, y in -0.3..0.3f64) {
            let (s, h) = (sensor(), 1e-6);
            for (row, j) in distortion_jacobian(&s, x, y).iter().enumerate() {
                let dx = (distort(&s, x + h, y)[row] - distort(&s, x - h, y)[row]) / (2.0 * h);
                let dy = (distort(&s, x, y + h)[row] - distort(&s, x, y - h)[row]) / (2.0 * h);
                prop_assert!((j[0] - dx).abs() < 1e-8 && (j[1] - dy).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn points_behind_and_beyond_the_fold_have_no_pixel() {
        let mut s = sensor();
        s.k = [-0.5, 0.0, 0.0, 0.0];
        let camera = camera(&s);
        assert!(camera.project_from_camera(&Vector3::new(0.0, 0.0, -1.0)).is_none());
        // 1 - 1.5 r^2 = 0 at r = 0.8165.
        assert!(camera.pixel([0.816, 0.0]).is_some());
        assert!(camera.pixel([0.817, 0.0]).is_none());
    }

    #[test]
    fn the_exponential_is_a_rotation_by_its_angle() {
        let r = exponential(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        assert!((r * Vector3::x() - Vector3::y()).norm() < 1e-15);
        let small = exponential(&Vector3::new(1e-7, 2e-7, -1e-7));
        assert!((small.tr_mul(&small) - Matrix3::identity()).norm() < 1e-15);
    }
}
