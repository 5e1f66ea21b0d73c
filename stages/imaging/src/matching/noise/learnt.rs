//! The noise of one acquisition drawn from a learnt model, as errors of disparity by place on the face.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::matching::elevation_step::SurveySteps;
use crate::matching::noise::changed_face::Face;
use crate::matching::noise::ensemble::Numbers;
use crate::matching::noise::matcher::Keys;
use crate::matching::noise::model_draws::Model;
use crate::matching::noise::spline::{Spline, mirrored};
use crate::matching::side::Side;
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Depth, Grid, Noise, Pairs};
use rockface_core::numerics::marginal;
use rockface_core::numerics::quantile::median;
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, vectorised};

/// Nodes along the longer side of the grid at which the geometry of pairs is looked at.
const NODES: usize = 32;

/// One acquisition of a learnt model as an image sees it: the same error of elevation for all of its pairs.
///
/// A model holds the noise of the surface that a survey yields, in pixels of disparity that are worth as much as in the median pair. A pair with
/// a shorter base has fewer of these pixels for the same error of elevation.
#[derive(Debug, Clone)]
pub struct Acquisition<'a> {
    noise: &'a Noise,
    survey: SurveySteps,
    nodes: Nodes,
    /// What a pixel is worth in the survey at each node, metres.
    step_m: Vec<Option<f64>>,
    /// Errors, pixels of the full image as in the median pair; 0 in gaps.
    errors_px: Vec<f32>,
    gaps: Arc<Vec<bool>>,
    face: Arc<Face>,
    downscale: u32,
}

impl<'a> Acquisition<'a> {
    /// Draws an acquisition for the ideal depth map of an image, which `block` and `pairs` survey with others.
    ///
    /// The streams depend neither on the image nor on its pairs: all of a survey share what is drawn. `numbers` are those of [`Model::draw`].
    pub fn new(
        model: Model<'a>,
        numbers: Numbers,
        depth: &Depth,
        block: &Cameras,
        pairs: &Pairs,
        keys: Keys,
    ) -> Result<Self, StageError> {
        let noise = model.noise;
        if noise.frame != depth.frame {
            let text =
                format!("the noise model is in the {} frame, the depth maps in the {} frame", noise.frame, depth.frame);
            return Err(StageError::new(text).hint("learn the model from rasters in the frame of the survey"));
        }
        let survey = SurveySteps::new(block, pairs)?;
        let face = model.face(depth);
        let mut errors_px = model.draw(&face, numbers, keys).errors_px(noise, &face.strength);
        let gaps = Arc::new(errors_px.iter().map(|px| px.is_nan()).collect());
        errors_px.iter_mut().filter(|px| px.is_nan()).for_each(|px| *px = 0.0);
        let nodes = Nodes::new(noise.grid, &noise.elevation);
        let step_m = nodes.points.iter().map(|point| survey.nearly_at(point)).collect();
        Ok(Self { noise, survey, nodes, step_m, errors_px, gaps, face, downscale: depth.downscale })
    }

    /// Its errors in the disparity of a pair, for the depth map of the image on one side.
    pub fn of_pair(&self, pair: &str, side: Side) -> LearntNoise {
        let own_m = self.survey.of_pair(pair, side);
        let shares: Vec<f32> =
            self.step_m.iter().zip(&self.nodes.points).map(|(step_m, point)| share(*step_m, own_m(point))).collect();
        let columns = self.noise.grid.columns;
        let scale = 1.0 / self.downscale as f32;
        let value = |(cell, error_px): (usize, &f32)| {
            error_px * scale * self.nodes.between(&shares, cell % columns, cell / columns)
        };
        let values_px: Vec<f32> = self.errors_px.iter().enumerate().map(value).collect();
        let range_px =
            values_px.iter().fold([0.0, 0.0], |[low, high]: [f32; 2], v| [low.min(*v), high.max(*v)]).map(f64::from);
        LearntNoise {
            grid: self.noise.grid,
            errors_px: Spline::new(values_px, columns),
            // Between cells a surface may lie beyond their values.
            range_px: range_px.map(|px| 1.5 * px),
            gaps: Arc::clone(&self.gaps),
            face: Arc::clone(&self.face),
        }
    }
}

/// What a pixel is worth in the survey over what it is worth in one pair; 1 where one of them is not known.
fn share(survey_m: Option<f64>, pair_m: Option<f64>) -> f32 {
    survey_m.zip(pair_m).map_or(1.0, |(survey_m, pair_m)| (survey_m / pair_m) as f32)
}

/// Points of the face some cells apart, between which the geometry of pairs varies little.
#[derive(Debug, Clone)]
struct Nodes {
    spacing: usize,
    columns: usize,
    points: Vec<Vector3<f64>>,
}

impl Nodes {
    /// On the cells of a grid over a face, whose elevation (metres) is the middle one where it is unknown.
    fn new(grid: Grid, elevation: &[f32]) -> Self {
        let mut known = marginal::known(elevation);
        let middle = median(&mut known).unwrap_or(0.0);
        let spacing = grid.columns.max(grid.rows).div_ceil(NODES);
        let [columns, rows] = [grid.columns, grid.rows].map(|size| (size - 1).div_ceil(spacing) + 1);
        let point = |node: usize| {
            let cell = |node: usize, size: usize| (node * spacing).min(size - 1);
            let (column, row) = (cell(node % columns, grid.columns), cell(node / columns, grid.rows));
            let (x, y) = grid.centre(row, column);
            let z = f64::from(elevation[row * grid.columns + column]);
            Vector3::new(x, y, if z.is_nan() { middle } else { z })
        };
        Self { spacing, columns, points: (0..columns * rows).map(point).collect() }
    }

    /// Bilinear between the values of the four nodes around a cell.
    fn between(&self, values: &[f32], column: usize, row: usize) -> f32 {
        let part = |at: usize, nodes: usize| {
            let low = (at / self.spacing).min(nodes - 1);
            (low, (low + 1).min(nodes - 1), (at % self.spacing) as f32 / self.spacing as f32)
        };
        let rows = self.points.len() / self.columns;
        let ((left, right, u), (top, bottom, v)) = (part(column, self.columns), part(row, rows));
        let along = |row: usize| {
            let value = |column: usize| values[row * self.columns + column];
            value(left) + u * (value(right) - value(left))
        };
        along(top) + v * (along(bottom) - along(top))
    }
}

/// Errors of disparity of a pair by place on the face; beyond the edges of the grid they go on mirrored.
#[derive(Debug, Clone)]
pub struct LearntNoise {
    grid: Grid,
    /// Errors, pixels of the depth map: smooth between the middles of the cells, so that they are the same for pixels of any size and for
    /// a surface that registration moves by a part of a cell.
    errors_px: Spline,
    /// Range of the errors.
    range_px: [f64; 2],
    /// Whether a cell is a gap.
    gaps: Arc<Vec<bool>>,
    face: Arc<Face>,
}

/// Range of the factor by which a slope makes a ray meet an error earlier or later; at ledges slopes say little.
const SLOPE_FACTOR: [f64; 2] = [0.5, 2.0];
/// Largest part of the way back to the camera that an error brings a point: stronger noise is no noise of matching.
const MOST_OF_THE_WAY: f64 = 0.9;
/// Guesses of where a ray meets the surface, before it is followed step by step.
const GUESSES: usize = 6;
/// Least fall of the height above a ray, for each part of its way, that guesses are made with.
const LEAST_SLOPE: f64 = 0.2;
/// Change of a guess that is none, cells.
const SAME_CELLS: f64 = 0.01;
/// Step along a ray that is followed, cells.
const STEP_CELLS: f64 = 0.25;
/// Steps along a ray.
const MOST_STEPS: usize = 256;

impl LearntNoise {
    /// The errors of some points of the face: those with which they come to lie where their rays meet the surface that the errors make of
    /// it. Of several such places it is the one that guesses from the point's own error settle at, or else the first on the way from the camera.
    ///
    /// `points` and `centre` (of the camera) are metres; `parallax_px` is the disparity beyond that of infinity without noise. NaN in a gap,
    /// where nothing is matched, and 0 for points that are NaN.
    // Wide registers are chosen here: as a part of each of its callers this would be compiled many times.
    #[inline(never)]
    pub fn landing_lanes(&self, points: [Lanes; 3], centre: [f64; 3], parallax_px: Lanes) -> Lanes {
        let none = |lane: usize| points[0][lane].is_nan() || parallax_px[lane].is_nan();
        let Some(first) = (0..LANES).find(|lane| !none(*lane)) else { return Lanes::all(0.0) };
        // Lanes without a point go the way of one that has one.
        let filled = |values: Lanes| Lanes::of(|lane| values[if none(lane) { first } else { lane }]);
        let [x, y, z] = points.map(filled);
        let found = vectorised(Landings { noise: self, points: [x, y, z], centre, parallax_px: filled(parallax_px) });
        Lanes::of(|lane| if none(lane) { 0.0 } else { found[lane] })
    }

    #[inline(always)]
    fn landings(&self, [x, y, z]: [Lanes; 3], centre: [f64; 3], parallax_px: Lanes) -> Lanes {
        let Grid { left_m, top_m, cell_m, .. } = self.grid;
        let start = [(x - left_m) / cell_m, (-y + top_m) / cell_m];
        let back = [(-x + centre[0]) / cell_m, (y - centre[1]) / cell_m];
        let gain = self.gain(start, back, -z + centre[2]);
        let way = Way { start, back, gain, parallax_px };
        let cells = (back[0] * back[0] + back[1] * back[1]).sqrt();
        let mut u = settled(&self.errors_px, &way, Lanes::all(SAME_CELLS) / cells);
        for lane in 0..LANES {
            if u[lane].is_nan() {
                u.set(lane, self.followed(&way.of_lane(lane), STEP_CELLS / cells[lane]));
            }
        }
        let place = way.place(u);
        let errors_px = parallax_px * u / (-u + 1.0);
        Lanes::of(|lane| {
            let gap = self.gaps[self.cell([place[0][lane], place[1][lane]])];
            if gap { f64::NAN } else { errors_px[lane] }
        })
    }

    /// Where the ray of one point first meets the surface.
    #[inline(never)]
    fn followed(&self, way: &Way<f64>, step: f64) -> f64 {
        let [lowest, highest] = self.range_px.map(|px| way.part(px));
        first_meeting(|u| way.part(self.errors_px.at(way.place(u))), highest, lowest, step)
    }

    /// How much higher a ray rises above the face than above a level one: the face falls away from it, or rises with it.
    #[inline(always)]
    fn gain(&self, start: [Lanes; 2], back: [Lanes; 2], rise_m: Lanes) -> Lanes {
        let [mut right, mut down] = [Lanes::NONE; 2];
        let columns = start[0].each().into_iter().zip(start[1].each());
        for (lane, (column, row)) in columns.enumerate() {
            let slopes = self.face.slopes[self.cell([column, row])];
            right.set(lane, f64::from(slopes[0]));
            down.set(lane, f64::from(slopes[1]));
        }
        let gain = -(right * back[0] + down * back[1]) / rise_m + 1.0;
        gain.map(|gain| if gain.is_nan() { 1.0 } else { gain.clamp(SLOPE_FACTOR[0], SLOPE_FACTOR[1]) })
    }

    /// The index of the cell at a position.
    #[inline(always)]
    fn cell(&self, [column, row]: [f64; 2]) -> usize {
        mirrored(row, self.grid.rows) * self.grid.columns + mirrored(column, self.grid.columns)
    }
}

/// [`LearntNoise::landings`] for the widest registers there are.
struct Landings<'a> {
    noise: &'a LearntNoise,
    points: [Lanes; 3],
    centre: [f64; 3],
    parallax_px: Lanes,
}

impl Work for Landings<'_> {
    type Output = Lanes;

    #[inline(always)]
    fn run(self) -> Lanes {
        self.noise.landings(self.points, self.centre, self.parallax_px)
    }
}

/// The way of a ray from its point, cells, back to the camera: u is the part of it. There an error e lifts the face to `e / (parallax + e)`,
/// divided by what the slope of the face gains on the ray.
struct Way<T> {
    start: [T; 2],
    back: [T; 2],
    gain: T,
    parallax_px: T,
}

impl<T: Number> Way<T> {
    #[inline(always)]
    fn part(&self, error_px: T) -> T {
        let whole = (self.parallax_px + error_px).at_least(self.parallax_px * 0.25);
        (error_px / whole / self.gain).at_most(MOST_OF_THE_WAY)
    }

    #[inline(always)]
    fn place(&self, u: T) -> [T; 2] {
        [self.start[0] + self.back[0] * u, self.start[1] + self.back[1] * u]
    }
}

impl Way<Lanes> {
    /// How far the surface of errors lies above the ray at a part of the way, as a part of the way.
    #[inline(always)]
    fn above(&self, errors_px: &Spline, u: Lanes) -> Lanes {
        self.part(errors_px.at_lanes(self.place(u))) - u
    }

    fn of_lane(&self, lane: usize) -> Way<f64> {
        let [start, back] = [self.start, self.back].map(|at| [at[0][lane], at[1][lane]]);
        Way { start, back, gain: self.gain[lane], parallax_px: self.parallax_px[lane] }
    }
}

/// Where rays meet the surface of errors, by secants from the height above their feet; NaN where they do not settle.
#[inline(always)]
#[allow(clippy::needless_bitwise_bool)] // branches would keep the lanes apart
fn settled(errors_px: &Spline, way: &Way<Lanes>, same: Lanes) -> Lanes {
    let mut last = [Lanes::all(0.0), way.above(errors_px, Lanes::all(0.0))];
    let (mut u, mut found) = (last[1], Lanes::NONE);
    for _ in 0..GUESSES {
        let above = way.above(errors_px, u);
        let mut all = true;
        for lane in 0..LANES {
            let settles = found[lane].is_nan() & (above[lane].abs() < same[lane]);
            found.set(lane, if settles { u[lane] + above[lane] } else { found[lane] });
            all &= !found[lane].is_nan();
        }
        if all {
            break;
        }
        let slope = (above - last[1]) / (u - last[0]);
        last = [u, above];
        // A ray rises faster than the surface where it comes out of it.
        u = u - slope.choose(|slope| slope < -LEAST_SLOPE, above / slope, -above);
    }
    found
}

/// Where a ray that comes from above first meets a surface that it may meet more than once.
fn first_meeting(surface: impl Fn(f64) -> f64, highest: f64, lowest: f64, step: f64) -> f64 {
    let step = step.max((highest - lowest) / MOST_STEPS as f64);
    let mut above = highest;
    let mut below = above - step;
    while surface(below) < below && below > lowest {
        (above, below) = (below, below - step);
    }
    // Twelve halvings of a quarter of a cell are less than any point is known to.
    for _ in 0..12 {
        let middle = 0.5 * (above + below);
        if surface(middle) < middle { above = middle } else { below = middle }
    }
    0.5 * (above + below)
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that are exact
mod tests {
    use super::*;
    use rockface_core::numerics::portable_math;

    /// Cells of a metre with one error for each column, and a slope of the face to the right.
    fn noise(values_px: &[f32], slope: f32) -> LearntNoise {
        let columns = values_px.len();
        let grid = Grid { columns, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        let values = values_px.iter().map(|px| if px.is_nan() { 0.0 } else { *px }).collect();
        LearntNoise {
            grid,
            errors_px: Spline::new(values, columns),
            range_px: [0.0, 60.0],
            gaps: Arc::new(values_px.iter().map(|px| px.is_nan()).collect()),
            face: Arc::new(Face { strength: Vec::new(), slopes: vec![[slope, 0.0]; columns], ground: None }),
        }
    }

    /// Pixels of 100 that bring a point nearer by so many of 10 m, and back.
    fn px(metres: f64) -> f32 {
        (100.0 * metres / (10.0 - metres)) as f32
    }

    fn metres(error_px: f64) -> f64 {
        10.0 * error_px / (100.0 + error_px)
    }

    /// The rise of a point, seen by a camera that is 10 m to the left of it and 10 m before the face.
    fn rise_m(noise: &LearntNoise, x: f64) -> f64 {
        let point = [x, 0.5, 0.0].map(Lanes::all);
        metres(noise.landing_lanes(point, [x - 10.0, 0.5, 10.0], Lanes::all(100.0))[5])
    }

    #[test]
    fn a_point_comes_to_lie_on_the_surface_of_the_errors() {
        // A hill of 0.8 m around 20.5, 8 m wide.
        let hill = |x: f64| 0.8 * portable_math::exp(-0.125 * (x - 20.5) * (x - 20.5));
        let noise = noise(&(0..40).map(|i| px(hill(f64::from(i) + 0.5))).collect::<Vec<_>>(), 0.0);
        for x in [10.0, 18.2, 20.5, 21.3, 23.9, 30.0] {
            let rise_m = rise_m(&noise, x);
            // The ray rises by 1 a metre to the left.
            assert!((rise_m - hill(x - rise_m)).abs() < 0.006, "{x}: {rise_m}");
        }
        let x = Lanes::of(|lane| if lane == 0 { 20.5 } else { f64::NAN });
        let all = noise.landing_lanes([x, Lanes::all(0.5), Lanes::all(0.0)], [10.5, 0.5, 10.0], Lanes::all(100.0));
        assert!((metres(all[0]) - rise_m(&noise, 20.5)).abs() < 1e-12 && all[1] == 0.0);
    }

    #[test]
    fn where_guesses_do_not_settle_a_ray_is_followed_and_gaps_match_nothing() {
        // A wall of 3 m at 20.5, steeper than the rays: those to points just behind it end on its side towards the camera.
        let wall = |x: f64| 3.0 * portable_math::exp(-(x - 20.5) * (x - 20.5));
        let noise = noise(&(0..40).map(|i| px(wall(f64::from(i) + 0.5))).collect::<Vec<_>>(), 0.0);
        for x in [20.5, 21.0, 21.5] {
            let rise_m = rise_m(&noise, x);
            let first = (0..4000).map(|i| 4.0 - 0.001 * f64::from(i)).find(|h| wall(x - h) >= *h).unwrap();
            assert!((rise_m - first).abs() < 0.1, "{x}: {rise_m} {first}");
        }
        let gap = self::noise(&(0..20).map(|i| if i == 8 { f32::NAN } else { 0.0 }).collect::<Vec<_>>(), 0.0);
        assert!(rise_m(&gap, 8.5).is_nan() && rise_m(&gap, 9.5) == 0.0);
    }

    #[test]
    fn on_a_slope_the_error_of_elevation_is_that_of_the_place_where_the_point_lands() {
        // Towards the camera the face rises by 0.3 a metre and the ray by 1: an error of a metre is met 1 / 0.7 m above the foot of the ray.
        let rise_m = rise_m(&noise(&[px(1.0); 40], -0.3), 20.5);
        assert!((rise_m - 1.0 / 0.7).abs() < 1e-5, "{rise_m}");
    }

    #[test]
    fn between_nodes_a_factor_is_exact_where_it_is_linear_and_one_where_it_is_unknown() {
        let grid = Grid { columns: 97, rows: 41, cell_m: 0.1, left_m: 0.0, top_m: 4.1 };
        let elevation: Vec<f32> = (0..97 * 41).map(|i| if i % 3 == 0 { f32::NAN } else { 2.0 }).collect();
        let nodes = Nodes::new(grid, &elevation);
        let factors: Vec<f32> =
            nodes.points.iter().map(|point| share(Some(point.x + 2.0 * point.y + point.z), Some(1.0))).collect();
        let at = |column: usize, row: usize| nodes.between(&factors, column, row);
        for (column, row) in [(0, 0), (13, 7), (95, 39), (96, 40)] {
            let (x, y) = grid.centre(row, column);
            // The last node stands at the last cell, nearer than the others: a cell before it is between them all the same.
            assert!((f64::from(at(column, row)) - (x + 2.0 * y + 2.0)).abs() < 0.3, "{column} {row}");
        }
        assert!((f64::from(at(13, 7)) - (1.35 + 2.0 * 3.35 + 2.0)).abs() < 1e-5);
        let unknown = vec![share(None, Some(2.0)); nodes.points.len()];
        assert_eq!((nodes.between(&unknown, 50, 20), share(Some(2.0), None)), (1.0, 1.0));
    }
}
