//! What is made of measurements: noise statistics, change detection, data sets, figures.

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

pub mod command;
pub mod dataset;
pub mod detection;
pub mod figure;
pub mod look;
pub mod noise;
