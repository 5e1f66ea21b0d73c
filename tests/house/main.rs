//! Proofs of the whole house, in one binary.

mod broken;
mod campaign;
mod care;
mod chain;
mod cli;
mod documents;
mod engine;
mod golden;
mod history;
mod lab;
mod reading;
mod rework;
mod tidy;
