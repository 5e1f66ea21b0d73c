//! The oriented bounding box of a body: its long, intermediate and short axis.

use nalgebra::{Vector2, Vector3};
use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;

use rockface_core::numerics::portable_math;

use super::facets::{Facets, with_a_sign};

/// A box of any orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientedBox {
    /// Lengths of the edges, metres, longest first: L, I and S.
    pub sides_m: [f64; 3],
    /// Unit vectors along the edges in the same order, right-handed but for their signs.
    pub axes: [Vector3<f64>; 3],
}

impl OrientedBox {
    /// Volume, cubic metres.
    pub fn volume_m3(&self) -> f64 {
        self.sides_m.iter().product()
    }
}

/// Directions of hull faces that are tried: those of the largest faces. A rounded body has thousands, all alike.
const DIRECTIONS: usize = 64;
/// Directions whose sine is below this are one.
const PARALLEL: f64 = 1e-6;
/// First and last angle by which the best box is turned in search of a smaller one, radians.
const TURNS_RAD: [f64; 2] = [0.1, 1e-6];

/// The smallest box found flush with one of the larger faces of the convex hull or along `axes` (unit, orthogonal), then
/// turned in ever smaller steps while it shrinks.
///
/// For each face the other two axes are those of the rectangle of least area around the hull's projection, which is
/// flush with an edge. Where no hull can be made because the points lie in a plane up to rounding, the search begins with
/// the box along `axes`. `None` without vertices.
pub fn oriented_box(body: &Facets, axes: [Vector3<f64>; 3]) -> Option<OrientedBox> {
    let origin = Vector3::from(*body.vertices.first()?);
    let points: Vec<Vector3<f64>> = body.vertices.iter().map(|v| Vector3::from(*v) - origin).collect();
    let [points, normals] = match hull(&points) {
        Some([corners, normals]) if hold(&corners, &points, &normals) => [corners, normals],
        // The hull of a body that is all but flat may lack some of its corners.
        Some([_, normals]) => [points, normals],
        None => [points, Vec::new()],
    };
    let smaller = |best: OrientedBox, next: OrientedBox| if next.volume_m3() < best.volume_m3() { next } else { best };
    let flush = normals.into_iter().map(|normal| flush_with(&points, normal)).fold(along(&points, axes), smaller);
    let mut best = flush;
    let mut angle_rad = TURNS_RAD[0];
    while angle_rad > TURNS_RAD[1] {
        let turned = (0..6).map(|turn| along(&points, turned(&best.axes, turn, angle_rad))).fold(best, smaller);
        if turned == best {
            angle_rad *= 0.5;
        }
        best = turned;
    }
    // A box flush with a face is not left for one that is smaller by rounding alone.
    Some(if best.volume_m3() < flush.volume_m3() * (1.0 - 1e-9) { best } else { flush })
}

/// Axes turned about one of themselves, forwards for even and backwards for odd turns.
fn turned(axes: &[Vector3<f64>; 3], turn: usize, angle_rad: f64) -> [Vector3<f64>; 3] {
    let (sine, cosine) = portable_math::sincos(if turn.is_multiple_of(2) { angle_rad } else { -angle_rad });
    let about = axes[turn / 2];
    let side = axes[(turn / 2 + 1) % 3];
    let side = (side * cosine + about.cross(&side) * sine).normalize();
    [about, side, about.cross(&side).normalize()]
}

/// Vertices of the convex hull and the unit normals of its largest faces, where there is one.
fn hull(points: &[Vector3<f64>]) -> Option<[Vec<Vector3<f64>>; 2]> {
    let vectors: Vec<Vector> = points.iter().map(|p| Vector::new(p.x, p.y, p.z)).collect();
    let (vertices, faces) = try_convex_hull(&vectors).ok()?;
    let vertices: Vec<Vector3<f64>> = vertices.iter().map(|v| Vector3::new(v.x, v.y, v.z)).collect();
    let doubled_area = |[a, b, c]: [Vector3<f64>; 3]| (b - a).cross(&(c - a));
    let mut areas: Vec<Vector3<f64>> =
        faces.iter().map(|face| doubled_area(face.map(|corner| vertices[corner as usize]))).collect();
    areas.sort_by(|a, b| b.norm_squared().total_cmp(&a.norm_squared()));
    let mut normals: Vec<Vector3<f64>> = Vec::new();
    for normal in areas.iter().map_while(|area| area.try_normalize(0.0)) {
        if normals.len() == DIRECTIONS {
            break;
        }
        if normals.iter().all(|known| known.cross(&normal).norm() > PARALLEL) {
            normals.push(normal);
        }
    }
    Some([vertices, normals])
}

/// Whether corners reach as far along these directions as all points do, up to rounding.
fn hold(corners: &[Vector3<f64>], points: &[Vector3<f64>], directions: &[Vector3<f64>]) -> bool {
    directions.iter().all(|axis| extent(points, axis) <= extent(corners, axis) * (1.0 + 1e-9) + 1e-12)
}

/// How far points reach along an axis.
fn extent(points: &[Vector3<f64>], axis: &Vector3<f64>) -> f64 {
    let grow = |[low, high]: [f64; 2], value: f64| [low.min(value), high.max(value)];
    let [low, high] = points.iter().map(|p| p.dot(axis)).fold([f64::INFINITY, f64::NEG_INFINITY], grow);
    high - low
}

/// The box along three axes.
fn along(points: &[Vector3<f64>], axes: [Vector3<f64>; 3]) -> OrientedBox {
    let mut sides = axes.map(|axis| (extent(points, &axis), with_a_sign(axis)));
    sides.sort_by(|a, b| b.0.total_cmp(&a.0));
    OrientedBox { sides_m: sides.map(|side| side.0), axes: sides.map(|side| side.1) }
}

/// The smallest box with one pair of faces across a unit normal.
fn flush_with(points: &[Vector3<f64>], normal: Vector3<f64>) -> OrientedBox {
    // The coordinate axis the normal leans to least is far from parallel to it.
    let mut aside = Vector3::zeros();
    aside[normal.iamin()] = 1.0;
    let u = normal.cross(&aside).normalize();
    let v = normal.cross(&u);
    let outline = outline(points.iter().map(|p| Vector2::new(p.dot(&u), p.dot(&v))).collect());
    let turned = |direction: Vector2<f64>| u * direction.x + v * direction.y;
    let direction = least_rectangle(&outline).unwrap_or_else(Vector2::x);
    let side = turned(direction);
    along(points, [normal, side, normal.cross(&side)])
}

/// Convex hull of points in the plane, counter-clockwise (Andrew's monotone chain).
fn outline(mut points: Vec<Vector2<f64>>) -> Vec<Vector2<f64>> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut chain = half(points.iter());
    chain.pop();
    chain.extend(half(points.iter().rev()));
    chain.pop();
    chain
}

fn half<'a>(points: impl Iterator<Item = &'a Vector2<f64>>) -> Vec<Vector2<f64>> {
    let mut chain: Vec<Vector2<f64>> = Vec::new();
    for point in points {
        while let [.., a, b] = chain.as_slice()
            && (b - a).perp(&(point - b)) <= 0.0
        {
            chain.pop();
        }
        chain.push(*point);
    }
    chain
}

/// Direction of an edge of the convex polygon along which the rectangle around it has the least area.
fn least_rectangle(outline: &[Vector2<f64>]) -> Option<Vector2<f64>> {
    let mut best: Option<(f64, Vector2<f64>)> = None;
    for (a, b) in outline.iter().zip(outline.iter().cycle().skip(1)) {
        let Some(direction) = (b - a).try_normalize(0.0) else { continue };
        let mut extent = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for point in outline {
            let (along, across) = (direction.dot(point), direction.perp(point));
            extent = [extent[0].min(along), extent[1].max(along), extent[2].min(across), extent[3].max(across)];
        }
        let area = (extent[1] - extent[0]) * (extent[3] - extent[2]);
        if best.is_none_or(|(least, _)| area < least) {
            best = Some((area, direction));
        }
    }
    best.map(|(_, direction)| direction)
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;
    use proptest::prelude::*;

    use super::*;

    fn found(body: &Facets) -> OrientedBox {
        oriented_box(body, body.body().unwrap().principal_axes()).unwrap()
    }

    #[test]
    fn a_turned_cube_is_found_though_its_principal_axes_are_any() {
        let turn = Rotation3::from_euler_angles(0.3, 0.9, -2.0);
        let cube = Facets::cuboid(1.0, 1.0, 1.0).moved(|p| turn * p + Vector3::new(5e5, 5e6, 0.0));
        let found = found(&cube);
        assert!(found.sides_m.iter().all(|side| (side - 1.0).abs() < 1e-8), "{found:?}");
    }

    #[test]
    fn a_wedge_lies_in_the_box_of_its_legs() {
        // Half a box: whichever face of the wedge its box is flush with, it is half of that box.
        let mut wedge = Facets::cuboid(4.0, 2.0, 1.0);
        wedge.vertices[7] = wedge.vertices[5];
        wedge.vertices[6] = wedge.vertices[4];
        let found = found(&wedge);
        assert!((found.volume_m3() - 8.0).abs() < 1e-9, "{found:?}");
        assert!((found.axes[0] - Vector3::x()).norm() < 1e-9 && (found.sides_m[0] - 4.0).abs() < 1e-9);
    }

    #[test]
    fn points_in_a_plane_get_the_box_along_the_given_axes() {
        let flat = Facets { vertices: vec![[0.0; 3], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0]], triangles: vec![[0, 1, 2]] };
        let found = oriented_box(&flat, [Vector3::x(), Vector3::y(), Vector3::z()]).unwrap();
        assert!((found.sides_m[0] - 2.0).abs() < 1e-12 && found.sides_m[2].abs() < 1e-12);
    }

    #[test]
    fn a_sharp_tetrahedron_is_held_whole() {
        let vertices = vec![
            [-0.619_912_578_688_508_2, 0.322_299_050_548_414_6, 0.020_150_330_604_063_79],
            [-0.876_422_407_130_403_6, 0.092_106_127_821_556_6, -0.163_489_030_705_177_1],
            [-0.340_134_054_480_352_8, 0.769_934_893_752_146_1, 0.289_477_255_951_315_24],
            [0.984_696_835_631_387_9, -0.293_853_245_590_476, 0.451_723_142_528_943_1],
        ];
        let body = Facets { vertices, triangles: Vec::new() };
        let found = oriented_box(&body, [Vector3::x(), Vector3::y(), Vector3::z()]).unwrap();
        for (axis, side) in found.axes.iter().zip(found.sides_m) {
            let along: Vec<f64> = body.vertices.iter().map(|v| Vector3::from(*v).dot(axis)).collect();
            let ends = along.iter().fold([f64::MAX, f64::MIN], |[low, high], x| [low.min(*x), high.max(*x)]);
            assert!(ends[1] - ends[0] <= side + 1e-9, "{found:?} {ends:?}");
        }
        let [low, high] = body.bounds().unwrap();
        let aligned: f64 = (0..3).map(|i| high[i] - low[i]).product();
        assert!(found.volume_m3() <= aligned, "{found:?} {aligned}");
    }

    proptest! {
        #[test]
        fn any_box_is_found_to_rounding(
            sides in prop::array::uniform3(0.05f64..4.0), angles in prop::array::uniform3(-3.0f64..3.0),
        ) {
            let turn = Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
            let found = found(&Facets::cuboid(sides[0], sides[1], sides[2]).moved(|p| turn * p));
            let mut sides = sides;
            sides.sort_by(|a, b| b.total_cmp(a));
            for (side, expected) in found.sides_m.iter().zip(sides) {
                prop_assert!((side - expected).abs() < 1e-9, "{:?} {:?}", found, sides);
            }
        }

        #[test]
        fn the_box_holds_every_point_and_no_axis_aligned_box_is_smaller(
            vertices in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 4..30),
        ) {
            let body = Facets { vertices, triangles: Vec::new() };
            let found = oriented_box(&body, [Vector3::x(), Vector3::y(), Vector3::z()]).unwrap();
            let [low, high] = body.bounds().unwrap();
            let aligned: f64 = (0..3).map(|i| high[i] - low[i]).product();
            prop_assert!(found.volume_m3() <= aligned * (1.0 + 1e-12));
            for (axis, side) in found.axes.iter().zip(found.sides_m) {
                let along: Vec<f64> = body.vertices.iter().map(|v| Vector3::from(*v).dot(axis)).collect();
                let extent = along.iter().copied().fold(f64::MIN, f64::max) - along.iter().copied().fold(f64::MAX, f64::min);
                prop_assert!(extent <= side + 1e-9);
            }
        }
    }
}
