//! The graph of a run, each step with what became of it.

use crate::drawing::{Drawing, Note, Tint};
use rockface_core::Registry;
use rockface_engine::history::Manifest;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::{Graph, resolve};

use super::steps::StepView;

/// A graph of more steps is not drawn: nobody could read it.
const STEPS: usize = 150;

/// The graph of a past run, from the texts its manifest holds; `None` where this version does not read them.
pub fn of(registry: &Registry, manifest: &Manifest) -> Option<Graph> {
    let (told, changed) = (&manifest.pipeline, &manifest.overrides);
    let path = told.folder.join(told.path.file_name()?);
    let (set, sweep) = (changed.set.clone(), changed.sweep.clone());
    let overrides = Overrides { set, sweep, seed: changed.seed, parts: registry.parts() };
    let included = told.included.iter().map(|file| (file.path.clone(), file.text.clone())).collect();
    let pipeline = Pipeline::of_text(&told.text, included, &path, &overrides).ok()?;
    resolve(&pipeline, &manifest.targets, registry.stages()).ok()
}

/// The names of the target steps.
pub fn targets(graph: &Graph) -> Vec<String> {
    graph.targets.iter().map(|step| graph.steps[*step].name.clone()).collect()
}

/// The picture, each step with its time and whether it ran, was cached or did not finish.
pub fn svg(graph: &Graph, steps: &[StepView]) -> Option<String> {
    if graph.steps.len() > STEPS {
        return None;
    }
    let drawing = Drawing::of(graph).ok()?;
    let noted = |drawing: Drawing, step: &StepView| {
        // The items of some axes were not known before the run.
        let instances = step.executed + step.cached + step.missing;
        drawing.count(&step.name, instances).note(&step.name, note(step))
    };
    Some(steps.iter().fold(drawing, noted).svg())
}

fn note(step: &StepView) -> Note {
    let tint = match step {
        step if step.missing > 0 => Tint::Failed,
        step if step.executed > 0 => Tint::Ran,
        _ => Tint::Cached,
    };
    let what = match step {
        step if step.missing > 0 => format!("{} not finished", step.missing),
        step if step.executed == 0 => "cached".to_owned(),
        step if step.cached > 0 => format!("ran {}, cached {}", step.executed, step.cached),
        _ => "ran".to_owned(),
    };
    Note { text: format!("{what}, {}", step.wall), tint }
}
