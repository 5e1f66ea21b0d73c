//! Faces from elsewhere and safe places on them: file formats, repair of meshes, meshes of clouds, synthetic blocks.

pub mod block_relief;
pub mod cloud;
pub mod cloud_las;
pub mod cloud_text;
pub mod distance;
pub mod half_edges;
pub mod inspection;
mod laz_check;
pub mod mesh_file;
pub mod obj;
pub mod orient;
pub mod repair;
pub mod safe_zone;
pub mod sheet;
pub mod stl;
