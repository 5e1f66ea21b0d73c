//! The verbs: pure functions on meshes, cameras, depth maps, rasters and numbers. A kernel knows no stage.

pub mod camera;
pub mod camera_files;
pub mod camera_files_colmap;
pub mod camera_files_json;
pub mod covariance_files;
pub mod covariance_sampling;
pub mod depth_exr;
pub mod geotiff;
pub mod orientation;
pub mod orientation_parameters;
pub mod overlap;
pub mod ply;
pub mod precise;
pub mod random;
pub mod surface_file;
