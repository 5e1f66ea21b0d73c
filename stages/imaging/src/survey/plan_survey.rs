//! `plan-survey`: places the images of a survey before a face and reports how well they cover it.

use nalgebra::Vector3;

use crate::camera::model::Camera;
use crate::survey::face::Face;
use crate::survey::overlap::{Views, depths_seen};
use crate::survey::stations::{Strips, count_to_cover, looking, scatter};
use rockface_core::artefact::{Cameras, Frame, Image, Kind, Mesh, Sensor};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

/// Vertices sampled for the coverage of the images.
const SAMPLES: usize = 20_000;
/// Most images of a block.
const MAXIMUM_IMAGES: usize = 10_000;
/// Default overlap of neighbouring images.
const USUAL_OVERLAP: f64 = 0.8;

choice! {
    /// How images are arranged.
    pub enum Block {
        /// Two images side by side: `left` and `right`.
        Pair = "pair",
        /// Strips of images, flown once for every direction: `r01c01`, ...
        Strips = "strips",
    }
}

choice! {
    /// Where the two cameras of a pair look.
    pub enum Aim {
        /// Both at the centre of the face: convergent axes.
        Centroid = "centroid",
        /// Straight at the plane of the face: parallel axes.
        Parallel = "parallel",
    }
}

choice! {
    /// What the stations of strips keep their distance from.
    pub enum Follow {
        /// The mean plane of the face.
        Plane = "plane",
        /// The rock nearby.
        Terrain = "terrain",
    }
}

choice! {
    /// How many camera bodies take the images; each has an interior orientation of its own.
    pub enum Bodies {
        /// One takes all images: one sensor, `camera`.
        One = "one",
        /// One for each image, as at a fixed station: sensors with the names of the images.
        Each = "each",
    }
}

params! {
    /// Parameters of `plan-survey`.
    pub struct PlanSurveyParams {
        /// How images are arranged.
        block: Block = Block::Pair,
        /// How many camera bodies take the images; null: one for each image of a pair, one for all of strips.
        bodies: Option<Bodies> = None,
        /// Columns of the sensor.
        width_px: u32 = 8256; Range::AtLeast(1.0),
        /// Rows of the sensor.
        height_px: u32 = 5504; Range::AtLeast(1.0),
        /// Principal distance in pixels; null: from `focal_mm` and `pixel_um`.
        focal_px: Option<f64> = None; Range::Positive,
        /// Principal distance in millimetres; null: from `focal_px`, or 85 where that is null too.
        focal_mm: Option<f64> = None; Range::Positive,
        /// Size of a pixel in micrometres; null: from `focal_px`, or 4.35 where that is null too.
        pixel_um: Option<f64> = None; Range::Positive,
        /// Distance of the stations from the face, metres; null: from `gsd_m`, or 87 where that is null too.
        distance_m: Option<f64> = None; Range::Positive,
        /// Size of a pixel on the face, metres; null: from `distance_m`.
        gsd_m: Option<f64> = None; Range::Positive,
        /// Distance of the two projection centres of a pair, metres; null: from `overlap`, or 32.6 where that is null too.
        baseline_m: Option<f64> = None; Range::Positive,
        /// How much higher than the centre of the face both cameras of a pair stand, metres.
        height_offset_m: f64 = 0.0,
        /// Where the cameras of a pair look; null: at the centroid.
        aim: Option<Aim> = None,
        /// Share of an image that the next one along the strip has too; null: 0.8 for strips.
        overlap: Option<f64> = None; Range::Between(0.0, 0.99),
        /// Share of an image that the next strip has too; null: 0.8 for strips.
        sidelap: Option<f64> = None; Range::Between(0.0, 0.99),
        /// Images of a strip; null: as many as cover the width of the face.
        columns: Option<usize> = None; Range::AtLeast(1.0),
        /// Strips; null: as many as cover the height of the face.
        rows: Option<usize> = None; Range::AtLeast(1.0),
        /// Yaw (to the right) and pitch (up) of the axes from straight at the face, degrees: strips are flown for each.
        directions_deg: Vec<[f64; 2]> = vec![[0.0, 0.0]]; Range::Between(-60.0, 60.0),
        /// What the stations of strips keep their distance from.
        follow: Follow = Follow::Plane,
        /// How well a station is met again: standard deviations of X, Y, Z, metres.
        position_sigma_m: [f64; 3] = [0.0; 3]; Range::NonNegative,
        /// How well its pointing is met again: standard deviations about the camera's own x, y, z, degrees.
        pointing_sigma_deg: [f64; 3] = [0.0; 3]; Range::NonNegative,
    }
}

/// Places the images of a survey before a face.
pub struct PlanSurvey;

impl Stage for PlanSurvey {
    type Params = PlanSurveyParams;
    const NAME: &'static str = "plan-survey";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("plan_survey.md"));
    const INPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The face, in the wall frame.")];
    const OUTPUTS: &'static [Port] = &[Port::one("cameras", &[Kind::Cameras], "The sensors and the images.")];

    fn draws(params: &Self::Params) -> bool {
        params.position_sigma_m.iter().chain(&params.pointing_sigma_deg).any(|sigma| *sigma > 0.0)
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut fault = |name: &str, text: &str| faults.push(Fault { path: vec![name.to_owned()], ..Fault::new(text) });
        if params.focal_px.is_some() && (params.focal_mm.is_some() || params.pixel_um.is_some()) {
            fault("focal_px", "give `focal_px`, or `focal_mm` and `pixel_um`, not both");
        }
        if params.distance_m.is_some() && params.gsd_m.is_some() {
            fault("gsd_m", "give `distance_m` or `gsd_m`, not both");
        }
        if params.baseline_m.is_some() && params.overlap.is_some() {
            fault("overlap", "give `baseline_m` or `overlap`, not both");
        }
        let of_pair = [
            ("baseline_m", params.baseline_m.is_some()),
            ("height_offset_m", params.height_offset_m != 0.0),
            ("aim", params.aim.is_some()),
        ];
        let of_strips = [
            ("sidelap", params.sidelap.is_some()),
            ("columns", params.columns.is_some()),
            ("rows", params.rows.is_some()),
            ("directions_deg", params.directions_deg != [[0.0, 0.0]]),
            ("follow", params.follow == Follow::Terrain),
        ];
        let (foreign, of) = match params.block {
            Block::Pair => (&of_strips[..], "only block `strips` has it"),
            Block::Strips => (&of_pair[..], "only block `pair` has it"),
        };
        foreign.iter().filter(|(_, given)| *given).for_each(|(name, _)| fault(name, of));
        if params.directions_deg.is_empty() {
            fault("directions_deg", "one direction at least is needed: [[0, 0]] looks straight at the face");
        }
        faults
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // A plane through the mesh, and a camera after the other.
        inputs.total() + (4 << 20)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let face = Face::of(inputs.one::<Mesh>("mesh")?, SAMPLES)?;
        let sensor = sensor(params);
        let plan = Plan::new(params, &sensor);
        let mut images = match params.block {
            Block::Pair => pair(params, &plan, &face)?,
            Block::Strips => strips(params, &plan, &face)?,
        };
        for image in &mut images {
            if Self::draws(params) {
                let field = context.stream("viewpoint", &image.name).field();
                scatter(image, params.position_sigma_m, params.pointing_sigma_deg, &field);
            }
            face.check_before(&image.centre(), plan.footprint_m.map(|side| 0.25 * side), plan.distance_m)?;
        }
        let cameras = with_bodies(params, sensor, images);
        report(params, &plan, &face, &cameras, context);
        Ok(Outputs::of("cameras", cameras))
    }
}

/// The block: all images by one sensor, or each by one of its own.
fn with_bodies(params: &PlanSurveyParams, sensor: Sensor, mut images: Vec<Image>) -> Cameras {
    let usual = if params.block == Block::Pair { Bodies::Each } else { Bodies::One };
    let sensors = match params.bodies.unwrap_or(usual) {
        Bodies::One => vec![sensor],
        Bodies::Each => {
            images.iter_mut().enumerate().for_each(|(number, image)| image.sensor = number);
            images.iter().map(|image| Sensor { name: image.name.clone(), ..sensor.clone() }).collect()
        }
    };
    Cameras { frame: Frame::Wall, sensors, images }
}

/// Figures that follow from sensor and distance.
struct Plan {
    distance_m: f64,
    focal_px: f64,
    /// Size of the face in an image at right angles, metres.
    footprint_m: [f64; 2],
    /// Distance of neighbours along a strip and of strips, or the baseline of a pair.
    step_m: [f64; 2],
}

impl Plan {
    fn new(params: &PlanSurveyParams, sensor: &Sensor) -> Self {
        let distance_m = params.distance_m.or(params.gsd_m.map(|gsd| gsd * sensor.f)).unwrap_or(87.0);
        let footprint_m = [sensor.width_px, sensor.height_px].map(|side| f64::from(side) * distance_m / sensor.f);
        let step = |overlap: Option<f64>, side: f64| (1.0 - overlap.unwrap_or(USUAL_OVERLAP)) * side;
        let along = match (params.block, params.baseline_m, params.overlap) {
            (Block::Pair, None, None) => 32.6,
            (Block::Pair, Some(baseline), _) => baseline,
            _ => step(params.overlap, footprint_m[0]),
        };
        let step_m = [along, step(params.sidelap, footprint_m[1])];
        Self { distance_m, focal_px: sensor.f, footprint_m, step_m }
    }
}

fn sensor(params: &PlanSurveyParams) -> Sensor {
    let (width, height) = (f64::from(params.width_px), f64::from(params.height_px));
    let from_lens = || params.focal_mm.unwrap_or(85.0) * 1000.0 / params.pixel_um.unwrap_or(4.35);
    Sensor {
        name: "camera".to_owned(),
        width_px: params.width_px,
        height_px: params.height_px,
        f: params.focal_px.unwrap_or_else(from_lens),
        cx: 0.5 * (width - 1.0),
        cy: 0.5 * (height - 1.0),
        b1: 0.0,
        b2: 0.0,
        k: [0.0; 4],
        p: [0.0; 2],
    }
}

fn pair(params: &PlanSurveyParams, plan: &Plan, face: &Face) -> Result<Vec<Image>, StageError> {
    let half = Vector3::new(0.5 * plan.step_m[0], 0.0, 0.0);
    let middle = face.centre + Vector3::new(0.0, params.height_offset_m, plan.distance_m);
    // A pair stands before all of the face, wherever rock stands out.
    face.check_before(&middle, [f64::INFINITY; 2], plan.distance_m)?;
    let target = |centre: &Vector3<f64>| match params.aim.unwrap_or(Aim::Centroid) {
        Aim::Centroid => face.centre,
        Aim::Parallel => centre - Vector3::z(),
    };
    let image = |name: &str, centre: Vector3<f64>| looking(name, centre, target(&centre));
    Ok(vec![image("left", middle - half), image("right", middle + half)])
}

fn strips(params: &PlanSurveyParams, plan: &Plan, face: &Face) -> Result<Vec<Image>, StageError> {
    let columns = params.columns.unwrap_or_else(|| count_to_cover(face.width_m, plan.step_m[0]));
    let rows = params.rows.unwrap_or_else(|| count_to_cover(face.height_m, plan.step_m[1]));
    let images = columns.saturating_mul(rows).saturating_mul(params.directions_deg.len());
    if images > MAXIMUM_IMAGES {
        let message = format!("{columns} x {rows} images in {} directions: {images}", params.directions_deg.len());
        return Err(StageError::new(format!("{message}, more than {MAXIMUM_IMAGES}"))
            .hint("less overlap, more distance_m, or columns and rows by hand; or is the face not in metres?"));
    }
    let strips = Strips {
        distance_m: plan.distance_m,
        step_m: plan.step_m,
        counts: [columns, rows],
        directions_deg: params.directions_deg.clone(),
        follow: params.follow == Follow::Terrain,
    };
    Ok(strips.images(face, plan.footprint_m))
}

fn report(params: &PlanSurveyParams, plan: &Plan, face: &Face, cameras: &Cameras, context: &Context) {
    let (b, f) = (plan.step_m[0], plan.focal_px);
    // Stations above or below the face are further away from it than from its plane.
    let looks_at_centre = params.block == Block::Pair && params.aim != Some(Aim::Parallel);
    let rise = if looks_at_centre { params.height_offset_m } else { 0.0 };
    let z = (plan.distance_m * plan.distance_m + rise * rise).sqrt();
    let [width, height] = plan.footprint_m.map(|side| side * z / plan.distance_m);
    context.metric("gsd", z / f, "m");
    context.metric("base_to_distance", b / z, "1");
    context.metric("depth_per_pixel", z * z / (b * f), "m");
    context.note(format!(
        "one image covers {width:.2} x {height:.2} m at the mean distance; the face measures {:.2} x {:.2} m",
        face.width_m, face.height_m
    ));
    let geometry = format!(
        "GSD {:.2} mm, B/Z {:.3}, {:.2} mm of depth per pixel",
        1000.0 * z / f,
        b / z,
        1000.0 * z * z / (b * f)
    );
    match params.block {
        Block::Pair => report_pair(face, cameras, &geometry, context),
        Block::Strips => report_strips(face, cameras, &geometry, context),
    }
}

fn report_pair(face: &Face, cameras: &Cameras, geometry: &str, context: &Context) {
    let views = Views::new(cameras, &face.samples);
    let share = views.shared_count(0, 1) as f64 / face.samples.len() as f64;
    context.metric("share_of_face_in_both", share, "1");
    match views.pair(0, 1) {
        Ok(pair) => context.metric("convergence", pair.convergence_rad.to_degrees(), "deg"),
        Err(why) => context.warn(format!("the two images are no stereo pair: {why}")),
    }
    if share < 0.5 {
        context.warn(format!("only {:.1} % of the face lies in both images", 100.0 * share));
    }
    context.headline(format!("stereo pair: {geometry}, {:.1} % of the face in both images", 100.0 * share));
}

fn report_strips(face: &Face, cameras: &Cameras, geometry: &str, context: &Context) {
    let mut counts = vec![0u32; face.samples.len()];
    for image in &cameras.images {
        let depths = depths_seen(&Camera::new(cameras.sensor(image), image), &face.samples);
        counts.iter_mut().zip(&depths).for_each(|(count, depth)| *count += u32::from(depth.is_some()));
    }
    let samples = face.samples.len() as f64;
    let stereo = counts.iter().filter(|count| **count >= 2).count() as f64 / samples;
    let mean = f64::from(counts.iter().sum::<u32>()) / samples;
    context.metric("images", cameras.images.len() as f64, "1");
    context.metric("images_of_a_point", mean, "1");
    context.metric("share_of_face_in_two", stereo, "1");
    if stereo < 0.95 {
        context.warn(format!("{:.1} % of the face lies in fewer than two images", 100.0 * (1.0 - stereo)));
    }
    context.headline(format!(
        "{} images: {geometry}, a point of the face lies in {mean:.1} images, {:.1} % of it in two or more",
        cameras.images.len(),
        100.0 * stereo
    ));
}

#[cfg(test)]
mod tests;
