//! Dense matching of image pairs and its noise (paper, section 2.1.2).

pub mod correspondence;
pub mod elevation_step;
pub mod image;
pub mod matched;
pub mod noise;
pub mod noisy_rays;
pub mod own_errors;
pub mod pair;
pub mod pair_geometry;
pub mod params;
pub mod pixel_row;
pub mod rectification;
pub mod rectified_row;
pub mod row_fusion;
pub mod setup;
pub mod side;

// A new stage is its file, its `mod` here and its row below.
mod map_noise;
mod match_image;
mod match_pair;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] =
    &[&Row::<map_noise::MapNoise>::new(), &Row::<match_image::MatchImage>::new(), &Row::<match_pair::MatchPair>::new()];
