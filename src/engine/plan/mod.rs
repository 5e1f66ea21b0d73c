//! From pipeline to plan: resolve names, expand axes, key every step instance.

mod axis_propagation;
mod certain;
mod completion;
mod dynamic;
mod faults;
mod former;
mod graph;
mod hit;
mod inputs;
mod instances;
mod late_items;
mod log_levels;
mod missing;
mod parameters;
mod partial_check;
mod points;
mod programs;
mod resolve;
mod side_files;
mod sight;
mod targets;
mod unused;

pub use completion::{complete, find};
pub use dynamic::{Items, Unknown, items_of, partners_of};
pub use former::{FindFormer, FormerInputs};
pub use graph::{Dynamic, Feed, Graph, GraphStep, Later, ListPoint, Partners, Source};
pub use hit::hit;
pub use instances::{Given, Instance, Plan, has_ports, makes};
pub use parameters::{InputFile, StepParams};
pub use points::{Wait, counts};
pub use programs::without_programs;
pub use resolve::resolve;
pub use sight::{Looks, kind_of};

use rockface_cache::{Digest, Store};
use rockface_core::AnyStage;

use crate::diagnostic::Diagnostics;
use crate::pipeline::Pipeline;

/// The stages a pipeline may use.
pub type Stages = [&'static dyn AnyStage];

/// Resolves a pipeline and expands the steps whose axes have items on record; input files are hashed through the
/// store, which remembers what did not change.
pub fn plan(pipeline: &Pipeline, targets: &[String], stages: &Stages, store: &Store) -> Result<Plan, Diagnostics> {
    expand(resolve(pipeline, targets, stages)?, pipeline, store)
}

/// Expands the steps of a resolved pipeline whose axes have items on record.
pub fn expand(graph: Graph, pipeline: &Pipeline, store: &Store) -> Result<Plan, Diagnostics> {
    let hash = file_hash(store);
    let told = |list| Diagnostics { sources: pipeline.sources.clone(), list };
    let mut plan = Plan::new(graph, &hash).map_err(told)?;
    plan.take_recorded(store, &hash).map_err(told)?;
    Ok(plan)
}

/// How a file is hashed through a store.
pub fn file_hash(store: &Store) -> impl Fn(&std::path::Path) -> Result<Digest, String> {
    |path| store.hash_file(path).map(|file| file.digest).map_err(|error| error.to_string())
}
