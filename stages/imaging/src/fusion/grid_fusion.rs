//! Fuses the elevations of many images on one lattice of cells to a 2.5D surface, cell by cell.

use rayon::prelude::*;

use rockface_core::artefact::{Frame, Grid, Raster, Surface};
use rockface_raster::robust_mean::{Measured, Rule, fuse};

/// The fused elevations of a grid, with how many images each comes from and how exact it is.
#[derive(Debug, Clone)]
pub struct FusedGrid {
    /// The grid around all images, or the requested part of it.
    pub grid: Grid,
    /// Elevation, metres; NaN where too few images agree.
    pub elevation_m: Vec<f32>,
    /// How many images were averaged; 0 without an elevation.
    pub images: Vec<f32>,
    /// Expected standard deviation for independent images, metres.
    pub sigma_m: Vec<f32>,
    /// Number of values of all images, and of those that were not rejected.
    pub values: [usize; 2],
}

/// Why grids do not fit: the index of the first that does not, and the reason.
pub type Misfit = (usize, String);

/// The grid of an image, and its position in the common one.
struct Part<'a> {
    raster: &'a Raster,
    column: i64,
    row: i64,
}

/// The grid around several whose cells stand on one lattice.
pub fn common_grid(rasters: &[&Raster]) -> Result<Grid, Misfit> {
    let (cell_m, first) = (rasters[0].grid.cell_m, place(&rasters[0].grid));
    let mut reach = [first[0], first[0], first[1], first[1]];
    for (index, raster) in rasters.iter().enumerate() {
        let grid = &raster.grid;
        if (grid.cell_m / cell_m - 1.0).abs() > 1e-12 {
            return Err((index, format!("has cells of {} m, the first one {cell_m} m", grid.cell_m)));
        }
        let [column, row] = place(grid);
        let off = (grid.left_m / cell_m - column).abs().max((grid.top_m / cell_m - row).abs());
        if off > 1e-4 {
            return Err((index, format!("does not stand on whole multiples of its cells ({off:.3} cells off)")));
        }
        reach = [
            reach[0].min(column),
            reach[1].max(column + grid.columns as f64),
            reach[2].max(row),
            reach[3].min(row - grid.rows as f64),
        ];
    }
    let (columns, rows) = ((reach[1] - reach[0]) as usize, (reach[2] - reach[3]) as usize);
    Ok(Grid { columns, rows, cell_m, left_m: reach[0] * cell_m, top_m: reach[2] * cell_m })
}

/// Left and top edge of a grid in cells.
fn place(grid: &Grid) -> [f64; 2] {
    [(grid.left_m / grid.cell_m).round(), (grid.top_m / grid.cell_m).round()]
}

/// Fuses rasters with the bands elevation and sigma over a grid of their lattice. The bits do not depend on the number of threads.
pub fn fuse_grids(rasters: &[&Raster], grid: &Grid, rule: &Rule) -> FusedGrid {
    let origin = place(grid);
    let part = |raster: &&'_ Raster| {
        let [column, row] = place(&raster.grid);
        (column - origin[0], origin[1] - row)
    };
    let parts: Vec<Part> = (rasters.iter())
        .map(|raster| (part(raster), raster))
        .map(|((column, row), raster)| Part { raster, column: column as i64, row: row as i64 })
        .collect();
    let empty = |value: f32| vec![value; grid.cells()];
    let (mut elevation_m, mut images, mut sigma_m) = (empty(f32::NAN), empty(0.0), empty(f32::NAN));
    let lines = elevation_m.par_chunks_mut(grid.columns).zip(images.par_chunks_mut(grid.columns));
    let lines = lines.zip(sigma_m.par_chunks_mut(grid.columns)).enumerate();
    let scratch = || Scratch::new(grid.columns, parts.len());
    let counts: Vec<[usize; 2]> = lines
        .map_init(scratch, |scratch, (row, ((elevation, images), sigma))| {
            scratch.gather(&parts, row as i64);
            let mut counts = [0; 2];
            for column in 0..elevation.len() {
                let values = scratch.values(column);
                counts[0] += values.len();
                if let Some(fused) = fuse(values, rule) {
                    elevation[column] = fused.value.value_m as f32;
                    sigma[column] = fused.value.sigma_m as f32;
                    images[column] = fused.count as f32;
                    counts[1] += fused.count;
                }
            }
            counts
        })
        .collect();
    let values = counts.iter().fold([0; 2], |sum, count| [sum[0] + count[0], sum[1] + count[1]]);
    FusedGrid { grid: *grid, elevation_m, images, sigma_m, values }
}

/// The elevations of all images in the cells of one row.
struct Scratch {
    /// `columns x images`, of which the first `counts` of each cell are valid.
    values: Vec<Measured>,
    counts: Vec<u32>,
    images: usize,
}

impl Scratch {
    fn new(columns: usize, images: usize) -> Self {
        let none = Measured::new(0.0, 1.0);
        Self { values: vec![none; columns * images], counts: vec![0; columns], images }
    }

    fn gather(&mut self, parts: &[Part], row: i64) {
        self.counts.fill(0);
        let columns = self.counts.len() as i64;
        for part in parts {
            let grid = &part.raster.grid;
            let own_row = row - part.row;
            if own_row < 0 || own_row >= grid.rows as i64 {
                continue;
            }
            let start = own_row as usize * grid.columns;
            let (first, last) = (part.column.max(0), (part.column + grid.columns as i64).min(columns));
            for column in first..last {
                let at = start + (column - part.column) as usize;
                let z = part.raster.bands[0].values[at];
                let sigma = part.raster.bands[1].values[at];
                if z.is_finite() && sigma > 0.0 {
                    let count = &mut self.counts[column as usize];
                    let slot = column as usize * self.images + *count as usize;
                    self.values[slot] = Measured::new(f64::from(z), f64::from(sigma));
                    *count += 1;
                }
            }
        }
    }

    fn values(&mut self, column: usize) -> &mut [Measured] {
        let start = column * self.images;
        &mut self.values[start..start + self.counts[column] as usize]
    }
}

/// The surface of elevations on a grid: cell centres joined unless the elevation steps by more than `max_step_m`.
///
/// Each square is cut along the diagonal that steps less. Returns the number of its triangles too.
pub fn surface_of(grid: &Grid, elevation_m: &[f32], frame: Frame, max_step_m: Option<f64>) -> (Surface, usize) {
    let middle = grid.centre(grid.rows / 2, grid.columns / 2);
    let origin_m = [middle.0.round(), middle.1.round(), 0.0];
    let point = |i: usize| {
        let (x, y) = grid.centre(i / grid.columns, i % grid.columns);
        let z = elevation_m[i];
        if z.is_finite() { [(x - origin_m[0]) as f32, (y - origin_m[1]) as f32, z] } else { [f32::NAN; 3] }
    };
    let points: Vec<[f32; 3]> = (0..grid.cells()).into_par_iter().map(point).collect();
    let allowed_m = max_step_m.unwrap_or(f64::INFINITY);
    let step = |a: usize, b: usize| f64::from((elevation_m[a] - elevation_m[b]).abs());
    let joined = |corners: [usize; 3]| {
        // A comparison with NaN is false: a triangle with a missing corner is left out.
        [(0, 1), (1, 2), (2, 0)].into_iter().all(|(i, j)| step(corners[i], corners[j]) <= allowed_m)
    };
    let width = grid.columns;
    let square = |row: usize, column: usize| {
        let a = row * width + column;
        let (b, c, d) = (a + 1, a + width + 1, a + width);
        let (ac, bd) = (step(a, c), step(b, d));
        // A missing corner lies on the other diagonal.
        let other = if ac.is_nan() || bd.is_nan() { ac.is_nan() } else { bd < ac };
        let byte = if other { Surface::OTHER_DIAGONAL } else { 0 };
        let [first, second] = Surface::corners(width, row, column, byte);
        let bit = |corners, bit| if joined(corners) { bit } else { 0 };
        byte | bit(first, Surface::FIRST) | bit(second, Surface::SECOND)
    };
    let mut squares = vec![0u8; width.saturating_sub(1) * grid.rows.saturating_sub(1)];
    squares.par_chunks_mut(width.saturating_sub(1).max(1)).enumerate().for_each(|(row, line)| {
        line.iter_mut().enumerate().for_each(|(column, byte)| *byte = square(row, column));
    });
    let triangles = squares.par_iter().map(|byte| (byte & (Surface::FIRST | Surface::SECOND)).count_ones() as usize);
    let triangles = triangles.sum();
    (Surface { frame, width, height: grid.rows, origin_m, points, squares }, triangles)
}
