//! Programs and functions of the user's own as steps.

mod declared;

// A new stage is its file, its `mod` here and its row below.
#[allow(clippy::module_inception)] // The room is named after its first stage.
mod command;
mod python;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[&Row::<command::Command>::new(), &Row::<python::Python>::new()];
