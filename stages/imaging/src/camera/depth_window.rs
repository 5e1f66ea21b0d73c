//! Depths between the pixels of a depth map: the slope of the inverse depth about a pixel, and the depth at any position.
//!
//! Inverse depth is an affine function of the ray wherever the surface is plane, and so, within a pixel of a real lens and
//! less than a micrometre, of the position in the image.

use rockface_core::artefact::Depth;
use rockface_core::numerics::fast_round::nearest;

/// Share of the depth by which a neighbour may differ and still belong to the same surface.
pub const STEP: f64 = 0.01;
/// Half width of the windows of the regression for depths between pixels.
const REACH: usize = 2;

/// A depth map and the size of the windows of its regressions.
#[derive(Debug, Clone, Copy)]
pub struct DepthWindow<'a> {
    /// Depths by row, metres, NaN where there is none.
    pub z: &'a [f32],
    /// Number of columns of the map.
    pub width: usize,
    /// Number of rows of the map.
    pub height: usize,
    /// Half width of a window: it has `2 reach + 1` pixels a side.
    pub reach: usize,
}

/// Inverse depth about a pixel: `inverse + across du + down dv`, 1/m and 1/m a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slope {
    /// At the pixel, by the regression.
    pub inverse: f64,
    /// How much it grows from one column to the next.
    pub across: f64,
    /// How much it grows from one row to the next.
    pub down: f64,
}

/// Index of the pixel in which a position lies; `None` outside of the map.
pub fn pixel_at(width: usize, height: usize, [x, y]: [f64; 2]) -> Option<usize> {
    let inside = x >= -0.5 && y >= -0.5 && x < width as f64 - 0.5 && y < height as f64 - 0.5;
    inside.then(|| nearest(y).max(0) as usize * width + nearest(x).max(0) as usize).filter(|at| *at < width * height)
}

impl<'a> DepthWindow<'a> {
    /// A depth map in the narrow windows that depths between pixels need.
    pub fn of(depth: &'a Depth) -> Self {
        Self { z: &depth.z, width: depth.width, height: depth.height, reach: REACH }
    }

    /// Depth at a position, metres: the depth of its pixel, extrapolated by the slope about that pixel. The noise of a pixel is
    /// neither averaged nor mixed with that of its neighbours, and depth steps are not interpolated.
    pub fn z_at(&self, position: [f64; 2]) -> Option<f64> {
        let index = pixel_at(self.width, self.height, position)?;
        let z_m = f64::from(self.z[index]);
        if !z_m.is_finite() {
            return None;
        }
        let (row, column) = (index / self.width, index % self.width);
        let Some(Slope { across, down, .. }) = self.slope(row, column, z_m) else { return Some(z_m) };
        let inverse = 1.0 / z_m + across * (position[0] - column as f64) + down * (position[1] - row as f64);
        (inverse > 0.0).then(|| 1.0 / inverse)
    }

    /// Regression of the inverse depth of the neighbours that belong to the surface at depth `z_m` on their columns and
    /// rows; `None` where they are too few or on one line.
    pub fn slope(&self, row: usize, column: usize, z_m: f64) -> Option<Slope> {
        let span = |at: usize, size: usize| at.saturating_sub(self.reach)..(at + self.reach + 1).min(size);
        let [mut n, mut u, mut v, mut w, mut uu, mut uv, mut vv, mut uw, mut vw] = [0.0f64; 9];
        for r in span(row, self.height) {
            for c in span(column, self.width) {
                let z = f64::from(self.z[r * self.width + c]);
                // The negated comparison leaves out NaN too.
                if (z - z_m).abs() <= STEP * z_m {
                    let (du, dv, inverse) = (c as f64 - column as f64, r as f64 - row as f64, 1.0 / z);
                    (n, u, v, w) = (n + 1.0, u + du, v + dv, w + inverse);
                    (uu, uv, vv) = (uu + du * du, uv + du * dv, vv + dv * dv);
                    (uw, vw) = (uw + du * inverse, vw + dv * inverse);
                }
            }
        }
        let (uu, uv, vv) = (uu - u * u / n, uv - u * v / n, vv - v * v / n);
        let (uw, vw) = (uw - u * w / n, vw - v * w / n);
        let determinant = uu * vv - uv * uv;
        if !(n >= 3.0 && determinant > 1e-9) {
            return None;
        }
        let (across, down) = ((uw * vv - vw * uv) / determinant, (vw * uu - uw * uv) / determinant);
        Some(Slope { inverse: (w - across * u - down * v) / n, across, down })
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_met_between_its_pixels_and_a_step_stays_one() {
        let (width, height) = (20, 10);
        let inverse = |x: f64, y: f64| 0.05 + 0.0002 * x - 0.0001 * y;
        let near = |at: usize| (1.0 / inverse((at % width) as f64, (at / width) as f64)) as f32;
        let z: Vec<f32> = (0..width * height).map(|at| if at % width < 12 { near(at) } else { 30.0 }).collect();
        let window = DepthWindow { z: &z, width, height, reach: 2 };
        for position in [[3.3, 4.4], [11.4, 0.0], [-0.4, 9.4]] {
            let expected = 1.0 / inverse(position[0], position[1]);
            assert!((window.z_at(position).unwrap() - expected).abs() < 1e-5);
        }
        assert!((window.z_at([11.6, 5.0]).unwrap() - 30.0).abs() < 1e-6);
        assert_eq!(window.z_at([-0.6, 5.0]), None);
        let lone = [f32::NAN, 7.0, f32::NAN, f32::NAN];
        let window = DepthWindow { z: &lone, width: 2, height: 2, reach: 2 };
        assert_eq!((window.z_at([1.2, 0.3]), window.z_at([0.0, 0.0])), (Some(7.0), None));
    }
}
