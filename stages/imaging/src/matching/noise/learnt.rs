//! The noise of one acquisition drawn from a learnt model, as errors of disparity by place on the face.

use crate::camera::model::Camera;
use crate::matching::noise::changed_face;
use crate::matching::noise::ensemble::draw;
use crate::matching::noise::matcher::{Keys, PairScene};
use rockface_core::StageError;
use rockface_core::artefact::{Grid, Noise};
use rockface_core::numerics::simd::Lanes;

/// Times that the place where a point lands is looked up anew.
const LANDINGS: usize = 2;

/// Errors of disparity on the cells of a grid; beyond its edges they go on mirrored.
#[derive(Debug, Clone)]
pub struct LearntNoise {
    grid: Grid,
    /// Errors, pixels of the depth map; NaN in gaps.
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
        let scale = 1.0 / depth.downscale as f32;
        let values_px = drawn.errors_px(noise, &strength).into_iter().map(|error_px| error_px * scale).collect();
        Ok(Self { grid: noise.grid, values_px })
    }

    /// The error at a place on the face, pixels of the depth map: that of its cell; NaN in a gap, where nothing is matched.
    pub fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let column = mirrored((x - self.grid.left_m) / self.grid.cell_m, self.grid.columns);
        let row = mirrored((self.grid.top_m - y) / self.grid.cell_m, self.grid.rows);
        f64::from(self.values_px[row * self.grid.columns + column])
    }

    /// The errors of some points, each that of the cell in which its point comes to lie: an error moves a point along its ray,
    /// and it is there that a raster of the surface meets it.
    ///
    /// `points` and `centre` (of the camera) are X and Y on the face, metres; `parallax_px` is the disparity beyond that of infinity without noise.
    pub fn landing_lanes(&self, [x, y]: [Lanes; 2], centre: [f64; 2], parallax_px: Lanes) -> Lanes {
        Lanes::of(|lane| {
            let (point, parallax_px) = ([x[lane], y[lane]], parallax_px[lane]);
            if point[0].is_nan() || parallax_px.is_nan() { 0.0 } else { self.landing(point, centre, parallax_px) }
        })
    }

    /// See [`Self::landing_lanes`].
    fn landing(&self, point: [f64; 2], centre: [f64; 2], parallax_px: f64) -> f64 {
        let mut error_px = self.at(point);
        for _ in 0..LANDINGS {
            let share = parallax_px / (parallax_px + error_px);
            if !(0.5..2.0).contains(&share) {
                break;
            }
            error_px = self.at([0, 1].map(|axis| centre[axis] + (point[axis] - centre[axis]) * share));
        }
        error_px
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
#[allow(clippy::float_cmp)] // values that are exact
mod tests {
    use super::*;

    #[test]
    fn a_point_has_the_error_of_the_cell_it_lands_in() {
        // The camera is at 0: an error of a third of the parallax brings a point to three quarters of its distance.
        let grid = Grid { columns: 20, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        let noise = LearntNoise { grid, values_px: (0..20).map(|i| if i < 5 { 5.0 } else { 1.0 }).collect() };
        assert_eq!((noise.landing([8.0, 0.5], [0.0; 2], 15.0), noise.landing([4.0, 0.5], [0.0; 2], 15.0)), (1.0, 5.0));
        assert_eq!(noise.landing([5.2, 0.5], [0.0; 2], 15.0), 5.0);
        let x = Lanes::of(|lane| if lane == 0 { 5.2 } else { f64::NAN });
        let all = noise.landing_lanes([x, x], [0.0; 2], Lanes::all(15.0));
        assert_eq!((all[0], all[1]), (5.0, 0.0));
    }

    #[test]
    fn beyond_its_edges_the_field_goes_on_mirrored() {
        for (position, cell) in [(0.0, 0), (2.9, 2), (3.1, 2), (5.5, 0), (-0.5, 0), (-2.5, 2), (6.2, 0), (60.1, 0)] {
            assert_eq!(mirrored(position, 3), cell, "{position}");
        }
    }
}
