//! The folder of a run: manifest, log, and outputs under names people can read.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

use rockface_cache::{Digest, Store};
use rockface_stages::Entry;
use serde_json::json;

use super::lay_out::{Laid, LayOut, readable_name};
use super::log::{LOG_FILE, Telling};
use super::unfinished::{self, Unfinished};
use super::{RunError, Summary, account};
use crate::history::{Manifest, crate_metadata};
use crate::pipeline::{Overrides, Pipeline};
use crate::plan::Plan;
use crate::report;
use crate::watch::step_log;

/// Where a run is told of.
#[derive(Debug, Clone)]
pub struct RunFolder<'a> {
    /// The folder that holds all runs.
    pub runs: &'a Path,
    /// The pipeline file as it was given.
    pub pipeline_path: &'a Path,
    /// The pipeline: its text and those it includes.
    pub pipeline: &'a Pipeline,
    /// What was changed from outside.
    pub overrides: &'a Overrides,
    /// The target steps asked for; empty for those the pipeline names itself.
    pub targets: &'a [String],
    /// Steps at once.
    pub jobs: usize,
    /// Which outputs get a name in the folder.
    pub lay_out: LayOut,
}

impl RunFolder<'_> {
    /// Makes the folder of runs and makes sure that it can be written to, before any work is done.
    pub fn prepare(&self) -> Result<(), RunError> {
        std::fs::create_dir_all(self.runs).map_err(failed(self.runs))?;
        unfinished::sweep(self.runs);
        tempfile::tempfile_in(self.runs).map(drop).map_err(failed(self.runs))
    }
}

/// A run that was told of.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Finished {
    /// The run folder.
    pub folder: PathBuf,
    /// The results in a line each.
    pub headlines: Vec<String>,
    /// The files of the target steps, relative to the run folder.
    pub files: Vec<PathBuf>,
    /// How many kept outputs have no file there.
    #[serde(default)]
    pub unnamed: usize,
}

/// Tells of a run. One in which nothing was executed is told by its former folder, if that is still there. A stop leaves no
/// folder: whatever was computed is in the store, and the next run tells of it.
pub fn finish(
    plan: &Plan,
    summary: &Summary,
    store: &Store,
    about: &RunFolder,
    stop: &AtomicBool,
) -> Result<Finished, RunError> {
    let runs = std::path::absolute(about.runs).map_err(failed(about.runs))?;
    let key = plan_key(plan, summary, &runs, about);
    if summary.executed() == 0 && !summary.failed {
        let former = store.recalled_run(&key).and_then(|note| serde_json::from_value::<Finished>(note).ok());
        if let Some(former) = former.filter(|former| is_told_in(&former.folder, &runs, &former.files)) {
            point_latest(about.runs, &former.folder)?;
            return Ok(former);
        }
    }
    let finished = Writer { plan, summary, store, about, stop }.write(&key)?;
    if !summary.failed {
        store.remember_run(&key, &json!(finished))?;
        store.sync()?;
    }
    Ok(finished)
}

/// Whether a run folder is one of those in `runs` and still as it was told: with these files, none of which was written to
/// since the manifest, which is written last.
pub(super) fn is_told_in(folder: &Path, runs: &Path, files: &[PathBuf]) -> bool {
    let written = |file: &Path| {
        let meta = std::fs::metadata(folder.join(file)).ok().filter(std::fs::Metadata::is_file)?;
        meta.modified().ok().map(|at| (at, meta.len()))
    };
    let Some((told, 1..)) = written(Path::new("run.json")) else { return false };
    let is_untouched = |file: &Path| written(file).is_some_and(|(at, _)| at <= told);
    // A page may be written again later.
    let is_whole = written(Path::new(report::FILE)).is_some() && is_untouched(Path::new(LOG_FILE));
    folder.parent() == Some(runs) && is_whole && files.iter().all(|file| is_untouched(file))
}

/// The same for two runs of the same text, overrides and targets with the same recipes, told of in the same place.
fn plan_key(plan: &Plan, summary: &Summary, runs: &Path, about: &RunFolder) -> Digest {
    let targets: Vec<&str> = plan.graph.targets.iter().map(|step| plan.graph.steps[*step].name.as_str()).collect();
    let set = (&about.overrides.set, &about.overrides.sweep, about.overrides.seed, plan.graph.seed);
    let texts: Vec<&str> = about.pipeline.files().map(|file| file.text.as_str()).collect();
    let unknown = Digest::of(b"");
    let mut text = json!([plan.graph.name, runs, targets, set, texts, about.lay_out]).to_string();
    text.push('\n');
    for (instance, result) in summary.instances.iter().enumerate() {
        let key = result.key.unwrap_or(unknown);
        let _ = writeln!(text, "{} {key}", plan.label(instance));
    }
    Digest::of(text.as_bytes())
}

struct Writer<'a> {
    plan: &'a Plan,
    summary: &'a Summary,
    store: &'a Store,
    about: &'a RunFolder<'a>,
    stop: &'a AtomicBool,
}

impl Writer<'_> {
    fn write(&self, key: &Digest) -> Result<Finished, RunError> {
        let folder = self.make_folder(key)?;
        // A folder that tells half of a run would only mislead.
        let mark = Unfinished::mark(&folder);
        let filled = mark.and_then(|mark| self.fill(&folder).and_then(|finished| mark.finish().map(|()| finished)));
        let finished = filled.inspect_err(|_| drop(std::fs::remove_dir_all(&folder)))?;
        point_latest(self.about.runs, &folder)?;
        Ok(finished)
    }

    fn fill(&self, folder: &Path) -> Result<Finished, RunError> {
        let laid = self.about.lay_out.lay_out(self.plan, self.summary, self.store, folder, self.stop)?;
        let logs = self.logs()?;
        let headlines = self.headlines(&logs);
        self.account(folder, &headlines, &logs, &laid)?;
        Ok(Finished { folder: folder.to_owned(), headlines, files: laid.of_targets, unnamed: laid.unnamed })
    }

    /// Writes the log, the page, a description of the folder as a research object for programs that know nothing of rockface,
    /// and last of all the manifest, without which a folder is no run.
    fn account(&self, folder: &Path, headlines: &[String], logs: &[Vec<Entry>], laid: &Laid) -> Result<(), RunError> {
        write_file(&folder.join("pipeline.yaml"), self.about.pipeline.text().as_bytes())?;
        let Self { plan, summary, store, about, .. } = self;
        let told = || -> Result<String, RunError> {
            let manifest = account::manifest(plan, summary, store, about, headlines, logs, laid)?;
            going_on(self.stop)?;
            self.report(folder, &manifest, logs)?;
            going_on(self.stop)?;
            let described = serde_json::to_string_pretty(&crate_metadata(folder, &manifest)).unwrap_or_default();
            write_file(&folder.join("ro-crate-metadata.json"), format!("{described}\n").as_bytes())?;
            Ok(manifest.text())
        };
        let (logged, manifest) = self.beside(|| self.log(folder, logs, laid), told)?;
        logged?;
        write_file(&folder.join("run.json"), manifest?.as_bytes())
    }

    /// Does two things at once, the second in this thread; one after the other if there is to be one job.
    fn beside<A: Send, B>(
        &self,
        other: impl FnOnce() -> A + Send,
        own: impl FnOnce() -> B,
    ) -> Result<(A, B), RunError> {
        if self.about.jobs < 2 {
            return Ok((other(), own()));
        }
        std::thread::scope(|scope| {
            let other = std::thread::Builder::new().spawn_scoped(scope, other);
            let other = other.map_err(|error| RunError::Threads(error.to_string()))?;
            let own = own();
            Ok((other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)), own))
        })
    }

    /// Writes the page of the run.
    fn report(&self, folder: &Path, manifest: &Manifest, logs: &[Vec<Entry>]) -> Result<(), RunError> {
        let path = folder.join(report::FILE);
        let (store, graph) = (Some(self.store), Some(&self.plan.graph));
        let source = report::Source { folder, manifest, store, graph, logs: Some(logs) };
        match report::write(&source, &path) {
            // What was computed is worth more than its page.
            Err(report::ReportError::Template(error)) => tracing::warn!("the run has no report: {error:#}"),
            Err(report::ReportError::Io { source, .. }) => return Err(failed(&path)(source)),
            Ok(()) => {}
        }
        Ok(())
    }

    fn make_folder(&self, key: &Digest) -> Result<PathBuf, RunError> {
        let time = humantime::format_rfc3339_seconds(SystemTime::now()).to_string().replace(':', "");
        let name = format!("{time}-{}-{}", readable_name(&self.plan.graph.name), &key.short()[..8]);
        for attempt in 0..1000 {
            let suffix = if attempt == 0 { String::new() } else { format!("-{attempt}") };
            let folder = self.about.runs.join(format!("{name}{suffix}"));
            std::fs::create_dir_all(self.about.runs).map_err(failed(self.about.runs))?;
            match std::fs::create_dir(&folder) {
                Ok(()) => return std::path::absolute(&folder).map_err(failed(&folder)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(failed(&folder)(error)),
            }
        }
        Err(failed(&self.about.runs.join(name))(std::io::ErrorKind::AlreadyExists.into()))
    }

    /// What each instance said.
    fn logs(&self) -> Result<Vec<Vec<Entry>>, RunError> {
        let read = |part: &[usize]| -> Result<Vec<_>, RunError> {
            part.iter().map(|instance| going_on(self.stop).and_then(|()| self.entries(*instance))).collect()
        };
        let instances: Vec<usize> = (0..self.summary.instances.len()).collect();
        let (former, latter) = instances.split_at(instances.len() / 2);
        let (latter, former) = self.beside(|| read(latter), || read(former))?;
        let mut logs = former?;
        logs.extend(latter?);
        Ok(logs)
    }

    /// The log of an instance; one that cannot be read is no reason to lose the run folder.
    fn entries(&self, instance: usize) -> Result<Vec<Entry>, RunError> {
        match step_log::entries(self.summary.instances[instance].log(), self.store) {
            Ok(entries) => Ok(entries),
            Err(error) => {
                let why = error.of_one_step()?;
                let text = format!("{why}; what the step reported is missing here, its results are not affected");
                tracing::warn!("step {}: {text}", self.plan.label(instance));
                Ok(vec![Entry::Warning { text }])
            }
        }
    }

    /// The results in a line each: what the target steps have to say.
    fn headlines(&self, logs: &[Vec<Entry>]) -> Vec<String> {
        let entries =
            logs.iter().enumerate().flat_map(|(instance, entries)| entries.iter().map(move |entry| (instance, entry)));
        let headline = |(instance, entry): (usize, &Entry)| match entry {
            Entry::Headline { text } => Some(format!("{}: {text}", self.plan.label(instance))),
            _ => None,
        };
        entries.filter(|(instance, _)| self.plan.targets.binary_search(instance).is_ok()).filter_map(headline).collect()
    }

    fn log(&self, folder: &Path, logs: &[Vec<Entry>], laid: &Laid) -> Result<(), RunError> {
        let about = BTreeMap::from([
            ("rockface".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("pipeline".to_owned(), self.about.pipeline.text().to_owned()),
            ("overrides".to_owned(), json!(self.about.overrides.set).to_string()),
            ("seed".to_owned(), self.plan.graph.seed.to_string()),
        ]);
        let Self { plan, summary, store, .. } = self;
        let pipeline_text = self.about.pipeline.text();
        let paths = &laid.paths;
        Telling { plan, summary, store, entries: logs, paths, about, pipeline_text, stop: self.stop }.write(folder)
    }
}

/// Whether nobody has asked for a stop.
pub(super) fn going_on(stop: &AtomicBool) -> Result<(), RunError> {
    if stop.load(Ordering::Relaxed) { Err(RunError::Interrupted) } else { Ok(()) }
}

/// Writes a whole file or none.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let write = || {
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        std::io::Write::write_all(&mut file, bytes).map(|()| file)
    };
    put(write().map_err(failed(path))?, path)
}

/// Gives a finished file its name.
pub(super) fn put(file: tempfile::NamedTempFile, path: &Path) -> Result<(), RunError> {
    // Temporary files are private; results are for whoever may read the folder.
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    let open = file.as_file().set_permissions(mode);
    open.and_then(|()| file.persist(path).map(drop).map_err(|error| error.error)).map_err(failed(path))
}

pub(super) fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> RunError + use<> {
    let path = path.to_owned();
    move |source| RunError::Folder { path, source }
}

/// Lets `latest` point at a run folder.
pub(super) fn point_latest(runs: &Path, folder: &Path) -> Result<(), RunError> {
    std::fs::create_dir_all(runs).map_err(failed(runs))?;
    let latest = runs.join("latest");
    let target = folder.file_name().map(PathBuf::from).unwrap_or_default();
    if std::fs::read_link(&latest).is_ok_and(|now| now == target) {
        return Ok(());
    }
    let staged = runs.join(format!(".latest-{}", std::process::id()));
    let _ = std::fs::remove_file(&staged);
    std::os::unix::fs::symlink(&target, &staged).map_err(failed(&staged))?;
    std::fs::rename(&staged, &latest).map_err(failed(&latest))
}
