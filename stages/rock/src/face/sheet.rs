//! A 2.5D mesh of a point cloud: Delaunay triangles in a plane, without those that bridge gaps.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};

use super::cloud::Cloud;
use super::half_edges::{BORDER, HalfEdges};
use super::{orient, repair};
use rockface_core::artefact::{Frame, Mesh};
use rockface_core::numerics::quantile;
use rockface_core::{StageError, fail};
use rockface_raster::mesh_check;

/// Coordinates nearer to zero than this are zero: the triangulation's exact arithmetic needs room below.
const LEAST_COORDINATE_M: f64 = 1e-30;

/// Triangles at the border flatter than this share of the median edge bridge a bay of the border and nothing else.
const LEAST_HEIGHT: f64 = 0.01;

/// The plane a cloud is triangulated in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetPlane {
    /// A point of the plane, metres.
    pub origin: Vector3<f64>,
    /// Rows: two directions in the plane and the normal, towards which the triangles will face.
    pub axes: Matrix3<f64>,
}

/// How a cloud becomes a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rules {
    /// One point a cell of this side in the plane is kept, the nearest to its centre, metres; `None`: all points.
    pub cell_m: Option<f64>,
    /// Triangles with a longer edge in the plane are dropped, metres; `None`: by `max_edge_medians`.
    pub max_edge_m: Option<f64>,
    /// The longest edge in units of the median one.
    pub max_edge_medians: f64,
    /// Fewest triangles of a piece.
    pub min_piece_triangles: usize,
}

/// What became of the cloud.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Made {
    /// Points left out because another stands for their cell.
    pub thinned_points: usize,
    /// Points left out because another lies before them at the same place of the plane.
    pub covered_points: usize,
    /// Points no triangle uses in the end.
    pub unused_points: usize,
    /// Median length of the edges in the plane, metres.
    pub median_edge_m: f64,
    /// Longest edge in the plane that was kept, metres.
    pub max_edge_m: f64,
    /// Triangles dropped for a long edge.
    pub long_triangles: usize,
    /// Triangles dropped because they were flat and lay at the border.
    pub flat_triangles: usize,
    /// Triangles dropped because they hung on the rest in a point only, or in small pieces.
    pub loose_triangles: usize,
}

struct Node {
    at: Point2<f64>,
    number: u32,
}

impl HasPosition for Node {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.at
    }
}

/// Meshes a cloud in a plane; vertices are points of the cloud, to the bit and in their order, with their colours.
///
/// # Errors
/// Fewer than three points, points the triangulation cannot hold, or no triangle left.
pub fn mesh(cloud: &Cloud, plane: &SheetPlane, rules: &Rules, frame: Frame) -> Result<(Mesh, Made), StageError> {
    let flat: Vec<Vector3<f64>> =
        cloud.points.par_iter().map(|p| (plane.axes * (Vector3::from(*p) - plane.origin)).map(snap)).collect();
    let mut made = Made::default();
    let mut kept: Vec<u32> = (0..flat.len() as u32).collect();
    if let Some(cell_m) = rules.cell_m {
        kept = thinned(&flat, cell_m);
    }
    made.thinned_points = flat.len() - kept.len();
    let before = kept.len();
    kept = foremost(&flat, kept);
    made.covered_points = before - kept.len();
    let mut triangles = delaunay(&flat, &kept)?;
    made.median_edge_m = median_edge(&flat, &triangles);
    made.max_edge_m = rules.max_edge_m.unwrap_or(rules.max_edge_medians * made.median_edge_m);
    let all = triangles.len();
    triangles.retain(|triangle| edges(&flat, triangle).iter().all(|length| *length <= made.max_edge_m));
    made.long_triangles = all - triangles.len();
    let (vertices, colours) = (cloud.points.clone(), cloud.colours.clone());
    let mut mesh = Mesh { frame, vertices, triangles, colours };
    made.flat_triangles = peel(&mut mesh, &flat, LEAST_HEIGHT * made.median_edge_m);
    made.loose_triangles = mesh.triangles.len();
    // A pinch that goes may leave a small piece, and never the other way round.
    repair::drop_small_pieces(&mut mesh, rules.min_piece_triangles);
    orient::drop_pinches(&mut mesh);
    repair::drop_small_pieces(&mut mesh, rules.min_piece_triangles);
    made.loose_triangles -= mesh.triangles.len();
    made.unused_points = mesh_check::drop_unreferenced(&mut mesh) - made.thinned_points - made.covered_points;
    if mesh.triangles.is_empty() {
        fail!(
            "of {all} triangles {} have an edge longer than {:.3e} m, {} are flat and {} lie in pieces of fewer than {} triangles: none is left",
            made.long_triangles,
            made.max_edge_m,
            made.flat_triangles,
            made.loose_triangles,
            rules.min_piece_triangles
        );
    }
    Ok((mesh, made))
}

fn snap(x: f64) -> f64 {
    if x.abs() < LEAST_COORDINATE_M { 0.0 } else { x }
}

/// Of each cell of the plane the point nearest to its centre, the first of several; ascending.
fn thinned(flat: &[Vector3<f64>], cell_m: f64) -> Vec<u32> {
    let key = |(number, p): (usize, &Vector3<f64>)| {
        let (u, v) = (p.x / cell_m, p.y / cell_m);
        let (column, row) = (u.floor(), v.floor());
        let (du, dv) = (u - column - 0.5, v - row - 0.5);
        // Not negative, so that the bits sort like the numbers.
        (column as i64, row as i64, (du * du + dv * dv).to_bits(), number as u32)
    };
    let mut keys: Vec<_> = flat.par_iter().enumerate().map(key).collect();
    keys.par_sort_unstable();
    keys.dedup_by_key(|key| (key.0, key.1));
    let mut kept: Vec<u32> = keys.into_iter().map(|key| key.3).collect();
    kept.sort_unstable();
    kept
}

/// Of points at one place of the plane the one farthest out, the first of several; ascending.
fn foremost(flat: &[Vector3<f64>], mut kept: Vec<u32>) -> Vec<u32> {
    let at = |number: &u32| &flat[*number as usize];
    kept.par_sort_unstable_by(|a, b| {
        let (p, q) = (at(a), at(b));
        (p.x.total_cmp(&q.x)).then(p.y.total_cmp(&q.y)).then(q.z.total_cmp(&p.z)).then(a.cmp(b))
    });
    kept.dedup_by(|a, b| (at(a).x, at(a).y) == (at(b).x, at(b).y));
    kept.sort_unstable();
    kept
}

/// Delaunay triangles of some points, counter-clockwise, by their numbers in the cloud.
fn delaunay(flat: &[Vector3<f64>], kept: &[u32]) -> Result<Vec<[u32; 3]>, StageError> {
    let node = |number: &u32| {
        let p = &flat[*number as usize];
        Node { at: Point2::new(p.x, p.y), number: *number }
    };
    let nodes: Vec<Node> = kept.iter().map(node).collect();
    let triangulation = DelaunayTriangulation::<Node>::bulk_load(nodes)
        .map_err(|e| format!("the points cannot be triangulated ({e}); are they in metres?"))?;
    let triangles: Vec<[u32; 3]> =
        triangulation.inner_faces().map(|face| face.vertices().map(|vertex| vertex.data().number)).collect();
    if triangles.is_empty() {
        fail!("{} different points in the plane, or all on one line, span no triangle", kept.len());
    }
    Ok(triangles)
}

fn edges(flat: &[Vector3<f64>], triangle: &[u32; 3]) -> [f64; 3] {
    let [a, b, c] = triangle.map(|i| flat[i as usize].xy());
    [(b - a).norm(), (c - b).norm(), (a - c).norm()]
}

/// Drops, again and again, triangles flatter than a height whose longest edge is on the border; returns how many went.
fn peel(mesh: &mut Mesh, flat: &[Vector3<f64>], least_height_m: f64) -> usize {
    let before = mesh.triangles.len();
    loop {
        let halves = HalfEdges::new(mesh);
        let is_bridge = |(number, triangle): (usize, &[u32; 3])| {
            let lengths = edges(flat, triangle);
            let longest = (0..3).reduce(|a, b| if lengths[b] > lengths[a] { b } else { a }).unwrap_or(0);
            let [a, b, c] = triangle.map(|i| flat[i as usize].xy());
            let height_m = (b - a).perp(&(c - a)) / lengths[longest];
            height_m < least_height_m && halves.twins[3 * number + longest] == BORDER
        };
        let bridges: Vec<bool> = mesh.triangles.par_iter().enumerate().map(is_bridge).collect();
        drop(halves);
        let count = mesh.triangles.len();
        let mut flags = bridges.iter();
        mesh.triangles.retain(|_| flags.next().is_some_and(|bridge| !bridge));
        if mesh.triangles.len() == count {
            return before - count;
        }
    }
}

/// Median over the edges of all triangles, those inside counted twice.
fn median_edge(flat: &[Vector3<f64>], triangles: &[[u32; 3]]) -> f64 {
    let mut lengths: Vec<f64> = triangles.par_iter().flat_map_iter(|triangle| edges(flat, triangle)).collect();
    quantile::median(&mut lengths).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::inspection::Inspection;
    use nalgebra::Rotation3;
    use rockface_core::numerics::random::Key;

    const RULES: Rules = Rules { cell_m: None, max_edge_m: None, max_edge_medians: 4.0, min_piece_triangles: 10 };

    /// Scattered points of a tilted square of 20 m with a round hole of radius 4 m, at UTM magnitudes.
    fn scattered(count: i32) -> (Cloud, SheetPlane) {
        let axes = Rotation3::from_euler_angles(1.1, -0.4, 0.7).into_inner().transpose();
        let origin = Vector3::new(451_000.0, 5_512_000.0, 300.0);
        let field = Key([4; 32]).field();
        let unit = |word: u32| f64::from(word) / f64::from(u32::MAX);
        let place = |i: i32| {
            let [a, b, c, _] = field.words(i, 0);
            Vector3::new(20.0 * unit(a) - 10.0, 20.0 * unit(b) - 10.0, 0.1 * unit(c))
        };
        let places = (0..count).map(place).filter(|p| p.xy().norm() > 4.0);
        let points: Vec<[f64; 3]> = places.map(|p| (axes.transpose() * p + origin).into()).collect();
        let colours = (0..points.len()).map(|i| [(i % 251) as u8, 0, 9]).collect();
        (Cloud { points, colours, ..Cloud::default() }, SheetPlane { origin, axes })
    }

    #[test]
    fn a_cloud_with_a_hole_becomes_a_manifold_with_a_hole() {
        let (cloud, plane) = scattered(6000);
        let (mesh, made) = mesh(&cloud, &plane, &RULES, Frame::World).unwrap();
        let found = Inspection::of(&mesh);
        assert_eq!((found.pieces.len(), found.holes.len()), (1, 1));
        assert_eq!((found.crowded_edges.count, found.opposed_edges.count, found.pinched_vertices.count), (0, 0, 0));
        let (area, normal) = found.open_area().unwrap();
        let projected = normal.dot(&plane.axes.row(2).transpose());
        let expected = 400.0 - 16.0 * std::f64::consts::PI;
        assert!((projected - expected).abs() < 0.04 * expected && area > projected, "{projected} of {expected} m2");
        assert_eq!(mesh.vertices.len() + made.unused_points, cloud.points.len());
        // Vertices are points of the cloud, to the bit, with their colours and in their order.
        let mut rest = cloud.points.iter().zip(&cloud.colours);
        assert!(mesh.vertices.iter().zip(&mesh.colours).all(|pair| rest.any(|point| point == pair)));
    }

    #[test]
    fn a_thinned_cloud_has_one_point_a_cell() {
        let (cloud, plane) = scattered(6000);
        let rules = Rules { cell_m: Some(0.5), ..RULES };
        let (mesh, made) = mesh(&cloud, &plane, &rules, Frame::World).unwrap();
        let cell =
            |p: &[f64; 3]| (plane.axes * (Vector3::from(*p) - plane.origin)).xy().map(|x| (x / 0.5).floor() as i64);
        let mut cells: Vec<[i64; 2]> = mesh.vertices.iter().map(|p| cell(p).into()).collect();
        cells.sort_unstable();
        let all = cells.len();
        cells.dedup();
        assert_eq!(cells.len(), all);
        assert!((1300..=1600).contains(&all) && made.thinned_points > 3000, "{all} cells, {made:?}");
        assert!((0.4..0.7).contains(&made.median_edge_m), "{made:?}");
    }

    #[test]
    fn points_behind_others_and_on_lines_are_no_trouble() {
        let axes = Matrix3::identity();
        let plane = SheetPlane { origin: Vector3::zeros(), axes };
        let line: Vec<[f64; 3]> = (0..9).map(|i| [f64::from(i), f64::from(i), 0.0]).collect();
        let cloud = |points: &[[f64; 3]]| Cloud { points: points.to_vec(), ..Cloud::default() };
        assert!(mesh(&cloud(&line), &plane, &RULES, Frame::World).unwrap_err().message.contains("span no triangle"));
        assert!(mesh(&cloud(&[]), &plane, &RULES, Frame::World).is_err());
        let grid: Vec<[f64; 3]> = (0..100).map(|i| [f64::from(i % 10), f64::from(i / 10), 0.0]).collect();
        let twice: Vec<[f64; 3]> =
            grid.iter().chain(&grid).enumerate().map(|(i, p)| [p[0], p[1], (i / 100) as f64]).collect();
        let (flat, made) = mesh(&cloud(&twice), &plane, &RULES, Frame::World).unwrap();
        assert_eq!((made.covered_points, flat.triangles.len()), (100, 162));
        assert!(flat.vertices.iter().all(|p| (p[2] - 1.0).abs() < 1e-12), "the foremost are kept");
        let strict = Rules { max_edge_m: Some(0.5), ..RULES };
        assert!(mesh(&cloud(&grid), &plane, &strict, Frame::World).unwrap_err().message.contains("none is left"));
    }
}
