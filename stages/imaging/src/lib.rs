//! Photogrammetry: cameras, depth maps, matching and its noise, surveys, fusion.

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

pub mod camera;
pub mod depth;
pub mod fusion;
pub mod matching;
pub mod survey;
