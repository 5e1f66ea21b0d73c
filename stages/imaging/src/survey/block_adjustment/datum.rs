//! The datum of a free block: the seven ways it moves as a whole without any pixel changing, and inner constraints on them.

use nalgebra::{DMatrix, Vector3};

use super::unknowns::Unknowns;
use rockface_core::artefact::Cameras;

/// The similarity modes, n x 7: shifts along X, Y, Z, turns about X, Y, Z through the mean centre, scale.
///
/// A turn `w` moves centres by `w x (C - C0)` and cameras by `-R w` (left, camera frame).
pub fn similarity_modes(cameras: &Cameras, unknowns: &Unknowns) -> DMatrix<f64> {
    let mut modes = DMatrix::zeros(unknowns.count(), 7);
    let images = cameras.images.len() as f64;
    let middle = cameras.images.iter().fold(Vector3::zeros(), |sum, image| sum + image.centre()) / images;
    for (at, image) in cameras.images.iter().enumerate() {
        let (first, arm, rotation) = (unknowns.of_image(at), image.centre() - middle, image.matrix());
        for axis in 0..3 {
            let mut unit = Vector3::zeros();
            unit[axis] = 1.0;
            let (turn, moved) = (-(rotation * unit), unit.cross(&arm));
            modes[(first + 3 + axis, axis)] = 1.0;
            for k in 0..3 {
                modes[(first + k, 3 + axis)] = turn[k];
                modes[(first + 3 + k, 3 + axis)] = moved[k];
            }
            modes[(first + 3 + axis, 6)] = arm[axis];
        }
    }
    modes
}

/// What inner constraints weigh: rotations by `distance_m` (so that they count as metres on the face), centres by 1.
fn weights(unknowns: &Unknowns, distance_m: f64) -> Vec<f64> {
    let mut weights = vec![0.0; unknowns.count()];
    for image in 0..unknowns.images() {
        let first = unknowns.of_image(image);
        weights[first..first + 3].fill(distance_m * distance_m);
        weights[first + 3..first + 6].fill(1.0);
    }
    weights
}

/// `P Sigma P^T` with `P = I - G (G^T W G)^-1 G^T W`: the covariance under inner constraints on all images.
///
/// Nothing moves the block as a whole any more: the weighted sums of shifts, turns and scale are zero. `None` where the
/// seven modes are not independent (all centres on one point, or a single image).
pub fn inner_constraints(
    covariance: &DMatrix<f64>,
    modes: &DMatrix<f64>,
    unknowns: &Unknowns,
    distance_m: f64,
) -> Option<DMatrix<f64>> {
    let n = covariance.nrows();
    let weights = weights(unknowns, distance_m);
    let weighted = DMatrix::from_fn(n, modes.ncols(), |i, j| weights[i] * modes[(i, j)]);
    let inner = (weighted.transpose() * modes).try_inverse()?;
    let projector = DMatrix::identity(n, n) - modes * inner * weighted.transpose();
    Some(&projector * covariance * projector.transpose())
}
