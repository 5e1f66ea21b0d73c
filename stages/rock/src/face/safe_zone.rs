//! Where a block may stand: the part of a face that keeps away from its borders and holes.

use std::collections::BTreeMap;

use super::distance;
use rockface_core::StageError;
use rockface_core::artefact::{Grid, Mesh};
use rockface_core::numerics::union_find::UnionFind;
use rockface_raster::rasterise;
use rockface_raster::shape::Shape;

/// How far to keep away, and from what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rules {
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Least distance of a cell's centre from the border, metres.
    pub offset_m: f64,
    /// Holes whose longer side is no longer than this do not count, metres.
    pub hole_m: f64,
}

/// The zone, and what was found on the way.
#[derive(Debug, Clone, PartialEq)]
pub struct Zone {
    /// Its grid: that of the footprint and one cell around.
    pub grid: Grid,
    /// Whether a block may stand in a cell, by row from the top.
    pub safe: Vec<bool>,
    /// Cells with a surface.
    pub footprint_cells: usize,
    /// Cells a block may stand in.
    pub safe_cells: usize,
    /// Number of holes large enough to keep blocks away.
    pub holes: usize,
    /// Holes too small to count.
    pub small_holes: usize,
    /// The greatest distance from the border any cell has, metres.
    pub inmost_m: f64,
}

/// Finds the zone of a mesh seen along Z. A cell belongs to the footprint where its centre lies under a triangle; the border
/// is taken to run half a cell before the nearest centre outside.
///
/// # Errors
/// A mesh without points, or a grid too large.
pub fn zone(mesh: &Mesh, rules: &Rules) -> Result<Zone, StageError> {
    let shape = Shape::Mesh(mesh);
    let [left, right, bottom, top] = rasterise::extent(shape, None).ok_or("the mesh has no points")?;
    let margin = rules.cell_m;
    let grid = rasterise::grid_around([left - margin, right + margin, bottom - margin, top + margin], rules.cell_m)?;
    let footprint: Vec<bool> = rasterise::tin(shape, None, &grid).iter().map(|z| !z.is_nan()).collect();
    let gaps = gaps(&footprint, &grid);
    let longer_side_m = |size: &[usize; 4]| (size[1] - size[0] + 1).max(size[3] - size[2] + 1) as f64 * rules.cell_m;
    let counts = |root: u32, size: &[usize; 4]| root != 0 && longer_side_m(size) > rules.hole_m;
    let (holes, small): (Vec<_>, Vec<_>) =
        gaps.sizes.iter().filter(|(root, _)| **root != 0).partition(|(root, size)| counts(**root, size));
    let (holes, small_holes) = (holes.len(), small.len());
    let is_border = |cell: usize| match gaps.roots[cell] {
        _ if footprint[cell] => false,
        0 => true,
        root => counts(root, &gaps.sizes[&root]),
    };
    let border: Vec<bool> = (0..footprint.len()).map(is_border).collect();
    let squared = distance::squared(&border, grid.columns).ok_or("the face has no border")?;
    let least = rules.offset_m / rules.cell_m + 0.5;
    let safe: Vec<bool> = footprint.iter().zip(&squared).map(|(on, d)| *on && *d as f64 >= least * least).collect();
    let inmost = squared.iter().zip(&footprint).filter(|(_, on)| **on).map(|(d, _)| *d).max().unwrap_or(0);
    let inmost_m = ((inmost as f64).sqrt() - 0.5).max(0.0) * rules.cell_m;
    let count = |cells: &[bool]| cells.iter().filter(|cell| **cell).count();
    let (footprint_cells, safe_cells) = (count(&footprint), count(&safe));
    Ok(Zone { grid, safe, footprint_cells, safe_cells, holes, small_holes, inmost_m })
}

/// Connected cells without surface.
struct Gaps {
    /// The first cell of each cell's gap; 0, the upper left corner, for all around the face.
    roots: Vec<u32>,
    /// First and last row and column of each gap.
    sizes: BTreeMap<u32, [usize; 4]>,
}

/// Gaps connect through sides; the rim of the grid has no surface, so all around the face is one.
fn gaps(footprint: &[bool], grid: &Grid) -> Gaps {
    let columns = grid.columns;
    let mut sets = UnionFind::new(footprint.len());
    for cell in (0..footprint.len()).filter(|cell| !footprint[*cell]) {
        if cell % columns > 0 && !footprint[cell - 1] {
            sets.join(cell - 1, cell);
        }
        if cell >= columns && !footprint[cell - columns] {
            sets.join(cell - columns, cell);
        }
    }
    let roots = sets.into_roots();
    let mut sizes = BTreeMap::new();
    for cell in (0..footprint.len()).filter(|cell| !footprint[*cell]) {
        let (row, column) = (cell / columns, cell % columns);
        let size = sizes.entry(roots[cell]).or_insert([row, row, column, column]);
        *size = [size[0].min(row), size[1].max(row), size[2].min(column), size[3].max(column)];
    }
    Gaps { roots, sizes }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    const RULES: Rules = Rules { cell_m: 0.1, offset_m: 0.5, hole_m: 0.0 };

    /// 10 x 10 m in squares of 0.25 m, without the squares of some rows and columns.
    fn sheet(holes: &[[u32; 4]]) -> Mesh {
        let mut mesh = height_mesh(40, [0.0, 10.0, 0.0, 10.0], |x, y| 0.1 * x * y);
        let mut number = 0;
        mesh.triangles.retain(|_| {
            let (row, column) = (number / 2 / 40, number / 2 % 40);
            number += 1;
            !holes.iter().any(|[r0, r1, c0, c1]| (*r0..*r1).contains(&row) && (*c0..*c1).contains(&column))
        });
        mesh
    }

    fn area(zone: &Zone) -> f64 {
        zone.safe_cells as f64 * 0.01
    }

    #[test]
    fn the_zone_of_a_square_is_a_smaller_square() {
        let found = zone(&sheet(&[]), &RULES).unwrap();
        assert_eq!(found.footprint_cells, 10_000);
        assert!((area(&found) - 81.0).abs() < 1e-9, "{}", area(&found));
        assert!((found.inmost_m - 5.0).abs() < 0.06);
        assert_eq!((found.holes, found.small_holes), (0, 0));
        let whole = zone(&sheet(&[]), &Rules { offset_m: 0.0, ..RULES }).unwrap();
        assert_eq!(whole.safe_cells, 10_000);
        let none = zone(&sheet(&[]), &Rules { offset_m: 5.1, ..RULES }).unwrap();
        assert_eq!(none.safe_cells, 0);
    }

    /// A square hole of side s with offset d takes s^2 + 4 s d + pi d^2.
    #[test]
    fn holes_count_by_their_size() {
        let holes = [[16, 20, 16, 20], [30, 31, 8, 9]];
        let taken = |s: f64| s * s + 4.0 * s * 0.5 + std::f64::consts::PI * 0.25;
        let all = zone(&sheet(&holes), &RULES).unwrap();
        assert_eq!((all.holes, all.small_holes), (2, 0));
        assert!((area(&all) - (81.0 - taken(1.0) - taken(0.25))).abs() < 0.35, "{}", area(&all));
        let large = zone(&sheet(&holes), &Rules { hole_m: 0.5, ..RULES }).unwrap();
        assert_eq!((large.holes, large.small_holes), (1, 1));
        assert!((area(&large) - (81.0 - taken(1.0) - 0.25 * 0.25)).abs() < 0.3, "{}", area(&large));
        // A bay that opens to the rim is no hole, whatever the size that counts.
        let bay = zone(&sheet(&[[16, 20, 0, 4]]), &Rules { hole_m: 9.0, ..RULES }).unwrap();
        assert_eq!((bay.holes, bay.small_holes), (0, 0));
        assert!(area(&bay) < 80.5);
    }
}
