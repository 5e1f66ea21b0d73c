//! What COLMAP's text and binary models share: camera models by name and number, and poses as `X_c = R X + t`.
//!
//! COLMAP counts pixels from the corner of the first one, rockface from its centre. A COLMAP model that is not Brown-Conrady, or
//! a sensor that no COLMAP model can hold, is an error that names it: nothing is approximated.

use std::collections::{HashMap, HashSet};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use rockface_core::artefact::{Image, Sensor};
use rockface_core::names::twice;
use rockface_core::{StageError, fail};

/// Offset from the pixel coordinates of rockface to those of COLMAP.
const HALF_PIXEL: f64 = 0.5;

const HELD: &str = "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV with k4 = k5 = k6 = 0";

/// COLMAP's camera models by number: name and count of parameters.
const MODELS: [(&str, usize); 12] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
];

/// Name and count of parameters of a model by its number.
pub fn model(number: i32) -> Result<(&'static str, usize), StageError> {
    let model = usize::try_from(number).ok().and_then(|at| MODELS.get(at));
    model
        .copied()
        .ok_or_else(|| StageError::new(format!("camera model number {number} is none of COLMAP's")).hint(way_out()))
}

/// The number of a model by its name.
pub fn number_of(name: &str) -> i32 {
    MODELS.iter().position(|(model, _)| *model == name).map_or(-1, |at| at as i32)
}

fn way_out() -> String {
    format!("models: {HELD}; let COLMAP refine or convert the block with one of them")
}

/// The sensor of a camera; it has no name yet.
///
/// # Errors
///
/// A model whose projection is not Brown-Conrady (fisheye, FOV, a denominator), or one with a wrong count of parameters.
pub fn sensor(model: &str, width_px: u32, height_px: u32, params: &[f64]) -> Result<Sensor, StageError> {
    let [fx, fy, cx, cy, k1, k2, p1, p2, k3] = opencv(model, params)?;
    Ok(Sensor {
        name: String::new(),
        width_px,
        height_px,
        f: fy,
        cx: cx - HALF_PIXEL,
        cy: cy - HALF_PIXEL,
        b1: fx - fy,
        b2: 0.0,
        k: [k1, k2, k3, 0.0],
        p: [p1, p2],
    })
}

/// fx, fy, cx, cy, k1, k2, p1, p2, k3 of a camera model.
fn opencv(model: &str, params: &[f64]) -> Result<[f64; 9], StageError> {
    Ok(match (model, params) {
        ("SIMPLE_PINHOLE", &[f, cx, cy]) => [f, f, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0],
        ("PINHOLE", &[fx, fy, cx, cy]) => [fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0, 0.0],
        ("SIMPLE_RADIAL", &[f, cx, cy, k]) => [f, f, cx, cy, k, 0.0, 0.0, 0.0, 0.0],
        ("RADIAL", &[f, cx, cy, k1, k2]) => [f, f, cx, cy, k1, k2, 0.0, 0.0, 0.0],
        ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => [fx, fy, cx, cy, k1, k2, p1, p2, 0.0],
        ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
            if [k4, k5, k6].iter().any(|k| *k != 0.0) {
                fail!(
                    "model FULL_OPENCV with a denominator (k4 = {k4}, k5 = {k5}, k6 = {k6}): only polynomials can be held"
                );
            }
            [fx, fy, cx, cy, k1, k2, p1, p2, k3]
        }
        ("SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "FULL_OPENCV", _) => {
            fail!("model {model} does not have {} parameters", params.len())
        }
        _ => {
            let named =
                model.len() <= 24 && model.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_');
            let model =
                if named { format!("camera model `{model}`") } else { "a camera model of that name".to_owned() };
            return Err(StageError::new(format!("{model} cannot be held")).hint(way_out()));
        }
    })
}

/// The simplest of `PINHOLE`, `OPENCV` and `FULL_OPENCV` that holds a sensor, with its parameters.
///
/// # Errors
///
/// Skew b2 and radial k4, which no model of COLMAP has.
pub fn parameters(sensor: &Sensor) -> Result<(&'static str, Vec<f64>), StageError> {
    let ([k1, k2, k3, k4], [p1, p2]) = (sensor.k, sensor.p);
    for (name, value, why) in
        [("b2", sensor.b2, "COLMAP has no skew"), ("k4", k4, "COLMAP has no term in r^8; its own k4 is a denominator")]
    {
        if value != 0.0 {
            let error = StageError::new(format!(
                "sensor `{}`: {name} = {value} does not fit a COLMAP model: {why}",
                sensor.name
            ));
            return Err(error.hint("export it as metashape or json, or estimate the sensor without it"));
        }
    }
    let pinhole = [sensor.f + sensor.b1, sensor.f, sensor.cx + HALF_PIXEL, sensor.cy + HALF_PIXEL];
    let (name, distortion) = match [k1, k2, p1, p2, k3] {
        [0.0, 0.0, 0.0, 0.0, 0.0] => ("PINHOLE", Vec::new()),
        [_, _, _, _, 0.0] => ("OPENCV", vec![k1, k2, p1, p2]),
        _ => ("FULL_OPENCV", vec![k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]),
    };
    Ok((name, pinhole.into_iter().chain(distortion).collect()))
}

/// A camera by its number; one of a model that cannot be held is an error where an image has it.
pub type Numbered = (u64, Result<Sensor, StageError>);

/// The sensors that can be held, and no error but of those that images have.
///
/// # Errors
///
/// Two cameras or two images of one number; a camera of an image that cannot be held.
pub fn of_images(cameras: Vec<Numbered>, poses: &[Pose]) -> Result<Vec<(u64, Sensor)>, StageError> {
    check_once("CAMERA_ID", cameras.iter().map(|(id, _)| *id))?;
    check_once("IMAGE_ID", poses.iter().map(|pose| pose.id))?;
    let with_image: HashSet<u64> = poses.iter().map(|pose| pose.camera).collect();
    let needed = cameras.into_iter().filter(|(id, sensor)| sensor.is_ok() || with_image.contains(id));
    needed.map(|(id, sensor)| Ok((id, sensor?))).collect()
}

fn check_once(what: &str, numbers: impl Iterator<Item = u64>) -> Result<(), StageError> {
    match twice(numbers.collect()) {
        Some(number) => Err(StageError::new(format!("{what} {number} is there twice"))
            .hint("two models in one file? merge them in COLMAP (model_merger), or import one of them")),
        None => Ok(()),
    }
}

/// A pose as COLMAP writes it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pose {
    /// Number of the image.
    pub id: u64,
    /// R as (w, x, y, z).
    pub quaternion: [f64; 4],
    /// t, in the units of the block.
    pub translation: [f64; 3],
    /// Number of the camera.
    pub camera: u64,
    /// File name of the image.
    pub name: String,
}

/// The images of poses, whose cameras are among the sensors.
///
/// # Errors
///
/// A camera that is not there.
pub fn images(poses: &[Pose], sensors: &[(u64, Sensor)]) -> Result<Vec<Image>, StageError> {
    let places = sensors.iter().enumerate().map(|(place, (id, _))| (*id, place)).collect();
    poses.iter().map(|pose| image(pose, &places)).collect()
}

/// The image of a pose: `C = -R^T t`; `places` says where each camera is.
fn image(pose: &Pose, places: &HashMap<u64, usize>) -> Result<Image, StageError> {
    let Some(sensor) = places.get(&pose.camera).copied() else {
        fail!("image `{}` names camera {}, which the model does not have", pose.name, pose.camera)
    };
    let [w, x, y, z] = pose.quaternion;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let centre_m = (-rotation.inverse_transform_vector(&Vector3::from(pose.translation))).into();
    Ok(Image { name: pose.name.clone(), sensor, camera_from_object: pose.quaternion, centre_m })
}

/// The pose of the image at a position of its block, `t = -R C`; images and cameras are numbered from 1.
pub fn pose(image: &Image, position: usize) -> Pose {
    Pose {
        id: position as u64 + 1,
        quaternion: image.camera_from_object,
        translation: (-(image.rotation() * image.centre())).into(),
        camera: image.sensor as u64 + 1,
        name: image.name.clone(),
    }
}
