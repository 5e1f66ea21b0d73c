//! Which side of a surface an image shows.

use nalgebra::Vector3;

use crate::camera::model::Camera;
use rockface_core::artefact::Mesh;

/// Triangles sampled to find the side of a surface that an image shows.
const SIDE_SAMPLES: usize = 20_000;
/// Least share of the triangles in an image that face it where it shows the front: of a rough face seen from behind some do,
/// of a closed body about half.
const FRONT_SHARE: f64 = 0.05;

/// Whether an image shows a surface from behind only: hardly any of the triangles in it face it.
pub fn shows_back(camera: &Camera, mesh: &Mesh) -> bool {
    let stride = mesh.triangles.len().div_ceil(SIDE_SAMPLES).max(1);
    let (mut seen, mut facing) = (0.0, 0.0);
    for triangle in mesh.triangles.iter().step_by(stride) {
        let [a, b, c] = triangle.map(|vertex| Vector3::from(mesh.vertices[vertex as usize]));
        let middle = (a + b + c) / 3.0;
        let pixel = camera.project_from_camera(&camera.to_camera(&middle));
        if pixel.is_some_and(|pixel| camera.inside(pixel, 0.0)) {
            seen += 1.0;
            facing += f64::from(u8::from((b - a).cross(&(c - a)).dot(&(camera.centre() - middle)) > 0.0));
        }
    }
    facing < FRONT_SHARE * seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::{image_at, small_sensor};

    #[test]
    fn an_image_in_which_less_than_a_twentieth_of_the_triangles_face_it_shows_the_back() {
        let vertices = vec![[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]];
        let sensor = small_sensor();
        let is_back = |facing: usize, height_m: f64| {
            let triangle = |i: usize| if i < facing { [0, 1, 2] } else { [0, 2, 1] };
            let triangles = (0..100).map(triangle).collect();
            let mesh = Mesh { frame: Frame::Wall, vertices: vertices.clone(), triangles, colours: Vec::new() };
            let image = image_at("above", [0.0, 0.0, height_m], [0.0; 3]);
            shows_back(&Camera::new(&sensor, &image), &mesh)
        };
        assert_eq!([0, 4, 6, 100].map(|facing| is_back(facing, 10.0)), [true, true, false, false]);
        assert!(!is_back(0, -10.0), "an image without the surface does not show its back");
    }
}
