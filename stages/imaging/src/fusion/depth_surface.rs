//! The surface of one depth map: its pixels as points, neighbours joined unless depth steps or the view grazes.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::camera::model::{Camera, full_pixel};
use crate::camera::ray_row::RayRow;
use rockface_core::artefact::{Depth, Surface};
use rockface_core::numerics::simd::{LANES, Lanes, Work, vectorised};
use rockface_raster::point_rows::PointRows;

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

/// How many triangles a depth map gave, and why others were left out.
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

/// Joins the valid pixels of a depth map of at least 2 x 2 pixels to triangles, counter-clockwise seen from the camera.
///
/// Each square is cut along the diagonal with the smaller step in depth. The bits do not depend on the number of threads.
pub fn join(depth: &Depth, joining: &Joining) -> (Surface, Joined) {
    let camera = Camera::of_depth(depth);
    let patch = Patch::of(depth);
    let origin = rounded_origin(&patch, &camera);
    // Filled by all threads: the first touch of so much memory would take one thread as long as placing the points.
    let mut points: Vec<[f32; 3]> = (0..patch.width * patch.height).into_par_iter().map(|_| [0.0; 3]).collect();
    let empty = || [(); 3].map(|()| vec![[0.0f32; LANES]; patch.width.div_ceil(LANES)]);
    points.par_chunks_mut(patch.width).enumerate().for_each_init(empty, |placed, (row, points)| {
        let rays = RayRow::new(&camera, patch.row + row, depth.downscale);
        vectorised(PlaceRow { depths_m: patch.line(row), rays, column: patch.column, origin: &origin, placed, points });
    });
    let mut surface = Surface {
        frame: depth.frame,
        width: patch.width,
        height: patch.height,
        origin_m: origin.into(),
        points,
        squares: Vec::new(),
    };
    let joiner = Joiner { patch: &patch, surface: &surface, viewpoint: camera.centre() - origin, joining };
    let mut squares = vec![0; (patch.width - 1) * (patch.height - 1)];
    let rows = squares.par_chunks_mut(patch.width - 1).enumerate();
    let join_row = |judging: &mut Judging, (row, squares): (usize, &mut [u8])| joiner.join_row(judging, row, squares);
    let counts: Vec<Joined> = rows.map_init(Judging::default, join_row).collect();
    surface.squares = squares;
    let sum = |get: fn(&Joined) -> usize| counts.iter().map(get).sum();
    (surface, Joined { triangles: sum(|j| j.triangles), steps: sum(|j| j.steps), grazing: sum(|j| j.grazing) })
}

/// The rectangle of a depth map that holds its valid pixels, at least 2 x 2.
struct Patch<'a> {
    depth: &'a Depth,
    /// Its first column in the depth map.
    column: usize,
    /// Its first row in the depth map.
    row: usize,
    width: usize,
    height: usize,
}

impl<'a> Patch<'a> {
    fn of(depth: &'a Depth) -> Self {
        let (width, height) = (depth.width, depth.height);
        let (mut columns, mut rows) = ([width, 0], [height, 0]);
        for (row, values) in depth.z.chunks(width).enumerate() {
            let valid = |z: &f32| Depth::is_seen(*z);
            if let (Some(first), Some(last)) = (values.iter().position(valid), values.iter().rposition(valid)) {
                columns = [columns[0].min(first), columns[1].max(last)];
                rows = [rows[0].min(row), rows[1].max(row)];
            }
        }
        let (column, width) = span(columns, width);
        let (row, height) = span(rows, height);
        Self { depth, column, row, width, height }
    }

    /// The depths of one of its rows, metres.
    #[inline]
    fn line(&self, row: usize) -> &'a [f32] {
        let start = (self.row + row) * self.depth.width + self.column;
        &self.depth.z[start..start + self.width]
    }
}

/// First and number of the indices from `first` to `last`, two at least, within `size`.
fn span([first, last]: [usize; 2], size: usize) -> (usize, usize) {
    let first = first.min(size - 2);
    (first, (last.max(first + 1) + 1).min(size) - first)
}

/// A point in the middle of the view, in whole metres, so that 32-bit differences from it stay exact to micrometres.
fn rounded_origin(patch: &Patch, camera: &Camera) -> Vector3<f64> {
    let rows = (0..patch.height).into_par_iter().map(|row| vectorised(Ends(patch.line(row))));
    let [low, high] = rows.reduce(|| Ends::NONE, Ends::join);
    if low > high {
        return camera.centre().map(f64::round);
    }
    let middle = full_pixel(patch.column + patch.width / 2, patch.row + patch.height / 2, patch.depth.downscale);
    let ray = camera.normalised(middle).unwrap_or([0.0; 2]);
    camera.unproject(ray, 0.5 * (f64::from(low) + f64::from(high))).map(f64::round)
}

/// Depths that are looked at together for their ends.
const ENDS_WIDTH: usize = 16;

/// Finds the smallest and the largest depth of a row; the bits are those of any order.
struct Ends<'a>(&'a [f32]);

impl Ends<'_> {
    /// The ends of no depth at all.
    const NONE: [f32; 2] = [f32::INFINITY, 0.0];

    fn join(one: [f32; 2], other: [f32; 2]) -> [f32; 2] {
        [one[0].min(other[0]), one[1].max(other[1])]
    }
}

impl Work for Ends<'_> {
    type Output = [f32; 2];

    #[inline(always)]
    #[allow(clippy::needless_bitwise_bool)] // branches would keep the depths apart
    fn run(self) -> [f32; 2] {
        let (chunks, rest) = self.0.as_chunks::<ENDS_WIDTH>();
        let (mut low, mut high) = ([Self::NONE[0]; ENDS_WIDTH], [Self::NONE[1]; ENDS_WIDTH]);
        for depths_m in chunks {
            for lane in 0..ENDS_WIDTH {
                let depth_m = depths_m[lane];
                low[lane] = if (depth_m > 0.0) & (depth_m < low[lane]) { depth_m } else { low[lane] };
                high[lane] = if (depth_m < f32::INFINITY) & (depth_m > high[lane]) { depth_m } else { high[lane] };
            }
        }
        let of_lanes = low.into_iter().zip(high).map(|(low, high)| [low, high]);
        let of_rest = rest.iter().filter(|depth_m| Depth::is_seen(**depth_m)).map(|depth_m| [*depth_m; 2]);
        of_lanes.chain(of_rest).fold(Self::NONE, Self::join)
    }
}

/// Places the points of a row of the patch; those without a depth or a ray are NaN.
struct PlaceRow<'a> {
    depths_m: &'a [f32],
    rays: RayRow<'a>,
    /// Column of the first pixel in the depth map.
    column: usize,
    origin: &'a Vector3<f64>,
    /// Room for X, Y and Z of the points, in whole blocks.
    placed: &'a mut [Vec<[f32; LANES]>; 3],
    points: &'a mut [[f32; 3]],
}

impl Work for PlaceRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        let [x_m, y_m, z_m] = self.placed;
        for (block, depths_m) in self.depths_m.chunks(LANES).enumerate() {
            let (ray, [x, y, z]) = self.rays.points(self.column + block * LANES, depths_m);
            let depth_m: Lanes = Lanes::of(|lane| f64::from(*depths_m.get(lane).unwrap_or(&f32::NAN)));
            // Neither infinite nor without a ray.
            let seen = depth_m.where_below(depth_m + ray[0], f64::INFINITY);
            // Axis by axis: what is indexed by a loop goes through memory, one number at a time.
            x_m[block] = (x - self.origin.x).where_positive(seen).narrowed();
            y_m[block] = (y - self.origin.y).where_positive(seen).narrowed();
            z_m[block] = (z - self.origin.z).where_positive(seen).narrowed();
        }
        let count = self.points.len();
        let (x_m, y_m, z_m) =
            (&x_m.as_flattened()[..count], &y_m.as_flattened()[..count], &z_m.as_flattened()[..count]);
        for (i, point) in self.points.iter_mut().enumerate() {
            *point = [x_m[i], y_m[i], z_m[i]];
        }
    }
}

struct Joiner<'a> {
    patch: &'a Patch<'a>,
    surface: &'a Surface,
    /// Projection centre relative to the origin of the points.
    viewpoint: Vector3<f64>,
    joining: &'a Joining,
}

impl Joiner<'_> {
    fn join_row(&self, judging: &mut Judging, row: usize, squares: &mut [u8]) -> Joined {
        judging.judge(self, row, squares);
        let mut joined = Joined::default();
        // Most rows; no branch for each of their squares.
        if !squares.contains(&0) {
            joined.triangles = 2 * squares.len();
            return joined;
        }
        for (column, byte) in squares.iter_mut().enumerate() {
            if *byte != 0 {
                joined.triangles += 2;
                continue;
            }
            let square = self.square(row, column);
            *byte = square.diagonal();
            let (triangles, steps) = (square.triangles(*byte == 0), self.steps(&square, *byte == 0));
            for ((corners, steps), bit) in triangles.iter().zip(steps).zip([Surface::FIRST, Surface::SECOND]) {
                match self.judge(corners, steps) {
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

    #[inline]
    fn square(&self, row: usize, column: usize) -> Square {
        let width = self.patch.width;
        let (upper, lower) = (row * width + column, (row + 1) * width + column);
        let points = &self.surface.points;
        let [z_above, z_below] = [row, row + 1].map(|row| &self.patch.line(row)[column..column + 2]);
        let (above, below) = (&points[upper..upper + 2], &points[lower..lower + 2]);
        let point = |p: &[f32; 3]| Vector3::from(*p).map(f64::from);
        Square {
            z: [z_above[0], z_above[1], z_below[1], z_below[0]],
            points: [point(&above[0]), point(&above[1]), point(&below[1]), point(&below[0])],
        }
    }

    #[inline]
    fn judge(&self, corners: &[Vector3<f64>; 3], steps: bool) -> Verdict {
        if corners.iter().any(|p| p.x.is_nan()) {
            return Verdict::Missing;
        }
        if steps {
            return Verdict::Steps;
        }
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        let sum = corners[0] + corners[1] + corners[2];
        let view = self.viewpoint - sum / 3.0;
        let grazes = normal.dot(&view) < self.joining.min_cosine * normal.norm() * view.norm();
        if grazes { Verdict::Grazing } else { Verdict::Kept }
    }

    /// Whether an edge steps, of the two triangles in their order.
    #[inline]
    fn steps(&self, square: &Square, along_ac: bool) -> [bool; 2] {
        let [a, b, c, d] = square.z.map(f64::from);
        let (low, high) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        // Most squares: no two corners differ by more than the limit of the nearest ones. A comparison with NaN is false.
        if !square.z.iter().any(|z| z.is_nan()) && high - low <= self.allowed_m(low) {
            return [false; 2];
        }
        let side = |z, other| self.edge_steps(z, other, 1.0);
        let diagonal = if along_ac { (a, c) } else { (b, d) };
        let [top, right, bottom, left] = [side(a, b), side(b, c), side(c, d), side(d, a)];
        let across = self.edge_steps(diagonal.0, diagonal.1, std::f64::consts::SQRT_2);
        let first = left || across || if along_ac { bottom } else { top };
        let second = right || across || if along_ac { top } else { bottom };
        [first, second]
    }

    fn edge_steps(&self, a: f64, b: f64, pixels: f64) -> bool {
        (a - b).abs() > self.allowed_m(a.min(b)) * pixels
    }

    /// The largest step between neighbours, the nearer of them at a depth; it grows with depth.
    #[inline]
    fn allowed_m(&self, z_m: f64) -> f64 {
        match self.joining.step {
            Step::Metres(metres) => metres,
            Step::Factor(factor) => {
                let depth = self.patch.depth;
                factor * z_m / depth.sensor.f * f64::from(depth.downscale)
            }
        }
    }
}

/// What one thread needs to find the squares of a row that are clearly whole.
#[derive(Default)]
struct Judging {
    rows: PointRows,
}

impl Judging {
    /// Sets the byte of each square with two triangles that no limit comes near, and 0 for all others.
    fn judge(&mut self, joiner: &Joiner, row: usize, squares: &mut [u8]) {
        self.rows.enter(&joiner.surface.points, joiner.patch.width, row);
        // The limit grows with depth: slope and value at depth 0. The margin is larger than any rounding.
        let allowed_m =
            [joiner.allowed_m(1.0) - joiner.allowed_m(0.0), joiner.allowed_m(0.0)].map(|m| m * (1.0 - 1e-9));
        let least = joiner.joining.min_cosine * joiner.joining.min_cosine * (1.0 + 1e-9);
        let z = [row, row + 1].map(|row| joiner.patch.line(row));
        let viewpoint = (joiner.viewpoint * 3.0).into();
        vectorised(Judge { rows: &self.rows, z, viewpoint, allowed_m, least, squares });
    }
}

struct Judge<'a> {
    rows: &'a PointRows,
    /// Depths above and below.
    z: [&'a [f32]; 2],
    /// Three times the projection centre, relative to the origin of the points.
    viewpoint: [f64; 3],
    /// How much the allowed step grows with depth, and what it is at depth 0.
    allowed_m: [f64; 2],
    /// Square of the least cosine between normal and view.
    least: f64,
    squares: &'a mut [u8],
}

impl Work for Judge<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let count = self.squares.len();
        let squares = &mut self.squares[..count];
        let [[ax, ay, az], [bx, by, bz], [cx, cy, cz], [dx, dy, dz]] =
            self.rows.corners().map(|corner| corner.map(|values| &values[..count]));
        let [za, zb] = [&self.z[0][..count], &self.z[0][1..=count]];
        let [zd, zc] = [&self.z[1][..count], &self.z[1][1..=count]];
        for i in 0..count {
            let (a, b) = ([ax[i], ay[i], az[i]], [bx[i], by[i], bz[i]]);
            let (c, d) = ([cx[i], cy[i], cz[i]], [dx[i], dy[i], dz[i]]);
            let other = (zb[i] - zd[i]).abs() < (za[i] - zc[i]).abs();
            let low = f64::from(za[i].min(zb[i]).min(zc[i].min(zd[i])));
            let high = f64::from(za[i].max(zb[i]).max(zc[i].max(zd[i])));
            // Minimum and maximum skip what is no number, but no point is there then, and no angle is clear.
            let steady = high - low <= self.allowed_m[0] * low + self.allowed_m[1] && low > 0.0;
            let first = faces_clearly([a, d, if other { b } else { c }], self.viewpoint, self.least);
            let second = faces_clearly([if other { d } else { a }, c, b], self.viewpoint, self.least);
            let cut = if other { Surface::OTHER_DIAGONAL } else { 0 };
            let whole = Surface::FIRST | Surface::SECOND | cut;
            squares[i] = if steady & first & second { whole } else { 0 };
        }
    }
}

/// Whether the normal of a triangle is clearly within the limit; `viewpoint` is three times that place.
#[inline(always)]
fn faces_clearly([p, q, r]: [[f64; 3]; 3], viewpoint: [f64; 3], least: f64) -> bool {
    let (u, v) = ([q[0] - p[0], q[1] - p[1], q[2] - p[2]], [r[0] - p[0], r[1] - p[1], r[2] - p[2]]);
    let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let view = [0, 1, 2].map(|i: usize| viewpoint[i] - (p[i] + q[i] + r[i]));
    let along = normal[0] * view[0] + normal[1] * view[1] + normal[2] * view[2];
    let normal = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    let view = view[0] * view[0] + view[1] * view[1] + view[2] * view[2];
    along > 0.0 && along * along > least * normal * view
}

/// Four neighbours: corners a, b, c and d in the order of [`Surface`].
struct Square {
    /// Depths at the corners, metres.
    z: [f32; 4],
    /// Points relative to the origin of the surface, metres.
    points: [Vector3<f64>; 4],
}

impl Square {
    /// The diagonal that steps less, or the one that leaves a triangle where a corner is missing.
    #[inline]
    fn diagonal(&self) -> u8 {
        let step = |a: f32, b: f32| if Depth::is_seen(a) && Depth::is_seen(b) { (a - b).abs() } else { f32::INFINITY };
        let [a, b, c, d] = self.z;
        if step(b, d) < step(a, c) { Surface::OTHER_DIAGONAL } else { 0 }
    }

    /// The corners of both triangles, as [`Surface::corners`] orders them.
    #[inline]
    fn triangles(&self, along_ac: bool) -> [[Vector3<f64>; 3]; 2] {
        let [a, b, c, d] = self.points;
        if along_ac { [[a, d, c], [a, c, b]] } else { [[a, d, b], [b, d, c]] }
    }
}
