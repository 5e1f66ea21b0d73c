//! Point clouds from elsewhere: points, colours and normals, whatever the format.

use super::cloud_text;
use rockface_core::artefact::CodecError;
use rockface_core::crs::Stated;
use rockface_core::format::{cloud_las, ply};

pub use rockface_core::format::cloud_las::Cloud;

/// Reads a cloud of whatever format its content shows: LAS or LAZ, PLY (faces are left out), or columns of numbers.
///
/// `columns` names the columns of a text file; see [`cloud_text::read`].
///
/// # Errors
/// The place at fault, as the reader of the format says it; `cancelled` became true.
pub fn read(bytes: Vec<u8>, columns: Option<&[String]>, cancelled: &dyn Fn() -> bool) -> Result<Cloud, CodecError> {
    read_classes(bytes, columns, &|_| true, cancelled)
}

/// The same of the points whose class is `wanted`, where the format has classes (LAS and LAZ).
///
/// # Errors
/// As [`read`].
pub fn read_classes(
    bytes: Vec<u8>,
    columns: Option<&[String]>,
    wanted: &dyn Fn(u8) -> bool,
    cancelled: &dyn Fn() -> bool,
) -> Result<Cloud, CodecError> {
    if bytes.starts_with(b"LASF") {
        return cloud_las::read_classes(bytes, wanted, cancelled);
    }
    if bytes.starts_with(b"ply") {
        return read_ply(&bytes);
    }
    if bytes.iter().take(4096).any(|byte| *byte == 0) {
        return Err(CodecError::new("its content is not LAS, LAZ, PLY or columns of numbers"));
    }
    cloud_text::read(&bytes, columns, cancelled)
}

fn read_ply(bytes: &[u8]) -> Result<Cloud, CodecError> {
    // What has faces is a mesh, and what is wrong with the file either reader says.
    let (points, colours, normals, frame) = if let Ok(cloud) = ply::cloud::read(bytes) {
        (cloud.points, cloud.colours, cloud.normals, cloud.frame)
    } else {
        let mesh = ply::read_mesh(bytes)?;
        (mesh.vertices, mesh.colours, Vec::new(), mesh.frame)
    };
    let stated = frame.world_crs().map(Stated::of_crs);
    let sum = |sum: [f64; 3], normal: &[f32; 3]| [0, 1, 2].map(|axis| sum[axis] + f64::from(normal[axis]));
    let normals = normals.iter().fold([0.0; 3], sum);
    Ok(Cloud { points, colours, normals, stated, ..Cloud::default() })
}
