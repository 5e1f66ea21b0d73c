//! Interpolation in the triangles of an organised surface. Most of its squares lie between the centres of the cells, and
//! are found to do so many at a time.

use rayon::prelude::*;

use rockface_core::artefact::{Grid, Surface};
use rockface_core::numerics::simd::{Work, vectorised};

use super::{for_each_band, raise_within};
use crate::shape::Moved;

/// Raises the cells of a grid to the triangles of a surface of at least 2 x 2 points.
pub(super) fn fill_grid(surface: &Surface, moved: Option<&Moved>, grid: &Grid, values: &mut [f32]) {
    let placing = Placing { origin_m: surface.origin_m, moved, grid };
    let rows = (0..surface.height).into_par_iter();
    let reach: Vec<[f64; 2]> = rows.map_init(Line::default, |line, row| line.reach(surface, row, &placing)).collect();
    let join = |pair: &[[f64; 2]]| [pair[0][0].min(pair[1][0]), pair[0][1].max(pair[1][1])];
    let ranges: Vec<[f64; 2]> = reach.windows(2).map(join).collect();
    for_each_band(&ranges, grid, values, |rows, cells, strips| {
        let mut strip = Strip::default();
        for row in strips {
            strip.enter(surface, row, &placing);
            strip.fill(surface, rows, grid.columns, cells);
        }
    });
}

/// How a point of the surface becomes columns and rows of the grid, and a height.
struct Placing<'a> {
    origin_m: [f64; 3],
    moved: Option<&'a Moved>,
    grid: &'a Grid,
}

impl Placing<'_> {
    /// The same arithmetic as [`super::to_cells`] of a point of a shape.
    #[inline(always)]
    fn place(&self, point: [f32; 3], moved: Option<&Moved>) -> [f64; 3] {
        let o = self.origin_m;
        let at = [o[0] + f64::from(point[0]), o[1] + f64::from(point[1]), o[2] + f64::from(point[2])];
        super::to_cells(self.grid, moved.map_or(at, |moved| moved.apply(at)))
    }
}

/// One row of points in columns and rows of the grid, with the next whole numbers on either side.
#[derive(Default)]
struct Line {
    /// Column, row, and metres.
    at: [Vec<f64>; 3],
    /// Least whole column and row that are not less.
    up: [Vec<i32>; 2],
    /// Greatest whole column and row that are not more.
    down: [Vec<i32>; 2],
}

impl Line {
    fn read(&mut self, surface: &Surface, row: usize, placing: &Placing<'_>) {
        self.at.iter_mut().for_each(|values| values.resize(surface.width, 0.0));
        self.up.iter_mut().chain(&mut self.down).for_each(|values| values.resize(surface.width, 0));
        vectorised(Place { points: points(surface, row), placing, line: self });
    }

    /// Least and greatest row of the grid that its points lie in; what is no point has none.
    fn reach(&mut self, surface: &Surface, row: usize, placing: &Placing<'_>) -> [f64; 2] {
        const EMPTY: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
        let join = |range: [f64; 2], row: f64| [range[0].min(row), range[1].max(row)];
        if placing.moved.is_some() {
            self.read(surface, row, placing);
            return self.at[1].iter().copied().fold(EMPTY, join);
        }
        // Rows follow Y alone then, and rounding keeps their order.
        let (low, high) = points(surface, row)
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), point| (low.min(point[1]), high.max(point[1])));
        if low > high {
            EMPTY
        } else {
            [low, high].map(|y| placing.place([0.0, y, 0.0], None)[1]).into_iter().fold(EMPTY, join)
        }
    }

    fn corner(&self, column: usize) -> [f64; 3] {
        [self.at[0][column], self.at[1][column], self.at[2][column]]
    }
}

fn points(surface: &Surface, row: usize) -> &[[f32; 3]] {
    &surface.points[row * surface.width..(row + 1) * surface.width]
}

struct Place<'a> {
    points: &'a [[f32; 3]],
    placing: &'a Placing<'a>,
    line: &'a mut Line,
}

impl Work for Place<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        match self.placing.moved {
            None => place_all(self.points, &mut self.line.at, |point| self.placing.place(point, None)),
            moved => place_all(self.points, &mut self.line.at, |point| self.placing.place(point, moved)),
        }
        // What is no number becomes 0, which lets a square pass that is then looked at more closely.
        for ((at, up), down) in self.line.at.iter().zip(&mut self.line.up).zip(&mut self.line.down) {
            for ((at, up), down) in at.iter().zip(up.iter_mut()).zip(down.iter_mut()) {
                *up = at.ceil() as i32;
                *down = at.floor() as i32;
            }
        }
    }
}

#[inline(always)]
fn place_all(points: &[[f32; 3]], at: &mut [Vec<f64>; 3], place: impl Fn([f32; 3]) -> [f64; 3]) {
    let count = points.len();
    let [x, y, z] = at;
    let (x, y, z) = (&mut x[..count], &mut y[..count], &mut z[..count]);
    for i in 0..count {
        [x[i], y[i], z[i]] = place(points[i]);
    }
}

/// A row of squares between two rows of points.
#[derive(Default)]
struct Strip {
    above: Line,
    below: Line,
    row: Option<usize>,
    /// Squares that may hold the centre of a cell.
    holds: Vec<bool>,
}

impl Strip {
    fn enter(&mut self, surface: &Surface, row: usize, placing: &Placing<'_>) {
        if row > 0 && self.row == Some(row - 1) {
            std::mem::swap(&mut self.above, &mut self.below);
        } else {
            self.above.read(surface, row, placing);
        }
        self.below.read(surface, row + 1, placing);
        self.row = Some(row);
    }

    /// Raises the cells of some rows of the grid to the triangles of the strip that was entered last.
    fn fill(&mut self, surface: &Surface, rows: [f64; 2], columns: usize, cells: &mut [f32]) {
        let Some(row) = self.row else { return };
        let (width, count) = (surface.width, surface.width - 1);
        let squares = &surface.squares[row * count..(row + 1) * count];
        self.holds.resize(count, false);
        let band = [[0, columns as i32 - 1], [rows[0] as i32, rows[1] as i32 - 1]];
        let (above, below) = (&self.above, &self.below);
        vectorised(Hold { above, below, squares, band, holds: &mut self.holds });
        let first = rows[0] as usize;
        for column in (0..count).filter(|column| self.holds[*column]) {
            let byte = squares[column];
            let corners = Surface::corners(width, 0, column, byte);
            for (corners, bit) in corners.iter().zip([Surface::FIRST, Surface::SECOND]) {
                if byte & bit != 0
                    && let Some(within) = box_of(above, below, corners, &band)
                {
                    let at = corners.map(|i| if i < width { above.corner(i) } else { below.corner(i - width) });
                    raise_within(at, within, first, columns, cells);
                }
            }
        }
    }
}

/// First and last column and row with cell centres in the box around a triangle, where it holds any.
#[inline]
fn box_of(above: &Line, below: &Line, corners: &[usize; 3], band: &[[i32; 2]; 2]) -> Option<[[usize; 2]; 2]> {
    let width = above.up[0].len();
    let along = |axis: usize| {
        let up = corners.map(|i| if i < width { above.up[axis][i] } else { below.up[axis][i - width] });
        let down = corners.map(|i| if i < width { above.down[axis][i] } else { below.down[axis][i - width] });
        let low = up[0].min(up[1]).min(up[2]).max(band[axis][0]);
        let high = down[0].max(down[1]).max(down[2]).min(band[axis][1]);
        (low <= high).then_some([low as usize, high as usize])
    };
    Some([along(0)?, along(1)?])
}

struct Hold<'a> {
    above: &'a Line,
    below: &'a Line,
    squares: &'a [u8],
    /// First and last column and row that are asked for.
    band: [[i32; 2]; 2],
    holds: &'a mut [bool],
}

impl Work for Hold<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let count = self.squares.len();
        let (squares, holds) = (&self.squares[..count], &mut self.holds[..count]);
        for (holds, byte) in holds.iter_mut().zip(squares) {
            *holds = byte & (Surface::FIRST | Surface::SECOND) != 0;
        }
        for axis in 0..2 {
            let [first, last] = self.band[axis];
            let [au, bu] = [&self.above.up[axis][..count], &self.above.up[axis][1..=count]];
            let [du, cu] = [&self.below.up[axis][..count], &self.below.up[axis][1..=count]];
            let [ad, bd] = [&self.above.down[axis][..count], &self.above.down[axis][1..=count]];
            let [dd, cd] = [&self.below.down[axis][..count], &self.below.down[axis][1..=count]];
            for i in 0..count {
                let low = au[i].min(bu[i]).min(cu[i].min(du[i])).max(first);
                let high = ad[i].max(bd[i]).max(cd[i].max(dd[i])).min(last);
                holds[i] &= low <= high;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rasterise::{fill_grid as plainly, grid_of_window};
    use crate::shape::Shape;
    use rockface_core::artefact::{Frame, Transform};

    /// A rough surface with holes, missing triangles and both diagonals, finer and coarser than the cells.
    fn rough(width: usize, height: usize, spacing_m: f32) -> Surface {
        let noise = |i: usize, k: usize| ((i * 2_654_435_761 + k * 40_503) % 1009) as f32 / 1009.0 - 0.5;
        let point = |i: usize| {
            if i % 37 == 5 {
                return [f32::NAN; 3];
            }
            let (x, y) = ((i % width) as f32 + 1.5 * noise(i, 1), (i / width) as f32 + 1.5 * noise(i, 2));
            [x * spacing_m, -y * spacing_m, noise(i, 3)]
        };
        let squares = (0..(width - 1) * (height - 1)).map(|i| (i * 7 % 11 % 8) as u8).collect();
        let points = (0..width * height).map(point).collect();
        Surface { frame: Frame::Wall, width, height, origin_m: [3.0, 70.0, -2.0], points, squares }
    }

    #[test]
    fn cells_have_the_bits_that_triangle_by_triangle_gives() {
        let mut turned = Transform::identity("a", "b");
        turned.rotation = [[0.96, 0.28, 0.0], [-0.28, 0.96, 0.0], [0.0, 0.0, 1.0]];
        turned.translation = [0.013, -0.02, 0.5];
        let moved = Moved::by(&turned);
        for (spacing_m, cell_m) in [(0.1, 0.25), (0.25, 0.1), (0.1, 0.1)] {
            let surface = rough(90, 150, spacing_m);
            let grid = grid_of_window([2.0, 20.0, 40.0, 70.5], cell_m).unwrap();
            for moved in [None, moved.as_ref()] {
                let (mut fast, mut plain) =
                    (vec![f32::NEG_INFINITY; grid.cells()], vec![f32::NEG_INFINITY; grid.cells()]);
                fill_grid(&surface, moved, &grid, &mut fast);
                plainly(Shape::Surface(&surface), moved, &grid, &mut plain);
                let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
                assert!(plain.iter().any(|z| z.is_finite()));
                assert_eq!(bits(fast), bits(plain));
            }
        }
    }
}
