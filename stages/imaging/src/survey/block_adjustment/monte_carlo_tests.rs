//! Tests by drawing: adjustments of noisy measurements scatter as the covariance says, and orientation errors move tie points
//! as first-order propagation says.

use nalgebra::{DMatrix, DVector, Vector3};

use super::block_tests::{lens, small_block};
use super::inverse::{Datum, invert};
use super::normals::{ObjectPoint, Priors, reduced};
use super::partials::Partials;
use super::propagation::{intersection, pair_effect, variance};
use super::unknowns::Unknowns;
use crate::camera::covariance_sampling::JointRoot;
use crate::camera::model::Camera;
use crate::camera::orientation_parameters::correct;
use rockface_core::artefact::{Cameras, Covariance};
use rockface_core::numerics::random::{Field, Key};

/// The standard deviation of a control point whose coordinates have the same.
fn control_sigma_m(point: &ObjectPoint) -> Option<f64> {
    point.control_weight.map(|weight| 1.0 / weight[(0, 0)].sqrt())
}

/// Gauss-Newton of a whole small block, object points among the unknowns; returns the corrections of the orientation.
fn adjust(cameras: &Cameras, unknowns: &Unknowns, points: &[ObjectPoint], field: &Field, trial: i32) -> Vec<f64> {
    let (n, mut draw) = (unknowns.count(), 0);
    let mut normal = || {
        draw += 1;
        field.normal(draw, trial)
    };
    // The measurements: true pixels, control coordinates and priors, each with its error.
    let mut measured: Vec<Vec<[f64; 2]>> = Vec::new();
    let mut control: Vec<Vector3<f64>> = Vec::new();
    for point in points {
        let pixel = |image: &usize| {
            let entry = &cameras.images[*image];
            let pixel = Camera::new(cameras.sensor(entry), entry).project(&point.position_m).unwrap();
            pixel.map(|at| at + point.sigma_px * normal())
        };
        measured.push(point.images.iter().map(pixel).collect());
        let sigma = control_sigma_m(point).unwrap_or(0.0);
        control.push(point.position_m + Vector3::new(normal(), normal(), normal()) * sigma);
    }
    let known: Vec<f64> = unknowns.free.iter().map(|free| free.sigma.unwrap_or(0.0) * normal()).collect();
    let (mut corrections, mut moved) = (vec![0.0; n], points.to_vec());
    for _ in 0..4 {
        let parameters = unknowns.parameters();
        let now: Vec<_> = parameters.iter().copied().zip(corrections.iter().copied()).collect();
        let block = correct(cameras, &now).unwrap();
        let size = n + 3 * points.len();
        let (mut matrix, mut right) = (DMatrix::<f64>::zeros(size, size), DVector::<f64>::zeros(size));
        let mut observe = |row: &[(usize, f64)], misclosure: f64, sigma: f64| {
            for (i, a) in row {
                right[*i] += a * misclosure / (sigma * sigma);
                row.iter().for_each(|(j, b)| matrix[(*i, *j)] += a * b / (sigma * sigma));
            }
        };
        for (at, point) in moved.iter().enumerate() {
            for (image, pixel) in point.images.iter().zip(&measured[at]) {
                let entry = &block.images[*image];
                let partials = Partials::new(&Camera::new(block.sensor(entry), entry), &point.position_m).unwrap();
                for row in 0..2 {
                    let columns = unknowns.columns(*image, 0, &partials).into_iter().map(|(i, d)| (i, d[row]));
                    let own = (0..3).map(|axis| (n + 3 * at + axis, partials.point[row][axis]));
                    let columns: Vec<_> = columns.chain(own).collect();
                    observe(&columns, pixel[row] - partials.pixel[row], point.sigma_px);
                }
            }
            if let Some(sigma) = control_sigma_m(point) {
                (0..3).for_each(|axis| {
                    observe(&[(n + 3 * at + axis, 1.0)], control[at][axis] - point.position_m[axis], sigma);
                });
            }
        }
        for (k, free) in unknowns.free.iter().enumerate() {
            let i = unknowns.of_sensor(0) + k;
            free.sigma.iter().for_each(|sigma| observe(&[(i, 1.0)], known[k] - corrections[i], *sigma));
        }
        let step = matrix.cholesky().unwrap().solve(&right);
        (0..n).for_each(|i| corrections[i] += step[i]);
        for (at, point) in moved.iter_mut().enumerate() {
            (0..3).for_each(|axis| point.position_m[axis] += step[n + 3 * at + axis]);
        }
    }
    corrections
}

#[test]
fn adjustments_scatter_as_the_covariance_says() {
    let (cameras, points) = small_block();
    let unknowns = Unknowns::new(&cameras, lens());
    let normals = reduced(&cameras, &unknowns, &points, &Priors::default()).unwrap();
    let expected = invert(&normals, &cameras, &unknowns, Datum::Priors).unwrap().covariance;
    let field = Key([5; 32]).field();
    let trials = 400;
    let draws: Vec<Vec<f64>> = (0..trials).map(|trial| adjust(&cameras, &unknowns, &points, &field, trial)).collect();
    let n = f64::from(trials);
    for i in 0..unknowns.count() {
        for j in 0..=i {
            let sampled = draws.iter().map(|d| d[i] * d[j]).sum::<f64>() / n;
            let (vi, vj, cij) = (expected[(i, i)], expected[(j, j)], expected[(i, j)]);
            // Standard error of a sampled covariance of normal variables; 210 of them are looked at.
            let error = ((vi * vj + cij * cij) / n).sqrt();
            assert!((sampled - cij).abs() < 4.5 * error, "{i} {j}: {sampled} for {cij}");
        }
    }
}

/// Errors are drawn this much smaller than this weak block has them: with principal distance and distance known to a few
/// percent only, second-order terms are as large as what is left of the first after both cancel.
const SMALL: f64 = 0.05;

/// The point nearest to the two rays of fixed pixels, by least squares of the pixels as the propagation has it.
fn intersect(cameras: &Cameras, pixels: [[f64; 2]; 2], start: &Vector3<f64>) -> (Vector3<f64>, [[f64; 2]; 2]) {
    let mut point = *start;
    let mut residuals = [[0.0; 2]; 2];
    for _ in 0..5 {
        let (mut matrix, mut right) = (nalgebra::Matrix3::zeros(), Vector3::zeros());
        for (image, pixel) in pixels.iter().enumerate() {
            let entry = &cameras.images[image];
            let partials = Partials::new(&Camera::new(cameras.sensor(entry), entry), &point).unwrap();
            for row in 0..2 {
                let b = Vector3::from(partials.point[row]);
                residuals[image][row] = pixel[row] - partials.pixel[row];
                matrix += b * b.transpose();
                right += b * residuals[image][row];
            }
        }
        point += matrix.try_inverse().unwrap() * right;
    }
    (point, residuals)
}

#[test]
fn orientation_errors_move_points_as_propagation_says() {
    let (cameras, points) = small_block();
    let unknowns = Unknowns::new(&cameras, lens());
    let normals = reduced(&cameras, &unknowns, &points, &Priors::default()).unwrap();
    let sigma = invert(&normals, &cameras, &unknowns, Datum::Priors).unwrap().covariance;
    let parameters = unknowns.parameters();
    let root = JointRoot::new(&Covariance {
        frame: cameras.frame,
        parameters: parameters.iter().map(|parameter| parameter.name(&cameras)).collect(),
        matrix: sigma.row_iter().map(|row| row.iter().copied().collect()).collect(),
        sigma0_applied: true,
        full_joint: true,
    })
    .unwrap();
    let (trials, field) = (1500, Key([8; 32]).field());
    let places: Vec<Vector3<f64>> = points.iter().map(|point| point.position_m).collect();
    let pixels = |place: &Vector3<f64>| {
        [0, 1].map(|i: usize| Camera::new(&cameras.sensors[0], &cameras.images[i]).project(place).unwrap())
    };
    let (mut squares, mut parallax) = (vec![Vector3::zeros(); places.len()], 0.0);
    for trial in 0..trials {
        let z: Vec<f64> = (0..parameters.len()).map(|i| field.normal(i as i32, trial)).collect();
        let errors: Vec<_> =
            parameters.iter().copied().zip(root.correlate(&z).into_iter().map(|error| SMALL * error)).collect();
        let estimated = correct(&cameras, &errors).unwrap();
        for (place, square) in places.iter().zip(&mut squares) {
            let (point, residuals) = intersect(&estimated, pixels(place), place);
            *square += (point - place).component_mul(&(point - place));
            parallax += 2.0 * residuals.iter().flatten().map(|r| r * r).sum::<f64>();
        }
    }
    let n = f64::from(trials);
    for (place, square) in places.iter().zip(&squares) {
        let error = intersection(&cameras, &unknowns, [0, 1], place).unwrap();
        for axis in 0..3 {
            let row: Vec<(usize, f64)> = error.moved.iter().map(|(at, d)| (*at, d[axis])).collect();
            let expected = SMALL * SMALL * variance(&row, &sigma);
            // Standard error of a sampled variance is sqrt(2 / n) of it.
            let off = (square[axis] / n - expected) / (expected * (2.0 / n).sqrt());
            assert!(off.abs() < 4.5, "axis {axis} of {place:?}: {off} standard errors");
        }
    }
    let effect = pair_effect(&cameras, &unknowns, &sigma, [0, 1], &places).unwrap();
    let sampled = (parallax / (n * places.len() as f64)).sqrt() / SMALL;
    assert!((sampled / effect.y_parallax_px - 1.0).abs() < 0.06, "{sampled} for {}", effect.y_parallax_px);
    assert!(effect.depth_off_plane_m < effect.depth_m);
}
