//! How deep a body reaches along a direction: the greatest and the mean thickness.

use nalgebra::{Matrix3, Vector3};

use rockface_core::StageError;
use rockface_core::artefact::{Frame, Mesh};
use rockface_raster::rasterise;
use rockface_raster::shape::Shape;

use super::Facets;

/// Lines along the longer side of the body at which its thickness is taken.
const LINES: f64 = 200.0;

/// Thickness of a body along a direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thickness {
    /// The greatest, metres.
    pub greatest_m: f64,
    /// The mean over the body's outline seen along the direction, metres.
    pub mean_m: f64,
}

/// Distance between the first and the last point of a closed body on parallel lines, 200 of them along its longer side.
///
/// # Errors
/// A direction that is none, or a body without extent across it.
pub fn along(body: &Facets, direction: Vector3<f64>) -> Result<Thickness, StageError> {
    let axes = axes(direction).ok_or_else(|| format!("the direction {direction:?} has no length"))?;
    let origin = body.vertices.first().map_or_else(Vector3::zeros, |v| Vector3::from(*v));
    let turned = body.moved(|p| axes * (p - origin));
    let (top, bottom) = (mesh(turned.clone()), mesh(turned.moved(|p| Vector3::new(p.x, p.y, -p.z))));
    let extent = rasterise::extent(Shape::Mesh(&top), None).ok_or("a body without points")?;
    let cell_m = (extent[1] - extent[0]).max(extent[3] - extent[2]) / LINES;
    let grid = rasterise::grid_around(extent, cell_m)?;
    let (top, bottom) =
        (rasterise::tin(Shape::Mesh(&top), None, &grid), rasterise::tin(Shape::Mesh(&bottom), None, &grid));
    let lines = top.iter().zip(&bottom).map(|(top, bottom)| f64::from(*top) + f64::from(*bottom));
    let (mut count, mut sum, mut greatest_m) = (0usize, 0.0, 0.0f64);
    for thickness in lines.filter(|thickness| !thickness.is_nan()) {
        count += 1;
        sum += thickness;
        greatest_m = greatest_m.max(thickness);
    }
    if count == 0 {
        return Err(StageError::new("a body so thin that no line meets it"));
    }
    Ok(Thickness { greatest_m, mean_m: sum / count as f64 })
}

/// Rows of the rotation that turns a direction into Z.
fn axes(direction: Vector3<f64>) -> Option<Matrix3<f64>> {
    let z = direction.try_normalize(0.0).filter(|z| z.iter().all(|value| value.is_finite()))?;
    let mut aside = Vector3::zeros();
    aside[z.iamin()] = 1.0;
    let x = aside.cross(&z).normalize();
    Some(Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]))
}

fn mesh(Facets { vertices, triangles }: Facets) -> Mesh {
    Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn a_turned_plate_is_as_thick_as_it_is() {
        let turn = Rotation3::from_euler_angles(0.4, -0.7, 1.2);
        let plate = Facets::cuboid(3.0, 2.0, 0.25).moved(|p| turn * p + Vector3::new(100.0, 5.0, -20.0));
        let found = along(&plate, turn * Vector3::new(0.0, 0.0, 2.0)).unwrap();
        assert!((found.greatest_m - 0.25).abs() < 1e-6 && (found.mean_m - 0.25).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn a_wedge_has_half_its_height_on_average() {
        let mut wedge = Facets::cuboid(4.0, 2.0, 1.0);
        for corner in [5, 7] {
            wedge.vertices[corner][2] = 0.0;
        }
        let found = along(&wedge, Vector3::z()).unwrap();
        assert!((found.mean_m - 0.5).abs() < 0.005 && (found.greatest_m - 1.0).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn no_direction_or_no_extent_is_refused() {
        assert!(along(&Facets::cuboid(1.0, 1.0, 1.0), Vector3::zeros()).is_err());
        assert!(along(&Facets::default(), Vector3::z()).is_err());
        assert!(along(&Facets::cuboid(0.0, 0.0, 1.0), Vector3::z()).is_err());
    }
}
