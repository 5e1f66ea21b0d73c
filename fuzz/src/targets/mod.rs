//! The targets: one for each format that is read, by its place in a run.

mod artefacts;
mod cameras;
mod host;
mod imports;
mod pipelines;
mod runs;
mod store;

pub use cameras::image_block;
pub use host::{Files, made};
pub use pipelines::{INCLUDED, long_text};
pub use store::{QUESTION, sealed};

use rockface_core::artefact::Kind;

/// What became of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It was read, and what was read was put to use.
    Accepted,
    /// It was refused with a reason.
    Refused,
}

impl Verdict {
    /// Accepted where something was read.
    pub fn of(is_read: bool) -> Self {
        if is_read { Self::Accepted } else { Self::Refused }
    }
}

/// A format that is read, and how a case of it is tried.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name, that of its folder of files.
    pub name: &'static str,
    /// What is read, for the list of targets.
    pub about: &'static str,
    /// The dictionary of its words; empty for none.
    pub dictionary: &'static str,
    /// Reads a case and puts it to use.
    pub run: fn(&[u8]) -> Verdict,
}

const fn target(
    name: &'static str,
    about: &'static str,
    dictionary: &'static str,
    run: fn(&[u8]) -> Verdict,
) -> Target {
    Target { name, about, dictionary, run }
}

/// Every target, in the order of the list.
pub const ALL: &[Target] = &[
    target("pipeline", "the YAML of a pipeline and of what it includes, up to its plan", "pipeline", pipelines::text),
    target("overrides", "`--set` and `--sweep` texts on a fixed pipeline", "pipeline", pipelines::overrides),
    target("tree", "the tree of a long pipeline, as the store keeps it", "", pipelines::tree),
    target("mesh", "PLY, OBJ and STL by `import-mesh`", "mesh", imports::mesh),
    target("blocks", "several meshes by `import-blocks`", "mesh", imports::blocks),
    target("cloud", "PLY, LAS, LAZ and columns of numbers by `import-cloud`", "mesh", imports::cloud),
    target("rasters", "GeoTIFF by `import-rasters`", "", imports::rasters),
    target("table", "CSV by `import-table`", "", imports::table),
    target("inventory", "GeoJSON by `import-inventory`", "json", imports::inventory),
    target("samples", "CSV with the values of a distribution, by `generate-blocks`", "", imports::samples),
    target("shapes", "the parameters of `generate-blocks`", "json", imports::shapes),
    target("cameras-json", "image blocks in JSON", "json", cameras::json),
    target("cameras-metashape", "Metashape's camera XML", "xml", cameras::metashape),
    target("cameras-bundler", "a Bundler file and its list", "", cameras::bundler),
    target("cameras-colmap-text", "COLMAP's text model", "colmap", cameras::colmap_text),
    target("cameras-colmap-binary", "COLMAP's binary model", "", cameras::colmap_binary),
    target("covariance", "the joint covariance of an image block in JSON", "json", cameras::covariance),
    target("colmap-fused", "the cloud that COLMAP fused, and who sees its points", "mesh", imports::fused),
    target("artefact-cloud", "a kept cloud (PLY)", "mesh", |bytes| artefacts::kept(Kind::Cloud, bytes)),
    target("artefact-mesh", "a kept mesh (PLY)", "mesh", |bytes| artefacts::kept(Kind::Mesh, bytes)),
    target("artefact-meshes", "kept blocks (PLY)", "mesh", |bytes| artefacts::kept(Kind::Meshes, bytes)),
    target("artefact-surface", "a kept surface", "", |bytes| artefacts::kept(Kind::Surface, bytes)),
    target("artefact-raster", "a kept raster (GeoTIFF)", "", |bytes| artefacts::kept(Kind::Raster, bytes)),
    target("artefact-depth", "a kept depth map (OpenEXR)", "", |bytes| artefacts::kept(Kind::Depth, bytes)),
    target("artefact-cameras", "a kept image block", "json", |bytes| artefacts::kept(Kind::Cameras, bytes)),
    target("artefact-covariance", "a kept covariance", "json", |bytes| artefacts::kept(Kind::Covariance, bytes)),
    target("artefact-pairs", "kept stereo pairs", "json", |bytes| artefacts::kept(Kind::Pairs, bytes)),
    target("artefact-transform", "a kept transform", "json", |bytes| artefacts::kept(Kind::Transform, bytes)),
    target("artefact-table", "a kept table", "json", |bytes| artefacts::kept(Kind::Table, bytes)),
    target("artefact-acceptance", "a kept reference model", "json", |bytes| artefacts::kept(Kind::Acceptance, bytes)),
    target("artefact-noise", "a kept noise model", "", |bytes| artefacts::kept(Kind::Noise, bytes)),
    target("artefact-picture", "a kept picture (PNG)", "", |bytes| artefacts::kept(Kind::Picture, bytes)),
    target("artefact-figure", "a kept chart (SVG)", "xml", |bytes| artefacts::kept(Kind::Figure, bytes)),
    target("artefact-files", "kept files (tar)", "", |bytes| artefacts::kept(Kind::Files, bytes)),
    target("artefact-inventory", "a kept inventory", "json", |bytes| artefacts::kept(Kind::Inventory, bytes)),
    target("artefact-candidates", "kept candidates", "json", |bytes| artefacts::kept(Kind::Candidates, bytes)),
    target("sketches", "sketches of the outputs of a step", "json", artefacts::sketches),
    target("step-log", "what a step said, in the log of a run", "json", runs::step_log),
    target("manifest", "run.json, up to comparison, report and archive", "json", runs::manifest),
    target("record", "a record of the store", "json", store::record),
    target("segment", "a segment of the store, as it is", "", store::segment),
    target("segment-sealed", "a segment whose checksums are right", "", store::segment_sealed),
    target("answer", "what a command came to last time", "json", store::answer),
];

/// The target of a name.
pub fn find(name: &str) -> Option<&'static Target> {
    ALL.iter().find(|target| target.name == name)
}
