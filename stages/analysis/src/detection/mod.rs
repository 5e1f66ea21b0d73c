//! Change detection, its scores, and limits of detection.
//!
//! `clusters` opens masks and joins cells, `limit` holds limits of detection on rasters, `found` turns clusters into an
//! inventory, `facing` refuses steep faces in the world frame, `cloud` and `m3c2` compare point clouds, `voxels` compares occupied space, `tested` says how much of the face could be compared, `score` compares what was found
//! with what is true, `assignment` pairs both one to one, `rates` averages over epochs, `detectability` tells what is found.

pub mod assignment;
pub mod change;
pub mod cloud;
pub mod clusters;
pub mod compared;
mod core_cells;
pub mod detectability;
pub mod facing;
pub mod found;
pub mod limit;
pub mod m3c2;
mod profile_likelihood;
pub mod raster;
pub mod rates;
pub mod score;
pub mod solid;
pub mod tested;
pub mod voxels;

// A new stage is its file, its `mod` here and its row below.
mod describe_detectability;
mod detect_m3c2;
mod detect_raster;
mod detect_voxels;
mod reconstruct_blocks;
mod score_detections;
mod summarise_detections;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<describe_detectability::DescribeDetectability>::new(),
    &Row::<detect_m3c2::DetectM3c2>::new(),
    &Row::<detect_raster::DetectRaster>::new(),
    &Row::<detect_voxels::DetectVoxels>::new(),
    &Row::<reconstruct_blocks::ReconstructBlocks>::new(),
    &Row::<score_detections::ScoreDetections>::new(),
    &Row::<summarise_detections::SummariseDetections>::new(),
];
