//! The folder of a run: manifest, log, and outputs under names people can read.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rockface_cache::{Digest, Outcome, Store};
use rockface_stages::Entry;
use rockface_stages::artefact::{Artefact, Export, Kind};
use serde_json::{Value, json};

use super::{RunError, Summary};
use crate::history::{FORMAT, crate_metadata};
use crate::pipeline::Overrides;
use crate::plan::Plan;
use crate::report;
use crate::watch::{LoggedStep, write_log};

/// Where a run is told of.
#[derive(Debug, Clone)]
pub struct RunFolder<'a> {
    /// The folder that holds all runs.
    pub runs: &'a Path,
    /// The pipeline file as it was given.
    pub pipeline_path: &'a Path,
    /// Its text.
    pub pipeline_text: &'a str,
    /// What was changed from outside.
    pub overrides: &'a Overrides,
    /// The target steps asked for; empty for those the pipeline names itself.
    pub targets: &'a [String],
    /// Steps at once.
    pub jobs: usize,
}

impl RunFolder<'_> {
    /// Makes the folder of runs and makes sure that it can be written to, before any work is done.
    pub fn prepare(&self) -> Result<(), RunError> {
        std::fs::create_dir_all(self.runs).map_err(failed(self.runs))?;
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
}

/// Tells of a run. One in which nothing was executed is told by its former folder, if that is still there.
pub fn finish(plan: &Plan, summary: &Summary, store: &Store, about: &RunFolder) -> Result<Finished, RunError> {
    let runs = std::path::absolute(about.runs).map_err(failed(about.runs))?;
    let key = plan_key(plan, summary, &runs, about);
    if summary.executed() == 0 && !summary.failed {
        let former = store.recalled_run(&key).and_then(|note| serde_json::from_value::<Finished>(note).ok());
        if let Some(former) = former.filter(|former| is_told_in(&former.folder, &runs, &former.files)) {
            point_latest(about.runs, &former.folder)?;
            return Ok(former);
        }
    }
    let finished = Writer { plan, summary, store, about }.write(&key)?;
    if !summary.failed {
        store.remember_run(&key, &json!(finished))?;
        store.sync()?;
    }
    Ok(finished)
}

/// Whether a run folder is one of those in `runs` and still there, with these files.
pub(super) fn is_told_in(folder: &Path, runs: &Path, files: &[PathBuf]) -> bool {
    let is_there = |file: &Path| folder.join(file).is_file();
    folder.parent() == Some(runs) && is_there(Path::new("run.json")) && files.iter().all(|file| is_there(file))
}

/// The same for two runs of the same text, overrides and targets with the same recipes, told of in the same place.
fn plan_key(plan: &Plan, summary: &Summary, runs: &Path, about: &RunFolder) -> Digest {
    let targets: Vec<&str> = plan.graph.targets.iter().map(|step| plan.graph.steps[*step].name.as_str()).collect();
    let set = (&about.overrides.set, &about.overrides.sweep, about.overrides.seed, plan.graph.seed);
    let mut text = json!([plan.graph.name, runs, targets, set, about.pipeline_text]).to_string();
    text.push('\n');
    for (instance, result) in summary.instances.iter().enumerate() {
        let key = result.key.map_or_else(|| "unknown".to_owned(), |key| key.to_string());
        text.push_str(&format!("{} {key}\n", plan.label(instance)));
    }
    Digest::of(text.as_bytes())
}

/// The files of the outputs of an instance by port, relative to the run folder.
type Paths = BTreeMap<String, PathBuf>;

struct Writer<'a> {
    plan: &'a Plan,
    summary: &'a Summary,
    store: &'a Store,
    about: &'a RunFolder<'a>,
}

impl Writer<'_> {
    fn write(&self, key: &Digest) -> Result<Finished, RunError> {
        let folder = self.make_folder(key)?;
        // A folder that tells half of a run would only mislead.
        self.fill(&folder).inspect_err(|_| drop(std::fs::remove_dir_all(&folder)))
    }

    fn fill(&self, folder: &Path) -> Result<Finished, RunError> {
        let (mut files, mut paths) = (Vec::new(), Vec::new());
        for (instance, result) in self.summary.instances.iter().enumerate() {
            let made = result.outcome.as_ref().map(|outcome| self.outputs(folder, instance, outcome)).transpose()?;
            let (named, exports) = made.unwrap_or_default();
            if self.plan.targets.contains(&instance) {
                files.extend(named.values().chain(&exports).cloned());
            }
            paths.push(named);
        }
        let results = self.summary.instances.iter();
        let logs = results.map(|result| self.entries(result.outcome.as_ref())).collect::<Result<Vec<_>, _>>()?;
        let headlines = self.headlines(&logs);
        write_file(&folder.join("run.mcap"), &self.log(&logs)?)?;
        let manifest = self.manifest(&headlines, &logs, &paths)?;
        let text = serde_json::to_string_pretty(&manifest).unwrap_or_default();
        write_file(&folder.join("run.json"), format!("{text}\n").as_bytes())?;
        self.report(folder, manifest.clone())?;
        self.describe(folder, &manifest)?;
        point_latest(self.about.runs, folder)?;
        Ok(Finished { folder: folder.to_owned(), headlines, files })
    }

    /// Describes the folder as a research object, for programs that know nothing of rockface.
    fn describe(&self, folder: &Path, manifest: &Value) -> Result<(), RunError> {
        let path = folder.join("ro-crate-metadata.json");
        let manifest = serde_json::from_value(manifest.clone()).map_err(|error| failed(&path)(error.into()))?;
        write_file(&folder.join("pipeline.yaml"), self.about.pipeline_text.as_bytes())?;
        let text = serde_json::to_string_pretty(&crate_metadata(folder, &manifest)).unwrap_or_default();
        write_file(&path, format!("{text}\n").as_bytes())
    }

    /// Writes the page of the run.
    fn report(&self, folder: &Path, manifest: Value) -> Result<(), RunError> {
        let path = folder.join(report::FILE);
        let manifest = serde_json::from_value(manifest).map_err(|error| failed(&path)(error.into()))?;
        let source = report::Source { folder, manifest: &manifest, store: Some(self.store) };
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

    /// Links the kept outputs of an instance and writes their further files; returns both, relative to the folder.
    fn outputs(&self, folder: &Path, instance: usize, outcome: &Outcome) -> Result<(Paths, Vec<PathBuf>), RunError> {
        let step = self.plan.step(instance);
        let mut place = Path::new("outputs").join(readable_name(&step.name));
        if !step.axes.is_empty() {
            place.push(readable_name(&self.plan.point_text(instance)));
        }
        let (mut named, mut exports) = (Paths::new(), Vec::new());
        for (port, output) in &outcome.outputs {
            let Ok(kind) = output.kind.parse::<Kind>() else { continue };
            if !step.keep || !output.kept {
                continue;
            }
            std::fs::create_dir_all(folder.join(&place)).map_err(failed(&folder.join(&place)))?;
            let path = place.join(format!("{port}.{}", step.extension(port, kind)));
            self.store.materialise(&output.digest, &folder.join(&path))?;
            named.insert(port.clone(), path.clone());
            if kind.has_exports() {
                let made = Artefact::decode(kind, &self.store.get(&output.digest)?)
                    .and_then(|value| value.exports(port))
                    .map_err(|error| failed(&folder.join(&path))(std::io::Error::other(error)))?;
                exports.extend(write_exports(folder, &place, &made)?);
            }
        }
        Ok((named, exports))
    }

    fn entries(&self, outcome: Option<&Outcome>) -> Result<Vec<Entry>, RunError> {
        let Some(digest) = outcome.and_then(|outcome| outcome.log) else { return Ok(Vec::new()) };
        let bytes = self.store.get(&digest)?;
        serde_json::from_slice(&bytes).map_err(|error| failed(Path::new("run.mcap"))(error.into()))
    }

    /// The results in a line each: what the target steps have to say.
    fn headlines(&self, logs: &[Vec<Entry>]) -> Vec<String> {
        let entries =
            logs.iter().enumerate().flat_map(|(instance, entries)| entries.iter().map(move |entry| (instance, entry)));
        let headline = |(instance, entry): (usize, &Entry)| match entry {
            Entry::Headline { text } => Some(format!("{}: {text}", self.plan.label(instance))),
            _ => None,
        };
        entries.filter(|(instance, _)| self.plan.targets.contains(instance)).filter_map(headline).collect()
    }

    fn log(&self, logs: &[Vec<Entry>]) -> Result<Vec<u8>, RunError> {
        let steps: Vec<LoggedStep> = self
            .summary
            .instances
            .iter()
            .zip(logs)
            .enumerate()
            .filter_map(|(instance, (result, entries))| {
                let outcome = result.outcome.as_ref()?;
                let step = self.plan.step(instance);
                let message = json!({
                    "step": step.name, "point": self.plan.point(instance), "stage": step.stage.name(),
                    "version": step.stage.version(), "key": result.key, "outputs": outcome.outputs, "entries": entries,
                });
                let recipe = result.recipe.as_ref().map(rockface_cache::Recipe::text).unwrap_or_default();
                Some(LoggedStep { step: step.name.clone(), message, recipe })
            })
            .collect();
        let about = BTreeMap::from([
            ("rockface".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("pipeline".to_owned(), self.about.pipeline_text.to_owned()),
            ("overrides".to_owned(), json!(self.about.overrides.set).to_string()),
            ("seed".to_owned(), self.plan.graph.seed.to_string()),
        ]);
        let log = write_log(Cursor::new(Vec::new()), &about, &steps);
        log.map(Cursor::into_inner).map_err(|error| failed(Path::new("run.mcap"))(std::io::Error::other(error)))
    }

    fn manifest(&self, headlines: &[String], logs: &[Vec<Entry>], paths: &[Paths]) -> Result<Value, RunError> {
        let path = self.about.pipeline_path;
        let folder = std::path::absolute(&self.plan.graph.folder).map_err(failed(path))?;
        let text = self.about.pipeline_text;
        let told = logs.iter().zip(paths).enumerate();
        let steps = told.map(|(instance, (entries, paths))| self.step(instance, entries, paths));
        Ok(json!({
            "format": FORMAT,
            "pipeline": {"name": self.plan.graph.name, "path": path, "folder": folder, "text": text},
            "overrides": {"set": self.about.overrides.set, "sweep": self.about.overrides.sweep, "seed": self.about.overrides.seed},
            "seed": self.plan.graph.seed,
            "targets": self.about.targets,
            "finished": humantime::format_rfc3339_millis(SystemTime::now()).to_string(),
            "wall_s": self.summary.wall_s,
            "jobs": self.about.jobs,
            "status": if self.summary.failed { "failed" } else { "done" },
            "program": crate::build::program(),
            "headlines": headlines,
            "steps": steps.collect::<Vec<_>>(),
        }))
    }

    /// What the manifest tells of one instance.
    fn step(&self, instance: usize, entries: &[Entry], paths: &Paths) -> Value {
        let (step, result) = (self.plan.step(instance), &self.summary.instances[instance]);
        let (params, outcome) = (&self.plan.instances[instance].params, result.outcome.as_ref());
        let metrics = entries.iter().filter_map(|entry| match entry {
            Entry::Metric { name, value, unit } => Some(json!({"name": name, "value": value, "unit": unit})),
            _ => None,
        });
        let files = params.files.values().flatten().map(|file| json!({"path": file.path, "blake3": file.digest}));
        let status = match outcome {
            _ if result.executed => "executed",
            Some(_) => "cached",
            None => "failed or not reached",
        };
        json!({
            "step": step.name, "point": self.plan.point(instance), "stage": step.stage.name(), "version": step.stage.version(),
            "status": status, "key": result.key, "outputs": outcome.map(|o| &o.outputs), "log": outcome.map(|o| o.log),
            "cost": outcome.map(|o| o.cost), "parameters": params.recipe,
            "metrics": metrics.collect::<Vec<_>>(), "files": files.collect::<Vec<_>>(),
            "inputs": result.recipe.as_ref().map_or(&BTreeMap::new(), |recipe| &recipe.inputs), "paths": paths,
        })
    }
}

/// The longest name of a folder; file systems take 255 bytes, and some of the tools that read them fewer.
const NAME_BYTES: usize = 200;

/// A name that every file system takes: a long one is cut, and told from others by a digest of the whole.
fn readable_name(name: &str) -> String {
    if name.len() <= NAME_BYTES {
        return name.to_owned();
    }
    let digest = Digest::of(name.as_bytes()).to_string();
    let cut = (0..=NAME_BYTES - 17).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    format!("{}-{}", &name[..cut], &digest[..16])
}

/// Writes further files to a place in the folder; returns their paths relative to the folder.
fn write_exports(folder: &Path, place: &Path, exports: &[Export]) -> Result<Vec<PathBuf>, RunError> {
    let write = |export: &Export| {
        let path = place.join(&export.path);
        let file = folder.join(&path);
        let parent = file.parent().unwrap_or(folder);
        std::fs::create_dir_all(parent).map_err(failed(parent))?;
        write_file(&file, &export.bytes)?;
        Ok(path)
    };
    exports.iter().map(write).collect()
}

/// Writes a whole file or none.
fn write_file(path: &Path, bytes: &[u8]) -> Result<(), RunError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let write = || {
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        std::io::Write::write_all(&mut file, bytes)?;
        // Temporary files are private; results are for whoever may read the folder.
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o644);
        file.as_file().set_permissions(mode)?;
        file.persist(path).map_err(|error| error.error)
    };
    write().map(drop).map_err(failed(path))
}

fn failed(path: &Path) -> impl FnOnce(std::io::Error) -> RunError + use<> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_are_cut_and_stay_apart() {
        let long = |last: char| format!("{}{last}", "ö".repeat(300));
        assert_eq!(readable_name("epoch=pre"), "epoch=pre");
        let (one, other) = (readable_name(&long('a')), readable_name(&long('b')));
        assert!(one.len() <= NAME_BYTES && one.starts_with("öö") && one != other, "{one}");
    }
}
