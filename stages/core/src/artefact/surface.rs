//! An organised grid of points whose triangles are implicit: 45 million vertices without two gigabytes of indices.

use rayon::prelude::*;

use super::Frame;
use crate::numerics::simd::{Work, vectorised};

/// Points whose extent a thread finds at a time.
const POINTS_AT_A_TIME: usize = 1 << 14;

/// An organised surface: a grid of points, and for every grid square which of its two triangles exist.
///
/// Square (row, column) has the corners a = (row, column), b = (row, column + 1), c = (row + 1, column + 1),
/// d = (row + 1, column). Its byte in `squares` has [`Surface::FIRST`] and [`Surface::SECOND`] for its triangles, and
/// [`Surface::OTHER_DIAGONAL`] for the way it is cut: a-c by default (first a, d, c; second a, c, b), b-d otherwise
/// (first a, d, b; second b, d, c). In a grid laid out like an image (columns right, rows down) seen from outside the
/// rock, all four are counter-clockwise.
#[derive(Debug, Clone)]
pub struct Surface {
    /// The frame of the points.
    pub frame: Frame,
    /// Number of columns of points; of squares there is one less.
    pub width: usize,
    /// Number of rows of points; of squares there is one less.
    pub height: usize,
    /// Added to every point, metres; keeps 32-bit points exact to micrometres.
    pub origin_m: [f64; 3],
    /// Points relative to the origin, metres, by row; NaN where there is none. `height x width`.
    pub points: Vec<[f32; 3]>,
    /// Triangles of each square, `(height - 1) x (width - 1)`.
    pub squares: Vec<u8>,
}

impl Surface {
    /// Bit of the first triangle.
    pub const FIRST: u8 = 1;
    /// Bit of the second triangle.
    pub const SECOND: u8 = 2;
    /// Bit of the b-d diagonal.
    pub const OTHER_DIAGONAL: u8 = 4;

    /// A point in its frame, metres; `None` where there is none.
    pub fn point(&self, row: usize, column: usize) -> Option<[f64; 3]> {
        let p = self.points[row * self.width + column];
        let o = self.origin_m;
        (!p[0].is_nan()).then(|| [o[0] + f64::from(p[0]), o[1] + f64::from(p[1]), o[2] + f64::from(p[2])])
    }

    /// The extent of its points.
    pub fn extent(&self) -> Extent {
        let parts = self.points.par_chunks(POINTS_AT_A_TIME).map(|points| vectorised(FindExtent(points)));
        parts.reduce(|| Extent::NONE, Extent::and)
    }

    /// Both triangles of a square as point indices, cut as its byte says, whether they exist or not.
    pub fn corners(width: usize, row: usize, column: usize, byte: u8) -> [[usize; 3]; 2] {
        let a = row * width + column;
        let (b, c, d) = (a + 1, a + width + 1, a + width);
        if byte & Self::OTHER_DIAGONAL == 0 { [[a, d, c], [a, c, b]] } else { [[a, d, b], [b, d, c]] }
    }

    /// The triangles of one square as point indices, at most two.
    pub fn triangles(&self, row: usize, column: usize) -> impl Iterator<Item = [usize; 3]> + use<> {
        let byte = self.squares[row * (self.width - 1) + column];
        let [first, second] = Self::corners(self.width, row, column, byte);
        let first = (byte & Self::FIRST != 0).then_some(first);
        let second = (byte & Self::SECOND != 0).then_some(second);
        first.into_iter().chain(second)
    }
}

/// Equal frames and bits: NaN equals NaN.
impl PartialEq for Surface {
    fn eq(&self, other: &Self) -> bool {
        let bits = |surface: &Self| surface.points.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
        (self.frame, self.width, self.height) == (other.frame, other.width, other.height)
            && self.origin_m == other.origin_m
            && self.squares == other.squares
            && bits(self) == bits(other)
    }
}

/// Smallest and largest X and Y of the points of a surface, and how many there are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    /// Smallest X and Y relative to the origin of the surface, metres; infinite without points.
    pub low: [f32; 2],
    /// Largest X and Y relative to the origin of the surface, metres; infinite without points.
    pub high: [f32; 2],
    /// Number of points.
    pub count: u32,
}

impl Extent {
    const NONE: Self = Self { low: [f32::INFINITY; 2], high: [f32::NEG_INFINITY; 2], count: 0 };

    /// That of both; the same in any order.
    #[inline(always)]
    fn and(self, other: Self) -> Self {
        let low = [self.low[0].min(other.low[0]), self.low[1].min(other.low[1])];
        let high = [self.high[0].max(other.high[0]), self.high[1].max(other.high[1])];
        Self { low, high, count: self.count + other.count }
    }

    #[inline(always)]
    fn of([x, y, _]: [f32; 3]) -> Self {
        Self { low: [x, y], high: [x, y], count: u32::from(!x.is_nan()) }
    }
}

/// Finds the extent of some points.
struct FindExtent<'a>(&'a [[f32; 3]]);

impl Work for FindExtent<'_> {
    type Output = Extent;

    #[inline(always)]
    fn run(self) -> Extent {
        let (blocks, rest) = self.0.as_chunks::<8>();
        // Each point of a block adds to an extent of its own.
        let mut extents = [Extent::NONE; 8];
        for points in blocks {
            for lane in 0..8 {
                extents[lane] = extents[lane].and(Extent::of(points[lane]));
            }
        }
        extents.into_iter().chain(rest.iter().map(|point| Extent::of(*point))).fold(Extent::NONE, Extent::and)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extent_is_that_of_the_points_and_skips_gaps() {
        let points: Vec<[f32; 3]> = (0u16..43 * 3)
            .map(|i| if i % 5 == 0 { [f32::NAN; 3] } else { [f32::from(i % 43), -2.0 * f32::from(i / 43), 7.0] })
            .collect();
        let gap = Surface {
            frame: Frame::Wall,
            width: 43,
            height: 3,
            origin_m: [1e6; 3],
            points: vec![[f32::NAN; 3]; 43 * 3],
            squares: vec![0; 42 * 2],
        };
        assert_eq!(gap.extent(), Extent::NONE);
        let count = points.iter().filter(|point| !point[0].is_nan()).count() as u32;
        let surface = Surface { points, ..gap };
        assert_eq!(surface.extent(), Extent { low: [0.0, -4.0], high: [42.0, 0.0], count });
    }
}
