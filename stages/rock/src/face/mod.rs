//! The face: import, repair and synthesis of meshes and clouds, and the places on them where blocks may be removed.

pub mod block_relief;
pub mod cloud;
pub mod cloud_text;
pub mod column_marks;
pub mod column_names;
pub mod distance;
pub mod file_frame;
pub mod half_edges;
pub mod inspection;
pub mod mesh_cleaning;
pub mod mesh_file;
pub mod obj;
pub mod orient;
pub mod placing;
pub mod point_classes;
pub mod relief;
pub mod repair;
pub mod rounding;
pub mod safe_zone;
pub mod separators;
pub mod sheet;
pub mod stl;
pub mod stray;
pub mod tetrahedra;

// A new stage is its file, its `mod` here and its row below.
mod clean_mesh;
mod import_cloud;
mod import_mesh;
mod mask_safe_zone;
mod synthesise_face;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<clean_mesh::CleanMesh>::new(),
    &Row::<import_cloud::ImportCloud>::new(),
    &Row::<import_mesh::ImportMesh>::new(),
    &Row::<mask_safe_zone::MaskSafeZone>::new(),
    &Row::<synthesise_face::SynthesiseFace>::new(),
];
