//! The verbs: pure functions on meshes, cameras, depth maps, rasters and numbers. A kernel knows no stage.

pub mod camera;
pub mod depth_exr;
pub mod geotiff;
pub mod orientation;
pub mod ply;
pub mod precise;
pub mod random;
pub mod surface_file;
