//! Rasters and what turns surfaces into them: grids, frames, windows, cleaning, tables.

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

pub mod cloud_making;
pub mod columns;
pub mod feature_rows;
pub mod frame_change;
pub mod grid;
pub mod mesh_check;
pub mod plane_fit;
pub mod point_rows;
pub mod raster_surface;
pub mod rasterise;
pub mod rasterise_points;
pub mod robust_mean;
pub mod shape;
pub mod strange_values;
pub mod surface_cleaning;
pub mod window;

// A new stage is its file, its `mod` here and its row below.
mod apply_mask;
mod crop_raster;
mod difference_dem;
mod export_cloud;
mod filter_outliers;
mod import_rasters;
mod import_table;
mod median_rasters;
mod rasterise_dem;
mod tabulate;
mod triangulate_surface;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<apply_mask::ApplyMask>::new(),
    &Row::<crop_raster::CropRaster>::new(),
    &Row::<difference_dem::DifferenceDem>::new(),
    &Row::<export_cloud::ExportCloud>::new(),
    &Row::<filter_outliers::FilterOutliers>::new(),
    &Row::<import_rasters::ImportRasters>::new(),
    &Row::<import_table::ImportTable>::new(),
    &Row::<median_rasters::MedianRasters>::new(),
    &Row::<rasterise_dem::RasteriseDem>::new(),
    &Row::<tabulate::Tabulate>::new(),
    &Row::<triangulate_surface::TriangulateSurface>::new(),
];
