//! A folder from which Agisoft Metashape builds a mesh: depth images, pictures, cameras, a script that imports them.
//!
//! Depth images are float TIFFs of one channel, z in the camera frame in metres, 0 where there is none, of cameras without
//! distortion: Metashape takes the depth of a pixel to lie on the pixel's ray.

mod readme;

use std::io::Cursor;

use nalgebra::Vector3;
use serde_json::json;
use tiff::encoder::{TiffEncoder, colortype::Gray32Float};

use crate::camera::camera_files::metashape;
use crate::camera::pinhole::PinholeMap;
use rockface_core::StageError;
use rockface_core::artefact::{Cameras, Depth, Frame, Image, Sensor};

/// The script beside the files.
pub const SCRIPT: &str = include_str!("import_depth.py");
/// Half width of the windows for the shading of the pictures, pixels.
const SHADE_REACH: usize = 2;
/// Largest coordinate that is not shifted, metres; larger ones would lose millimetres in single precision.
const FAR_M: f64 = 10_000.0;
/// Multiple to which the origin of shifted coordinates is rounded, metres.
const ORIGIN_STEP_M: f64 = 1000.0;

/// The files of a project.
pub struct Project {
    /// Path in the folder and content of each file.
    pub files: Vec<(String, Vec<u8>)>,
    /// Origin of its coordinates in the frame of the depth maps, metres.
    pub origin_m: [f64; 3],
}

/// Lays out the folder for depth maps in one frame.
///
/// # Errors
/// A picture or an image that cannot be written; a name that XML cannot hold.
pub fn lay_out(depths: &[&Depth], frame: Frame) -> Result<Project, StageError> {
    let origin = origin(depths);
    let mut cameras = Cameras { frame, sensors: Vec::new(), images: Vec::new() };
    let (mut files, mut listed) = (Vec::new(), Vec::new());
    for (number, depth) in depths.iter().enumerate() {
        let map = PinholeMap::of(depth);
        let label = label(number, &depth.image.name);
        let sensor = sensor_of(&map, &mut cameras.sensors);
        let centre_m = (depth.image.centre() - origin).into();
        cameras.images.push(Image { name: label.clone(), sensor, centre_m, ..depth.image.clone() });
        let (depth_file, picture_file) = (format!("depth/{label}.tif"), format!("images/{label}.png"));
        listed.push(json!({
            "image": depth.image.name, "label": label, "depth": depth_file, "picture": picture_file,
            "width_px": map.width, "height_px": map.height, "focal_px": map.focal_px[1],
        }));
        files.push((depth_file, depth_image(&map)?));
        files.push((picture_file, picture(&map)?));
    }
    let origin_m: [f64; 3] = origin.into();
    let list = json!({ "frame": frame.to_string(), "offset_m": origin_m, "images": listed });
    files.push(("cameras.xml".to_owned(), metashape::write(&cameras, None)?));
    files.push(("images.json".to_owned(), format!("{list:#}\n").into_bytes()));
    files.push(("import_depth.py".to_owned(), SCRIPT.as_bytes().to_vec()));
    files.push(("README.txt".to_owned(), readme::text(depths.len(), frame, origin_m).into_bytes()));
    Ok(Project { files, origin_m })
}

fn origin(depths: &[&Depth]) -> Vector3<f64> {
    let mean = depths.iter().map(|depth| depth.image.centre()).sum::<Vector3<f64>>() / depths.len() as f64;
    if mean.amax() < FAR_M { Vector3::zeros() } else { mean.map(|x| (x / ORIGIN_STEP_M).round() * ORIGIN_STEP_M) }
}

/// A file name and label: the number makes it unique, the name readable.
fn label(number: usize, name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' };
    format!("{number:04}_{}", name.chars().map(plain).collect::<String>())
}

/// The number of the sensor of a map; maps of equal sensors share one.
fn sensor_of(map: &PinholeMap, sensors: &mut Vec<Sensor>) -> usize {
    let sensor = |name: String| Sensor {
        name,
        width_px: map.width as u32,
        height_px: map.height as u32,
        f: map.focal_px[1],
        cx: map.centre_px[0],
        cy: map.centre_px[1],
        b1: map.focal_px[0] - map.focal_px[1],
        b2: 0.0,
        k: [0.0; 4],
        p: [0.0; 2],
    };
    let same = |known: &Sensor| *known == sensor(known.name.clone());
    sensors.iter().position(same).unwrap_or_else(|| {
        sensors.push(sensor(format!("depth maps {}", sensors.len() + 1)));
        sensors.len() - 1
    })
}

fn depth_image(map: &PinholeMap) -> Result<Vec<u8>, StageError> {
    let fault = |error: tiff::TiffError| StageError::new(format!("a depth image cannot be written: {error}"));
    let values: Vec<f32> = map.z.iter().map(|z| if z.is_finite() { *z } else { 0.0 }).collect();
    let mut file = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file).map_err(fault)?;
    encoder.write_image::<Gray32Float>(map.width as u32, map.height as u32, &values).map_err(fault)?;
    Ok(file.into_inner())
}

/// A picture of every image: the surface lit from the camera, black where there is no depth.
fn picture(map: &PinholeMap) -> Result<Vec<u8>, StageError> {
    let fault = |error: png::EncodingError| StageError::new(format!("a picture cannot be written: {error}"));
    let shade =
        |normal: &[f32; 3]| if normal[2].is_finite() { (255.0 * (-normal[2]).clamp(0.1, 1.0)) as u8 } else { 0 };
    let rgb: Vec<u8> = map.normals(SHADE_REACH).iter().flat_map(|normal| [shade(normal); 3]).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, map.width as u32, map.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(fault)?;
    writer.write_image_data(&rgb).map_err(fault)?;
    writer.finish().map_err(fault)?;
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests;
