//! Running a recorded recipe once more, in memory, to look closer at what it made.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rockface_cache::{Digest, Recipe, RecipeInput, SeedMaterial, Store};
use rockface_core::artefact::{Artefact, Kind};
use rockface_core::{Context, Inputs, Point, Registry, StageError};
use serde_json::Value;

use super::failure::Trouble;
use super::host::StepHost;

/// The parameter of stages that can keep more of what they know.
const SWITCH: &str = "channels";

/// Runs a recipe again with `channels` on, where its stage has that switch; inputs are read from the store.
///
/// # Errors
/// The stage is another version now, reads files or starts programs, or an input was not kept.
pub fn with_channels(
    recipe: &Recipe,
    stages: &Registry,
    store: &Store,
    kind_of: &dyn Fn(&Digest) -> Option<Kind>,
) -> Result<BTreeMap<&'static str, Artefact>, StageError> {
    let stage = stages
        .find(&recipe.stage)
        .ok_or_else(|| StageError::new(format!("this program has no stage `{}`", recipe.stage)))?;
    if stage.starts_programs() {
        // The recipe may be anybody's who could write to the store; to look at a result must not run what it says.
        let error =
            StageError::new(format!("`{}` starts a program, which looking at a result never does", recipe.stage));
        return Err(error.hint("run the pipeline again, if you trust it"));
    }
    if stage.version() != recipe.version {
        let (was, is) = (recipe.version, stage.version());
        let error =
            StageError::new(format!("`{}` was version {was} when it ran and is version {is} now", recipe.stage));
        return Err(error.hint("run the pipeline again with this program"));
    }
    let mut with = (*recipe.params).clone();
    let has_switch =
        stage.fields().iter().any(|field| field.name == SWITCH && field.default == Some(Value::Bool(false)));
    if let (true, Some(map)) = (has_switch, with.as_object_mut()) {
        map.insert(SWITCH.to_owned(), Value::Bool(true));
    }
    let inputs = inputs(recipe, store, kind_of)?;
    let (files, stop, trouble) = (BTreeMap::new(), AtomicBool::new(false), Trouble::default());
    let host = StepHost::new(recipe.seed.as_ref().map(SeedMaterial::key), &files, store, &stop, None, &trouble, None);
    Ok(stage.run(&with, &inputs, &Context::new(&host))?.into_inner())
}

fn inputs(
    recipe: &Recipe,
    store: &Store,
    kind_of: &dyn Fn(&Digest) -> Option<Kind>,
) -> Result<Inputs<'static>, StageError> {
    let mut inputs = Inputs::default();
    for (port, input) in &recipe.inputs {
        let elements: Vec<(Point, Digest)> = match input {
            RecipeInput::One(digest) => vec![(Point::new(), *digest)],
            RecipeInput::Many(all) => all.iter().map(|one| (one.point.clone(), one.digest)).collect(),
        };
        for (point, digest) in elements {
            let lost = |why: String| {
                let error =
                    StageError::new(format!("its input `{port}` (blob {}) is not available: {why}", digest.short()));
                error.hint("run the pipeline again with `keep: true` on the step that makes it")
            };
            let kind = kind_of(&digest).ok_or_else(|| lost("no record says what it is".to_owned()))?;
            let bytes = store.get(&digest).map_err(|error| lost(error.to_string()))?;
            let value = Artefact::decode(kind, &bytes).map_err(|error| lost(error.to_string()))?;
            inputs.push(port, point, Arc::new(value));
        }
    }
    Ok(inputs)
}
