//! Expected precision of points of a face: matching noise propagated through the intersection of rays, and orientation errors.

use nalgebra::{DMatrix, Matrix3, Vector3};

use crate::camera::model::Camera;
use crate::camera::orientation_parameters::{INTERIOR, Parameter};
use crate::survey::block_adjustment::partials::Partials;
use crate::survey::block_adjustment::propagation::{movement, rms_off_plane};
use crate::survey::block_adjustment::unknowns::{FreeInterior, Unknowns};
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Covariance};

/// Matching noise, and the cell of the DEM that averages the white part of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Matching {
    /// Standard deviation of the white disparity noise, pixels.
    pub local_px: f64,
    /// Root mean square of the smooth disparity noise over its field, pixels.
    pub regular_px: f64,
    /// Side of a DEM cell, metres.
    pub cell_m: f64,
}

impl Matching {
    /// Standard deviation of disparity in a cell: white noise falls with the root of the pixels in it, smooth noise does not.
    pub fn disparity_px(&self, gsd_m: f64) -> f64 {
        let pixels = (self.cell_m * self.cell_m / (gsd_m * gsd_m)).max(1.0);
        (self.local_px * self.local_px / pixels + self.regular_px * self.regular_px).sqrt()
    }
}

/// Determinant of the normal equations of a point over the cube of their mean diagonal, from which on its rays count as parallel: a base of less than about
/// a millionth of the distance.
const LEAST_ANGLE: f64 = 1e-12;

/// The expected precision at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Mean size of a pixel on a plane across the axes there, metres.
    pub gsd_m: f64,
    /// Standard deviation along the given direction, from matching alone, metres.
    pub matching_m: f64,
}

/// The forecast at a point seen by some cameras; `None` with fewer than two rays, or parallel ones.
///
/// Disparity noise s is image noise s / sqrt(2) in each image; all rays are intersected by least squares. For two normal
/// images this is Z^2 / (B f) s.
pub fn at_point(
    cameras: &[&Camera],
    point: &Vector3<f64>,
    direction: &Vector3<f64>,
    matching: &Matching,
) -> Option<Expected> {
    let (mut normal, mut gsd) = (Matrix3::zeros(), 0.0);
    for camera in cameras {
        let b = Partials::new(camera, point)?.point.map(Vector3::from);
        normal += b[0] * b[0].transpose() + b[1] * b[1].transpose();
        gsd += camera.to_camera(point).z / camera.sensor().f;
    }
    if cameras.len() < 2 {
        return None;
    }
    let gsd_m = gsd / cameras.len() as f64;
    let sigma_px = matching.disparity_px(gsd_m) / std::f64::consts::SQRT_2;
    let mean = normal.trace() / 3.0;
    if normal.determinant() <= LEAST_ANGLE * mean * mean * mean {
        return None;
    }
    let spread = direction.dot(&(normal.try_inverse()? * direction));
    (spread > 0.0 && spread.is_finite()).then(|| Expected { gsd_m, matching_m: sigma_px * spread.sqrt() })
}

/// A covariance in canonical order over all images, from any order and subset.
#[derive(Debug, Clone)]
pub struct Joint {
    /// The unknowns of the block.
    pub unknowns: Unknowns,
    /// Its matrix; zero for parameters that the covariance does not have.
    pub matrix: DMatrix<f64>,
}

impl Joint {
    /// A covariance sorted into the order of a block.
    ///
    /// # Errors
    ///
    /// A parameter that the block does not have.
    pub fn new(covariance: &Covariance, cameras: &Cameras) -> Result<Self, StageError> {
        let names = covariance.parameters.iter();
        let given = names.map(|name| Parameter::find(cameras, name)).collect::<Result<Vec<_>, _>>()?;
        let has = |place: usize| given.iter().any(|p| matches!(p, Parameter::Interior(_, at) if *at == place));
        let free = (0..INTERIOR.len()).filter(|place| has(*place)).map(|place| FreeInterior { place, sigma: None });
        let unknowns = Unknowns::new(cameras, free.collect());
        let order: Vec<Option<usize>> =
            unknowns.parameters().iter().map(|parameter| given.iter().position(|other| other == parameter)).collect();
        let element = |i: usize, j: usize| order[i].zip(order[j]).map_or(0.0, |(i, j)| covariance.matrix[i][j]);
        let matrix = DMatrix::from_fn(order.len(), order.len(), element);
        Ok(Self { unknowns, matrix })
    }

    /// Root mean square error along a direction that orientation leaves after a plane is taken off, metres, for points
    /// intersected from the images that see each; `None` with fewer than four points.
    pub fn off_plane(
        &self,
        cameras: &Cameras,
        seen: &[(Vector3<f64>, Vec<usize>)],
        direction: &Vector3<f64>,
    ) -> Option<f64> {
        let (mut points, mut rows) = (Vec::new(), Vec::new());
        for (point, images) in seen {
            if let Some(moved) = movement(cameras, &self.unknowns, images, point) {
                points.push(point);
                rows.push(moved.iter().map(|(at, d)| (*at, d.dot(direction))).collect::<Vec<_>>());
            }
        }
        rms_off_plane(&points, &rows, direction, &self.matrix)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Sensor};
    use rockface_core::testing::{image_at, small_sensor};

    fn cameras(count: usize, base_m: f64) -> Vec<Camera> {
        let sensor = Sensor { f: 1000.0, width_px: 1000, height_px: 800, ..small_sensor() };
        let camera = |i: usize| Camera::new(&sensor, &image_at("a", [base_m * i as f64, 0.0, 20.0], [0.0; 3]));
        (0..count).map(camera).collect()
    }

    fn at(cameras: &[Camera], point: [f64; 3], matching: &Matching) -> Option<Expected> {
        at_point(&cameras.iter().collect::<Vec<_>>(), &point.into(), &Vector3::z(), matching)
    }

    #[test]
    fn a_normal_pair_has_the_textbook_precision() {
        let matching = Matching { local_px: 0.3, regular_px: 0.4, cell_m: 0.02 };
        let found = at(&cameras(2, 4.0), [2.0, 0.0, 0.0], &matching).unwrap();
        assert!((found.gsd_m - 0.02).abs() < 1e-12);
        // Z^2 / (B f) of 0.5 px: one pixel a cell. The lines of sight are symmetric, so Z does not mix with X.
        assert!((found.matching_m - 0.5 * 400.0 / 4000.0).abs() < 1e-4, "{}", found.matching_m);
        let coarse = Matching { cell_m: 0.06, ..matching };
        assert!((coarse.disparity_px(0.02) - (0.01f64 + 0.16).sqrt()).abs() < 1e-12);
        assert!(at(&cameras(1, 4.0), [0.0; 3], &matching).is_none());
    }

    #[test]
    fn more_rays_measure_better() {
        let matching = Matching { local_px: 0.3, regular_px: 0.4, cell_m: 0.02 };
        let sigma = |count| at(&cameras(count, 1.0), [0.0; 3], &matching).unwrap().matching_m;
        assert!(sigma(3) < sigma(2) && sigma(5) < sigma(3));
    }

    #[test]
    fn a_covariance_finds_its_order() {
        let images = vec![image_at("a", [0.0, 0.0, 20.0], [0.0; 3]), image_at("b", [4.0, 0.0, 20.0], [0.0; 3])];
        let block = Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images };
        let covariance = Covariance {
            frame: Frame::Wall,
            parameters: ["small.f", "b.Z"].map(str::to_owned).to_vec(),
            matrix: vec![vec![4.0, 0.5], vec![0.5, 1.0]],
            sigma0_applied: true,
            full_joint: true,
        };
        let joint = Joint::new(&covariance, &block).unwrap();
        assert_eq!(joint.matrix.nrows(), 13);
        let found = [joint.matrix[(12, 12)], joint.matrix[(11, 12)], joint.matrix[(11, 11)], joint.matrix[(0, 0)]];
        assert!(found.iter().zip([4.0, 0.5, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-15));
    }

    #[test]
    fn rays_without_an_angle_say_nothing_of_a_point() {
        let matching = Matching { local_px: 0.3, regular_px: 0.4, cell_m: 0.02 };
        assert!(at(&cameras(2, 0.0), [2.0, 0.0, 0.0], &matching).is_none());
        // A base of a ten-thousandth of the distance is poor, and a base.
        assert!(at(&cameras(2, 2e-3), [2.0, 0.0, 0.0], &matching).is_some());
    }
}
