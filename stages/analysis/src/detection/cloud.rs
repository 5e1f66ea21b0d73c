//! Points sorted into square columns over X and Y, to find those in a sphere or a cylinder in a fixed order.

use std::ops::Range;

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use rayon::prelude::*;

use rockface_core::numerics::simd::Lanes;
use rockface_raster::shape::{Moved, Shape};

/// Columns there may be; sides grow beyond.
const MAXIMUM_COLUMNS: f64 = 5e7;
/// Points that are looked at together. Sums have one part for each, so this number is part of their rounding.
const WIDE: usize = 4;
/// The column of a place without a point.
const NOWHERE: u32 = u32::MAX;
/// Columns along each side of a tile, whose heights are kept together.
const TILE: usize = 4;
/// What rounding may take from a length, as a share of the side of a column.
const SLACK: f64 = 1e-9;

/// The least and the greatest Z of no points.
const NO_HEIGHT: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// The least and the greatest Z in either of two.
#[inline(always)]
fn either(one: [f32; 2], other: [f32; 2]) -> [f32; 2] {
    [one[0].min(other[0]), one[1].max(other[1])]
}

/// The tiles that hold some rows or columns of columns.
#[inline(always)]
fn tiles(places: &Range<usize>) -> Range<usize> {
    places.start / TILE..places.end.div_ceil(TILE)
}

/// A point cloud in columns.
pub struct Cloud {
    /// X, Y and Z of the points, metres, column by column.
    coordinates: [Vec<f64>; 3],
    /// Where each column starts; one more than there are columns.
    starts: Vec<u32>,
    /// The least and the greatest Z in each column, metres, rounded outwards.
    heights: Vec<[f32; 2]>,
    /// The same in each tile of columns.
    tiles: Vec<[f32; 2]>,
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
        // Points are made where they are needed: a list of them would take longer to write than they take to make.
        let point = |place: usize| Vector3::from(shape.point(place, transform));
        let ends = (0..shape.places()).into_par_iter().map(point).filter(|p| !p.x.is_nan()).map(|p| (p, p));
        let (low, high) = ends.reduce_with(|one, other| (one.0.inf(&other.0), one.1.sup(&other.1)))?;
        let size = high - low;
        let side = side_m.max((size.x * size.y / MAXIMUM_COLUMNS).sqrt()).max(size.x.max(size.y) / 1e6);
        let [wide, tall] = [size.x, size.y].map(|length| (length / side) as usize + 1);
        let mut cloud = Self {
            coordinates: Default::default(),
            starts: Vec::new(),
            heights: Vec::new(),
            tiles: Vec::new(),
            left: low.x,
            bottom: low.y,
            side,
            wide,
            high: tall,
        };
        cloud.sort(shape.places(), point);
        Some(cloud)
    }

    /// Counting sort of the points of some places, in their order.
    fn sort(&mut self, places: usize, point: impl Fn(usize) -> Vector3<f64> + Sync) {
        let of_place = |place| Some(point(place)).filter(|p| !p.x.is_nan()).map_or(NOWHERE, |p| self.column(&p) as u32);
        let columns: Vec<u32> = (0..places).into_par_iter().map(of_place).collect();
        let placed = || columns.iter().enumerate().filter(|(_, column)| **column != NOWHERE);
        let mut next = vec![0u32; self.wide * self.high + 1];
        placed().for_each(|(_, column)| next[*column as usize + 1] += 1);
        (1..next.len()).for_each(|i| next[i] += next[i - 1]);
        self.starts.clone_from(&next);
        let mut coordinates = [0; 3].map(|_| vec![0.0; next[next.len() - 1] as usize]);
        for (place, column) in placed() {
            let slot = &mut next[*column as usize];
            coordinates.iter_mut().zip(point(place).iter()).for_each(|(values, value)| values[*slot as usize] = *value);
            *slot += 1;
        }
        self.coordinates = coordinates;
        let ends = self.starts.par_windows(2).map(|ends| &self.coordinates[2][ends[0] as usize..ends[1] as usize]);
        let grow = |[low, high]: [f32; 2], z: &f64| [low.min((*z as f32).next_down()), high.max((*z as f32).next_up())];
        self.heights = ends.map(|column| column.iter().fold(NO_HEIGHT, grow)).collect();
        let tiles_wide = self.wide.div_ceil(TILE);
        self.tiles = vec![NO_HEIGHT; tiles_wide * self.high.div_ceil(TILE)];
        for (rows, tiles) in self.heights.chunks(TILE * self.wide).zip(self.tiles.chunks_mut(tiles_wide)) {
            for row in rows.chunks(self.wide) {
                let of_tiles = row.chunks(TILE).zip(tiles.iter_mut());
                of_tiles.for_each(|(columns, tile)| *tile = columns.iter().copied().fold(*tile, either));
            }
        }
    }

    fn column(&self, p: &Vector3<f64>) -> usize {
        let x = ((p.x - self.left) / self.side) as usize;
        let y = ((p.y - self.bottom) / self.side) as usize;
        y.min(self.high - 1) * self.wide + x.min(self.wide - 1)
    }

    /// All points, in the fixed order of the columns.
    pub fn points(&self) -> impl Iterator<Item = Vector3<f64>> {
        let [x, y, z] = &self.coordinates;
        x.iter().zip(y).zip(z).map(|((x, y), z)| Vector3::new(*x, *y, *z))
    }

    /// The columns, of those in a line, that meet a span of coordinates, metres.
    #[inline(always)]
    fn columns(&self, [from, to]: [f64; 2], start: f64, count: usize) -> Range<usize> {
        let place = |value: f64| (value - start) / self.side;
        let (from, to) = (place(from) - SLACK, place(to) + SLACK);
        let first = from.max(0.0) as usize;
        if to < 0.0 || first >= count { 0..0 } else { first..(to as usize + 1).min(count) }
    }

    /// The rows of columns that meet a span of Y, metres.
    #[inline(always)]
    fn rows(&self, span: [f64; 2]) -> Range<usize> {
        self.columns(span, self.bottom, self.high)
    }

    /// Where some rows or columns of columns, `count` of them from one on, begin and end, metres, where the first of all begins at `start`.
    #[inline(always)]
    fn band(&self, place: usize, count: usize, start: f64) -> [f64; 2] {
        let low = start + place as f64 * self.side;
        [low - SLACK * self.side, low + self.side * (count as f64 + SLACK)]
    }

    /// Places of the points of some columns of a row.
    #[inline(always)]
    fn places(&self, row: usize, columns: &Range<usize>) -> Range<usize> {
        let [first, end] = [columns.start, columns.end].map(|column| row * self.wide + column);
        if first < end { self.starts[first] as usize..self.starts[end] as usize } else { 0..0 }
    }

    /// The least and the greatest Z in the tiles of a row of them that hold some columns, metres.
    #[inline(always)]
    fn heights_about(&self, row_of_tiles: usize, columns: &Range<usize>) -> [f32; 2] {
        let tiles = tiles(columns);
        let row = &self.tiles[row_of_tiles * self.wide.div_ceil(TILE)..];
        row[tiles].iter().copied().fold(NO_HEIGHT, either)
    }

    /// Coordinates of the points of some places.
    #[inline(always)]
    fn at(&self, places: &Range<usize>) -> [&[f64]; 3] {
        let [x, y, z] = &self.coordinates;
        [&x[places.clone()], &y[places.clone()], &z[places.clone()]]
    }

    /// The normal of the plane through the points within a radius, towards positive Z, and how planar they are,
    /// (l2 - l3) / l1 of the eigenvalues of their covariance; `None` for fewer than 3 points.
    #[inline(always)]
    pub fn normal(&self, centre: &[f64; 3], radius_m: f64) -> Option<(Vector3<f64>, f64)> {
        let square_m2 = radius_m * radius_m;
        let mut sums = Moments::default();
        for row in self.rows([centre[1] - radius_m, centre[1] + radius_m]) {
            let [low, high] = self.band(row, 1, self.bottom - centre[1]);
            let off = low.max(-high).max(0.0);
            let half = (square_m2 - off * off).max(0.0).sqrt();
            let columns = self.columns([centre[0] - half, centre[0] + half], self.left, self.wide);
            let places = self.places(row, &columns);
            let points = self.at(&places);
            for first in (0..places.len()).step_by(WIDE) {
                sums.add(arms(points, first, centre), square_m2);
            }
        }
        sums.plane()
    }

    /// Number, mean and variance (n - 1) along the axis of the points in a cylinder, relative to its centre.
    #[inline(always)]
    pub fn along(&self, cylinder: &Cylinder, values: &mut Vec<f64>) -> Stack {
        let Cylinder { centre, axis, radius_m, half_m } = cylinder;
        let square_m2 = radius_m * radius_m;
        // A point is `t` axes and an arm across from the centre. What the arm reaches along X, Y and Z, a disc of the radius turned:
        let reach = |along: f64| radius_m * (1.0 - along * along).max(0.0).sqrt();
        let disc = [reach(axis[0]), reach(axis[1]), reach(axis[2]) + SLACK * self.side];
        // The part of the axis whose discs meet a band of X, Y or Z, within another part.
        let inverse = axis.map(|along| 1.0 / along);
        let part = |[low, high]: [f64; 2], along: usize, [from, to]: [f64; 2]| {
            let ends = [(low - disc[along]) * inverse[along], (high + disc[along]) * inverse[along]];
            [ends[0].min(ends[1]).max(from), ends[0].max(ends[1]).min(to)]
        };
        // What the discs of a part reach along X or Y.
        let reached = |along: usize, [from, to]: [f64; 2]| {
            let [one, other] = [from, to].map(|t| centre[along] + t * axis[along]);
            [one.min(other) - disc[along], one.max(other) + disc[along]]
        };
        // A long cylinder leaves the heights of the cloud near its centre.
        let whole = [-half_m, *half_m];
        let mut heights = NO_HEIGHT;
        for row_of_tiles in tiles(&self.rows(reached(1, whole))) {
            let within = part(self.band(row_of_tiles * TILE, TILE, self.bottom - centre[1]), 1, whole);
            if within[0] <= within[1] {
                let columns = self.columns(reached(0, within), self.left, self.wide);
                heights = either(heights, self.heights_about(row_of_tiles, &columns));
            }
        }
        let [low, high] = heights.map(f64::from);
        if low > high {
            return Stack::default();
        }
        let near = part([low - centre[2], high - centre[2]], 2, whole);
        let mut found = 0;
        for row in self.rows(reached(1, near)) {
            let [from, to] = part(self.band(row, 1, self.bottom - centre[1]), 1, near);
            if from > to {
                continue;
            }
            let mut columns = self.columns(reached(0, [from, to]), self.left, self.wide);
            // Most columns have no point at the height the axis has there.
            let meets = |column: usize| {
                let [from, to] = part(self.band(column, 1, self.left - centre[0]), 0, [from, to]);
                let [one, other] = [centre[2] + from * axis[2], centre[2] + to * axis[2]];
                let [low, high] = self.heights[row * self.wide + column].map(f64::from);
                from <= to && one.max(other) + disc[2] >= low && one.min(other) - disc[2] <= high
            };
            while columns.start < columns.end && !meets(columns.start) {
                columns.start += 1;
            }
            while columns.start < columns.end && !meets(columns.end - 1) {
                columns.end -= 1;
            }
            let places = self.places(row, &columns);
            values.resize(values.len().max(found + places.len() + WIDE), 0.0);
            let points = self.at(&places);
            for first in (0..places.len()).step_by(WIDE) {
                let [dx, dy, dz] = arms(points, first, centre);
                let t = dx * axis[0] + dy * axis[1] + dz * axis[2];
                let (dx, dy, dz) = (dx - t * axis[0], dy - t * axis[1], dz - t * axis[2]);
                let square = dx * dx + dy * dy + dz * dz;
                for lane in 0..WIDE {
                    values[found] = t[lane];
                    found += usize::from(t[lane].abs() < *half_m && square[lane] <= square_m2);
                }
            }
        }
        Stack::of(&values[..found])
    }
}

/// The arms from a centre to several points from one on; NaN beyond the last of them.
#[inline(always)]
fn arms([x, y, z]: [&[f64]; 3], first: usize, centre: &[f64; 3]) -> [Lanes<WIDE>; 3] {
    [
        Lanes::first_of(&x[first..]) - centre[0],
        Lanes::first_of(&y[first..]) - centre[1],
        Lanes::first_of(&z[first..]) - centre[2],
    ]
}

/// Number, sums, and sums of products xx, xy, xz, yy, yz, zz of points, by lane.
struct Moments([Lanes<WIDE>; 10]);

impl Default for Moments {
    fn default() -> Self {
        Self([Lanes::all(0.0); 10])
    }
}

impl Moments {
    /// Adds those of several arms that are within a radius, given by its square.
    #[inline(always)]
    fn add(&mut self, [x, y, z]: [Lanes<WIDE>; 3], square_m2: f64) {
        let square = x * x + y * y + z * z;
        let inside =
            |value: Lanes<WIDE>| value.with(square, |value, square| if square <= square_m2 { value } else { 0.0 });
        let (one, x, y, z) = (inside(Lanes::all(1.0)), inside(x), inside(y), inside(z));
        let [n, sx, sy, sz, xx, xy, xz, yy, yz, zz] = self.0;
        self.0 =
            [n + one, sx + x, sy + y, sz + z, xx + x * x, xy + x * y, xz + x * z, yy + y * y, yz + y * z, zz + z * z];
    }

    /// Normal and planarity; `None` for fewer than 3 points.
    fn plane(&self) -> Option<(Vector3<f64>, f64)> {
        let [n, x, y, z, xx, xy, xz, yy, yz, zz] = self.0.map(|lanes| lanes.each().iter().sum::<f64>());
        if n < 3.0 {
            return None;
        }
        let (sum, squares) = (Vector3::new(x, y, z), Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
        let eigen = SymmetricEigen::new((squares - sum * sum.transpose() / n) / (n - 1.0));
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [l1, l2, l3] = order.map(|place| eigen.eigenvalues[place]);
        let normal: Vector3<f64> = eigen.eigenvectors.column(order[2]).into_owned();
        let planarity = if l1 > 0.0 { (l2 - l3) / l1 } else { 0.0 };
        Some((if normal.z < 0.0 { -normal } else { normal }, planarity))
    }
}

/// A cylinder: its middle, the unit vector of its axis, its radius, and half its length, metres.
pub struct Cylinder {
    /// The middle, metres.
    pub centre: [f64; 3],
    /// Unit vector.
    pub axis: [f64; 3],
    /// Radius, metres.
    pub radius_m: f64,
    /// Half the length, metres.
    pub half_m: f64,
}

/// Values summed up: number, mean, sum of squares about the mean.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stack {
    /// Number of values.
    pub count: f64,
    /// Mean of the values; 0 without any.
    pub mean: f64,
    squares: f64,
}

impl Stack {
    fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count.max(1.0);
        Self { count, mean, squares: values.iter().map(|value| (value - mean) * (value - mean)).sum() }
    }

    /// Variance with n - 1; NaN for fewer than two values.
    pub fn variance(&self) -> f64 {
        if self.count < 2.0 { f64::NAN } else { self.squares / (self.count - 1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use rockface_core::testing::height_mesh;

    #[test]
    fn what_a_cylinder_holds_is_what_looking_at_every_point_finds() {
        let mesh = height_mesh(60, [-2.0, 2.0, -1.0, 1.0], |x, y| 0.2 * x - 0.1 * y);
        let cloud = Cloud::new(Shape::Mesh(&mesh), None, 0.13).unwrap();
        let centres = [Point3::new(0.1, 0.2, 0.0), Point3::new(-2.3, 1.1, 0.1), Point3::new(9.0, 0.0, 0.0)];
        // Across the face, and long and steep to neither X nor Y.
        for (axis, half_m) in [([0.3, -0.2, 0.9], 0.4), ([0.5, 0.6, -0.1], 3.0), ([-0.4, 0.3, 0.05], 1.0)] {
            let axis = Vector3::from(axis).normalize();
            for centre in centres {
                let cylinder = Cylinder { centre: centre.into(), axis: axis.into(), radius_m: 0.3, half_m };
                let found = cloud.along(&cylinder, &mut Vec::new());
                let arms = mesh.vertices.iter().map(|v| Vector3::from(*v) - centre.coords);
                let inside = |arm: &Vector3<f64>| {
                    let along = arm.dot(&axis);
                    along.abs() < half_m && (arm - axis * along).norm() <= 0.3
                };
                let expected: Vec<f64> = arms.filter(inside).map(|arm| arm.dot(&axis)).collect();
                assert_eq!(found.count as usize, expected.len());
                let mean = expected.iter().sum::<f64>() / expected.len().max(1) as f64;
                assert!((found.mean - mean).abs() < 1e-12);
            }
        }
        let (normal, planarity) = cloud.normal(&[0.0; 3], 0.5).unwrap();
        assert!((normal - Vector3::new(-0.2, 0.1, 1.0).normalize()).norm() < 1e-9 && planarity > 0.5);
        assert!(cloud.normal(&[50.0, 0.0, 0.0], 0.5).is_none());
    }

    #[test]
    fn mean_and_variance_by_hand() {
        let stack = Stack::of(&[1.0, 2.0, 4.0]);
        assert!((stack.mean - 7.0 / 3.0).abs() < 1e-14 && (stack.variance() - 7.0 / 3.0).abs() < 1e-12);
        assert!(Stack::of(&[]).variance().is_nan() && Stack::of(&[]) == Stack::default());
    }
}
