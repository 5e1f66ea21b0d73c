//! What is made of measurements: noise statistics, change detection, data sets, figures.

pub mod command;
pub mod dataset;
pub mod detection;
pub mod figure;
pub mod look;
pub mod noise;
