//! A small picture of an artefact for logs and reports.

/// A small picture with its caption. It is made from an artefact at any time and never kept as one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Preview {
    /// What is seen, in a few words.
    pub caption: String,
    /// Number of pixel columns.
    pub width: usize,
    /// Number of pixel rows.
    pub height: usize,
    /// Red, green and blue by row from the top.
    pub rgb: Vec<u8>,
}
