//! Which noise a matched disparity gets: that of the paper, one with further terms, or one learnt from rasters of the site.

use crate::matching::noise::learnt::LearntNoise;
use crate::matching::noise::paper::{LocalNoise, SmoothNoise};
use crate::matching::noise::terms::Terms;

/// A field of unit standard deviation and the factor on it.
#[derive(Debug, Clone)]
pub struct Scaled<F> {
    /// Standard deviation of the noise, pixels.
    pub sigma_px: f64,
    /// The field, or the fields that add up to it.
    pub field: F,
}

/// The noise of the matching of a pair.
#[derive(Debug, Clone)]
pub enum NoiseModel {
    /// The paper's two components, each of which may be absent.
    Paper {
        /// White noise, independent from pixel to pixel.
        local: Option<Scaled<LocalNoise>>,
        /// Smooth noise, interpolated between nodes.
        smooth: Option<Scaled<SmoothNoise>>,
    },
    /// Both components and the further terms of a real matcher, pixel by pixel.
    Terms(Box<Terms>),
    /// An acquisition of a learnt model, by place on the face.
    Learnt(LearntNoise),
}
