//! Elevation grids of meshes and organised surfaces: mean of points per cell, or interpolation in the triangles.

use rayon::prelude::*;

use rockface_core::artefact::{Extent, Grid, Surface};
use rockface_core::{StageError, fail};

use super::shape::{Moved, Shape};
use cells::Cells;

mod cells;
mod squares;

/// Points whose cells are looked up in parallel before they are added in order.
const BATCH: usize = 1 << 18;
/// Points of these that a thread looks up at a time.
const PART: usize = 1 << 13;
/// Fewest grid rows that a thread fills from the triangles at a time.
const BAND_ROWS: usize = 64;
/// Bands a thread has to fill, where the grid is high enough: the more, the more strips lie in two bands.
const BANDS_PER_THREAD: usize = 8;
/// Weight below zero, in units of a triangle's area, at which a cell centre still counts as inside: closes the seam
/// between two triangles against rounding.
const SEAM: f64 = -1e-9;
/// Cells a grid may have.
pub const MAXIMUM_CELLS: f64 = 1.5e8;

/// Smallest box around the points in X and Y as (left, right, bottom, top), metres; `None` without points.
pub fn extent(shape: Shape, moved: Option<&Moved>) -> Option<[f64; 4]> {
    if let (Shape::Surface(surface), None) = (shape, moved) {
        return extent_of(surface);
    }
    let empty = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    let grow = |e: [f64; 4], p: [f64; 3]| [e[0].min(p[0]), e[1].max(p[0]), e[2].min(p[1]), e[3].max(p[1])];
    let join = |a: [f64; 4], b: [f64; 4]| [a[0].min(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].max(b[3])];
    // Minimum and maximum are exact in any order, and skip NaN.
    let places = (0..shape.places()).into_par_iter().with_min_len(1 << 14);
    let found = places.map(|i| shape.point(i, moved)).fold(|| empty, grow).reduce(|| empty, join);
    (found[0] <= found[1]).then_some(found)
}

/// The same of a surface: sums with its origin are in the order of what is added to it.
fn extent_of(surface: &Surface) -> Option<[f64; 4]> {
    let Extent { low, high, count } = surface.extent();
    let [x, y] = [0, 1].map(|axis| [low[axis], high[axis]].map(|end| surface.origin_m[axis] + f64::from(end)));
    (count > 0).then_some([x[0], x[1], y[0], y[1]])
}

/// The grid of whole multiples of the cell that covers an extent (left, right, bottom, top), metres.
pub fn grid_around([left, right, bottom, top]: [f64; 4], cell_m: f64) -> Result<Grid, StageError> {
    let (first, last) = ((left / cell_m).floor(), (right / cell_m).floor());
    let (lowest, highest) = ((bottom / cell_m).floor(), (top / cell_m).floor());
    sized(last - first + 1.0, highest - lowest + 1.0, cell_m, first * cell_m, (highest + 1.0) * cell_m)
}

/// The grid of a window (left, right, bottom, top), metres: its size rounded to whole cells.
pub fn grid_of_window([left, right, bottom, top]: [f64; 4], cell_m: f64) -> Result<Grid, StageError> {
    sized(((right - left) / cell_m).round(), ((top - bottom) / cell_m).round(), cell_m, left, top)
}

fn sized(columns: f64, rows: f64, cell_m: f64, left_m: f64, top_m: f64) -> Result<Grid, StageError> {
    if !(columns >= 1.0 && rows >= 1.0 && columns * rows <= MAXIMUM_CELLS) {
        fail!(
            "a grid of {columns:.3e} columns and {rows:.3e} rows of {cell_m:.3e} m has none or more than {MAXIMUM_CELLS:.1e} cells; is \
             the surface in metres (`unit_m` of its importer), and are there stray pieces or points far away from it (`min_piece_triangles`)?"
        );
    }
    Ok(Grid { columns: columns as usize, rows: rows as usize, cell_m, left_m, top_m })
}

/// Mean Z of the points in each cell, metres, by row from the top; NaN where a cell has fewer than `minimum_points`.
///
/// Points are added in their own order, so the bytes do not depend on the number of threads.
pub fn mean(shape: Shape, moved: Option<&Moved>, grid: &Grid, minimum_points: u32) -> Vec<f32> {
    let mut cells = vec![(0.0f64, 0u32); grid.cells()];
    // Points are many, and their cells are found by all threads before they are added by one.
    let mut parts: Vec<Cells> = (0..BATCH / PART).map(|_| Cells::default()).collect();
    for start in (0..shape.places()).step_by(BATCH) {
        parts.par_iter_mut().enumerate().for_each(|(number, part)| {
            let end = |first: usize| shape.places().min(first);
            part.find(shape, moved, grid, [end(start + number * PART), end(start + (number + 1) * PART)]);
        });
        for (cell, z_m) in parts.iter().flat_map(|part| part.cell.iter().zip(&part.z_m)) {
            if let Some((sum, count)) = cells.get_mut(*cell as usize) {
                *sum += z_m;
                *count += 1;
            }
        }
    }
    let least = minimum_points.max(1);
    let value = |&(sum, count): &(f64, u32)| if count >= least { (sum / f64::from(count)) as f32 } else { f32::NAN };
    cells.par_iter().map(value).collect()
}

/// The cell of a point and its Z; a cell that does not exist for points outside.
#[inline]
pub(super) fn place(grid: &Grid, [x, y, z]: [f64; 3]) -> (u32, f64) {
    // A cell has its left and its lower edge, and not its upper one: `grid_around` rounds down to whole cells in X and in Y, so that
    // every point it is made around has a cell. Cutting off is rounding down where there is no sign, and needs no call.
    let [column, row] = grid.in_cells([x, y]);
    if column >= 0.0 && column < grid.columns as f64 && row > 0.0 && row <= grid.rows as f64 && !z.is_nan() {
        let cut = row as u32;
        let row = cut - u32::from(f64::from(cut) >= row);
        (row * grid.columns as u32 + column as u32, z)
    } else {
        (u32::MAX, z)
    }
}

/// Z at the cell centres interpolated in the triangles, metres, by row from the top; the highest where several lie over
/// each other, NaN where there is none.
pub fn tin(shape: Shape, moved: Option<&Moved>, grid: &Grid) -> Vec<f32> {
    raised(vec![f32::NEG_INFINITY; grid.cells()], shape, moved, grid)
}

/// Cells raised to the triangles of a shape; NaN where they are as low as can be.
fn raised(mut values: Vec<f32>, shape: Shape, moved: Option<&Moved>, grid: &Grid) -> Vec<f32> {
    match shape {
        Shape::Surface(surface) if surface.width > 1 && surface.height > 1 => {
            squares::fill_grid(surface, moved, grid, &mut values);
        }
        _ => fill_grid(shape, moved, grid, &mut values),
    }
    values.par_iter_mut().filter(|z| **z == f32::NEG_INFINITY).for_each(|z| *z = f32::NAN);
    values
}

/// Gives cells without a value what [`tin`] gives them; how many got one.
pub fn fill_empty(values: &mut [f32], shape: Shape, moved: Option<&Moved>, grid: &Grid) -> usize {
    // Other cells are as high as can be, so that no triangle raises them.
    let known = |value: &f32| if value.is_nan() { f32::NEG_INFINITY } else { f32::INFINITY };
    let found = raised(values.par_iter().map(known).collect(), shape, moved, grid);
    let fill = |(value, found): (&mut f32, f32)| {
        let is_new = value.is_nan() && !found.is_nan();
        if is_new {
            *value = found;
        }
        usize::from(is_new)
    };
    values.par_iter_mut().zip(found).map(fill).sum()
}

/// Raises the cells of a grid to the triangles of any shape.
fn fill_grid(shape: Shape, moved: Option<&Moved>, grid: &Grid, values: &mut [f32]) {
    let points: Vec<[f64; 3]> =
        (0..shape.places()).into_par_iter().map(|i| to_cells(grid, shape.point(i, moved))).collect();
    let ranges: Vec<[f64; 2]> = (0..shape.strips()).into_par_iter().map(|s| row_range(shape, s, &points)).collect();
    for_each_band(&ranges, grid, values, |rows, cells, strips| {
        strips.for_each(|s| {
            shape.for_each_triangle(s, |t| raise(t.map(|i| points[i]), rows, grid.columns, cells));
        });
    });
}

/// Hands over each band of grid rows with its cells and the strips of triangles that may reach it, in their order.
fn for_each_band(
    ranges: &[[f64; 2]],
    grid: &Grid,
    values: &mut [f32],
    fill: impl Fn([f64; 2], &mut [f32], &mut dyn Iterator<Item = usize>) + Sync,
) {
    let band_rows = BAND_ROWS.max(grid.rows.div_ceil(BANDS_PER_THREAD * rayon::current_num_threads()));
    values.par_chunks_mut(band_rows * grid.columns).enumerate().for_each(|(band, cells)| {
        let first = band * band_rows;
        let rows = [first as f64, (first + cells.len() / grid.columns) as f64];
        let mut met = (0..ranges.len()).filter(|s| ranges[*s][0] < rows[1] && ranges[*s][1] >= rows[0]);
        fill(rows, cells, &mut met);
    });
}

/// Columns and rows from the centre of the first cell, Z in metres.
fn to_cells(grid: &Grid, [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [column, row] = grid.in_cells([x, y]);
    [column - 0.5, row - 0.5, z]
}

fn row_range(shape: Shape, strip: usize, points: &[[f64; 3]]) -> [f64; 2] {
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    shape.for_each_triangle(strip, |triangle| {
        for place in triangle {
            range = [range[0].min(points[place][1]), range[1].max(points[place][1])];
        }
    });
    range
}

/// Raises the cells of some rows to one triangle.
#[inline]
fn raise(corners: [[f64; 3]; 3], rows: [f64; 2], columns: usize, cells: &mut [f32]) {
    let [down, across] = [1, 0].map(|axis: usize| {
        let [a, b, c] = corners.map(|corner| corner[axis]);
        [a.min(b).min(c).ceil(), a.max(b).max(c).floor()]
    });
    let (top, bottom) = (down[0].max(rows[0]), down[1].min(rows[1] - 1.0));
    let (left, right) = (across[0].max(0.0), across[1].min(columns as f64 - 1.0));
    if top <= bottom && left <= right {
        let within = [[left as usize, right as usize], [top as usize, bottom as usize]];
        raise_within(corners, within, rows[0] as usize, columns, cells);
    }
}

/// Raises the cells of some columns and rows, which lie in the grid, to one triangle; `first` is the row of the first cell.
#[inline]
fn raise_within(
    [a, b, c]: [[f64; 3]; 3],
    [[left, right], [top, bottom]]: [[usize; 2]; 2],
    first: usize,
    columns: usize,
    cells: &mut [f32],
) {
    let highest = |row: usize| {
        let row = (row - first) * columns;
        cells[row + left..=row + right].iter().all(|z| *z == f32::INFINITY)
    };
    if (top..=bottom).all(highest) {
        return;
    }
    let (ab, ac) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let area = ab[0] * ac[1] - ac[0] * ab[1];
    // A triangle seen edge-on covers no cell centre; NaN corners end here too.
    if area == 0.0 || area.is_nan() {
        return;
    }
    // Further out than any rounding, with the sign of the area taken away.
    let outside = 2.0 * SEAM * area.abs();
    for row in top..=bottom {
        let y = row as f64 - a[1];
        for column in left..=right {
            let x = column as f64 - a[0];
            let (toward_b, toward_c) = (x * ac[1] - y * ac[0], y * ab[0] - x * ab[1]);
            if toward_b * area.signum() < outside || toward_c * area.signum() < outside {
                continue;
            }
            let (toward_b, toward_c) = (toward_b / area, toward_c / area);
            if toward_b >= SEAM && toward_c >= SEAM && 1.0 - toward_b - toward_c >= SEAM {
                let z = a[2] + toward_b * (b[2] - a[2]) + toward_c * (c[2] - a[2]);
                let cell = &mut cells[(row - first) * columns + column];
                *cell = cell.max(z as f32);
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that are exact
mod tests;
