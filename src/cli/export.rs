//! `rockface export` and `rockface archive`: results of past runs, to wherever they are wanted.

use std::path::{Path, PathBuf};

use clap::Args;

use super::places::Places;
use super::{CliError, say, tell};
use crate::diagnostic::nearest;
use crate::history::{self, Manifest, StepDone};

/// Arguments of `rockface export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A run folder, its name, a part of it, or `latest`.
    run: String,
    /// The output, such as `dem.raster` or `dem[epoch=pre].raster`.
    output: String,
    /// The file to write, or a folder to write it into.
    path: PathBuf,
    #[command(flatten)]
    places: Places,
}

impl ExportArgs {
    /// Writes the output.
    pub fn run(self) -> Result<(), CliError> {
        let run = history::find(&self.places.runs, &self.run)?;
        let (done, port) = chosen(&run.manifest, &self.output)?;
        let output = &done.outputs.as_ref().map(|outputs| &outputs[port]);
        let Some(output) = output else {
            return Err(CliError::Usage(format!("`{}` was not made in this run", done.label())));
        };
        let kind: Option<rockface_stages::artefact::Kind> = output.kind.parse().ok();
        let to = if self.path.is_dir() {
            let extension = kind.map_or("bin", rockface_stages::artefact::Kind::extension);
            self.path.join(format!("{}.{port}.{extension}", done.label()))
        } else {
            self.path.clone()
        };
        let store = self.places.open_store()?;
        let how = store.materialise(&output.digest, &to).map_err(|error| unkept(error, &run.folder))?;
        let how = match how {
            rockface_cache::Materialised::Reflink => "shared with the store until it is written to",
            rockface_cache::Materialised::Copy => "a copy",
            rockface_cache::Materialised::HardLink => "a read-only link into the store",
        };
        say(&format!("{} ({}, {} bytes): {how}", to.display(), output.kind, output.bytes));
        Ok(())
    }
}

fn unkept(error: rockface_cache::StoreError, folder: &Path) -> CliError {
    match error {
        rockface_cache::StoreError::Missing { digest } => {
            let again = folder.join("run.json");
            let way =
                format!("repeat the run with `rockface run {}`, and with `keep: true` on the step", again.display());
            CliError::Usage(format!("blob {} is not in the store (not kept, or collected): {way}", digest.short()))
        }
        other => other.into(),
    }
}

/// The instance and the port that `output` names.
fn chosen<'a>(manifest: &'a Manifest, output: &'a str) -> Result<(&'a StepDone, &'a str), CliError> {
    // `dem.raster[epoch=pre]`, as pipelines refer to it, or `dem[epoch=pre].raster`, as messages do.
    let known = |done: &'a StepDone| {
        let ports = done.outputs.iter().flatten().map(|(port, _)| port.as_str());
        let point = done.label()[done.step.len()..].to_owned();
        ports
            .map(move |port| (done, port, [format!("{}.{port}", done.label()), format!("{}.{port}{point}", done.step)]))
    };
    let all: Vec<_> = manifest.steps.iter().flat_map(known).collect();
    if let Some((done, port, _)) = all.iter().find(|(_, _, names)| names.iter().any(|name| name == output)) {
        return Ok((done, port));
    }
    let names: Vec<&str> = all.iter().map(|(_, _, names)| names[0].as_str()).collect();
    let hint = match nearest(output, &names) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("it has {}", names.iter().take(12).copied().collect::<Vec<_>>().join(", ")),
    };
    Err(CliError::Usage(format!("the run has no output `{output}`: {hint}")))
}

/// Arguments of `rockface archive`.
#[derive(Debug, Args)]
pub struct ArchiveArgs {
    /// A run folder, its name, a part of it, or `latest`.
    run: String,
    /// The file to write; by default the name of the run with `.tar`.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Put in what came out of the run, too.
    #[arg(long)]
    outputs: bool,
    #[command(flatten)]
    places: Places,
}

impl ArchiveArgs {
    /// Writes the archive.
    pub fn run(self) -> Result<(), CliError> {
        let run = history::find(&self.places.runs, &self.run)?;
        let to = self.output.unwrap_or_else(|| PathBuf::from(format!("{}.tar", run.name)));
        let done = history::archive(&run, &self.places.open_store()?, self.outputs, &to)?;
        if done.missing > 0 {
            tell(&format!("warning: {} records or logs of this run are not in the store any more", done.missing));
        }
        say(&format!("{}: {} files", to.display(), done.files));
        Ok(())
    }
}
