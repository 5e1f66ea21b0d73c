//! Elevations of meshes and surfaces at the size of a preview.

use crate::figure::picture::SMALL;
use crate::figure::picture::look::Look;
use rockface_core::artefact::{Grid, Mesh, Meshes};
use rockface_raster::rasterise;
use rockface_raster::shape::Shape;

use super::WIDTH_PX;

/// Up to so many triangles are drawn themselves; beyond it points are sampled.
const TRIANGLES: usize = 200_000;
/// How often triangles may lie over each other, on the whole, to be drawn themselves: each pixel is looked at so often.
const LAYERS: f64 = 100.0;
/// Points looked at of a mesh or surface that is sampled.
const POINTS: usize = 600_000;
/// Sampled points that a cell should have.
const POINTS_A_CELL: f64 = 6.0;

/// The shape seen along Z, in a picture of preview size; `None` without points.
pub(super) fn look(shape: Shape, kind: &str) -> Option<Look<'static>> {
    let extent = rasterise::extent(shape, None)?;
    let size_m = [extent[1] - extent[0], extent[3] - extent[2]];
    let (grid, values) = elevations(shape, extent)?;
    Some(Look::of_shape(shape, kind, values, &grid, size_m))
}

/// Elevations over an extent (left, right, bottom, top), metres, in cells of about a pixel of a preview.
pub(super) fn elevations(shape: Shape, extent: [f64; 4]) -> Option<(Grid, Vec<f32>)> {
    let longest = (extent[1] - extent[0]).max(extent[3] - extent[2]);
    let room = (SMALL.room(WIDTH_PX) - 1) as f64;
    let cell = |count: f64| if longest > 0.0 { longest / count } else { 1.0 };
    if is_small(shape) && layers(shape, extent) <= LAYERS {
        let grid = rasterise::grid_around(extent, cell(room)).ok()?;
        return Some((grid, rasterise::tin(shape, None, &grid)));
    }
    let step = shape.places().div_ceil(POINTS);
    let area = (extent[1] - extent[0]) * (extent[3] - extent[2]);
    let wanted = (area * POINTS_A_CELL * step as f64 / shape.places() as f64).sqrt();
    let grid = rasterise::grid_around(extent, wanted.max(cell(room))).ok()?;
    Some((grid, filled(&grid, &means(shape, step, &grid))))
}

fn is_small(shape: Shape) -> bool {
    match shape {
        Shape::Mesh(mesh) | Shape::Part(mesh, _) => mesh.triangles.len() <= TRIANGLES,
        Shape::Surface(surface) => 2 * surface.points.len() <= TRIANGLES,
        Shape::Cloud(_) => false,
    }
}

/// The boxes around the triangles of a mesh together, the parts of them within an extent, in units of its area.
fn layers(shape: Shape, [left, right, bottom, top]: [f64; 4]) -> f64 {
    let (Shape::Mesh(mesh) | Shape::Part(mesh, _)) = shape else { return 1.0 };
    let span = |values: [f64; 3], low: f64, high: f64| {
        let [least, most] = [f64::min, f64::max].map(|pick| values.into_iter().reduce(pick).unwrap_or(f64::NAN));
        (most.min(high) - least.max(low)).max(0.0)
    };
    let area = |corners: &[u32; 3]| {
        let along = |axis: usize| corners.map(|corner| mesh.vertices[corner as usize][axis]);
        span(along(0), left, right) * span(along(1), bottom, top)
    };
    let whole = (right - left) * (top - bottom);
    if whole > 0.0 { mesh.triangles.iter().map(area).sum::<f64>() / whole } else { 1.0 }
}

/// Mean elevation of every so many points in each cell.
fn means(shape: Shape, step: usize, grid: &Grid) -> Vec<f32> {
    let mut sums = vec![(0.0f64, 0u32); grid.cells()];
    for place in (0..shape.places()).step_by(step) {
        let [x, y, z] = shape.point(place, None);
        if let Some(cell) = grid.cell_of([x, y]).filter(|_| z.is_finite()) {
            let (sum, count) = &mut sums[cell];
            *sum += z;
            *count += 1;
        }
    }
    sums.into_iter().map(|(sum, count)| if count > 0 { (sum / f64::from(count)) as f32 } else { f32::NAN }).collect()
}

/// Gives a cell between sampled ones the mean of its neighbours, where at least five of the eight have a value.
fn filled(grid: &Grid, values: &[f32]) -> Vec<f32> {
    let around = |cell: usize| {
        let (row, column) = (cell / grid.columns, cell % grid.columns);
        let rows = row.saturating_sub(1)..(row + 2).min(grid.rows);
        let across = column.saturating_sub(1)..(column + 2).min(grid.columns);
        rows.flat_map(move |r| across.clone().map(move |c| values[r * grid.columns + c]))
    };
    let value = |cell: usize| {
        if !values[cell].is_nan() {
            return values[cell];
        }
        let known: Vec<f32> = around(cell).filter(|z| !z.is_nan()).collect();
        if known.len() < 5 { f32::NAN } else { known.iter().sum::<f32>() / known.len() as f32 }
    };
    (0..values.len()).map(value).collect()
}

/// All parts as one mesh.
pub(super) fn together(meshes: &Meshes) -> Mesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for part in &meshes.parts {
        let first = vertices.len() as u32;
        vertices.extend_from_slice(&part.vertices);
        triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
    }
    Mesh { frame: meshes.frame, vertices, triangles, colours: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::height_mesh;

    #[test]
    fn triangles_that_lie_over_each_other_are_sampled() {
        let sheet = height_mesh(4, [0.0, 4.0, 0.0, 2.0], |_, _| 0.0);
        let extent = [0.0, 4.0, 0.0, 2.0];
        let found = layers(Shape::Mesh(&sheet), extent);
        assert!((found - 2.0).abs() < 1e-9, "{found}");
        let vertices = vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let fan = Mesh { frame: Frame::Wall, vertices, triangles: vec![[0, 1, 2]; 500], colours: Vec::new() };
        let found = layers(Shape::Mesh(&fan), extent);
        assert!((found - 500.0).abs() < 1e-9, "{found}");
        let (grid, values) = elevations(Shape::Mesh(&fan), extent).unwrap();
        assert!(values.len() == grid.cells() && values.iter().any(|z| !z.is_nan()));
    }
}
