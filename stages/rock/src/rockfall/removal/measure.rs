//! Area, centroid and depth of pieces of rock.

use nalgebra::{Matrix3, Vector3};

use super::face::Rect;
use crate::face::tetrahedra::tetrahedra;

/// The sum of the areas of triangles, square metres.
pub fn area_m2(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> f64 {
    let at = |v: u32| Vector3::from(vertices[v as usize]);
    triangles.iter().fold(0.0, |sum, [a, b, c]| sum + (at(*b) - at(*a)).cross(&(at(*c) - at(*a))).norm()) / 2.0
}

/// The volume centroid of a closed mesh; that of its vertices where it has no volume.
pub fn centroid(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> [f64; 3] {
    let sum = vertices.iter().fold(Vector3::zeros(), |sum, v| sum + Vector3::from(*v));
    let mean = sum / (vertices.len().max(1) as f64);
    let (mut moment, mut volume) = (Vector3::zeros(), 0.0);
    for ([a, b, c], part) in tetrahedra(vertices, triangles, mean.into()) {
        volume += part;
        moment += (a + b + c) * part;
    }
    if volume > 0.0 { (mean + moment / (4.0 * volume)).into() } else { mean.into() }
}

/// How far, as a share of the way to the centre of its triangle, a corner is moved in before the surface over or under it is looked for: the
/// rims of a niche and of the rock face over it coincide, and rounding would decide whether a point on them is inside.
const INWARD: f64 = 1e-6;

/// More than the rounding of a height between three corners, metres.
const ROUNDING_M: f64 = 1e-9;

/// The greatest distance, along a direction, between the triangles of `deep` and those of `cover` over them, metres, looked for at the corners of
/// both; 0 where none is under any. The niche of a prism along the direction has no vertex but those under the rim of its cover.
pub fn depth_m(vertices: &[[f64; 3]], deep: &[[u32; 3]], cover: &[[u32; 3]], frame: &Matrix3<f64>) -> f64 {
    let turned: Vec<[f64; 3]> = vertices.iter().map(|v| (frame.transpose() * Vector3::from(*v)).into()).collect();
    let greatest = |from: &[[u32; 3]], to: &[[u32; 3]], sign: f64| {
        let lids = Lids::new(&turned, to);
        let bounds = lids.bounds(sign);
        let corners = from.iter().flat_map(|triangle| inner_corners(triangle.map(|v| turned[v as usize])));
        corners.fold(0.0, |depth: f64, [x, y, z]| {
            if bounds[lids.cell_at(x, y)] - sign * z + ROUNDING_M < depth {
                return depth;
            }
            lids.heights(x, y).fold(depth, |depth, other| depth.max(sign * (other - z)))
        })
    };
    greatest(deep, cover, 1.0).max(greatest(cover, deep, -1.0))
}

/// The corners of a triangle, moved a little towards its centre.
fn inner_corners(corners: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let [a, b, c] = corners;
    let centre = [0, 1, 2].map(|k| (a[k] + b[k] + c[k]) / 3.0);
    corners.map(|corner| [0, 1, 2].map(|k| corner[k] + INWARD * (centre[k] - corner[k])))
}

/// Triangles sorted into square cells over the first two coordinates, to find those above a point.
pub struct Lids<'a> {
    places: &'a [[f64; 3]],
    triangles: Vec<[u32; 3]>,
    low: [f64; 2],
    side: f64,
    wide: usize,
    high: usize,
    cells: Vec<Vec<u32>>,
}

impl<'a> Lids<'a> {
    /// Sorts triangles into cells, about as many as there are triangles.
    pub fn new(places: &'a [[f64; 3]], triangles: &[[u32; 3]]) -> Self {
        let rect = Rect::around(triangles.iter().flatten().map(|v| &places[*v as usize]));
        let size = [0, 1].map(|k| (rect.high[k] - rect.low[k]).max(0.0));
        let side = ((size[0] * size[1]) / (triangles.len().max(1) as f64)).sqrt().max(size[0].max(size[1]) / 1000.0);
        let side = if side > 0.0 && side.is_finite() { side } else { 1.0 };
        let [wide, high] = size.map(|s| (s / side) as usize + 1);
        let mut lids = Self {
            places,
            triangles: triangles.to_vec(),
            low: rect.low.map(|x| if x.is_finite() { x } else { 0.0 }),
            side,
            wide,
            high,
            cells: vec![Vec::new(); wide * high],
        };
        for (number, t) in triangles.iter().enumerate() {
            let rect = Rect::around(t.iter().map(|v| &places[*v as usize]));
            let ([left, bottom], [right, top]) = (lids.cell(rect.low), lids.cell(rect.high));
            for row in bottom..=top {
                for column in left..=right {
                    lids.cells[row * wide + column].push(number as u32);
                }
            }
        }
        lids
    }

    fn cell(&self, p: [f64; 2]) -> [usize; 2] {
        let cell = |k: usize, count: usize| (((p[k] - self.low[k]) / self.side).max(0.0) as usize).min(count - 1);
        [cell(0, self.wide), cell(1, self.high)]
    }

    /// The number of the cell of a point.
    fn cell_at(&self, x: f64, y: f64) -> usize {
        let [column, row] = self.cell([x, y]);
        row * self.wide + column
    }

    /// By cell, the greatest third coordinate, times `sign`, that its triangles have anywhere: no height in it is greater, but for rounding.
    fn bounds(&self, sign: f64) -> Vec<f64> {
        let highest = |number: &u32| {
            let corners = self.triangles[*number as usize].map(|v| sign * self.places[v as usize][2]);
            corners.into_iter().fold(f64::NEG_INFINITY, f64::max)
        };
        self.cells.iter().map(|cell| cell.iter().map(highest).fold(f64::NEG_INFINITY, f64::max)).collect()
    }

    /// The third coordinate of every triangle over or under a point, in the order of the triangles.
    pub fn heights(&self, x: f64, y: f64) -> impl Iterator<Item = f64> {
        self.cells[self.cell_at(x, y)].iter().filter_map(move |number| {
            let [a, b, c] = self.triangles[*number as usize].map(|v| self.places[v as usize]);
            height_in([a, b, c], x, y)
        })
    }
}

/// Height of a triangle at a point inside its outline (edges included); none beside it or where it stands upright.
pub fn height_in([a, b, c]: [[f64; 3]; 3], x: f64, y: f64) -> Option<f64> {
    let cross = |p: [f64; 3], q: [f64; 3]| (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]);
    let (wc, wa, wb) = (cross(a, b), cross(b, c), cross(c, a));
    let inside = (wa >= 0.0 && wb >= 0.0 && wc >= 0.0) || (wa <= 0.0 && wb <= 0.0 && wc <= 0.0);
    let sum = wa + wb + wc;
    (inside && sum != 0.0).then(|| (wa * a[2] + wb * b[2] + wc * c[2]) / sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    #[test]
    fn a_corner_of_a_cube_has_the_known_area_centroid_and_depth() {
        let places = [[10.0, 20.0, 30.0], [11.0, 20.0, 30.0], [10.0, 21.0, 30.0], [10.0, 20.0, 31.0]];
        let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        assert!((area_m2(&places, &triangles[..3]) - 1.5).abs() < 1e-15);
        let centre = centroid(&places, &triangles);
        assert!((0..3).all(|k| (centre[k] - places[0][k] - 0.25).abs() < 1e-12), "{centre:?}");
        let depth = depth_m(&places, &triangles[..1], &triangles[3..], &Matrix3::identity());
        assert!((depth - 1.0).abs() < 2e-6, "{depth}");
        let frame = Matrix3::from_columns(&[Vector3::y(), Vector3::z(), Vector3::x()]);
        assert!((depth_m(&places, &triangles[2..3], &triangles[3..], &frame) - 1.0).abs() < 2e-6);
    }

    #[test]
    fn a_prism_along_the_direction_is_as_deep_as_it_is_whichever_way_it_is_turned() {
        // Its lid, its walls and its bottom share all their vertices with the rim of the lid, or have them right under it.
        let corner = |i: u32| [f64::from(i & 1), f64::from(i >> 1 & 1), 0.4 * f64::from(i >> 2 & 1)];
        let lid = [[4, 5, 7], [4, 7, 6]];
        let niche = [
            [0, 3, 1],
            [0, 2, 3],
            [0, 1, 5],
            [0, 5, 4],
            [2, 6, 7],
            [2, 7, 3],
            [0, 4, 6],
            [0, 6, 2],
            [1, 3, 7],
            [1, 7, 5],
        ];
        for turn in 0..300 {
            let [roll, pitch, yaw] = [0.017, 0.031, 0.053].map(|step| step * f64::from(turn));
            let frame = nalgebra::Rotation3::from_euler_angles(roll, pitch, yaw).into_inner();
            let places: Vec<[f64; 3]> =
                (0..8).map(|i| (frame * Vector3::from(corner(i)) + Vector3::new(17.3, -4.1, 2.9)).into()).collect();
            let depth = depth_m(&places, &niche, &lid, &frame);
            assert!((depth - 0.4).abs() < 1e-5, "turn {turn}: {depth}");
        }
    }

    #[test]
    fn heights_are_those_of_the_surface() {
        let mesh = height_mesh(7, [-1.0, 3.0, 2.0, 4.0], |x, y| 2.0 * x - y);
        let lids = Lids::new(&mesh.vertices, &mesh.triangles);
        for (x, y) in [(0.1, 2.3), (-0.99, 3.99), (2.5, 3.0)] {
            let first = lids.heights(x, y).next().unwrap();
            assert!((first - (2.0 * x - y)).abs() < 1e-12, "{x} {y} {first}");
        }
        assert_eq!(lids.heights(9.0, 9.0).count(), 0);
    }
}
