//! Takes away the triangles of a surface that are no surface, in a fixed order of causes.

use nalgebra::Vector3;
use rayon::prelude::*;

use rockface_core::artefact::{Raster, Surface};
use rockface_core::numerics::union_find::UnionFind;

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
    pub fn in_mask(&self, [x, y]: [f64; 2]) -> bool {
        let Some(Raster { grid, bands, .. }) = self.mask else { return true };
        let (column, row) = ((x - grid.left_m) / grid.cell_m, (grid.top_m - y) / grid.cell_m);
        let inside = column >= 0.0 && row >= 0.0 && column < grid.columns as f64 && row < grid.rows as f64;
        inside && {
            let value = bands[0].values[row as usize * grid.columns + column as usize];
            value.is_finite() && value != 0.0
        }
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

/// Cleans a surface; the same bits at any thread count.
pub fn clean(surface: &mut Surface, rules: &Rules<'_>) -> Removed {
    let not_finite =
        retain(surface, |s, corners| corners.iter().all(|i| s.points[*i].iter().all(|value| value.is_finite())));
    let degenerate = retain(surface, |s, corners| area_m2(s, corners) >= rules.min_area_m2);
    let all = |s: &Surface, corners: &[usize; 3], holds: &dyn Fn([f64; 2]) -> bool| {
        corners.iter().all(|i| holds(plan_m(s, *i)))
    };
    let outside =
        rules.window_m.map_or(0, |_| retain(surface, |s, corners| all(s, corners, &|at| rules.in_window(at))));
    let masked = rules.mask.map_or(0, |_| retain(surface, |s, corners| all(s, corners, &|at| rules.in_mask(at))));
    let small_pieces = remove_small_pieces(surface, rules.min_component_triangles);
    let points = remove_unused_points(surface);
    let kept = surface.squares.par_iter().map(|byte| (byte & (Surface::FIRST | Surface::SECOND)).count_ones() as usize);
    let kept = kept.sum();
    Removed { not_finite, degenerate, outside, masked, small_pieces, points, kept }
}

fn area_m2(surface: &Surface, corners: &[usize; 3]) -> f64 {
    let [a, b, c] = corners.map(|i| Vector3::from(surface.points[i]).map(f64::from));
    0.5 * (b - a).cross(&(c - a)).norm()
}

/// X and Y of a point, metres.
fn plan_m(surface: &Surface, point: usize) -> [f64; 2] {
    [0, 1].map(|axis| surface.origin_m[axis] + f64::from(surface.points[point][axis]))
}

/// Keeps the triangles a test holds for; returns how many went.
fn retain(surface: &mut Surface, holds: impl Fn(&Surface, &[usize; 3]) -> bool + Sync) -> usize {
    let mut squares = std::mem::take(&mut surface.squares);
    let (width, shared) = (surface.width, &*surface);
    let keep_row = |(row, squares): (usize, &mut [u8])| {
        let mut removed = 0;
        for (column, byte) in squares.iter_mut().enumerate() {
            let corners = Surface::corners(width, row, column, *byte);
            for (corners, bit) in corners.iter().zip([Surface::FIRST, Surface::SECOND]) {
                if *byte & bit != 0 && !holds(shared, corners) {
                    *byte &= !bit;
                    removed += 1;
                }
            }
        }
        removed
    };
    let removed = squares.par_chunks_mut((width - 1).max(1)).enumerate().map(keep_row).sum();
    surface.squares = squares;
    removed
}

fn for_each_triangle(surface: &Surface, mut act: impl FnMut([usize; 3])) {
    for row in 0..surface.height - 1 {
        for column in 0..surface.width - 1 {
            surface.triangles(row, column).for_each(&mut act);
        }
    }
}

fn remove_small_pieces(surface: &mut Surface, min_triangles: usize) -> usize {
    if min_triangles <= 1 {
        return 0;
    }
    let mut pieces = UnionFind::new(surface.points.len());
    for_each_triangle(surface, |[a, b, c]| {
        let root = pieces.join(a, b);
        pieces.join(root, c);
    });
    let mut sizes = vec![0u32; surface.points.len()];
    for_each_triangle(surface, |[a, ..]| sizes[pieces.root(a)] += 1);
    let roots = pieces.into_roots();
    retain(surface, |_, corners| sizes[roots[corners[0]] as usize] as usize >= min_triangles)
}

fn remove_unused_points(surface: &mut Surface) -> usize {
    let mut used = vec![false; surface.points.len()];
    for_each_triangle(surface, |corners| corners.iter().for_each(|i| used[*i] = true));
    let mut removed = 0;
    for (point, _) in surface.points.iter_mut().zip(used).filter(|(_, used)| !used) {
        removed += usize::from(!point.iter().all(|value| value.is_nan()));
        *point = [f32::NAN; 3];
    }
    removed
}
