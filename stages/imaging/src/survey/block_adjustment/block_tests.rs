//! Tests of the reduced normal equations and their inverse: against the whole normal matrix, and against the modes of a free block.

use nalgebra::{DMatrix, Matrix3, Vector3};

use super::datum::similarity_modes;
use super::inverse::{Datum, invert};
use super::normals::{ObjectPoint, Priors, even_weight, reduced};
use super::partials::Partials;
use super::unknowns::{FreeInterior, Unknowns};
use crate::camera::model::Camera;
use rockface_core::artefact::{Cameras, Frame, Sensor};
use rockface_core::testing::{image_at, small_sensor};

/// Three images of a lens with distortion and 25 points, 4 of them control points.
pub(super) fn small_block() -> (Cameras, Vec<ObjectPoint>) {
    let sensor = Sensor {
        f: 1000.0,
        k: [-0.1, 0.05, 0.0, 0.0],
        p: [1e-3, -5e-4],
        width_px: 600,
        height_px: 400,
        cx: 299.5,
        cy: 199.5,
        ..small_sensor()
    };
    let images = vec![
        image_at("a", [-3.0, 0.2, 20.0], [0.0, -0.15, 0.01]),
        image_at("b", [3.0, -0.3, 21.0], [0.02, 0.15, 0.0]),
        image_at("c", [0.3, 2.0, 19.0], [-0.1, 0.0, 1.6]),
    ];
    let point = |at: usize| {
        let (i, j) = ((at % 5) as f64 - 2.0, (at / 5) as f64 - 2.0);
        ObjectPoint {
            position_m: Vector3::new(1.1 * i, 0.8 * j, 0.7 * ((at * 7) % 5) as f64 - 1.4),
            images: if at % 4 == 3 { vec![0, 1] } else { vec![0, 1, 2] },
            sigma_px: 0.5,
            control_weight: at.is_multiple_of(6).then_some(even_weight(0.01)),
        }
    };
    (Cameras { frame: Frame::Wall, sensors: vec![sensor], images }, (0..25).map(point).collect())
}

pub(super) fn lens() -> Vec<FreeInterior> {
    vec![FreeInterior { place: 5, sigma: Some(0.05) }, FreeInterior { place: 0, sigma: None }]
}

/// The whole normal matrix, object points in it, inverted at once.
fn dense(cameras: &Cameras, unknowns: &Unknowns, points: &[ObjectPoint], priors: &Priors) -> DMatrix<f64> {
    let n = unknowns.count();
    let mut normal = DMatrix::zeros(n + 3 * points.len(), n + 3 * points.len());
    for (at, point) in points.iter().enumerate() {
        for image in &point.images {
            let entry = &cameras.images[*image];
            let partials = Partials::new(&Camera::new(cameras.sensor(entry), entry), &point.position_m).unwrap();
            for row in 0..2 {
                let mut a = DMatrix::zeros(1, normal.ncols());
                unknowns.columns(*image, 0, &partials).iter().for_each(|(i, d)| a[(0, *i)] = d[row]);
                (0..3).for_each(|axis| a[(0, n + 3 * at + axis)] = partials.point[row][axis]);
                normal += a.transpose() * &a / (point.sigma_px * point.sigma_px);
            }
        }
        for axis in 0..3 {
            let weight = point.control_weight.map_or(0.0, |weight| weight[(axis, axis)]);
            normal[(n + 3 * at + axis, n + 3 * at + axis)] += weight;
        }
    }
    for image in 0..3 {
        for (axis, sigma) in priors.position_sigma_m.iter().flatten().enumerate() {
            // An observation of the centre along one axis.
            let along = priors.cameras_from_measured.unwrap_or_else(Matrix3::identity).column(axis).into_owned();
            let mut a = DMatrix::zeros(1, normal.ncols());
            (0..3).for_each(|k| a[(0, unknowns.of_image(image) + 3 + k)] = along[k]);
            normal += a.transpose() * &a / (sigma * sigma);
        }
    }
    for (k, free) in unknowns.free.iter().enumerate() {
        let i = unknowns.of_sensor(0) + k;
        normal[(i, i)] += free.sigma.map_or(0.0, |sigma| 1.0 / (sigma * sigma));
    }
    normal.try_inverse().unwrap().view((0, 0), (n, n)).into_owned()
}

#[test]
fn elimination_gives_what_the_whole_matrix_gives() {
    let (cameras, points) = small_block();
    let turn = Some(*nalgebra::Rotation3::from_euler_angles(0.4, -0.7, 1.3).matrix());
    let gnss = Some([0.02, 0.03, 0.04]);
    for (free, position_sigma_m, cameras_from_measured) in
        [(Vec::new(), None, None), (lens(), None, None), (lens(), gnss, None), (lens(), gnss, turn)]
    {
        let unknowns = Unknowns::new(&cameras, free);
        let priors = Priors { position_sigma_m, cameras_from_measured };
        let normals = reduced(&cameras, &unknowns, &points, &priors).unwrap();
        let found = invert(&normals, &cameras, &unknowns, Datum::Priors).unwrap().covariance;
        let expected = dense(&cameras, &unknowns, &points, &priors);
        for i in 0..unknowns.count() {
            for j in 0..unknowns.count() {
                let unit = (expected[(i, i)] * expected[(j, j)]).sqrt();
                assert!((found[(i, j)] - expected[(i, j)]).abs() < 1e-7 * unit, "{i} {j}");
            }
        }
    }
}

#[test]
fn a_free_block_has_its_seven_modes_and_no_others() {
    let (cameras, mut points) = small_block();
    points.iter_mut().for_each(|point| point.control_weight = None);
    let unknowns = Unknowns::new(&cameras, Vec::new());
    let normals = reduced(&cameras, &unknowns, &points, &Priors::default()).unwrap();
    let modes = similarity_modes(&cameras, &unknowns);
    let product = &normals.matrix * &modes;
    for j in 0..7 {
        let scale: f64 = (0..unknowns.count()).map(|i| normals.diagonal[i] * modes[(i, j)].abs()).sum();
        assert!(product.column(j).norm() < 1e-12 * scale, "mode {j}");
    }
    let error = invert(&normals, &cameras, &unknowns, Datum::Priors).unwrap_err();
    assert!(error.message.contains("7 free directions: 7 of the block as a whole"), "{error}");
    let inner = invert(&normals, &cameras, &unknowns, Datum::Inner { distance_m: 20.0 }).unwrap().covariance;
    // The covariance satisfies N Sigma N = N, and no weighted motion of the whole is left in it.
    let again = &normals.matrix * &inner * &normals.matrix;
    for i in 0..unknowns.count() {
        for j in 0..unknowns.count() {
            let unit = (normals.diagonal[i] * normals.diagonal[j]).sqrt();
            assert!((again[(i, j)] - normals.matrix[(i, j)]).abs() < 1e-8 * unit, "{i} {j}");
        }
    }
    for axis in 0..3 {
        let row: f64 = (0..3).map(|image| inner[(unknowns.of_image(image) + 3 + axis, 3)]).sum();
        assert!(row.abs() < 1e-9, "the mean centre moves along {axis} by {row}");
    }
}

#[test]
fn what_nothing_measures_is_named() {
    let (cameras, mut points) = small_block();
    points.iter_mut().for_each(|point| point.images = vec![0, 1]);
    let unknowns = Unknowns::new(&cameras, Vec::new());
    let normals = reduced(&cameras, &unknowns, &points, &Priors::default()).unwrap();
    let error = invert(&normals, &cameras, &unknowns, Datum::Priors).unwrap_err();
    assert!(error.message.contains("6 of the 18 parameters: c.rx, c.ry"), "{error}");
    points[3].images = vec![0];
    let error = reduced(&cameras, &unknowns, &points, &Priors::default()).unwrap_err();
    assert!(error.message.contains("do not meet in one point"), "{error}");
    // b1 and f of a lens without distortion, seen on nothing but itself: one cannot be told from the other in a flat block.
    let (mut cameras, mut flat) = small_block();
    cameras.sensors[0] = Sensor { k: [0.0; 4], p: [0.0; 2], ..cameras.sensors[0].clone() };
    cameras.images.truncate(2);
    cameras.images.iter_mut().for_each(|image| {
        *image = image_at(&image.name, [image.centre_m[0], 0.0, 20.0], [0.0; 3]);
    });
    flat.iter_mut().for_each(|point| {
        point.position_m.z = 0.0;
        point.images = vec![0, 1];
        point.control_weight = Some(even_weight(0.01));
    });
    let unknowns = Unknowns::new(&cameras, vec![FreeInterior { place: 0, sigma: None }]);
    let normals = reduced(&cameras, &unknowns, &flat, &Priors::default()).unwrap();
    let error = invert(&normals, &cameras, &unknowns, Datum::Priors).unwrap_err();
    // Straight images of a plane: principal distance and both distances go together.
    assert!(error.message.contains("1 free directions: one of") && error.message.contains("small.f"), "{error}");
}
