//! Steps that start programs, for whoever will not have any started.

use super::graph::Graph;
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::pipeline::Pipeline;

/// Refuses a graph in which a step that is wanted would start a program; each such step is named.
///
/// Whether its result is known already does not count: what is damaged or not kept is recomputed.
///
/// # Errors
///
/// The steps, at the places of their names.
pub fn without_programs(graph: &Graph, pipeline: &Pipeline) -> Result<(), Diagnostics> {
    let steps = graph.steps.iter().zip(graph.wanted()).filter(|(step, wanted)| *wanted && step.stage.starts_programs());
    let told = |name: &str, stage: &str| {
        format!("step `{name}` starts a program (stage `{stage}`), and none is to be started")
    };
    let hint = "leave out --no-commands (or ROCKFACE_NO_COMMANDS) if you trust the pipeline, or name targets that need no such step";
    let list: Vec<Diagnostic> =
        steps.map(|(step, _)| Diagnostic::at(step.span, told(&step.name, step.stage.name())).hint(hint)).collect();
    if list.is_empty() { Ok(()) } else { Err(Diagnostics { sources: pipeline.sources.clone(), list }) }
}
