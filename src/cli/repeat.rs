//! Repeating a past run from its manifest, and saying whether it came out the same.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rockface_cache::Digest;

use super::output::complain;
use super::{CliError, PipelineArgs};
use rockface_engine::history::{Manifest, StepDone};
use rockface_engine::pipeline::{Copied, is_same_axis, is_set_by, is_swept_by, without_detours};
use rockface_engine::plan::Plan;
use rockface_engine::run::Summary;

/// The manifest at `path`, if it is that of a run and not a pipeline.
fn manifest(path: &Path) -> Result<Option<Manifest>, CliError> {
    let is_json = path.extension().is_some_and(|extension| extension == "json");
    if is_json && path.is_file() { Ok(Some(Manifest::read(path)?)) } else { Ok(None) }
}

impl PipelineArgs {
    /// Takes the pipeline that is named: one that ships with rockface, or that of a past run by its manifest, which is returned.
    pub fn take(&mut self) -> Result<Option<Manifest>, CliError> {
        self.take_shipped()?;
        let former = manifest(&self.pipeline)?;
        if let Some(former) = &former {
            let copied = former.copied_inputs(&self.pipeline);
            let copy = copied.as_ref().map(|copied| copied.to.clone());
            let moved = moved_to(former, &self.pipeline).filter(|_| copied.is_none());
            take_over(self, former, copied);
            if let Some(now) = moved {
                let before = &former.pipeline.folder;
                complain(&format!(
                    "note: {} is gone, where this run was made; it is repeated in {}",
                    before.display(),
                    now.display()
                ));
                self.pipeline = now.join(former.pipeline.path.file_name().unwrap_or_default());
                let moved =
                    |(path, text): (&PathBuf, &String)| Some((now.join(path.strip_prefix(before).ok()?), text.clone()));
                let included: Vec<(PathBuf, String)> = self.included.iter().filter_map(moved).collect();
                self.included.extend(included);
            }
            if let Some(copy) = copy {
                check_own_folder(&self.pipeline, &copy)?;
            }
        }
        Ok(former)
    }
}

/// The folder of a pipeline that was moved together with its runs: where the one it was in is gone, that around the `.rockface/runs` that
/// the manifest is in.
fn moved_to(manifest: &Manifest, path: &Path) -> Option<PathBuf> {
    if manifest.pipeline.folder.exists() {
        return None;
    }
    let path = std::path::absolute(path).ok()?;
    let runs = path.parent()?.parent()?;
    let own = runs.parent().filter(|own| runs.ends_with("runs") && own.ends_with(".rockface"))?;
    own.parent().map(Path::to_owned)
}

/// Refuses an extracted archive that has a link on the way to the folder of its pipeline, or in it: results would go where that leads.
fn check_own_folder(pipeline: &Path, copy: &Path) -> Result<(), CliError> {
    let own = super::beside(pipeline);
    let places = [own.join("runs"), own.join("store"), own];
    let is_inside = |place: &&PathBuf| {
        // What is not there yet is made where the folder around it is.
        let there = place.ancestors().find(|path| path.symlink_metadata().is_ok());
        let real = there.and_then(|path| std::fs::canonicalize(path).ok()).zip(std::fs::canonicalize(copy).ok());
        !place.is_symlink() && real.is_some_and(|(real, copy)| real.starts_with(copy))
    };
    let Some(outside) = places.iter().find(|place| !is_inside(place)) else { return Ok(()) };
    let (outside, copy) = (outside.display(), copy.display());
    let told = format!("{outside} leads out of {copy}, which came with the archive, by a link");
    Err(CliError::Usage(format!("{told}: remove it, or extract the archive anew")))
}

/// Turns arguments that name a manifest into those of its run; what is given besides comes on top. Where an extracted archive
/// has `copied` the input files, they are read there.
fn take_over(arguments: &mut PipelineArgs, manifest: &Manifest, copied: Option<Copied>) {
    let file = manifest.pipeline.path.file_name().unwrap_or_default();
    arguments.pipeline = manifest.pipeline.folder.join(file);
    arguments.text = Some(manifest.pipeline.text.clone());
    let included = manifest.pipeline.included.iter();
    arguments.included = included.map(|file| (file.path.clone(), file.text.clone())).collect();
    if let Some(copied) = copied {
        arguments.pipeline = copied.place(&arguments.pipeline);
        // The path of an include is relative to the copy, or what the pipeline says.
        let in_copy =
            arguments.included.iter().map(|(path, text)| (copied.moved(&without_detours(path)), text.clone()));
        let in_copy: Vec<(PathBuf, String)> = in_copy.collect();
        arguments.included.extend(in_copy);
        arguments.copied = Some(Arc::new(copied));
    }
    let (set, sweep) = (std::mem::take(&mut arguments.set), std::mem::take(&mut arguments.sweep));
    let is_replaced = |former: &&String| {
        sweep.iter().any(|given| is_same_axis(given, former)) || set.iter().any(|given| is_swept_by(given, former))
    };
    let former: Vec<String> = manifest.overrides.sweep.iter().filter(|former| !is_replaced(former)).cloned().collect();
    let seed = arguments.seed.map(|seed| format!("seed={seed}"));
    let is_given = |former: &&String| {
        let is_set = set.iter().chain(&seed).any(|given| is_set_by(former, given));
        is_set || sweep.iter().any(|given| is_swept_by(former, given))
    };
    let set_before = manifest.overrides.set.iter().filter(|former| !is_given(former)).cloned();
    let seed_before = manifest.overrides.seed.filter(|_| !set.iter().any(|given| is_set_by("seed=", given)));
    arguments.set = set_before.chain(set.iter().cloned()).collect();
    arguments.sweep = former.into_iter().chain(sweep.iter().cloned()).collect();
    arguments.seed = arguments.seed.or(seed_before);
    if arguments.target.is_empty() {
        arguments.target.clone_from(&manifest.targets);
    }
}

/// How a repetition came out.
#[derive(Debug, serde::Serialize)]
pub struct Repeated {
    /// How many outputs have the digest they had.
    same: usize,
    /// How many have another one, or were made in one of the two runs only.
    others: usize,
    /// What is to be said of it, and what may be why outputs differ, a line each.
    pub lines: Vec<String>,
}

impl Repeated {
    /// Whether there are outputs, those of the former run and no others, each with the digest it had.
    pub fn is_same(&self) -> bool {
        self.others == 0 && self.same > 0
    }

    /// What there is to say where outputs have to be the same.
    pub fn fault(&self) -> String {
        match self.others {
            0 => "error: no output was made, and `--require-same` holds outputs against those of the run".to_owned(),
            1 => "error: 1 output is not as the run had it (`--require-same`)".to_owned(),
            others => format!("error: {others} outputs are not as the run had them (`--require-same`)"),
        }
    }
}

/// Whether every output of a repetition has the digest it had, and what may be why not; `copied` are the input files where it read a copy.
pub fn verdict(manifest: &Manifest, copied: Option<&Copied>, plan: &Plan, summary: &Summary) -> Repeated {
    let mut former: BTreeMap<String, BTreeMap<&str, Digest>> = manifest
        .steps
        .iter()
        .map(|done| {
            let outputs = done.outputs.iter().flatten().map(|(port, output)| (port.as_str(), output.digest));
            (done.label(), outputs.collect())
        })
        .collect();
    let (mut same, mut others) = (0, Vec::new());
    for (instance, result) in summary.instances.iter().enumerate() {
        let Some(outcome) = &result.outcome else { continue };
        let label = sorted_label(plan, instance);
        for (port, output) in &outcome.outputs {
            match former.get_mut(&label).and_then(|outputs| outputs.remove(port.as_str())) {
                Some(digest) if digest == output.digest => same += 1,
                Some(digest) => others.push(format!(
                    "differs  {label}.{port}: {} then, {} now",
                    digest.short(),
                    output.digest.short()
                )),
                None => others.push(format!("new      {label}.{port}: the former run did not make it")),
            }
        }
    }
    others.extend(missing(manifest, plan, &former));
    if others.is_empty() && same == 0 {
        return Repeated { same, others: 0, lines: vec!["repeated: no output was made".to_owned()] };
    }
    if others.is_empty() {
        let (computed, stored) = (summary.executed(), summary.cached());
        let how = if computed == 0 {
            "all of them from the store; with `--store` and an empty folder they are computed again".to_owned()
        } else {
            format!("{computed} steps were computed again, {stored} are from the store")
        };
        return Repeated { same, others: 0, lines: vec![format!("repeated: all {same} outputs are the same: {how}")] };
    }
    let count = others.len();
    let mut lines = changed_files(manifest, plan, copied);
    lines.extend(changed_stages(manifest, plan));
    lines.extend(others);
    lines.extend(changed_program(manifest));
    lines.push(format!("repeated: {same} outputs are the same, {count} are not"));
    Repeated { same, others: count, lines }
}

/// The input files whose content is not what it was.
fn changed_files(manifest: &Manifest, plan: &Plan, copied: Option<&Copied>) -> Vec<String> {
    let here = |path: PathBuf| copied.map_or_else(|| path.clone(), |copied| copied.place(&path));
    let former: BTreeMap<PathBuf, Digest> =
        manifest.input_files().into_iter().map(|(path, digest)| (here(path), digest)).collect();
    let now = plan.instances.iter().flat_map(|instance| instance.params.files.values().flatten());
    let now: BTreeMap<&PathBuf, Digest> = now.map(|file| (&file.path, file.digest)).collect();
    let changed = now.into_iter().filter_map(|(path, now)| {
        let then = former.get(path).filter(|then| **then != now)?;
        Some(format!("changed  {}: {} then, {} now", path.display(), then.short(), now.short()))
    });
    changed.collect()
}

/// What is `left` of the outputs of the former run, by label, of steps that are wanted now.
fn missing(manifest: &Manifest, plan: &Plan, left: &BTreeMap<String, BTreeMap<&str, Digest>>) -> Vec<String> {
    let steps = plan.graph.steps.iter().zip(plan.graph.wanted()).filter(|(_, is_wanted)| *is_wanted);
    let wanted: BTreeSet<&str> = steps.map(|(step, _)| step.name.as_str()).collect();
    let labels = manifest.steps.iter().filter(|done| wanted.contains(&*done.step)).map(StepDone::label);
    let of_step = |label: String| -> Vec<String> {
        let ports = left[&label].keys();
        ports.map(|port| format!("missing  {label}.{port}: the former run made it")).collect()
    };
    labels.flat_map(of_step).collect()
}

/// The stages whose version is not what it was, each once.
fn changed_stages(manifest: &Manifest, plan: &Plan) -> BTreeSet<String> {
    let former: BTreeMap<(&str, &str), u32> =
        manifest.steps.iter().map(|done| ((&*done.step, &*done.stage), done.version)).collect();
    let changed = plan.graph.steps.iter().filter_map(|step| {
        let (stage, now) = (step.stage.name(), step.stage.version());
        let then = former.get(&(step.name.as_str(), stage)).filter(|then| **then != now)?;
        Some(format!("changed  stage {stage}: version {then} then, {now} now"))
    });
    changed.collect()
}

/// Which program made the run, where it is not this one, or on which processor.
fn changed_program(manifest: &Manifest) -> Option<String> {
    let (then, now) = (&manifest.program, rockface_engine::version::program());
    if then["source"] != now["source"] {
        let this = rockface_engine::version::TEXT;
        return Some(format!("the run was made by {}, this is rockface {this}", manifest.made_by()));
    }
    let facts = [
        ("compiler", "compiler"),
        ("target", "target"),
        ("dependencies", "cargo_lock_blake3"),
        ("system", "os"),
        ("kind of processor", "cpu_features"),
    ];
    let other: Vec<&str> = facts.iter().filter(|(_, key)| then[key] != now[key]).map(|(name, _)| *name).collect();
    let names = other.join(", ");
    (!other.is_empty())
        .then(|| format!("the run was made by the same version of the program, but not the same {names}"))
}

/// The label with its axes by name, as manifests have them.
fn sorted_label(plan: &Plan, instance: usize) -> String {
    let point = plan.point(instance);
    let name = &plan.step(instance).name;
    if point.is_empty() {
        return name.clone();
    }
    let items: Vec<String> = point.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
    format!("{name}[{}]", items.join(","))
}
