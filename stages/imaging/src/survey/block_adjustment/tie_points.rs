//! Object points on a face and the images that see them, like those of a feature matcher; control points among them.

use nalgebra::Vector3;
use rand::seq::SliceRandom;
use rand::{Rng, RngExt};
use rayon::prelude::*;

use super::normals::{ObjectPoint, even_weight};
use crate::camera::back_side::shows_back;
use crate::camera::model::Camera;
use crate::depth::depth_buffer::{DepthBuffer, Drawing, draw};
use rockface_core::artefact::{Cameras, Mesh};

/// Columns or rows, whichever is more, of the depth maps that decide visibility.
const BUFFER_SIDE: u32 = 400;
/// Share of its depth by which a visible point may lie behind the surface in a depth map.
const TOLERANCE: f64 = 0.01;
/// Draws for every requested point before the search fails: most of the face may lie outside of the images.
const TRIES: usize = 40;

/// Visibility of the points of a face in the images of a block.
pub struct Visibility {
    /// None of an image that shows only the back of the face.
    views: Vec<Option<(Camera, DepthBuffer, f64)>>,
}

impl Visibility {
    /// Draws the face into coarse depth maps, one for each image. The bits do not depend on the number of threads.
    pub fn new(cameras: &Cameras, mesh: &Mesh) -> Self {
        let view = |image| {
            let camera = Camera::new(cameras.sensor(image), image);
            if shows_back(&camera, mesh) {
                return None;
            }
            let side = camera.sensor().width_px.max(camera.sensor().height_px);
            let downscale = side.div_ceil(BUFFER_SIDE).max(1);
            let buffer =
                draw(mesh, &camera, &Drawing { downscale, safe_border_px: 0.0, front_only: true, window_m: None });
            Some((camera, buffer, f64::from(downscale)))
        };
        Self { views: cameras.images.par_iter().map(view).collect() }
    }

    /// The images that see a point of the face, in block order.
    pub fn images(&self, point: &Vector3<f64>) -> Vec<usize> {
        self.images_near(point, 0.0)
    }

    /// The images that see a point which may be so far behind the face, metres: a mesh is smoother than the rock that a target is fixed to.
    pub fn images_near(&self, point: &Vector3<f64>, behind_m: f64) -> Vec<usize> {
        (0..self.views.len()).filter(|image| self.sees(*image, point, behind_m)).collect()
    }

    /// Whether an image shows only the back of the face.
    pub fn is_behind(&self, image: usize) -> bool {
        self.views[image].is_none()
    }

    /// How far a point is in front of the face, metres along the view, in the image where it is the least; `None` where no image sees it
    /// before the face.
    pub fn in_front_m(&self, point: &Vector3<f64>) -> Option<f64> {
        let seen = (0..self.views.len()).filter_map(|image| self.depths_m(image, point));
        seen.map(|[point_m, face_m]| face_m - point_m).filter(|ahead_m| ahead_m.is_finite()).min_by(f64::total_cmp)
    }

    fn sees(&self, image: usize, point: &Vector3<f64>, behind_m: f64) -> bool {
        let depths = self.depths_m(image, point);
        depths.is_some_and(|[point_m, face_m]| point_m <= face_m * (1.0 + TOLERANCE) + behind_m)
    }

    /// Depth of a point in an image, metres, and of the face where it projects to: infinite where there is none, at the edge of the face.
    /// `None` outside of the image.
    fn depths_m(&self, image: usize, point: &Vector3<f64>) -> Option<[f64; 2]> {
        let (camera, buffer, scale) = self.views[image].as_ref()?;
        let local = camera.to_camera(point);
        let pixel = camera.project_from_camera(&local).filter(|pixel| camera.inside(*pixel, 0.0))?;
        let [column, row] = pixel.map(|at| ((at + 0.5) / scale).floor().max(0.0) as usize);
        let (column, row) = (column.min(buffer.width.saturating_sub(1)), row.min(buffer.height.saturating_sub(1)));
        let face_m = buffer.z_m.get(row * buffer.width + column).copied().filter(|face_m| face_m.is_finite());
        Some([local.z, face_m.unwrap_or(f64::INFINITY)])
    }
}

/// How tie points are made.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Number of tie points on the face.
    pub count: usize,
    /// In how many images a point is measured at most; a random choice of those that see it.
    pub most_images: usize,
    /// Standard deviation of their image coordinates, pixels.
    pub sigma_px: f64,
}

/// Draws tie points evenly over the area of the face; only those that two images see count.
pub fn tie_points(mesh: &Mesh, visibility: &Visibility, wanted: &Wanted, random: &mut impl Rng) -> Vec<ObjectPoint> {
    let surface = Surface::new(mesh);
    let mut points = Vec::with_capacity(wanted.count);
    for _ in 0..TRIES * wanted.count {
        if points.len() == wanted.count {
            break;
        }
        let Some(position_m) = surface.draw(random) else { break };
        let mut images = visibility.images(&position_m);
        if images.len() > wanted.most_images {
            images.shuffle(random);
            images.truncate(wanted.most_images);
            images.sort_unstable();
        }
        if images.len() >= 2 {
            points.push(ObjectPoint { position_m, images, sigma_px: wanted.sigma_px, control_weight: None });
        }
    }
    points
}

/// A surface to draw points from, by area.
struct Surface<'a> {
    mesh: &'a Mesh,
    /// Area of the triangles up to each one, m^2.
    areas: Vec<f64>,
}

impl<'a> Surface<'a> {
    fn new(mesh: &'a Mesh) -> Self {
        let mut sum = 0.0;
        let area = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|i| Vector3::from(mesh.vertices[i as usize]));
            0.5 * (b - a).cross(&(c - a)).norm()
        };
        let areas = mesh.triangles.iter().map(|triangle| {
            sum += area(triangle);
            sum
        });
        Self { mesh, areas: areas.collect() }
    }

    fn draw(&self, random: &mut impl Rng) -> Option<Vector3<f64>> {
        let total = self.areas.last().filter(|total| **total > 0.0)?;
        let at = random.random::<f64>() * total;
        let triangle = self.areas.partition_point(|area| *area <= at).min(self.areas.len() - 1);
        let (root, other) = (random.random::<f64>().sqrt(), random.random::<f64>());
        let [a, b, c] = self.mesh.triangles[triangle].map(|i| Vector3::from(self.mesh.vertices[i as usize]));
        Some(a * (1.0 - root) + b * (root * (1.0 - other)) + c * (root * other))
    }
}

/// Chooses well-spread points as control points: each next one is the farthest from those already chosen.
///
/// The first is the farthest from the mean of all. They are measured in every image that sees them.
pub fn control_points(
    points: &[ObjectPoint],
    visibility: &Visibility,
    count: usize,
    sigma_px: f64,
    sigma_m: f64,
) -> Vec<ObjectPoint> {
    let mean = points.iter().fold(Vector3::zeros(), |sum, p| sum + p.position_m) / points.len().max(1) as f64;
    let mut distances: Vec<f64> = points.iter().map(|p| (p.position_m - mean).norm_squared()).collect();
    let mut chosen = Vec::new();
    while chosen.len() < count.min(points.len()) {
        let farthest = (0..points.len()).fold(0, |best, i| if distances[i] > distances[best] { i } else { best });
        let position_m = points[farthest].position_m;
        if chosen.is_empty() {
            distances.fill(f64::INFINITY);
        }
        for (distance, point) in distances.iter_mut().zip(points) {
            *distance = distance.min((point.position_m - position_m).norm_squared());
        }
        let images = visibility.images(&position_m);
        chosen.push(ObjectPoint { position_m, images, sigma_px, control_weight: Some(even_weight(sigma_m)) });
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{height_mesh, image_at, small_sensor};

    fn block() -> Cameras {
        let at = |name: &str, x: f64| image_at(name, [x, 0.0, 20.0], [0.0; 3]);
        Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images: vec![at("a", -2.0), at("b", 2.0)] }
    }

    #[test]
    fn points_lie_on_the_face_where_both_images_look() {
        let mesh = height_mesh(20, [-10.0, 10.0, -5.0, 5.0], |_, _| 0.5);
        let visibility = Visibility::new(&block(), &mesh);
        let wanted = Wanted { count: 300, most_images: 8, sigma_px: 0.5 };
        let points = tie_points(&mesh, &visibility, &wanted, &mut Key([1; 32]).generator());
        assert_eq!(points.len(), 300);
        // Each image covers 60/100 of 19.5 m about its own x: both see |x| < 5.85 - 2.
        assert!(points.iter().all(|p| p.position_m.x.abs() < 3.86 && (p.position_m.z - 0.5).abs() < 1e-12));
        assert!(points.iter().any(|p| p.position_m.x < -3.5) && points.iter().any(|p| p.position_m.x > 3.5));
        let again = tie_points(&mesh, &visibility, &wanted, &mut Key([1; 32]).generator());
        assert_eq!(points, again);
        let control = control_points(&points, &visibility, 4, 0.3, 0.005);
        let corners = control.iter().filter(|p| p.position_m.x.abs() > 3.0 && p.position_m.y.abs() > 3.0).count();
        assert!(corners >= 3, "{corners} of 4 stand in the corners");
    }

    #[test]
    fn the_back_of_a_face_is_not_seen() {
        // A rough face whose triangles are turned: a few of its steep ones face the cameras all the same.
        let rough = |x: f64, y: f64| 0.1 * rockface_core::numerics::portable_math::sin(9.0 * x + 7.0 * y);
        let mut mesh = height_mesh(120, [-10.0, 10.0, -5.0, 5.0], rough);
        let point = Vector3::new(0.0, 0.0, 0.0);
        assert_eq!(Visibility::new(&block(), &mesh).images(&point), [0, 1]);
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
        let turned = Visibility::new(&block(), &mesh);
        assert!(turned.images(&point).is_empty() && turned.is_behind(0));
    }

    #[test]
    fn what_stands_before_hides() {
        // A wall at x > 0 that stands out 8 m hides the foot behind it from the camera on the right.
        let mesh = height_mesh(200, [-10.0, 10.0, -5.0, 5.0], |x, _| if x > 0.0 { 8.0 } else { 0.0 });
        let visibility = Visibility::new(&block(), &mesh);
        assert_eq!(visibility.images(&Vector3::new(-0.4, 0.0, 0.0)), [0]);
        assert_eq!(visibility.images(&Vector3::new(-3.0, 0.0, 0.0)), [0, 1]);
        assert!(visibility.images(&Vector3::new(0.0, 0.0, 30.0)).is_empty());
    }
}
