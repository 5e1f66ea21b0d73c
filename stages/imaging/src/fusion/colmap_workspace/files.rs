//! The files of a workspace, each by its layout.

use super::View;
use super::tie_points::TiePoint;
use crate::camera::pinhole::PinholeMap;
use rockface_core::StageError;

/// COLMAP's sparse code counts pixels from the corner of the first one.
const HALF_PIXEL: f64 = 0.5;
/// Grey of the pictures: COLMAP wants one of every image for the colours of its points.
const GREY: u8 = 128;

/// Images are named by their numbers: their real names may have blanks and slashes.
pub fn image_name(number: usize) -> String {
    format!("{number:06}.png")
}

/// `cameras.txt`, `images.txt` and `points3D.txt`; the principal point as the dense code counts it.
pub fn sparse_model(views: &[View], ties: &[TiePoint]) -> Vec<(String, Vec<u8>)> {
    let (mut cameras, mut images, mut points) = (String::new(), String::new(), String::new());
    let mut observations = vec![String::new(); views.len()];
    let mut counts = vec![0usize; views.len()];
    for (number, tie) in ties.iter().enumerate() {
        let [x, y, z]: [f64; 3] = tie.point_m.into();
        points += &format!("{} {x} {y} {z} {GREY} {GREY} {GREY} 0", number + 1);
        for (view, [u, v]) in &tie.seen {
            points += &format!(" {} {}", view + 1, counts[*view]);
            observations[*view] += &format!("{} {} {} ", u + HALF_PIXEL, v + HALF_PIXEL, number + 1);
            counts[*view] += 1;
        }
        points += "\n";
    }
    for (number, (view, observed)) in views.iter().zip(&observations).enumerate() {
        let PinholeMap { width, height, focal_px: [fx, fy], centre_px: [cx, cy], .. } = view.map;
        cameras += &format!("{} PINHOLE {width} {height} {fx} {fy} {cx} {cy}\n", number + 1);
        let [qw, qx, qy, qz] = view.depth.image.camera_from_object;
        let [tx, ty, tz]: [f64; 3] = (-(view.depth.image.rotation() * view.centre_m)).into();
        let (id, name) = (number + 1, image_name(number));
        images += &format!("{id} {qw} {qx} {qy} {qz} {tx} {ty} {tz} {id} {name}\n{}\n", observed.trim_end());
    }
    let files = [("cameras", cameras), ("images", images), ("points3D", points)];
    files.map(|(name, text)| (format!("sparse/{name}.txt"), text.into_bytes())).into()
}

/// Picture, depth map and normal map of an image.
pub fn dense_maps(number: usize, map: &PinholeMap, normal_reach: usize) -> Result<[(String, Vec<u8>); 3], StageError> {
    let name = image_name(number);
    let normals = map.normals(normal_reach);
    let known = |value: f32| if value.is_finite() { value } else { 0.0 };
    let depths = map.z.iter().map(|z| known(*z));
    // All first coordinates, then all second ones, then all third ones.
    let planes = (0..3).flat_map(|axis| normals.iter().map(move |normal| known(normal[axis])));
    Ok([
        (format!("images/{name}"), picture(map.width, map.height)?),
        (format!("stereo/depth_maps/{name}.geometric.bin"), array(map, 1, depths)),
        (format!("stereo/normal_maps/{name}.geometric.bin"), array(map, 3, planes)),
    ])
}

/// `width&height&channels&` and floats, least significant byte first, by channel and row.
fn array(map: &PinholeMap, channels: usize, values: impl Iterator<Item = f32>) -> Vec<u8> {
    let mut bytes = format!("{}&{}&{channels}&", map.width, map.height).into_bytes();
    bytes.reserve_exact(4 * channels * map.z.len());
    values.for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    bytes
}

/// A PNG in one even grey: COLMAP asks for a picture of each image.
fn picture(width: usize, height: usize) -> Result<Vec<u8>, StageError> {
    let fault =
        |error: png::EncodingError| StageError::new(format!("the picture for COLMAP cannot be written: {error}"));
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(fault)?;
    writer.write_image_data(&vec![GREY; width * height]).map_err(fault)?;
    writer.finish().map_err(fault)?;
    Ok(bytes)
}
