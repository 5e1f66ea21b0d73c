//! The names of the files that a run writes into its folder, beside those of outputs, and of one that only its archive has.

/// The manifest.
pub const MANIFEST_FILE: &str = "run.json";
/// The text of the pipeline.
pub const PIPELINE_FILE: &str = "pipeline.yaml";
/// The log, MCAP.
pub const LOG_FILE: &str = "run.mcap";
/// The layout that opens the log.
pub const LAYOUT_FILE: &str = "foxglove-layout.json";
/// The description as a research object.
pub const CRATE_FILE: &str = "ro-crate-metadata.json";
/// The page of the run, for people.
pub const REPORT_FILE: &str = "report.html";
/// The numbers of all steps, a row a point of the axes.
pub const POINTS_FILE: &str = "points.csv";

/// All of them.
pub const RUN_FILES: [&str; 7] =
    [MANIFEST_FILE, PIPELINE_FILE, LOG_FILE, LAYOUT_FILE, CRATE_FILE, REPORT_FILE, POINTS_FILE];

/// The BLAKE3 of every other file of an archive.
pub const SUMS_FILE: &str = "B3SUMS";
