//! The files artefacts are kept in, and those of other programs that several rooms read or write.

pub mod cloud_las;
pub mod cloud_laz;
pub mod depth_exr;
pub mod distribution_file;
pub mod geotiff;
pub mod inventory_file;
mod las_normals;
mod laz_check;
pub mod noise_file;
pub mod nouns;
#[cfg(feature = "parquet")]
pub mod parquet_file;
pub mod ply;
pub mod png;
pub mod sketch_file;
pub mod surface_file;
pub mod table_file;
pub mod tar_file;

use crate::artefact::CodecError;

/// The text of a file.
///
/// # Errors
/// The first line that is not UTF-8.
pub fn utf8(bytes: &[u8]) -> Result<&str, CodecError> {
    std::str::from_utf8(bytes).map_err(|fault| {
        let line = bytes[..fault.valid_up_to()].split(|byte| *byte == b'\n').count();
        CodecError::new(format!(
            "line {line} is no UTF-8 text, but perhaps Latin-1 or Windows-1252: save the file as UTF-8, which spreadsheets call `CSV UTF-8`"
        ))
    })
}

/// Text in UTF-8 without the byte order mark that some editors write before it.
pub fn without_mark(text: &[u8]) -> &[u8] {
    text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text)
}
