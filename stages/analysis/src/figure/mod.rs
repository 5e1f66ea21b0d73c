//! Figures and pictures for people.

pub mod canvas;
pub mod chart;
pub mod colour_scale;
pub mod picture;
pub mod rockfall_figure;
pub mod shape_triangle;

// A new stage is its file, its `mod` here and its row below.
mod compare_figures;
mod draw_descriptors;
mod draw_detection_frequency;
mod draw_detection_rates;
mod draw_detection_volumes;
mod draw_detections;
mod draw_picture;
mod draw_rasters;
mod draw_rockfall;
mod draw_scores;
mod draw_search;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<compare_figures::CompareFigures>::new(),
    &Row::<draw_descriptors::DrawDescriptors>::new(),
    &Row::<draw_detection_frequency::DrawDetectionFrequency>::new(),
    &Row::<draw_detection_rates::DrawDetectionRates>::new(),
    &Row::<draw_detection_volumes::DrawDetectionVolumes>::new(),
    &Row::<draw_detections::DrawDetections>::new(),
    &Row::<draw_picture::DrawPicture>::new(),
    &Row::<draw_rasters::DrawRasters>::new(),
    &Row::<draw_rockfall::DrawRockfall>::new(),
    &Row::<draw_scores::DrawScores>::new(),
    &Row::<draw_search::DrawSearch>::new(),
];
