//! Gaps and skewness of rasters, and the gains of a model with which its draws have as much of both.

use crate::noise::learning::departure::{Departure, Mean, of_another};
use crate::noise::learning::differences::{gaps, skewnesses};
use rockface_core::artefact::{MOST_GAP_GAIN, MOST_GAP_VARIETY, MOST_SKEWNESS_GAIN};

/// Share of gaps and skewness of rasters.
pub struct Marks {
    /// Share of gaps.
    gaps: Mean,
    /// Deviation of the share of gaps.
    variety: f64,
    /// Root mean square.
    skewness: f64,
}

impl Marks {
    /// Those of rasters, in the cells that some of them see.
    pub fn of(rasters: &[impl AsRef<[f32]> + Sync], seen: &[bool]) -> Self {
        let skewnesses = skewnesses(rasters);
        let squares = skewnesses.iter().map(|skewness| skewness * skewness).sum::<f64>();
        let gaps = Mean::of(&gaps(rasters, seen), 0);
        let count = rasters.len() as f64;
        Self { gaps, variety: (gaps.squared_error * count).sqrt(), skewness: (squares / count).sqrt() }
    }

    /// What the marks of one more of as many rasters vary.
    #[must_use]
    pub fn of_another(self, rasters: usize) -> Self {
        let wider = of_another(rasters).sqrt();
        Self { variety: wider * self.variety, skewness: wider * self.skewness, ..self }
    }
}

/// The gains of a model with which its draws have the marks of the rasters.
#[derive(Debug, Clone, Copy)]
pub struct Gains {
    /// Of the share of gaps, as `gap_gain` of [`rockface_core::artefact::Noise`].
    pub gaps: f64,
    /// Of what the share of gaps varies by, as `gap_variety` of [`rockface_core::artefact::Noise`].
    pub variety: f64,
    /// Of the skewness, as `skewness_gain` of [`rockface_core::artefact::Noise`].
    pub skewness: f64,
}

impl Default for Gains {
    /// What holds without filter and mixing: a difference of two acquisitions that are independent has half of their skewness, and a share of gaps that varies less than
    /// theirs by sqrt 2.
    fn default() -> Self {
        Self { gaps: 1.0, variety: std::f64::consts::SQRT_2, skewness: 2.0 }
    }
}

impl Gains {
    /// Better gains, after draws with these have the marks that were found: outliers that are filtered out of draws leave gaps too, and take the tails that make them skewed.
    #[must_use]
    pub fn refined(self, real: &Marks, found: &Marks) -> Self {
        let excess = Departure::of(found.gaps, real.gaps.exact()).certain(1.0);
        let gaps = if real.gaps.value > 0.0 { self.gaps - excess / real.gaps.value } else { self.gaps };
        let times = |gain: f64, ratio: f64| if ratio.is_finite() { gain * ratio.clamp(0.5, 2.0) } else { gain };
        Self {
            gaps: gaps.clamp(0.0, MOST_GAP_GAIN),
            variety: times(self.variety, real.variety / found.variety).min(MOST_GAP_VARIETY),
            skewness: times(self.skewness, real.skewness / found.skewness).min(MOST_SKEWNESS_GAIN),
        }
    }
}
