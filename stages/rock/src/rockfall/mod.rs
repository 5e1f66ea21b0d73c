//! Rockfall: candidate blocks, their removal from a mesh, ground truth, inventories and their magnitudes.

pub mod block;
pub mod goodness;
pub mod ground_truth;
pub mod inventory_foreign;
mod inventory_kml;
pub mod inventory_labels;
mod inventory_places;
pub mod power_law;
pub mod removal;

// A new stage is its file, its `mod` here and its row below.
mod classify_shapes;
mod export_inventory;
mod fit_magnitude_frequency;
mod generate_blocks;
mod import_blocks;
mod import_inventory;
mod join_inventories;
mod place_blocks;
mod rasterise_inventory;
mod remove_blocks;
mod select_features;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<classify_shapes::ClassifyShapes>::new(),
    &Row::<export_inventory::ExportInventory>::new(),
    &Row::<fit_magnitude_frequency::FitMagnitudeFrequency>::new(),
    &Row::<generate_blocks::GenerateBlocks>::new(),
    &Row::<import_blocks::ImportBlocks>::new(),
    &Row::<import_inventory::ImportInventory>::new(),
    &Row::<join_inventories::JoinInventories>::new(),
    &Row::<place_blocks::PlaceBlocks>::new(),
    &Row::<rasterise_inventory::RasteriseInventory>::new(),
    &Row::<remove_blocks::RemoveBlocks>::new(),
    &Row::<select_features::SelectFeatures>::new(),
];
