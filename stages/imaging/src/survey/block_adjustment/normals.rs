//! Normal equations of a block with its object points eliminated: `N = U - sum W V^-1 W^T`, all weights in.

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::partials::Partials;
use super::unknowns::Unknowns;
use crate::camera::model::Camera;
use rockface_core::StageError;
use rockface_core::artefact::Cameras;

/// Least determinant of a point's normal matrix, as a share of that of a point known evenly: below it rays are parallel.
const RAYS_MEET: f64 = 1e-12;

/// An object point of the block adjustment.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectPoint {
    /// Its position in the frame of the block, metres.
    pub position_m: Vector3<f64>,
    /// The images in which it is measured.
    pub images: Vec<usize>,
    /// Standard deviation of an image coordinate, pixels.
    pub sigma_px: f64,
    /// Weight of the coordinates of a control point, the inverse of their covariance, per square metre; `None` for a tie point.
    pub control_weight: Option<Matrix3<f64>>,
}

/// The weight of coordinates with one standard deviation, metres.
pub fn even_weight(sigma_m: f64) -> Matrix3<f64> {
    Matrix3::identity() / (sigma_m * sigma_m)
}

/// Further observations of every image.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Priors {
    /// Standard deviations of X, Y, Z of each projection centre (GNSS), metres.
    pub position_sigma_m: Option<[f64; 3]>,
    /// Rotation to the frame of the cameras from the axes these are measured along; `None`: the same axes.
    pub cameras_from_measured: Option<Matrix3<f64>>,
}

/// Normal equations of the orientation parameters alone, object points eliminated.
#[derive(Debug, Clone)]
pub struct Normals {
    /// The matrix, n x n in the order of the unknowns.
    pub matrix: DMatrix<f64>,
    /// Its diagonal before object points were eliminated: the scale of rounding errors.
    pub diagonal: Vec<f64>,
    /// Number of image coordinates.
    pub observations: usize,
}

/// Builds the reduced normal equations. Points are added in their order: the bits do not depend on the number of threads.
///
/// # Errors
///
/// A point without pixel in one of its images, or one that its rays do not determine.
pub fn reduced(
    cameras: &Cameras,
    unknowns: &Unknowns,
    points: &[ObjectPoint],
    priors: &Priors,
) -> Result<Normals, StageError> {
    let n = unknowns.count();
    let ready: Vec<Camera> = cameras.images.iter().map(|image| Camera::new(cameras.sensor(image), image)).collect();
    let (mut matrix, mut diagonal, mut observations) = (vec![0.0; n * n], vec![0.0; n], 0);
    for point in points {
        let rays = Rays::new(cameras, &ready, unknowns, point)?;
        rays.add(&mut matrix, &mut diagonal);
        observations += 2 * point.images.len();
    }
    for (row, column, weight) in prior_weights(cameras, unknowns, priors) {
        matrix[row * n + column] += weight;
        if row == column {
            diagonal[row] += weight;
        }
    }
    let matrix = DMatrix::from_fn(n, n, |i, j| if i >= j { matrix[i * n + j] } else { matrix[j * n + i] });
    Ok(Normals { matrix, diagonal, observations })
}

/// Row, column and weight of what is known beforehand, on and below the diagonal.
fn prior_weights(cameras: &Cameras, unknowns: &Unknowns, priors: &Priors) -> Vec<(usize, usize, f64)> {
    let mut weights = Vec::new();
    if let Some(sigma_m) = priors.position_sigma_m {
        let along = sigma_m.map(|sigma| 1.0 / (sigma * sigma));
        for first in (0..cameras.images.len()).map(|image| unknowns.of_image(image) + 3) {
            match &priors.cameras_from_measured {
                None => weights.extend((0..3).map(|axis| (first + axis, first + axis, along[axis]))),
                Some(rotation) => {
                    let weight = rotation * Matrix3::from_diagonal(&Vector3::from(along)) * rotation.transpose();
                    let lower = (0..3).flat_map(|row| (0..=row).map(move |column| (row, column)));
                    weights.extend(lower.map(|(row, column)| (first + row, first + column, weight[(row, column)])));
                }
            }
        }
    }
    for sensor in 0..cameras.sensors.len() {
        for (k, free) in unknowns.free.iter().enumerate() {
            let at = unknowns.of_sensor(sensor) + k;
            weights.extend(free.sigma.map(|sigma| (at, at, 1.0 / (sigma * sigma))));
        }
    }
    weights
}

/// The observations of one point: rows of `A` (by unknowns) and what the elimination of the point takes.
struct Rays {
    /// Columns of each image coordinate pair, weighted.
    rows: Vec<Vec<(usize, [f64; 2])>>,
    /// `W`: a 3-vector for every unknown met, sorted by position.
    w: Vec<(usize, Vector3<f64>)>,
    /// `V^-1`, the point's own covariance where orientation is without error.
    v_inverse: Matrix3<f64>,
}

impl Rays {
    fn new(cameras: &Cameras, ready: &[Camera], unknowns: &Unknowns, point: &ObjectPoint) -> Result<Self, StageError> {
        let (mut rows, mut w, mut v) = (Vec::new(), std::collections::BTreeMap::new(), Matrix3::zeros());
        for image in &point.images {
            let name = &cameras.images[*image].name;
            let partials = Partials::new(&ready[*image], &point.position_m)
                .ok_or_else(|| StageError::new(format!("a tie point has no pixel in image `{name}`")))?;
            let scale = 1.0 / point.sigma_px;
            let b = partials.point.map(|row| Vector3::from(row) * scale);
            v += b[0] * b[0].transpose() + b[1] * b[1].transpose();
            let sensor = cameras.images[*image].sensor;
            let row: Vec<(usize, [f64; 2])> = unknowns
                .columns(*image, sensor, &partials)
                .into_iter()
                .map(|(at, a)| (at, a.map(|x| x * scale)))
                .collect();
            for (at, a) in &row {
                *w.entry(*at).or_insert_with(Vector3::zeros) += b[0] * a[0] + b[1] * a[1];
            }
            rows.push(row);
        }
        if let Some(weight) = point.control_weight {
            v += weight;
        }
        let p = point.position_m;
        let size = v.trace() / 3.0;
        let meet = v.determinant() > RAYS_MEET * size * size * size;
        let v_inverse = v.try_inverse().filter(|_| meet).ok_or_else(|| {
            StageError::new(format!(
                "the rays of the tie point at ({:.3}, {:.3}, {:.3}) do not meet in one point",
                p.x, p.y, p.z
            ))
        })?;
        Ok(Self { rows, w: w.into_iter().collect(), v_inverse })
    }

    /// Adds to the lower triangle of a row-major matrix.
    fn add(&self, matrix: &mut [f64], diagonal: &mut [f64]) {
        let n = diagonal.len();
        for row in &self.rows {
            for (i, a) in row {
                diagonal[*i] += a[0] * a[0] + a[1] * a[1];
                for (j, b) in row.iter().filter(|(j, _)| j <= i) {
                    matrix[i * n + j] += a[0] * b[0] + a[1] * b[1];
                }
            }
        }
        for (at, (i, a)) in self.w.iter().enumerate() {
            let y = self.v_inverse * a;
            for (j, b) in &self.w[..=at] {
                matrix[i * n + j] -= y.dot(b);
            }
        }
    }
}
