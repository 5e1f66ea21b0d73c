//! `rockface graph`: the steps of a pipeline and what flows between them, as a picture or for programs that draw.

use clap::{Args, ValueEnum};

use super::{CliError, PipelineArgs, say};
use crate::diagnostic::Diagnostics;
use crate::drawing::Drawing;
use crate::plan::resolve;

/// Arguments of `rockface graph`.
#[derive(Debug, Args)]
pub struct GraphArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The language to write: `rockface graph p.yaml --format svg > p.svg` is a picture; Graphviz makes one of the first.
    #[arg(long, value_enum, default_value_t = Format::Dot)]
    format: Format,
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
}

impl GraphArgs {
    /// Prints the graph.
    pub fn run(self) -> Result<(), CliError> {
        let pipeline = self.pipeline.load()?;
        let graph = resolve(&pipeline, &self.pipeline.target, rockface_stages::all()).map_err(CliError::Pipeline)?;
        let drawing = Drawing::of(&graph)
            .map_err(|list| CliError::Pipeline(Diagnostics { sources: pipeline.sources.clone(), list }))?;
        say(match self.format {
            Format::Dot => drawing.dot(),
            Format::Mermaid => drawing.mermaid(),
            Format::Svg => drawing.svg(),
        }
        .trim_end());
        Ok(())
    }
}
