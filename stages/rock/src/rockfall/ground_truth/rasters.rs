//! What a grid of elevations sees of removed rock: which piece each cell lost, and how deep.

use rockface_core::artefact::{Frame, Grid, Mesh, Raster, Sample};
use rockface_core::{StageError, fail};
use rockface_raster::rasterise;
use rockface_raster::shape::Shape;

use super::Facets;

/// The top of a piece and the face before lie on each other within this, metres: they are the same triangles, perhaps cut
/// anew; 32-bit elevations add their own rounding.
const SAME_M: f64 = 1e-6;

/// The rasters, and what each piece leaves on them.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Number of the piece each cell lost, 0 for none.
    pub labels: Raster,
    /// Metres each cell lost along Z; 0 where nothing was lost, NaN where the face has no value before or after.
    pub depth: Raster,
    /// One for each piece, in their order.
    pub pieces: Vec<Trace>,
}

/// What one piece leaves on the rasters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trace {
    /// (row, column) of the cells with its number.
    pub cells: Vec<(usize, usize)>,
    /// Cells whose centre it covers, seen or not.
    pub covered: usize,
    /// Volume between the two elevations of its cells, cubic metres.
    pub volume_m3: f64,
}

impl Trace {
    /// Share of the cells under it that show its loss: below 1 where the niche reaches under an overhang, 0 where the
    /// whole niche is hidden or falls between the cells.
    pub fn visible_fraction(&self) -> f64 {
        if self.covered == 0 { 0.0 } else { self.cells.len() as f64 / self.covered as f64 }
    }
}

/// A piece on the part of the grid around it.
struct Window {
    first_row: usize,
    first_column: usize,
    columns: usize,
    /// Its top at each cell, NaN beside it.
    top: Vec<f32>,
}

/// Compares the elevations of the face before and after at the centres of one grid, and tells which piece went where.
///
/// Elevations are interpolated in the triangles, the highest layer counts. A cell has lost a piece where it lies lower
/// than before and the piece's top was the face before.
///
/// # Errors
/// A face without points, or a cell that gives a grid with none or too many cells.
pub fn compare(pre: &Mesh, post: &Mesh, pieces: &[(u32, &Facets)], cell_m: f64) -> Result<Seen, StageError> {
    if !(cell_m > 0.0 && cell_m.is_finite()) {
        fail!("a cell of {cell_m} m makes no grid");
    }
    let extent = rasterise::extent(Shape::Mesh(pre), None).ok_or("the face before has no points")?;
    let grid = rasterise::grid_around(extent, cell_m)?;
    let before = rasterise::tin(Shape::Mesh(pre), None, &grid);
    let after = rasterise::tin(Shape::Mesh(post), None, &grid);
    let mut labels = vec![0.0f32; grid.cells()];
    let mut traces = Vec::with_capacity(pieces.len());
    for (id, piece) in pieces {
        let trace = trace(&grid, piece, |cell| {
            let free = labels[cell].to_bits() == 0;
            (free && after[cell] < before[cell]).then_some(f64::from(before[cell]))
        });
        let volume = |sum: f64, (row, column): &(usize, usize)| {
            let cell = row * grid.columns + column;
            sum + (f64::from(before[cell]) - f64::from(after[cell])) * cell_m * cell_m
        };
        trace.cells.iter().for_each(|(row, column)| labels[row * grid.columns + column] = *id as f32);
        traces.push(Trace { volume_m3: trace.cells.iter().fold(0.0, volume), ..trace });
    }
    let lost = |cell: usize| {
        let difference = f64::from(before[cell]) - f64::from(after[cell]);
        if labels[cell] > 0.0 || difference.is_nan() { difference as f32 } else { 0.0 }
    };
    let depth = (0..grid.cells()).map(lost).collect();
    let mut labels = Raster::single(grid, Frame::Wall, "label", "piece", labels);
    labels.sample = Sample::Word;
    Ok(Seen { labels, depth: Raster::single(grid, Frame::Wall, "depth", "depth", depth), pieces: traces })
}

/// The cells a piece covers and is lost from; `before` gives the elevation a cell has lost, where it has lost any.
fn trace(grid: &Grid, piece: &Facets, before: impl Fn(usize) -> Option<f64>) -> Trace {
    let mut trace = Trace::default();
    let Some(window) = Window::of(grid, piece) else { return trace };
    for (place, top) in window.top.iter().enumerate().filter(|(_, top)| !top.is_nan()) {
        let row = window.first_row + place / window.columns;
        let column = window.first_column + place % window.columns;
        trace.covered += 1;
        let same = |before: f64| {
            let rounding = f64::from(f32::EPSILON) * before.abs();
            (before - f64::from(*top)).abs() <= SAME_M + 2.0 * rounding
        };
        if before(row * grid.columns + column).is_some_and(same) {
            trace.cells.push((row, column));
        }
    }
    trace
}

impl Window {
    /// `None` where the piece lies beside the grid.
    fn of(grid: &Grid, piece: &Facets) -> Option<Self> {
        let [low, high] = piece.bounds()?;
        let cell = |metres: f64, last: usize| (metres / grid.cell_m).floor().clamp(0.0, last as f64) as usize;
        let (last_column, last_row) = (grid.columns.checked_sub(1)?, grid.rows.checked_sub(1)?);
        let (left, right) = (cell(low[0] - grid.left_m, last_column), cell(high[0] - grid.left_m, last_column));
        let (above, below) = (cell(grid.top_m - high[1], last_row), cell(grid.top_m - low[1], last_row));
        let window = grid.part(left..right + 1, above..below + 1);
        let Facets { vertices, triangles } = piece.clone();
        let mesh = Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() };
        let top = rasterise::tin(Shape::Mesh(&mesh), None, &window);
        Some(Self { first_row: above, first_column: left, columns: window.columns, top })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(z: f64) -> Mesh {
        let vertices = vec![[0.0, 0.0, z], [4.0, 0.0, z], [4.0, 3.0, z], [0.0, 3.0, z]];
        Mesh { frame: Frame::Wall, vertices, triangles: vec![[0, 1, 2], [0, 2, 3]], colours: Vec::new() }
    }

    /// Joins the triangles of meshes; the highest layer is what a raster sees.
    fn joined(meshes: &[Mesh]) -> Mesh {
        let mut sum = Mesh { frame: Frame::Wall, vertices: Vec::new(), triangles: Vec::new(), colours: Vec::new() };
        for mesh in meshes {
            let first = sum.vertices.len() as u32;
            sum.triangles.extend(mesh.triangles.iter().map(|t| t.map(|corner| corner + first)));
            sum.vertices.extend(&mesh.vertices);
        }
        sum
    }

    fn raised(z: f64, left: f64, right: f64) -> Mesh {
        let mut mesh = plane(z);
        mesh.vertices.iter_mut().for_each(|v| v[0] = if v[0] > 0.0 { right } else { left });
        mesh
    }

    #[test]
    fn a_box_out_of_a_plane_is_labelled_to_its_edges() {
        let piece = Facets::cuboid(1.0, 1.0, 0.5).moved(|p| p + nalgebra::Vector3::new(1.0, 1.0, 1.5));
        // Before: the plane at 2. After: all that is left of it around the box, and the floor at 1.5.
        let after = joined(&[plane(1.5), raised(2.0, 0.0, 1.0), raised(2.0, 2.0, 4.0)]);
        let seen = compare(&plane(2.0), &after, &[(7, &piece)], 0.1).unwrap();
        let trace = &seen.pieces[0];
        assert_eq!((trace.covered, trace.cells.len()), (100, 100));
        assert!((trace.volume_m3 - 0.5).abs() < 1e-6 && (trace.visible_fraction() - 1.0).abs() < 1e-15);
        let at = |x: f64, y: f64| ((3.05 - y) / 0.1) as usize * seen.labels.grid.columns + (x / 0.1) as usize;
        assert_eq!(seen.labels.bands[0].values[at(1.55, 1.55)].to_bits(), 7f32.to_bits());
        // The floor is lower along the whole height, but only the box is a piece.
        assert_eq!(seen.labels.bands[0].values[at(1.55, 0.35)].to_bits(), 0);
        assert!((seen.depth.bands[0].values[at(1.55, 1.55)] - 0.5).abs() < 1e-6);
        assert_eq!(seen.depth.bands[0].values[at(1.55, 0.35)].to_bits(), 0);
    }

    #[test]
    fn what_lies_under_an_overhang_is_not_seen() {
        let piece = Facets::cuboid(2.0, 3.0, 0.5).moved(|p| p + nalgebra::Vector3::new(1.0, 0.0, 0.5));
        let roof = raised(2.0, 2.0, 4.0);
        let before = joined(&[plane(1.0), roof.clone()]);
        let seen = compare(&before, &joined(&[plane(0.5), roof]), &[(1, &piece)], 0.1).unwrap();
        assert!((seen.pieces[0].visible_fraction() - 0.5).abs() < 0.03, "{}", seen.pieces[0].visible_fraction());
    }

    #[test]
    fn a_piece_between_the_cells_or_beside_the_grid_is_not_seen() {
        let small = Facets::cuboid(0.01, 0.01, 0.01).moved(|p| p + nalgebra::Vector3::new(1.01, 1.01, 1.99));
        let beside = Facets::cuboid(1.0, 1.0, 1.0).moved(|p| p + nalgebra::Vector3::new(50.0, 50.0, 1.0));
        let seen = compare(&plane(2.0), &plane(2.0), &[(1, &small), (2, &beside)], 0.1).unwrap();
        assert!(seen.pieces.iter().all(|trace| trace.cells.is_empty() && trace.visible_fraction().to_bits() == 0));
        assert!(compare(&plane(2.0), &plane(2.0), &[], 0.0).unwrap_err().message.contains("0 m"));
    }
}
