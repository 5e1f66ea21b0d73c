//! Programs of the user's own as steps.

// A new stage is its file, its `mod` here and its row below.
#[allow(clippy::module_inception)] // The room is named after its one stage.
mod command;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[&Row::<command::Command>::new()];
