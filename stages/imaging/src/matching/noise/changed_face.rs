//! Where the face differs from the one a noise model was learnt on, and how strong the noise is there.

use rayon::prelude::*;

use crate::camera::model::Camera;
use crate::matching::noise::parametric::Ground;
use crate::matching::pixel_row::PixelRow;
use rockface_core::artefact::{Depth, Noise, ReliefLaw};

/// A face has changed where its elevation lies this many cells outside of the range that the known one has nearby.
const LEAST_CHANGE_CELLS: f64 = 2.0;
/// Cells around a cell whose elevations count as nearby.
const NEARBY_CELLS: usize = 2;

/// The face of a survey on the cells of a model.
#[derive(Debug, Clone)]
pub struct Face {
    /// Strength of the noise by place, pixels of the full image: that of the model, and where the surface of the depth map differs
    /// from the face of the model, what its relief law gives the new relief.
    pub strength: Vec<f32>,
    /// Slopes, metres a cell, to the right and downwards: those of the model, or of the depth map where it differs; 0 where unknown.
    pub slopes: Vec<[f32; 2]>,
    /// What noise without fields has from place to place; none for models with fields.
    pub ground: Option<Ground>,
}

/// The face that a depth map shows.
pub fn seen(noise: &Noise, depth: &Depth, camera: &Camera) -> Face {
    let elevation = seen_elevation(noise, depth, camera);
    let differs = |i: usize| !elevation[i].is_nan() && is_known(noise, i, f64::from(elevation[i])) == Some(false);
    let changed: Vec<usize> = (0..elevation.len()).filter(|i| differs(*i)).collect();
    let mut strength = noise.strength.clone();
    // Of the unchanged face, all that is known: the new surface meets it at the rim of the change.
    let mut surface = noise.elevation.clone();
    changed.iter().for_each(|i| surface[*i] = elevation[*i]);
    let reach = Window { columns: noise.grid.columns, rows: noise.grid.rows, half: noise.relief.window_cells };
    for i in changed {
        for j in reach.around(i) {
            strength[j] = law(&noise.relief, relief_m(&surface, &reach, j)) as f32;
        }
    }
    let columns = noise.grid.columns;
    let ground = noise.parametric.as_ref().map(|parametric| Ground::new(parametric, &strength, &surface, columns));
    Face { slopes: slopes(&surface, columns), ground, strength }
}

/// Slopes of elevations from a cell's neighbours, to the right and downwards, cell by cell in metres a cell; 0 where one is unknown.
pub fn slopes(elevation: &[f32], columns: usize) -> Vec<[f32; 2]> {
    let rows = elevation.len() / columns;
    let between = |low: usize, high: usize, cells: usize| {
        let slope = (elevation[high] - elevation[low]) / cells.max(1) as f32;
        if slope.is_nan() { 0.0 } else { slope }
    };
    let at = |i: usize| {
        let (column, row) = (i % columns, i / columns);
        let (left, right) = (column.saturating_sub(1), (column + 1).min(columns - 1));
        let (above, below) = (row.saturating_sub(1), (row + 1).min(rows - 1));
        let to_the_right = between(row * columns + left, row * columns + right, right - left);
        [to_the_right, between(above * columns + column, below * columns + column, below - above)]
    };
    (0..elevation.len()).map(at).collect()
}

/// Whether an elevation (metres) is one of the face of a model at one of its cells: at most two cells beyond what is known nearby; `None` where
/// nothing is.
pub fn is_known(noise: &Noise, cell: usize, elevation_m: f64) -> Option<bool> {
    let least_m = LEAST_CHANGE_CELLS * noise.grid.cell_m;
    let within = |low: f32, high: f32| (f64::from(low) - least_m..=f64::from(high) + least_m).contains(&elevation_m);
    // Most elevations are near that of the cell itself.
    if within(noise.elevation[cell], noise.elevation[cell]) {
        return Some(true);
    }
    let window = Window { columns: noise.grid.columns, rows: noise.grid.rows, half: NEARBY_CELLS };
    let (low, high) = window
        .around(cell)
        .map(|j| noise.elevation[j])
        .filter(|z| !z.is_nan())
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    (low <= high).then(|| within(low, high))
}

/// Strength by relief, pixels.
pub fn law(law: &ReliefLaw, relief_m: f64) -> f64 {
    let of_relief = law.gain_px_m * relief_m;
    (law.flat_px * law.flat_px + of_relief * of_relief).sqrt()
}

/// Deviation of the elevations within a window around a cell, metres; 0 where none is known.
pub fn relief_m(elevation: &[f32], window: &Window, cell: usize) -> f64 {
    let (mut n, mut sum, mut squares) = (0.0, 0.0, 0.0);
    let base = f64::from(elevation[cell]);
    let base = if base.is_nan() { 0.0 } else { base };
    for z in window.around(cell).map(|i| f64::from(elevation[i])).filter(|z| !z.is_nan()) {
        (n, sum, squares) = (n + 1.0, sum + (z - base), squares + (z - base) * (z - base));
    }
    if n > 0.0 { (squares / n - (sum / n) * (sum / n)).max(0.0).sqrt() } else { 0.0 }
}

/// Square windows on a grid, cut off at its edges.
#[derive(Debug, Clone, Copy)]
pub struct Window {
    /// Columns of the grid.
    pub columns: usize,
    /// Rows of the grid.
    pub rows: usize,
    /// Half width of a window without its centre, cells.
    pub half: usize,
}

impl Window {
    /// The cells around a cell, itself included.
    pub fn around(self, cell: usize) -> impl Iterator<Item = usize> {
        let reach = |at: usize, size: usize| at.saturating_sub(self.half)..(at + self.half + 1).min(size);
        let columns = reach(cell % self.columns, self.columns);
        reach(cell / self.columns, self.rows).flat_map(move |row| columns.clone().map(move |c| row * self.columns + c))
    }
}

/// Rows of a depth map whose points are found side by side.
const ROWS_AT_ONCE: usize = 64;

/// Mean elevation of the points of a depth map on the cells of the model; NaN where there is none.
fn seen_elevation(noise: &Noise, depth: &Depth, camera: &Camera) -> Vec<f32> {
    let grid = noise.grid;
    // The cell and the elevation of each point of a row that is on the grid.
    let points = |row: usize| -> Vec<(usize, f64)> {
        let on_grid = |[x, y, z]: [f64; 3]| grid.cell_of([x, y]).map(|cell| (cell, z));
        PixelRow::new(depth, camera, camera, row).points_m().filter_map(on_grid).collect()
    };
    let mut sums = vec![[0.0f64; 2]; grid.cells()];
    for first in (0..depth.height).step_by(ROWS_AT_ONCE) {
        let rows = first..(first + ROWS_AT_ONCE).min(depth.height);
        let rows: Vec<Vec<(usize, f64)>> = rows.into_par_iter().map(points).collect();
        for (cell, z) in rows.into_iter().flatten() {
            let sum = &mut sums[cell];
            (sum[0], sum[1]) = (sum[0] + z, sum[1] + 1.0);
        }
    }
    sums.iter().map(|[sum, count]| if *count > 0.0 { (sum / count) as f32 } else { f32::NAN }).collect()
}
