//! Cameras from and to Bundler's `.out` file: x right, y up, z backward, pixels from the middle of the image.
//!
//! `P = R X + t`, `p = -P / P_z`, pixel `= f (1 + k1 |p|^2 + k2 |p|^4) p`. The file holds neither image sizes nor names:
//! the caller gives the size, and the `list.txt` beside the file the names.

use nalgebra::{Matrix3, Vector3};

use super::{CameraFile, assemble};
use crate::camera::orientation::quaternion;
use rockface_core::artefact::{Cameras, Frame, Image, Sensor};
use rockface_core::{StageError, fail};

const HEADER: &str = "# Bundle file v0.3";

/// Bundler's camera frame from that of rockface: half a turn about x.
const FLIP: [f64; 3] = [1.0, -1.0, -1.0];

/// Farthest that R R^T may be from the identity.
const ORTHONORMAL: f64 = 1e-5;

/// Whether a file starts as Bundler's do.
pub fn is_bundler(head: &[u8]) -> bool {
    head.starts_with(b"# Bundle file")
}

/// Reads the cameras of a `.out` file, and ignores its points. Every image gets its own sensor.
///
/// `list` is the text of `list.txt`, one image a line (its first word); without it images are called `image0`, ...
///
/// # Errors
///
/// A version other than v0.3, missing numbers, matrices that are no rotations, a list of another length.
pub fn read(text: &str, list: Option<&str>, [width, height]: [u32; 2], frame: Frame) -> Result<CameraFile, StageError> {
    let Some(body) = text.strip_prefix(HEADER) else {
        return Err(StageError::new(format!("not a Bundler file of version 0.3: its first line is not `{HEADER}`")));
    };
    let mut numbers = body.split_whitespace();
    let count = whole(&mut numbers, "the count of cameras")?;
    whole(&mut numbers, "the count of points")?;
    let names = names(list, count)?;
    let (mut sensors, mut images, mut left_out) = (Vec::new(), Vec::new(), Vec::new());
    for number in 0..count {
        let name = names.as_ref().map_or_else(|| format!("image{number}"), |names| names[number].clone());
        let camera = values(&mut numbers, number)?;
        if camera[0] == 0.0 {
            left_out.push(name);
            continue;
        }
        images.push(image(&name, sensors.len(), &camera)?);
        sensors.push((number as u64, sensor(&camera, width, height)));
    }
    if images.is_empty() && count > 0 {
        return Err(StageError::new(format!("none of the {count} images is oriented (f = 0 for all)"))
            .hint("the reconstruction has registered no image: repeat it, or export one that has"));
    }
    let notes = vec![format!("{width} x {height} pixels, as given: a Bundler file does not say it")];
    let mut file = assemble(frame, sensors, images, notes)?;
    if !left_out.is_empty() {
        let (some, names) = (left_out.len(), left_out.join(", "));
        file.warnings.push(format!("{some} of {count} images have no orientation (f = 0) and are left out: {names}"));
    }
    Ok(file)
}

fn whole<'a>(words: &mut impl Iterator<Item = &'a str>, what: &str) -> Result<usize, StageError> {
    let word = words.next().unwrap_or("");
    word.parse().map_err(|_| StageError::new(format!("{what} is not there: the next word is no number")))
}

/// The first word of each line that has one; `None` without a list.
fn names(list: Option<&str>, count: usize) -> Result<Option<Vec<String>>, StageError> {
    let Some(list) = list else { return Ok(None) };
    let names: Vec<String> =
        list.lines().filter_map(|line| line.split_whitespace().next()).map(str::to_owned).collect();
    if names.len() != count {
        fail!("list.txt names {} images, the Bundler file has {count} cameras", names.len());
    }
    Ok(Some(names))
}

/// f, k1, k2, the rows of R, t.
fn values<'a>(words: &mut impl Iterator<Item = &'a str>, number: usize) -> Result<[f64; 15], StageError> {
    let mut values = [0.0; 15];
    for (place, value) in values.iter_mut().enumerate() {
        let word = words.next().unwrap_or("");
        *value = word.parse().map_err(|_| {
            // Neither name nor word are told: both files may be links in a folder, to what is not meant to be shown.
            StageError::new(format!(
                "camera {number} (counted from 0): number {} of 15 (f k1 k2, R, t) is {}",
                place + 1,
                if word.is_empty() { "missing" } else { "no number" }
            ))
        })?;
    }
    Ok(values)
}

fn sensor(values: &[f64; 15], width_px: u32, height_px: u32) -> Sensor {
    let [cx, cy] = middle(width_px, height_px);
    let (f, k) = (values[0], [values[1], values[2], 0.0, 0.0]);
    Sensor { name: String::new(), width_px, height_px, f, cx, cy, b1: 0.0, b2: 0.0, k, p: [0.0; 2] }
}

/// The middle of an image, pixels from the centre of the first one.
fn middle(width_px: u32, height_px: u32) -> [f64; 2] {
    [width_px, height_px].map(|side| 0.5 * (f64::from(side) - 1.0))
}

fn image(name: &str, sensor: usize, values: &[f64; 15]) -> Result<Image, StageError> {
    let bundler = Matrix3::from_row_slice(&values[3..12]);
    let off = (bundler * bundler.transpose() - Matrix3::identity()).norm();
    // The negated comparison refuses NaN too.
    if !(off < ORTHONORMAL && bundler.determinant() > 0.0) {
        fail!("camera `{name}`: R is not a rotation (R R^T is {off:.2e} off the identity)");
    }
    let rotation = quaternion(&(Matrix3::from_diagonal(&Vector3::from(FLIP)) * bundler));
    let translation = Vector3::new(values[12], values[13], values[14]);
    let centre_m = (-(bundler.transpose() * translation)).into();
    let mut image = Image { name: name.to_owned(), sensor, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m };
    image.set_rotation(&rotation);
    Ok(image)
}

/// Writes `bundle.out` and `list.txt`.
///
/// # Errors
///
/// Each thing that Bundler cannot hold: a principal point off the middle, affinity, k3, k4, decentring, blanks in a name.
pub fn write(cameras: &Cameras) -> Result<Vec<(String, Vec<u8>)>, StageError> {
    let (mut bundle, mut list) = (format!("{HEADER}\n{} 0\n", cameras.images.len()), String::new());
    cameras.sensors.iter().try_for_each(check)?;
    for image in &cameras.images {
        if image.name.split_whitespace().next() != Some(image.name.as_str()) {
            fail!("image `{}`: the list of a Bundler file holds no blanks in names", image.name.escape_debug());
        }
        let sensor = cameras.sensor(image);
        let rotation = Matrix3::from_diagonal(&Vector3::from(FLIP)) * image.matrix();
        let t = -(rotation * image.centre());
        bundle += &format!("{} {} {}\n", sensor.f, sensor.k[0], sensor.k[1]);
        for row in rotation.row_iter() {
            bundle += &format!("{} {} {}\n", row[0], row[1], row[2]);
        }
        bundle += &format!("{} {} {}\n", t.x, t.y, t.z);
        list += &format!("{}\n", image.name);
    }
    Ok(vec![("bundle.out".to_owned(), bundle.into_bytes()), ("list.txt".to_owned(), list.into_bytes())])
}

fn check(sensor: &Sensor) -> Result<(), StageError> {
    let ([cx, cy], [_, _, k3, k4], [p1, p2]) = (middle(sensor.width_px, sensor.height_px), sensor.k, sensor.p);
    let offsets = [("cx", sensor.cx - cx), ("cy", sensor.cy - cy)].map(|(name, x)| (name, x, " px from the middle"));
    let others = [("b1", sensor.b1), ("b2", sensor.b2), ("k3", k3), ("k4", k4), ("p1", p1), ("p2", p2)];
    let others = others.map(|(name, x)| (name, x, ""));
    match offsets.into_iter().chain(others).find(|(_, value, _)| *value != 0.0) {
        None => Ok(()),
        Some((name, value, what)) => Err(StageError::new(format!(
            "sensor `{}`: {name} = {value}{what} does not fit a Bundler file, which has f, k1 and k2 only",
            sensor.name
        ))
        .hint("export it as metashape, colmap-text or json")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::model::Camera;

    /// Two cameras, the second without orientation, and a point.
    const FILE: &str = "# Bundle file v0.3\n2 1\n100 -0.1 0.02\n0 -1 0\n1 0 0\n0 0 1\n0.5 -0.25 -3\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n1 2 3\n255 0 0\n1 0 0 0 0\n";

    #[test]
    fn a_point_falls_where_bundlers_formula_puts_it() {
        let file = read(FILE, Some("a.jpg 0 100\nb.jpg\n"), [60, 40], Frame::World).unwrap();
        assert_eq!(file.notes.len(), 1);
        assert!(file.warnings[0].ends_with("left out: b.jpg"), "{:?}", file.warnings);
        let block = &file.cameras;
        assert_eq!((block.images.len(), block.images[0].name.as_str()), (1, "a.jpg"));
        // P = R X + t of X = (0.2, 0.3, -1) is (0.2, -0.05, -4), so p = (0.05, -0.0125).
        let (px, py) = (0.05, -0.0125);
        let r2: f64 = px * px + py * py;
        let scale = 100.0 * (1.0 - 0.1 * r2 + 0.02 * r2 * r2);
        let [u, v] = Camera::new(&block.sensors[0], &block.images[0]).project(&Vector3::new(0.2, 0.3, -1.0)).unwrap();
        assert!((u - (29.5 + scale * px)).abs() < 1e-12 && (v - (19.5 - scale * py)).abs() < 1e-12, "{u} {v}");
    }

    #[test]
    fn what_is_no_bundler_file_is_refused() {
        let says = |text: &str, list: Option<&str>, expected: &str| {
            let message = read(text, list, [60, 40], Frame::World).unwrap_err().message;
            assert!(message.contains(expected), "{message}");
        };
        says("# Bundle file v0.4\n", None, "version 0.3");
        says(FILE, Some("a.jpg"), "names 1 images, the Bundler file has 2");
        says(&FILE.replace("0 -1 0\n", "0 -2 0\n"), None, "R is not a rotation");
        says(&FILE.replace("0 -1 0\n", "0 nan 0\n"), None, "R is not a rotation");
        says(
            "# Bundle file v0.3\n1 0\n1 2",
            None,
            "camera 0 (counted from 0): number 3 of 15 (f k1 k2, R, t) is missing",
        );
        says("# Bundle file v0.3\n1 0\n1 hidden", None, "number 2 of 15 (f k1 k2, R, t) is no number");
        says("# Bundle file v0.3\nx", None, "the count of cameras");
        let endless = FILE.replacen("2 1", "9999999999999999 1", 1);
        says(&endless, None, "camera 2 (counted from 0): number 12 of 15");
        says(&format!("# Bundle file v0.3\n{} 0\n", usize::MAX), None, "camera 0 (counted from 0): number 1 of 15");
    }

    #[test]
    fn what_bundler_cannot_hold_is_named() {
        let mut cameras = read(FILE, None, [60, 40], Frame::World).unwrap().cameras;
        assert!(write(&cameras).is_ok());
        cameras.sensors[0].cx += 0.25;
        let error = write(&cameras).unwrap_err();
        assert!(error.message.contains("cx = 0.25 px from the middle"), "{error}");
        cameras.sensors[0].cx -= 0.25;
        cameras.sensors[0].p[1] = 1e-4;
        assert!(write(&cameras).unwrap_err().message.contains("p2 = 0.0001"));
    }
}
