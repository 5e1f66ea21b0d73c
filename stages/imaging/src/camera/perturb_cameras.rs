//! `perturb-cameras`: draws the orientation errors of one epoch, jointly from a bundle block covariance or one by one.

use crate::camera::covariance_sampling::{JointRoot, block_only};
use crate::camera::orientation_parameters::{EXTERIOR, INTERIOR, Parameter, correct};
use rockface_core::artefact::{Cameras, Covariance, Kind};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

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
        let ([x, y, z], [cx, cy]) = (self.position_m, self.principal_point_px);
        let ([k1, k2, k3, k4], [p1, p2]) = (self.k, self.p);
        match parameter {
            Parameter::Exterior(_, place) => [rx, ry, rz, x, y, z][place],
            Parameter::Interior(_, place) => [self.focal_px, cx, cy, 0.0, 0.0, k1, k2, k3, k4, p1, p2][place],
        }
    }

    fn numbers(&self) -> impl Iterator<Item = f64> {
        let exterior = (0..EXTERIOR.len()).map(|place| Parameter::Exterior(0, place));
        let interior = (0..INTERIOR.len()).map(|place| Parameter::Interior(0, place));
        exterior.chain(interior).map(|parameter| self.of(parameter))
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
        /// Systematic error added to every image and sensor in every model; `scale` leaves it alone.
        shift: Offsets = Offsets::default(),
    }
}

/// The stage.
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
            Model::Independent => params.independent.numbers().any(|sd| sd != 0.0),
            Model::None => false,
        };
        something && params.scale > 0.0 && (params.exterior || params.interior)
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
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let cameras: &Cameras = inputs.one("cameras")?;
        let covariance: Option<&Covariance> = inputs.optional("covariance")?;
        let mut errors = match params.model {
            Model::Covariance => joint(params, cameras, covariance, context)?,
            Model::Independent => independent(params, cameras, context),
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

fn independent(params: &PerturbCamerasParams, cameras: &Cameras, context: &Context) -> Vec<(Parameter, f64)> {
    let error = |parameter: Parameter| {
        let sd = params.scale * params.independent.of(parameter);
        (sd != 0.0).then(|| (parameter, sd * draw(context, &parameter.name(cameras))))
    };
    all(cameras).filter_map(error).collect()
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
    if let Some(warning) = block_only(covariance) {
        context.warn(warning);
    }
    let find = |name: &String| Parameter::find(cameras, name);
    let parameters = covariance.parameters.iter().map(find).collect::<Result<Vec<_>, _>>()?;
    let root = JointRoot::new(covariance)?;
    if params.scale == 0.0 {
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
