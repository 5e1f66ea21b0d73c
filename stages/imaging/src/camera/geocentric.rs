//! Image blocks in geocentric coordinates, as of chunks on the Earth, brought to a map.

use nalgebra::{Matrix3, Rotation3, Vector3};
use std::collections::HashMap;

use crate::camera::map_projection::MapProjection;
use crate::camera::model::Camera;
use crate::camera::orientation::{quaternion, turn_positions};
use rockface_core::artefact::{Cameras, Covariance, Image, Sensor};
use rockface_core::crs::DatumShift;
use rockface_core::{StageError, fail};

/// Lengths on a map that differ less from one direction to another are those of a conformal one.
const CONFORMAL: f64 = 1e-5;

/// What a map is at the images of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtBlock {
    /// Least and greatest length on the map of a unit of horizontal length at the height of the images; heights are not scaled.
    pub scales: [f64; 2],
    /// How far grid north is to the east of true north at the first image, degrees.
    pub convergence_deg: f64,
    /// How far what is projected is off at most, pixels, since horizontal lengths are scaled and heights are not.
    pub most_px: f64,
}

/// Brings centres to the map with heights above the ellipsoid, and turns rotations and the covariance of centres by the rotation nearest to the
/// derivatives of the map at each image.
///
/// With a `shift` the centres are in WGS 84 and the map is on an older datum, to which they are shifted first.
///
/// Covariances of rotations are about the axes of the camera and stay. That of centres is turned and not scaled: the scale of a map is one to
/// some thousandths.
///
/// # Errors
///
/// A centre where the map does not reach, by name; a map that is not conformal.
pub fn to_map(
    cameras: &mut Cameras,
    covariance: Option<&mut Covariance>,
    map: &MapProjection,
    shift: Option<&DatumShift>,
) -> Result<AtBlock, StageError> {
    let angles = shift.map_or([0.0; 3], DatumShift::angles).map(|angle| -angle);
    let datum_from_file = Rotation3::from_scaled_axis(Vector3::from(angles)).into_inner();
    let mut turns: HashMap<String, Matrix3<f64>> = HashMap::new();
    let mut found: Option<AtBlock> = None;
    for image in &mut cameras.images {
        let centre_m = shift.map_or(image.centre_m, |shift| shift.from_wgs_84(image.centre_m));
        let Some(at) = map.place(centre_m) else {
            fail!("image `{}` at geocentric {:?} is at no place of the map", image.name, image.centre_m)
        };
        image.centre_m = at.place_m;
        if at.uneven > CONFORMAL {
            fail!(
                "lengths on the map differ by {:.4} % from one direction to another, so no rotation fits the images",
                100.0 * at.uneven
            )
        }
        let map_from_file = at.map_from_earth * datum_from_file;
        image.set_rotation(&(image.rotation() * quaternion(&map_from_file).inverse()));
        turns.insert(image.name.clone(), map_from_file);
        let off_px = off_px(&cameras.sensors[image.sensor], image, at.scale);
        let before =
            found.unwrap_or(AtBlock { scales: [at.scale; 2], convergence_deg: at.convergence_deg, most_px: off_px });
        let scales = [before.scales[0].min(at.scale), before.scales[1].max(at.scale)];
        found = Some(AtBlock { scales, most_px: before.most_px.max(off_px), ..before });
    }
    if let Some(covariance) = covariance {
        turn_positions(covariance, |image| turns.get(image).copied().unwrap_or_else(Matrix3::identity))?;
    }
    found.ok_or_else(|| StageError::new("the block has no images"))
}

/// How far the points seen along the border of an image move in it at most where horizontal lengths are scaled, pixels.
fn off_px(sensor: &Sensor, image: &Image, scale: f64) -> f64 {
    let camera = Camera::new(sensor, image);
    let (right, bottom) = (f64::from(sensor.width_px) - 1.0, f64::from(sensor.height_px) - 1.0);
    let middle = [right / 2.0, bottom / 2.0];
    let border = [0.0, middle[0], right].into_iter().flat_map(|u| [0.0, middle[1], bottom].map(|v| [u, v]));
    let moved = |pixel: [f64; 2]| {
        let [x, y] = camera.normalised(pixel)?;
        let ray = camera.camera_from_object().transpose() * Vector3::new(x, y, 1.0);
        let mapped = Vector3::new(ray.x * scale, ray.y * scale, ray.z);
        let [u, v] = camera.project_from_camera(&(camera.camera_from_object() * mapped))?;
        let (du, dv) = (u - pixel[0], v - pixel[1]);
        Some((du * du + dv * dv).sqrt())
    };
    border.filter_map(moved).fold(0.0, f64::max)
}
