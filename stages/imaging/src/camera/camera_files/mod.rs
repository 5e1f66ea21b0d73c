//! Image blocks from and to files of other programs, one format a file; here what they share: names and checks.
//!
//! | file | format | pixels of the file |
//! |---|---|---|
//! | `json.rs` | JSON, ours and a simple one | first centre at (0, 0) |
//! | `colmap.rs`, `colmap_text.rs`, `colmap_binary.rs` | COLMAP models | first centre at (0.5, 0.5) |
//! | `metashape.rs`, `metashape_xml.rs`, `metashape_covariance.rs`, `metashape_writer.rs` | Metashape's camera XML | from the middle |
//! | `bundler.rs` | Bundler's `.out` | from the middle, y up |

pub mod bundler;
mod colmap;
pub mod colmap_binary;
pub mod colmap_text;
pub mod json;
pub mod metashape;
mod metashape_covariance;
mod metashape_writer;
mod metashape_xml;
pub mod recognise;
#[cfg(test)]
mod round_trip_tests;

use rockface_core::artefact::{Cameras, Covariance, Frame, Image, Sensor};
use rockface_core::crs::Stated;
use rockface_core::names::twice;
use rockface_core::{StageError, fail};

/// How far from 1 the length of an imported quaternion may be; closer ones are normalised.
const UNIT_TOLERANCE: f64 = 1e-6;

/// An image block read from files.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFile {
    /// The sensors and oriented images that were read.
    pub cameras: Cameras,
    /// Whether the file states its frame.
    pub states_frame: bool,
    /// What was read over, in sentences.
    pub notes: Vec<String>,
    /// What may be wrong, in sentences.
    pub warnings: Vec<String>,
    /// The coordinate reference system that the file states, units included.
    pub stated: Option<Stated>,
    /// The system whose datum the centres are geocentric in (X, Y and Z from the centre of the Earth); `stated` is absent then.
    pub geocentric: Option<Stated>,
    /// The covariance the file itself holds; its names are those of the block.
    pub covariance: Option<Covariance>,
}

impl CameraFile {
    /// A block from a file that holds nothing else.
    pub fn of(cameras: Cameras) -> Self {
        let stated = cameras.frame.crs().map(Stated::of_crs);
        let (notes, warnings) = (Vec::new(), Vec::new());
        Self { cameras, states_frame: false, notes, warnings, stated, geocentric: None, covariance: None }
    }
}

/// Names the sensors of a foreign file and checks the block.
///
/// A sensor that exactly one image uses takes the name of that image, any other keeps its own or is `sensor<id>`.
pub fn assemble(
    frame: Frame,
    numbered: Vec<(u64, Sensor)>,
    images: Vec<Image>,
    notes: Vec<String>,
) -> Result<CameraFile, StageError> {
    let mut sensors = Vec::with_capacity(numbered.len());
    // How many images use each sensor, and the first of them.
    let mut users: Vec<(usize, Option<&Image>)> = vec![(0, None); numbered.len()];
    for image in &images {
        if let Some((count, first)) = users.get_mut(image.sensor) {
            *count += 1;
            *first = first.or(Some(image));
        }
    }
    for ((id, mut sensor), users) in numbered.into_iter().zip(users) {
        sensor.name = match users {
            (1, Some(only)) => only.name.clone(),
            _ if !sensor.name.is_empty() => sensor.name,
            _ => format!("sensor{id}"),
        };
        sensors.push(sensor);
    }
    let cameras = validated(Cameras { frame, sensors, images })?;
    Ok(CameraFile { notes, ..CameraFile::of(cameras) })
}

/// Checks names, sizes and numbers of a block, and normalises its quaternions.
pub fn validated(mut cameras: Cameras) -> Result<Cameras, StageError> {
    if cameras.images.is_empty() {
        fail!("the file has no images");
    }
    check_names("image", cameras.images.iter().map(|image| image.name.as_str()))?;
    check_names("sensor", cameras.sensors.iter().map(|sensor| sensor.name.as_str()))?;
    cameras.sensors.iter().try_for_each(check_sensor)?;
    let sensors = cameras.sensors.len();
    cameras.images.iter_mut().try_for_each(|image| check_image(image, sensors))?;
    Ok(cameras)
}

fn check_names<'a>(what: &str, names: impl Iterator<Item = &'a str>) -> Result<(), StageError> {
    let names: Vec<&str> = names.collect();
    if names.iter().any(|name| name.is_empty()) {
        fail!("an {what} has no name");
    }
    match twice(names) {
        Some(name) => Err(StageError::new(format!("two {what}s are called `{name}`"))
            .hint("covariances and pairs refer to names: give each its own")),
        None => Ok(()),
    }
}

/// Checks that an interior orientation is usable.
pub fn check_sensor(sensor: &Sensor) -> Result<(), StageError> {
    let (name, [p1, p2], [k1, k2, k3, k4]) = (&sensor.name, sensor.p, sensor.k);
    if sensor.width_px == 0 || sensor.height_px == 0 {
        fail!("sensor `{name}`: an image of {} x {} pixels", sensor.width_px, sensor.height_px);
    }
    let numbers = [sensor.f, sensor.cx, sensor.cy, sensor.b1, sensor.b2, k1, k2, k3, k4, p1, p2];
    if let Some(bad) = numbers.iter().find(|x| !x.is_finite()) {
        fail!("sensor `{name}`: {bad} is not a finite number");
    }
    if sensor.f <= 0.0 || sensor.f + sensor.b1 <= 0.0 {
        fail!("sensor `{name}`: principal distance f = {} px, b1 = {} px: fx and fy must be > 0", sensor.f, sensor.b1);
    }
    Ok(())
}

fn check_image(image: &mut Image, sensors: usize) -> Result<(), StageError> {
    let (name, q) = (&image.name, image.camera_from_object);
    if image.sensor >= sensors {
        fail!("image `{name}` refers to sensor number {}, there are {sensors} (counted from 0)", image.sensor);
    }
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if q.iter().all(|x| x.is_finite()) && (length - 1.0).abs() > UNIT_TOLERANCE {
        let error = StageError::new(format!("image `{name}`: its quaternion has length {length}, not 1"));
        return Err(error.hint("a rotation is a unit quaternion (w, x, y, z); write all digits"));
    }
    if let Some(bad) = image.centre_m.iter().chain(&q).find(|x| !x.is_finite()) {
        fail!("image `{name}`: {bad} is not a finite number");
    }
    // One that is of unit length to its last digits keeps its bits: a file read again is the same file.
    if (length - 1.0).abs() > 4.0 * f64::EPSILON {
        image.camera_from_object = q.map(|x| x / length);
    }
    Ok(())
}

/// Finds a name among others: exactly, else with or without a file extension where that fits a single one.
pub fn find_name(wanted: &str, names: &[&str]) -> Option<usize> {
    if let Some(exact) = names.iter().position(|name| *name == wanted) {
        return Some(exact);
    }
    let fits = |name: &str| stem(name) == wanted || name == stem(wanted);
    let mut fitting = names.iter().enumerate().filter(|(_, name)| fits(name));
    match (fitting.next(), fitting.next()) {
        (Some((index, _)), None) => Some(index),
        _ => None,
    }
}

/// A name without its file extension: three or four letters or digits, at least one of them a letter.
fn stem(name: &str) -> &str {
    let is_extension = |e: &str| {
        matches!(e.len(), 3 | 4)
            && e.bytes().all(|b| b.is_ascii_alphanumeric())
            && e.bytes().any(|b| b.is_ascii_alphabetic())
    };
    match name.rsplit_once('.') {
        Some((stem, extension)) if is_extension(extension) => stem,
        _ => name,
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;

    fn sensor(name: &str) -> Sensor {
        let name = name.to_owned();
        let (k, p) = ([0.0; 4], [0.0; 2]);
        Sensor { name, width_px: 10, height_px: 8, f: 9.0, cx: 4.5, cy: 3.5, b1: 0.0, b2: 0.0, k, p }
    }

    fn image(name: &str, sensor: usize) -> Image {
        Image { name: name.into(), sensor, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: [0.0; 3] }
    }

    #[test]
    fn a_sensor_of_one_image_takes_its_name() {
        let numbered = vec![(3, sensor("")), (7, sensor("")), (9, sensor(""))];
        let images = vec![image("a", 0), image("b", 1), image("c", 1)];
        let file = assemble(Frame::Wall, numbered, images, Vec::new()).unwrap();
        let names: Vec<_> = file.cameras.sensors.iter().map(|s| s.name.as_str()).collect();
        assert_eq!(names, ["a", "sensor7", "sensor9"]);
    }

    #[test]
    fn bad_blocks_are_refused_by_name() {
        let block = |sensor: Sensor, image: Image| {
            validated(Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![image] })
        };
        let says = |result: Result<Cameras, StageError>, text: &str| {
            let message = result.unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        let mut odd = image("a", 0);
        odd.camera_from_object = [1.0 + 2e-6, 0.0, 0.0, 0.0];
        says(block(sensor("s"), odd.clone()), "`a`: its quaternion has length 1.000002");
        let zero = Image { camera_from_object: [0.0; 4], centre_m: [f64::NAN; 3], ..image("a", 0) };
        says(block(sensor("s"), zero), "its quaternion has length 0");
        odd.camera_from_object = [1.0 + 5e-7, 0.0, 0.0, 0.0];
        assert_eq!(block(sensor("s"), odd).unwrap().images[0].camera_from_object, [1.0, 0.0, 0.0, 0.0]);
        says(block(sensor("s"), image("a", 1)), "sensor number 1");
        says(block(Sensor { f: -1.0, ..sensor("s") }, image("a", 0)), "f = -1");
        says(block(Sensor { cx: f64::NAN, ..sensor("s") }, image("a", 0)), "NaN");
        let twice = vec![image("a", 0), image("a", 0)];
        says(validated(Cameras { frame: Frame::Wall, sensors: vec![sensor("s")], images: twice }), "called `a`");
    }

    #[test]
    fn names_fit_with_and_without_extension() {
        let names = ["cam1.png", "cam2", "DJI.0001", "x.jpg", "x.tif"];
        assert_eq!(find_name("cam1", &names), Some(0));
        assert_eq!(find_name("cam2.JPG", &names), Some(1));
        assert_eq!(find_name("DJI", &names), None);
        assert_eq!(find_name("x.tif", &names), Some(4));
        assert_eq!(find_name("x", &names), None);
    }
}
