//! The verbs: pure functions on meshes, cameras, depth maps, rasters and numbers. A kernel knows no stage.

pub mod acceptance_rate;
pub mod camera;
pub mod depth_exr;
pub mod descriptors;
pub mod fft;
pub mod gathered;
pub mod geotiff;
pub mod grid;
pub mod line;
pub mod mahalanobis;
pub mod marginal;
pub mod ply;
pub mod precise;
pub mod quantile;
pub mod random;
pub mod roughness;
pub mod spectrum;
pub mod surface_file;
pub mod variogram;
pub mod variogram_model;
