//! `rockface graph`: the steps of a pipeline and what flows between them, as a picture or for programs that draw.

use clap::{Args, ValueEnum};
use rockface_core::Registry;

use super::{CliError, PipelineArgs, say};
use crate::drawing::Drawing;
use rockface_engine::diagnostic::Diagnostics;
use rockface_engine::pipeline::Pipeline;
use rockface_engine::plan::{Graph, resolve};

/// Arguments of `rockface graph`.
#[derive(Debug, Args)]
pub struct GraphArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The output format: `rockface graph p.yaml --format svg > p.svg` writes a picture; `dot` is for Graphviz.
    #[arg(long, value_enum, default_value_t = Format::Dot)]
    format: Format,
    /// Draw every use of a part as one box instead of a frame with its steps.
    #[arg(long)]
    fold: bool,
    /// The same as `--format json`.
    #[arg(long, conflicts_with = "format")]
    json: bool,
}

/// A language for graphs.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Graphviz.
    Dot,
    /// Mermaid, which Markdown viewers draw.
    Mermaid,
    /// A picture for browsers and documents.
    Svg,
    /// Steps and arrows for programs.
    Json,
}

impl GraphArgs {
    /// Prints the drawing in the language asked for.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        self.pipeline.take()?;
        let pipeline = self.pipeline.load(registry)?;
        let graph = self.graph(registry, &pipeline)?;
        let drawing = Drawing::of(&graph)
            .map_err(|list| CliError::Pipeline(Diagnostics { sources: pipeline.sources.clone(), list }))?;
        let drawing = if self.pipeline.target.is_empty() { drawing } else { drawing.only_needed() };
        let drawing = if self.fold { drawing.folded() } else { drawing };
        let format = if self.json { Format::Json } else { self.format };
        say(match format {
            Format::Dot => drawing.dot(),
            Format::Mermaid => drawing.mermaid(),
            Format::Svg => drawing.svg(),
            Format::Json => serde_json::to_string_pretty(&drawing.json()).unwrap_or_default(),
        }
        .trim_end());
        Ok(())
    }

    /// The graph, with the items of axes that are on record; drawing makes no store.
    fn graph(&self, registry: &Registry, pipeline: &Pipeline) -> Result<Graph, CliError> {
        let target = &self.pipeline.target;
        let graph = resolve(pipeline, target, registry.stages()).map_err(CliError::Pipeline)?;
        if !(0..graph.axes.len()).any(|axis| graph.is_pending(axis)) {
            return Ok(graph);
        }
        // What keeps it from being planned, such as a missing file, does not keep it from being drawn.
        Ok(self.pipeline.look(registry, pipeline, target).map_or(graph, |(plan, _)| plan.graph))
    }
}
