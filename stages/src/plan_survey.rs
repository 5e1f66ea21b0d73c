//! `plan-survey`: places a stereo pair before a face and says how well it will see it.

use nalgebra::{Matrix3, Vector3};

use crate::artefact::{Cameras, Frame, Image, Kind, Mesh, Sensor};
use crate::kernel::orientation::quaternion;
use crate::kernel::overlap::{Views, sample_vertices};
use crate::params::{Fault, Range};
use crate::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

/// Vertices looked at for what the pair sees.
const SAMPLES: usize = 20_000;

choice! {
    /// Where the two cameras look.
    pub enum Aim {
        /// Both at the centre of the face: convergent axes.
        Centroid = "centroid",
        /// Straight at the plane of the face: parallel axes.
        Parallel = "parallel",
    }
}

params! {
    /// Parameters of `plan-survey`.
    pub struct PlanSurveyParams {
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
        /// Distance of the cameras from the mean plane of the face, metres.
        distance_m: f64 = 87.0; Range::Positive,
        /// Distance of the two projection centres, metres.
        baseline_m: f64 = 32.6; Range::Positive,
        /// How much higher than the centre of the face both cameras stand, metres.
        height_offset_m: f64 = 0.0,
        /// Where they look.
        aim: Aim = Aim::Centroid,
    }
}

/// The stage.
pub struct PlanSurvey;

impl Stage for PlanSurvey {
    type Params = PlanSurveyParams;
    const NAME: &'static str = "plan-survey";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Places the two cameras of a fixed stereo station before a face: images `left` and `right`, one shared sensor \
               `camera` without distortion. Logs ground sampling distance, base-to-distance ratio, expected depth \
               precision, convergence and the share of the face both images hold.",
        method: "Normal or convergent case of stereo photogrammetry: GSD = Z / f, one pixel of disparity is Z^2 / (B f) in \
                 depth. The defaults are the station of the paper's Hunter Valley site (two 45.4 MP cameras, 85 mm; paper \
                 2.3). Occlusion is not looked at.",
        frames: "The mesh and the cameras are in the wall frame, metres; camera x is horizontal, y down, z forward.",
        fails: "When the mesh is not in the wall frame (transform-crs takes it there), or a camera would stand behind or \
                inside the face: increase distance_m.",
        example: "rockface: 1\nname: plan-survey\nseed: 1\nsteps:\n  face: {stage: synthesise-face}\n  survey:\n    \
                  stage: plan-survey\n    in: {mesh: face.mesh}\n    \
                  with: {width_px: 1900, height_px: 1600, focal_px: 4545, distance_m: 20, baseline_m: 7.3}\n",
    };
    const INPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The face, in the wall frame.")];
    const OUTPUTS: &'static [Port] = &[Port::one("cameras", &[Kind::Cameras], "The images `left` and `right`.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        if params.focal_px.is_some() && (params.focal_mm.is_some() || params.pixel_um.is_some()) {
            let mut fault = Fault::new("give `focal_px`, or `focal_mm` and `pixel_um`, not both");
            fault.path = vec!["focal_px".to_owned()];
            return vec![fault];
        }
        Vec::new()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mesh: &Mesh = inputs.one("mesh")?;
        let face = Face::of(mesh)?;
        let sensor = sensor(params);
        let half = Vector3::new(0.5 * params.baseline_m, 0.0, 0.0);
        let middle = face.centre + Vector3::new(0.0, params.height_offset_m, params.distance_m);
        face.check_before(middle.z, params.distance_m)?;
        let target = |centre: &Vector3<f64>| match params.aim {
            Aim::Centroid => face.centre,
            Aim::Parallel => centre - Vector3::z(),
        };
        let image = |name: &str, centre: Vector3<f64>| looking(name, centre, target(&centre));
        let images = vec![image("left", middle - half), image("right", middle + half)];
        let cameras = Cameras { frame: Frame::Wall, sensors: vec![sensor], images };
        report(params, &face, mesh, &cameras, context);
        Ok(Outputs::of("cameras", cameras))
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

/// An image with horizontal x axis that looks from a centre to a target.
fn looking(name: &str, centre: Vector3<f64>, target: Vector3<f64>) -> Image {
    let z = (target - centre).normalize();
    let x = z.cross(&Vector3::y()).normalize();
    let rotation = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    let mut image =
        Image { name: name.to_owned(), sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: centre.into() };
    image.set_rotation(&quaternion(&rotation));
    image
}

/// The extent of a face in the wall frame, metres.
struct Face {
    /// Centre of the bounding box in X and Y, mean of the vertices in Z.
    centre: Vector3<f64>,
    width_m: f64,
    height_m: f64,
    nearest_z: f64,
}

impl Face {
    fn of(mesh: &Mesh) -> Result<Self, StageError> {
        if mesh.frame != Frame::Wall {
            let error = StageError::new(format!(
                "the mesh is in the {} frame, a survey is planned in the wall frame",
                mesh.frame
            ));
            return Err(error.hint("send the mesh through transform-crs first"));
        }
        if mesh.vertices.is_empty() {
            fail!("the mesh has no vertices");
        }
        let start = Vector3::repeat(f64::INFINITY);
        let vertices = || mesh.vertices.iter().map(|vertex| Vector3::from(*vertex));
        let low = vertices().fold(start, |low, vertex| low.inf(&vertex));
        let high = vertices().fold(-start, |high, vertex| high.sup(&vertex));
        let mean_z = mesh.vertices.iter().map(|vertex| vertex[2]).sum::<f64>() / mesh.vertices.len() as f64;
        let centre = Vector3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), mean_z);
        Ok(Self { centre, width_m: high.x - low.x, height_m: high.y - low.y, nearest_z: high.z })
    }

    fn check_before(&self, z: f64, distance_m: f64) -> Result<(), StageError> {
        if z > self.nearest_z {
            return Ok(());
        }
        let relief = self.nearest_z - self.centre.z;
        Err(StageError::new(format!(
            "the cameras would stand inside or behind the face: {distance_m} m from its mean plane, while rock stands out {relief:.3} m"
        ))
        .hint(format!("distance_m must be well above {relief:.3}; or the face looks away: its Z must point to the viewer")))
    }
}

fn report(params: &PlanSurveyParams, face: &Face, mesh: &Mesh, cameras: &Cameras, context: &Context) {
    let (b, f) = (params.baseline_m, cameras.sensors[0].f);
    // Stations above or below the face that look at it are further away than its plane.
    let rise = if params.aim == Aim::Centroid { params.height_offset_m } else { 0.0 };
    let z = (params.distance_m * params.distance_m + rise * rise).sqrt();
    let (width, height) = (f64::from(params.width_px) * z / f, f64::from(params.height_px) * z / f);
    context.metric("gsd", z / f, "m");
    context.metric("base_to_distance", b / z, "1");
    context.metric("depth_per_pixel", z * z / (b * f), "m");
    context.note(format!(
        "one image covers {width:.2} x {height:.2} m at the mean distance; the face measures {:.2} x {:.2} m",
        face.width_m, face.height_m
    ));
    let points = sample_vertices(mesh, SAMPLES);
    let views = Views::new(cameras, &points);
    let share = views.shared_count(0, 1) as f64 / points.len() as f64;
    context.metric("share_of_face_in_both", share, "1");
    match views.pair(0, 1) {
        Ok(pair) => context.metric("convergence", pair.convergence_rad.to_degrees(), "deg"),
        Err(why) => context.warn(format!("the two images are no stereo pair: {why}")),
    }
    if share < 0.5 {
        context.warn(format!("only {:.1} % of the face lies in both images", 100.0 * share));
    }
    context.headline(format!(
        "stereo pair: GSD {:.2} mm, B/Z {:.3}, {:.2} mm of depth per pixel, {:.1} % of the face in both images",
        1000.0 * z / f,
        b / z,
        1000.0 * z * z / (b * f),
        100.0 * share
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Artefact;
    use crate::kernel::camera::Camera;
    use crate::params::ParamType;
    use crate::testing::TestHost;
    use serde_json::{Value, json};
    use std::sync::Arc;

    fn face(frame: Frame) -> Mesh {
        let vertices =
            (0..21).flat_map(|i| (0..21).map(move |j| [f64::from(i), f64::from(j), 0.5 * f64::from((i + j) % 2)]));
        let vertices: Vec<_> = vertices.collect();
        Mesh { frame, vertices, triangles: vec![[0, 1, 22]], colours: Vec::new() }
    }

    fn plan(host: &TestHost, mesh: Mesh, with: &Value) -> Result<Cameras, StageError> {
        let mut inputs = Inputs::default();
        inputs.push("mesh", crate::Point::new(), Arc::new(mesh.into()));
        let made = PlanSurvey::run(&PlanSurveyParams::decode(with).unwrap(), &inputs, &Context::new(host))?;
        match made.into_inner().remove("cameras") {
            Some(Artefact::Cameras(cameras)) => Ok(cameras),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_default_station_has_the_figures_of_the_paper() {
        let host = TestHost::default();
        let cameras = plan(&host, face(Frame::Wall), &json!({})).unwrap();
        assert!((host.metric("gsd").unwrap() - 0.00445).abs() < 1e-5);
        assert!((host.metric("depth_per_pixel").unwrap() - 0.01188).abs() < 1e-5);
        // Both axes meet at the centre: 2 atan(16.3 / 87).
        let expected = 2.0 * crate::kernel::precise::atan(16.3 / 87.0).to_degrees();
        assert!((host.metric("convergence").unwrap() - expected).abs() < 1e-9);
        assert_eq!(host.metric("share_of_face_in_both"), Some(1.0));
        let mean_z = 0.5 * 220.0 / 441.0;
        for image in &cameras.images {
            let [u, v] = Camera::new(&cameras.sensors[0], image).project(&Vector3::new(10.0, 10.0, mean_z)).unwrap();
            assert!((u - 4127.5).abs() < 1e-6 && (v - 2751.5).abs() < 1e-6, "{u} {v}");
            assert!(image.matrix()[(0, 1)].abs() < 1e-12, "x is horizontal");
        }
        assert_eq!(cameras.images[0].name, "left");
        assert!(
            (cameras.images[1].centre() - cameras.images[0].centre() - Vector3::new(32.6, 0.0, 0.0)).norm() < 1e-12
        );
    }

    #[test]
    fn parallel_axes_look_straight_with_x_right_and_y_down() {
        let with = json!({"aim": "parallel", "height_offset_m": 2.0, "distance_m": 40, "baseline_m": 4});
        let cameras = plan(&TestHost::default(), face(Frame::Wall), &with).unwrap();
        let expected = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        assert!(cameras.images.iter().all(|image| (image.matrix() - expected).norm() < 1e-15));
        assert!((cameras.images[0].centre_m[1] - 12.0).abs() < 1e-12);
    }

    #[test]
    fn impossible_stations_are_refused() {
        let near = plan(&TestHost::default(), face(Frame::Wall), &json!({"distance_m": 0.1})).unwrap_err();
        assert!(near.message.contains("inside or behind"), "{near}");
        let world = plan(&TestHost::default(), face(Frame::World), &json!({})).unwrap_err();
        assert!(world.message.contains("world frame") && world.hint.unwrap().contains("transform-crs"));
        let both = PlanSurveyParams::decode(&json!({"focal_px": 4545, "pixel_um": 4})).unwrap();
        assert_eq!(PlanSurvey::check(&both)[0].path, ["focal_px"]);
    }
}
