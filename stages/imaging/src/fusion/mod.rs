//! Fusion of depth maps into one surface, and its registration.

pub mod colmap_workspace;
pub mod depth_surface;
pub mod grid_fusion;
pub mod icp;
pub mod metashape_project;
mod nearest;
pub mod normals;
pub mod volume;

// A new stage is its file, its `mod` here and its row below.
mod export_metashape;
mod fuse_colmap;
mod fuse_depth;
mod fuse_grids;
mod fuse_volume;
mod register_icp;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<export_metashape::ExportMetashape>::new(),
    &Row::<fuse_colmap::FuseColmap>::new(),
    &Row::<fuse_depth::FuseDepth>::new(),
    &Row::<fuse_grids::FuseGrids>::new(),
    &Row::<fuse_volume::FuseVolume>::new(),
    &Row::<register_icp::RegisterIcp>::new(),
];
