//! Truncated signed distances of many depth maps in sparse blocks of voxels, and the surface where they vanish (Curless and
//! Levoy 1996; blocks after Niessner et al. 2013; cubes after Lorensen and Cline 1987).

pub mod blocks;
pub mod cubes;
pub mod integration;
pub mod surface;
