//! The graph of a run, each step with what became of it.

use std::collections::BTreeMap;

use crate::drawing::{Drawing, Note, Tint};
use crate::history::{Manifest, StepDone};
use crate::pipeline::{Overrides, Pipeline};
use crate::plan::resolve;
use crate::watch::duration;

/// The picture, where it can be drawn: not where the pipeline is one that this program does not read any more.
pub fn svg(manifest: &Manifest) -> Option<String> {
    let told = &manifest.pipeline;
    let overrides = Overrides {
        set: manifest.overrides.set.clone(),
        sweep: manifest.overrides.sweep.clone(),
        seed: manifest.overrides.seed,
    };
    let included = told.included.iter().map(|file| (file.path.clone(), file.text.clone())).collect();
    let path = told.folder.join(told.path.file_name().unwrap_or_default());
    let pipeline = Pipeline::of_text(&told.text, included, &path, &overrides).ok()?;
    let graph = resolve(&pipeline, &manifest.targets, rockface_stages::all()).ok()?;
    let mut steps: BTreeMap<&str, Vec<&StepDone>> = BTreeMap::new();
    manifest.steps.iter().for_each(|done| steps.entry(&done.step).or_default().push(done));
    let drawing = Drawing::of(&graph).ok()?;
    let noted = |drawing: Drawing, (step, done): (&str, Vec<&StepDone>)| {
        drawing.count(step, done.len()).note(step, note(&done))
    };
    Some(steps.into_iter().fold(drawing, noted).svg())
}

/// How many of the instances of a step ran and how long they took together, in the colour of what became of them.
fn note(done: &[&StepDone]) -> Note {
    let with = |status: &'static str| done.iter().filter(move |done| done.status == status);
    let (ran, cached) = (with("executed").count(), with("cached").count());
    let wall_s: f64 = with("executed").filter_map(|done| done.cost.map(|cost| cost.wall_s)).sum();
    let failed = done.len() - ran - cached;
    let took = format!("ran {ran}, {}", duration(wall_s));
    let (tint, text) = match (failed, ran) {
        (0, 0) => (Tint::Cached, "cached".to_owned()),
        (0, 1) if cached == 0 => (Tint::Ran, format!("ran, {}", duration(wall_s))),
        (0, _) if cached == 0 => (Tint::Ran, took),
        (0, _) => (Tint::Ran, format!("{took}; cached {cached}")),
        (failed, _) => (Tint::Failed, format!("{failed} not made")),
    };
    Note { text, tint }
}
