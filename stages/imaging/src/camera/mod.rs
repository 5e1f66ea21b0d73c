//! Cameras: interior and exterior orientation, their files, their covariance, and the wall frame.

pub mod back_side;
pub mod camera_files;
pub mod covariance_files;
pub mod covariance_sampling;
pub mod depth_pixel;
pub mod depth_window;
mod far_cameras;
mod geocentric;
mod map_projection;
pub mod model;
pub mod orientation;
pub mod orientation_parameters;
pub mod pinhole;
pub mod ray_row;

// A new stage is its file, its `mod` here and its row below.
mod export_cameras;
mod import_cameras;
mod perturb_cameras;
mod transform_crs;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<export_cameras::ExportCameras>::new(),
    &Row::<import_cameras::ImportCameras>::new(),
    &Row::<perturb_cameras::PerturbCameras>::new(),
    &Row::<transform_crs::TransformCrs>::new(),
];
