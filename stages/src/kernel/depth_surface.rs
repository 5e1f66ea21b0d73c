//! The surface of one depth map: its pixels as points, neighbours joined unless depth steps or the view grazes.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::artefact::{Depth, Surface};
use crate::kernel::camera::{Camera, full_pixel};
use crate::kernel::ray_row::RayRow;

/// Where neighbouring pixels are not joined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Depths differ by more than this, metres.
    Metres(f64),
    /// Depths differ by more than this many times the distance of neighbours across the view.
    Factor(f64),
}

/// When two pixels are one surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joining {
    /// Largest step in depth between neighbours; the diagonal of a square may step by its length more.
    pub step: Step,
    /// Cosine of the largest angle between a triangle's normal and the view.
    pub min_cosine: f64,
}

/// What was made and what was cut.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Joined {
    /// Triangles of the surface.
    pub triangles: usize,
    /// Triangles left out because an edge steps.
    pub steps: usize,
    /// Triangles left out because the view grazes them.
    pub grazing: usize,
}

enum Verdict {
    Kept,
    Missing,
    Steps,
    Grazing,
}

/// Joins the pixels of a depth map, which must be at least 2 x 2, inside the rectangle of those that are valid; triangles are counter-clockwise from the camera.
///
/// Each square is cut along the diagonal that steps less in depth. The same bits at any thread count.
pub fn join(depth: &Depth, joining: &Joining) -> (Surface, Joined) {
    let camera = Camera::of_depth(depth);
    let patch = Patch::of(depth);
    let origin = rounded_origin(&patch, &camera);
    let mut points = vec![[f32::NAN; 3]; patch.z.len()];
    points.par_chunks_mut(patch.width).enumerate().for_each(|(row, points)| {
        place_row(&patch, &camera, &origin, row, points);
    });
    let mut surface = Surface {
        frame: depth.frame,
        width: patch.width,
        height: patch.height,
        origin_m: origin.into(),
        points,
        squares: Vec::new(),
    };
    let joiner = Joiner { depth: &patch, surface: &surface, viewpoint: camera.centre() - origin, joining };
    let mut squares = vec![0; (patch.width - 1) * (patch.height - 1)];
    let rows = squares.par_chunks_mut(patch.width - 1).enumerate();
    let counts: Vec<Joined> = rows.map(|(row, squares)| joiner.join_row(row, squares)).collect();
    surface.squares = squares;
    let sum = |get: fn(&Joined) -> usize| counts.iter().map(get).sum();
    (surface, Joined { triangles: sum(|j| j.triangles), steps: sum(|j| j.steps), grazing: sum(|j| j.grazing) })
}

/// The rectangle of a depth map that holds its valid pixels, at least 2 x 2.
struct Patch {
    /// Principal distance, pixels of the full image.
    f: f64,
    downscale: u32,
    /// Its first column in the depth map.
    column: usize,
    /// Its first row in the depth map.
    row: usize,
    width: usize,
    height: usize,
    z: Vec<f32>,
}

impl Patch {
    fn of(depth: &Depth) -> Self {
        let (width, height) = (depth.width, depth.height);
        let (mut columns, mut rows) = ([width, 0], [height, 0]);
        for (row, values) in depth.z.chunks(width).enumerate() {
            let valid = |z: &f32| is_depth(*z);
            if let (Some(first), Some(last)) = (values.iter().position(valid), values.iter().rposition(valid)) {
                columns = [columns[0].min(first), columns[1].max(last)];
                rows = [rows[0].min(row), rows[1].max(row)];
            }
        }
        let (column, width) = span(columns, width);
        let (row, height) = span(rows, height);
        let lines = depth.z.chunks(depth.width).skip(row).take(height);
        let z = lines.flat_map(|line| &line[column..column + width]).copied().collect();
        Self { f: depth.sensor.f, downscale: depth.downscale, column, row, width, height, z }
    }
}

/// First and number of the indices from `first` to `last`, two at least, within `size`.
fn span([first, last]: [usize; 2], size: usize) -> (usize, usize) {
    let first = first.min(size - 2);
    (first, (last.max(first + 1) + 1).min(size) - first)
}

/// A point in the middle of the view, in whole metres, so that 32-bit differences from it stay exact to micrometres.
fn rounded_origin(depth: &Patch, camera: &Camera) -> Vector3<f64> {
    let (low, high) = depth
        .z
        .iter()
        .filter(|z| is_depth(**z))
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), z| (l.min(*z), h.max(*z)));
    if low > high {
        return camera.centre().map(f64::round);
    }
    let middle = full_pixel(depth.column + depth.width / 2, depth.row + depth.height / 2, depth.downscale);
    let ray = camera.normalised(middle).unwrap_or([0.0; 2]);
    camera.unproject(ray, 0.5 * (f64::from(low) + f64::from(high))).map(f64::round)
}

/// Whether a pixel has a depth: what is not finite, or behind the camera, is none.
fn is_depth(z: f32) -> bool {
    z.is_finite() && z > 0.0
}

fn place_row(depth: &Patch, camera: &Camera, origin: &Vector3<f64>, row: usize, points: &mut [[f32; 3]]) {
    let mut rays = RayRow::new(camera, depth.row + row, depth.downscale);
    for (column, point) in points.iter_mut().enumerate() {
        let z = depth.z[row * depth.width + column];
        if !is_depth(z) {
            continue;
        }
        if let Some(ray) = rays.ray(depth.column + column) {
            let local = camera.unproject(ray, f64::from(z)) - origin;
            *point = [local.x as f32, local.y as f32, local.z as f32];
        }
    }
}

struct Joiner<'a> {
    depth: &'a Patch,
    surface: &'a Surface,
    /// Projection centre relative to the origin of the points.
    viewpoint: Vector3<f64>,
    joining: &'a Joining,
}

impl Joiner<'_> {
    fn join_row(&self, row: usize, squares: &mut [u8]) -> Joined {
        let mut joined = Joined::default();
        for (column, byte) in squares.iter_mut().enumerate() {
            *byte = self.diagonal(row, column);
            let corners = Surface::corners(self.depth.width, row, column, *byte);
            for (corners, bit) in corners.into_iter().zip([Surface::FIRST, Surface::SECOND]) {
                match self.judge(corners) {
                    Verdict::Kept => {
                        *byte |= bit;
                        joined.triangles += 1;
                    }
                    Verdict::Missing => {}
                    Verdict::Steps => joined.steps += 1,
                    Verdict::Grazing => joined.grazing += 1,
                }
            }
        }
        joined
    }

    /// The diagonal that steps less, or the one that leaves a triangle where a corner is missing.
    fn diagonal(&self, row: usize, column: usize) -> u8 {
        let a = row * self.depth.width + column;
        let (b, c, d) = (a + 1, a + self.depth.width + 1, a + self.depth.width);
        let step = |i: usize, j: usize| {
            let (a, b) = (self.depth.z[i], self.depth.z[j]);
            if is_depth(a) && is_depth(b) { (a - b).abs() } else { f32::INFINITY }
        };
        if step(b, d) < step(a, c) { Surface::OTHER_DIAGONAL } else { 0 }
    }

    fn judge(&self, corners: [usize; 3]) -> Verdict {
        let local = corners.map(|i| Vector3::from(self.surface.points[i]).map(f64::from));
        if local.iter().any(|p| p.x.is_nan()) {
            return Verdict::Missing;
        }
        if [(0, 1), (1, 2), (2, 0)].into_iter().any(|(i, j)| self.steps(corners[i], corners[j])) {
            return Verdict::Steps;
        }
        let normal = (local[1] - local[0]).cross(&(local[2] - local[0]));
        let view = self.viewpoint - (local[0] + local[1] + local[2]) / 3.0;
        let grazes = normal.dot(&view) < self.joining.min_cosine * normal.norm() * view.norm();
        if grazes { Verdict::Grazing } else { Verdict::Kept }
    }

    fn steps(&self, i: usize, j: usize) -> bool {
        let (depth, width) = (self.depth, self.depth.width);
        let (a, b) = (f64::from(depth.z[i]), f64::from(depth.z[j]));
        let across = i / width != j / width && i % width != j % width;
        let pixels = if across { std::f64::consts::SQRT_2 } else { 1.0 };
        let allowed = match self.joining.step {
            Step::Metres(metres) => metres,
            Step::Factor(factor) => factor * a.min(b) / depth.f * f64::from(depth.downscale),
        };
        (a - b).abs() > allowed * pixels
    }
}
