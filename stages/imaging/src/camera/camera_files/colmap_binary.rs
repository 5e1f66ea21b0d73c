//! Cameras from and to the binary model of COLMAP: `cameras.bin`, `images.bin` and an empty `points3D.bin`, little-endian.

use super::colmap::{self, Numbered, Pose};
use super::{CameraFile, assemble};
use rockface_core::artefact::{Cameras, Frame};
use rockface_core::{StageError, fail};

/// Reads a binary model. Images come in the order of their ids; their points are ignored.
pub fn read(cameras: &[u8], images: &[u8], frame: Frame) -> Result<CameraFile, StageError> {
    let within = |file: &str| {
        let file = file.to_owned();
        move |e: StageError| StageError { message: format!("{file}: {}", e.message), ..e }
    };
    let cameras = records(cameras, sensor).map_err(within("cameras.bin"))?;
    let mut poses = records(images, pose).map_err(within("images.bin"))?;
    let sensors = colmap::of_images(cameras, &poses)?;
    poses.sort_by_key(|pose| pose.id);
    let images = colmap::images(&poses, &sensors)?;
    assemble(frame, sensors, images, Vec::new())
}

/// A count, and that many records to the end of the file.
fn records<T>(bytes: &[u8], read: fn(&mut Bytes) -> Result<T, StageError>) -> Result<Vec<T>, StageError> {
    let mut bytes = Bytes { all: bytes, at: 0 };
    let count = u64::from_le_bytes(bytes.take()?);
    let mut records = Vec::new();
    for number in 1..=count {
        let record = read(&mut bytes);
        records.push(
            record.map_err(|e| StageError { message: format!("record {number} of {count}: {}", e.message), ..e })?,
        );
    }
    match bytes.all.len() - bytes.at {
        0 => Ok(records),
        rest => Err(StageError::new(format!("{rest} bytes follow after the {count} records it announces"))),
    }
}

/// Bytes read from the front.
struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
}

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], StageError> {
        let Some((head, _)) = self.all[self.at..].split_first_chunk::<N>() else { return Err(self.ended()) };
        self.at += N;
        Ok(*head)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N], StageError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = f64::from_le_bytes(self.take()?);
        }
        Ok(numbers)
    }

    /// Text up to a zero byte.
    fn text(&mut self) -> Result<String, StageError> {
        let rest = &self.all[self.at..];
        let Some(length) = rest.iter().position(|byte| *byte == 0) else { return Err(self.ended()) };
        self.at += length + 1;
        String::from_utf8(rest[..length].to_vec()).map_err(|e| StageError::new(format!("a name is not UTF-8: {e}")))
    }

    fn skip(&mut self, records: u64, bytes_each: u64) -> Result<(), StageError> {
        let skipped = records.checked_mul(bytes_each).and_then(|bytes| usize::try_from(bytes).ok());
        let Some(end) = skipped.and_then(|bytes| self.at.checked_add(bytes)).filter(|end| *end <= self.all.len())
        else {
            return Err(self.ended());
        };
        self.at = end;
        Ok(())
    }

    fn ended(&self) -> StageError {
        StageError::new(format!("the file ends too early, after {} bytes", self.all.len()))
            .hint("copy the model again; a text model in a file called .bin is not read either")
    }
}

/// Camera id (u32), model (i32), width and height (u64), parameters.
fn sensor(bytes: &mut Bytes) -> Result<Numbered, StageError> {
    let id = u64::from(u32::from_le_bytes(bytes.take()?));
    let (model, count) = colmap::model(i32::from_le_bytes(bytes.take()?))?;
    let mut side = || {
        let pixels = u64::from_le_bytes(bytes.take()?);
        u32::try_from(pixels).map_err(|_| StageError::new(format!("camera {id}: an image side of {pixels} pixels")))
    };
    let (width, height) = (side()?, side()?);
    let mut parameters = Vec::with_capacity(count);
    for _ in 0..count {
        parameters.push(f64::from_le_bytes(bytes.take()?));
    }
    let of_camera = |e: StageError| StageError { message: format!("cameras.bin: camera {id}: {}", e.message), ..e };
    Ok((id, colmap::sensor(model, width, height, &parameters).map_err(of_camera)))
}

/// Image id (u32), quaternion, translation, camera id (u32), name, count of points (u64), points of 24 bytes.
fn pose(bytes: &mut Bytes) -> Result<Pose, StageError> {
    let id = u64::from(u32::from_le_bytes(bytes.take()?));
    let (quaternion, translation) = (bytes.numbers()?, bytes.numbers()?);
    let camera = u64::from(u32::from_le_bytes(bytes.take()?));
    let name = bytes.text()?;
    let points = u64::from_le_bytes(bytes.take()?);
    bytes.skip(points, 24)?;
    Ok(Pose { id, quaternion, translation, camera, name })
}

/// Writes a binary model: file names and contents.
///
/// # Errors
///
/// A sensor that no model of COLMAP holds, or a name with a zero byte.
pub fn write(cameras: &Cameras) -> Result<Vec<(String, Vec<u8>)>, StageError> {
    let mut sensors = (cameras.sensors.len() as u64).to_le_bytes().to_vec();
    for (position, sensor) in cameras.sensors.iter().enumerate() {
        let (model, parameters) = colmap::parameters(sensor)?;
        sensors.extend((position as u32 + 1).to_le_bytes());
        sensors.extend(colmap::number_of(model).to_le_bytes());
        sensors.extend([sensor.width_px, sensor.height_px].iter().flat_map(|side| u64::from(*side).to_le_bytes()));
        sensors.extend(parameters.iter().flat_map(|parameter| parameter.to_le_bytes()));
    }
    let mut images = (cameras.images.len() as u64).to_le_bytes().to_vec();
    for (position, image) in cameras.images.iter().enumerate() {
        if image.name.contains('\0') {
            fail!("image `{}`: a COLMAP model ends a name at a zero byte", image.name.escape_debug());
        }
        let pose = colmap::pose(image, position);
        images.extend((pose.id as u32).to_le_bytes());
        images.extend(pose.quaternion.iter().chain(&pose.translation).flat_map(|number| number.to_le_bytes()));
        images.extend((pose.camera as u32).to_le_bytes());
        images.extend(pose.name.bytes().chain([0]));
        images.extend(0u64.to_le_bytes());
    }
    let files = [("cameras.bin", sensors), ("images.bin", images), ("points3D.bin", 0u64.to_le_bytes().to_vec())];
    Ok(files.map(|(name, bytes)| (name.to_owned(), bytes)).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A model of one camera and one image with two points, byte by byte as COLMAP documents it.
    fn model(number: i32, parameters: &[f64]) -> (Vec<u8>, Vec<u8>) {
        let mut cameras = 1u64.to_le_bytes().to_vec();
        cameras.extend(7u32.to_le_bytes());
        cameras.extend(number.to_le_bytes());
        cameras.extend([9u64, 7].iter().flat_map(|side| side.to_le_bytes()));
        cameras.extend(parameters.iter().flat_map(|x| x.to_le_bytes()));
        let mut images = 1u64.to_le_bytes().to_vec();
        images.extend(3u32.to_le_bytes());
        images.extend([0.0, 1.0, 0.0, 0.0, 1.0, 2.0, 3.0f64].iter().flat_map(|x| x.to_le_bytes()));
        images.extend(7u32.to_le_bytes());
        images.extend(b"a b.png\0");
        images.extend(2u64.to_le_bytes());
        images.extend([1u8; 48]);
        (cameras, images)
    }

    #[test]
    fn a_model_is_read_past_its_points() {
        let (cameras, images) = model(3, &[100.0, 4.5, 3.5, 0.1, 0.2]);
        let block = read(&cameras, &images, Frame::Wall).unwrap().cameras;
        let s = &block.sensors[0];
        assert_eq!((s.f, s.cx, s.cy, s.k, s.width_px, s.height_px), (100.0, 4.0, 3.0, [0.1, 0.2, 0.0, 0.0], 9, 7));
        assert_eq!((block.images[0].name.as_str(), block.images[0].centre_m), ("a b.png", [-1.0, 2.0, 3.0]));
    }

    #[test]
    fn damaged_files_and_foreign_models_are_refused() {
        let (cameras, images) = model(1, &[9.0, 9.0, 4.5, 3.5]);
        let says = |cameras: &[u8], images: &[u8], text: &str| {
            let message = read(cameras, images, Frame::World).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        for end in 0..images.len() {
            says(&cameras, &images[..end], "images.bin:");
        }
        for end in 0..cameras.len() {
            says(&cameras[..end], &images, "cameras.bin:");
        }
        let fisheye = model(5, &[0.0; 8]).0;
        says(&fisheye, &images, "cameras.bin: camera 7: camera model `OPENCV_FISHEYE`");
        says(&model(99, &[]).0, &images, "camera model number 99");
        says(&[&cameras[..], &[0]].concat(), &images, "1 bytes follow");
        let mut many = images.clone();
        let count = images.len() - 56;
        many[count..count + 8].copy_from_slice(&u64::MAX.to_le_bytes());
        says(&cameras, &many, "ends too early");
    }
}
