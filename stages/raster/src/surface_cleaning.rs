//! Takes away the triangles of a surface that are no surface, in a fixed order of causes.

use nalgebra::Vector3;
use rayon::prelude::*;

use rockface_core::artefact::{Raster, Surface};
use rockface_core::numerics::simd::{Work, vectorised};

use crate::point_rows::PointRows;

mod pieces;

/// What a triangle must be to stay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rules<'a> {
    /// Smallest area, square metres.
    pub min_area_m2: f64,
    /// Rectangle `[x0, x1, y0, y1]` all corners must lie in, metres.
    pub window_m: Option<[f64; 4]>,
    /// Raster all corners must lie over a cell of that has a value and not 0, in its first band.
    pub mask: Option<&'a Raster>,
    /// Fewest triangles of a connected piece; pieces of a surface connect through points, of a mesh through edges.
    pub min_component_triangles: usize,
}

impl Rules<'_> {
    /// Whether a corner lies in the window.
    pub fn in_window(&self, [x, y]: [f64; 2]) -> bool {
        self.window_m.is_none_or(|[x0, x1, y0, y1]| (x0..=x1).contains(&x) && (y0..=y1).contains(&y))
    }

    /// Whether a corner lies over a valid cell of the mask.
    pub fn in_mask(&self, place: [f64; 2]) -> bool {
        let Some(Raster { grid, bands, .. }) = self.mask else { return true };
        let value = grid.cell_of(place).map(|cell| bands[0].values[cell]);
        value.is_some_and(|value| value.is_finite() && value != 0.0)
    }
}

/// Triangles taken away by cause, each counted once, and points no triangle uses any more.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Removed {
    /// A corner is missing or not finite.
    pub not_finite: usize,
    /// The area is below the smallest.
    pub degenerate: usize,
    /// A corner lies outside the window.
    pub outside: usize,
    /// A corner lies over no valid cell of the mask.
    pub masked: usize,
    /// The piece has too few triangles.
    pub small_pieces: usize,
    /// Points that became NaN.
    pub points: usize,
    /// Triangles that stay.
    pub kept: usize,
}

impl Removed {
    fn and(self, other: Self) -> Self {
        Self {
            not_finite: self.not_finite + other.not_finite,
            degenerate: self.degenerate + other.degenerate,
            outside: self.outside + other.outside,
            masked: self.masked + other.masked,
            small_pieces: self.small_pieces + other.small_pieces,
            points: self.points + other.points,
            kept: self.kept + other.kept,
        }
    }
}

/// Cleans a surface; the same bits at any thread count.
pub fn clean(surface: &mut Surface, rules: &Rules<'_>) -> Removed {
    let mut removed = remove_bad_triangles(surface, rules);
    removed.small_pieces = pieces::remove_small(surface, rules.min_component_triangles);
    removed.points = remove_unused_points(surface);
    removed.kept = surface.squares.par_chunks(SQUARES_AT_A_TIME).map(triangles).sum();
    removed
}

/// Squares that a thread counts the triangles of at a time.
const SQUARES_AT_A_TIME: usize = 1 << 14;

/// Number of triangles of some squares.
fn triangles(squares: &[u8]) -> usize {
    let of_square = |byte: &u8| (byte & Surface::FIRST) + (byte & Surface::SECOND) / Surface::SECOND;
    // So few at a time that their number fits into a byte.
    squares.chunks(64).map(|few| usize::from(few.iter().map(of_square).sum::<u8>())).sum()
}

fn area_m2(surface: &Surface, corners: &[usize; 3]) -> f64 {
    let [a, b, c] = corners.map(|i| Vector3::from(surface.points[i]).map(f64::from));
    0.5 * (b - a).cross(&(c - a)).norm()
}

/// X and Y of a point, metres.
fn plan_m(surface: &Surface, point: usize) -> [f64; 2] {
    [0, 1].map(|axis| surface.origin_m[axis] + f64::from(surface.points[point][axis]))
}

/// Takes away the triangles that one of the rules about single triangles forbids.
fn remove_bad_triangles(surface: &mut Surface, rules: &Rules<'_>) -> Removed {
    let mut squares = std::mem::take(&mut surface.squares);
    let (width, shared) = (surface.width, &*surface);
    let everywhere = rules.window_m.is_none() && rules.mask.is_none();
    let clean_row = |judging: &mut Judging, (row, squares): (usize, &mut [u8])| {
        judging.judge(shared, row, squares, rules.min_area_m2);
        let mut removed = Removed::default();
        if everywhere && judging.is_fine.iter().fold(true, |fine, square| fine & square) {
            return removed;
        }
        for (column, byte) in
            squares.iter_mut().enumerate().filter(|(column, _)| !everywhere || !judging.is_fine[*column])
        {
            let corners = Surface::corners(width, row, column, *byte);
            for (corners, bit) in corners.iter().zip([Surface::FIRST, Surface::SECOND]) {
                if *byte & bit != 0 && is_bad(shared, corners, rules, &mut removed) {
                    *byte &= !bit;
                }
            }
        }
        removed
    };
    let rows = squares.par_chunks_mut((width - 1).max(1)).enumerate();
    let removed = rows.map_init(Judging::default, clean_row).reduce(Removed::default, Removed::and);
    surface.squares = squares;
    removed
}

/// Whether a triangle must go; the first cause counts.
fn is_bad(surface: &Surface, corners: &[usize; 3], rules: &Rules<'_>, removed: &mut Removed) -> bool {
    let all = |holds: &dyn Fn([f64; 2]) -> bool| corners.iter().all(|i| holds(plan_m(surface, *i)));
    let count = if !corners.iter().all(|i| surface.points[*i].iter().all(|value| value.is_finite())) {
        &mut removed.not_finite
    } else if area_m2(surface, corners) < rules.min_area_m2 {
        &mut removed.degenerate
    } else if !all(&|at| rules.in_window(at)) {
        &mut removed.outside
    } else if !all(&|at| rules.in_mask(at)) {
        &mut removed.masked
    } else {
        return false;
    };
    *count += 1;
    true
}

/// What one thread needs to find the squares of a row that need no closer look.
#[derive(Default)]
struct Judging {
    rows: PointRows,
    /// Whether both triangles of a square are surely finite and large enough.
    is_fine: Vec<bool>,
}

impl Judging {
    fn judge(&mut self, surface: &Surface, row: usize, squares: &[u8], min_area_m2: f64) {
        self.rows.enter(&surface.points, surface.width, row);
        self.is_fine.resize(squares.len(), false);
        // Larger than what rounding can do to a square of an area.
        let least = 4.0 * min_area_m2 * min_area_m2 * (1.0 + 1e-9);
        vectorised(Judge { rows: &self.rows, squares, least, is_fine: &mut self.is_fine });
    }
}

struct Judge<'a> {
    rows: &'a PointRows,
    squares: &'a [u8],
    /// Square of twice the least area.
    least: f64,
    is_fine: &'a mut [bool],
}

impl Work for Judge<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let count = self.squares.len();
        let [[ax, ay, az], [bx, by, bz], [cx, cy, cz], [dx, dy, dz]] =
            self.rows.corners().map(|corner| corner.map(|values| &values[..count]));
        let (squares, is_fine) = (&self.squares[..count], &mut self.is_fine[..count]);
        for i in 0..count {
            let (a, b) = ([ax[i], ay[i], az[i]], [bx[i], by[i], bz[i]]);
            let (c, d) = ([cx[i], cy[i], cz[i]], [dx[i], dy[i], dz[i]]);
            let other = squares[i] & Surface::OTHER_DIAGONAL != 0;
            // Twice the area does not depend on the corner it is measured from but for rounding.
            let first = doubled_area_squared(if other { b } else { c }, a, d);
            let second = doubled_area_squared(if other { d } else { a }, b, c);
            // What is not a number is not above; what is not finite has no finite area.
            is_fine[i] = first > self.least && second > self.least && first + second < f64::INFINITY;
        }
    }
}

/// Square of the doubled area of a triangle, m4; infinite or no number where a corner is not finite.
#[inline(always)]
fn doubled_area_squared(p: [f64; 3], q: [f64; 3], r: [f64; 3]) -> f64 {
    let (u, v) = ([q[0] - p[0], q[1] - p[1], q[2] - p[2]], [r[0] - p[0], r[1] - p[1], r[2] - p[2]]);
    let cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]
}

/// Makes the points that no triangle uses NaN; returns how many had been points.
fn remove_unused_points(surface: &mut Surface) -> usize {
    let (width, height, squares) = (surface.width, surface.height, &surface.squares);
    let line = |row: usize| &squares[row * (width - 1)..(row + 1) * (width - 1)];
    let clean_row = |(row, points): (usize, &mut [[f32; 3]])| {
        let above = if row > 0 { line(row - 1) } else { &[] };
        let below = if row + 1 < height { line(row) } else { &[] };
        let corner = |line: &[u8], column: usize, corner: u8| {
            line.get(column).is_some_and(|byte| pieces::used(*byte) & corner != 0)
        };
        let mut removed = 0;
        if !above.is_empty() && !below.is_empty() && pieces::all_whole(above) && pieces::all_whole(below) {
            return removed;
        }
        for (column, point) in points.iter_mut().enumerate() {
            let used = corner(below, column, pieces::A)
                || corner(above, column, pieces::D)
                || column > 0 && (corner(below, column - 1, pieces::B) || corner(above, column - 1, pieces::C));
            if !used {
                removed += usize::from(!point.iter().all(|value| value.is_nan()));
                *point = [f32::NAN; 3];
            }
        }
        removed
    };
    surface.points.par_chunks_mut(width).enumerate().map(clean_row).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Grid};

    const GRID: Grid = Grid { columns: 2, rows: 2, cell_m: 1.0, left_m: 10.0, top_m: 5.0 };

    fn rules(mask: &Raster) -> Rules<'_> {
        Rules { min_area_m2: 0.0, window_m: None, mask: Some(mask), min_component_triangles: 1 }
    }

    #[test]
    fn cells_of_the_mask_that_are_0_or_empty_take_the_points_over_them_away() {
        let values = vec![1.0, 0.0, f32::NAN, -2.0];
        let mask = Raster::single(GRID, Frame::Wall, "mask", "mask", values);
        let rules = rules(&mask);
        let at_centres = [[10.5, 4.5], [11.5, 4.5], [10.5, 3.5], [11.5, 3.5]];
        assert_eq!(at_centres.map(|at| rules.in_mask(at)), [true, false, false, true]);
    }

    #[test]
    fn a_cell_of_the_mask_has_its_left_and_its_upper_edge() {
        let mask = Raster::single(GRID, Frame::Wall, "mask", "mask", vec![1.0; 4]);
        let rules = rules(&mask);
        for (at, inside) in [([10.0, 5.0], true), ([12.0, 4.0], false), ([11.0, 3.0], false), ([9.999, 4.0], false)] {
            assert_eq!(rules.in_mask(at), inside, "{at:?}");
        }
        assert!(!rules.in_mask([11.0, 5.001]) && !rules.in_mask([f64::NAN, 4.0]));
        let upper = Raster::single(GRID, Frame::Wall, "mask", "mask", vec![1.0, 1.0, 0.0, 0.0]);
        assert!(!self::rules(&upper).in_mask([11.0, 4.0]), "the edge between two rows is of the lower one");
    }
}
