//! Fine registration of two organised surfaces: trimmed iterative closest points, to points or to planes.

use nalgebra::{Matrix3, Matrix6, Rotation3, SymmetricEigen, Vector3, Vector6};
use rayon::prelude::*;

use rockface_core::artefact::{Surface, Transform};
use rockface_core::{StageError, fail};

use super::nearest::{Columns, local};
use super::normals::Normals;

/// Automatic search distance, in point spacings of the target.
const AUTOMATIC_SPACINGS: f64 = 20.0;
/// Pairs needed to solve for six unknowns with any confidence.
const LEAST_PAIRS: usize = 50;
/// Share of the points that must find a partner.
const LEAST_OVERLAP: f64 = 0.1;
/// Iterations after which steps are halved.
const FULL_STEPS: usize = 12;
/// The iteration stops when the rotation is smaller than this, radians ...
const STOP_ROTATION_RAD: f64 = 1e-8;
/// ... and the shift smaller than this, metres ...
const STOP_SHIFT_M: f64 = 1e-6;
/// ... or both smaller than this share of their own standard deviations: what is left is noise of the pairing.
const STOP_SHARE: f64 = 0.25;

/// Which distances between paired points are minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Distances to the tangent plane of the nearest point (Chen and Medioni 1992).
    PointToPlane,
    /// Distances to the nearest point (Besl and `McKay` 1992).
    PointToPoint,
}

/// Which point of the target is paired with a point of the source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pairing {
    /// The nearest in X and Y, as in a comparison of rasters. Noise along Z does not affect the pairing.
    InPlan,
    /// The nearest in space. Among many noisy points it picks the one that fits, so residuals are underestimated and every step
    /// is too short.
    InSpace,
}

/// Method and limits of a registration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// The distances that are minimised.
    pub method: Method,
    /// How points are paired.
    pub pairing: Pairing,
    /// Share of the pairs kept, the closest first (Chetverikov et al. 2005).
    pub trim: f64,
    /// Largest distance of a pair, metres; `None`: automatic.
    pub max_distance_m: Option<f64>,
    /// Approximate number of points of the source that are used.
    pub points: usize,
    /// Number of iterations after which it stops without having converged.
    pub max_iterations: usize,
    /// Least eigenvalue, as a share of the largest, of a direction that the registration may move along.
    pub weak_eigenvalue: f64,
}

/// The transform that was found, how well it fits, and how certain it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// `target_from_source`, with its origin at the centroid of the points used.
    pub transform: Transform,
    /// Root mean square residual of the pairs kept, metres.
    pub rms_m: f64,
    /// Number of pairs kept in the last iteration.
    pub pairs: usize,
    /// Number of iterations made.
    pub iterations: usize,
    /// Whether the last step was smaller than the limits.
    pub converged: bool,
    /// Formal standard deviation of the rotation about X, Y, Z (rad) and of the shift along them (m).
    pub sd: [f64; 6],
    /// Directions the surface does not determine: unit vectors of rotation (times the radius of the points) and shift.
    pub unobservable: Vec<[f64; 6]>,
    /// For each of them: the motion along it that least squares would make, metres, and what leaving it out does to the differences of
    /// the surfaces, root mean square along the normals, metres.
    pub left_alone_m: Vec<[f64; 2]>,
}

/// Registers the source on the target.
///
/// # Errors
/// Too few points or pairs, no overlap within the search distance, or a solution that diverges.
pub fn register(source: &Surface, target: &Surface, settings: &Settings) -> Result<Registration, StageError> {
    let columns = Columns::new(target, settings.pairing == Pairing::InPlan)
        .ok_or_else(|| StageError::new("the target has no points"))?;
    let points = sample(source, settings.points);
    if points.len() < LEAST_PAIRS {
        fail!("the source has {} points to use, {LEAST_PAIRS} are needed", points.len());
    }
    let centroid = points.iter().fold(Vector3::zeros(), |sum, p| sum + p) / points.len() as f64;
    let arms: Vec<Vector3<f64>> = points.iter().map(|p| p - centroid).collect();
    let radius_m = (arms.iter().fold(0.0, |sum, a| sum + a.norm_squared()) / arms.len() as f64).sqrt();
    let origin = Vector3::from(source.origin_m) + centroid;
    let search_m = settings.max_distance_m.unwrap_or(AUTOMATIC_SPACINGS * columns.spacing_m());
    let fit = Fit { target, normals: Normals::new(target), columns, arms, radius_m, search_m, settings: *settings };
    // Relative to the target's origin, so that UTM coordinates keep their precision.
    let start = origin - Vector3::from(target.origin_m);
    fit.solve(start).map(|(pose, outcome)| {
        let translation = pose.translation + Vector3::from(target.origin_m);
        Registration { transform: Transform::new("source", "target", &pose.rotation, origin, translation), ..outcome }
    })
}

/// Points of a surface relative to its origin: every n-th row and column.
fn sample(surface: &Surface, wanted: usize) -> Vec<Vector3<f64>> {
    let valid = surface.points.iter().filter(|p| !p[0].is_nan()).count();
    let stride = ((valid as f64 / wanted.max(1) as f64).sqrt() as usize).max(1);
    let rows = (stride / 2..surface.height).step_by(stride);
    let places = rows.flat_map(|row| (stride / 2..surface.width).step_by(stride).map(move |c| row * surface.width + c));
    places.filter(|place| !surface.points[*place][0].is_nan()).map(|place| local(surface, place)).collect()
}

#[derive(Debug, Clone, Copy)]
struct Pose {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

/// A point of the source (rotated about the centroid) and its difference from its partner.
struct Pair {
    arm: Vector3<f64>,
    offset: Vector3<f64>,
    normal: Vector3<f64>,
}

struct Fit<'a> {
    target: &'a Surface,
    normals: Normals<'a>,
    columns: Columns<'a>,
    arms: Vec<Vector3<f64>>,
    radius_m: f64,
    search_m: f64,
    settings: Settings,
}

impl Fit<'_> {
    fn solve(&self, start: Vector3<f64>) -> Result<(Pose, Registration), StageError> {
        let mut pose = Pose { rotation: Matrix3::identity(), translation: start };
        let mut iterations = 0;
        let mut partners = vec![None; self.arms.len()];
        loop {
            let system = self.system(&pose, &mut partners)?;
            let (step, outcome) = system.solve(self.settings.weak_eigenvalue, self.radius_m);
            let (turn, shift) = (step.fixed_rows::<3>(0) / self.radius_m, step.fixed_rows::<3>(3).into_owned());
            iterations += 1;
            // Without damping, pairs that alternate would make the solution oscillate for ever.
            let share = if iterations > FULL_STEPS { 0.5 } else { 1.0 };
            let (turn, shift): (Vector3<f64>, Vector3<f64>) = (turn * share, shift * share);
            let small = |k: usize, step: f64, floor: f64| step.abs() < (outcome.sd[k] * STOP_SHARE).max(floor);
            let converged =
                (0..3).all(|k| small(k, turn[k], STOP_ROTATION_RAD) && small(3 + k, shift[k], STOP_SHIFT_M));
            pose.rotation = Rotation3::new(turn).into_inner() * pose.rotation;
            pose.translation += shift;
            let moved = (pose.translation - start).norm();
            if !moved.is_finite() || moved > 10.0 * (self.search_m + self.radius_m) {
                fail!("the registration ran away after {iterations} iterations: it has moved {moved} m");
            }
            if converged || iterations >= self.settings.max_iterations {
                return Ok((pose, Registration { iterations, converged, ..outcome }));
            }
        }
    }

    /// The equations at a pose. `partners` are the places the points were paired with before, and are now.
    fn system(&self, pose: &Pose, partners: &mut [Option<usize>]) -> Result<System, StageError> {
        let points = self.arms.par_iter().zip(partners);
        let pairs: Vec<Option<Pair>> = points.map(|(arm, partner)| self.pair(pose, arm, partner)).collect();
        let pairs: Vec<Pair> = pairs.into_iter().flatten().collect();
        let least = ((self.arms.len() as f64 * LEAST_OVERLAP) as usize).max(LEAST_PAIRS);
        if pairs.len() < least {
            let (paired, all, search) = (pairs.len(), self.arms.len(), self.search_m);
            let message = format!(
                "the surfaces do not overlap: {paired} of {all} points have a partner within {search:.3} m, {least} are needed"
            );
            return Err(StageError::new(message).hint("check that both are in one frame, or raise `max_distance_m`"));
        }
        let method = self.settings.method;
        let mut sizes: Vec<f64> = pairs.iter().map(|pair| pair.size(method)).collect();
        let kept = ((pairs.len() as f64 * self.settings.trim).ceil() as usize).clamp(1, pairs.len());
        let limit = *sizes.select_nth_unstable_by(kept - 1, f64::total_cmp).1;
        let mut system = System::default();
        pairs.iter().filter(|p| p.size(method) <= limit).for_each(|p| system.add(p, method, self.radius_m));
        Ok(system)
    }

    fn pair(&self, pose: &Pose, arm: &Vector3<f64>, partner: &mut Option<usize>) -> Option<Pair> {
        let arm = pose.rotation * arm;
        let point = arm + pose.translation;
        *partner = self.columns.nearest_near(&point, self.search_m, *partner);
        let place = (*partner)?;
        let normal = self.normals.at(place)?;
        let offset = point - local(self.target, place);
        (offset.norm_squared() <= self.search_m * self.search_m).then_some(Pair { arm, offset, normal })
    }
}

impl Pair {
    fn size(&self, method: Method) -> f64 {
        match method {
            Method::PointToPlane => self.offset.dot(&self.normal).abs(),
            Method::PointToPoint => self.offset.norm(),
        }
    }
}

/// Normal equations for a small rotation (times the radius of the points) and a shift.
#[derive(Default)]
struct System {
    matrix: Matrix6<f64>,
    right: Vector6<f64>,
    squares: f64,
    equations: usize,
    pairs: usize,
}

impl System {
    fn add(&mut self, pair: &Pair, method: Method, radius_m: f64) {
        self.pairs += 1;
        match method {
            Method::PointToPlane => self.add_equation(pair, &pair.normal, radius_m),
            Method::PointToPoint => {
                for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                    self.add_equation(pair, &axis, radius_m);
                }
            }
        }
    }

    fn add_equation(&mut self, pair: &Pair, direction: &Vector3<f64>, radius_m: f64) {
        let residual = pair.offset.dot(direction);
        let turn = pair.arm.cross(direction) / radius_m;
        let row = Vector6::new(turn.x, turn.y, turn.z, direction.x, direction.y, direction.z);
        self.matrix += row * row.transpose();
        self.right -= row * residual;
        self.squares += residual * residual;
        self.equations += 1;
    }

    /// The step, and the quality of the solution it starts from; weak directions are not moved.
    fn solve(&self, weak_eigenvalue: f64, radius_m: f64) -> (Vector6<f64>, Registration) {
        let eigen = SymmetricEigen::new(self.matrix);
        let least = eigen.eigenvalues.max() * weak_eigenvalue;
        let (mut step, mut cofactors) = (Vector6::zeros(), Matrix6::zeros());
        let (mut unobservable, mut left_alone_m) = (Vec::new(), Vec::new());
        for (index, value) in eigen.eigenvalues.iter().enumerate() {
            let direction = eigen.eigenvectors.column(index).into_owned();
            if *value <= least || *value <= 0.0 {
                unobservable.push(direction.into());
                let pull = direction.dot(&self.right);
                let full = if *value > 0.0 { pull / value } else { 0.0 };
                left_alone_m.push([full.abs(), full.abs() * (value.max(0.0) / self.equations.max(1) as f64).sqrt()]);
            } else {
                step += direction * (direction.dot(&self.right) / value);
                cofactors += direction * direction.transpose() / *value;
            }
        }
        let freedom = (self.equations + unobservable.len()).saturating_sub(6).max(1);
        let variance = self.squares / freedom as f64;
        let unit = |k: usize| if k < 3 { radius_m } else { 1.0 };
        let sd = std::array::from_fn(|k| (variance * cofactors[(k, k)]).sqrt() / unit(k));
        let rms_m = (self.squares / self.pairs.max(1) as f64).sqrt();
        let transform = Transform::identity("source", "target");
        let pairs = self.pairs;
        (
            step,
            Registration { transform, rms_m, pairs, iterations: 0, converged: false, sd, unobservable, left_alone_m },
        )
    }
}

#[cfg(test)]
mod tests;
