//! Blocks bounded by discontinuities: polyhedra between planes of joint sets, and whether they can slide.

use super::draw::Drawing;
use super::hull::hull;
use super::{BlockError, Solid};
use nalgebra::{Matrix3, Vector3};
use rockface_core::artefact::Candidates;
use rockface_core::artefact::candidates::{JointBlock, JointSet, JointWedge, Kinematics, Quantity};
use rockface_core::numerics::portable_math;
use rockface_raster::plane_fit::azimuth_deg;

/// Planes whose unit normals span a smaller volume meet too far away to bound a block.
const LEAST_SPAN: f64 = 0.02;
/// Points of a block closer than this share of its size are one point.
const SAME_POINT: f64 = 1e-9;

/// All x with `normal . x <= offset`, metres.
#[derive(Debug, Clone, Copy)]
struct HalfSpace {
    normal: Vector3<f64>,
    offset: f64,
}

/// The rows X, Y, Z of the wall frame in east, north, up, for a face by its dip and dip direction in degrees.
///
/// Z is out of the face, Y up its line of dip. A face steeper than vertical (an overhang) has a dip above 90.
pub fn wall_from_enu(dip_deg: f64, dip_direction_deg: f64) -> [[f64; 3]; 3] {
    let z = upward_normal(dip_deg, dip_direction_deg);
    let y = -down_dip(dip_deg, dip_direction_deg);
    [y.cross(&z), y, z].map(Into::into)
}

/// The unit normal of a plane, upwards: east, north, up.
fn upward_normal(dip_deg: f64, dip_direction_deg: f64) -> Vector3<f64> {
    let ((sd, cd), (sa, ca)) = (turn(dip_deg), turn(dip_direction_deg));
    Vector3::new(sd * sa, sd * ca, cd)
}

/// The unit vector down the line of dip: east, north, up.
fn down_dip(dip_deg: f64, dip_direction_deg: f64) -> Vector3<f64> {
    let ((sd, cd), (sa, ca)) = (turn(dip_deg), turn(dip_direction_deg));
    Vector3::new(cd * sa, cd * ca, -sd)
}

fn turn(angle_deg: f64) -> (f64, f64) {
    portable_math::sincos(angle_deg.to_radians())
}

/// A parallelepiped, or richer polyhedron, between two planes of each set, about the origin; wall frame, metres.
pub fn block(block: &JointBlock, candidates: &Candidates, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let face = face(candidates)?;
    let mut planes = Vec::new();
    let mut normals = Vec::new();
    for (i, set) in block.sets.iter().enumerate() {
        let normal = plane_of(set, i, drawing);
        let spacing = drawing.value(&format!("shape.set_{}.spacing_m", i + 1), &set.spacing_m)?;
        let inwall = face * normal;
        planes.push(HalfSpace { normal: inwall, offset: 0.5 * spacing });
        planes.push(HalfSpace { normal: -inwall, offset: 0.5 * spacing });
        normals.push(normal);
    }
    if !any_three(&normals).any(|[a, b, c]| a.dot(&b.cross(&c)).abs() >= LEAST_SPAN) {
        return Err(BlockError::Unbounded);
    }
    let rule = Rule { friction: &block.friction_deg, lateral_deg: block.lateral_deg, wanted: block.kinematics };
    admit(&normals, &face, &rule, drawing)?;
    hull(&corners(&planes)).ok_or(BlockError::Unbounded)
}

/// The tetrahedron above two planes, behind the face and below an upper plane, its lowest point at the origin; wall frame,
/// metres. The planes must daylight: their line of intersection comes out of the face below the upper plane.
pub fn wedge(wedge: &JointWedge, candidates: &Candidates, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let face = face(candidates)?;
    let normals: Vec<Vector3<f64>> = wedge.sets.iter().enumerate().map(|(i, set)| plane_of(set, i, drawing)).collect();
    let height_m = drawing.value("shape.height_m", &wedge.height_m)?;
    let rule = Rule { friction: &wedge.friction_deg, lateral_deg: wedge.lateral_deg, wanted: wedge.kinematics };
    admit(&normals, &face, &rule, drawing)?;
    // The rock lies above a plane; before it where the plane is vertical.
    let under = |normal: &Vector3<f64>| {
        let outward = if normal.z.abs() > 1e-9 { normal.z } else { normal.dot(&out_of(&face)) };
        HalfSpace { normal: face * normal * if outward > 0.0 { -1.0 } else { 1.0 }, offset: 0.0 }
    };
    let upper = face * upward_normal(wedge.upper_dip_deg, wedge.upper_dip_direction_deg);
    let planes = [
        under(&normals[0]),
        under(&normals[1]),
        HalfSpace { normal: Vector3::z(), offset: 0.0 },
        HalfSpace { normal: upper, offset: height_m },
    ];
    let corners = corners(&planes);
    // Four planes have four corners in common exactly where they enclose a tetrahedron.
    if corners.len() == 4 { hull(&corners).ok_or(BlockError::Unbounded) } else { Err(BlockError::Unbounded) }
}

/// The rotation from east, north, up to the wall frame.
fn face(candidates: &Candidates) -> Result<Matrix3<f64>, BlockError> {
    let missing = || BlockError::Specification("joint sets need the orientation of the face".into());
    let rows = candidates.wall_from_enu.ok_or_else(missing)?;
    Ok(Matrix3::from_rows(&rows.map(|row| Vector3::from(row).transpose())))
}

/// The unit vector out of the face: east, north, up.
fn out_of(face: &Matrix3<f64>) -> Vector3<f64> {
    face.row(2).transpose()
}

/// The upward unit normal of one plane of a set (east, north, up), dispersed after Fisher (1953); its orientation is noted.
fn plane_of(set: &JointSet, index: usize, drawing: &mut Drawing) -> Vector3<f64> {
    let mean = upward_normal(set.dip_deg, set.dip_direction_deg);
    let name = format!("shape.set_{}", index + 1);
    let normal = match set.fisher_k {
        None => mean,
        Some(k) => {
            let share = 1.0 - drawing.uniform(&format!("{name}.off")) * (1.0 - portable_math::exp(-2.0 * k));
            let cos = (1.0 + portable_math::log(share) / k).clamp(-1.0, 1.0);
            around(mean, cos, std::f64::consts::TAU * drawing.uniform(&format!("{name}.turn")))
        }
    };
    let normal = if normal.z < 0.0 { -normal } else { normal };
    drawing.note(&format!("{name}.dip_deg"), portable_math::acos(normal.z.clamp(-1.0, 1.0)).to_degrees());
    drawing.note(&format!("{name}.dip_direction_deg"), azimuth_deg(&normal));
    normal
}

/// The unit vector at an angle (by its cosine) from a mean, turned about it.
fn around(mean: Vector3<f64>, cos: f64, turn_rad: f64) -> Vector3<f64> {
    let helper = if mean.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let across = helper.cross(&mean);
    let u = across * (1.0 / across.norm());
    let v = mean.cross(&u);
    let (s, c) = portable_math::sincos(turn_rad);
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    mean * cos + (u * c + v * s) * sin
}

fn any_three<T: Copy>(items: &[T]) -> impl Iterator<Item = [T; 3]> {
    let n = items.len();
    let triples = (0..n).flat_map(move |i| (i + 1..n).flat_map(move |j| (j + 1..n).map(move |k| [i, j, k])));
    triples.map(|triple| triple.map(|i| items[i]))
}

/// The corners of the polyhedron common to half spaces: every meeting point of three planes that no other cuts off.
fn corners(planes: &[HalfSpace]) -> Vec<[f64; 3]> {
    let met: Vec<Vector3<f64>> = any_three(planes).filter_map(meeting).collect();
    let size = planes.iter().fold(0.0, |size: f64, plane| size.max(plane.offset.abs()));
    let inside = |p: &Vector3<f64>| {
        let slack = SAME_POINT * (size + p.norm());
        planes.iter().all(|plane| plane.normal.dot(p) <= plane.offset + slack)
    };
    let mut corners: Vec<Vector3<f64>> = Vec::new();
    for p in met.into_iter().filter(inside) {
        let near = SAME_POINT * (size + p.norm());
        if corners.iter().all(|q| (p - q).norm_squared() > near * near) {
            corners.push(p);
        }
    }
    corners.into_iter().map(Into::into).collect()
}

/// Where three planes meet; `None` where they are too nearly parallel.
fn meeting([a, b, c]: [HalfSpace; 3]) -> Option<Vector3<f64>> {
    let (bc, ca, ab) = (b.normal.cross(&c.normal), c.normal.cross(&a.normal), a.normal.cross(&b.normal));
    let span = a.normal.dot(&bc);
    if span.abs() < 1e-9 {
        return None;
    }
    Some((bc * a.offset + ca * b.offset + ab * c.offset) / span)
}

struct Rule<'a> {
    friction: &'a Quantity,
    lateral_deg: f64,
    wanted: Kinematics,
}

/// Notes what can slide after Markland (1972), and turns away what must slide but cannot.
///
/// A plane slides where it dips more steeply than the friction angle, out of the face, and within the lateral limit of the
/// face's own direction; a pair where its line of intersection plunges more steeply than that and out of the face.
fn admit(normals: &[Vector3<f64>], face: &Matrix3<f64>, rule: &Rule, drawing: &mut Drawing) -> Result<(), BlockError> {
    let friction_deg = drawing.value("shape.friction_deg", rule.friction)?;
    let steep = turn(friction_deg).0;
    let out = out_of(face);
    let facing = azimuth_deg(&out);
    let slides = |down: Vector3<f64>| -down.z > steep && down.dot(&out) > 0.0;
    let planar = |normal: &Vector3<f64>| {
        let flat = (normal.x * normal.x + normal.y * normal.y).sqrt();
        if flat == 0.0 {
            return false;
        }
        let down = Vector3::new(normal.z * normal.x / flat, normal.z * normal.y / flat, -flat);
        let off = (azimuth_deg(normal) - facing + 540.0) % 360.0 - 180.0;
        slides(down) && off.abs() <= rule.lateral_deg
    };
    let planes = normals.iter().filter(|normal| planar(normal)).count();
    let pairs = (0..normals.len()).flat_map(|i| (i + 1..normals.len()).map(move |j| (i, j)));
    let wedges = pairs.filter(|(i, j)| line(normals[*i], normals[*j]).is_some_and(slides)).count();
    drawing.note("kinematics.sliding_planes", planes as f64);
    drawing.note("kinematics.sliding_wedges", wedges as f64);
    if rule.wanted == Kinematics::Sliding && planes + wedges == 0 { Err(BlockError::Stable) } else { Ok(()) }
}

/// The downward unit vector along the intersection of two planes; `None` where they are parallel.
fn line(a: Vector3<f64>, b: Vector3<f64>) -> Option<Vector3<f64>> {
    let along = a.cross(&b);
    let length = along.norm();
    let down = if along.z > 0.0 { -along } else { along };
    (length > 1e-9).then(|| down * (1.0 / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::candidates::{Class, HexKey};
    use rockface_core::distribution::Draws;
    use rockface_core::numerics::random::Key;
    use rockface_core::params::ParamType;
    use serde_json::{Value, json};

    /// A vertical face that looks south.
    fn candidates() -> Candidates {
        let key = HexKey(Key([1; 32]));
        Candidates { classes: Vec::new(), wall_from_enu: Some(wall_from_enu(90.0, 180.0)), library: Vec::new(), key }
    }

    fn make(shape: &Value, number: u64) -> (Result<Solid, BlockError>, Vec<(String, f64)>) {
        use rockface_core::artefact::candidates::Shape;
        let class = Class::decode(&json!({ "shape": shape })).unwrap();
        let mut drawing = Drawing::new(Draws::new(Key([1; 32]), number), 0);
        let solid = match &class.shape {
            Shape::JointBlock(shape) => block(shape, &candidates(), &mut drawing),
            Shape::JointWedge(shape) => wedge(shape, &candidates(), &mut drawing),
            other => panic!("{other:?}"),
        };
        (solid, drawing.into_noted())
    }

    fn noted(list: &[(String, f64)], name: &str) -> f64 {
        list.iter().find(|(key, _)| key == name).unwrap().1
    }

    fn count(list: &[(String, f64)], name: &str) -> usize {
        noted(list, name) as usize
    }

    #[test]
    fn the_wall_frame_is_right_handed_and_looks_where_the_face_does() {
        let rows = wall_from_enu(90.0, 180.0);
        let near = |a: [f64; 3], b: [f64; 3]| (Vector3::from(a) - Vector3::from(b)).norm_squared() < 1e-30;
        // Looking south, X runs to the east.
        assert!(near(rows[0], [1.0, 0.0, 0.0]) && near(rows[1], [0.0, 0.0, 1.0]) && near(rows[2], [0.0, -1.0, 0.0]));
        let [x, y, z] = wall_from_enu(70.0, 33.0);
        assert!(near(Vector3::from(x).cross(&Vector3::from(y)).into(), z) && y[2] > 0.0 && x[2].abs() < 1e-15);
    }

    #[test]
    fn three_orthogonal_sets_make_a_cuboid_of_their_spacings() {
        let set = |dip: f64, direction: f64, spacing: f64| json!({"dip_deg": dip, "dip_direction_deg": direction, "spacing_m": spacing});
        let sets = json!([set(0.0, 0.0, 0.5), set(90.0, 180.0, 2.0), set(90.0, 90.0, 3.0)]);
        let solid = make(&json!({"joint_block": {"sets": sets}}), 0).0.unwrap();
        assert!((solid.volume() - 3.0).abs() < 1e-12);
        // East is X, up is Y, south is Z.
        for (found, expected) in solid.extent().iter().zip([3.0, 0.5, 2.0]) {
            assert!((found - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn a_skewed_block_has_the_volume_of_its_spacings_over_the_span_of_its_normals() {
        let set = |dip: f64, direction: f64| json!({"dip_deg": dip, "dip_direction_deg": direction, "spacing_m": 0.4, "fisher_k": 80});
        let shape = json!({"joint_block": {"sets": [set(70.0, 170.0), set(80.0, 260.0), set(20.0, 10.0)]}});
        for number in 0..50 {
            let (solid, list) = make(&shape, number);
            let normal = |i: usize| {
                upward_normal(
                    noted(&list, &format!("shape.set_{i}.dip_deg")),
                    noted(&list, &format!("shape.set_{i}.dip_direction_deg")),
                )
            };
            let span = normal(1).dot(&normal(2).cross(&normal(3))).abs();
            let solid = solid.unwrap();
            assert!((solid.volume() * span / 0.064 - 1.0).abs() < 1e-9);
            assert_eq!((solid.check(), solid.vertices.len()), (Ok(()), 8));
        }
    }

    #[test]
    fn parallel_sets_enclose_nothing() {
        let set = json!({"dip_deg": 50, "dip_direction_deg": 10});
        assert_eq!(make(&json!({"joint_block": {"sets": [set, set, set]}}), 0).0, Err(BlockError::Unbounded));
    }

    /// A horizontal set and two upright ones: the volume their normals span is the sine of the angle between the latter.
    #[test]
    fn sets_that_are_nearly_parallel_enclose_nothing() {
        let block_at = |angle_deg: f64| {
            let set =
                |dip: f64, direction: f64| json!({"dip_deg": dip, "dip_direction_deg": direction, "spacing_m": 1});
            make(&json!({"joint_block": {"sets": [set(0.0, 0.0), set(90.0, 180.0), set(90.0, 180.0 + angle_deg)]}}), 0)
                .0
        };
        assert_eq!(block_at(1.1), Err(BlockError::Unbounded));
        let sine = portable_math::sincos(1.2f64.to_radians()).0;
        assert!((block_at(1.2).unwrap().volume() * sine - 1.0).abs() < 1e-6);
    }

    #[test]
    fn a_wedge_on_two_symmetric_planes_is_the_tetrahedron_of_the_textbook() {
        // Planes dipping 60 degrees to south-east and south-west meet in a line due south of plunge atan(tan 60 cos 45).
        let set = |direction: f64| json!({"dip_deg": 60, "dip_direction_deg": direction});
        let (solid, list) = make(&json!({"joint_wedge": {"sets": [set(135.0), set(225.0)], "height_m": 2}}), 0);
        let solid = solid.unwrap();
        assert_eq!((solid.check(), solid.vertices.len()), (Ok(()), 4));
        let plunge = 3.0f64.sqrt() * 0.5f64.sqrt();
        // Each plane leaves the vertical face along a line of slope tan 60 sin 45: half width at the top.
        let (back, half) = (2.0 / plunge, 2.0 / plunge);
        assert!((solid.volume() - back * half * 2.0 / 3.0).abs() < 1e-12, "{}", solid.volume());
        assert_eq!(count(&list, "kinematics.sliding_wedges"), 1);
        assert_eq!(count(&list, "kinematics.sliding_planes"), 0);
    }

    #[test]
    fn only_what_daylights_steeper_than_friction_slides() {
        let kinematics = |dip: f64, direction: f64, friction: f64| {
            let set = |dip: f64, direction: f64| json!({"dip_deg": dip, "dip_direction_deg": direction});
            let sets = [set(dip, direction), set(89.0, 90.0), set(5.0, 0.0)];
            let (_, list) = make(&json!({"joint_block": {"sets": sets, "friction_deg": friction}}), 0);
            count(&list, "kinematics.sliding_planes")
        };
        assert_eq!(kinematics(45.0, 180.0, 30.0), 1);
        assert_eq!(kinematics(45.0, 199.0, 30.0), 1);
        assert_eq!(kinematics(45.0, 201.0, 30.0), 0);
        assert_eq!(kinematics(45.0, 180.0, 46.0), 0);
        assert_eq!(kinematics(45.0, 0.0, 30.0), 0);
        let set = json!({"dip_deg": 45, "dip_direction_deg": 0});
        let stable =
            json!({"joint_wedge": {"sets": [set, {"dip_deg": 45, "dip_direction_deg": 20}], "kinematics": "sliding"}});
        assert_eq!(make(&stable, 0).0, Err(BlockError::Stable));
    }
}
