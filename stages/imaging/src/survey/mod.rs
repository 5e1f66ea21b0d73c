//! Surveys: viewpoints, pairs, and the covariance of the block adjustment.

pub mod block_adjustment;
pub mod face;
pub mod forecast;
pub mod overlap;
pub mod stations;
mod surveyed_points;

// A new stage is its file, its `mod` here and its row below.
mod estimate_covariance;
mod forecast_precision;
mod plan_survey;
mod select_pairs;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<estimate_covariance::EstimateCovariance>::new(),
    &Row::<forecast_precision::ForecastPrecision>::new(),
    &Row::<plan_survey::PlanSurvey>::new(),
    &Row::<select_pairs::SelectPairs>::new(),
];
