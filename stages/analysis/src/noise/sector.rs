//! The sector of lags or frequencies about a direction that a directional variogram or spectrum takes.

use rockface_core::numerics::portable_math;

/// Half the angle of a sector, degrees.
pub const HALF_ANGLE_DEG: f64 = 22.5;

/// A direction and its opposite, with what lies within [`HALF_ANGLE_DEG`] of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sector {
    sin: f64,
    cos: f64,
    /// Cosine of the half angle.
    least: f64,
}

impl Sector {
    /// The sector about a direction, degrees counter-clockwise from the rows' direction.
    pub fn about(direction_deg: f64) -> Self {
        let (sin, cos) = portable_math::sincos(direction_deg.to_radians());
        Self { sin, cos, least: portable_math::cos(HALF_ANGLE_DEG.to_radians()) }
    }

    /// Whether a vector along the columns and down the rows lies in it.
    pub fn contains(&self, across: f64, down: f64) -> bool {
        // Rows go down, angles up. A vector and its opposite are one.
        (across * self.cos - down * self.sin).abs() >= self.least * (across * across + down * down).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_sectors_share_the_plane() {
        let sectors = [0.0, 45.0, 90.0, 135.0].map(Sector::about);
        for (across, down, index) in [(5.0, 1.0, 0), (3.0, -4.0, 1), (-1.0, 9.0, 2), (2.0, 2.0, 3), (-2.0, -2.0, 3)] {
            let found: Vec<usize> = (0..4).filter(|i| sectors[*i].contains(across, down)).collect();
            assert_eq!(found, [index], "{across} {down}");
        }
    }
}
