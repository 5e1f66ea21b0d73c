//! A small picture of an artefact for logs and reports.

use super::CodecError;

/// A small picture with its caption. It is made from an artefact at any time and never kept as one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Preview {
    /// What is seen, in a few words.
    pub caption: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue by row from the top.
    pub rgb: Vec<u8>,
}

impl Preview {
    /// The picture as a PNG file.
    ///
    /// # Errors
    /// That of the encoder.
    pub fn to_png(&self) -> Result<Vec<u8>, CodecError> {
        crate::kernel::canvas::png_of(self.width, self.height, &self.rgb)
    }
}
