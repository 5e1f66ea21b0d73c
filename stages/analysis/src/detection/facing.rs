//! Which way a face looks. Detectors distinguish rock from air along Z: out of the wall in the wall frame, upwards in the world frame.

use nalgebra::Vector3;

use rockface_core::StageError;
use rockface_core::artefact::Frame;
use rockface_core::numerics::portable_math;
use rockface_raster::shape::Shape;

/// Least vertical part of the mean normal of a face whose distances are measured at points seen from above: a dip of 60 degrees.
pub const POINTS_FROM_ABOVE: f64 = 0.5;
/// Least vertical part of the mean normal of a face that encloses volumes: a dip of 85 degrees. The side of one that is steeper, or overhangs, is only
/// in the order of the corners of its triangles, and where these face into the rock a loss would be a gain.
pub const VOLUMES_BELOW: f64 = 0.087;

/// Least mean normal, as a share of that of a plane, by which a surface has a side.
const LEAST_SIDE: f64 = 1e-3;

/// Refuses a face in the world frame whose mean normal has less of the vertical, so that rock would be missed or taken for air. Of a cloud, which has no
/// triangles, the warning is returned.
///
/// # Errors
/// How the face lies.
pub fn check(port: &str, shape: Shape, least_upwards: f64) -> Result<Option<String>, StageError> {
    if shape.frame() != Frame::World {
        return Ok(None);
    }
    let (normal, area) = vector_area(shape);
    let length = normal.norm();
    if area <= 0.0 {
        let steepest = portable_math::atan2((1.0 - least_upwards * least_upwards).sqrt(), least_upwards).to_degrees();
        return Ok(Some(format!(
            "`{port}` has no triangles and is in the world frame, where rock is what lies below: that is right for faces that dip by less than \
             {steepest:.0} degrees only; bring others into the wall frame with `transform-crs`"
        )));
    }
    if length > LEAST_SIDE * area && normal.z < least_upwards * length {
        let dip = dip_deg(&normal);
        let lies = if dip > 90.0 { format!("overhangs by {:.0}", dip - 90.0) } else { format!("dips by {dip:.0}") };
        return Err(StageError::new(format!(
            "the face of `{port}` {lies} degrees and is in the world frame, where rock is what lies below: change would be missed, or loss \
             taken for gain"
        ))
        .hint(
            "bring both epochs into the wall frame with one `transform` of `transform-crs`; if it is a slope whose triangles face into the rock, say where it \
             looks with `outward` of `import-mesh`",
        ));
    }
    Ok(None)
}

/// The sum of the cross products of the sides of all triangles, and that of their lengths: twice the vector area and twice the area, square metres.
fn vector_area(shape: Shape) -> (Vector3<f64>, f64) {
    let (mut normal, mut area) = (Vector3::zeros(), 0.0);
    for strip in 0..shape.strips() {
        shape.for_each_triangle(strip, |places| {
            let [a, b, c] = places.map(|place| Vector3::from(shape.point(place, None)));
            let own = (b - a).cross(&(c - a));
            normal += own;
            area += own.norm();
        });
    }
    (normal, area)
}

/// The way out of the rock: Z in the wall frame, in the world frame the unit mean normal of the face, or Z where it has no side.
pub fn outward(shape: Shape) -> Vector3<f64> {
    if shape.frame() != Frame::World {
        return Vector3::z();
    }
    let (normal, area) = vector_area(shape);
    let length = normal.norm();
    if length > LEAST_SIDE * area { normal / length } else { Vector3::z() }
}

/// The dip of a face with this normal, degrees: 0 for a level one, more than 90 for one that overhangs.
pub fn dip_deg(normal: &Vector3<f64>) -> f64 {
    portable_math::atan2(normal.xy().norm(), normal.z).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Mesh;

    fn checked(frame: Frame, up: [f64; 3]) -> Result<Option<String>, StageError> {
        let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], up];
        let mesh = Mesh { frame, vertices, triangles: vec![[0, 1, 2]], colours: Vec::new() };
        check("reference", Shape::Mesh(&mesh), POINTS_FROM_ABOVE)
    }

    #[test]
    fn steep_faces_are_measured_in_the_wall_frame() {
        assert!(checked(Frame::World, [0.0, 1.0, 0.5]) == Ok(None));
        assert!(checked(Frame::Wall, [0.0, 0.1, 1.0]) == Ok(None));
        assert!(checked(Frame::World, [0.0, 0.1, 1.0]).unwrap_err().message.contains("dips by 84"));
        let over = checked(Frame::World, [0.0, -0.1, 1.0]).unwrap_err();
        // A triangle without an area has no side, like a cloud.
        assert!(checked(Frame::World, [2.0, 0.0, 0.0]).unwrap().unwrap().contains("less than 60 degrees"));
        assert!(over.message.contains("overhangs by 6") && over.hint.unwrap().contains("transform-crs"));
    }
}
