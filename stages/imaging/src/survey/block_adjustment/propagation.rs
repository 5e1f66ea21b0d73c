//! First-order effects of orientation errors on a stereo pair: errors of depth, with and without their best plane, and y-parallax.
//!
//! A pixel is measured with the true orientation and intersected with the estimated one. With `A` and `B` the
//! derivatives of the four image coordinates by orientation and object point, a point moves by `-(B^T B)^-1 B^T A e` and
//! keeps the residual `(I - B (B^T B)^-1 B^T) A e`, whose length is the y-parallax over the root of two.

use nalgebra::{DMatrix, Matrix4x3, Vector3, Vector4};

use super::partials::Partials;
use super::unknowns::Unknowns;
use crate::camera::model::Camera;
use crate::survey::overlap::Views;
use rockface_core::artefact::Cameras;

/// Smallest overlap and ratio of baseline to distance of a stereo pair.
const STEREO: [f64; 2] = [0.3, 0.03];

/// The combinations of images that make a stereo pair: 30 % overlap and a baseline of 3 % of the distance at least.
pub fn stereo_pairs(cameras: &Cameras, points: &[Vector3<f64>]) -> Vec<[usize; 2]> {
    let views = Views::new(cameras, points);
    let images = cameras.images.len();
    let usable = |pair: &[usize; 2]| {
        let stereo = views.pair(pair[0], pair[1]);
        stereo.is_ok_and(|pair| pair.overlap >= STEREO[0] && pair.baseline_m >= STEREO[1] * pair.distance_m)
    };
    (0..images).flat_map(|i| (i + 1..images).map(move |j| [i, j])).filter(usable).collect()
}

/// The points that lie in all of some images.
pub fn in_all(cameras: &Cameras, images: &[usize], points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let ready: Vec<Camera> = images
        .iter()
        .map(|image| Camera::new(cameras.sensor(&cameras.images[*image]), &cameras.images[*image]))
        .collect();
    let lies = |camera: &Camera, point| camera.project(point).is_some_and(|pixel| camera.inside(pixel, 0.0));
    points.iter().filter(|point| ready.iter().all(|camera| lies(camera, point))).copied().collect()
}

/// Shift of a point intersected from several images for each unknown, metres a unit; `None` without intersection.
pub fn movement(
    cameras: &Cameras,
    unknowns: &Unknowns,
    images: &[usize],
    point: &Vector3<f64>,
) -> Option<Vec<(usize, Vector3<f64>)>> {
    let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), std::collections::BTreeMap::new());
    for image in images {
        let entry = &cameras.images[*image];
        let partials = Partials::new(&Camera::new(cameras.sensor(entry), entry), point)?;
        let b = partials.point.map(Vector3::from);
        normal += b[0] * b[0].transpose() + b[1] * b[1].transpose();
        for (at, [u, v]) in unknowns.columns(*image, entry.sensor, &partials) {
            *right.entry(at).or_insert_with(Vector3::zeros) += b[0] * u + b[1] * v;
        }
    }
    let inverse = normal.try_inverse()?;
    Some(right.into_iter().map(|(at, w)| (at, -(inverse * w))).collect())
}

/// Expected effect of orientation errors on a pair, over the points it sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairEffect {
    /// Root mean square error along the mean optical axis, metres.
    pub depth_m: f64,
    /// The same after the best plane of each realisation is subtracted, metres: the error that remains after registration.
    pub depth_off_plane_m: f64,
    /// Root mean square y-parallax, pixels.
    pub y_parallax_px: f64,
}

/// Derivatives of one point of a pair.
#[derive(Debug, Clone)]
pub struct PointError {
    /// For every unknown with an effect: its position, and the shift of the intersected point, metres a unit.
    pub moved: Vec<(usize, Vector3<f64>)>,
    /// For the same unknowns: y-parallax, pixels a unit.
    pub y_parallax: Vec<(usize, f64)>,
}

/// Derivatives of the intersection of two images by their orientation; `None` where a point has no pixel in one of them.
pub fn intersection(
    cameras: &Cameras,
    unknowns: &Unknowns,
    pair: [usize; 2],
    point: &Vector3<f64>,
) -> Option<PointError> {
    let mut b = Matrix4x3::zeros();
    let mut columns: Vec<(usize, Vector4<f64>)> = Vec::new();
    for (side, image) in pair.into_iter().enumerate() {
        let image_ref = &cameras.images[image];
        let partials = Partials::new(&Camera::new(cameras.sensor(image_ref), image_ref), point)?;
        for row in 0..2 {
            for axis in 0..3 {
                b[(2 * side + row, axis)] = partials.point[row][axis];
            }
        }
        for (at, [u, v]) in unknowns.columns(image, image_ref.sensor, &partials) {
            let place = columns.iter().position(|(other, _)| *other == at).unwrap_or_else(|| {
                columns.push((at, Vector4::zeros()));
                columns.len() - 1
            });
            columns[place].1[2 * side] += u;
            columns[place].1[2 * side + 1] += v;
        }
    }
    let solver = (b.transpose() * b).try_inverse()? * b.transpose();
    // The direction of the contradiction between the four coordinates: orthogonal to all columns of B.
    let residual = |a: &Vector4<f64>| a - b * (solver * a);
    let across = (0..4)
        .map(|k| residual(&Vector4::ith(k, 1.0)))
        .fold(Vector4::zeros(), |best: Vector4<f64>, r| if r.norm() > best.norm() { r } else { best });
    let across = across.normalize() * std::f64::consts::SQRT_2;
    Some(PointError {
        moved: columns.iter().map(|(at, a)| (*at, -(solver * a))).collect(),
        y_parallax: columns.iter().map(|(at, a)| (*at, across.dot(a))).collect(),
    })
}

/// The expected effect of a covariance on a pair; `None` where fewer than four points lie in both images.
pub fn pair_effect(
    cameras: &Cameras,
    unknowns: &Unknowns,
    covariance: &DMatrix<f64>,
    pair: [usize; 2],
    points: &[Vector3<f64>],
) -> Option<PairEffect> {
    let axis = (cameras.images[pair[0]].axis() + cameras.images[pair[1]].axis()).normalize();
    let seen: Vec<(&Vector3<f64>, PointError)> =
        points.iter().filter_map(|point| Some((point, intersection(cameras, unknowns, pair, point)?))).collect();
    if seen.len() < 4 {
        return None;
    }
    let depth = |error: &PointError| error.moved.iter().map(|(at, d)| (*at, d.dot(&axis))).collect::<Vec<_>>();
    let depths: Vec<Vec<(usize, f64)>> = seen.iter().map(|(_, error)| depth(error)).collect();
    let places: Vec<&Vector3<f64>> = seen.iter().map(|(point, _)| *point).collect();
    let mean = |variances: f64| (variances.max(0.0) / seen.len() as f64).sqrt();
    Some(PairEffect {
        depth_m: mean(depths.iter().map(|row| variance(row, covariance)).sum()),
        depth_off_plane_m: rms_off_plane(&places, &depths, &axis, covariance)?,
        y_parallax_px: mean(seen.iter().map(|(_, error)| variance(&error.y_parallax, covariance)).sum()),
    })
}

/// Root mean square of a field with derivatives `rows`, after the best plane over `axis` of each realisation is subtracted.
pub fn rms_off_plane(
    points: &[&Vector3<f64>],
    rows: &[Vec<(usize, f64)>],
    axis: &Vector3<f64>,
    covariance: &DMatrix<f64>,
) -> Option<f64> {
    if points.len() < 4 {
        return None;
    }
    let field = sandwich(rows, covariance);
    let trace = (off_plane(points, axis)? * field).trace();
    Some((trace.max(0.0) / points.len() as f64).sqrt())
}

/// `g Sigma g^T` of a sparse row.
pub fn variance(row: &[(usize, f64)], covariance: &DMatrix<f64>) -> f64 {
    row.iter().map(|(i, a)| a * row.iter().map(|(j, b)| covariance[(*i, *j)] * b).sum::<f64>()).sum()
}

/// `J Sigma J^T` of sparse rows.
fn sandwich(rows: &[Vec<(usize, f64)>], covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let spread = |row: &Vec<(usize, f64)>| {
        let at = |i: usize| row.iter().map(|(j, b)| covariance[(*j, i)] * b).sum::<f64>();
        (0..covariance.nrows()).map(at).collect::<Vec<f64>>()
    };
    let spread: Vec<Vec<f64>> = rows.iter().map(spread).collect();
    DMatrix::from_fn(rows.len(), rows.len(), |r, c| rows[r].iter().map(|(i, a)| a * spread[c][*i]).sum())
}

/// The projector that subtracts the best plane over the axis from values at points.
fn off_plane(points: &[&Vector3<f64>], axis: &Vector3<f64>) -> Option<DMatrix<f64>> {
    let helper = if axis.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let (u, v) = (axis.cross(&helper).normalize(), axis.cross(&axis.cross(&helper)).normalize());
    let middle = points.iter().fold(Vector3::zeros(), |sum, point| sum + *point) / points.len() as f64;
    let design = DMatrix::from_fn(points.len(), 3, |i, j| match j {
        0 => 1.0,
        1 => (points[i] - middle).dot(&u),
        _ => (points[i] - middle).dot(&v),
    });
    let inner = (design.transpose() * &design).try_inverse()?;
    Some(DMatrix::identity(points.len(), points.len()) - &design * inner * design.transpose())
}
