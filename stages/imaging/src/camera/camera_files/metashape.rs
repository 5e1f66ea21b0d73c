//! Cameras from Metashape's XML: camera -> chunk -> world, Brown-Conrady in Metashape's own order, covariance blocks.
//!
//! `x' = x radial + P1 (r2 + 2 x2) + 2 P2 x y`, `y' = y radial + P2 (r2 + 2 y2) + 2 P1 x y`,
//! `u = w/2 + cx + f x' + b1 x' + b2 y'`, `v = h/2 + cy + f y'` from the corner of the first pixel: our p1 is its P2, our
//! p2 its P1, and the principal point moves by w/2 - 0.5. A camera's matrix takes its frame (x right, y down, z forward)
//! to the chunk, the component's similarity the chunk to the world.

use std::collections::{HashMap, HashSet};

use nalgebra::Matrix3;

use super::metashape_covariance::covariance;
use super::metashape_xml::{self, CameraEntry, Chunk, SensorEntry, Similarity};
use super::{CameraFile, assemble};
use crate::camera::orientation::quaternion;
use rockface_core::artefact::{Frame, Image, Sensor};
use rockface_core::crs::{Kind, Stated};
use rockface_core::{StageError, fail};

pub use super::metashape_writer::write;

/// Farthest that R R^T may be from the identity.
const ORTHONORMAL: f64 = 1e-6;

/// Images without orientation that a message names.
const NAMED: usize = 10;

/// Our names of Metashape's calibration elements where they differ.
pub(super) fn our_name(element: &str) -> &str {
    match element {
        "p1" => "p2",
        "p2" => "p1",
        other => other,
    }
}

/// Reads a camera XML. Images that are disabled or not aligned are left out, and named.
///
/// # Errors
///
/// Sensors other than frame cameras, aligned images whose sensor has no calibration, distortion terms that Brown-Conrady
/// with k1 to k4, p1, p2 lacks, matrices that are no rotations: all by name.
pub fn read(text: &str, frame: Frame) -> Result<CameraFile, StageError> {
    let chunk = metashape_xml::read(text)?;
    let (used, idle): (Vec<&CameraEntry>, Vec<_>) =
        chunk.cameras.iter().partition(|c| c.enabled && c.transform.is_some());
    if used.is_empty() && !idle.is_empty() {
        let aligned = idle.iter().filter(|camera| camera.transform.is_some()).count();
        let what = if aligned == 0 { "aligned" } else { "both aligned and enabled" };
        return Err(StageError::new(format!("none of the {} images of the chunk is {what}", idle.len()))
            .hint("in Metashape: Workflow > Align Photos (and enable the photos), then export the cameras again"));
    }
    let with_image: HashSet<&str> = used.iter().map(|camera| camera.sensor.as_str()).collect();
    let sensors: Vec<&SensorEntry> =
        chunk.sensors.iter().filter(|sensor| with_image.contains(sensor.id.as_str())).collect();
    let numbered = sensors.iter().enumerate().map(|(at, entry)| Ok((number(entry, at), sensor(entry, &used)?)));
    let numbered = numbered.collect::<Result<Vec<_>, StageError>>()?;
    let places = sensors.iter().enumerate().map(|(place, sensor)| (sensor.id.as_str(), place)).collect();
    let images = used.iter().map(|camera| image(camera, &chunk, &places)).collect::<Result<Vec<_>, _>>()?;
    let mut file = assemble(frame, numbered, images, Vec::new())?;
    if !idle.is_empty() {
        let names: Vec<&str> = idle.iter().take(NAMED).map(|camera| camera.label.as_str()).collect();
        let more = idle.len() - names.len();
        let more = if more == 0 { String::new() } else { format!(" and {more} more") };
        file.warnings.push(format!(
            "{} of {} images are not aligned or not enabled and are left out: {}{more}",
            idle.len(),
            chunk.cameras.len(),
            names.join(", ")
        ));
    }
    let followers = idle.iter().filter(|camera| camera.follows).count();
    if followers > 0 {
        file.warnings.push(format!(
            "{followers} of these are images of a rig of several cameras (`master_id`), whose orientation the file gives by that of \
             another image: it is not computed here"
        ));
    }
    file.covariance = covariance(&chunk, &used, &sensors, &file.cameras)?;
    if file.covariance.is_some() {
        file.notes.push("covariance blocks as Metashape scaled them: nothing was multiplied".to_owned());
    }
    file.warnings.extend(of_reference(&chunk, &used));
    file.stated = chunk.reference.as_deref().map(|text| Stated::of_prj(text.as_bytes())).map(as_written);
    Ok(file)
}

/// Centres in a system on the Earth are written as geocentric ones, whichever it is; a local system is what it says.
fn as_written(stated: Stated) -> Stated {
    match stated.kind {
        Kind::Local | Kind::Unknown => Stated { node: None, ..stated },
        _ => Stated { kind: Kind::Geocentric, node: None, ..stated },
    }
}

fn number(sensor: &SensorEntry, position: usize) -> u64 {
    sensor.id.parse().unwrap_or(position as u64)
}

fn of_reference(chunk: &Chunk, used: &[&CameraEntry]) -> Vec<String> {
    let mut warnings = Vec::new();
    if used.iter().any(|camera| placed(chunk, camera).is_none()) {
        warnings.push(
            "the chunk has no transform: centres are in its own units, of unknown scale; give it markers, scale bars or \
             GNSS positions"
                .to_owned(),
        );
    }
    match &chunk.reference {
        Some(system) if !system.starts_with("LOCAL_CS") => {
            let name = system.split('"').nth(1).unwrap_or(system);
            warnings.push(format!(
                "the chunk is referenced to `{name}`: its centres are geocentric (Earth-centred X, Y, Z in metres), not \
                 coordinates of that system; export cameras and mesh from a local system (metres) to have them fit"
            ));
        }
        _ => {}
    }
    warnings
}

fn sensor(entry: &SensorEntry, used: &[&CameraEntry]) -> Result<Sensor, StageError> {
    let id = &entry.id;
    if entry.kind != "frame" {
        return Err(StageError::new(format!(
            "sensor {id} is of type `{}`: only frame cameras can be held",
            entry.kind
        ))
        .hint("undistort its images in Metashape (Export > Undistort Photos) and export the cameras again"));
    }
    let Some(calibration) = &entry.calibration else {
        let users: Vec<&str> = used.iter().filter(|c| c.sensor == *id).map(|c| c.label.as_str()).collect();
        fail!("sensor {id} has no <calibration>, yet these images of it are aligned: {}", users.join(", "))
    };
    let mut sensor = empty();
    for (name, value) in calibration {
        set(&mut sensor, name, *value)
            .map_err(|why| StageError::new(format!("sensor {id}: {name} = {value}: {why}")))?;
    }
    sensor.cx += 0.5 * f64::from(sensor.width_px) - 0.5;
    sensor.cy += 0.5 * f64::from(sensor.height_px) - 0.5;
    Ok(sensor)
}

fn empty() -> Sensor {
    let (k, p) = ([0.0; 4], [0.0; 2]);
    Sensor { name: String::new(), width_px: 0, height_px: 0, f: 0.0, cx: 0.0, cy: 0.0, b1: 0.0, b2: 0.0, k, p }
}

fn set(sensor: &mut Sensor, name: &str, value: f64) -> Result<(), &'static str> {
    match our_name(name) {
        "width" | "height" if value.fract() != 0.0 || !(1.0..=1e6).contains(&value) => return Err("not an image side"),
        "width" => sensor.width_px = value as u32,
        "height" => sensor.height_px = value as u32,
        "f" => sensor.f = value,
        "cx" => sensor.cx = value,
        "cy" => sensor.cy = value,
        "b1" => sensor.b1 = value,
        "b2" => sensor.b2 = value,
        "k1" => sensor.k[0] = value,
        "k2" => sensor.k[1] = value,
        "k3" => sensor.k[2] = value,
        "k4" => sensor.k[3] = value,
        "p1" => sensor.p[0] = value,
        "p2" => sensor.p[1] = value,
        "fx" | "fy" | "skew" => return Err("a calibration of an old PhotoScan; open and export it with Metashape"),
        _ if value == 0.0 => {}
        _ => {
            return Err(
                "a term that Brown-Conrady with k1 to k4, p1, p2, b1, b2 lacks; fix it at zero and adjust again",
            );
        }
    }
    Ok(())
}

/// The similarity an image is under, if its component or the chunk has one.
pub(super) fn placed(chunk: &Chunk, camera: &CameraEntry) -> Option<Similarity> {
    camera.component.as_ref().and_then(|id| chunk.components.get(id)).copied().or(chunk.transform)
}

fn image(camera: &CameraEntry, chunk: &Chunk, places: &HashMap<&str, usize>) -> Result<Image, StageError> {
    let label = &camera.label;
    let Some(sensor) = places.get(camera.sensor.as_str()).copied() else {
        fail!("image `{label}` names sensor {}, which the file does not have", camera.sensor)
    };
    let Some((chunk_from_camera, centre)) = camera.transform else { fail!("image `{label}` is not aligned") };
    let similarity = placed(chunk, camera).unwrap_or_else(Similarity::identity);
    check_rotation(&chunk_from_camera, &format!("image `{label}`"))?;
    check_rotation(&similarity.rotation, &format!("the component of image `{label}`"))?;
    let world_from_camera = similarity.rotation * chunk_from_camera;
    let centre_m = (similarity.rotation * centre * similarity.scale + similarity.translation).into();
    let mut image = Image { name: label.clone(), sensor, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m };
    image.set_rotation(&quaternion(&world_from_camera.transpose()));
    Ok(image)
}

fn check_rotation(rotation: &Matrix3<f64>, owner: &str) -> Result<(), StageError> {
    let off = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    // Not a number is refused here too.
    if off < ORTHONORMAL && rotation.determinant() > 0.0 {
        Ok(())
    } else {
        Err(StageError::new(format!("{owner}: its matrix is not a rotation (R R^T is {off:.2e} off the identity)")))
    }
}

#[cfg(test)]
mod tests;
