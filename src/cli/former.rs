//! Input files that are gone: what past runs know of them.

use std::sync::Arc;

use rockface_cache::Store;
use rockface_engine::history;
use rockface_engine::pipeline::Pipeline;
use rockface_engine::plan::{FormerInputs, Graph, Plan};

use super::{CliError, PipelineArgs, beside, complain};

impl PipelineArgs {
    /// What the runs of a pipeline know of its input files.
    pub fn former_inputs(&self, pipeline: &str) -> Arc<FormerInputs> {
        let runs = self.former_runs.clone().unwrap_or_else(|| beside(&self.pipeline).join("runs"));
        Arc::new(FormerInputs::new(self.recorded_inputs, history::find_inputs(runs, pipeline.to_owned())))
    }
}

/// Expands a graph, and warns of input files that are gone and whose former digests count.
pub fn expanded(graph: Graph, pipeline: &Pipeline, store: &Store) -> Result<Plan, CliError> {
    let plan = rockface_engine::plan::expand(graph, pipeline, store).map_err(CliError::Pipeline)?;
    for (path, run) in plan.graph.former.iter().flat_map(|former| former.used()) {
        let told = "steps that read it go by the digest it had in run";
        complain(&format!("warning: {} is not there: {told} {run}", path.display()));
    }
    Ok(plan)
}
