//! Undistorted rays along one row of a depth map, interpolated from a few exact ones.

use crate::camera::model::{Camera, full_pixel};
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, both, vectorised};

/// Image pixels between the rays that are computed without interpolation.
const SPACING_PX: u32 = 16;
/// Fewest columns between them.
const FEWEST: usize = 4;
/// Nodes that a stretch is interpolated from: three on either side.
const THROUGH: usize = 6;
/// Nodes that are known around a stretch: those, and one more on either side, which show how much the interpolation may err.
const AROUND: usize = THROUGH + 2;
/// Largest value of `|t (t^2 - 1) (t^2 - 4) (t - 3)| / 6!` for `t` in 0 to 1, by which a sixth difference is multiplied in the error of a
/// quintic.
const OF_SIXTH_DIFFERENCE: f64 = 225.0 / 64.0 / 720.0;
/// Largest error of an interpolated ray, in pixels of the image, from which on it is refined.
const LARGEST_ERROR_PX: f64 = 1e-9;
/// Weights of one node at the columns of a stretch, of the longest, and at those that a block may reach beyond it.
type Weights = [f64; SPACING_PX as usize + LANES];

/// The nodes around a stretch of columns.
#[derive(Clone, Copy)]
struct Around {
    /// Their rays, from the third node before the start of the stretch on; NaN where there is none.
    rays: [[f64; 2]; AROUND],
    /// Whether rays that are interpolated from them need no refinement.
    suffice: bool,
}

/// Computes the rays of a row, in any columns. A ray does not depend on which other columns are computed.
///
/// Nodes some columns apart are solved without a guess. The quintic through six of them gives the rays between the middle two. Where the
/// sixth differences show that it may err by more than 1e-9 pixels (short lenses, strongly bent), a step of Newton's method refines them.
pub struct RayRow<'a> {
    camera: &'a Camera,
    downscale: u32,
    /// Distorted normalised y of the row.
    yd: f64,
    /// Columns from one node to the next.
    spacing: usize,
    /// Weights of the nodes around a stretch at its columns, over and over.
    weights: [Weights; THROUGH],
    /// Largest error of an interpolated ray that is not refined, in normalised coordinates.
    largest_error: f64,
    /// Number of the stretch of columns that `around` is for.
    stretch: Option<usize>,
    around: Around,
    /// The last node that a column of the image needs.
    last: i64,
    /// Nodes that were solved together, from the node of this number on; NaN where there is no ray.
    nodes: (i64, [Lanes; 2]),
}

impl<'a> RayRow<'a> {
    /// The rays of a row of an image reduced by `downscale`.
    pub fn new(camera: &'a Camera, row: usize, downscale: u32) -> Self {
        let spacing = ((SPACING_PX / downscale.max(1)) as usize).max(FEWEST);
        let [_, v] = full_pixel(0, row, downscale);
        let columns = camera.sensor().width_px.div_ceil(downscale.max(1)) as usize;
        let last = (columns.saturating_sub(1) / spacing + AROUND / 2) as i64;
        let weights = vectorised(AllWeights { spacing });
        let largest_error = LARGEST_ERROR_PX / camera.sensor().f.abs();
        Self {
            camera,
            downscale,
            yd: camera.distorted_y(v),
            spacing,
            weights,
            largest_error,
            stretch: None,
            around: Around { rays: [[f64::NAN; 2]; AROUND], suffice: false },
            last,
            nodes: (i64::MIN, [Lanes::NONE; 2]),
        }
    }

    /// Undistorted normalised coordinates of the centre of a pixel; `None` where the distortion has no inverse.
    pub fn ray(&mut self, column: usize) -> Option<[f64; 2]> {
        if self.camera.is_straight() {
            return self.camera.normalised_in_row(self.full_column(column as f64), self.yd, None);
        }
        let stretch = column / self.spacing;
        let around = self.around(stretch);
        let offset = column - stretch * self.spacing;
        let near = through(self.weights.each_ref().map(|weights| weights[offset]), &around);
        if around.suffice {
            return Some(near);
        }
        let guess = (!near[0].is_nan()).then_some(near);
        self.camera.normalised_in_row(self.full_column(column as f64), self.yd, guess)
    }

    /// The rays of the columns from one on, NaN where there is none, X and Y in slices of their own, which are equally long; equal to
    /// calling [`RayRow::ray`] for each.
    pub fn fill(&mut self, first: usize, x: &mut [f64], y: &mut [f64]) {
        vectorised(Fill { row: self, first, x, y });
    }

    /// The rays of at most [`LANES`] columns from one on, and the points at their depths, metres: the bits of [`Camera::unproject`].
    /// NaN where a column has no ray, points also where it has no depth. For use in wide registers.
    #[inline(always)]
    pub fn points(&mut self, first: usize, depths_m: &[f32]) -> ([Lanes; 2], [Lanes; 3]) {
        let ray = self.block(first);
        let z_m = match depths_m.first_chunk::<LANES>() {
            Some(depths_m) => Lanes::of(|lane| f64::from(depths_m[lane])),
            None => Lanes::of(|lane| depths_m.get(lane).map_or(f64::NAN, |depth_m| f64::from(*depth_m))),
        };
        (ray, self.camera.unproject_lanes(ray, z_m))
    }

    /// The rays of the [`LANES`] columns from one on, NaN where there is none. For use in wide registers.
    #[inline(always)]
    pub fn block(&mut self, first: usize) -> [Lanes; 2] {
        if self.camera.is_straight() {
            return self.camera.normalised_in_row_unguessed_lanes(self.full_columns(first), self.yd);
        }
        let (start, end) = (first / self.spacing, (first + LANES - 1) / self.spacing);
        if end <= start + 1 {
            let one = self.around(start);
            let other = if end == start { one } else { self.around(end) };
            let near = self.between_nodes(first - start * self.spacing, [&one, &other]);
            if one.suffice && other.suffice {
                return near;
            }
            if !one.suffice && !other.suffice {
                let rays = self.camera.normalised_in_row_lanes(self.full_columns(first), self.yd, near);
                if rays[0].every(|x| !x.is_nan()) {
                    return rays;
                }
            }
        }
        self.one_by_one(first)
    }

    #[cold]
    fn one_by_one(&mut self, first: usize) -> [Lanes; 2] {
        let mut rays = [Lanes::NONE; 2];
        for lane in 0..LANES {
            let [x, y] = self.ray(first + lane).unwrap_or([f64::NAN; 2]);
            rays[0].set(lane, x);
            rays[1].set(lane, y);
        }
        rays
    }

    /// The interpolated rays of the columns that are `offset` columns behind the start of their stretch; those beyond the stretch are in
    /// the next. `one` and `other` are the rays of the nodes around both.
    #[inline(always)]
    fn between_nodes(&self, offset: usize, [one, other]: [&Around; 2]) -> [Lanes; 2] {
        let [a, b, c, d, e, f] = &self.weights;
        let at = |weights: &Weights| Lanes::<LANES>::first_of(&weights[offset..]);
        let weights = [at(a), at(b), at(c), at(d), at(e), at(f)];
        let mut near = through(weights, one);
        let rest = (self.spacing - offset) as f64;
        if rest < LANES as f64 {
            let lane = Lanes::<LANES>::of(|lane| lane as f64);
            let beyond = through(weights, other);
            near = both([0, 1], |i| lane.choose(|lane| lane < rest, near[i], beyond[i]));
        }
        near
    }

    /// The nodes around a stretch.
    #[inline(always)]
    fn around(&mut self, stretch: usize) -> Around {
        if self.stretch != Some(stretch) {
            self.enter(stretch);
        }
        self.around
    }

    #[inline(never)]
    fn enter(&mut self, stretch: usize) {
        let next = self.stretch.is_some_and(|last| last + 1 == stretch);
        let first = stretch as i64 + 1 - (AROUND / 2) as i64;
        let mut rays = [[f64::NAN; 2]; AROUND];
        let mut known = 0;
        if next {
            known = AROUND - 1;
            rays[..known].copy_from_slice(&self.around.rays[1..]);
        }
        for (number, ray) in (first..).zip(&mut rays).skip(known) {
            *ray = self.node(number);
        }
        self.around = Around { rays, suffice: interpolation_error(&rays) <= self.largest_error };
        self.stretch = Some(stretch);
    }

    /// The ray of a node, which is solved together with those that follow it.
    fn node(&mut self, number: i64) -> [f64; 2] {
        if number > self.last {
            let column = self.full_column((number * self.spacing as i64) as f64);
            return self.camera.normalised_in_row(column, self.yd, None).unwrap_or([f64::NAN; 2]);
        }
        if !(0..LANES as i64).contains(&number.saturating_sub(self.nodes.0)) {
            self.nodes = (number, vectorised(Nodes { row: self, first: number }));
        }
        let lane = (number - self.nodes.0) as usize;
        self.nodes.1.map(|of| of[lane])
    }

    /// Position in the full image of a column of the row, pixels; it may lie beyond the image.
    #[inline]
    fn full_column(&self, column: f64) -> f64 {
        (column + 0.5) * f64::from(self.downscale) - 0.5
    }

    /// As [`RayRow::full_column`], of the [`LANES`] columns from one on.
    #[inline(always)]
    fn full_columns(&self, first: usize) -> Lanes {
        let lane = Lanes::<LANES>::of(|lane| lane as f64);
        (lane + first as f64 + 0.5) * f64::from(self.downscale) - 0.5
    }
}

/// Nodes of a row from one on, those that no column of the image needs left out.
struct Nodes<'r, 'c> {
    row: &'r RayRow<'c>,
    first: i64,
}

impl Work for Nodes<'_, '_> {
    type Output = [Lanes; 2];

    #[inline(always)]
    fn run(self) -> [Lanes; 2] {
        let Self { row, first } = self;
        let number = Lanes::<LANES>::of(|lane| lane as f64) + first as f64;
        let last = row.last as f64;
        let column = number.map(|number| if number > last { f64::NAN } else { number }) * row.spacing as f64;
        let full = (column + 0.5) * f64::from(row.downscale) - 0.5;
        row.camera.normalised_in_row_unguessed_lanes(full, row.yd)
    }
}

/// Rays of a row in two slices.
struct Fill<'a, 'c> {
    row: &'a mut RayRow<'c>,
    first: usize,
    x: &'a mut [f64],
    y: &'a mut [f64],
}

impl Work for Fill<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (block, (x, y)) in self.x.chunks_mut(LANES).zip(self.y.chunks_mut(LANES)).enumerate() {
            let [block_x, block_y] = self.row.block(self.first + block * LANES);
            x.copy_from_slice(&block_x.each()[..x.len()]);
            y.copy_from_slice(&block_y.each()[..y.len()]);
        }
    }
}

/// The weights of the nodes at all columns.
struct AllWeights {
    spacing: usize,
}

impl Work for AllWeights {
    type Output = [Weights; THROUGH];

    #[inline(always)]
    fn run(self) -> [Weights; THROUGH] {
        let mut weights = [[0.0; SPACING_PX as usize + LANES]; THROUGH];
        for first in (0..self.spacing).step_by(LANES) {
            let column = Lanes::<LANES>::of(|lane| (first + lane) as f64);
            let of_block = lagrange(column / self.spacing as f64);
            for (weights, of_block) in weights.iter_mut().zip(of_block) {
                weights[first..first + LANES].copy_from_slice(&of_block.each());
            }
        }
        for weights in &mut weights {
            (self.spacing..weights.len()).for_each(|column| weights[column] = weights[column - self.spacing]);
        }
        weights
    }
}

/// Weights of the values at -2 to 3 in the quintic through them at `t`.
#[inline(always)]
fn lagrange<T: Number>(t: T) -> [T; THROUGH] {
    let (a, b, c, d, e) = (t + 2.0, t + 1.0, t - 1.0, t - 2.0, t - 3.0);
    let (ab, de) = (a * b, d * e);
    let (abc, bcd) = (ab * c, b * c * d);
    [
        -(t * b * c * de) / 120.0,
        t * a * c * de / 24.0,
        -(abc * de) / 12.0,
        t * ab * de / 12.0,
        -(t * abc * e) / 24.0,
        t * a * bcd / 120.0,
    ]
}

/// The rays that the quintic through the inner nodes has where these are their weights.
#[inline(always)]
fn through<T: Number>([a, b, c, d, e, f]: [T; THROUGH], around: &Around) -> [T; 2] {
    let [_, ra, rb, rc, rd, re, rf, _] = &around.rays;
    // No closure for both axes: those are not inlined, and wide registers would be filled by narrow ones.
    let [xa, ya] = [a * ra[0], a * ra[1]];
    let [xb, yb] = [xa + b * rb[0], ya + b * rb[1]];
    let [xc, yc] = [xb + c * rc[0], yb + c * rc[1]];
    let [xd, yd] = [xc + d * rd[0], yc + d * rd[1]];
    let [xe, ye] = [xd + e * re[0], yd + e * re[1]];
    [xe + f * rf[0], ye + f * rf[1]]
}

/// Largest error of rays that are interpolated from nodes with these, in normalised coordinates: in proportion to their sixth differences,
/// of which the nodes have two. NaN where a node has no ray.
fn interpolation_error(rays: &[[f64; 2]; AROUND]) -> f64 {
    let sixth = |first: usize, axis: usize| {
        let at = |node: usize| rays[first + node][axis];
        (at(0) + at(6)) - 6.0 * (at(1) + at(5)) + 15.0 * (at(2) + at(4)) - 20.0 * at(3)
    };
    // A sum instead of the largest of the four: NaN stays NaN.
    let both_of = |axis: usize| sixth(0, axis).abs() + sixth(1, axis).abs();
    (both_of(0) + both_of(1)) * OF_SIXTH_DIFFERENCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Sensor;
    use rockface_core::testing::{image_at, small_sensor};

    #[test]
    fn a_ray_is_the_same_whatever_else_was_asked_for() {
        let sensor = Sensor { width_px: 400, k: [-0.3, 0.2, 0.0, 0.0], f: 500.0, ..small_sensor() };
        let camera = Camera::new(&sensor, &image_at("a", [0.0; 3], [0.0; 3]));
        let all: Vec<_> = (0..400).scan(RayRow::new(&camera, 5, 1), RayRow::ray).collect();
        assert_eq!(all.len(), 400);
        for column in [0, 31, 32, 200, 64, 399, 398] {
            assert_eq!(RayRow::new(&camera, 5, 1).ray(column), Some(all[column]));
        }
        for first in [0, 13] {
            let [mut x, mut y] = [[0.0; 350]; 2];
            RayRow::new(&camera, 5, 1).fill(first, &mut x, &mut y);
            let filled: Vec<_> = x.into_iter().zip(y).map(|(x, y)| [x, y]).collect();
            assert_eq!(filled, all[first..first + 350]);
        }
    }

    /// Largest distance of the rays of some rows to those that are computed without interpolation, pixels; how many stretches needed no
    /// refinement, and how many there are.
    fn error_px(sensor: &Sensor, downscale: u32) -> (f64, usize, usize) {
        let camera = Camera::new(sensor, &image_at("a", [0.0; 3], [0.0; 3]));
        let (mut error_px, mut sufficient, mut stretches) = (0.0_f64, 0, 0);
        for row in (0..(sensor.height_px / downscale) as usize).step_by(53) {
            let mut rays = RayRow::new(&camera, row, downscale);
            for column in 0..(sensor.width_px / downscale) as usize {
                let ray = rays.ray(column);
                let exact = camera.normalised(full_pixel(column, row, downscale));
                assert_eq!(ray.is_some(), exact.is_some(), "column {column} of row {row}");
                if let (Some(ray), Some(exact)) = (ray, exact) {
                    let off = (ray[0] - exact[0]).abs().max((ray[1] - exact[1]).abs());
                    error_px = error_px.max(off * sensor.f);
                }
                if column.is_multiple_of(rays.spacing) {
                    stretches += 1;
                    sufficient += usize::from(rays.around.suffice);
                }
            }
        }
        (error_px, sufficient, stretches)
    }

    #[test]
    fn rays_of_a_row_are_those_of_its_pixels() {
        let camera = |f: f64, k: [f64; 4]| Sensor {
            f,
            k,
            width_px: 1200,
            height_px: 900,
            cx: 590.0,
            cy: 460.0,
            p: [1e-3, -5e-4],
            b2: 0.4,
            ..small_sensor()
        };
        // Long, usual, short, and one whose radial polynomial folds back within the image.
        let cases = [
            (camera(9000.0, [-0.3, 0.2, 0.0, 0.0]), 1, 1.0..=1.0),
            (camera(1400.0, [-0.1, 0.05, 0.0, 0.0]), 1, 0.2..=1.0),
            (camera(1400.0, [-0.1, 0.05, 0.0, 0.0]), 8, 0.0..=0.5),
            (camera(400.0, [-0.3, 0.12, -0.02, 0.0]), 1, 0.0..=0.5),
            (camera(600.0, [-0.5, 0.0, 0.0, 0.0]), 1, 0.0..=0.5),
            (camera(600.0, [0.0; 4]), 2, 0.0..=1.0),
        ];
        for (sensor, downscale, share) in cases {
            let (error_px, sufficient, stretches) = error_px(&sensor, downscale);
            assert!(error_px < LARGEST_ERROR_PX, "{error_px} px, {sensor:?}");
            let sufficient = sufficient as f64 / stretches as f64;
            assert!(share.contains(&sufficient), "{sufficient} need no refinement, {sensor:?}");
        }
    }
}
