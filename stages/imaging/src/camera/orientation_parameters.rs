//! The orientation parameters of an image block by name, and corrections applied to them.

use nalgebra::Vector3;

use crate::camera::camera_files::{check_sensor, find_name};
use crate::camera::model::exponential;
use crate::camera::orientation::quaternion;
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Sensor};

/// The parameters of an image, in order.
pub const EXTERIOR: [&str; 6] = ["rx", "ry", "rz", "X", "Y", "Z"];
/// The parameters of a sensor, in order.
pub const INTERIOR: [&str; 11] = ["f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2"];

/// One orientation parameter of a block: the index of its owner and its place in [`EXTERIOR`] or [`INTERIOR`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// Of an image: rotation about the camera axes (rad) or projection centre (m).
    Exterior(usize, usize),
    /// Of a sensor: px, or 1 for distortion coefficients.
    Interior(usize, usize),
}

impl Parameter {
    /// Finds a parameter such as `cam1.rx`; the owner's name may have or lack its file extension.
    pub fn find(cameras: &Cameras, name: &str) -> Result<Self, StageError> {
        let (owner, element) = name.rsplit_once('.').unwrap_or((name, ""));
        if let Some(place) = EXTERIOR.iter().position(|e| *e == element) {
            let names: Vec<&str> = cameras.images.iter().map(|image| image.name.as_str()).collect();
            return find_name(owner, &names).map(|i| Self::Exterior(i, place)).ok_or_else(|| unknown(name, cameras));
        }
        let names: Vec<&str> = cameras.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        let place = INTERIOR.iter().position(|e| *e == element);
        let parameter = place.and_then(|place| Some(Self::Interior(find_name(owner, &names)?, place)));
        parameter.ok_or_else(|| unknown(name, cameras))
    }

    /// Its full name, such as `cam1.rx`.
    pub fn name(self, cameras: &Cameras) -> String {
        match self {
            Self::Exterior(image, place) => format!("{}.{}", cameras.images[image].name, EXTERIOR[place]),
            Self::Interior(sensor, place) => format!("{}.{}", cameras.sensors[sensor].name, INTERIOR[place]),
        }
    }

    /// Whether it belongs to an image.
    pub fn is_exterior(self) -> bool {
        matches!(self, Self::Exterior(..))
    }
}

fn unknown(name: &str, cameras: &Cameras) -> StageError {
    let some = |names: Vec<&str>| {
        let more = if names.len() > 8 { ", ..." } else { "" };
        names.into_iter().take(8).collect::<Vec<_>>().join(", ") + more
    };
    let images = some(cameras.images.iter().map(|image| image.name.as_str()).collect());
    let sensors = some(cameras.sensors.iter().map(|sensor| sensor.name.as_str()).collect());
    let message = format!("`{name}` is no single orientation parameter of this block");
    StageError::new(message).hint(format!(
        "`<image>.{}` with images {images}; `<sensor>.{}` with sensors {sensors}",
        EXTERIOR.join("|"),
        INTERIOR.join("|")
    ))
}

/// Applies corrections: `R' = Exp(dtheta) R` (camera frame, rad), `C' = C + dC` (m), and sums for interior orientation.
///
/// Angles are never decomposed. Parameters without a correction keep their bits.
///
/// # Errors
///
/// When a corrected interior orientation is unusable (principal distance not positive).
pub fn correct(cameras: &Cameras, corrections: &[(Parameter, f64)]) -> Result<Cameras, StageError> {
    let mut corrected = cameras.clone();
    let mut rotations = vec![Vector3::zeros(); cameras.images.len()];
    for (parameter, value) in corrections {
        match *parameter {
            Parameter::Exterior(image, place @ 0..3) => rotations[image][place] += value,
            Parameter::Exterior(image, place) => corrected.images[image].centre_m[place - 3] += value,
            Parameter::Interior(sensor, place) => *element(&mut corrected.sensors[sensor], place) += value,
        }
    }
    for (image, rotation) in corrected.images.iter_mut().zip(&rotations) {
        if *rotation != Vector3::zeros() {
            image.set_rotation(&(quaternion(&exponential(rotation)) * image.rotation()));
        }
    }
    corrected.sensors.iter().try_for_each(check_sensor)?;
    Ok(corrected)
}

fn element(sensor: &mut Sensor, place: usize) -> &mut f64 {
    match place {
        0 => &mut sensor.f,
        1 => &mut sensor.cx,
        2 => &mut sensor.cy,
        3 => &mut sensor.b1,
        4 => &mut sensor.b2,
        5..9 => &mut sensor.k[place - 5],
        _ => &mut sensor.p[place - 9],
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Image};

    fn block() -> Cameras {
        let image = |name: &str| Image {
            name: name.into(),
            sensor: 0,
            camera_from_object: [0.6, 0.0, 0.8, 0.0],
            centre_m: [1.0, 2.0, 3.0],
        };
        let (k, p) = ([0.0; 4], [0.0; 2]);
        let sensor =
            Sensor { name: "s".into(), width_px: 9, height_px: 7, f: 9.0, cx: 4.0, cy: 3.0, b1: 0.0, b2: 0.0, k, p };
        Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![image("a.png"), image("b.png")] }
    }

    #[test]
    fn every_name_finds_its_number() {
        let block = block();
        for (place, element) in EXTERIOR.iter().enumerate() {
            let parameter = Parameter::find(&block, &format!("b.{element}")).unwrap();
            assert_eq!(parameter, Parameter::Exterior(1, place));
            assert_eq!(parameter.name(&block), format!("b.png.{element}"));
        }
        for (place, name) in INTERIOR.iter().enumerate() {
            assert_eq!(Parameter::find(&block, &format!("s.{name}")).unwrap(), Parameter::Interior(0, place));
        }
        for name in ["c.rx", "a.f", "s.rx", "s.k5", "s"] {
            let error = Parameter::find(&block, name).unwrap_err();
            assert!(error.message.contains(name) && error.hint.unwrap().contains("images a.png, b.png"));
        }
    }

    #[test]
    fn corrections_land_where_they_belong() {
        let block = block();
        let all: Vec<(Parameter, f64)> = (0..11).map(|i| (Parameter::Interior(0, i), 1.0 + i as f64)).collect();
        let sensor = correct(&block, &all).unwrap().sensors[0].clone();
        assert_eq!((sensor.f, sensor.cx, sensor.cy, sensor.b1, sensor.b2), (10.0, 6.0, 6.0, 4.0, 5.0));
        assert_eq!((sensor.k, sensor.p), ([6.0, 7.0, 8.0, 9.0], [10.0, 11.0]));
        let moved = correct(&block, &[(Parameter::Exterior(0, 0), 1e-3), (Parameter::Exterior(0, 4), 0.5)]).unwrap();
        assert_eq!(moved.images[0].centre_m, [1.0, 2.5, 3.0]);
        assert_eq!(moved.images[1], block.images[1]);
        // A turn about the camera's own x axis moves its y and z axes only.
        let turn = moved.images[0].matrix() * block.images[0].matrix().transpose();
        assert!((turn - exponential(&Vector3::new(1e-3, 0.0, 0.0))).norm() < 1e-15);
        assert!(correct(&block, &[(Parameter::Interior(0, 0), -9.0)]).is_err());
    }
}
