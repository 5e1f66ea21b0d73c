//! Exact depths at pixel centres: the triangle each undistorted ray meets first, and where it meets its plane.
//!
//! Coverage is decided on rays in the camera frame, where edges are straight whatever the lens distortion does: ray r
//! meets triangle (A, B, C) where r . (A x B), r . (B x C) and r . (C x A) have one sign. The product of an edge shared
//! by two triangles is the same number with opposite sign, and edges are inclusive, so no ray slips between them. The
//! depth is N . A / N . r with N = (B - A) x (C - A), all in f64 (paper 2.1.2, Algorithm 2 lines 9, 11 and 12).

use std::ops::RangeInclusive;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::camera::model::{Camera, full_pixel};
use crate::camera::ray_row::RayRow;
use crate::depth::triangle_reach::{Bend, NEAR_M, Projected, Reach, reach_of_projected};
use rockface_core::artefact::Mesh;

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
}

/// Depths of a mesh at the pixel centres of an image reduced by the downscale.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthBuffer {
    /// Columns: those of the image divided by the downscale, rounded down.
    pub width: usize,
    /// Rows, likewise.
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

impl Facet {
    fn new(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Self {
        let normal = (b - a).cross(&(c - a));
        Self { edges: [a.cross(b), b.cross(c), c.cross(a)], offset: normal.dot(a), normal }
    }

    /// Depth at which the ray (x, y, 1) meets the triangle, edges included; infinite where it does not.
    fn depth(&self, ray: &Vector3<f64>) -> f64 {
        let [e0, e1, e2] = [self.edges[0].dot(ray), self.edges[1].dot(ray), self.edges[2].dot(ray)];
        let inside = (e0 >= 0.0 && e1 >= 0.0 && e2 >= 0.0) || (e0 <= 0.0 && e1 <= 0.0 && e2 <= 0.0);
        if !inside {
            return f64::INFINITY;
        }
        let z = self.offset / self.normal.dot(ray);
        if z >= NEAR_M { z } else { f64::INFINITY }
    }
}

/// Draws a mesh; its vertices must be in the frame of the camera. The same bits at any thread count.
pub fn draw(mesh: &Mesh, camera: &Camera, drawing: &Drawing) -> DepthBuffer {
    let scene = Scene::of(mesh, camera, drawing);
    let (width, height) = (scene.width, scene.height);
    let mut z_m = vec![f64::INFINITY; width * height];
    if !z_m.is_empty() {
        let bands = z_m.par_chunks_mut(BAND * width).enumerate();
        bands.for_each(|(band, z)| scene.draw_band_where(band, z, |_| true));
    }
    DepthBuffer { width, height, z_m }
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
    numbers.par_chunks_mut(BAND * width).zip(buffer.z_m.par_chunks(BAND * width)).enumerate().for_each(
        |(band, (numbers, z))| {
            scene.visit_band(
                band,
                z.len() / width,
                |_| true,
                |triangle, facet, rays, span| {
                    for ((ray, z), number) in rays.iter().zip(&z[span.clone()]).zip(&mut numbers[span]) {
                        let free = *number == NO_TRIANGLE && z.is_finite();
                        if free && facet.depth(&Vector3::new(ray[0], ray[1], 1.0)).to_bits() == z.to_bits() {
                            *number = triangle;
                        }
                    }
                },
            );
        },
    );
    numbers
}

impl DepthBuffer {
    /// Empties the pixels whose points lie outside x from, x to, y from, y to, metres in the frame of the camera.
    pub fn keep_window(&mut self, camera: &Camera, downscale: u32, [x0, x1, y0, y1]: [f64; 4]) {
        let inside = |p: Vector3<f64>| (x0..=x1).contains(&p.x) && (y0..=y1).contains(&p.y);
        self.z_m.par_chunks_mut(self.width).enumerate().for_each(|(row, values)| {
            let mut rays = RayRow::new(camera, row, downscale);
            for (column, z) in values.iter_mut().enumerate().filter(|(_, z)| z.is_finite()) {
                if !rays.ray(column).is_some_and(|ray| inside(camera.unproject(ray, *z))) {
                    *z = f64::INFINITY;
                }
            }
        });
    }
}

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
    reaches: Vec<Reach>,
    bands: Vec<Vec<u32>>,
}

impl<'a> Scene<'a> {
    /// The scene of a mesh before a camera.
    pub(super) fn of(mesh: &'a Mesh, camera: &'a Camera, drawing: &'a Drawing) -> Self {
        let scale = drawing.downscale as usize;
        let (width, height) = (camera.sensor().width_px as usize / scale, camera.sensor().height_px as usize / scale);
        let points: Vec<_> = mesh.vertices.par_iter().map(|v| camera.to_camera(&Vector3::from(*v))).collect();
        let bend = Bend::new(camera.sensor());
        let projected: Vec<_> = points.par_iter().map(|point| Projected::new(camera, point)).collect();
        let find = |triangle: &[u32; 3]| {
            let corners = triangle.map(|i| points[i as usize]);
            let faces_away = corners[0].dot(&corners[1].cross(&corners[2])) >= 0.0;
            if drawing.front_only && faces_away {
                return Reach::Nothing;
            }
            let projected = triangle.map(|i| projected[i as usize]);
            reach_of_projected(&projected, &bend, &corners, f64::from(drawing.downscale), (width, height))
        };
        let reaches: Vec<_> = mesh.triangles.par_iter().map(find).collect();
        let bands = sort_into_bands(&reaches, height);
        Self { camera, drawing, width, height, triangles: &mesh.triangles, points, reaches, bands }
    }

    /// Draws the triangles of a band for whose first and last column `wanted` holds; those that reach far are all drawn.
    pub(super) fn draw_band_where(&self, band: usize, z: &mut [f64], wanted: impl Fn([usize; 2]) -> bool) {
        let rows = z.len() / self.width;
        self.visit_band(band, rows, wanted, |_, facet, rays, span| keep_nearest(facet, rays, &mut z[span]));
    }

    /// Calls `visit` for every triangle that may cover pixels of a band and for whose first and last column `wanted` holds, with
    /// the rays of a stretch of a row and where in the band that stretch is.
    fn visit_band(
        &self,
        band: usize,
        rows: usize,
        wanted: impl Fn([usize; 2]) -> bool,
        mut visit: impl FnMut(u32, &Facet, &[[f64; 2]], RangeInclusive<usize>),
    ) {
        let first_row = band * BAND;
        let rays = self.rays(first_row, rows);
        let extents: Vec<_> = rays.chunks(self.width).map(Extent::of).collect();
        for triangle in &self.bands[band] {
            let reach = &self.reaches[*triangle as usize];
            if let Reach::Pixels { columns, .. } = reach
                && !wanted(columns.map(|column| column as usize))
            {
                continue;
            }
            let [a, b, c] = self.triangles[*triangle as usize].map(|i| self.points[i as usize]);
            let facet = Facet::new(&a, &b, &c);
            match reach {
                Reach::Nothing => {}
                Reach::Pixels { columns: [c0, c1], rows: [r0, r1] } => {
                    let last = (*r1 as usize + 1 - first_row).min(rows);
                    for row in (*r0 as usize).saturating_sub(first_row)..last {
                        let span = row * self.width + *c0 as usize..=row * self.width + *c1 as usize;
                        visit(*triangle, &facet, &rays[span.clone()], span);
                    }
                }
                Reach::Wide { x, y } => {
                    for row in (0..rows).filter(|row| extents[*row].meets(*x, *y)) {
                        let span = row * self.width..=(row + 1) * self.width - 1;
                        visit(*triangle, &facet, &rays[span.clone()], span);
                    }
                }
            }
        }
    }

    /// Undistorted normalised coordinates of every pixel of some rows; NaN where no depth is wanted.
    fn rays(&self, first_row: usize, rows: usize) -> Vec<[f64; 2]> {
        let Drawing { downscale, safe_border_px, .. } = *self.drawing;
        let row_of_rays = |row: usize| {
            let mut rays = RayRow::new(self.camera, row, downscale).rays(0, self.width);
            for (column, ray) in rays.iter_mut().enumerate() {
                if !self.camera.inside(full_pixel(column, row, downscale), safe_border_px) {
                    *ray = [f64::NAN; 2];
                }
            }
            rays
        };
        (first_row..first_row + rows).flat_map(row_of_rays).collect()
    }
}

/// Keeps the smaller depth at every ray of a span.
fn keep_nearest(facet: &Facet, rays: &[[f64; 2]], z: &mut [f64]) {
    for (ray, z) in rays.iter().zip(z) {
        let depth = facet.depth(&Vector3::new(ray[0], ray[1], 1.0));
        if depth < *z {
            *z = depth;
        }
    }
}

/// The triangles that may cover a pixel of each band, in the order of the mesh.
fn sort_into_bands(reaches: &[Reach], height: usize) -> Vec<Vec<u32>> {
    let mut bands = vec![Vec::new(); height.div_ceil(BAND)];
    for (triangle, reach) in reaches.iter().enumerate() {
        let range = match reach {
            Reach::Nothing => continue,
            Reach::Pixels { rows: [first, last], .. } => *first as usize / BAND..*last as usize / BAND + 1,
            Reach::Wide { .. } => 0..bands.len(),
        };
        bands[range].iter_mut().for_each(|band| band.push(triangle as u32));
    }
    bands
}

/// Bounding rectangle of the rays of one row, normalised coordinates.
struct Extent {
    x: [f64; 2],
    y: [f64; 2],
}

impl Extent {
    fn of(rays: &[[f64; 2]]) -> Self {
        let empty = Self { x: [f64::INFINITY, f64::NEG_INFINITY], y: [f64::INFINITY, f64::NEG_INFINITY] };
        // min and max pass over NaN.
        rays.iter()
            .fold(empty, |e, [x, y]| Self { x: [e.x[0].min(*x), e.x[1].max(*x)], y: [e.y[0].min(*y), e.y[1].max(*y)] })
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

    const ALL: Drawing = Drawing { downscale: 1, safe_border_px: 0.0, front_only: true };

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
