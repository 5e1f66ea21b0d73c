//! Points that both images of a pair see: their projections, and the disparity and depth that the paper's noise gives them.
//!
//! All types exist for several pixels at once (lanes, NaN where a pixel has no value) and for one pixel.

use crate::matching::matched::Match;
use crate::matching::noise::terms::DisparityError;
use rockface_core::numerics::simd::{LANES, Lanes};

/// Projections of points into the partner image; NaN where a point has none.
pub struct Projected {
    /// Depths of the points in the image, metres.
    pub z_m: Lanes,
    /// Undistorted normalised coordinates of their true rays.
    pub ray: [Lanes; 2],
    /// Positions in the image, pixels of the full image.
    pub pixel: [Lanes; 2],
    /// Positions in the image, pixels of the depth map.
    pub level: [Lanes; 2],
}

impl Projected {
    /// Removes the projections of points that the partner does not see.
    #[inline(always)]
    pub fn keep(&mut self, seen: [bool; LANES]) {
        let seen: Lanes = Lanes::of(|lane| if seen[lane] { 1.0 } else { 0.0 });
        for positions in [&mut self.ray, &mut self.pixel, &mut self.level] {
            *positions = [positions[0].where_positive(seen), positions[1].where_positive(seen)];
        }
    }
}

/// A point that both images see, and what matching yields for it with the paper's noise; NaN where it cannot be rectified.
pub struct Correspondence<T> {
    /// Noisy ray of the image pixel at which the point is matched.
    pub image_ray: [T; 2],
    /// Ray of the depth: `image_ray`, or the ray of the pixel of the rectified image.
    pub depth_ray: [T; 2],
    /// Positions at which the noise of the first and of the second image is evaluated, pixels of the depth map.
    pub noise_px: [[T; 2]; 2],
    /// Position in the rectified first image, pixels.
    pub rectified_px: [T; 2],
    /// Disparity without matching noise, pixels.
    pub ideal_px: T,
    /// Row of the first rectified position minus row of the second, pixels.
    pub y_parallax_px: T,
    /// Depth across the rectified plane of the point at depth 1 on the ray of the image pixel.
    pub image_slant: T,
    /// Depth across the rectified plane of the point at depth 1 on the ray of the depth.
    pub slant: T,
    /// The paper's white noise, pixels.
    pub white_px: T,
    /// The paper's smooth noise, pixels.
    pub regular_px: T,
    /// Disparity with both, pixels.
    pub disparity_px: T,
    /// Depth of that disparity, metres.
    pub depth_m: T,
    /// Change of depth for one pixel of disparity, metres.
    pub depth_per_px_m: T,
}

impl Correspondence<f64> {
    /// The correspondence in one lane of several.
    #[inline]
    pub fn of(all: &Correspondence<Lanes>, lane: usize) -> Self {
        let at = |[x, y]: &[Lanes; 2]| [x[lane], y[lane]];
        let [first, second] = &all.noise_px;
        Self {
            image_ray: at(&all.image_ray),
            depth_ray: at(&all.depth_ray),
            noise_px: [at(first), at(second)],
            rectified_px: at(&all.rectified_px),
            ideal_px: all.ideal_px[lane],
            y_parallax_px: all.y_parallax_px[lane],
            image_slant: all.image_slant[lane],
            slant: all.slant[lane],
            white_px: all.white_px[lane],
            regular_px: all.regular_px[lane],
            disparity_px: all.disparity_px[lane],
            depth_m: all.depth_m[lane],
            depth_per_px_m: all.depth_per_px_m[lane],
        }
    }

    /// The match with the paper's noise, of a pixel that has a depth.
    #[inline]
    pub fn matched(&self) -> Match {
        let Self { white_px, regular_px, .. } = *self;
        Match {
            depth_m: self.depth_m,
            noisy_ray: self.depth_ray,
            ideal_px: self.ideal_px,
            error: DisparityError { white_px, blunder_px: 0.0, regular_px, relief_px: 0.0, strength: 1.0 },
            sub_pixel_px: 0.0,
            disparity_px: self.disparity_px,
            y_parallax_px: self.y_parallax_px,
            depth_per_px_m: self.depth_per_px_m,
        }
    }
}
