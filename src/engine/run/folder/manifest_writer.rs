//! Writes the manifest of a run: facts about the whole and about each instance.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rockface_cache::{Digest, RecipeInput, Seen, Store};
use rockface_core::Entry;
use serde_json::{Map, Value};

use super::files::failed;
use super::lay_out::{Laid, Paths};
use crate::diagnostic::{Origin, Source};
use crate::history::{
    FORMAT, FileUsed, IncludedText, ItemValues, Manifest, Metric, Overridden, PartUsed, PipelineText, StepDone,
};
use crate::pipeline::{Axis, Used};
use crate::plan::Plan;
use crate::run::{RunError, RunFolder, Summary};

/// The manifest of a run.
pub fn manifest(
    plan: &Plan,
    summary: &Summary,
    store: &Store,
    about: &RunFolder,
    headlines: &[String],
    logs: &[Vec<Entry>],
    laid: &Laid,
) -> Result<Manifest, RunError> {
    let overrides = about.overrides;
    let told = logs.iter().zip(&laid.paths).enumerate();
    let steps = told.map(|(instance, (entries, paths))| step(plan, summary, store, instance, entries, paths));
    Ok(Manifest {
        format: FORMAT,
        pipeline: pipeline_text(plan, about)?,
        overrides: Overridden { sweep: overrides.sweep.clone(), set: overrides.set.clone(), seed: overrides.seed },
        seed: plan.graph.seed,
        targets: about.targets.to_vec(),
        finished: humantime::format_rfc3339_millis(SystemTime::now()).to_string(),
        wall_s: summary.wall_s,
        jobs: about.jobs,
        status: if summary.failed { "failed" } else { "done" }.to_owned(),
        program: crate::version::program(),
        headlines: headlines.to_vec(),
        laid_out: if laid.unnamed == 0 { "all" } else { "some" }.to_owned(),
        parts: plan.graph.uses.iter().map(part_used).collect(),
        store: store_elsewhere(store, about)?,
        values: item_values(&plan.graph.axes),
        steps: steps.collect(),
    })
}

/// The store, unless it is where commands look for it by themselves.
fn store_elsewhere(store: &Store, about: &RunFolder) -> Result<Option<PathBuf>, RunError> {
    let absolute = |path: &Path| std::path::absolute(path).map_err(failed(path));
    let real = |path: &Path| std::fs::canonicalize(path).map_or_else(|_| absolute(path), Ok);
    let (own, runs) = (real(store.dir())?, real(about.runs)?);
    let is_beside = runs.parent().is_some_and(|folder| folder.join("store") == own);
    Ok((!is_beside).then_some(own))
}

/// What items stand for, where that is several values. Axes of parts that share a label and differ have none: points name labels.
fn item_values(axes: &[Axis]) -> ItemValues {
    let mut all: BTreeMap<&str, Option<Named>> = BTreeMap::new();
    for axis in axes {
        let named = named_values(axis);
        all.entry(&axis.label)
            .and_modify(|known| *known = known.take().filter(|known| *known == named))
            .or_insert(Some(named));
    }
    let alike = all.into_iter().filter_map(|(label, named)| Some((label.to_owned(), named?)));
    alike.filter(|(_, named)| !named.is_empty()).collect()
}

/// The values of items by their names.
type Named = BTreeMap<String, Map<String, Value>>;

fn named_values(axis: &Axis) -> Named {
    let named = axis.items.iter().zip(&*axis.values).filter_map(|(item, value)| {
        // The column `item` of a table names the item itself.
        let is_told = |(name, value): &(&String, &Value)| *name != "item" && !value.is_object() && !value.is_array();
        let values = value.as_object()?.iter().filter(is_told);
        let values: Map<String, Value> = values.map(|(name, value)| (name.clone(), value.clone())).collect();
        (!values.is_empty()).then(|| (item.clone(), values))
    });
    named.collect()
}

fn part_used(used: &Used) -> PartUsed {
    let outputs = used.outputs.keys().filter_map(|output| Some((output.clone(), used.behind(output)?)));
    let (name, part) = (used.name.clone(), used.part.clone());
    PartUsed { name, part, blake3: used.digest, outputs: outputs.collect() }
}

fn pipeline_text(plan: &Plan, about: &RunFolder) -> Result<PipelineText, RunError> {
    let absolute = |path: &Path| std::path::absolute(path).map_err(failed(path));
    let path = |file: &Source| match file.origin {
        // What comes with the program has a name and no place.
        Origin::Shipped => Ok(PathBuf::from(&file.name)),
        _ => absolute(Path::new(&file.name)),
    };
    let others = about.pipeline.files().skip(1);
    let included = others.map(|file| Ok(IncludedText { path: path(file)?, text: file.text.to_string() }));
    Ok(PipelineText {
        name: plan.graph.name.clone(),
        path: about.pipeline_path.to_owned(),
        folder: absolute(&plan.graph.folder)?,
        text: about.pipeline.text().to_owned(),
        copied: about.pipeline.copied.as_deref().cloned(),
        asked: asked(about),
        included: included.collect::<Result<_, RunError>>()?,
    })
}

/// The files that planning has read but for those of the pipeline.
fn asked(about: &RunFolder) -> Vec<FileUsed> {
    let texts: Vec<&str> = about.pipeline.files().map(|file| file.name.as_str()).collect();
    let read = about.pipeline.looks.iter().filter_map(|(path, seen)| match seen {
        Seen::File(digest) if !texts.iter().any(|text| Path::new(text) == path) => Some((path.clone(), *digest)),
        _ => None,
    });
    let read: BTreeMap<PathBuf, Digest> = read.collect();
    read.into_iter().map(|(path, blake3)| FileUsed { path, blake3 }).collect()
}

/// The entry of one instance, with its log and the files of its outputs.
fn step(plan: &Plan, summary: &Summary, store: &Store, instance: usize, entries: &[Entry], paths: &Paths) -> StepDone {
    let (step, result) = (plan.step(instance), &summary.instances[instance]);
    let (params, outcome) = (&plan.instances[instance].params, result.outcome.as_ref());
    let metrics = entries.iter().filter_map(|entry| match entry {
        Entry::Metric { name, value, unit } => {
            Some(Metric { name: name.clone(), value: Some(*value).filter(|x| x.is_finite()), unit: unit.clone() })
        }
        _ => None,
    });
    let warnings = entries.iter().filter_map(|entry| match entry {
        Entry::Warning { text } => Some(text.clone()),
        _ => None,
    });
    let files = params.files.values().flatten();
    let status = match outcome {
        _ if result.executed => "executed",
        Some(_) => "cached",
        None if result.failure.is_some() => "failed",
        None => "not reached",
    };
    StepDone {
        step: step.name.clone(),
        point: plan.point(instance),
        stage: step.stage.name().into(),
        version: step.stage.version(),
        status: status.into(),
        key: result.key,
        outputs: outcome.map(|outcome| outcome.outputs.clone()),
        failure: result.failure.as_ref().map(|failure| failure.message.clone()),
        log: result.log(),
        sketches: outcome.and_then(|outcome| outcome.sketches),
        cost: outcome.map(|outcome| outcome.cost),
        parameters: params.recipe.clone(),
        metrics: metrics.collect(),
        warnings: warnings.collect(),
        files: files.map(|file| FileUsed { path: file.path.clone(), blake3: file.digest }).collect(),
        inputs: inputs(plan, summary, store, instance),
        paths: paths.clone(),
    }
}

/// What each input port of an instance read: the inputs of the plan, unless a recomputed step gave a different output since.
fn inputs(plan: &Plan, summary: &Summary, store: &Store, instance: usize) -> BTreeMap<String, RecipeInput> {
    let result = &summary.instances[instance];
    let digest = |producer: usize, port: &str| {
        let outcome = summary.instances[producer].outcome.as_ref();
        outcome.map_or_else(|| Digest::of(b""), |outcome| outcome.outputs[port].digest)
    };
    if result.key.is_some() && !summary.revised {
        return plan.inputs(instance, digest);
    }
    result.recipe(store).map(|recipe| recipe.inputs).unwrap_or_default()
}
