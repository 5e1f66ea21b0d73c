//! The cells that points lie in, many points at a time.

use rockface_core::artefact::Grid;
use rockface_core::numerics::fast_round::whole;
use rockface_core::numerics::simd::{Work, vectorised};

use crate::shape::{Moved, Shape};

/// Points that are taken out of a shape before their cells are found.
const AT_ONCE: usize = 256;

/// The cells and heights of some points.
#[derive(Default)]
pub(super) struct Cells {
    /// The cell of each point; one that does not exist for points outside the grid, and where there is no point.
    pub cell: Vec<u32>,
    /// Z of each point, metres.
    pub z_m: Vec<f64>,
}

impl Cells {
    /// Finds those of the places of a shape from `first` to before `end`, the same as [`super::place`] of each.
    pub fn find(&mut self, shape: Shape, moved: Option<&Moved>, grid: &Grid, [first, end]: [usize; 2]) {
        self.cell.clear();
        self.z_m.clear();
        vectorised(Find { shape, moved, grid, places: [first, end], found: self });
    }
}

struct Find<'a> {
    shape: Shape<'a>,
    moved: Option<&'a Moved>,
    grid: &'a Grid,
    places: [usize; 2],
    found: &'a mut Cells,
}

impl Work for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { shape, moved, grid, places, found } = self;
        // A surface, of which there may be many points, without a question at each of them.
        match (shape, moved) {
            (Shape::Surface(_), None) => find_all(places, grid, found, |i| shape.point(i, None)),
            (Shape::Surface(_), Some(moved)) => find_all(places, grid, found, |i| shape.point(i, Some(moved))),
            _ => find_all(places, grid, found, |i| shape.point(i, moved)),
        }
    }
}

#[inline(always)]
#[allow(clippy::needless_bitwise_bool)] // branches would keep the points apart
fn find_all([first, end]: [usize; 2], grid: &Grid, found: &mut Cells, point: impl Fn(usize) -> [f64; 3]) {
    let (columns, rows) = (grid.columns as f64, grid.rows as f64);
    let mut at = [[0.0; AT_ONCE]; 3];
    for start in (first..end).step_by(AT_ONCE) {
        let count = AT_ONCE.min(end - start);
        let [x, y, z] = &mut at;
        let (x, y, z) = (&mut x[..count], &mut y[..count], &mut z[..count]);
        for i in 0..count {
            [x[i], y[i], z[i]] = point(start + i);
        }
        found.z_m.extend_from_slice(z);
        let known = found.cell.len();
        found.cell.resize(known + count, u32::MAX);
        // A plain loop: what iterators are given is not always inlined, and then not compiled for wide registers.
        let cells = &mut found.cell[known..known + count];
        for i in 0..count {
            // A cell has its left and its lower edge.
            let [column, row] = grid.in_cells([x[i], y[i]]);
            let inside = (column >= 0.0) & (column < columns) & (row > 0.0) & (row <= rows) & !z[i].is_nan();
            let cell = (row.ceil() - 1.0) * columns + column.floor();
            cells[i] = if inside { whole(cell) as u32 } else { u32::MAX };
        }
    }
}
