//! What matching yields at one pixel, and the sums of it over an image.

use crate::matching::noise::terms::DisparityError;
use rockface_core::numerics::simd::Lanes;

/// Everything that the matching of one pixel yields: disparity and its errors, ray and depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Depth on the noisy ray, metres; in the rectified image where disparities are sampled there.
    pub depth_m: f64,
    /// Normalised coordinates of the noisy ray, or of the ray of the rectified image.
    pub noisy_ray: [f64; 2],
    /// Disparity without matching noise, pixels: of the true projections, rectified by the noisy cameras.
    pub ideal_px: f64,
    /// Matching noise, term by term.
    pub error: DisparityError,
    /// What the sub-pixel step adds, pixels.
    pub sub_pixel_px: f64,
    /// Noisy disparity, pixels: the sum of the ideal one and all terms.
    pub disparity_px: f64,
    /// Row of the first rectified position minus row of the second, pixels.
    pub y_parallax_px: f64,
    /// Change of depth for one pixel of disparity, metres.
    pub depth_per_px_m: f64,
}

impl Match {
    /// Distance along the noisy ray, metres.
    pub fn range_m(&self) -> f64 {
        let [x, y] = self.noisy_ray;
        self.depth_m * (x * x + y * y + 1.0).sqrt()
    }
}

/// What takes the matches of a row, from left to right.
pub trait TakeMatches {
    /// Takes the match of a column.
    fn take(&mut self, column: usize, matched: &Match);

    /// Takes the depths of neighbouring columns from `first` on, metres, and their changes for one pixel of disparity, where nothing
    /// else of their matches is wanted; `false` where it is, and nothing was taken. Implementations say `#[inline(always)]`.
    fn take_depths(&mut self, first: usize, depth_m: Lanes, depth_per_px_m: Lanes) -> bool;
}

/// Sums over the matched pixels of an image, added in the order of its rows.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tally {
    /// Number of matched pixels.
    pub count: usize,
    /// Sum of squared y-parallaxes, square pixels.
    pub y_parallax2_px2: f64,
    /// Sum of the changes of depth for one pixel of disparity, metres.
    pub depth_per_px_m: f64,
}

impl Tally {
    /// Adds a match to the sums.
    pub fn add(&mut self, m: &Match) {
        self.count += 1;
        self.y_parallax2_px2 += m.y_parallax_px * m.y_parallax_px;
        self.depth_per_px_m += m.depth_per_px_m;
    }

    /// Adds matches in all lanes, one after the other, by their y-parallaxes and their changes of depth.
    #[inline(always)]
    pub fn add_lanes(&mut self, y_parallax_px: Lanes, depth_per_px_m: Lanes) {
        let (parallaxes2, steps_m) = ((y_parallax_px * y_parallax_px).each(), depth_per_px_m.each());
        self.count += parallaxes2.len();
        for (parallax2, step_m) in parallaxes2.into_iter().zip(steps_m) {
            self.y_parallax2_px2 += parallax2;
            self.depth_per_px_m += step_m;
        }
    }

    /// The sums of both.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            y_parallax2_px2: self.y_parallax2_px2 + other.y_parallax2_px2,
            depth_per_px_m: self.depth_per_px_m + other.depth_per_px_m,
        }
    }
}
