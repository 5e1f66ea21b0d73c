//! `rockface report`: the page of a past run, made anew.

use std::path::{Path, PathBuf};

use clap::Args;

use super::places::Places;
use super::{CliError, complain, say};
use crate::report::{self, Source};
use rockface_core::Registry;
use rockface_engine::history::{REPORT_FILE, RunContents};

/// Arguments of `rockface report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// A run folder, its name or a part of it, `latest`, or a pipeline (its file or its name) for its last run; `~1` after it
    /// means the one before.
    #[arg(add = super::candidates::runs())]
    run: String,
    /// The file to write [default: `report.html` in the run folder].
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Show it in the browser.
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    places: Places,
}

impl ReportArgs {
    /// Writes the page of the run anew, and shows it in the browser where that is asked for.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        let run = self.places.find(&self.run)?;
        let store = self.places.store_beside(&run)?;
        let to = self.output.unwrap_or_else(|| run.folder.join(REPORT_FILE));
        if store.is_none() {
            // The page that the run wrote has what only the store has.
            if to == run.folder.join(REPORT_FILE) && to.is_file() {
                complain(
                    "warning: no store here has results of this run, so its page stays as it is; `--store` writes it anew",
                );
                say(&to.display().to_string());
                if self.open {
                    return Err(CliError::Usage(format!(
                        "{} was not written here, so it is not opened: its scripts would run as those of a local file; give `--output FILE` for a page of \
                         what is in the folder, or open it yourself if you trust whoever it is from",
                        to.display()
                    )));
                }
                return Ok(());
            }
            complain(
                "warning: no store here has results of this run; what is not in its folder is missing from the report",
            );
        }
        let graph = report::graph_of(registry, &run.manifest);
        let (folder, manifest) = (&run.folder, &run.manifest);
        let (store, graph, look) = (store.as_ref(), graph.as_ref(), registry.look());
        let source = Source { run: RunContents { folder, manifest, store, graph, logs: None }, look };
        super::check_own(&to, 0, report::BEGINS, "report")?;
        report::write(&source, &to)?;
        say(&to.display().to_string());
        if self.open { show(&to) } else { Ok(()) }
    }
}

/// Hands a page to the browser of the desktop.
fn show(page: &Path) -> Result<(), CliError> {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let quiet = || std::process::Stdio::null();
    let started = std::process::Command::new(program).arg(page).stdin(quiet()).stdout(quiet()).stderr(quiet()).status();
    match started {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(CliError::Usage(format!("{program} could not show {}: {status}", page.display()))),
        Err(error) => {
            let page = page.display();
            Err(CliError::Usage(format!("cannot start {program}: {error}; open {page} in a browser yourself")))
        }
    }
}
