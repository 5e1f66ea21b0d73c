//! Stereo geometry of pairs of images before a face: overlap, distance, baseline, convergence, and the order of the two images.

use nalgebra::Vector3;

use crate::camera::back_side::shows_back;
use crate::camera::model::Camera;
use rockface_core::artefact::{Cameras, Mesh, Pair};
use rockface_core::numerics::portable_math;

/// Least component of the viewing direction across the baseline, of both images together and of each: below it a pair cannot be rectified.
const FORWARD: f64 = 0.1;

/// At most `limit` vertices of the surface of a mesh, evenly spaced in its vertex list.
pub fn sample_vertices(mesh: &Mesh, limit: usize) -> Vec<Vector3<f64>> {
    sample_vertices_where(mesh, limit, &|_, _| true)
}

/// As [`sample_vertices`], of those whose X and Y are `wanted`.
pub fn sample_vertices_where(mesh: &Mesh, limit: usize, wanted: &dyn Fn(f64, f64) -> bool) -> Vec<Vector3<f64>> {
    let points = || mesh.surface_points().filter(|[x, y, _]| wanted(*x, *y));
    let stride = points().count().div_ceil(limit.max(1)).max(1);
    points().step_by(stride).map(Vector3::from).collect()
}

/// Depth along the optical axis, metres, of each point that lies in the image; occlusion is ignored.
pub fn depths_seen(camera: &Camera, points: &[Vector3<f64>]) -> Vec<Option<f64>> {
    let depth = |point: &Vector3<f64>| {
        let local = camera.to_camera(point);
        let pixel = camera.project_from_camera(&local)?;
        camera.inside(pixel, 0.0).then_some(local.z)
    };
    points.iter().map(depth).collect()
}

/// The sampled vertices of a face in every image of a block.
#[derive(Debug)]
pub struct Views<'a> {
    cameras: &'a Cameras,
    depths: Vec<Vec<Option<f64>>>,
}

/// Why two images are no stereo pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPair {
    /// Both projection centres are the same.
    NoBaseline,
    /// The images look along their baseline.
    Forward,
    /// No sampled vertex lies in both images.
    NothingShared,
}

impl std::fmt::Display for NoPair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::NoBaseline => "their projection centres are the same",
            Self::Forward => "they look along their baseline",
            Self::NothingShared => "no part of the face is in both, seen from its front",
        })
    }
}

impl<'a> Views<'a> {
    /// Projects the sampled points into every image.
    pub fn new(cameras: &'a Cameras, points: &[Vector3<f64>]) -> Self {
        let camera = |image| Camera::new(cameras.sensor(image), image);
        let depths = cameras.images.iter().map(|image| depths_seen(&camera(image), points)).collect();
        Self { cameras, depths }
    }

    /// At most `limit` vertices of a face in every image; images that show only its back see none.
    pub fn of_face(cameras: &'a Cameras, mesh: &Mesh, limit: usize) -> Self {
        let mut views = Self::new(cameras, &sample_vertices(mesh, limit));
        for (image, depths) in cameras.images.iter().zip(&mut views.depths) {
            if shows_back(&Camera::new(cameras.sensor(image), image), mesh) {
                depths.fill(None);
            }
        }
        views
    }

    /// The pair of two images (i < j in block order), ordered so that the second lies in the direction of image x.
    ///
    /// With `b = (C2 - C1) / B` and `m` the sum of the optical axes, a pair with `|m - (m.b) b| < 0.1` looks along its
    /// baseline, and so does one with an axis whose cosine to that direction is below 0.1. Overlap is the
    /// share of the sampled vertices in one image that lie in the other too: the smaller of both, so that it is the same either way round.
    pub fn pair(&self, i: usize, j: usize) -> Result<Pair, NoPair> {
        let images = &self.cameras.images;
        let baseline = images[j].centre() - images[i].centre();
        let baseline_m = baseline.norm();
        if baseline_m == 0.0 {
            return Err(NoPair::NoBaseline);
        }
        let b = baseline / baseline_m;
        let sum = images[i].axis() + images[j].axis();
        let across = sum - b * sum.dot(&b);
        let towards_plane = |k: usize| images[k].axis().dot(&across) / across.norm();
        if across.norm() < FORWARD || towards_plane(i).min(towards_plane(j)) < FORWARD {
            return Err(NoPair::Forward);
        }
        let towards = b.dot(&images[i].matrix().row(0).transpose());
        let (first, second) = if towards < 0.0 { (j, i) } else { (i, j) };
        let (overlap, distance_m) = self.shared(first, second).ok_or(NoPair::NothingShared)?;
        let (a, z) = (images[first].axis(), images[second].axis());
        Ok(Pair {
            name: format!("{}+{}", images[first].name, images[second].name),
            first: images[first].name.clone(),
            second: images[second].name.clone(),
            baseline_m,
            distance_m,
            convergence_rad: portable_math::atan2(a.cross(&z).norm(), a.dot(&z)),
            overlap,
        })
    }

    /// How many of the sampled vertices lie in both images.
    pub fn shared_count(&self, i: usize, j: usize) -> usize {
        self.depths[i].iter().zip(&self.depths[j]).filter(|(a, b)| a.is_some() && b.is_some()).count()
    }

    /// The share of the sampled vertices that lie in both images of one of these pairs, by their numbers in the block.
    pub fn share_in(&self, pairs: &[[usize; 2]]) -> f64 {
        let count = self.depths.first().map_or(0, Vec::len);
        let sees = |image: usize, vertex: usize| self.depths[image][vertex].is_some();
        let covered = (0..count).filter(|vertex| pairs.iter().any(|[a, b]| sees(*a, *vertex) && sees(*b, *vertex)));
        covered.count() as f64 / count.max(1) as f64
    }

    /// The smaller of the shares that two images have of each other's vertices, and the mean depth (m) of the shared ones in both.
    fn shared(&self, first: usize, second: usize) -> Option<(f64, f64)> {
        let seen = [first, second].map(|image| self.depths[image].iter().flatten().count());
        let both = self.depths[first].iter().zip(&self.depths[second]);
        let depths: Vec<f64> = both.filter_map(|(a, b)| Some(0.5 * ((*a)? + (*b)?))).collect();
        let shared = depths.len() as f64;
        (!depths.is_empty()).then(|| (shared / seen[0].max(seen[1]) as f64, depths.iter().sum::<f64>() / shared))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::{image_at, small_sensor};

    /// Images that look along -Z from 1 m apart, the baseline at an angle with this sine to the view.
    fn pair(sine: f64) -> Result<Pair, NoPair> {
        let second = image_at("second", [sine, 0.0, 20.0 + (1.0 - sine * sine).sqrt()], [0.0; 3]);
        let images = vec![image_at("first", [0.0, 0.0, 20.0], [0.0; 3]), second];
        let cameras = Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images };
        Views::new(&cameras, &[Vector3::zeros()]).pair(0, 1)
    }

    #[test]
    fn images_that_look_along_their_baseline_are_no_pair() {
        assert_eq!(pair(0.09).unwrap_err(), NoPair::Forward);
        let found = pair(0.11).unwrap();
        assert!((found.baseline_m - 1.0).abs() < 1e-12 && (found.overlap - 1.0).abs() < 1e-12, "{found:?}");
        assert_eq!(found.name, "first+second");
    }
}
