//! `rockface report`: the page of a past run, made anew.

use std::path::PathBuf;

use clap::Args;

use super::places::Places;
use super::{CliError, complain, say};
use crate::report::{self, Source};
use rockface_core::Registry;
use rockface_engine::history::{self, REPORT_FILE, RunContents};

/// Arguments of `rockface report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// A run folder, its name, a part of it, or `latest`.
    run: String,
    /// The file to write [default: `report.html` in the run folder].
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    places: Places,
}

impl ReportArgs {
    /// Writes the report.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        let run = history::find(&self.places.runs, &self.run)?;
        let store = self.places.store_beside(&run.folder)?;
        if store.is_none() {
            complain("warning: there is no store here; what is not in the run folder is missing from the report");
        }
        let graph = report::graph_of(registry, &run.manifest);
        let (folder, manifest) = (&run.folder, &run.manifest);
        let (store, graph, look) = (store.as_ref(), graph.as_ref(), registry.look());
        let source = Source { run: RunContents { folder, manifest, store, graph, logs: None }, look };
        let to = self.output.unwrap_or_else(|| run.folder.join(REPORT_FILE));
        report::write(&source, &to)?;
        say(&to.display().to_string());
        Ok(())
    }
}
