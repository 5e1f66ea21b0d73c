//! Which pixels a triangle may cover under lens distortion: a rectangle that is never too small.

use nalgebra::Vector3;

use crate::camera::model::Camera;
use rockface_core::artefact::Sensor;
use rockface_core::numerics::fast_round::whole;
use rockface_core::numerics::simd::{Lanes, Number, both};

/// Nothing nearer to the camera than this is seen, metres along the optical axis.
pub const NEAR_M: f64 = 1e-3;

/// The pixels a triangle may cover.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reach {
    /// None: the triangle is not seen.
    Nothing,
    /// Those of a rectangle of the buffer, bounds included.
    Pixels {
        /// First and last column.
        columns: [u32; 2],
        /// First and last row.
        rows: [u32; 2],
    },
    /// Those whose undistorted normalised coordinates lie in a rectangle: the triangle leaves the domain of the
    /// distortion or passes the camera, so its corners have no pixels to go by.
    Wide {
        /// Least and largest x.
        x: [f64; 2],
        /// Least and largest y.
        y: [f64; 2],
    },
}

/// Bounds how far distortion bends a straight line.
///
/// The image of a segment of length h under a map with second derivative at most M stays within M h^2 / 8 of its chord.
#[derive(Debug, Clone)]
pub struct Bend {
    /// `2n (2n + 1) |k_n|` of the terms `k_n r^2n (x, y)`, whose second derivative is at most that times r^(2n - 1).
    radial: [f64; 4],
    tangential: f64,
    scale_px: f64,
}

impl Bend {
    /// The bound of a sensor.
    pub fn new(s: &Sensor) -> Self {
        let [k1, k2, k3, k4] = s.k.map(f64::abs);
        let scale_px = s.f.abs() + s.b1.abs() + s.b2.abs();
        let radial = [6.0 * k1, 20.0 * k2, 42.0 * k3, 72.0 * k4];
        Self { radial, tangential: 8.0 * (s.p[0].abs() + s.p[1].abs()), scale_px }
    }

    /// Largest distance between a curved edge and its chord, pixels of the full image, for normalised points within
    /// radius `r` and edges of squared length `h2`.
    #[inline(always)]
    fn of_edges<T: Number>(&self, r: T, h2: T) -> T {
        let (r2, [a, b, c, d]) = (r * r, self.radial);
        let second = r * (r2 * (r2 * (r2 * d + c) + b) + a) + self.tangential;
        second * self.scale_px * h2 / 8.0
    }
}

/// A point in the camera frame and what becomes of it, found once for all triangles that share it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Projected {
    /// Normalised coordinates; of use where the point lies beyond the near plane.
    flat: [f64; 2],
    /// Pixel of the full image; NaN where it has none.
    pixel: [f64; 2],
}

impl Projected {
    /// A point that is not projected.
    pub const NONE: Self = Self { flat: [f64::NAN; 2], pixel: [f64::NAN; 2] };

    /// Whether the point has a pixel.
    #[inline(always)]
    pub fn has_pixel(&self) -> bool {
        !self.pixel[0].is_nan()
    }

    /// Projects a point of the camera frame.
    pub fn new(camera: &Camera, point: &Vector3<f64>) -> Self {
        let flat = [point.x / point.z, point.y / point.z];
        let pixel = if point.z >= NEAR_M { camera.pixel(flat) } else { None };
        Self { flat, pixel: pixel.unwrap_or([f64::NAN; 2]) }
    }
}

/// The pixels a triangle in the camera frame may cover, in a buffer of `size` (columns, rows) reduced by `downscale`.
pub fn reach(camera: &Camera, bend: &Bend, corners: &[Vector3<f64>; 3], downscale: f64, size: (usize, usize)) -> Reach {
    reach_of_projected(&corners.map(|c| Projected::new(camera, &c)), bend, corners, downscale, size)
}

/// As [`reach`], for corners that are projected already.
#[inline]
fn reach_of_projected(
    projected: &[Projected; 3],
    bend: &Bend,
    corners: &[Vector3<f64>; 3],
    downscale: f64,
    size: (usize, usize),
) -> Reach {
    let in_front = corners.iter().filter(|corner| corner.z >= NEAR_M).count();
    if in_front == 0 {
        return Reach::Nothing;
    }
    if in_front < 3 {
        return wide(&clip_near(corners));
    }
    if !projected.iter().all(Projected::has_pixel) {
        return wide(&projected.map(|p| p.flat));
    }
    reaches(&projected.map(|p| [p]), bend, downscale, size).of_lane(0)
}

/// As [`reach`] of some triangles, whose corners all lie beyond the near plane and have pixels.
#[inline(always)]
pub fn reaches<const N: usize>(
    projected: &[[Projected; N]; 3],
    bend: &Bend,
    downscale: f64,
    size: (usize, usize),
) -> Reaches<N> {
    let of = |corner: usize, value: fn(&Projected) -> f64| Lanes::of(|lane| value(&projected[corner][lane]));
    let flat = [0, 1, 2].map(|corner| [of(corner, |p| p.flat[0]), of(corner, |p| p.flat[1])]);
    let square = |[x, y]: [Lanes<N>; 2]| x * x + y * y;
    let r2 = square(flat[0]).at_least(square(flat[1])).at_least(square(flat[2]));
    let edge = |i: usize, j: usize| square([flat[i][0] - flat[j][0], flat[i][1] - flat[j][1]]);
    let h2 = edge(0, 1).at_least(edge(1, 2)).at_least(edge(2, 0));
    // A thousandth of a pixel covers rounding.
    let margin = bend.of_edges(r2.sqrt(), h2) + 1e-3;
    let columns = [of(0, |p| p.pixel[0]), of(1, |p| p.pixel[0]), of(2, |p| p.pixel[0])];
    let rows = [of(0, |p| p.pixel[1]), of(1, |p| p.pixel[1]), of(2, |p| p.pixel[1])];
    Reaches { columns: spans(columns, margin, downscale, size.0), rows: spans(rows, margin, downscale, size.1) }
}

/// What some triangles reach: first and last column, and first and last row; NaN or out of order where there is none.
#[derive(Clone, Copy)]
pub struct Reaches<const N: usize> {
    columns: [Lanes<N>; 2],
    rows: [Lanes<N>; 2],
}

impl<const N: usize> Reaches<N> {
    /// What the triangle of a lane reaches.
    #[inline(always)]
    pub fn of_lane(&self, lane: usize) -> Reach {
        let [left, right, top, bottom] =
            [self.columns[0][lane], self.columns[1][lane], self.rows[0][lane], self.rows[1][lane]];
        if left <= right && top <= bottom {
            let place = |value: f64| whole(value) as u32;
            Reach::Pixels { columns: [place(left), place(right)], rows: [place(top), place(bottom)] }
        } else {
            Reach::Nothing
        }
    }
}

/// First and last buffer positions whose centres lie within `margin` of the bounds of three full-image positions.
#[inline(always)]
fn spans<const N: usize>([a, b, c]: [Lanes<N>; 3], margin: Lanes<N>, downscale: f64, size: usize) -> [Lanes<N>; 2] {
    let smaller = |a: Lanes<N>, b: Lanes<N>| a.with(b, |a, b| if b < a { b } else { a });
    let (low, high) = (smaller(smaller(a, b), c), a.at_least(b).at_least(c));
    let [low, high] = both([low - margin, high + margin], |full| (full + 0.5) / downscale - 0.5);
    let last_place = size as f64 - 1.0;
    let first = low.map(|low| low.ceil().max(0.0));
    let last = high.map(|high| high.floor().min(last_place));
    let outside = |low: f64, high: f64| if high < 0.0 || low > last_place { f64::NAN } else { 0.0 };
    [first + low.with(high, outside), last]
}

fn bounds(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
}

fn wide(polygon: &[[f64; 2]]) -> Reach {
    Reach::Wide { x: bounds(polygon.iter().map(|p| p[0])), y: bounds(polygon.iter().map(|p| p[1])) }
}

/// Normalised corners of the part of a triangle beyond the near plane.
fn clip_near(corners: &[Vector3<f64>; 3]) -> Vec<[f64; 2]> {
    let mut polygon = Vec::with_capacity(4);
    for (i, from) in corners.iter().enumerate() {
        let to = &corners[(i + 1) % 3];
        if from.z >= NEAR_M {
            polygon.push([from.x / from.z, from.y / from.z]);
        }
        if (from.z >= NEAR_M) != (to.z >= NEAR_M) {
            let cut = from + (to - from) * ((NEAR_M - from.z) / (to.z - from.z));
            polygon.push([cut.x / NEAR_M, cut.y / NEAR_M]);
        }
    }
    polygon
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::model::full_pixel;
    use proptest::prelude::*;
    use rockface_core::testing::{image_at, small_sensor};

    fn is_hit([a, b, c]: &[Vector3<f64>; 3], ray: &Vector3<f64>) -> bool {
        let signs = [a.cross(b).dot(ray), b.cross(c).dot(ray), c.cross(a).dot(ray)];
        let normal = (b - a).cross(&(c - a));
        let z = normal.dot(a) / normal.dot(ray);
        (signs.iter().all(|s| *s > 0.0) || signs.iter().all(|s| *s < 0.0)) && z > NEAR_M
    }

    fn covers(reach: &Reach, column: usize, row: usize, [x, y]: [f64; 2]) -> bool {
        match reach {
            Reach::Nothing => false,
            Reach::Pixels { columns, rows } => {
                (columns[0]..=columns[1]).contains(&(column as u32)) && (rows[0]..=rows[1]).contains(&(row as u32))
            }
            Reach::Wide { x: [x0, x1], y: [y0, y1] } => (*x0..=*x1).contains(&x) && (*y0..=*y1).contains(&y),
        }
    }

    fn corner() -> impl Strategy<Value = Vector3<f64>> {
        (-8.0..8.0f64, -8.0..8.0f64, -4.0..12.0f64).prop_map(|(x, y, z)| Vector3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn no_pixel_a_triangle_covers_is_out_of_reach(
            corners in [corner(), corner(), corner()], k1 in -0.5..0.3f64, p1 in -0.01..0.01f64, downscale in 1u32..4,
        ) {
            let sensor = Sensor { f: 40.0, k: [k1, 0.1, 0.0, 0.0], p: [p1, -0.005], b2: 0.5, ..small_sensor() };
            let camera = Camera::new(&sensor, &image_at("a", [0.0; 3], [0.0; 3]));
            let (width, height) = ((60 / downscale) as usize, (40 / downscale) as usize);
            let reach = reach(&camera, &Bend::new(&sensor), &corners, f64::from(downscale), (width, height));
            for (column, row) in (0..height).flat_map(|row| (0..width).map(move |column| (column, row))) {
                let Some([x, y]) = camera.normalised(full_pixel(column, row, downscale)) else { continue };
                if is_hit(&corners, &Vector3::new(x, y, 1.0)) {
                    prop_assert!(covers(&reach, column, row, [x, y]), "({column}, {row}) is not in {reach:?}");
                }
            }
        }
    }
}
