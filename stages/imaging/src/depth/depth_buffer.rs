//! Exact depths at pixel centres: the triangle each undistorted ray meets first, and where it meets its plane.
//!
//! Coverage is decided on rays in the camera frame, where edges are straight whatever the lens distortion does: ray r
//! meets triangle (A, B, C) where r . (A x B), r . (B x C) and r . (C x A) have one sign. The product of an edge shared
//! by two triangles is the same number with opposite sign, and edges are inclusive, so no ray slips between them. The
//! depth is N . A / N . r with N = (B - A) x (C - A), all in f64 (paper 2.1.2, Algorithm 2 lines 9, 11 and 12).

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::camera::model::{Camera, full_pixel};
use crate::camera::ray_row::RayRow;
use crate::depth::triangle_reach::{Bend, NEAR_M, Projected, Reach, reach, reaches};
use crate::depth::view_bounds::ViewBounds;
use rockface_core::artefact::Mesh;
use rockface_core::numerics::simd::{LANES, Work, vectorised};

/// Rows a task works on.
pub(super) const BAND: usize = 16;

/// How a mesh is drawn into a depth buffer.
#[derive(Debug, Clone, Copy)]
pub struct Drawing {
    /// Image pixels a pixel of the buffer, along each side.
    pub downscale: u32,
    /// Pixels of the full image left empty along its edges.
    pub safe_border_px: f64,
    /// Whether triangles that face away from the camera are left out.
    pub front_only: bool,
    /// Points outside x from, x to, y from, y to are left out, metres in the frame of the camera; `None`: none is.
    pub window_m: Option<[f64; 4]>,
}

/// Depths of a mesh at the pixel centres of an image reduced by the downscale.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthBuffer {
    /// Columns: those of the image divided by the downscale, rounded down.
    pub width: usize,
    /// Rows: those of the image divided by the downscale, rounded down.
    pub height: usize,
    /// Depth along the optical axis by row from the top, metres; infinite where there is none.
    pub z_m: Vec<f64>,
}

/// A triangle in the camera frame, ready for many rays.
struct Facet {
    edges: [Vector3<f64>; 3],
    normal: Vector3<f64>,
    offset: f64,
}

// Without branches several rays are tested at a time.
#[allow(clippy::needless_bitwise_bool)]
impl Facet {
    #[inline(always)]
    fn new(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Self {
        let normal = (b - a).cross(&(c - a));
        Self { edges: [a.cross(b), b.cross(c), c.cross(a)], offset: normal.dot(a), normal }
    }

    /// Whether the ray (x, y, 1) lies within the three edges, these included.
    #[inline(always)]
    fn is_met(&self, x: f64, y: f64) -> bool {
        let [e0, e1, e2] = [along(&self.edges[0], x, y), along(&self.edges[1], x, y), along(&self.edges[2], x, y)];
        ((e0 >= 0.0) & (e1 >= 0.0) & (e2 >= 0.0)) | ((e0 <= 0.0) & (e1 <= 0.0) & (e2 <= 0.0))
    }

    /// Depth at which the ray (x, y, 1) meets the triangle, edges included; infinite where it does not.
    #[inline(always)]
    fn depth(&self, x: f64, y: f64) -> f64 {
        let z = self.offset / along(&self.normal, x, y);
        if self.is_met(x, y) & (z >= NEAR_M) { z } else { f64::INFINITY }
    }

    /// Keeps the smaller depth at every ray of some columns of a row.
    #[inline(always)]
    fn keep_nearest(&self, [x, y]: [&[f64]; 2], z: &mut [f64], [first, last]: [usize; 2]) {
        let mut start = first;
        while start <= last {
            let count = (last + 1 - start).min(LANES);
            let (Some(x), Some(y), Some(z)) = (block(x, start), block(y, start), block_mut(z, start)) else {
                return self.keep_nearest_one_by_one([x, y], z, [start, last]);
            };
            let mut met = [false; LANES];
            for lane in 0..LANES {
                met[lane] = (lane < count) & self.is_met(x[lane], y[lane]);
            }
            if met.contains(&true) {
                for lane in 0..LANES {
                    let depth = self.offset / along(&self.normal, x[lane], y[lane]);
                    z[lane] = if met[lane] & (depth >= NEAR_M) & (depth < z[lane]) { depth } else { z[lane] };
                }
            }
            start += count;
        }
    }

    /// The same where the row ends within a block.
    #[inline(always)]
    fn keep_nearest_one_by_one(&self, [x, y]: [&[f64]; 2], z: &mut [f64], [first, last]: [usize; 2]) {
        for column in first..=last {
            z[column] = z[column].min(self.depth(x[column], y[column]));
        }
    }
}

/// Product of a vector and the ray (x, y, 1).
#[inline(always)]
fn along(vector: &Vector3<f64>, x: f64, y: f64) -> f64 {
    vector.x * x + vector.y * y + vector.z
}

#[inline(always)]
fn block(values: &[f64], start: usize) -> Option<&[f64; LANES]> {
    values.get(start..start + LANES)?.try_into().ok()
}

#[inline(always)]
fn block_mut(values: &mut [f64], start: usize) -> Option<&mut [f64; LANES]> {
    values.get_mut(start..start + LANES)?.try_into().ok()
}

/// Draws a mesh; its vertices must be in the frame of the camera. The same bits at any thread count.
pub fn draw(mesh: &Mesh, camera: &Camera, drawing: &Drawing) -> DepthBuffer {
    let scene = Scene::of(mesh, camera, drawing);
    let (width, height) = (scene.width, scene.height);
    let mut z_m = vec![f64::INFINITY; width * height];
    if !z_m.is_empty() {
        let bands = z_m.par_chunks_mut(BAND * width).enumerate();
        bands.for_each_init(Rays::default, |rays, (band, z)| scene.draw_band_where(band, rays, z, |_| true));
    }
    DepthBuffer { width, height, z_m }
}

/// The same depths rounded to 32 bits, NaN where there is none: a buffer in double precision of the whole image is not needed.
pub fn draw_rounded(mesh: &Mesh, camera: &Camera, drawing: &Drawing) -> Vec<f32> {
    let scene = Scene::of(mesh, camera, drawing);
    let mut depths_m = vec![f32::NAN; scene.width * scene.height];
    if !depths_m.is_empty() {
        let bands = depths_m.par_chunks_mut(BAND * scene.width).enumerate();
        bands.for_each_init(Band::default, |own, (band, depths_m)| {
            let drawn = own.draw(&scene, band, |_| true);
            depths_m.iter_mut().zip(drawn).for_each(|(depth_m, z_m)| *depth_m = rounded(*z_m));
        });
    }
    depths_m
}

/// A depth as depth maps have it: 32 bits, NaN where there is none.
#[inline]
pub fn rounded(z_m: f64) -> f32 {
    if z_m.is_finite() { z_m as f32 } else { f32::NAN }
}

/// What [`triangles`] says where nothing is seen.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// The number of the triangle each pixel of a buffer shows, drawn from the same mesh in the same way: the first of those
/// that lie exactly as near as the depth says; [`NO_TRIANGLE`] where there is none.
pub fn triangles(mesh: &Mesh, camera: &Camera, drawing: &Drawing, buffer: &DepthBuffer) -> Vec<u32> {
    let width = buffer.width;
    let mut numbers = vec![NO_TRIANGLE; buffer.z_m.len()];
    if numbers.is_empty() {
        return numbers;
    }
    let scene = Scene::of(mesh, camera, drawing);
    numbers.par_chunks_mut(BAND * width).zip(buffer.z_m.par_chunks(BAND * width)).enumerate().for_each_init(
        Rays::default,
        |rays, (band, (numbers, z))| {
            scene.find_rays(rays, band * BAND, z.len() / width);
            scene.visit_band(band, rays, |_| true, Tell { rays, z, numbers });
        },
    );
    numbers
}

/// Triangles whose reach is found by one task.
const CHUNK: usize = 1 << 16;
/// Points that follow each other in a mesh, and mostly lie near each other.
const NEIGHBOURS: usize = 256;

/// A mesh in the camera frame, its triangles sorted into bands of rows.
pub(super) struct Scene<'a> {
    camera: &'a Camera,
    drawing: &'a Drawing,
    /// Columns of the buffer.
    pub(super) width: usize,
    /// Rows of the buffer.
    pub(super) height: usize,
    triangles: &'a [[u32; 3]],
    points: Vec<Vector3<f64>>,
    chunks: Vec<Sorted>,
}

/// The triangles of a chunk that may cover pixels.
struct Sorted {
    /// Where the triangles of each band start in `reached`, and where those of the last one end.
    starts: Vec<u32>,
    reached: Vec<Reached>,
    /// Those without pixels to go by: least and largest x and y of their normalised coordinates.
    wide: Vec<(u32, [[f64; 2]; 2])>,
}

/// A triangle in one band.
#[derive(Clone, Copy, Default)]
struct Reached {
    triangle: u32,
    /// First and last column it may cover.
    columns: [u32; 2],
    /// First and last row it may cover, counted in the band.
    rows: [u8; 2],
}

/// A triangle with the columns and rows of the buffer that it may cover.
type Covering = (u32, [u32; 2], [u32; 2]);

impl Sorted {
    /// Sorts triangles into `bands` bands, each in the order that they come in.
    fn new(covering: &[Covering], wide: Vec<(u32, [[f64; 2]; 2])>, bands: usize) -> Self {
        let span = |rows: [u32; 2]| rows[0] as usize / BAND..=rows[1] as usize / BAND;
        let mut starts = vec![0; bands + 1];
        for (_, _, rows) in covering {
            span(*rows).for_each(|band| starts[band + 1] += 1);
        }
        (0..bands).for_each(|band| starts[band + 1] += starts[band]);
        let (mut next, mut reached) = (starts.clone(), vec![Reached::default(); starts[bands] as usize]);
        for (triangle, columns, rows) in covering {
            for band in span(*rows) {
                let within = |row: u32| (row as usize).clamp(band * BAND, band * BAND + BAND - 1) - band * BAND;
                reached[next[band] as usize] =
                    Reached { triangle: *triangle, columns: *columns, rows: rows.map(|row| within(row) as u8) };
                next[band] += 1;
            }
        }
        Self { starts, reached, wide }
    }

    fn of_band(&self, band: usize) -> &[Reached] {
        &self.reached[self.starts[band] as usize..self.starts[band + 1] as usize]
    }
}

/// Whether a triangle in the camera frame shows its back.
#[inline(always)]
fn faces_away([a, b, c]: [&Vector3<f64>; 3]) -> bool {
    a.dot(&b.cross(c)) >= 0.0
}

/// Finds the triangles of a chunk that may cover pixels, several at a time.
struct FindReaches<'a> {
    triangles: &'a [[u32; 3]],
    /// Number of the first of the triangles.
    first: u32,
    points: &'a [Vector3<f64>],
    projected: &'a [Projected],
    /// The planes that each point lies beyond.
    beyond: &'a [u8],
    camera: &'a Camera,
    bend: &'a Bend,
    drawing: &'a Drawing,
    size: (usize, usize),
    covering: &'a mut Vec<Covering>,
    wide: &'a mut Vec<(u32, [[f64; 2]; 2])>,
}

impl Work for FindReaches<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { triangles, first, points, projected, beyond, camera, bend, drawing, size, covering, wide } = self;
        let downscale = f64::from(drawing.downscale);
        let mut corners = [[Projected::default(); LANES]; 3];
        for (block, triangles) in triangles.chunks(LANES).enumerate() {
            let (mut simple, mut beside) = ([false; LANES], [true; LANES]);
            for (beside, [a, b, c]) in beside.iter_mut().zip(triangles) {
                *beside = beyond[*a as usize] & beyond[*b as usize] & beyond[*c as usize] != 0;
            }
            // Most triangles of a large mesh lie beside the image.
            if beside == [true; LANES] {
                continue;
            }
            for (lane, [a, b, c]) in triangles.iter().enumerate() {
                let [a, b, c] = [projected[*a as usize], projected[*b as usize], projected[*c as usize]];
                simple[lane] = a.has_pixel() && b.has_pixel() && c.has_pixel();
                (corners[0][lane], corners[1][lane], corners[2][lane]) = (a, b, c);
            }
            let found = reaches(&corners, bend, downscale, size);
            for (lane, triangle) in triangles.iter().enumerate().filter(|(lane, _)| !beside[*lane]) {
                let number = first + (block * LANES + lane) as u32;
                let simple_reach = simple[lane].then(|| found.of_lane(lane));
                if simple_reach == Some(Reach::Nothing) {
                    continue;
                }
                let [a, b, c] = triangle.map(|i| &points[i as usize]);
                if drawing.front_only && faces_away([a, b, c]) {
                    continue;
                }
                // A neighbour of points beside the image has not been projected with them.
                let reach = simple_reach.unwrap_or_else(|| reach(camera, bend, &[*a, *b, *c], downscale, size));
                match reach {
                    Reach::Nothing => {}
                    Reach::Pixels { columns, rows } => covering.push((number, columns, rows)),
                    Reach::Wide { x, y } => wide.push((number, [x, y])),
                }
            }
        }
    }
}

/// Projects points of the camera frame, but for those that lie beyond one plane around the field of view with all of their neighbours; and
/// the planes that each point lies beyond.
fn project(camera: &Camera, points: &[Vector3<f64>]) -> (Vec<Projected>, Vec<u8>) {
    let bounds = ViewBounds::of(camera);
    let beyond: Vec<u8> = points.par_iter().map(|point| bounds.beyond(point)).collect();
    let is_wanted = |neighbours: &[u8]| neighbours.iter().fold(u8::MAX, |common, beyond| common & beyond) == 0;
    let wanted: Vec<bool> = beyond.par_chunks(NEIGHBOURS).map(is_wanted).collect();
    let project = |(i, point): (usize, &Vector3<f64>)| {
        if wanted[i / NEIGHBOURS] { Projected::new(camera, point) } else { Projected::NONE }
    };
    (points.par_iter().enumerate().map(project).collect(), beyond)
}

impl<'a> Scene<'a> {
    /// The scene of a mesh before a camera.
    pub(super) fn of(mesh: &'a Mesh, camera: &'a Camera, drawing: &'a Drawing) -> Self {
        let scale = drawing.downscale as usize;
        let (width, height) = (camera.sensor().width_px as usize / scale, camera.sensor().height_px as usize / scale);
        let points: Vec<_> = mesh.vertices.par_iter().map(|v| camera.to_camera(&Vector3::from(*v))).collect();
        let bend = Bend::new(camera.sensor());
        let (projected, beyond) = project(camera, &points);
        let sort = |covering: &mut Vec<Covering>, (chunk, triangles): (usize, &[[u32; 3]])| {
            covering.clear();
            let mut wide = Vec::new();
            vectorised(FindReaches {
                triangles,
                first: (chunk * CHUNK) as u32,
                points: &points,
                projected: &projected,
                beyond: &beyond,
                camera,
                bend: &bend,
                drawing,
                size: (width, height),
                covering,
                wide: &mut wide,
            });
            Sorted::new(covering, wide, height.div_ceil(BAND))
        };
        let chunks = mesh.triangles.par_chunks(CHUNK).enumerate().map_init(Vec::new, sort).collect();
        Self { camera, drawing, width, height, triangles: &mesh.triangles, points, chunks }
    }

    /// Draws the triangles of a band for whose first and last column `wanted` holds, within the window; those that reach far are
    /// all drawn. `rays` becomes the rays of the band.
    pub(super) fn draw_band_where(
        &self,
        band: usize,
        rays: &mut Rays,
        z: &mut [f64],
        wanted: impl Fn([usize; 2]) -> bool,
    ) {
        self.find_rays(rays, band * BAND, z.len() / self.width);
        vectorised(DrawBand { scene: self, band, rays, z, wanted });
        if let Some([x0, x1, y0, y1]) = self.drawing.window_m {
            let inside = |p: Vector3<f64>| (x0..=x1).contains(&p.x) && (y0..=y1).contains(&p.y);
            for ((z, x), y) in z.iter_mut().zip(&rays.x).zip(&rays.y).filter(|((z, _), _)| z.is_finite()) {
                if !inside(self.camera.unproject([*x, *y], *z)) {
                    *z = f64::INFINITY;
                }
            }
        }
    }

    /// Rows of a band: fewer in the last one.
    fn rows_of(&self, band: usize) -> usize {
        BAND.min(self.height - band * BAND)
    }

    #[inline(always)]
    fn facet(&self, triangle: u32) -> Facet {
        let [a, b, c] = self.triangles[triangle as usize];
        Facet::new(&self.points[a as usize], &self.points[b as usize], &self.points[c as usize])
    }

    /// Shows `visitor` every triangle that may cover pixels of a band and for whose first and last column `wanted` holds, with
    /// a row of the band, and the first and last of its columns in reach.
    #[inline(always)]
    fn visit_band(&self, band: usize, rays: &Rays, wanted: impl Fn([usize; 2]) -> bool, mut visitor: impl Visit) {
        for Reached { triangle, columns, rows: [first, last] } in self.chunks.iter().flat_map(|all| all.of_band(band)) {
            let columns = columns.map(|column| column as usize);
            if wanted(columns) {
                let facet = self.facet(*triangle);
                for row in usize::from(*first)..=usize::from(*last) {
                    visitor.visit(*triangle, &facet, row, columns);
                }
            }
        }
        if self.chunks.iter().any(|chunk| !chunk.wide.is_empty()) {
            let extents: Vec<Extent> = (0..rays.rows()).map(|row| Extent::of(rays.row(row))).collect();
            for (triangle, [x, y]) in self.chunks.iter().flat_map(|chunk| &chunk.wide) {
                let facet = self.facet(*triangle);
                for row in (0..rays.rows()).filter(|row| extents[*row].meets(*x, *y)) {
                    visitor.visit(*triangle, &facet, row, [0, self.width - 1]);
                }
            }
        }
    }

    /// Makes `rays` those of every pixel of some rows.
    fn find_rays(&self, rays: &mut Rays, first_row: usize, rows: usize) {
        let Drawing { downscale, safe_border_px, .. } = *self.drawing;
        let width = self.width;
        rays.width = width;
        rays.x.resize(rows * width, f64::NAN);
        rays.y.resize(rows * width, f64::NAN);
        for (row, (x, y)) in rays.x.chunks_mut(width).zip(rays.y.chunks_mut(width)).enumerate() {
            let is_inside =
                |column: &usize| self.camera.inside(full_pixel(*column, first_row + row, downscale), safe_border_px);
            // The pixels within the border follow each other.
            let inside = (0..width)
                .find(is_inside)
                .map_or(0..0, |first| first..(first..width).rfind(is_inside).unwrap_or(first) + 1);
            for values in [&mut *x, &mut *y] {
                values[..inside.start].fill(f64::NAN);
                values[inside.end..].fill(f64::NAN);
            }
            let first = inside.start;
            RayRow::new(self.camera, first_row + row, downscale).fill(first, &mut x[inside.clone()], &mut y[inside]);
        }
    }
}

/// Undistorted normalised coordinates of the pixels of some rows; NaN where no depth is wanted.
#[derive(Default)]
pub(super) struct Rays {
    width: usize,
    x: Vec<f64>,
    y: Vec<f64>,
}

impl Rays {
    fn rows(&self) -> usize {
        self.x.len() / self.width
    }

    /// X and Y of the rays of a row.
    #[inline(always)]
    fn row(&self, row: usize) -> [&[f64]; 2] {
        let span = row * self.width..(row + 1) * self.width;
        [&self.x[span.clone()], &self.y[span]]
    }
}

/// Depths of one band and its rays, kept from band to band: a task that asked for them anew would wait for cleared memory.
#[derive(Default)]
pub(super) struct Band {
    rays: Rays,
    z_m: Vec<f64>,
}

impl Band {
    /// The depths of a band with the triangles for whose first and last column `wanted` holds; infinite where there is none.
    pub(super) fn draw(&mut self, scene: &Scene, band: usize, wanted: impl Fn([usize; 2]) -> bool) -> &[f64] {
        self.z_m.clear();
        self.z_m.resize(scene.rows_of(band) * scene.width, f64::INFINITY);
        scene.draw_band_where(band, &mut self.rays, &mut self.z_m, wanted);
        &self.z_m
    }
}

/// Draws the triangles of one band of rows into its depths.
struct DrawBand<'a, W> {
    scene: &'a Scene<'a>,
    band: usize,
    rays: &'a Rays,
    z: &'a mut [f64],
    wanted: W,
}

impl<W: Fn([usize; 2]) -> bool> Work for DrawBand<'_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { scene, band, rays, z, wanted } = self;
        scene.visit_band(band, rays, wanted, KeepNearest { rays, z });
    }
}

/// What is done with the triangles that may cover pixels of a row. Its method is inlined wherever it is called, which a closure is not: it would be
/// compiled for any processor, without the lanes of this one.
trait Visit {
    /// A triangle, its facet, the row, and the first and last column in reach.
    fn visit(&mut self, triangle: u32, facet: &Facet, row: usize, columns: [usize; 2]);
}

/// Keeps the smallest depth at each ray.
struct KeepNearest<'a> {
    rays: &'a Rays,
    z: &'a mut [f64],
}

impl Visit for KeepNearest<'_> {
    #[inline(always)]
    fn visit(&mut self, _: u32, facet: &Facet, row: usize, columns: [usize; 2]) {
        let width = self.rays.width;
        facet.keep_nearest(self.rays.row(row), &mut self.z[row * width..(row + 1) * width], columns);
    }
}

/// Writes the number of the triangle that has the depth of a pixel, the first of several.
struct Tell<'a> {
    rays: &'a Rays,
    z: &'a [f64],
    numbers: &'a mut [u32],
}

impl Visit for Tell<'_> {
    #[inline(always)]
    fn visit(&mut self, triangle: u32, facet: &Facet, row: usize, [first, last]: [usize; 2]) {
        let ([x, y], start) = (self.rays.row(row), row * self.rays.width);
        for column in first..=last {
            let (z, number) = (self.z[start + column], &mut self.numbers[start + column]);
            if z.is_finite() && facet.depth(x[column], y[column]).to_bits() == z.to_bits() {
                *number = triangle.min(*number);
            }
        }
    }
}

/// Bounding rectangle of the rays of one row, normalised coordinates.
struct Extent {
    x: [f64; 2],
    y: [f64; 2],
}

impl Extent {
    fn of([x, y]: [&[f64]; 2]) -> Self {
        // min and max pass over NaN.
        let join = |[low, high]: [f64; 2], value: &f64| [low.min(*value), high.max(*value)];
        let range = |values: &[f64]| values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], join);
        Self { x: range(x), y: range(y) }
    }

    fn meets(&self, x: [f64; 2], y: [f64; 2]) -> bool {
        self.x[0] <= x[1] && x[0] <= self.x[1] && self.y[0] <= y[1] && y[0] <= self.y[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Sensor};
    use rockface_core::testing::{height_mesh, image_at, small_sensor};

    const ALL: Drawing = Drawing { downscale: 1, safe_border_px: 0.0, front_only: true, window_m: None };

    fn bent() -> Sensor {
        Sensor { k: [-0.35, 0.2, 0.05, 0.0], p: [0.004, -0.003], b1: 0.8, b2: -0.5, f: 60.0, ..small_sensor() }
    }

    fn turned(sensor: &Sensor) -> Camera {
        Camera::new(sensor, &image_at("a", [0.3, -0.2, 20.0], [0.1, -0.15, 0.4]))
    }

    /// Depth of the ray of a pixel at the plane z = c + a x + b y.
    fn plane_depth(camera: &Camera, column: usize, row: usize, scale: u32, [c, a, b]: [f64; 3]) -> f64 {
        let d = camera.direction(camera.normalised(full_pixel(column, row, scale)).unwrap());
        let o = camera.centre();
        (c + a * o.x + b * o.y - o.z) / (d.z - a * d.x - b * d.y)
    }

    fn check_plane(camera: &Camera, squares: u32, scale: u32) {
        let mesh = height_mesh(squares, [-40.0, 40.0, -40.0, 40.0], |x, y| 1.0 + 0.2 * x - 0.1 * y);
        let buffer = draw(&mesh, camera, &Drawing { downscale: scale, ..ALL });
        for (i, z) in buffer.z_m.iter().enumerate() {
            let expected = plane_depth(camera, i % buffer.width, i / buffer.width, scale, [1.0, 0.2, -0.1]);
            assert!((z - expected).abs() < 1e-9, "pixel {i}: {z} instead of {expected}");
        }
    }

    #[test]
    fn a_plane_has_exact_depths_and_no_gap_at_any_tessellation() {
        for squares in [1, 2, 7, 100, 333] {
            check_plane(&turned(&small_sensor()), squares, 1);
            check_plane(&turned(&bent()), squares, 1);
            check_plane(&turned(&bent()), squares, 3);
        }
    }

    #[test]
    fn a_camera_straight_at_the_joints_of_a_grid_loses_no_pixel() {
        let camera = Camera::new(&small_sensor(), &image_at("a", [0.5, 0.5, 100.0], [0.0; 3]));
        let buffer = draw(&height_mesh(80, [-40.0, 40.0, -40.0, 40.0], |_, _| 0.0), &camera, &ALL);
        assert!(buffer.z_m.iter().all(|z| (z - 100.0).abs() < 1e-12));
    }

    #[test]
    fn the_nearest_of_two_surfaces_is_seen_and_backs_only_on_demand() {
        let camera = turned(&small_sensor());
        let mut mesh = height_mesh(1, [-40.0, 40.0, -40.0, 40.0], |_, _| 0.0);
        let near = height_mesh(1, [-40.0, 0.0, -40.0, 40.0], |_, _| 5.0);
        mesh.triangles.extend(near.triangles.iter().map(|t| [t[0] + 4, t[2] + 4, t[1] + 4]));
        mesh.vertices.extend(near.vertices);
        let through = draw(&mesh, &camera, &ALL);
        let blocked = draw(&mesh, &camera, &Drawing { front_only: false, ..ALL });
        let (mut far, mut close) = (0, 0);
        for (i, (through, blocked)) in through.z_m.iter().zip(&blocked.z_m).enumerate() {
            let depth = |z| plane_depth(&camera, i % 60, i / 60, 1, [z, 0.0, 0.0]);
            assert!((through - depth(0.0)).abs() < 1e-9);
            let xy = camera.normalised(full_pixel(i % 60, i / 60, 1)).unwrap();
            let left = camera.unproject(xy, depth(5.0)).x < 0.0;
            assert!((blocked - depth(if left { 5.0 } else { 0.0 })).abs() < 1e-9);
            if left { close += 1 } else { far += 1 }
        }
        assert!(far > 100 && close > 100);
    }

    #[test]
    fn triangles_that_pass_the_camera_are_seen_where_they_are_in_front() {
        let camera = Camera::new(&bent(), &image_at("a", [0.0, 2.0, 0.0], [0.0; 3]));
        // A floor at y = 0 from 30 m behind the camera to 50 m before it, in two triangles, facing up.
        let vertices = vec![[-60.0, 0.0, 30.0], [60.0, 0.0, 30.0], [60.0, 0.0, -50.0], [-60.0, 0.0, -50.0]];
        let mesh = Mesh { frame: Frame::Wall, vertices, triangles: vec![[0, 1, 2], [0, 2, 3]], colours: Vec::new() };
        let buffer = draw(&mesh, &camera, &ALL);
        let mut seen = 0;
        for (i, z) in buffer.z_m.iter().enumerate() {
            let [_, y] = camera.normalised(full_pixel(i % 60, i / 60, 1)).unwrap();
            let expected = 2.0 / y;
            if y > 0.041 {
                assert!((z - expected).abs() < 1e-9 * expected, "pixel {i}: {z} instead of {expected}");
                seen += 1;
            } else if y < 0.039 {
                assert!(z.is_infinite());
            }
        }
        assert!(seen > 500);
    }

    #[test]
    fn the_safe_border_and_surplus_pixels_stay_empty() {
        let camera = turned(&small_sensor());
        let mesh = height_mesh(1, [-40.0, 40.0, -40.0, 40.0], |_, _| 0.0);
        let buffer = draw(&mesh, &camera, &Drawing { safe_border_px: 3.0, ..ALL });
        let seen = buffer.z_m.iter().filter(|z| z.is_finite()).count();
        assert_eq!(seen, (60 - 6) * (40 - 6));
        let buffer = draw(&mesh, &camera, &Drawing { downscale: 7, ..ALL });
        assert_eq!((buffer.width, buffer.height), (8, 5));
    }

    #[test]
    fn the_bits_do_not_depend_on_the_number_of_threads() {
        let mesh = height_mesh(50, [-9.0, 9.0, -9.0, 9.0], |x, y| (x * 3.0).abs() - (y * 2.0).abs());
        let draw_with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| draw(&mesh, &turned(&bent()), &ALL))
        };
        assert_eq!(draw_with(1), draw_with(3));
    }

    #[test]
    fn every_pixel_names_a_triangle_its_ray_meets_at_its_depth() {
        let mesh = height_mesh(40, [-9.0, 9.0, -9.0, 9.0], |x, y| (x * 3.0).abs() - (y * 2.0).abs());
        for drawing in [ALL, Drawing { downscale: 3, ..ALL }, Drawing { front_only: false, ..ALL }] {
            let camera = turned(&bent());
            let buffer = draw(&mesh, &camera, &drawing);
            let found = triangles(&mesh, &camera, &drawing, &buffer);
            let mut seen = 0;
            for (i, (z, triangle)) in buffer.z_m.iter().zip(&found).enumerate() {
                assert_eq!(z.is_finite(), *triangle != NO_TRIANGLE);
                if !z.is_finite() {
                    continue;
                }
                let pixel = full_pixel(i % buffer.width, i / buffer.width, drawing.downscale);
                let point = camera.unproject(camera.normalised(pixel).unwrap(), *z);
                let [a, b, c] = mesh.triangles[*triangle as usize].map(|v| Vector3::from(mesh.vertices[v as usize]));
                let normal = (b - a).cross(&(c - a)).normalize();
                assert!((point - a).dot(&normal).abs() < 1e-9);
                let inside =
                    [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (q - p).cross(&(point - p)).dot(&normal) > -1e-9);
                assert!(inside, "pixel {i} lies outside triangle {triangle}");
                seen += 1;
            }
            assert!(seen > 50);
        }
    }
}
