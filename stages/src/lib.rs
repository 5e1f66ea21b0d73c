//! The stages of rockface: photogrammetric rockfall simulation and the statistics of its noise.
//!
//! `artefact/` holds the nouns, `kernel/` the verbs, and each stage is one file of its own: `verb_object.rs` for
//! `verb-object` in a pipeline. Nothing here touches disk, clock, thread count, YAML or hash function; what a stage
//! needs of them it is lent through [`Context`].

pub mod artefact;
pub mod kernel;
pub mod params;
mod stage;

// A new stage is its file, its `mod` and its row.
mod draw_picture;
mod import_mesh;
mod rasterise_dem;
mod register_icp;
mod synthesise_face;
mod transform_crs;

#[cfg(test)]
pub(crate) mod testing;

pub use stage::{
    AnyStage, Arity, Checked, Context, Element, Entry, Host, Inputs, Outputs, Page, Point, Port, Row, SourceFile,
    Stage, StageError,
};

static STAGES: &[&dyn AnyStage] = &[
    &Row::<draw_picture::DrawPicture>::new(),
    &Row::<import_mesh::ImportMesh>::new(),
    &Row::<rasterise_dem::RasteriseDem>::new(),
    &Row::<register_icp::RegisterIcp>::new(),
    &Row::<synthesise_face::SynthesiseFace>::new(),
    &Row::<transform_crs::TransformCrs>::new(),
];

/// Every stage there is, in the order of the catalogue.
pub fn all() -> &'static [&'static dyn AnyStage] {
    STAGES
}

/// The stage of a name.
pub fn find(name: &str) -> Option<&'static dyn AnyStage> {
    STAGES.iter().copied().find(|stage| stage.name() == name)
}
