//! The stages of rockface: photogrammetric rockfall simulation and the statistics of its noise.
//!
//! `artefact/` holds the nouns, `kernel/` the verbs, and each stage is one file of its own: `verb_object.rs` for
//! `verb-object` in a pipeline. Nothing here touches disk, clock, thread count, YAML or hash function; what a stage
//! needs of them it is lent through [`Context`].

pub mod artefact;
pub mod kernel;
pub mod params;
mod stage;
#[cfg(test)]
pub(crate) mod testing;

// A new stage is its file, its `mod` and its row.
mod apply_mask;
mod describe_noise;
mod difference_dem;
mod filter_outliers;
mod fit_acceptance;
mod import_rasters;
mod tabulate;
mod test_acceptance;

pub use stage::{
    AnyStage, Arity, Checked, Context, Element, Entry, Host, Inputs, Outputs, Page, Point, Port, Row, SourceFile,
    Stage, StageError,
};

static STAGES: &[&dyn AnyStage] = &[
    &Row::<apply_mask::ApplyMask>::new(),
    &Row::<describe_noise::DescribeNoise>::new(),
    &Row::<difference_dem::DifferenceDem>::new(),
    &Row::<filter_outliers::FilterOutliers>::new(),
    &Row::<fit_acceptance::FitAcceptance>::new(),
    &Row::<import_rasters::ImportRasters>::new(),
    &Row::<tabulate::Tabulate>::new(),
    &Row::<test_acceptance::TestAcceptance>::new(),
];

/// Every stage there is, in the order of the catalogue.
pub fn all() -> &'static [&'static dyn AnyStage] {
    STAGES
}

/// The stage of a name.
pub fn find(name: &str) -> Option<&'static dyn AnyStage> {
    STAGES.iter().copied().find(|stage| stage.name() == name)
}
