//! Fine registration of two organised surfaces: trimmed iterative closest points, to points or to planes.

use nalgebra::{Matrix3, Matrix6, Rotation3, SymmetricEigen, Vector3, Vector6};
use rayon::prelude::*;

use rockface_core::artefact::{Surface, Transform};
use rockface_core::{StageError, fail};

use super::nearest::{Columns, Partner, local};
use super::normals::{Neighbourhood, Normals};

mod noise;

/// Automatic search distance, in point spacings of the target; no errors of two surveys in one datum are larger.
pub const AUTOMATIC_SPACINGS: f64 = 20.0;
/// Pairs needed to solve for six unknowns with any confidence.
const LEAST_PAIRS: usize = 50;
/// Share of the points that must find a partner.
const LEAST_OVERLAP: f64 = 0.1;
/// Points whose equations are summed up together; the sums are then added in the order of the points.
const POINTS_AT_A_TIME: usize = 2048;
/// Iterations after which steps are halved.
const FULL_STEPS: usize = 12;
/// The iteration stops when the rotation is smaller than this, radians ...
const STOP_ROTATION_RAD: f64 = 1e-8;
/// ... and the shift smaller than this, metres ...
const STOP_SHIFT_M: f64 = 1e-6;
/// ... or both smaller than this share of their own standard deviations: what is left is noise of the pairing.
const STOP_SHARE: f64 = 0.25;

/// Factor on the noise that distances of pairs in space show: partners are chosen that fit. By trials: with less, normals of the
/// second pass are worse than those of the first from half a spacing of noise on.
const FITTING: f64 = 4.0;

/// What rounding may put a point outside of a triangle on whose edge it is, as a share of its sides.
const EDGE: f64 = 1e-9;

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
    /// Number of iterations after which a pass stops without having converged.
    pub max_iterations: usize,
    /// Least eigenvalue, as a share of the largest, of a direction that the registration may move along.
    pub weak_eigenvalue: f64,
    /// Whether points are held against the surface between the points of the target, along Z, rather than against its points.
    pub between_points: bool,
}

/// The transform that was found, how well it fits, and how certain it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// `target_from_source`, with its origin at the centroid of the points used.
    pub transform: Transform,
    /// Root mean square residual of the pairs kept, metres.
    pub rms_m: f64,
    /// Root mean square motion of the points used, metres.
    pub moved_m: f64,
    /// Mean distance of neighbouring points of the target, metres.
    pub spacing_m: f64,
    /// Number of pairs kept in the last iteration.
    pub pairs: usize,
    /// Number of iterations made, of all passes.
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
    let normals = Normals::new(target, Neighbourhood::WIDEST, arms.len());
    let fit = Fit { source, centroid, target, normals, finer: None, columns, radius_m, search_m, settings: *settings };
    // Relative to the target's origin, so that UTM coordinates keep their precision.
    let start = Pose { rotation: Matrix3::identity(), translation: origin - Vector3::from(target.origin_m) };
    let spacing_m = fit.columns.spacing_m();
    fit.solve_in_passes(&arms, start).map(|(pose, outcome)| {
        let shift = pose.translation - start.translation;
        let squares = arms.iter().map(|arm| (pose.rotation * arm - arm + shift).norm_squared()).sum::<f64>();
        let translation = pose.translation + Vector3::from(target.origin_m);
        Registration {
            transform: Transform::new("source", "target", &pose.rotation, origin, translation),
            moved_m: (squares / arms.len() as f64).sqrt(),
            spacing_m,
            ..outcome
        }
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

/// A point of the source about the centroid, and its partner where it was last.
#[derive(Clone, Default)]
struct Moving {
    arm: Vector3<f64>,
    partner: Partner,
    target: Vector3<f64>,
    normal: Option<Vector3<f64>>,
    /// Of the target, where the point was within it in plan.
    triangle: Option<[usize; 3]>,
    pair: Option<Pair>,
}

/// A point of the source (rotated about the centroid) and its difference from its partner.
#[derive(Clone)]
struct Pair {
    arm: Vector3<f64>,
    offset: Vector3<f64>,
    normal: Vector3<f64>,
}

struct Fit<'a> {
    source: &'a Surface,
    /// Of the points used, relative to the origin of the source.
    centroid: Vector3<f64>,
    target: &'a Surface,
    normals: Normals<'a>,
    /// Normals of later passes; where they have too few points, these take those of the first.
    finer: Option<Normals<'a>>,
    columns: Columns<'a>,
    radius_m: f64,
    search_m: f64,
    settings: Settings,
}

impl Fit<'_> {
    /// The pose of points about their centroid, with wide normals that no noise tilts, and from there with normals no wider than
    /// the noise between the surfaces asks for: wide ones smooth relief away, and the surface with it. That noise is correlated
    /// is seen where narrow normals leave no relief in the residuals: it asks for wider ones again.
    fn solve_in_passes(mut self, arms: &[Vector3<f64>], start: Pose) -> Result<(Pose, Registration), StageError> {
        let mut points: Vec<Moving> = arms.iter().map(|arm| Moving { arm: *arm, ..Moving::default() }).collect();
        let (wide_pose, first) = self.solve(&mut points, start)?;
        if self.settings.method == Method::PointToPoint {
            return Ok((wide_pose, first));
        }
        let white_m = self.white_noise_m(&mut points, &wide_pose);
        let about = self.neighbourhood(white_m);
        if about == Neighbourhood::WIDEST {
            return Ok((wide_pose, first));
        }
        let (pose, second) = self.solve_with(about, &mut points, wide_pose)?;
        let wider = self.neighbourhood(white_m.max(self.correlated_noise_m(&pose)));
        let iterations = first.iterations + second.iterations;
        if wider == about {
            return Ok((pose, Registration { iterations, ..second }));
        }
        if wider == Neighbourhood::WIDEST {
            return Ok((wide_pose, Registration { iterations, ..first }));
        }
        let (pose, third) = self.solve_with(wider, &mut points, pose)?;
        Ok((pose, Registration { iterations: iterations + third.iterations, ..third }))
    }

    fn neighbourhood(&self, noise_m: f64) -> Neighbourhood {
        let fitting = if self.settings.pairing == Pairing::InSpace { FITTING } else { 1.0 };
        Neighbourhood::for_noise(fitting * noise_m / self.columns.spacing_m())
    }

    /// [`Fit::solve`] with other normals than those of the first pass.
    fn solve_with(
        &mut self,
        about: Neighbourhood,
        points: &mut [Moving],
        start: Pose,
    ) -> Result<(Pose, Registration), StageError> {
        self.finer = None;
        self.finer = Some(Normals::new(self.target, about, points.len()));
        points
            .par_iter_mut()
            .for_each(|point| point.normal = point.partner.place().and_then(|place| self.normal(place)));
        self.solve(points, start)
    }

    /// The pose of points about their centroid, from a pose near it.
    fn solve(&self, points: &mut [Moving], start: Pose) -> Result<(Pose, Registration), StageError> {
        let (mut pose, mut iterations) = (start, 0);
        loop {
            let system = self.system(&pose, points)?;
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
            let moved = (pose.translation - start.translation).norm();
            if !moved.is_finite() || moved > 10.0 * (self.search_m + self.radius_m) {
                fail!("the registration ran away after {iterations} iterations: it has moved {moved} m");
            }
            if converged || iterations >= self.settings.max_iterations {
                return Ok((pose, Registration { iterations, converged, ..outcome }));
            }
        }
    }

    /// The equations at a pose.
    fn system(&self, pose: &Pose, points: &mut [Moving]) -> Result<System, StageError> {
        let (all, method) = (points.len(), self.settings.method);
        let sizes = self.pair_all(pose, points);
        let mut sorted: Vec<f64> = sizes.iter().copied().filter(|size| !size.is_nan()).collect();
        let count = sorted.len();
        let least = ((all as f64 * LEAST_OVERLAP) as usize).max(LEAST_PAIRS);
        if count < least {
            let (paired, search) = (count, self.search_m);
            let message = format!(
                "the surfaces do not overlap: {paired} of {all} points have a partner within {search:.3} m, {least} are needed"
            );
            return Err(StageError::new(message).hint("check that both are in one frame, or raise `max_distance_m`"));
        }
        let kept = ((count as f64 * self.settings.trim).ceil() as usize).clamp(1, count);
        let limit = *sorted.select_nth_unstable_by(kept - 1, f64::total_cmp).1;
        let sum = |(sizes, points): (&[f64], &[Moving])| {
            let mut system = System::default();
            let kept = sizes.iter().zip(points).filter(|(size, _)| **size <= limit);
            let pairs = kept.filter_map(|(_, point)| point.pair.as_ref());
            pairs.for_each(|pair| system.add(pair, method, self.radius_m));
            system
        };
        let parts = sizes.par_chunks(POINTS_AT_A_TIME).zip(points.par_chunks(POINTS_AT_A_TIME));
        let systems: Vec<System> = parts.map(sum).collect();
        Ok(systems.iter().fold(System::default(), System::and))
    }

    /// Pairs points at a pose; the distances of the pairs, NaN where there is none.
    fn pair_all(&self, pose: &Pose, points: &mut [Moving]) -> Vec<f64> {
        let mut sizes = vec![f64::NAN; points.len()];
        sizes.par_chunks_mut(POINTS_AT_A_TIME).zip(points.par_chunks_mut(POINTS_AT_A_TIME)).for_each(
            |(sizes, points)| {
                for (size, point) in sizes.iter_mut().zip(points) {
                    self.pair_up(pose, point);
                    *size = point.pair.as_ref().map_or(f64::NAN, |pair| pair.size(self.settings.method));
                }
            },
        );
        sizes
    }

    /// Pairs a point at a pose, where it has a partner with a normal within the search distance.
    fn pair_up(&self, pose: &Pose, moving: &mut Moving) {
        let arm = pose.rotation * moving.arm;
        let at = arm + pose.translation;
        let before = moving.partner.place();
        if let Some(place) = self.columns.follow(&at, self.search_m, &mut moving.partner)
            && before != Some(place)
        {
            moving.normal = self.normal(place);
            moving.target = local(self.target, place);
        }
        moving.pair = moving.normal.and_then(|normal| {
            let offset = self.offset(&at, moving)?;
            (offset.norm_squared() <= self.search_m * self.search_m).then_some(Pair { arm, offset, normal })
        });
    }

    /// From the target to a point, metres; `None` without a partner.
    fn offset(&self, at: &Vector3<f64>, moving: &mut Moving) -> Option<Vector3<f64>> {
        let place = moving.partner.place()?;
        if !self.settings.between_points {
            return Some(at - moving.target);
        }
        Some(Vector3::new(0.0, 0.0, at.z - self.height_m(place, at, &mut moving.triangle)?))
    }

    fn normal(&self, place: usize) -> Option<Vector3<f64>> {
        let finer = self.finer.as_ref().and_then(|normals| normals.at(place));
        finer.or_else(|| self.normals.at(place))
    }

    /// The height of the target in plan at a point, metres, by the triangle it was within last or else by those about the nearest
    /// place; `None` where none covers it. Of several, as where noise folds the surface, the first: the nearest would be the one
    /// whose noise fits.
    fn height_m(&self, place: usize, at: &Vector3<f64>, last: &mut Option<[usize; 3]>) -> Option<f64> {
        if let Some(height_m) = last.and_then(|corners| self.height_within_m(corners, at)) {
            return Some(height_m);
        }
        let (row, column) = (place / self.target.width, place % self.target.width);
        let rows = row.saturating_sub(1)..(row + 1).min(self.target.height - 1);
        let columns = column.saturating_sub(1)..(column + 1).min(self.target.width - 1);
        let squares = rows.flat_map(|row| columns.clone().map(move |column| (row, column)));
        let mut triangles = squares.flat_map(|(row, column)| self.target.triangles(row, column));
        let found = triangles.find_map(|corners| Some((corners, self.height_within_m(corners, at)?)));
        *last = found.map(|(corners, _)| corners);
        found.map(|(_, height_m)| height_m)
    }

    /// The height of a triangle of the target at a point, metres; `None` where it does not cover the point in plan.
    fn height_within_m(&self, corners: [usize; 3], at: &Vector3<f64>) -> Option<f64> {
        let [a, b, c] = corners.map(|corner| local(self.target, corner));
        let (u, v, w) = ((b - a).xy(), (c - a).xy(), (at - a).xy());
        let twice_area = u.perp(&v);
        let (of_b, of_c) = (w.perp(&v) / twice_area, u.perp(&w) / twice_area);
        let is_within = of_b >= -EDGE && of_c >= -EDGE && of_b + of_c <= 1.0 + EDGE;
        is_within.then(|| a.z + of_b * (b.z - a.z) + of_c * (c.z - a.z))
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
    /// Its upper triangle; the lower one stays zero.
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
        for i in 0..6 {
            for j in i..6 {
                self.matrix[(i, j)] += row[i] * row[j];
            }
        }
        self.right -= row * residual;
        self.squares += residual * residual;
        self.equations += 1;
    }

    fn and(self, other: &Self) -> Self {
        Self {
            matrix: self.matrix + other.matrix,
            right: self.right + other.right,
            squares: self.squares + other.squares,
            equations: self.equations + other.equations,
            pairs: self.pairs + other.pairs,
        }
    }

    /// The step, and the quality of the solution it starts from; weak directions are not moved.
    fn solve(&self, weak_eigenvalue: f64, radius_m: f64) -> (Vector6<f64>, Registration) {
        let mut matrix = self.matrix;
        matrix.fill_lower_triangle_with_upper_triangle();
        let eigen = SymmetricEigen::new(matrix);
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
        let outcome = Registration {
            transform: Transform::identity("source", "target"),
            rms_m,
            moved_m: 0.0,
            spacing_m: 0.0,
            pairs: self.pairs,
            iterations: 0,
            converged: false,
            sd,
            unobservable,
            left_alone_m,
        };
        (step, outcome)
    }
}

#[cfg(test)]
mod tests;
