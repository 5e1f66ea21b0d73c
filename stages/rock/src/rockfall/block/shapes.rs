//! Base shapes in a box of one metre about the origin: Z out of the rock, tips and narrow sides into it.

use super::draw::Drawing;
use super::hull::hull;
use super::{BlockError, Solid, V, joints, subdivide};
use nalgebra::Vector3;
use rockface_core::artefact::Candidates;
use rockface_core::artefact::candidates::{Ellipsoid, Polyhedron, Shape, Trapezoid, Wedge};
use rockface_core::numerics::portable_math;

/// The base shape of a candidate, metres: joint and library blocks in their own size, all others with a box of 1 m.
pub fn base(shape: &Shape, candidates: &Candidates, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    match shape {
        Shape::Prism(prism) => {
            let ring = polygon(prism.sides);
            boxed(&ring.iter().flat_map(|[x, y]| [[*x, *y, -0.5], [*x, *y, 0.5]]).collect::<Vec<_>>())
        }
        Shape::Pyramid(pyramid) => {
            let ring = polygon(pyramid.sides);
            boxed(&ring.iter().map(|[x, y]| [*x, *y, 0.5]).chain([[0.0, 0.0, -0.5]]).collect::<Vec<_>>())
        }
        Shape::Ellipsoid(ellipsoid) => sphere(ellipsoid),
        Shape::Trapezoid(trapezoid) => frustum(trapezoid, drawing),
        Shape::Wedge(wedge) => ramp(wedge, drawing),
        Shape::Polyhedron(polyhedron) => irregular(polyhedron, drawing),
        Shape::JointBlock(block) => joints::block(block, candidates, drawing),
        Shape::JointWedge(wedge) => joints::wedge(wedge, candidates, drawing),
        Shape::Library(library) => scanned(library.class.as_deref(), candidates, drawing),
    }
}

/// The hull of points, in a box of 1 m about the origin.
fn boxed(points: &[V]) -> Result<Solid, BlockError> {
    let mut solid = hull(points).ok_or(BlockError::Flat)?;
    let [low, high] = solid.bounds();
    solid.map(|v| std::array::from_fn(|i| (v[i] - low[i]) / (high[i] - low[i]) - 0.5));
    Ok(solid)
}

/// The corners of a regular polygon, one side level; a square is parallel to the axes.
fn polygon(sides: u32) -> Vec<[f64; 2]> {
    let step = std::f64::consts::TAU / f64::from(sides);
    let corner = |i: u32| {
        let (sin, cos) = portable_math::sincos(step * (f64::from(i) + 0.5));
        [sin, -cos]
    };
    if sides == 4 { vec![[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]] } else { (0..sides).map(corner).collect() }
}

fn sphere(ellipsoid: &Ellipsoid) -> Result<Solid, BlockError> {
    let golden = f64::midpoint(1.0, 5.0f64.sqrt());
    let signs = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)];
    let corners = signs.iter().flat_map(|(s, t)| [[0.0, *s, t * golden], [*s, t * golden, 0.0], [t * golden, 0.0, *s]]);
    let mut solid = hull(&corners.collect::<Vec<_>>()).ok_or(BlockError::Flat)?;
    for _ in 0..ellipsoid.subdivisions {
        subdivide::quarter(&mut solid);
        solid.map(|v| (Vector3::from(v) * (1.0 / Vector3::from(v).norm())).into());
    }
    let extent = solid.extent();
    solid.map(|v| std::array::from_fn(|i| v[i] / extent[i]));
    Ok(solid)
}

fn frustum(trapezoid: &Trapezoid, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let x = 0.5 * drawing.value("shape.taper_x", &trapezoid.taper_x)?;
    let y = 0.5 * drawing.value("shape.taper_y", &trapezoid.taper_y)?;
    let corner = |(s, t): (f64, f64)| [[0.5 * s, 0.5 * t, 0.5], [x * s, y * t, -0.5]];
    boxed(&[(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].into_iter().flat_map(corner).collect::<Vec<_>>())
}

fn ramp(wedge: &Wedge, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let edge = drawing.value("shape.edge", &wedge.edge)?;
    boxed(&[-0.5, 0.5].iter().flat_map(|x| [[*x, -0.5, 0.5], [*x, 0.5, 0.5], [*x, edge, -0.5]]).collect::<Vec<_>>())
}

/// Points in uniformly distributed directions.
fn irregular(polyhedron: &Polyhedron, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let mut points = Vec::with_capacity(polyhedron.points as usize);
    for i in 0..polyhedron.points {
        let radius = drawing.unnoted(&format!("shape.radius.{i}"), &polyhedron.radius)?;
        let z = 2.0 * drawing.uniform(&format!("shape.point.{i}.z")) - 1.0;
        let (sin, cos) =
            portable_math::sincos(std::f64::consts::TAU * drawing.uniform(&format!("shape.point.{i}.turn")));
        let across = (1.0 - z * z).sqrt();
        points.push([across * cos, across * sin, z].map(|x| x * radius));
    }
    boxed(&points)
}

fn scanned(class: Option<&str>, candidates: &Candidates, drawing: &mut Drawing) -> Result<Solid, BlockError> {
    let fits = |at: &usize| class.is_none_or(|class| candidates.library[*at].class == class);
    let parts: Vec<usize> = (0..candidates.library.len()).filter(fits).collect();
    let at = (drawing.uniform("shape.part") * parts.len() as f64) as usize;
    let Some(part) = parts.get(at.min(parts.len().saturating_sub(1))) else {
        return Err(BlockError::Specification(format!("the library has no block{}", in_class(class))));
    };
    drawing.note("shape.part", *part as f64);
    let part = &candidates.library[*part];
    Ok(Solid { vertices: part.vertices.clone(), triangles: part.triangles.clone() })
}

fn in_class(class: Option<&str>) -> String {
    class.map_or_else(String::new, |class| format!(" of class `{class}`"))
}
