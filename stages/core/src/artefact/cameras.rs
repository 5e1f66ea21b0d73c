//! Sensors (interior orientation) and images (exterior orientation) of a survey.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::Frame;

/// Interior orientation and distortion of a camera, Brown-Conrady in the `OpenCV` convention.
///
/// With `r2 = x2 + y2` on normalised coordinates (x right, y down), `radial = 1 + k1 r2 + k2 r2^2 + k3 r2^3 + k4 r2^4`:
/// `x' = x radial + 2 p1 x y + p2 (r2 + 2 x2)`, `y' = y radial + p1 (r2 + 2 y2) + 2 p2 x y`,
/// `u = cx + f x' + b1 x' + b2 y'`, `v = cy + f y'`. The centre of the first pixel is (0, 0).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Its name, as covariance parameters refer to it (`<name>.f`).
    pub name: String,
    /// Number of pixel columns of an image.
    pub width_px: u32,
    /// Number of pixel rows of an image.
    pub height_px: u32,
    /// Principal distance, pixels.
    pub f: f64,
    /// Principal point, pixels from the centre of the first pixel.
    pub cx: f64,
    /// Principal point, pixels from the centre of the first pixel.
    pub cy: f64,
    /// Affinity, pixels (`fx = f + b1`).
    pub b1: f64,
    /// Skew, pixels.
    pub b2: f64,
    /// Radial distortion k1 to k4.
    pub k: [f64; 4],
    /// Decentring distortion p1, p2.
    pub p: [f64; 2],
}

/// Exterior orientation of an image: camera frame x right, y down, z forward, `X_c = R (X - C)`.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Image {
    /// Its name, as covariance parameters refer to it (`<name>.rx`).
    pub name: String,
    /// Index into the sensors.
    pub sensor: usize,
    /// Unit quaternion (w, x, y, z) of R, which takes object coordinates to the camera frame.
    pub camera_from_object: [f64; 4],
    /// Projection centre C in the frame of the block, metres.
    pub centre_m: [f64; 3],
}

impl Image {
    /// R as a unit quaternion; an imported one that is off unit length by rounding is normalised.
    pub fn rotation(&self) -> UnitQuaternion<f64> {
        let [w, x, y, z] = self.camera_from_object;
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
    }

    /// R as a matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        self.rotation().to_rotation_matrix().into_inner()
    }

    /// C as a vector, metres.
    pub fn centre(&self) -> Vector3<f64> {
        self.centre_m.into()
    }

    /// The optical axis in the frame of the block: unit vector forward.
    pub fn axis(&self) -> Vector3<f64> {
        self.matrix().row(2).transpose()
    }

    /// Replaces R, which takes object coordinates to the camera frame.
    pub fn set_rotation(&mut self, camera_from_object: &UnitQuaternion<f64>) {
        let q = camera_from_object.quaternion();
        self.camera_from_object = [q.w, q.i, q.j, q.k];
    }
}

/// An image block: sensors and oriented images in one frame.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cameras {
    /// The frame of the projection centres and rotations.
    pub frame: Frame,
    /// Interior orientations; an image names its own by the place in this list.
    pub sensors: Vec<Sensor>,
    /// Exterior orientations, in project order.
    pub images: Vec<Image>,
}

impl Cameras {
    /// An image by name.
    pub fn image(&self, name: &str) -> Option<&Image> {
        self.images.iter().find(|image| image.name == name)
    }

    /// The sensor of an image.
    pub fn sensor(&self, image: &Image) -> &Sensor {
        &self.sensors[image.sensor]
    }
}

/// A file of another program may name sensors that it does not have.
fn check(cameras: &Cameras) -> Result<(), super::CodecError> {
    let sensors = cameras.sensors.len();
    let lost = cameras.images.iter().find(|image| image.sensor >= sensors);
    lost.map_or(Ok(()), |image| {
        let (name, sensor) = (&image.name, image.sensor);
        let message = format!("image `{name}` refers to sensor number {sensor}, there are {sensors} (counted from 0)");
        Err(super::CodecError(message))
    })
}

super::json_noun!(
    Cameras checked by check,
    fn items(&self) -> Option<Vec<String>> {
        Some(self.images.iter().map(|image| image.name.clone()).collect())
    }
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Noun;

    #[test]
    fn an_image_without_its_sensor_is_refused() {
        let cameras = Cameras {
            frame: Frame::Wall,
            sensors: vec![crate::testing::small_sensor()],
            images: vec![crate::testing::image_at("a", [0.0; 3], [0.0; 3])],
        };
        let text = String::from_utf8(cameras.encode().unwrap()).unwrap();
        assert_eq!(Cameras::decode(text.as_bytes()).unwrap(), cameras);
        let lost = Cameras::decode(text.replace("\"sensor\": 0", "\"sensor\": 1").as_bytes()).unwrap_err();
        assert_eq!(lost.0, "image `a` refers to sensor number 1, there are 1 (counted from 0)");
    }
}
