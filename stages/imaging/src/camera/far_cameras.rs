//! Cameras that cannot be those of a mesh, since they are far away from it.

use nalgebra::Vector3;

use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Image, Mesh};

/// Cameras that are all farther from a mesh than so many of its diagonals, and than so many metres, are not of its place.
const MOST_DIAGONALS: f64 = 100.0;
const MOST_M: f64 = 1000.0;

/// What is wrong where all cameras are so far from a mesh that one of the two must be shifted; `None` where one is near.
pub fn far_from(mesh: &Mesh, cameras: &Cameras) -> Option<StageError> {
    let corners = mesh.triangles.iter().flatten().map(|vertex| Vector3::from(mesh.vertices[*vertex as usize]));
    let [low, high] = corners.fold(None, |bounds: Option<[Vector3<f64>; 2]>, corner| {
        Some(bounds.map_or([corner; 2], |[low, high]| [low.inf(&corner), high.sup(&corner)]))
    })?;
    // From the box around the mesh.
    let distance_m = |image: &Image| (image.centre() - image.centre().sup(&low).inf(&high)).norm();
    let nearest = cameras.images.iter().min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
    let apart_m = distance_m(nearest);
    if apart_m <= MOST_M.max(MOST_DIAGONALS * (high - low).norm()) {
        return None;
    }
    let place = |at: Vector3<f64>| format!("({:.0}, {:.0}, {:.0})", at.x, at.y, at.z);
    let message = format!(
        "cameras are {} from the mesh: the nearest, `{}`, is at {}, the middle of the mesh at {}",
        in_words(apart_m),
        nearest.name,
        place(nearest.centre()),
        place((low + high) / 2.0)
    );
    let way = "one of the two is shifted or in a local frame: give `offset_m` of `import-mesh` or `import-cameras`, or export both in one system";
    Some(StageError::new(message).hint(way))
}

fn in_words(distance_m: f64) -> String {
    let km = distance_m / 1000.0;
    if km < 10.0 { format!("{km:.1} km") } else { format!("{km:.0} km") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::image_at;

    #[test]
    fn cameras_of_another_place_are_named_with_both_places() {
        let with = |side_m: f64, centres: &[[f64; 3]]| {
            let vertices = vec![[0.0; 3], [side_m, 0.0, 0.0], [0.0, side_m, 0.0], [1e9; 3]];
            let mesh = Mesh { frame: Frame::World, vertices, triangles: vec![[0, 1, 2]], colours: Vec::new() };
            let images = centres.iter().map(|centre| image_at("DJI_1", *centre, [0.0; 3])).collect();
            far_from(&mesh, &Cameras { frame: Frame::World, sensors: Vec::new(), images })
        };
        let error = with(100.0, &[[400_000.0, 5_100_000.0, 700.0]]).unwrap();
        assert_eq!(
            error.message,
            "cameras are 5116 km from the mesh: the nearest, `DJI_1`, is at (400000, 5100000, 700), the middle of the mesh at (50, 50, 0)"
        );
        assert!(error.hint.unwrap().contains("`offset_m` of `import-mesh` or `import-cameras`"));
        // One that is near is enough; a small face is photographed from up to 1 km, a large one from farther.
        assert!(with(100.0, &[[4e5, 5e6, 0.0], [50.0, 50.0, 90.0]]).is_none());
        assert!(with(1.0, &[[0.0, 0.0, 999.0]]).is_none());
        assert!(with(1.0, &[[0.0, 0.0, 1001.0]]).unwrap().message.contains("are 1.0 km from"));
        assert!(with(100.0, &[[0.0, 0.0, 14_000.0]]).is_none());
        assert!(with(100.0, &[[0.0, 0.0, 14_200.0]]).is_some());
        assert!(with(100.0, &[]).is_none());
    }
}
