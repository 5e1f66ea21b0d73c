//! `rockface report`: the page of a past run, made anew.

use std::path::PathBuf;

use clap::Args;

use super::places::Places;
use super::{CliError, complain, say};
use crate::history;
use crate::report::{self, Source};

/// Arguments of `rockface report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// A run folder, its name, a part of it, or `latest`.
    run: String,
    /// The file to write; by default `report.html` in the run folder.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    places: Places,
}

impl ReportArgs {
    /// Writes the report.
    pub fn run(self) -> Result<(), CliError> {
        let run = history::find(&self.places.runs, &self.run)?;
        let store = self.places.store_beside(&run.folder)?;
        if store.is_none() {
            complain("warning: there is no store here; what is not in the run folder is missing from the report");
        }
        let graph = report::graph_of(&run.manifest);
        let (folder, manifest) = (&run.folder, &run.manifest);
        let source = Source { folder, manifest, store: store.as_ref(), graph: graph.as_ref(), logs: None };
        let to = self.output.unwrap_or_else(|| run.folder.join(report::FILE));
        report::write(&source, &to)?;
        say(&to.display().to_string());
        Ok(())
    }
}
