//! Undistorted rays along one row of a depth map, interpolated from a few exact ones.

use crate::camera::model::{Camera, full_pixel};
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, both, vectorised};

/// Image pixels between the rays that are computed without interpolation.
const SPACING_PX: u32 = 32;
/// Fewest columns between them.
const FEWEST: usize = 4;
/// Weights of one node at the columns of a stretch, of the longest, and at those that a block may reach beyond it.
type Weights = [f64; SPACING_PX as usize + LANES];

/// Computes the rays of a row, in any columns. A ray does not depend on which other columns are computed.
///
/// Nodes some columns apart are solved without a guess. The cubic through four nodes gives the rays between them to about
/// 1e-10, and one step of Newton's method refines them.
pub struct RayRow<'a> {
    camera: &'a Camera,
    downscale: u32,
    /// Distorted normalised y of the row.
    yd: f64,
    /// Columns from one node to the next.
    spacing: usize,
    /// Weights of the nodes around a stretch at its columns, over and over.
    weights: [Weights; 4],
    /// Number of the stretch of columns that `around` is for.
    stretch: Option<usize>,
    /// Rays one stretch before its start, at its start, at its end and one stretch beyond.
    around: [Option<[f64; 2]>; 4],
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
        let last = (columns.saturating_sub(1) / spacing + 2) as i64;
        let nodes = (i64::MIN, [Lanes::NONE; 2]);
        let weights = vectorised(AllWeights { spacing });
        let yd = camera.distorted_y(v);
        Self { camera, downscale, yd, spacing, weights, stretch: None, around: [None; 4], last, nodes }
    }

    /// Undistorted normalised coordinates of the centre of a pixel; `None` where the distortion has no inverse.
    #[inline]
    pub fn ray(&mut self, column: usize) -> Option<[f64; 2]> {
        let stretch = column / self.spacing;
        if self.stretch != Some(stretch) {
            self.enter(stretch);
        }
        let guess = if let [Some(a), Some(b), Some(c), Some(d)] = self.around {
            let [wa, wb, wc, wd] = [0, 1, 2, 3].map(|node| self.weights[node][column - stretch * self.spacing]);
            Some([0, 1].map(|i| wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]))
        } else {
            None
        };
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
        let (start, end) = (first / self.spacing, (first + LANES - 1) / self.spacing);
        if end <= start + 1 {
            let one = self.around(start);
            let other = if end == start { one } else { self.around(end) };
            if let (Some(one), Some(other)) = (one, other) {
                let rays = self.between_nodes(first, first - start * self.spacing, [one, other]);
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

    /// The rays of the columns from `first` on, which is `offset` columns behind the start of its stretch; those beyond the stretch are
    /// in the next. `one` and `other` are the rays of the nodes around both.
    #[inline(always)]
    fn between_nodes(&self, first: usize, offset: usize, [one, other]: [[[f64; 2]; 4]; 2]) -> [Lanes; 2] {
        let lane = Lanes::<LANES>::of(|lane| lane as f64);
        let [wa, wb, wc, wd] = &self.weights;
        let at = |weights: &Weights| Lanes::<LANES>::first_of(&weights[offset..]);
        let (wa, wb, wc, wd) = (at(wa), at(wb), at(wc), at(wd));
        let guess = |[a, b, c, d]: [[f64; 2]; 4]| both([0, 1], |i| wa * a[i] + wb * b[i] + wc * c[i] + wd * d[i]);
        let mut near = guess(one);
        let rest = (self.spacing - offset) as f64;
        if rest < LANES as f64 {
            let beyond = guess(other);
            near = both([0, 1], |i| lane.choose(|lane| lane < rest, near[i], beyond[i]));
        }
        let full = (lane + first as f64 + 0.5) * f64::from(self.downscale) - 0.5;
        self.camera.normalised_in_row_lanes(full, self.yd, near)
    }

    /// The rays of the nodes around a stretch; `None` where one of them has none.
    #[inline(always)]
    fn around(&mut self, stretch: usize) -> Option<[[f64; 2]; 4]> {
        if self.stretch != Some(stretch) {
            self.enter(stretch);
        }
        let [Some(a), Some(b), Some(c), Some(d)] = self.around else { return None };
        Some([a, b, c, d])
    }

    #[inline(never)]
    fn enter(&mut self, stretch: usize) {
        let known = self.stretch.is_some_and(|last| last + 1 == stretch);
        let [_, b, c, d] = self.around;
        let mut node = |step: i64| self.node(stretch as i64 + step);
        self.around = if known { [b, c, d, node(2)] } else { [node(-1), node(0), node(1), node(2)] };
        self.stretch = Some(stretch);
    }

    /// The ray of a node, which is solved together with those that follow it.
    fn node(&mut self, number: i64) -> Option<[f64; 2]> {
        if number > self.last {
            return self.camera.normalised_in_row(
                self.full_column((number * self.spacing as i64) as f64),
                self.yd,
                None,
            );
        }
        if !(0..LANES as i64).contains(&number.saturating_sub(self.nodes.0)) {
            self.nodes = (number, vectorised(Nodes { row: self, first: number }));
        }
        let lane = (number - self.nodes.0) as usize;
        let ray = self.nodes.1.map(|of| of[lane]);
        (!ray[0].is_nan()).then_some(ray)
    }

    /// Position in the full image of a column of the row, pixels; it may lie beyond the image.
    #[inline]
    fn full_column(&self, column: f64) -> f64 {
        (column + 0.5) * f64::from(self.downscale) - 0.5
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
    type Output = [Weights; 4];

    #[inline(always)]
    fn run(self) -> [Weights; 4] {
        let mut weights = [[0.0; SPACING_PX as usize + LANES]; 4];
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

/// Weights of the values at -1, 0, 1 and 2 in the cubic through them at `t`.
#[inline(always)]
fn lagrange<T: Number>(t: T) -> [T; 4] {
    let (before, after, beyond) = (t + 1.0, t - 1.0, t - 2.0);
    [-t * after * beyond / 6.0, before * after * beyond / 2.0, -before * t * beyond / 2.0, before * t * after / 6.0]
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

    #[test]
    fn rays_of_a_row_are_those_of_its_pixels() {
        let sensor = Sensor { k: [-0.3, 0.2, 0.0, 0.0], p: [0.01, 0.0], b2: 0.4, ..small_sensor() };
        let camera = Camera::new(&sensor, &image_at("a", [0.0; 3], [0.0; 3]));
        let mut row = RayRow::new(&camera, 3, 2);
        for column in (0..30).filter(|column| column % 7 != 2) {
            let [x, y] = row.ray(column).unwrap();
            let [ex, ey] = camera.normalised(full_pixel(column, 3, 2)).unwrap();
            assert!((x - ex).abs() < 1e-15 && (y - ey).abs() < 1e-15);
        }
    }
}
