//! Point clouds from elsewhere: points and colours, whatever the format.

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
    if bytes.starts_with(b"LASF") {
        return cloud_las::read(bytes, cancelled);
    }
    if bytes.starts_with(b"ply") {
        let mesh = ply::read_mesh(&bytes)?;
        let georeference = mesh.frame.georeference();
        let stated = georeference.map(|georeference| Stated::of_crs(&georeference.crs));
        return Ok(Cloud {
            points: mesh.vertices,
            colours: mesh.colours,
            stated,
            frame: Some(mesh.frame),
            warnings: Vec::new(),
        });
    }
    if bytes.iter().take(4096).any(|byte| *byte == 0) {
        return Err(CodecError::new("its content is not LAS, LAZ, PLY or columns of numbers"));
    }
    cloud_text::read(&bytes, columns, cancelled)
}
