//! The triangle of shapes of Sneed and Folk (1958): compact at the top, platy to the left, elongate to the right.
//!
//! `chart` draws it as SVG, `rockfall_figure` beside the picture of a face; where shapes and lines lie is told here.

use rockface_rock::rockfall::ground_truth::sneed_folk::{ELONGATION_LIMITS, FLATNESS_LIMITS};

/// Height of an equilateral triangle to its side.
pub const HEIGHT: f64 = 0.866_025_403_784_438_6;

/// The triangle on a drawing whose Y points downwards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeTriangle {
    /// Left end of the base, pixels.
    pub left: [f64; 2],
    /// Length of a side, pixels.
    pub side: f64,
}

impl ShapeTriangle {
    /// Where a shape lies, pixels: S/L upwards, (L - I)/(L - S) from left to right at that height.
    pub fn place(&self, flatness: f64, elongation: f64) -> [f64; 2] {
        let x = 0.5 * flatness + elongation * (1.0 - flatness);
        [self.left[0] + x * self.side, self.left[1] - flatness * HEIGHT * self.side]
    }

    /// The line between classes at each limit of S/L, from left to right.
    pub fn flatness_lines(&self) -> [[[f64; 2]; 2]; FLATNESS_LIMITS.len()] {
        FLATNESS_LIMITS.map(|flatness| [self.place(flatness, 0.0), self.place(flatness, 1.0)])
    }

    /// The line between classes at each limit of (L - I)/(L - S), upwards.
    pub fn elongation_lines(&self) -> [[[f64; 2]; 2]; ELONGATION_LIMITS.len()] {
        ELONGATION_LIMITS.map(|elongation| [self.place(0.0, elongation), self.place(FLATNESS_LIMITS[0], elongation)])
    }

    /// The corners: left, right, top.
    pub fn corners(&self) -> [[f64; 2]; 3] {
        [self.place(0.0, 0.0), self.place(0.0, 1.0), self.place(1.0, 0.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corners_are_as_far_apart_as_a_side_is_long() {
        let triangle = ShapeTriangle { left: [10.0, 100.0], side: 40.0 };
        let [left, right, top] = triangle.corners();
        let apart = |[x, y]: [f64; 2], [u, v]: [f64; 2]| ((x - u) * (x - u) + (y - v) * (y - v)).sqrt();
        assert_eq!((left, right), ([10.0, 100.0], [50.0, 100.0]));
        assert!((apart(left, top) - 40.0).abs() < 1e-12 && (apart(right, top) - 40.0).abs() < 1e-12);
    }
}
