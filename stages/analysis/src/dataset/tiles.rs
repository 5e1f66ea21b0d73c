//! Square tiles of a comparison: where they lie, what they hold, how hard they are.

use rockface_core::artefact::{Grid, Raster};

/// The rasters of a comparison on one grid, and the truth on it.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The grid of all.
    pub grid: &'a Grid,
    /// Comparison minus reference, metres.
    pub difference: &'a [f32],
    /// Elevations before, metres.
    pub reference: &'a [f32],
    /// Elevations after, metres.
    pub comparison: &'a [f32],
    /// Number of the true change of each cell, 0 for none.
    pub instances: &'a [u16],
}

/// A square of cells that becomes one sample, and what it holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Tile {
    /// Row and column of its first cell.
    pub corner: [usize; 2],
    /// Cells along its side.
    pub side: usize,
    /// Cells with a difference.
    pub valid: usize,
    /// Cells of true changes.
    pub changed: usize,
    /// True changes in it.
    pub instances: usize,
    /// Mean of the losses in it, metres, gains counted as 0: what an empty tile pretends to.
    pub apparent_loss_m: f64,
}

/// First rows or columns of tiles along an axis: every `stride`, the last one at the end; none where the axis is too short.
pub fn starts(length: usize, side: usize, stride: usize) -> Vec<usize> {
    if side == 0 || length < side {
        return Vec::new();
    }
    let last = length - side;
    let mut starts: Vec<usize> = (0..=last).step_by(stride.max(1)).collect();
    if starts.last() != Some(&last) {
        starts.push(last);
    }
    starts
}

/// All tiles of a scene, by row, then column.
pub fn tiles(scene: &Scene, side: usize, stride: usize) -> Vec<Tile> {
    let rows = starts(scene.grid.rows, side, stride);
    let columns = starts(scene.grid.columns, side, stride);
    rows.iter().flat_map(|row| columns.iter().map(|column| tile(scene, [*row, *column], side))).collect()
}

fn tile(scene: &Scene, corner: [usize; 2], side: usize) -> Tile {
    let (mut valid, mut changed, mut loss) = (0, 0, 0.0);
    let mut ids = std::collections::BTreeSet::new();
    for cell in cells(scene.grid, corner, side) {
        let difference = f64::from(scene.difference[cell]);
        if !difference.is_nan() {
            valid += 1;
            loss += (-difference).max(0.0);
        }
        if scene.instances[cell] > 0 {
            changed += 1;
            ids.insert(scene.instances[cell]);
        }
    }
    let apparent_loss_m = loss / valid.max(1) as f64;
    Tile { corner, side, valid, changed, instances: ids.len(), apparent_loss_m }
}

/// The cells of a tile by row.
fn cells(grid: &Grid, [row, column]: [usize; 2], side: usize) -> impl Iterator<Item = usize> {
    let columns = grid.columns;
    (row..row + side).flat_map(move |r| (column..column + side).map(move |c| r * columns + c))
}

impl Tile {
    /// The grid of its cells within the whole one.
    pub fn grid(&self, whole: &Grid) -> Grid {
        Grid {
            columns: self.side,
            rows: self.side,
            left_m: whole.left_m + self.corner[1] as f64 * whole.cell_m,
            top_m: whole.top_m - self.corner[0] as f64 * whole.cell_m,
            ..*whole
        }
    }

    /// Its part of values on the whole grid.
    pub fn cut<T: Copy>(&self, whole: &Grid, values: &[T]) -> Vec<T> {
        cells(whole, self.corner, self.side).map(|cell| values[cell]).collect()
    }

    /// A raster of its part of float values.
    pub fn raster(&self, whole: &Raster, quantity: &str, values: &[f32]) -> Raster {
        Raster::single(self.grid(&whole.grid), whole.frame, quantity, quantity, self.cut(&whole.grid, values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_the_scene_to_its_end() {
        assert_eq!(starts(10, 4, 4), [0, 4, 6]);
        assert_eq!(starts(8, 4, 4), [0, 4]);
        assert_eq!(starts(8, 4, 2), [0, 2, 4]);
        assert!(starts(3, 4, 4).is_empty());
    }

    #[test]
    fn a_tile_knows_what_it_holds() {
        let grid = Grid { columns: 4, rows: 2, cell_m: 0.5, left_m: 1.0, top_m: 3.0 };
        let difference = [0.0, -0.2, f32::NAN, 0.4, 0.0, 0.0, 0.0, -0.4];
        let instances = [0, 3, 3, 0, 0, 0, 0, 9];
        let flat = [0.0; 8];
        let scene =
            Scene { grid: &grid, difference: &difference, reference: &flat, comparison: &flat, instances: &instances };
        let found = tiles(&scene, 2, 2);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].valid, found[0].changed, found[0].instances), (4, 1, 1));
        assert_eq!((found[1].valid, found[1].changed, found[1].instances), (3, 2, 2));
        assert!((found[1].apparent_loss_m - 0.4 / 3.0).abs() < 1e-7);
        assert_eq!(found[1].cut(&grid, &instances), [3, 0, 0, 9]);
        assert!((found[1].grid(&grid).left_m - 2.0).abs() < 1e-12);
    }
}
