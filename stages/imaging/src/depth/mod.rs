//! Depth maps drawn from a mesh.

pub mod depth_buffer;
pub mod depth_cells;
pub mod depth_update;
pub mod triangle_reach;
pub mod view_bounds;

// A new stage is its file, its `mod` here and its row below.
mod grid_depth;
mod project_depth;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] =
    &[&Row::<grid_depth::GridDepth>::new(), &Row::<project_depth::ProjectDepth>::new()];
