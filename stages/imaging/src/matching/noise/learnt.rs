//! The noise of one acquisition drawn from a learnt model, as errors of disparity by place on the face.

use crate::camera::model::Camera;
use crate::matching::noise::changed_face;
use crate::matching::noise::ensemble::{draw, log_strength_at};
use crate::matching::noise::matcher::{Keys, PairScene};
use rockface_core::StageError;
use rockface_core::artefact::{Grid, Noise};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::simd::Lanes;

/// Errors of disparity on the cells of a grid; beyond its edges they go on mirrored.
#[derive(Debug, Clone)]
pub struct LearntNoise {
    grid: Grid,
    /// Errors, pixels of the depth map.
    values_px: Vec<f32>,
}

impl LearntNoise {
    /// Draws the noise of one acquisition of a pair.
    ///
    /// The streams do not depend on the pair: the model holds the noise of the surface that a survey yields, so all pairs of
    /// an acquisition share it.
    pub fn new(noise: &Noise, scene: &PairScene, keys: Keys) -> Result<Self, StageError> {
        let depth = scene.geometry.ideal[scene.side];
        if noise.frame != depth.frame {
            let text =
                format!("the noise model is in the {} frame, the depth maps in the {} frame", noise.frame, depth.frame);
            return Err(StageError::new(text).hint("learn the model from rasters in the frame of the survey"));
        }
        let drawn = draw(noise, keys);
        let camera: &Camera = &scene.geometry.cameras[scene.side];
        let strength = changed_face::strength(noise, depth, camera);
        let scale = 1.0 / f64::from(depth.downscale);
        let value = |(unit, strength_px): (&f64, &f32)| {
            let strength_px = f64::from(*strength_px);
            if strength_px <= 0.0 {
                return 0.0;
            }
            let log = log_strength_at(&noise.class_log_strength, &drawn.log_strength, portable_math::log(strength_px));
            (unit * strength_px * portable_math::exp(log) * scale) as f32
        };
        Ok(Self { grid: noise.grid, values_px: drawn.field.iter().zip(&strength).map(value).collect() })
    }

    /// The error at a place on the face, pixels of the depth map: that of its cell.
    pub fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let column = mirrored((x - self.grid.left_m) / self.grid.cell_m, self.grid.columns);
        let row = mirrored((self.grid.top_m - y) / self.grid.cell_m, self.grid.rows);
        f64::from(self.values_px[row * self.grid.columns + column])
    }

    /// The errors at some places.
    pub fn at_lanes(&self, [x, y]: [Lanes; 2]) -> Lanes {
        Lanes::of(|lane| if x[lane].is_nan() { 0.0 } else { self.at([x[lane], y[lane]]) })
    }
}

/// The cell of a position along one side of a grid of `size` cells, which is mirrored at its ends.
fn mirrored(position: f64, size: usize) -> usize {
    let period = 2.0 * size as f64;
    let within = position.rem_euclid(period);
    let folded = if within < size as f64 { within } else { period - within };
    (folded as usize).min(size - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beyond_its_edges_the_field_goes_on_mirrored() {
        for (position, cell) in [(0.0, 0), (2.9, 2), (3.1, 2), (5.5, 0), (-0.5, 0), (-2.5, 2), (6.2, 0), (60.1, 0)] {
            assert_eq!(mirrored(position, 3), cell, "{position}");
        }
    }
}
