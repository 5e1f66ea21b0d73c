//! Cameras from Metashape's XML: camera -> chunk -> world, Brown-Conrady in Metashape's own order, covariance blocks.
//!
//! `x' = x radial + P1 (r2 + 2 x2) + 2 P2 x y`, `y' = y radial + P2 (r2 + 2 y2) + 2 P1 x y`,
//! `u = w/2 + cx + f x' + b1 x' + b2 y'`, `v = h/2 + cy + f y'` from the corner of the first pixel: our p1 is its P2, our
//! p2 its P1, and the principal point moves by w/2 - 0.5. A camera's matrix takes its frame (x right, y down, z forward)
//! to the chunk, the component's similarity the chunk to the world.

use std::collections::{BTreeMap, HashMap, HashSet};

use nalgebra::Matrix3;

use super::metashape_covariance::covariance;
use super::metashape_xml::{self, CameraEntry, Chunk, SensorEntry, Similarity};
use super::{CameraFile, assemble};
use crate::camera::orientation::quaternion;
use rockface_core::artefact::{Frame, Image, Sensor};
use rockface_core::crs::{Kind, Stated};
use rockface_core::names::twice;
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
    let mut chunk = metashape_xml::read(text)?;
    let renamed = name_apart(&mut chunk.cameras);
    let (used, idle): (Vec<&CameraEntry>, Vec<_>) = chunk.cameras.iter().partition(|camera| is_used(camera));
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
    file.warnings.extend(renamed);
    file.warnings.extend(of_rolling_shutter(&used, &sensors));
    if used.iter().any(|camera| placed(&chunk, camera).is_none()) {
        file.warnings.push(
            "the chunk has no transform: centres are in its own units, of unknown scale; give it markers, scale bars or \
             GNSS positions"
                .to_owned(),
        );
    }
    let reference = chunk.reference.as_deref().map(|text| Stated::of_prj(text.as_bytes()));
    refer(&mut file, reference);
    Ok(file)
}

/// Distances from the centre of the Earth at which a photograph is taken, metres.
const ON_EARTH_M: std::ops::Range<f64> = 6.34e6..6.42e6;

/// What the system of the chunk says of its centres: those of a system on the Earth are written as geocentric ones, whichever it is, where the
/// chunk is placed in it; a local system is what it says.
fn refer(file: &mut CameraFile, reference: Option<Stated>) {
    let Some(reference) = reference else { return };
    let on_earth = file.cameras.images.iter().all(|image| ON_EARTH_M.contains(&image.centre().norm()));
    match reference.kind {
        Kind::Local => file.stated = Some(Stated { node: None, ..reference }),
        _ if on_earth => file.geocentric = Some(reference),
        Kind::Unknown => file.stated = Some(reference),
        _ => file.warnings.push(format!(
            "the chunk is referenced to `{}`: of a chunk placed in such a system its centres are geocentric (Earth-centred X, Y, Z in metres), but these are far \
             from the surface of the Earth, and are taken for metres as they stand; `crs` says in which system, where they are in one",
            reference.name
        )),
    }
}

/// Whether a camera is read: those that are disabled or not aligned are left out.
fn is_used(camera: &CameraEntry) -> bool {
    camera.enabled && camera.transform.is_some()
}

/// Gives images of one label names of their own: with the label of their group where that tells them apart, else with their id; says so.
fn name_apart(cameras: &mut [CameraEntry]) -> Option<String> {
    let mut of_label: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (place, camera) in cameras.iter().enumerate().filter(|(_, camera)| is_used(camera)) {
        of_label.entry(camera.label.clone()).or_default().push(place);
    }
    let mut taken: HashSet<String> = of_label.keys().cloned().collect();
    let mut renamed = Vec::new();
    for (label, places) in of_label.iter().filter(|(_, places)| places.len() > 1) {
        let with_group = |place: &usize| match &cameras[*place].group {
            Some(group) if !group.is_empty() => format!("{group}_{label}"),
            _ => label.clone(),
        };
        let with_id = |place: &usize| format!("{label}#{}", cameras[*place].id.as_deref().unwrap_or_default());
        let by_group: Vec<String> = places.iter().map(with_group).collect();
        let is_free = |name: &String| name == label || !taken.contains(name);
        let tells_apart =
            twice(by_group.iter().map(String::as_str).collect()).is_none() && by_group.iter().all(is_free);
        let names =
            if tells_apart { by_group } else { places.iter().map(|place| free(with_id(place), &taken)).collect() };
        renamed.push(format!("`{label}` ({})", names.join(", ")));
        taken.extend(names.iter().cloned());
        for (place, name) in places.iter().zip(names) {
            cameras[*place].label = name;
        }
    }
    let [first, others @ ..] = renamed.as_slice() else { return None };
    let others = if others.is_empty() { String::new() } else { format!(", and {} more labels likewise", others.len()) };
    Some(format!(
        "several images have one label, {first}{others}: they are named by their group, else by their id, to have names of their own; to choose the names, \
         rename the photos in Metashape (Photos pane, Rename) and export the cameras again"
    ))
}

/// A name that no image has, with further marks at its end where it needs them.
fn free(mut name: String, taken: &HashSet<String>) -> String {
    while taken.contains(&name) {
        name.push('#');
    }
    name
}

/// Says what a rolling shutter that Metashape adjusted is here: nothing.
fn of_rolling_shutter(used: &[&CameraEntry], sensors: &[&SensorEntry]) -> Option<String> {
    let ids: Vec<&str> = sensors.iter().filter(|s| s.rolling_shutter).map(|s| s.id.as_str()).collect();
    let images = used.iter().filter(|camera| camera.rolling_shutter).count();
    let whose = match (ids.as_slice(), images) {
        ([], 0) => return None,
        ([], images) => format!("of {images} images"),
        (ids, _) => format!("of sensor {}", ids.join(", ")),
    };
    Some(format!(
        "the rolling shutter {whose} was adjusted in Metashape and is not modelled here: all lines of an image are taken for exposed at once, so what is projected \
         into the first and last lines is off by half the way that the camera went during the readout (a drone at 5 m/s that reads an image in 30 ms: 0.15 m \
         from the first line to the last, up to 0.075 m at the face)"
    ))
}

fn number(sensor: &SensorEntry, position: usize) -> u64 {
    sensor.id.parse().unwrap_or(position as u64)
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
