//! The folder of a run: manifest, log, and outputs under names people can read.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

use rockface_cache::{Digest, RunNote, SafeName, SafePath, Store};
use rockface_core::{Entry, Look};
use serde_json::json;
use tempfile::NamedTempFile;

use super::files::{durable, failed, going_on, put, write_file};
use super::headlines;
use super::lay_out::{Laid, LayOut};
use super::log::Telling;
use super::made::{self, Made};
use super::manifest_writer;
use super::side_by_side::{both, each};
use super::unfinished::{self, Unfinished};
use crate::history::{
    CRATE_FILE, LOG_FILE, MANIFEST_FILE, Manifest, PIPELINE_FILE, POINTS_FILE, REPORT_FILE, RunContents,
    crate_metadata, is_pinned, latest_of, points_table, readable_name,
};
use crate::pipeline::{LogLevel, Overrides, Pipeline};
use crate::plan::Plan;
use crate::run::{RunError, Summary};
use crate::watch::step_log::{self, StepLogError};

/// What a run folder is written from, and where it goes.
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
    /// How many threads the steps had together.
    pub jobs: usize,
    /// Which outputs get a name in the folder.
    pub lay_out: LayOut,
    /// What draws outputs that have no sketches yet.
    pub look: &'static dyn Look,
    /// What writes the page of the run.
    pub reporter: &'a dyn Reporter,
}

impl RunFolder<'_> {
    /// Makes the folder of runs and makes sure that it can be written to, before any work is done.
    pub fn prepare(&self) -> Result<(), RunError> {
        std::fs::create_dir_all(self.runs).map_err(failed(self.runs))?;
        unfinished::sweep(self.runs);
        let of_pipeline = format!("latest-{}", readable_name(&self.pipeline.document.name));
        ["latest", &of_pipeline].iter().try_for_each(|link| check_link(&self.runs.join(link)))?;
        tempfile::tempfile_in(self.runs).map(drop).map_err(failed(self.runs))
    }
}

/// Writes the page of a run when it ends.
pub trait Reporter: Sync + std::fmt::Debug {
    /// Writes the page to a file, whole or not at all. A page that cannot be filled in is logged and left out: what was computed
    /// is worth more.
    ///
    /// # Errors
    ///
    /// Those of the disk.
    fn report(&self, run: &RunContents, to: &Path) -> std::io::Result<()>;
}

/// A run whose folder is written.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Finished {
    /// Where the run folder is, under its final name.
    pub folder: PathBuf,
    /// The results in a line each.
    pub headlines: Vec<String>,
    /// What instances warned of, those that were cached too: each with its instance.
    #[serde(default)]
    pub warnings: Vec<(usize, String)>,
    /// The files of the target steps, relative to the run folder.
    pub files: Vec<SafePath>,
    /// How many kept outputs have no file there.
    #[serde(default)]
    pub unnamed: usize,
    /// What was left in the folder, in which state.
    #[serde(default)]
    pub made: Vec<Made>,
}

/// Writes the folder of a run, and makes the results in the store durable. If nothing was executed and the former folder still exists,
/// that folder is used. A stopped run leaves no folder: its results are in the store, and the next run writes them.
///
/// # Errors
///
/// A blob that is missing or damaged, among others: the log and the sketches of a step too, unless they are among those that were `lost` before.
pub fn finish(
    plan: &Plan,
    summary: &Summary,
    store: &Store,
    about: &RunFolder,
    lost: &BTreeSet<Digest>,
    stop: &AtomicBool,
) -> Result<Finished, RunError> {
    let runs = std::path::absolute(about.runs).map_err(failed(about.runs))?;
    let key = plan_key(plan, summary, &runs, about);
    if summary.executed() == 0
        && !summary.failed
        && let Some(former) = former(store, &key, &runs)?
    {
        if store.memory().noted_folder(&former.folder).is_none() {
            // A version that knew no such notes has written it.
            note(store, summary, &former.folder, is_pinned(&former.folder))?;
        }
        store.sync()?;
        point_latest(about.runs, &former.folder)?;
        return Ok(former);
    }
    let finished = Writer { plan, summary, store, about, lost, stop }.write(&key)?;
    note(store, summary, &finished.folder, false)?;
    if !summary.failed {
        store.memory().remember_run(&key, &json!(finished))?;
    }
    store.sync()?;
    Ok(finished)
}

/// Lets the store know of a run folder, so that collections find it and what it names.
fn note(store: &Store, summary: &Summary, folder: &Path, pinned: bool) -> Result<(), RunError> {
    let finished_s = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let keys = summary.instances.iter().filter_map(|result| result.key);
    // Under a path that is not UTF-8 it is found only in its folder of runs.
    store.memory().note_folder(&RunNote::new(folder, keys, finished_s, pinned))?;
    Ok(())
}

/// A former run of the same key, if its folder is in `runs` and all that was left in it is what it was.
fn former(store: &Store, key: &Digest, runs: &Path) -> Result<Option<Finished>, RunError> {
    let former = store.memory().own_run(key).and_then(|note| serde_json::from_value::<Finished>(note).ok());
    let Some(mut former) = former.filter(|former| made::is_in(&former.folder, runs)) else { return Ok(None) };
    let before = former.made.clone();
    if !made::is_whole(&former.folder, &mut former.made) {
        return Ok(None);
    }
    if former.made != before {
        store.memory().remember_run(key, &json!(former))?;
    }
    Ok(Some(former))
}

/// The same for two runs of the same text, overrides and targets with the same recipes, reported in the same place.
fn plan_key(plan: &Plan, summary: &Summary, runs: &Path, about: &RunFolder) -> Digest {
    let targets: Vec<&str> = plan.graph.targets.iter().map(|step| plan.graph.steps[*step].name.as_str()).collect();
    let set = (&about.overrides.set, &about.overrides.sweep, about.overrides.seed, plan.graph.seed);
    let texts: Vec<&str> = about.pipeline.files().map(|file| &*file.text).collect();
    let unknown = Digest::of(b"");
    let mut text = json!([plan.graph.name, runs, targets, set, texts, about.lay_out]).to_string();
    text.push('\n');
    for (instance, result) in summary.instances.iter().enumerate() {
        let key = result.key.unwrap_or(unknown);
        let _ = writeln!(text, "{} {key}", plan.label(instance));
    }
    Digest::of(text.as_bytes())
}

/// More threads than these do not make file systems faster.
const MOST_THREADS: usize = 8;

/// What stands in a folder that lacks but its manifest.
struct Filled {
    manifest: NamedTempFile,
    headlines: Vec<String>,
    warnings: Vec<(usize, String)>,
    laid: Laid,
}

struct Writer<'a> {
    plan: &'a Plan,
    summary: &'a Summary,
    store: &'a Store,
    about: &'a RunFolder<'a>,
    /// Blobs that a step was computed again for already.
    lost: &'a BTreeSet<Digest>,
    stop: &'a AtomicBool,
}

impl Writer<'_> {
    fn write(&self, key: &Digest) -> Result<Finished, RunError> {
        let unfinished = self.make_folder(key)?;
        let folder = unfinished.folder().to_owned();
        let finished = match self.fill(&folder) {
            Ok(finished) => finished,
            Err(error) => {
                unfinished.discard();
                return Err(error);
            }
        };
        unfinished.finish()?;
        // The store remembers the folder next, so the folder must be durable first.
        unfinished::sync(&folder)?;
        unfinished::sync(self.about.runs)?;
        point_latest(self.about.runs, &folder)?;
        Ok(finished)
    }

    /// Fills the folder, while the store makes durable what the folder reports.
    fn fill(&self, folder: &Path) -> Result<Finished, RunError> {
        let (synced, filled) = both(self.about.jobs, || phase!("sync", self.store.sync()), || self.fill_in(folder))?;
        let Filled { manifest, headlines, warnings, laid } = filled?;
        synced?;
        // A folder with a manifest is whole, after a power cut too.
        phase!("sync", unfinished::sync_all(folder))?;
        put(manifest, &folder.join(MANIFEST_FILE))?;
        let mut own = vec![MANIFEST_FILE, LOG_FILE, PIPELINE_FILE, CRATE_FILE];
        own.extend(folder.join(POINTS_FILE).exists().then_some(POINTS_FILE));
        let made = made::left(folder, &own, &laid)?;
        let (files, unnamed) = (laid.of_targets(self.plan), laid.unnamed);
        Ok(Finished { folder: folder.to_owned(), headlines, warnings, files, unnamed, made })
    }

    /// Writes all files of the folder; the manifest has yet to be given its name.
    fn fill_in(&self, folder: &Path) -> Result<Filled, RunError> {
        phase!("fetch", self.bring())?;
        let lay_out =
            || self.about.lay_out.lay_out(self.plan, self.summary, self.store, folder, self.threads(), self.stop);
        let laid = phase!("lay out", lay_out())?;
        let logs = self.logs()?;
        let headlines = headlines::headlines(self.plan, &logs);
        let manifest = self.account(folder, &headlines, &logs, &laid)?;
        Ok(Filled { manifest, headlines, warnings: self.warnings(&logs), laid })
    }

    /// Fetches what the folder is made of and is in a remote place only, all at once.
    fn bring(&self) -> Result<(), RunError> {
        let levels = self.plan.log_levels();
        let of_logs = self.summary.instances.iter().enumerate().flat_map(|(instance, result)| {
            let sketches = result.outcome.as_ref().and_then(|outcome| outcome.sketches);
            [result.log(), sketches.filter(|_| levels[instance] == LogLevel::Full)]
        });
        let outputs = self.about.lay_out.blobs(self.plan, self.summary);
        Ok(self.store.bring(of_logs.flatten().chain(outputs))?)
    }

    /// Writes the log, the page, a description of the folder as a research object for programs that know nothing of rockface,
    /// and the manifest, without which a folder is no run: it is durable, and has no name yet.
    fn account(
        &self,
        folder: &Path,
        headlines: &[String],
        logs: &[Vec<Entry>],
        laid: &Laid,
    ) -> Result<NamedTempFile, RunError> {
        write_file(&folder.join(PIPELINE_FILE), self.about.pipeline.text().as_bytes())?;
        let Self { plan, summary, store, about, .. } = self;
        let told = || -> Result<NamedTempFile, RunError> {
            let describe = || manifest_writer::manifest(plan, summary, store, about, headlines, logs, laid);
            let manifest = phase!("manifest", describe())?;
            going_on(self.stop)?;
            phase!("report", self.report(folder, &manifest, logs))?;
            going_on(self.stop)?;
            if let Some(table) = points_table(&manifest) {
                write_file(&folder.join(POINTS_FILE), table.as_bytes())?;
            }
            write_file(&folder.join(CRATE_FILE), crate_metadata(folder, &manifest).as_bytes())?;
            phase!("manifest", durable(&folder.join(MANIFEST_FILE), |file| manifest.write(file)))
        };
        let (logged, manifest) = both(self.about.jobs, || phase!("log", self.log(folder, logs, laid)), told)?;
        logged.and(manifest)
    }

    /// How many threads read and write files that are many.
    fn threads(&self) -> usize {
        self.about.jobs.min(MOST_THREADS)
    }

    /// Writes the page of the run.
    fn report(&self, folder: &Path, manifest: &Manifest, logs: &[Vec<Entry>]) -> Result<(), RunError> {
        let path = folder.join(REPORT_FILE);
        let (store, graph) = (Some(self.store), Some(&self.plan.graph));
        let contents = RunContents { folder, manifest, store, graph, logs: Some(logs) };
        self.about.reporter.report(&contents, &path).map_err(failed(&path))
    }

    fn make_folder(&self, key: &Digest) -> Result<Unfinished, RunError> {
        let time = humantime::format_rfc3339_seconds(SystemTime::now()).to_string().replace(':', "");
        let name = format!("{time}-{}-{}", readable_name(&self.plan.graph.name), &key.short()[..8]);
        let runs = std::path::absolute(self.about.runs).map_err(failed(self.about.runs))?;
        std::fs::create_dir_all(&runs).map_err(failed(&runs))?;
        let name = SafeName::new(name).map_err(|error| failed(&runs)(error.into()))?;
        let mut begun = Unfinished::begin(&runs)?;
        for attempt in 0..1000 {
            let suffix = if attempt == 0 { String::new() } else { format!("-{attempt}") };
            if begun.rename(&runs.join(format!("{name}{suffix}")))? {
                return Ok(begun);
            }
        }
        begun.discard();
        Err(failed(&runs.join(name))(std::io::ErrorKind::AlreadyExists.into()))
    }

    /// The log of each instance.
    fn logs(&self) -> Result<Vec<Vec<Entry>>, RunError> {
        let read = |instance| going_on(self.stop).and_then(|()| self.entries(instance));
        each(self.threads(), self.summary.instances.len(), read)
    }

    /// The log of an instance. A lost one is recomputed with its step; one that cannot be read then is no reason to lose the run folder.
    fn entries(&self, instance: usize) -> Result<Vec<Entry>, RunError> {
        let result = &self.summary.instances[instance];
        let log = result.log();
        let is_lost_now = log.is_some_and(|log| !self.lost.contains(&log)) && result.outcome.is_some();
        match step_log::entries(log, self.store) {
            Ok(entries) => Ok(entries),
            Err(StepLogError::Store(error)) if is_lost_now => Err(error.into()),
            Err(error) => {
                let why = error.of_one_step()?;
                let text = format!("{why}; what the step reported is missing here, its results are not affected");
                Ok(vec![Entry::Warning { text }])
            }
        }
    }

    /// What instances warned of, each with its name.
    fn warnings(&self, logs: &[Vec<Entry>]) -> Vec<(usize, String)> {
        let of_instance = |(instance, entries): (usize, &Vec<Entry>)| {
            let texts = entries.iter().filter_map(|entry| match entry {
                Entry::Warning { text } => Some((instance, format!("{}: {text}", self.plan.label(instance)))),
                _ => None,
            });
            texts.collect::<Vec<_>>()
        };
        logs.iter().enumerate().flat_map(of_instance).collect()
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
        Telling {
            plan,
            summary,
            store,
            look: self.about.look,
            entries: logs,
            paths,
            about,
            pipeline_text,
            lost: self.lost,
            stop: self.stop,
        }
        .write(folder)
    }
}

/// Lets `latest` point at a run folder, and the link of its pipeline: a run whose results were all known ends with a former folder, which
/// is the last of both then.
pub(super) fn point_latest(runs: &Path, folder: &Path) -> Result<(), RunError> {
    std::fs::create_dir_all(runs).map_err(failed(runs))?;
    let target = folder.file_name().map(PathBuf::from).unwrap_or_default();
    if let Some(link) = target.to_str().and_then(latest_of) {
        point(runs, &runs.join(link), &target)?;
    }
    point(runs, &runs.join("latest"), &target)
}

/// Refuses what somebody else has put in the place of a link to a run.
fn check_link(latest: &Path) -> Result<(), RunError> {
    if std::fs::symlink_metadata(latest).is_ok_and(|meta| !meta.is_symlink()) {
        let told = "it is no link of rockface and stays as it is: give it another name, or the runs another folder";
        return Err(failed(latest)(std::io::Error::new(std::io::ErrorKind::AlreadyExists, told)));
    }
    Ok(())
}

fn point(runs: &Path, latest: &Path, target: &Path) -> Result<(), RunError> {
    if std::fs::read_link(latest).is_ok_and(|now| now == *target) {
        return Ok(());
    }
    check_link(latest)?;
    let staged = runs.join(format!("{}{}", unfinished::STAGED, std::process::id()));
    loop {
        let _ = std::fs::remove_file(&staged);
        std::os::unix::fs::symlink(target, &staged).map_err(failed(&staged))?;
        match std::fs::rename(&staged, latest) {
            // Another process took it for one that was left by the dead.
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            renamed => {
                let cleared = renamed.inspect_err(|_| drop(std::fs::remove_file(&staged)));
                return cleared.map_err(failed(latest));
            }
        }
    }
}
