//! The stages of rockface: photogrammetric rockfall simulation and the statistics of its noise.
//!
//! `artefact/` holds the nouns, `kernel/` the verbs, and each stage is one file of its own: `verb_object.rs` for
//! `verb-object` in a pipeline. Nothing here touches disk, clock, thread count, YAML or hash function; what a stage
//! needs of them it is lent through [`Context`].

mod any_number;
pub mod artefact;
pub mod format;
#[cfg(test)]
mod format_tests;
mod inputs;
pub mod kernel;
mod needs;
pub mod params;
mod program;
mod stage;
#[cfg(test)]
pub(crate) mod testing;

// A new stage is its file, its `mod` here and its row below.
mod apply_mask;
mod classify_shapes;
mod clean_mesh;
mod command;
mod compare_samples;
mod describe_detectability;
mod describe_noise;
mod detect_m3c2;
mod detect_raster;
mod detect_voxels;
mod difference_dem;
mod draw_descriptors;
mod draw_detection_frequency;
mod draw_detection_rates;
mod draw_detection_volumes;
mod draw_detections;
mod draw_picture;
mod draw_rasters;
mod draw_rockfall;
mod draw_scores;
mod draw_search;
mod estimate_covariance;
mod export_cameras;
mod export_cloud;
mod export_dataset;
mod export_metashape;
mod filter_outliers;
mod fit_acceptance;
mod fit_magnitude_frequency;
mod forecast_precision;
mod fuse_colmap;
mod fuse_depth;
mod fuse_grids;
mod fuse_volume;
mod generate_blocks;
mod grid_depth;
mod import_blocks;
mod import_cameras;
mod import_cloud;
mod import_inventory;

mod import_mesh;
mod import_rasters;
mod import_table;
mod join_inventories;
mod map_noise;
mod mask_safe_zone;
mod match_image;
mod match_pair;
mod perturb_cameras;
mod place_blocks;
mod plan_survey;
mod project_depth;
mod propose_parameters;
mod rasterise_dem;
mod rasterise_inventory;
mod reconstruct_blocks;
mod refine_search;
mod register_icp;
mod remove_blocks;
mod score_detections;
mod select_features;
mod select_pairs;
mod summarise_acceptance;
mod summarise_detections;
mod synthesise_face;
mod tabulate;
mod test_acceptance;
mod transform_crs;
mod triangulate_surface;

pub use inputs::{Element, Inputs, Later};
pub use needs::{InputSize, InputSizes, SmallInput};
pub use program::{Piece, Program, ProgramResult};
pub use stage::{
    AnyStage, Arity, Checked, Context, Entry, Host, Outputs, Page, Point, Port, Ports, Row, SourceFile, Stage,
    StageError,
};

static STAGES: &[&dyn AnyStage] = &[
    &Row::<import_mesh::ImportMesh>::new(),
    &Row::<import_cloud::ImportCloud>::new(),
    &Row::<synthesise_face::SynthesiseFace>::new(),
    &Row::<transform_crs::TransformCrs>::new(),
    &Row::<mask_safe_zone::MaskSafeZone>::new(),
    &Row::<generate_blocks::GenerateBlocks>::new(),
    &Row::<import_blocks::ImportBlocks>::new(),
    &Row::<place_blocks::PlaceBlocks>::new(),
    &Row::<import_table::ImportTable>::new(),
    &Row::<remove_blocks::RemoveBlocks>::new(),
    &Row::<plan_survey::PlanSurvey>::new(),
    &Row::<import_cameras::ImportCameras>::new(),
    &Row::<export_cameras::ExportCameras>::new(),
    &Row::<estimate_covariance::EstimateCovariance>::new(),
    &Row::<perturb_cameras::PerturbCameras>::new(),
    &Row::<select_pairs::SelectPairs>::new(),
    &Row::<forecast_precision::ForecastPrecision>::new(),
    &Row::<project_depth::ProjectDepth>::new(),
    &Row::<match_pair::MatchPair>::new(),
    &Row::<match_image::MatchImage>::new(),
    &Row::<fuse_depth::FuseDepth>::new(),
    &Row::<grid_depth::GridDepth>::new(),
    &Row::<fuse_grids::FuseGrids>::new(),
    &Row::<fuse_volume::FuseVolume>::new(),
    &Row::<fuse_colmap::FuseColmap>::new(),
    &Row::<export_metashape::ExportMetashape>::new(),
    &Row::<clean_mesh::CleanMesh>::new(),
    &Row::<register_icp::RegisterIcp>::new(),
    &Row::<rasterise_dem::RasteriseDem>::new(),
    &Row::<difference_dem::DifferenceDem>::new(),
    &Row::<export_cloud::ExportCloud>::new(),
    &Row::<detect_raster::DetectRaster>::new(),
    &Row::<detect_m3c2::DetectM3c2>::new(),
    &Row::<detect_voxels::DetectVoxels>::new(),
    &Row::<score_detections::ScoreDetections>::new(),
    &Row::<summarise_detections::SummariseDetections>::new(),
    &Row::<describe_detectability::DescribeDetectability>::new(),
    &Row::<join_inventories::JoinInventories>::new(),
    &Row::<select_features::SelectFeatures>::new(),
    &Row::<reconstruct_blocks::ReconstructBlocks>::new(),
    &Row::<export_dataset::ExportDataset>::new(),
    &Row::<import_rasters::ImportRasters>::new(),
    &Row::<rasterise_inventory::RasteriseInventory>::new(),
    &Row::<filter_outliers::FilterOutliers>::new(),
    &Row::<apply_mask::ApplyMask>::new(),
    &Row::<map_noise::MapNoise>::new(),
    &Row::<describe_noise::DescribeNoise>::new(),
    &Row::<fit_acceptance::FitAcceptance>::new(),
    &Row::<test_acceptance::TestAcceptance>::new(),
    &Row::<import_inventory::ImportInventory>::new(),
    &Row::<fit_magnitude_frequency::FitMagnitudeFrequency>::new(),
    &Row::<classify_shapes::ClassifyShapes>::new(),
    &Row::<summarise_acceptance::SummariseAcceptance>::new(),
    &Row::<compare_samples::CompareSamples>::new(),
    &Row::<refine_search::RefineSearch>::new(),
    &Row::<propose_parameters::ProposeParameters>::new(),
    &Row::<tabulate::Tabulate>::new(),
    &Row::<triangulate_surface::TriangulateSurface>::new(),
    &Row::<draw_picture::DrawPicture>::new(),
    &Row::<draw_detections::DrawDetections>::new(),
    &Row::<draw_detection_volumes::DrawDetectionVolumes>::new(),
    &Row::<draw_detection_frequency::DrawDetectionFrequency>::new(),
    &Row::<draw_detection_rates::DrawDetectionRates>::new(),
    &Row::<command::Command>::new(),
    &Row::<draw_rockfall::DrawRockfall>::new(),
    &Row::<draw_descriptors::DrawDescriptors>::new(),
    &Row::<draw_scores::DrawScores>::new(),
    &Row::<draw_search::DrawSearch>::new(),
    &Row::<draw_rasters::DrawRasters>::new(),
];

/// Every stage there is, in the order of the catalogue.
pub fn all() -> &'static [&'static dyn AnyStage] {
    STAGES
}

/// The stage of a name.
pub fn find(name: &str) -> Option<&'static dyn AnyStage> {
    STAGES.iter().copied().find(|stage| stage.name() == name)
}
