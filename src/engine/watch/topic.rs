//! Topics of a log, and the outputs that its messages stand for.

/// An output that a sketch stands for.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Made {
    /// BLAKE3 of the file.
    pub digest: String,
    /// The file, relative to the run folder; `None` where it was not kept.
    pub path: Option<String>,
}

/// A topic of the log.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Topic {
    /// Its name, such as `/wall/mesh`.
    pub name: String,
    /// The name of its schema, such as `foxglove.SceneUpdate`.
    pub schema: String,
}
