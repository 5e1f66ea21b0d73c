//! `perturb-cameras`: draws the orientation errors of one epoch, jointly from a bundle block covariance or one by one.

mod rules;

use crate::camera::covariance_sampling::{JointRoot, block_only};
use crate::camera::orientation_parameters::{EXTERIOR, INTERIOR, Parameter, correct};
use rockface_core::artefact::candidates::Quantity;
use rockface_core::artefact::{Cameras, Covariance, Kind};
use rockface_core::distribution::Draws;
use rockface_core::format::distribution_file::with_files_read;
use rockface_core::params::{Fault, FileRef, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};
use rules::Rules;

choice! {
    /// Where the errors come from.
    pub enum Model {
        /// One joint draw from the covariance of the bundle block adjustment.
        Covariance = "covariance",
        /// Every parameter by itself, with the standard deviations of `independent`.
        Independent = "independent",
        /// Nothing is drawn.
        None = "none",
    }
}

params! {
    /// One number for each orientation parameter of an image and of a sensor.
    pub struct Offsets {
        /// Rotation about the camera's own x, y, z axes, degrees.
        rotation_deg: [f64; 3] = [0.0; 3],
        /// Projection centre along X, Y, Z of the block's frame, metres.
        position_m: [f64; 3] = [0.0; 3],
        /// Principal distance, pixels.
        focal_px: f64 = 0.0,
        /// Principal point in x, y, pixels.
        principal_point_px: [f64; 2] = [0.0; 2],
        /// Affinity b1 and skew b2, pixels.
        affinity_px: [f64; 2] = [0.0; 2],
        /// Radial distortion k1 to k4.
        k: [f64; 4] = [0.0; 4],
        /// Decentring distortion p1, p2.
        p: [f64; 2] = [0.0; 2],
    }
}

impl Offsets {
    /// The number of a parameter, in rad, m, px or 1.
    fn of(&self, parameter: Parameter) -> f64 {
        let [rx, ry, rz] = self.rotation_deg.map(f64::to_radians);
        let ([x, y, z], [cx, cy], [b1, b2]) = (self.position_m, self.principal_point_px, self.affinity_px);
        let ([k1, k2, k3, k4], [p1, p2]) = (self.k, self.p);
        match parameter {
            Parameter::Exterior(_, place) => [rx, ry, rz, x, y, z][place],
            Parameter::Interior(_, place) => [self.focal_px, cx, cy, b1, b2, k1, k2, k3, k4, p1, p2][place],
        }
    }

    fn numbers(&self) -> impl Iterator<Item = f64> {
        let exterior = (0..EXTERIOR.len()).map(|place| Parameter::Exterior(0, place));
        let interior = (0..INTERIOR.len()).map(|place| Parameter::Interior(0, place));
        exterior.chain(interior).map(|parameter| self.of(parameter))
    }
}

params! {
    /// Errors of some parameters of some images or sensors, drawn from any distribution.
    pub struct ErrorOf {
        /// The parameters, each drawn by itself: rx, ry, rz (degrees), X, Y, Z (metres), f, cx, cy, b1, b2 (pixels), k1 to k4, p1, p2.
        of: Vec<String>,
        /// The images (rx to Z) or sensors (f to p2) by name; null: all.
        at: Option<Vec<String>> = None,
        /// The error in their unit: a number, or a distribution it is drawn from.
        error: Quantity,
    }
}

params! {
    /// Parameters of `perturb-cameras`.
    pub struct PerturbCamerasParams {
        /// Where the errors come from.
        model: Model = Model::Covariance,
        /// Factor on every draw: the covariance counts scale^2 times.
        scale: f64 = 1.0; Range::NonNegative,
        /// Whether rotations and projection centres change; false: they stay put.
        exterior: bool = true,
        /// Whether principal distance, principal point and distortion change; false: they stay put.
        interior: bool = true,
        /// Standard deviations of model `independent`, the same for every image and sensor.
        independent: Offsets = Offsets::default(),
        /// Errors of model `independent` from other distributions, or for single images and sensors. Where several are for one
        /// parameter the last one counts, and all of them instead of `independent`.
        errors: Vec<ErrorOf> = Vec::new(),
        /// Whether a covariance without the covariances between images is drawn from all the same. It tears the images apart.
        allow_blocks: bool = false,
        /// Systematic error added to every image and sensor in every model; `scale` leaves it alone.
        shift: Offsets = Offsets::default(),
    }
}

impl PerturbCamerasParams {
    /// Whether any draw can have an effect.
    fn moves_something(&self) -> bool {
        self.scale > 0.0 && (self.exterior || self.interior)
    }
}

/// Draws the estimated orientation of an epoch: the true orientation plus random errors.
pub struct PerturbCameras;

impl Stage for PerturbCameras {
    type Params = PerturbCamerasParams;
    const NAME: &'static str = "perturb-cameras";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("perturb_cameras.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "The true orientation."),
        Port::optional("covariance", &[Kind::Covariance], "Joint covariance; needed by model `covariance`."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("cameras", &[Kind::Cameras], "The estimated orientation.")];

    fn draws(params: &Self::Params) -> bool {
        let something = match params.model {
            Model::Covariance => true,
            Model::Independent => params.independent.numbers().any(|sd| sd != 0.0) || !params.errors.is_empty(),
            Model::None => false,
        };
        something && params.moves_something()
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let fault = |path: &str, message: &str| {
            let mut fault = Fault::new(message);
            fault.path = vec![path.to_owned()];
            fault
        };
        let mut faults = Vec::new();
        if params.independent.numbers().any(|sd| sd < 0.0) {
            faults.push(fault("independent", "a standard deviation cannot be negative"));
        }
        if params.model != Model::Independent && params.independent != Offsets::default() {
            faults.push(fault("independent", "only model `independent` uses these standard deviations"));
        }
        if params.model != Model::Independent && !params.errors.is_empty() {
            faults.push(fault("errors", "only model `independent` uses these distributions"));
        }
        faults.extend(params.errors.iter().enumerate().flat_map(|(at, rule)| rule.faults(at)));
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let cameras: &Cameras = inputs.one("cameras")?;
        let covariance: Option<&Covariance> = inputs.optional("covariance")?;
        let mut errors = match params.model {
            Model::Covariance => joint(params, cameras, covariance, context)?,
            Model::Independent => independent(params, cameras, context)?,
            Model::None => Vec::new(),
        };
        if params.model != Model::Covariance && covariance.is_some() {
            context.note("the covariance is not used by this model");
        }
        let moves = |parameter: Parameter| if parameter.is_exterior() { params.exterior } else { params.interior };
        errors.retain(|(parameter, _)| moves(*parameter));
        report(&errors, context);
        let shifts = all(cameras).map(|parameter| (parameter, params.shift.of(parameter)));
        errors.extend(shifts.filter(|(parameter, shift)| *shift != 0.0 && moves(*parameter)));
        Ok(Outputs::of("cameras", correct(cameras, &errors)?))
    }
}

/// Every parameter of a block: its images in order, then its sensors.
fn all(cameras: &Cameras) -> impl Iterator<Item = Parameter> {
    let (images, sensors) = (cameras.images.len(), cameras.sensors.len());
    let exterior = (0..images).flat_map(|i| (0..EXTERIOR.len()).map(move |place| Parameter::Exterior(i, place)));
    exterior.chain((0..sensors).flat_map(|i| (0..INTERIOR.len()).map(move |place| Parameter::Interior(i, place))))
}

/// The standard normal draw of a parameter; it depends on its name only, not on other parameters.
fn draw(context: &Context, name: &str) -> f64 {
    context.stream("orientation", name).field().normal(0, 0)
}

fn independent(
    params: &PerturbCamerasParams,
    cameras: &Cameras,
    context: &Context,
) -> Result<Vec<(Parameter, f64)>, StageError> {
    let read = |path: &str| context.read(&FileRef(path.to_owned()));
    let rules = with_files_read(&params.errors, &read).map_err(|e| e.within("`errors`"))?;
    let rules = Rules::of(&rules, cameras)?;
    if !params.moves_something() {
        return Ok(Vec::new());
    }
    let mut errors = Vec::new();
    for parameter in all(cameras) {
        let name = parameter.name(cameras);
        let sd = params.independent.of(parameter);
        let error = match rules.of_parameter(parameter) {
            Some(quantity) => {
                let draws = Draws::new(context.stream("orientation-error", &name), 0);
                let drawn = draws.value("error", quantity).unwrap_or_default();
                if matches!(parameter, Parameter::Exterior(_, 0..3)) { drawn.to_radians() } else { drawn }
            }
            None if sd != 0.0 => sd * draw(context, &name),
            None => 0.0,
        };
        if error != 0.0 {
            errors.push((parameter, params.scale * error));
        }
    }
    Ok(errors)
}

fn joint(
    params: &PerturbCamerasParams,
    cameras: &Cameras,
    covariance: Option<&Covariance>,
    context: &Context,
) -> Result<Vec<(Parameter, f64)>, StageError> {
    let Some(covariance) = covariance.filter(|covariance| !covariance.parameters.is_empty()) else {
        let error = StageError::new("model `covariance` needs a covariance with parameters, there is none");
        return Err(error.hint("name the covariance file in import-cameras, or use model: independent"));
    };
    if covariance.frame != cameras.frame {
        fail!("the covariance is in the {} frame, the cameras in the {} frame", covariance.frame, cameras.frame);
    }
    if let Some(finding) = block_only(covariance) {
        if !params.allow_blocks {
            let hint = "`estimate-covariance` computes the joint covariance of a block; `allow_blocks: true` draws from this one";
            return Err(StageError::new(finding).hint(hint));
        }
        context.warn(finding);
    }
    let find = |name: &String| Parameter::find(cameras, name);
    let parameters = covariance.parameters.iter().map(find).collect::<Result<Vec<_>, _>>()?;
    let root = JointRoot::new(covariance)?;
    if !params.moves_something() {
        return Ok(Vec::new());
    }
    let z: Vec<f64> = parameters.iter().map(|parameter| draw(context, &parameter.name(cameras))).collect();
    let errors = root.correlate(&z).into_iter().map(|error| params.scale * error);
    Ok(parameters.into_iter().zip(errors).collect())
}

/// Logs the root mean square of the drawn errors of each kind.
fn report(errors: &[(Parameter, f64)], context: &Context) {
    let is_rotation = |p: Parameter| matches!(p, Parameter::Exterior(_, 0..3));
    let is_position = |p: Parameter| matches!(p, Parameter::Exterior(_, 3..));
    let is_focal = |p: Parameter| matches!(p, Parameter::Interior(_, 0));
    let is_point = |p: Parameter| matches!(p, Parameter::Interior(_, 1 | 2));
    let metric = |name: &str, unit: &str, is: &dyn Fn(Parameter) -> bool| {
        let squares: Vec<f64> = errors.iter().filter(|(p, _)| is(*p)).map(|(_, error)| error * error).collect();
        if !squares.is_empty() {
            context.metric(name, (squares.iter().sum::<f64>() / squares.len() as f64).sqrt(), unit);
        }
    };
    metric("rotation_error_rms", "rad", &is_rotation);
    metric("position_error_rms", "m", &is_position);
    metric("focal_error_rms", "px", &is_focal);
    metric("principal_point_error_rms", "px", &is_point);
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests;
