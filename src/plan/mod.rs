//! From pipeline to plan: resolve names, expand axes, key every step instance.

mod graph;
mod instances;
mod parameters;
mod resolve;
mod values;

pub use graph::{Feed, Graph, GraphStep, Source};
pub use instances::{Given, Instance, Plan, counts, makes};
pub use parameters::{InputFile, StepParams};
pub use resolve::resolve;

use rockface_cache::Store;
use rockface_stages::AnyStage;

use crate::diagnostic::Diagnostics;
use crate::pipeline::Pipeline;

/// The stages a pipeline may use.
pub type Registry = [&'static dyn AnyStage];

/// Resolves and expands a pipeline; input files are hashed through the store, which remembers what did not change.
pub fn plan(pipeline: &Pipeline, targets: &[String], stages: &Registry, store: &Store) -> Result<Plan, Diagnostics> {
    let graph = resolve(pipeline, targets, stages)?;
    let hash =
        |path: &std::path::Path| store.hash_file(path).map(|file| file.digest).map_err(|error| error.to_string());
    Plan::new(graph, &hash).map_err(|list| Diagnostics { sources: pipeline.sources.clone(), list })
}
