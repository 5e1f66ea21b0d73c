//! Proofs of the whole house, in one binary.

mod broken;
mod calibration;
mod campaign;
mod care;
mod chain;
mod cli;
mod commands;
mod detection;
mod documents;
mod dynamic;
mod engine;
mod folders;
mod golden;
mod history;
mod lab;
mod language;
mod memory;
mod reading;
mod references;
mod report;
mod rework;
mod streams;
mod survey;
mod tidy;
mod together;
mod watching;
