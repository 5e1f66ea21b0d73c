//! The verbs: pure functions on meshes, cameras, depth maps, rasters and numbers. A kernel knows no stage.

pub mod camera;
pub mod canvas;
pub mod colour_scale;
pub mod depth_exr;
pub mod geotiff;
pub mod icp;
pub mod mesh_check;
mod nearest;
pub mod orientation;
pub mod picture;
pub mod plane_fit;
pub mod ply;
mod ply_header;
pub mod precise;
pub mod random;
pub mod rasterise;
pub mod relief;
pub mod shape;
pub mod surface_file;
