//! The verbs: pure functions on meshes, cameras, depth maps, rasters and numbers. A kernel knows no stage.

pub mod camera;
pub mod camera_files;
pub mod camera_files_colmap;
pub mod camera_files_json;
pub mod covariance_files;
pub mod covariance_sampling;
pub mod depth_buffer;
pub mod depth_exr;
pub mod depth_surface;
pub mod geotiff;
pub mod grid;
pub mod marginal;
pub mod matching_noise;
pub mod orientation;
pub mod orientation_parameters;
pub mod overlap;
pub mod pair_matching;
pub mod ply;
pub mod precise;
pub mod quantile;
pub mod random;
pub mod ray_row;
pub mod rectification;
pub mod surface_cleaning;
pub mod surface_file;
pub mod triangle_reach;
