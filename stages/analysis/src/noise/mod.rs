//! Noise descriptors of rasters, and the acceptance of simulations against references (paper, section 2.2).

pub mod acceptance_rate;
pub mod chain;
pub mod classifier;
pub mod descriptors;
pub mod detrend;
pub mod doubtful;
pub mod envelope;
pub mod learning;
pub mod mahalanobis;
pub mod match_moments;
pub mod nested_variogram;
pub mod perfect_score;
pub mod perfect_simulator;
pub mod points;
pub mod robust_variogram;
pub mod roughness;
pub mod sector;
pub mod spectrum;
pub mod structure;
pub mod stumps;
pub mod surrogate;
pub mod tested;
pub mod transfer;
pub mod two_samples;
pub mod variogram;
pub mod variogram_model;

// A new stage is its file, its `mod` here and its row below.
mod adjust_noise;
mod compare_samples;
mod describe_noise;
mod describe_structure;
mod draw_noise;
mod draw_registration;
mod fit_acceptance;
mod learn_noise;
mod propose_parameters;
mod refine_search;
mod summarise_acceptance;
mod test_acceptance;
mod transfer_noise;

use rockface_core::{AnyStage, Row};

/// The stages of this room, in the order of the catalogue.
pub static STAGES: &[&dyn AnyStage] = &[
    &Row::<adjust_noise::AdjustNoise>::new(),
    &Row::<compare_samples::CompareSamples>::new(),
    &Row::<describe_noise::DescribeNoise>::new(),
    &Row::<describe_structure::DescribeStructure>::new(),
    &Row::<draw_noise::DrawNoise>::new(),
    &Row::<draw_registration::DrawRegistration>::new(),
    &Row::<fit_acceptance::FitAcceptance>::new(),
    &Row::<learn_noise::LearnNoise>::new(),
    &Row::<propose_parameters::ProposeParameters>::new(),
    &Row::<refine_search::RefineSearch>::new(),
    &Row::<summarise_acceptance::SummariseAcceptance>::new(),
    &Row::<test_acceptance::TestAcceptance>::new(),
    &Row::<transfer_noise::TransferNoise>::new(),
];
