//! Runs stages of the registry without an engine.

use std::sync::Arc;

use rockface_core::artefact::Artefact;
use rockface_core::testing::TestHost;
use rockface_core::{Context, Inputs, Point};
use serde_json::Value;

/// The first output of a stage.
pub fn run(stage: &str, with: &Value, given: &[(&str, &Arc<Artefact>)]) -> Arc<Artefact> {
    let mut inputs = Inputs::default();
    for (port, artefact) in given {
        inputs.push(port, Point::new(), Arc::clone(artefact));
    }
    let found = rockface_stages::registry().find(stage).expect("the stage is there");
    let host = TestHost::default();
    let outputs = found.run(with, &inputs, &Context::new(&host)).unwrap_or_else(|error| panic!("{stage}: {error}"));
    Arc::new(outputs.into_inner().remove(found.outputs()[0].name).expect("every output is made"))
}
