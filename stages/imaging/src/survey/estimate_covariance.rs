//! `estimate-covariance`: the joint covariance that a bundle block adjustment of a planned or imported block would yield.

use nalgebra::{DMatrix, Vector3};

use crate::camera::orientation_parameters::{INTERIOR, Parameter};
use crate::survey::block_adjustment::inverse::{Datum, Inverse, invert};
use crate::survey::block_adjustment::normals::{ObjectPoint, Priors, reduced};
use crate::survey::block_adjustment::propagation::{in_all, pair_effect, stereo_pairs};
use crate::survey::block_adjustment::tie_points::{Visibility, Wanted, control_points, tie_points};
use crate::survey::block_adjustment::unknowns::{FreeInterior, Unknowns};
use crate::survey::surveyed_points::{self, Surveyed};
use rockface_core::artefact::{Cameras, Covariance, Frame, Kind, Mesh, Table, Transform};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

choice! {
    /// What fixes position, orientation and scale of the whole block.
    pub enum DatumKind {
        /// Control points or positions, with their own errors.
        Priors = "priors",
        /// Nothing: the errors of a free block, without the seven that move it as a whole.
        Inner = "inner",
    }
}

params! {
    /// What is known of the interior orientation before the adjustment; null: nothing.
    pub struct InteriorSigma {
        /// Principal distance, pixels.
        focal_px: Option<f64> = None; Range::Positive,
        /// Principal point, pixels.
        principal_point_px: Option<f64> = None; Range::Positive,
        /// Affinity and skew b1, b2, pixels.
        affinity_px: Option<f64> = None; Range::Positive,
        /// Radial distortion k1 to k4.
        k: Option<[f64; 4]> = None; Range::Positive,
        /// Decentring distortion p1, p2.
        p: Option<f64> = None; Range::Positive,
    }
}

impl InteriorSigma {
    fn of(&self, place: usize) -> Option<f64> {
        match place {
            0 => self.focal_px,
            1 | 2 => self.principal_point_px,
            3 | 4 => self.affinity_px,
            5..9 => self.k.map(|k| k[place - 5]),
            _ => self.p,
        }
    }
}

choice! {
    /// Along which axes positions of projection centres are measured.
    pub enum PositionAxes {
        /// Those of the frame of the cameras: in the wall frame X along the face, Y up it, Z out of the rock.
        Cameras = "cameras",
        /// Those of the world: east, north, up.
        World = "world",
    }
}

params! {
    /// Parameters of `estimate-covariance`.
    pub struct EstimateCovarianceParams {
        /// Tie points on the face, drawn evenly over its area.
        tie_points: usize = 400; Range::AtLeast(1.0),
        /// Images a tie point is measured in at most.
        most_images: usize = 8; Range::AtLeast(2.0),
        /// Standard deviation of an image coordinate of a tie point, pixels.
        image_sigma_px: f64 = 0.5; Range::Positive,
        /// Control points, spread over the face and measured in every image that sees them; those of the input `control` take their place.
        control_points: usize = 8,
        /// Standard deviation of each coordinate of a control point, metres; of those of `control` where their rows say none.
        control_sigma_m: f64 = 0.005; Range::Positive,
        /// Standard deviation of an image coordinate of a control point, pixels; null: that of tie points.
        control_sigma_px: Option<f64> = None; Range::Positive,
        /// Standard deviations of X, Y, Z of every projection centre (GNSS); null: not measured.
        position_sigma_m: Option<[f64; 3]> = None; Range::Positive,
        /// Whether these X, Y, Z are the axes of the frame of the cameras or those of the world; null: those of the cameras, with a warning where it matters.
        position_axes: Option<PositionAxes> = None,
        /// Parameters of every sensor that are estimated too, of f, cx, cy, b1, b2, k1 to k4, p1, p2; none: the lens is known.
        free_interior: Vec<String> = Vec::new(),
        /// What is known of them beforehand.
        interior_sigma: InteriorSigma = InteriorSigma::default(),
        /// What fixes the block as a whole.
        datum: DatumKind = DatumKind::Priors,
    }
}

/// How far behind the mesh a control point may be and still be seen, metres.
const BEHIND_M: f64 = 0.5;
/// How far in front of the mesh a control point may be without a warning, metres.
const IN_FRONT_M: f64 = 0.5;
/// Control points that a warning names at most.
const NAMED: usize = 10;
/// Points for the mean effect on a pair.
const EFFECT_POINTS: usize = 120;
/// Pairs whose expected effects are reported.
const EFFECT_PAIRS: usize = 40;

/// Computes the joint covariance of exterior and interior orientation that a bundle adjustment of this block would
/// yield.
pub struct EstimateCovariance;

impl Stage for EstimateCovariance {
    type Params = EstimateCovarianceParams;
    const NAME: &'static str = "estimate-covariance";
    const VERSION: u32 = 5;
    const PAGE: Page = Page::new(include_str!("estimate_covariance.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "The orientation the adjustment is linearised at."),
        Port::one("mesh", &[Kind::Mesh], "The face, in the same frame."),
        Port::optional(
            "control",
            &[Kind::Table],
            "Control points of a survey, instead of those spread over the face: `x_m`, `y_m`, `z_m`, with `sx_m`, `sy_m`, `sz_m` or `sigma_m`.",
        ),
        Port::optional("transform", &[Kind::Transform], "wall_from_world, where `control` is in world coordinates."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("covariance", &[Kind::Covariance], "Full joint covariance, in canonical order."),
        Port::one("precision", &[Kind::Table], "Standard deviation of every parameter."),
    ];

    fn draws(_params: &Self::Params) -> bool {
        true
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let fault = |path: &[&str], message: String| {
            let path = path.iter().map(|&segment| segment.to_owned()).collect();
            Fault { path, ..Fault::new(message) }
        };
        let mut faults = Vec::new();
        for (at, name) in params.free_interior.iter().enumerate() {
            if !INTERIOR.contains(&name.as_str()) {
                let message = format!("`{name}` is no interior parameter: {}", INTERIOR.join(", "));
                faults.push(fault(&["free_interior", &at.to_string()], message));
            } else if params.free_interior[..at].contains(name) {
                faults.push(fault(&["free_interior", &at.to_string()], format!("`{name}` is there twice")));
            }
        }
        if params.datum == DatumKind::Inner {
            if params.control_points != 0 {
                let message = "datum `inner` has no control points: give 0";
                faults.push(fault(&["control_points"], message.to_owned()));
            }
            if params.position_sigma_m.is_some() {
                faults.push(fault(
                    &["position_sigma_m"],
                    "datum `inner` has no measured positions: leave it out".to_owned(),
                ));
            }
        }
        let unused = (0..INTERIOR.len()).find(|place| {
            params.interior_sigma.of(*place).is_some() && !free_places(params).iter().any(|free| alike(*free, *place))
        });
        if let Some(place) = unused {
            let message = format!("the prior of {} is for a parameter that is not in `free_interior`", INTERIOR[place]);
            faults.push(fault(&["interior_sigma"], message));
        }
        faults
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // The mesh with a search tree over its triangles, for visibility; what is known of each tie point.
        inputs.times(2.3, "mesh") + (params.tie_points as u64).min(1 << 40) * (16 << 10)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (cameras, mesh): (&Cameras, &Mesh) = (inputs.one("cameras")?, inputs.one("mesh")?);
        if mesh.frame != cameras.frame {
            let (a, b) = (mesh.frame, cameras.frame);
            let error = StageError::new(format!("the mesh is in the {a} frame, the cameras in the {b} frame"));
            return Err(error.hint("send both through one transform-crs"));
        }
        let surveyed = surveyed(params, cameras, inputs)?;
        let points = object_points(params, cameras, mesh, surveyed.as_deref(), context)?;
        let unknowns = Unknowns::new(cameras, free_interior(params));
        let priors = priors(params, cameras, context)?;
        let normals = reduced(cameras, &unknowns, &points, &priors)?;
        context.check_cancelled()?;
        let inverse = invert(&normals, cameras, &unknowns, datum(params, cameras, &points))?;
        report(&inverse, &unknowns, normals.observations, &points, context);
        report_pairs(cameras, &unknowns, &inverse.covariance, &points, context);
        let parameters = unknowns.parameters();
        let precision = precision(&parameters, cameras, &inverse.covariance);
        let covariance = Covariance {
            frame: cameras.frame,
            parameters: parameters.iter().map(|parameter| parameter.name(cameras)).collect(),
            matrix: inverse.covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
            sigma0_applied: true,
            full_joint: true,
        };
        Ok(Outputs::of("covariance", covariance).and("precision", precision))
    }
}

/// Whether two interior parameters share their prior.
fn alike(a: usize, b: usize) -> bool {
    let group = |place: usize| match place {
        0 => 0,
        1 | 2 => 1,
        3 | 4 => 2,
        5..9 => 3,
        _ => 4,
    };
    group(a) == group(b)
}

fn free_places(params: &EstimateCovarianceParams) -> Vec<usize> {
    params.free_interior.iter().filter_map(|name| INTERIOR.iter().position(|known| known == name)).collect()
}

/// What GNSS says of projection centres, in the frame of the cameras.
fn priors(params: &EstimateCovarianceParams, cameras: &Cameras, context: &Context) -> Result<Priors, StageError> {
    let Some(sigma_m) = params.position_sigma_m else { return Ok(Priors::default()) };
    let along_cameras = Priors { position_sigma_m: Some(sigma_m), cameras_from_measured: None };
    let way = cameras.frame.wall_from_world().filter(|way| cameras.frame == Frame::Wall && !way.is_identity());
    match (params.position_axes, way) {
        (Some(PositionAxes::World), Some(way)) => {
            Ok(Priors { cameras_from_measured: Some(way.matrix()), ..along_cameras })
        }
        (Some(PositionAxes::World), None) if cameras.frame == Frame::Wall => {
            let error = StageError::new("`position_axes: world` needs to know how the wall stands in the world");
            Err(error.hint(
                "send mesh and cameras through `transform-crs`, or give the standard deviations along the wall's axes",
            ))
        }
        (None, Some(_)) if sigma_m.iter().any(|sigma| (sigma - sigma_m[0]).abs() > 0.0) => {
            context.warn(
                "`position_sigma_m` counts along the axes of the wall, Z out of the rock; for GNSS, whose Z is up, set \
                 `position_axes: world`, or `cameras` if this is meant",
            );
            Ok(along_cameras)
        }
        _ => Ok(along_cameras),
    }
}

fn free_interior(params: &EstimateCovarianceParams) -> Vec<FreeInterior> {
    let free = |place| FreeInterior { place, sigma: params.interior_sigma.of(place) };
    free_places(params).into_iter().map(free).collect()
}

/// Tie points and control points, tie points first.
fn object_points(
    params: &EstimateCovarianceParams,
    cameras: &Cameras,
    mesh: &Mesh,
    surveyed: Option<&[Surveyed]>,
    context: &Context,
) -> Result<Vec<ObjectPoint>, StageError> {
    let visibility = Visibility::new(cameras, mesh);
    let (count, most_images, sigma_px) = (params.tie_points, params.most_images, params.image_sigma_px);
    let mut random = context.stream("tie-points", "").generator();
    let mut points = tie_points(mesh, &visibility, &Wanted { count, most_images, sigma_px }, &mut random);
    if points.is_empty() {
        let behind = (0..cameras.images.len()).any(|image| visibility.is_behind(image));
        let hint = if behind {
            "images show only the back of the face: check frames and orientation, or turn its triangles"
        } else {
            "check frames and orientation, or plan the block with more overlap"
        };
        return Err(StageError::new("no part of the face lies in two images: there are no tie points").hint(hint));
    }
    if points.len() < count {
        context.warn(format!("only {} of {count} tie points: little of the face lies in two images", points.len()));
    }
    for (image, entry) in cameras.images.iter().enumerate() {
        let rays = points.iter().filter(|point| point.images.contains(&image)).count();
        if rays < 3 && visibility.is_behind(image) {
            return Err(StageError::new(format!("image `{}` shows only the back of the face", entry.name))
                .hint("leave it out of the block, or turn the triangles if all images do"));
        }
        if rays < 3 {
            fail!("image `{}` has {rays} tie points, three are needed: more `tie_points`, or leave it out", entry.name);
        }
    }
    let control_sigma_px = params.control_sigma_px.unwrap_or(sigma_px);
    let control = match surveyed {
        Some(surveyed) => measured(surveyed, &visibility, control_sigma_px, cameras, context)?,
        None => control_points(&points, &visibility, params.control_points, control_sigma_px, params.control_sigma_m),
    };
    points.extend(control);
    Ok(points)
}

/// The control points that are given, in the frame of the cameras.
fn surveyed(
    params: &EstimateCovarianceParams,
    cameras: &Cameras,
    inputs: &Inputs,
) -> Result<Option<Vec<Surveyed>>, StageError> {
    let transform = inputs.optional::<Transform>("transform")?;
    let Some(table) = inputs.optional::<Table>("control")? else {
        if transform.is_some() {
            fail!("`transform` moves the points of `control`, which is not given");
        }
        return Ok(None);
    };
    if params.datum == DatumKind::Inner {
        fail!("datum `inner` has no control points: leave `control` out");
    }
    surveyed_points::read(table, params.control_sigma_m, cameras.frame, transform).map(Some)
}

/// Those of the given control points that two images see.
fn measured(
    surveyed: &[Surveyed],
    visibility: &Visibility,
    sigma_px: f64,
    cameras: &Cameras,
    context: &Context,
) -> Result<Vec<ObjectPoint>, StageError> {
    if surveyed.is_empty() {
        fail!("`control` has no rows");
    }
    let (mut points, mut left_out, mut in_front) = (Vec::new(), Vec::new(), Vec::new());
    let mut hidden = 0;
    for Surveyed { name, position_m, weight } in surveyed {
        let name = if name.is_empty() { "(no name)" } else { name.as_str() };
        let images = visibility.images_near(position_m, BEHIND_M);
        if images.len() < 2 {
            left_out.push(name);
            hidden += usize::from(visibility.images_near(position_m, f64::INFINITY).len() >= 2);
            continue;
        }
        let ahead_m = visibility.in_front_m(position_m).filter(|ahead_m| *ahead_m > IN_FRONT_M);
        in_front.extend(ahead_m.map(|ahead_m| format!("{name} ({ahead_m:.1} m)")));
        points.push(ObjectPoint { position_m: *position_m, images, sigma_px, control_weight: Some(*weight) });
    }
    if points.is_empty() {
        let from_camera = |position_m: Vector3<f64>| {
            cameras.images.iter().map(move |image| (image.centre() - position_m).norm()).fold(f64::INFINITY, f64::min)
        };
        let nearest_m = surveyed.iter().map(|point| from_camera(point.position_m)).fold(f64::INFINITY, f64::min);
        let message = format!(
            "no point of `control`, of {} in it, is seen by two images; the nearest is {nearest_m:.1} m from a camera",
            surveyed.len()
        );
        let hint = if hidden > 0 {
            "they project into the images and are behind the mesh by more than half a metre: their frame, or the mesh, is another"
        } else if cameras.frame == Frame::Wall {
            "they have to be in the wall frame, as the cameras are: points in map coordinates need `transform` of `transform-crs` here; with it, look for eastings and \
             northings that are swapped, and for wrong digits"
        } else {
            "they have to be in the frame of the cameras, in metres: look for eastings and northings that are swapped, and for wrong digits"
        };
        return Err(StageError::new(message).hint(hint));
    }
    if !left_out.is_empty() {
        context.warn(format!(
            "left out of `control`, as fewer than two images see them ({hidden} behind the mesh, {} outside of the images): {}",
            left_out.len() - hidden,
            first_of(&left_out)
        ));
    }
    if !in_front.is_empty() {
        context.warn(format!(
            "points of `control` in front of the mesh: {}; unless they are on the ground before it, look for another frame, another unit or wrong digits",
            first_of(&in_front)
        ));
    }
    Ok(points)
}

/// The first names, for a warning.
fn first_of<T: AsRef<str>>(names: &[T]) -> String {
    let listed: Vec<&str> = names.iter().take(NAMED).map(AsRef::as_ref).collect();
    let more = if names.len() > NAMED { ", ..." } else { "" };
    format!("{}{more}", listed.join(", "))
}

fn datum(params: &EstimateCovarianceParams, cameras: &Cameras, points: &[ObjectPoint]) -> Datum {
    if params.datum == DatumKind::Priors {
        return Datum::Priors;
    }
    let distances = points
        .iter()
        .flat_map(|point| point.images.iter().map(|image| (cameras.images[*image].centre() - point.position_m).norm()));
    let (count, sum) = distances.fold((0.0, 0.0), |(count, sum), distance| (count + 1.0, sum + distance));
    Datum::Inner { distance_m: sum / count }
}

fn unit(parameter: Parameter) -> &'static str {
    match parameter {
        Parameter::Exterior(_, 0..3) => "rad",
        Parameter::Exterior(..) => "m",
        Parameter::Interior(_, 0..5) => "px",
        Parameter::Interior(..) => "1",
    }
}

fn precision(parameters: &[Parameter], cameras: &Cameras, covariance: &DMatrix<f64>) -> Table {
    let mut table = Table::new(["parameter", "sigma", "unit"]);
    for (at, parameter) in parameters.iter().enumerate() {
        let sigma = covariance[(at, at)].max(0.0).sqrt();
        table.push(vec![parameter.name(cameras).into(), sigma.into(), unit(*parameter).into()]);
    }
    table
}

fn report(inverse: &Inverse, unknowns: &Unknowns, observations: usize, points: &[ObjectPoint], context: &Context) {
    let parameters = unknowns.parameters();
    let rms = |is: &dyn Fn(Parameter) -> bool| {
        let variances: Vec<f64> =
            (0..parameters.len()).filter(|i| is(parameters[*i])).map(|i| inverse.covariance[(i, i)]).collect();
        (variances.iter().sum::<f64>() / variances.len() as f64).max(0.0).sqrt()
    };
    context.metric("rotation_sigma_rms", rms(&|p| matches!(p, Parameter::Exterior(_, 0..3))), "rad");
    context.metric("position_sigma_rms", rms(&|p| matches!(p, Parameter::Exterior(_, 3..))), "m");
    context.metric("condition", inverse.condition, "1");
    let control = points.iter().filter(|point| point.control_weight.is_some()).count();
    let rays = points.iter().map(|point| point.images.len()).sum::<usize>() as f64 / points.len() as f64;
    context.note(format!(
        "{observations} image coordinates of {} tie points and {control} control points ({rays:.1} images each), {} \
         orientation parameters",
        points.len() - control,
        parameters.len()
    ));
}

/// Logs the effect of the covariance on pairs of neighbouring images: the physical check of a joint covariance.
fn report_pairs(
    cameras: &Cameras,
    unknowns: &Unknowns,
    covariance: &DMatrix<f64>,
    points: &[ObjectPoint],
    context: &Context,
) {
    let places: Vec<Vector3<f64>> = points.iter().map(|point| point.position_m).collect();
    let images = cameras.images.len();
    let pairs = stereo_pairs(cameras, &places).into_iter().take(EFFECT_PAIRS);
    let effect = |pair: [usize; 2]| {
        let mut shared = in_all(cameras, &pair, &places);
        shared.truncate(EFFECT_POINTS);
        pair_effect(cameras, unknowns, covariance, pair, &shared)
    };
    let effects: Vec<_> = pairs.filter_map(effect).collect();
    if effects.is_empty() {
        context.warn("no two images make a stereo pair: expected depth errors are not reported");
        return;
    }
    let rms = |of: &dyn Fn(usize) -> f64| {
        ((0..effects.len()).map(|i| of(i) * of(i)).sum::<f64>() / effects.len() as f64).sqrt()
    };
    let depth = rms(&|i| effects[i].depth_m);
    let off_plane = rms(&|i| effects[i].depth_off_plane_m);
    let parallax = rms(&|i| effects[i].y_parallax_px);
    context.metric("expected_depth_error", depth, "m");
    context.metric("expected_depth_error_off_plane", off_plane, "m");
    context.metric("expected_y_parallax", parallax, "px");
    context.headline(format!(
        "{images} images: orientation errors of {:.1} mm in depth, {:.2} mm after a plane, y-parallax {parallax:.3} px",
        1000.0 * depth,
        1000.0 * off_plane
    ));
}

#[cfg(test)]
mod tests;
