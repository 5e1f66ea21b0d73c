//! Smooth random fields that modulate the noise from place to place, and patches of blunders and holes.

use crate::matching::noise::correlated::SPACING_OF_SCALE;
use crate::matching::noise::paper::{Distribution, FieldRecipe, Interpolation, SmoothNoise, Variance};
use rockface_core::numerics::normal::normal_quantile;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;

/// A smooth normal field of unit deviation whose correlation is a Gaussian of deviation `length` (any unit), its nodes
/// drawn ahead for positions within `low..high`.
pub fn smooth_field(key: &Key, length: f64, low: [f64; 2], high: [f64; 2]) -> SmoothNoise {
    let recipe = FieldRecipe {
        spacing_px: SPACING_OF_SCALE * length,
        distribution: Distribution::Gaussian,
        interpolation: Interpolation::BSpline,
        variance: Variance::Pointwise,
    };
    SmoothNoise::new(key, recipe, low, high)
}

/// A log-normal factor with mean square 1: it redistributes the variance of the noise and does not raise it.
#[derive(Debug, Clone)]
pub struct Modulation {
    /// Standard deviation of its logarithm.
    pub log_sd: f64,
    /// The normal field of its logarithm, of unit deviation.
    pub field: SmoothNoise,
}

impl Modulation {
    /// The factor at a position.
    pub fn at(&self, position: [f64; 2]) -> f64 {
        factor(self.log_sd, self.field.at(position))
    }
}

/// A log-normal factor of mean square 1 from a standard normal draw.
pub fn factor(log_sd: f64, normal: f64) -> f64 {
    portable_math::exp(log_sd * normal - log_sd * log_sd)
}

/// Patches where a smooth normal field is above a level, covering a share of the plane.
#[derive(Debug, Clone)]
pub struct Patches {
    level: f64,
    field: SmoothNoise,
}

impl Patches {
    /// Patches that cover `share` (0 to 1) of the plane.
    pub fn new(share: f64, field: SmoothNoise) -> Self {
        Self { level: upper_point(share), field }
    }

    /// Whether a position lies in a patch.
    pub fn covers(&self, position: [f64; 2]) -> bool {
        self.field.at(position) > self.level
    }
}

/// The value a standard normal draw exceeds with probability `share`.
pub fn upper_point(share: f64) -> f64 {
    -normal_quantile(share)
}

/// Patches in which the disparity has a smooth normal error: a neighbourhood matched to the wrong place.
#[derive(Debug, Clone)]
pub struct Blunders {
    /// Where the blunders are.
    pub patches: Patches,
    /// Standard deviation of the error inside, pixels.
    pub sigma_px: f64,
    /// The error, as a field of unit deviation.
    pub error: SmoothNoise,
}

impl Blunders {
    /// The error at a position, pixels; 0 outside the patches.
    pub fn at(&self, position: [f64; 2]) -> f64 {
        if self.patches.covers(position) { self.sigma_px * self.error.at(position) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn upper_points_are_the_tabulated_ones() {
        for (share, expected) in [(0.5, 0.0), (0.025, 1.959_963_984_540_054), (0.001, 3.090_232_306_167_813_5)] {
            assert!((upper_point(share) - expected).abs() < 1e-9, "{share}");
        }
    }

    #[test]
    fn patches_cover_their_share_and_factors_have_mean_square_one() {
        let field = || smooth_field(&Key([6; 32]), 2.0, [0.0; 2], [1000.0; 2]);
        let patches = Patches::new(0.1, field());
        let modulation = Modulation { log_sd: 0.4, field: field() };
        let (mut covered, mut squares) = (0.0, 0.0);
        for i in 0..40_000 {
            let position = [f64::from(i % 200) * 5.0, f64::from(i / 200) * 5.0];
            covered += f64::from(u8::from(patches.covers(position)));
            squares += modulation.at(position) * modulation.at(position);
        }
        assert!((covered / 40_000.0 - 0.1).abs() < 0.01, "{covered}");
        assert!((squares / 40_000.0 - 1.0).abs() < 0.05, "{squares}");
    }
}
