//! Cameras from and to the text model of COLMAP: `cameras.txt`, `images.txt` and an empty `points3D.txt`.

use std::str::FromStr;

use super::colmap::{self, Pose};
use super::{CameraFile, assemble};
use rockface_core::artefact::{Cameras, Frame, Sensor};
use rockface_core::{StageError, fail};

/// Reads a text model. Images come in the order of their ids.
pub fn read(cameras: &str, images: &str, frame: Frame) -> Result<CameraFile, StageError> {
    let within = |number: usize| move |e: StageError| at("cameras.txt", number, &e);
    let cameras = content(cameras)
        .map(|(number, line)| Ok((camera_id(line).map_err(within(number))?, sensor(line).map_err(within(number)))))
        .collect::<Result<Vec<_>, StageError>>()?;
    let mut poses = read_poses(images)?;
    let sensors = colmap::of_images(cameras, &poses)?;
    poses.sort_by_key(|pose| pose.id);
    let images = colmap::images(&poses, &sensors)?;
    assemble(frame, sensors, images, Vec::new())
}

/// Writes a text model: file names and contents. Every number is written with all its digits.
///
/// # Errors
///
/// A sensor that no model of COLMAP holds, or a name that lines of words cannot hold.
pub fn write(cameras: &Cameras) -> Result<Vec<(String, Vec<u8>)>, StageError> {
    let mut sensors = String::from("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n");
    for (position, sensor) in cameras.sensors.iter().enumerate() {
        let (model, parameters) = colmap::parameters(sensor)?;
        let (width, height, words) = (sensor.width_px, sensor.height_px, words(&parameters));
        sensors += &format!("{} {model} {width} {height} {words}\n", position + 1);
    }
    let mut images =
        String::from("# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[] as (X, Y, POINT3D_ID)\n");
    for (position, image) in cameras.images.iter().enumerate() {
        if image.name.contains(char::is_whitespace) {
            let name = image.name.escape_debug();
            let error = StageError::new(format!("image `{name}`: COLMAP ends a name of its text model at a blank"));
            return Err(error.hint("export it as colmap-binary, or rename the image"));
        }
        let pose = colmap::pose(image, position);
        let (q, t) = (words(&pose.quaternion), words(&pose.translation));
        images += &format!("{} {q} {t} {} {}\n\n", pose.id, pose.camera, pose.name);
    }
    let points = "# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID, POINT2D_IDX)\n".to_owned();
    let files = [("cameras.txt", sensors), ("images.txt", images), ("points3D.txt", points)];
    Ok(files.map(|(name, text)| (name.to_owned(), text.into_bytes())).into())
}

/// Numbers with all their digits, blanks between them.
fn words(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

fn at(file: &str, number: usize, error: &StageError) -> StageError {
    StageError { message: format!("{file}, line {number}: {}", error.message), ..error.clone() }
}

/// Lines that say something, numbered from 1.
fn content(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// The words of a file in a folder are not told: a link may lead to a file that is not meant to be shown.
fn number<T: FromStr>(word: Option<&str>, what: &str) -> Result<T, StageError> {
    let Some(word) = word else { fail!("{what} is missing") };
    word.parse().map_err(|_| StageError::new(format!("{what} is not a number of its kind")))
}

fn camera_id(line: &str) -> Result<u64, StageError> {
    number(line.split_whitespace().next(), "CAMERA_ID")
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`
fn sensor(line: &str) -> Result<Sensor, StageError> {
    let mut words = line.split_whitespace().skip(1);
    let model = words.next().unwrap_or("");
    let (width_px, height_px) = (number(words.next(), "WIDTH")?, number(words.next(), "HEIGHT")?);
    let params = words.map(|word| number(Some(word), "parameter")).collect::<Result<Vec<f64>, _>>()?;
    colmap::sensor(model, width_px, height_px, &params)
}

/// Each image has two lines, the second (its points) possibly empty.
fn read_poses(text: &str) -> Result<Vec<Pose>, StageError> {
    let mut poses = Vec::new();
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    while let Some((at_line, line)) = lines.next() {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        poses.push(pose(line).map_err(|e| at("images.txt", at_line, &e))?);
        let points = lines.next().map_or("", |(_, points)| points);
        if points.split_whitespace().count() % 3 != 0 {
            fail!("images.txt, line {}: not points (X, Y, POINT3D_ID); each image needs two lines", at_line + 1);
        }
    }
    Ok(poses)
}

/// `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`
fn pose(line: &str) -> Result<Pose, StageError> {
    let mut words = line.split_whitespace();
    let id = number(words.next(), "IMAGE_ID")?;
    let mut values = [0.0; 7];
    for (value, what) in values.iter_mut().zip(["QW", "QX", "QY", "QZ", "TX", "TY", "TZ"]) {
        *value = number(words.next(), what)?;
    }
    let camera = number(words.next(), "CAMERA_ID")?;
    let name = words.collect::<Vec<_>>().join(" ");
    let [w, x, y, z, tx, ty, tz] = values;
    Ok(Pose { id, quaternion: [w, x, y, z], translation: [tx, ty, tz], camera, name })
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;

    const IMAGES: &str = "# c\n2 1 0 0 0 0 0 0 1 b b.png\n\n1 0 1 0 0 1 2 3 1 a.png\n1 2 3\n";

    fn model(line: &str) -> Result<CameraFile, StageError> {
        read(line, IMAGES, Frame::World)
    }

    #[test]
    fn models_become_one_and_pixels_lose_a_half() {
        let file = model("1 RADIAL 9 7 100 4.5 3.5 0.1 0.2\n").unwrap();
        let s = &file.cameras.sensors[0];
        assert_eq!((s.f, s.cx, s.cy, s.k, s.b1), (100.0, 4.0, 3.0, [0.1, 0.2, 0.0, 0.0], 0.0));
        let s = &model("1 FULL_OPENCV 9 7 101 100 4.5 3.5 1 2 3 4 5 0 0 0").unwrap().cameras.sensors[0];
        assert_eq!((s.b1, s.k, s.p), (1.0, [1.0, 2.0, 5.0, 0.0], [3.0, 4.0]));
        for line in ["1 SIMPLE_PINHOLE 9 7 9 1 1", "1 PINHOLE 9 7 9 9 1 1", "1 SIMPLE_RADIAL 9 7 9 1 1 0"] {
            assert!(model(line).is_ok(), "{line}");
        }
    }

    #[test]
    fn images_come_by_id_with_their_centres() {
        let images = model("1 PINHOLE 9 7 9 9 1 1").unwrap().cameras.images;
        assert_eq!((images[0].name.as_str(), images[1].name.as_str()), ("a.png", "b b.png"));
        // A half turn about x: C = -R^T t = (-1, 2, 3).
        assert_eq!(images[0].centre_m, [-1.0, 2.0, 3.0]);
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let says = |result: Result<CameraFile, StageError>, text: &str| {
            let message = result.unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        says(model("1 FOV 9 7 9 9 1 1 0.9"), "line 1: camera model `FOV`");
        says(model("1 FULL_OPENCV 9 7 9 9 1 1 0 0 0 0 0 0.1 0 0"), "k4 = 0.1");
        says(model("1 PINHOLE 9 7 9 9 1"), "does not have 3 parameters");
        says(model("# no\n1 PINHOLE 9 x 9 9 1 1"), "line 2: HEIGHT is not a number");
        says(model("2 PINHOLE 9 7 9 9 1 1"), "names camera 1");
        let two = "1 PINHOLE 9 7 9 9 1 1\n";
        says(model(&two.repeat(2)), "CAMERA_ID 1 is there twice");
        says(read(two, &IMAGES.replace("\n2 ", "\n1 "), Frame::World), "IMAGE_ID 1 is there twice");
        assert_eq!(model(&format!("{two}9 FOV 9 7 9 9 1 1 0.9")).unwrap().cameras.sensors.len(), 1);
        let strange = read("secret words 1 2 3", "not read", Frame::World).unwrap_err().message;
        assert_eq!(strange, "cameras.txt, line 1: CAMERA_ID is not a number of its kind");
        let missing = "1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 0 0 0 0 1 b.png\n";
        says(read("1 PINHOLE 9 7 9 9 1 1", missing, Frame::World), "line 2: not points");
    }
}
