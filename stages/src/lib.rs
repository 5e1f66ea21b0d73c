//! The registry of the stages of rockface, room by room.

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

mod parts;

use std::sync::LazyLock;

use rockface_core::{Registry, Room};

static SHIPPED: LazyLock<Registry> = LazyLock::new(shipped);

/// Every stage that ships with rockface, and what draws their outputs. A program of your own clones it and adds a [`Room`].
pub fn registry() -> &'static Registry {
    &SHIPPED
}

fn shipped() -> Registry {
    let room = |name, doc, stages| Room { name, doc, stages };
    Registry::default()
        .with(room("face", "Meshes and clouds of a rock face: import, repair, synthesis.", rockface_rock::face::STAGES))
        .with(room("rockfall", "Blocks, their removal, ground truth and inventories.", rockface_rock::rockfall::STAGES))
        .with(room("camera", "Cameras, their orientation and the wall frame.", rockface_imaging::camera::STAGES))
        .with(room("survey", "Viewpoints, pairs, and the covariance of a survey.", rockface_imaging::survey::STAGES))
        .with(room("depth", "Depth maps drawn from a mesh.", rockface_imaging::depth::STAGES))
        .with(room("matching", "Dense matching and its noise.", rockface_imaging::matching::STAGES))
        .with(room("fusion", "Fusion of depth maps, and registration.", rockface_imaging::fusion::STAGES))
        .with(room("raster", "Elevation models, differences, masks and tables.", rockface_raster::STAGES))
        .with(room("noise", "Noise descriptors, acceptance and calibration.", rockface_analysis::noise::STAGES))
        .with(room("detection", "Change detection and its scores.", rockface_analysis::detection::STAGES))
        .with(room("dataset", "Labelled data for training.", rockface_analysis::dataset::STAGES))
        .with(room("figure", "Figures and pictures.", rockface_analysis::figure::STAGES))
        .with(room("command", "Programs of your own.", rockface_analysis::command::STAGES))
        .with_parts(parts::PARTS)
        .drawn_by(&rockface_analysis::look::Drawn)
}
