//! Photogrammetry: cameras, depth maps, matching and its noise, surveys, fusion.

pub mod camera;
pub mod depth;
pub mod fusion;
pub mod matching;
pub mod survey;
