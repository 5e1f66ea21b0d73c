//! `rockface export` and `rockface archive`: results of past runs, to wherever they are wanted.

pub mod provenance;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use rockface_cache::{Digest, SafeName, Store};
use rockface_core::artefact::{Artefact, Kind};

use super::own_file::{check_own, check_place, folder_of, write_own};
use super::places::Places;
use super::{CliError, complain, say, signals};
use rockface_engine::diagnostic::{listed, nearest};
use rockface_engine::history::{self, HistoryError, Manifest, StepDone};
use rockface_engine::pipeline::Label;

/// Arguments of `rockface export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// A run folder, its name or a part of it, `latest`, or a pipeline (its file or its name) for its last run; `~1` after it
    /// means the one before.
    #[arg(add = super::candidates::runs())]
    run: String,
    /// The output, such as `dem.raster`, `dem[epoch=pre].raster` or `dem.raster[epoch=pre]`; of a part that is used,
    /// `before.dem` or `before/dem.raster`.
    #[arg(add = super::candidates::outputs())]
    output: String,
    /// The file to write, or a folder to write it into; no device, pipe or link. A table goes into a `.csv` too, a cloud into a `.laz`, by the extension.
    path: PathBuf,
    /// Replace a file that is no earlier export.
    #[arg(long)]
    force: bool,
    /// Write the output without verifying it first. Faster for very large outputs, but damage on disk is not noticed.
    #[arg(long)]
    trust_store: bool,
    /// Write the bytes of the store as they are: no provenance in the file or beside it, no overviews in rasters.
    #[arg(long)]
    plain: bool,
    #[command(flatten)]
    places: Places,
}

impl ExportArgs {
    /// Writes the output to a file, with where it comes from in that file or beside it.
    pub fn run(self) -> Result<(), CliError> {
        let run = self.places.find(&self.run)?;
        let (done, port) = chosen(&run.manifest, &self.output)?;
        let output = &done.outputs.as_ref().map(|outputs| &outputs[port]);
        let Some(output) = output else {
            return Err(CliError::Usage(format!("`{}` was not made in this run", done.label())));
        };
        let kind: Option<Kind> = output.kind.parse().ok();
        let to = if self.path.is_dir() || self.path.to_string_lossy().ends_with('/') {
            let extension = kind.map_or("bin", Kind::extension);
            let refused = |error| CliError::Usage(format!("{error}; name the file to write"));
            let label = done.label();
            // Steps of parts have a slash in their name.
            let names = label.split('/').map(SafeName::new).collect::<Result<Vec<_>, _>>().map_err(refused)?;
            let names: Vec<&str> = names.iter().map(SafeName::as_str).collect();
            let name = SafeName::new(format!("{}.{port}.{extension}", names.join(".")));
            self.path.join(name.map_err(refused)?)
        } else {
            self.path.clone()
        };
        check_place(&to)?;
        if !self.plain {
            check_place(&provenance::beside(&to))?;
        }
        let store = self.places.store_of(&run)?;
        store.trust(self.trust_store);
        let other = kind.map(|kind| other_format(kind, &to)).transpose()?.flatten();
        let failed = |action| {
            let path = to.clone();
            move |source| CliError::History(HistoryError::Io { action, path, source })
        };
        if !self.force && !is_replaceable(&to, &store).map_err(failed("read"))? {
            let text = "is there and is no earlier export; name another file, or replace it with --force";
            return Err(CliError::Usage(format!("{} {text}", to.display())));
        }
        let facts = provenance::of(&run, done, port, &output.digest);
        if let Some((kind, extension)) = other {
            let bytes = store.get(&output.digest).map_err(|error| unkept(error, &run.folder))?;
            let bytes = converted(kind, &bytes, extension)?;
            std::fs::create_dir_all(folder_of(&to)).map_err(failed("create the folder of"))?;
            write_own(&to, &bytes).map_err(failed("write"))?;
            let told = if self.plain { "" } else { "; its origin is noted in a file beside it" };
            if !self.plain {
                let facts = format!("{facts:#}\n");
                write_own(&provenance::beside(&to), facts.as_bytes()).map_err(failed("write"))?;
            }
            say(&format!("{} ({} as {extension}){told}", to.display(), output.kind));
            return Ok(());
        }
        let how = store.materialise(&output.digest, &to).map_err(|error| unkept(error, &run.folder))?;
        let how = match how {
            rockface_cache::Materialised::Reflink => "shared with the store until it is written to",
            rockface_cache::Materialised::Copy => "a copy",
            rockface_cache::Materialised::HardLink => "a read-only link into the store",
        };
        if self.plain {
            say(&format!("{} ({}, {} bytes): {how}", to.display(), output.kind, output.bytes));
            return Ok(());
        }
        let bytes = std::fs::read(&to).map_err(failed("read"))?;
        let (at, bytes, where_to) = match provenance::written(kind, &bytes, &facts) {
            Some(bytes) => (to.clone(), bytes, "in it"),
            None => (provenance::beside(&to), format!("{facts:#}\n").into_bytes(), "in a file beside it"),
        };
        write_own(&at, &bytes).map_err(failed("write"))?;
        say(&format!("{} ({}); its origin is noted {where_to}", to.display(), output.kind));
        Ok(())
    }
}

/// What a file's name ends in, in lower case, as formats are named here.
fn ending(file: &Path) -> Option<String> {
    let ending = file.extension()?.to_string_lossy().to_lowercase();
    Some(if ending == "tiff" { "tif".to_owned() } else { ending })
}

/// The ending of a file that a kind is converted to, where it is not the one it is kept in.
fn other_format(kind: Kind, to: &Path) -> Result<Option<(Kind, &'static str)>, CliError> {
    let own = kind.extension();
    // GeoJSON is JSON.
    let is_own = |ending: &String| ending == own || (kind == Kind::Inventory && ending == "json");
    let Some(ending) = ending(to).filter(|ending| !is_own(ending)) else { return Ok(None) };
    let other = match kind {
        Kind::Table | Kind::Inventory => Some("csv"),
        Kind::Cloud => Some("laz"),
        _ => None,
    };
    if let Some(other) = other.filter(|other| *other == ending) {
        return Ok(Some((kind, other)));
    }
    let formats = other.map_or(format!(".{own}"), |other| format!(".{own} or .{other}"));
    Err(CliError::Usage(format!("{}: outputs of kind {kind} are written as {formats}, not as .{ending}", to.display())))
}

/// A value in another format than the one it is kept in.
fn converted(kind: Kind, bytes: &[u8], extension: &str) -> Result<Vec<u8>, CliError> {
    let refused = |error: rockface_core::artefact::CodecError| CliError::Usage(error.to_string());
    let exports = Artefact::decode(kind, bytes).and_then(|value| value.exports("value")).map_err(refused)?;
    let fitting =
        exports.into_iter().find(|export| Path::new(&export.path).extension().is_some_and(|e| e == extension));
    let none = || CliError::Usage(format!("this {kind} has no form as .{extension}"));
    fitting.map(|export| export.bytes).ok_or_else(none)
}

/// Whether a file may be replaced: there is none, it says that it is an export, or the store has the same.
fn is_replaceable(to: &Path, store: &Store) -> std::io::Result<bool> {
    if !to.is_file() {
        return Ok(true);
    }
    let bytes = std::fs::read(to)?;
    Ok(provenance::read(to, &bytes).is_some() || store.contains(&Digest::of(&bytes)))
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

/// The instance and the port that `output` names, its axes in any order.
pub fn chosen<'a>(manifest: &'a Manifest, output: &'a str) -> Result<(&'a StepDone, &'a str), CliError> {
    let ports = |done: &'a StepDone| done.outputs.iter().flatten().map(move |(port, _)| (done, port.as_str()));
    let all = || manifest.steps.iter().flat_map(ports);
    if let Some(label) = Label::parse(output) {
        let label = manifest.behind(&label).unwrap_or(label);
        let is_meant = |done: &StepDone| {
            done.step == label.step && done.point.len() == label.picks.len() && label.fits(&done.point)
        };
        if let Some(found) = all().find(|(done, port)| Some(*port) == label.port && is_meant(done)) {
            return Ok(found);
        }
    }
    let name = |(done, port): (&StepDone, &str)| format!("{}.{port}", done.label());
    // The name of a port may have a dot in it, which a label cannot.
    if let Some(found) = all().find(|found| name(*found) == output) {
        return Ok(found);
    }
    let parts = manifest.parts.iter().flat_map(|used| used.outputs.keys().map(|port| format!("{}.{port}", used.name)));
    let names: Vec<String> = all().map(name).chain(parts).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let behind = Label::parse(output).and_then(|label| manifest.behind(&label));
    let is_behind = |(done, port): &(&StepDone, &str)| {
        behind.as_ref().is_some_and(|behind| done.step == behind.step && Some(*port) == behind.port)
    };
    let hint = match nearest(output, &names) {
        // A use of a part has it; the steps behind it have several points, or did not run.
        Some(near) if near == output => match all().filter(is_behind).map(name).collect::<Vec<_>>() {
            points if points.is_empty() => "the steps behind it were not needed in this run".to_owned(),
            points => format!("behind it are {}", listed(points.iter().map(String::as_str))),
        },
        Some(near) => format!("did you mean `{near}`?"),
        None => match names.iter().copied().filter(|name| step_of(name) == step_of(output)).collect::<Vec<_>>() {
            own if own.is_empty() => format!("it has {}", listed(names)),
            own if own.len() == 1 => format!("did you mean `{}`?", own[0]),
            own => format!("of `{}` it has {}", step_of(output), listed(own)),
        },
    };
    Err(CliError::Usage(format!("the run has no output `{output}`: {hint}")))
}

/// The step, or the use of a part, whose output a name is.
fn step_of(name: &str) -> &str {
    name.split(['.', '[']).next().unwrap_or_default()
}

/// Arguments of `rockface archive`.
#[derive(Debug, Args)]
pub struct ArchiveArgs {
    /// A run folder, its name or a part of it, `latest`, or a pipeline (its file or its name) for its last run; `~1` after it
    /// means the one before.
    #[arg(add = super::candidates::runs())]
    run: String,
    /// The file to write [default: the name of the run with `.tar`]. It replaces no file but an earlier archive.
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Include the outputs of the run: those in its folder, and the others from the store.
    #[arg(long)]
    outputs: bool,
    /// Include the pipeline and all files it read, as they were, so that `rockface run run.json` repeats the run wherever the
    /// archive is extracted.
    #[arg(long)]
    inputs: bool,
    #[command(flatten)]
    places: Places,
}

impl ArchiveArgs {
    /// Writes the run and its records into a tar file, with its outputs where they are asked for.
    pub fn run(self) -> Result<(), CliError> {
        let run = self.places.find(&self.run)?;
        let to = self.output.unwrap_or_else(|| PathBuf::from(format!("{}.tar", run.name)));
        let (at, has) = history::ARCHIVE_MARK;
        check_own(&to, at, has, "archive of a run")?;
        let contents = history::Contents { inputs: self.inputs, outputs: self.outputs };
        let stop = Arc::new(AtomicBool::new(false));
        signals::stop_on_signal(&stop);
        let done = history::archive(&run, &self.places.store_of(&run)?, contents, &to, &stop)?;
        if done.missing > 0 {
            let missing = done.missing;
            complain(&format!("warning: {missing} records or logs of this run are not in the store any more"));
        }
        if done.strange > 0 {
            let (strange, folder) = (done.strange, run.folder.display());
            complain(&format!(
                "warning: {strange} files, folders or links in {folder} are none that a run writes, and are not in the archive"
            ));
        }
        if !done.left_out.is_empty() {
            complain(&format!("warning: {}", left_out(&done.left_out, &run.folder)));
        }
        say(&format!("{}: {} files", to.display(), done.files));
        Ok(())
    }
}

/// Outputs that are named where an archive lacks them.
const NAMED: usize = 5;

/// Which outputs an archive lacks, and why.
fn left_out(outputs: &[String], folder: &Path) -> String {
    let mut named = outputs[..outputs.len().min(NAMED)].join(", ");
    if outputs.len() > NAMED {
        named += &format!(" and {} more", outputs.len() - NAMED);
    }
    let (count, again) = (outputs.len(), folder.join("run.json"));
    format!(
        "{count} outputs of this run are not in the archive, since neither its folder nor the store has them (not kept, or collected): {named}; repeat the run with `rockface run {}`, and with `keep: true` on these steps",
        again.display()
    )
}
