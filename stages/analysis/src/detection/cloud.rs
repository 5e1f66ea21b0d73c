//! Points sorted into square columns over X and Y, to find those in a sphere or a cylinder in a fixed order.

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use rayon::prelude::*;

use rockface_raster::shape::{Moved, Shape};

/// Columns there may be; sides grow beyond.
const MAXIMUM_COLUMNS: f64 = 5e7;

/// A point cloud in columns.
pub struct Cloud {
    /// Points, metres, column by column.
    points: Vec<Vector3<f64>>,
    /// Where each column starts; one more than there are columns.
    starts: Vec<u32>,
    left: f64,
    bottom: f64,
    side: f64,
    wide: usize,
    high: usize,
}

impl Cloud {
    /// The points of a surface or the vertices of a mesh, moved by `transform`, in columns of about `side_m`; `None` without
    /// points.
    pub fn new(shape: Shape, transform: Option<&Moved>, side_m: f64) -> Option<Self> {
        let points: Vec<Vector3<f64>> =
            (0..shape.places()).into_par_iter().map(|place| Vector3::from(shape.point(place, transform))).collect();
        let points: Vec<Vector3<f64>> = points.into_iter().filter(|p| !p.x.is_nan()).collect();
        let first = points.first()?;
        let grow = |(low, high): (Vector3<f64>, Vector3<f64>), p: &Vector3<f64>| (low.inf(p), high.sup(p));
        let (low, high) = points.iter().fold((*first, *first), grow);
        let size = high - low;
        let side = side_m.max((size.x * size.y / MAXIMUM_COLUMNS).sqrt()).max(size.x.max(size.y) / 1e6);
        let [wide, tall] = [size.x, size.y].map(|length| (length / side) as usize + 1);
        let mut cloud =
            Self { points: Vec::new(), starts: Vec::new(), left: low.x, bottom: low.y, side, wide, high: tall };
        cloud.sort(points);
        Some(cloud)
    }

    /// Counting sort, in the order of the points.
    fn sort(&mut self, points: Vec<Vector3<f64>>) {
        let columns: Vec<u32> = points.par_iter().map(|p| self.column(p) as u32).collect();
        let mut next = vec![0u32; self.wide * self.high + 1];
        columns.iter().for_each(|column| next[*column as usize + 1] += 1);
        (1..next.len()).for_each(|i| next[i] += next[i - 1]);
        self.starts.clone_from(&next);
        self.points = vec![Vector3::zeros(); points.len()];
        for (point, column) in points.into_iter().zip(columns) {
            let slot = &mut next[column as usize];
            self.points[*slot as usize] = point;
            *slot += 1;
        }
    }

    fn column(&self, p: &Vector3<f64>) -> usize {
        let x = ((p.x - self.left) / self.side) as usize;
        let y = ((p.y - self.bottom) / self.side) as usize;
        y.min(self.high - 1) * self.wide + x.min(self.wide - 1)
    }

    /// All points, in the fixed order of the columns.
    pub fn points(&self) -> &[Vector3<f64>] {
        &self.points
    }

    /// Hands over the points whose columns meet a box of half sides `reach` around `centre` in X and Y.
    pub fn near(&self, centre: &Vector3<f64>, reach: [f64; 2], mut visit: impl FnMut(&Vector3<f64>)) {
        let range = |middle: f64, reach: f64, start: f64, count: usize| {
            let place = |value: f64| (value - start) / self.side;
            let (from, to) = (place(middle - reach), place(middle + reach));
            let first = from.max(0.0) as usize;
            if to < 0.0 || first >= count { 0..0 } else { first..(to as usize + 1).min(count) }
        };
        let across = range(centre.x, reach[0], self.left, self.wide);
        for row in range(centre.y, reach[1], self.bottom, self.high) {
            let columns = row * self.wide + across.start..row * self.wide + across.end;
            if !columns.is_empty() {
                let places = self.starts[columns.start] as usize..self.starts[columns.end] as usize;
                self.points[places].iter().for_each(&mut visit);
            }
        }
    }

    /// The normal of the plane through the points within a radius, towards positive Z, and how planar they are,
    /// (l2 - l3) / l1 of the eigenvalues of their covariance; `None` for fewer than 3 points.
    pub fn normal(&self, centre: &Vector3<f64>, radius_m: f64) -> Option<(Vector3<f64>, f64)> {
        let (mut count, mut sum, mut squares) = (0.0, Vector3::zeros(), Matrix3::zeros());
        self.near(centre, [radius_m; 2], |point| {
            let arm = point - centre;
            if arm.norm_squared() <= radius_m * radius_m {
                count += 1.0;
                sum += arm;
                squares += arm * arm.transpose();
            }
        });
        if count < 3.0 {
            return None;
        }
        let eigen = SymmetricEigen::new((squares - sum * sum.transpose() / count) / (count - 1.0));
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [l1, l2, l3] = order.map(|place| eigen.eigenvalues[place]);
        let normal: Vector3<f64> = eigen.eigenvectors.column(order[2]).into_owned();
        let planarity = if l1 > 0.0 { (l2 - l3) / l1 } else { 0.0 };
        Some((if normal.z < 0.0 { -normal } else { normal }, planarity))
    }

    /// Number, mean and variance (n - 1) along the axis of the points in a cylinder, relative to its centre.
    pub fn along(&self, centre: &Point3<f64>, axis: &Vector3<f64>, radius_m: f64, half_m: f64) -> Stack {
        // The box around the cylinder: a disc of the radius turned, and the axis.
        let reach = [0, 1].map(|k| radius_m * (1.0 - axis[k] * axis[k]).max(0.0).sqrt() + half_m * axis[k].abs());
        let mut stack = Stack::default();
        self.near(&centre.coords, reach, |point| {
            let arm = point - centre.coords;
            let along = arm.dot(axis);
            if along.abs() < half_m && (arm - axis * along).norm_squared() <= radius_m * radius_m {
                stack.add(along);
            }
        });
        stack
    }
}

/// Values summed up: number, mean, sum of squares about the mean (Welford 1962).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stack {
    /// Number of values.
    pub count: f64,
    /// Mean of the values; 0 without any.
    pub mean: f64,
    squares: f64,
}

impl Stack {
    fn add(&mut self, value: f64) {
        self.count += 1.0;
        let before = value - self.mean;
        self.mean += before / self.count;
        self.squares += before * (value - self.mean);
    }

    /// Variance with n - 1; NaN for fewer than two values.
    pub fn variance(&self) -> f64 {
        if self.count < 2.0 { f64::NAN } else { self.squares / (self.count - 1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    #[test]
    fn what_a_cylinder_holds_is_what_looking_at_every_point_finds() {
        let mesh = height_mesh(60, [-2.0, 2.0, -1.0, 1.0], |x, y| 0.2 * x - 0.1 * y);
        let cloud = Cloud::new(Shape::Mesh(&mesh), None, 0.13).unwrap();
        let axis = Vector3::new(0.3, -0.2, 0.9).normalize();
        for centre in [Point3::new(0.1, 0.2, 0.0), Point3::new(-2.3, 1.1, 0.1), Point3::new(9.0, 0.0, 0.0)] {
            let found = cloud.along(&centre, &axis, 0.3, 0.4);
            let arms = mesh.vertices.iter().map(|v| Vector3::from(*v) - centre.coords);
            let inside = |arm: &Vector3<f64>| {
                let along = arm.dot(&axis);
                along.abs() < 0.4 && (arm - axis * along).norm() <= 0.3
            };
            let expected: Vec<f64> = arms.filter(inside).map(|arm| arm.dot(&axis)).collect();
            assert_eq!(found.count as usize, expected.len());
            let mean = expected.iter().sum::<f64>() / expected.len().max(1) as f64;
            assert!((found.mean - mean).abs() < 1e-12);
        }
        let (normal, planarity) = cloud.normal(&Vector3::zeros(), 0.5).unwrap();
        assert!((normal - Vector3::new(-0.2, 0.1, 1.0).normalize()).norm() < 1e-9 && planarity > 0.5);
        assert!(cloud.normal(&Vector3::new(50.0, 0.0, 0.0), 0.5).is_none());
    }

    #[test]
    fn mean_and_variance_by_hand() {
        let mut stack = Stack::default();
        [1.0, 2.0, 4.0].into_iter().for_each(|value| stack.add(value));
        assert!((stack.mean - 7.0 / 3.0).abs() < 1e-14 && (stack.variance() - 7.0 / 3.0).abs() < 1e-12);
        assert!(Stack::default().variance().is_nan());
    }
}
