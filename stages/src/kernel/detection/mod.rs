//! Change detection: what a detector found, the clusters it is made of, and its limits of detection.
//!
//! `clusters` opens masks and joins cells, `limit` holds limits of detection on rasters, `found` turns clusters into an
//! inventory, `cloud` and `m3c2` compare point clouds, `voxels` compares occupied space, `score` compares what was found
//! with what is true, `assignment` pairs both one to one, `rates` averages over epochs, `detectability` tells what is found.

pub mod assignment;
pub mod change;
pub mod cloud;
pub mod clusters;
pub mod compared;
pub mod detectability;
pub mod found;
pub mod limit;
pub mod m3c2;
pub mod raster;
pub mod rates;
pub mod score;
pub mod solid;
pub mod voxels;
