//! Square tiles of a comparison: where they lie, what they hold, how hard they are.

use std::ops::Range;

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
    /// Cells of true changes that have a difference.
    pub changed_valid: usize,
    /// True changes in it.
    pub instances: usize,
    /// Mean of the losses in it, metres, gains counted as 0: what an empty tile pretends to.
    pub apparent_loss_m: f64,
}

/// How tiles are cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// Cells along the side of a tile.
    pub side: usize,
    /// Cells from one tile to the next.
    pub stride: usize,
    /// Whether what is left at the end gets a tile that is pushed back until it fits.
    pub to_end: bool,
}

/// First rows or columns of tiles along an axis: every stride, and where wanted one at the end; none where the axis is too short.
pub fn starts(length: usize, cut: Cut) -> Vec<usize> {
    if cut.side == 0 || length < cut.side {
        return Vec::new();
    }
    let last = length - cut.side;
    let mut starts: Vec<usize> = (0..=last).step_by(cut.stride.max(1)).collect();
    if cut.to_end && starts.last() != Some(&last) {
        starts.push(last);
    }
    starts
}

/// All tiles of some columns of a scene, by row, then column.
pub fn tiles(scene: &Scene, columns: &Range<usize>, cut: Cut) -> Vec<Tile> {
    let rows = starts(scene.grid.rows, cut);
    let starts = starts(columns.len(), cut);
    let corner = |row: usize, start: &usize| [row, columns.start + start];
    rows.iter().flat_map(|row| starts.iter().map(|start| tile(scene, corner(*row, start), cut.side))).collect()
}

/// Cells of a grid that some tiles cover, each counted once.
pub fn covered<'a>(grid: &Grid, tiles: impl IntoIterator<Item = &'a Tile>) -> usize {
    let mut is_covered = vec![false; grid.cells()];
    tiles.into_iter().for_each(|tile| cells(grid, tile.corner, tile.side).for_each(|cell| is_covered[cell] = true));
    is_covered.into_iter().filter(|is| *is).count()
}

fn tile(scene: &Scene, corner: [usize; 2], side: usize) -> Tile {
    let (mut valid, mut changed, mut changed_valid, mut loss) = (0, 0, 0, 0.0);
    let mut ids = std::collections::BTreeSet::new();
    for cell in cells(scene.grid, corner, side) {
        let difference = f64::from(scene.difference[cell]);
        if !difference.is_nan() {
            valid += 1;
            loss += (-difference).max(0.0);
        }
        if scene.instances[cell] > 0 {
            changed += 1;
            changed_valid += usize::from(!difference.is_nan());
            ids.insert(scene.instances[cell]);
        }
    }
    let apparent_loss_m = loss / valid.max(1) as f64;
    Tile { corner, side, valid, changed, changed_valid, instances: ids.len(), apparent_loss_m }
}

/// The cells of a tile by row.
fn cells(grid: &Grid, [row, column]: [usize; 2], side: usize) -> impl Iterator<Item = usize> {
    let columns = grid.columns;
    (row..row + side).flat_map(move |r| (column..column + side).map(move |c| r * columns + c))
}

impl Tile {
    /// The grid of its cells within the whole one.
    pub fn grid(&self, whole: &Grid) -> Grid {
        let [row, column] = self.corner;
        whole.part(column..column + self.side, row..row + self.side)
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
        let cut = |side, stride, to_end| Cut { side, stride, to_end };
        assert_eq!(starts(10, cut(4, 4, true)), [0, 4, 6]);
        assert_eq!(starts(10, cut(4, 4, false)), [0, 4]);
        assert_eq!(starts(8, cut(4, 4, true)), [0, 4]);
        assert_eq!(starts(8, cut(4, 2, true)), [0, 2, 4]);
        assert!(starts(3, cut(4, 4, true)).is_empty());
    }

    #[test]
    fn a_tile_knows_what_it_holds() {
        let grid = Grid { columns: 4, rows: 2, cell_m: 0.5, left_m: 1.0, top_m: 3.0 };
        let difference = [0.0, -0.2, f32::NAN, 0.4, 0.0, 0.0, 0.0, -0.4];
        let instances = [0, 3, 3, 0, 0, 0, 0, 9];
        let flat = [0.0; 8];
        let scene =
            Scene { grid: &grid, difference: &difference, reference: &flat, comparison: &flat, instances: &instances };
        let cut = Cut { side: 2, stride: 2, to_end: true };
        let found = tiles(&scene, &(0..4), cut);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].changed_valid, found[1].changed_valid), (1, 1));
        assert_eq!((found[0].valid, found[0].changed, found[0].instances), (4, 1, 1));
        assert_eq!((found[1].valid, found[1].changed, found[1].instances), (3, 2, 2));
        assert!((found[1].apparent_loss_m - 0.4 / 3.0).abs() < 1e-7);
        assert_eq!(found[1].cut(&grid, &instances), [3, 0, 0, 9]);
        assert!((found[1].grid(&grid).left_m - 2.0).abs() < 1e-12);
        // A strip of columns has tiles of its own, and overlapping ones cover each cell once.
        let strip = tiles(&scene, &(1..4), cut);
        assert_eq!(strip.iter().map(|tile| tile.corner).collect::<Vec<_>>(), [[0, 1], [0, 2]]);
        assert_eq!(covered(&grid, &strip), 6);
    }
}
