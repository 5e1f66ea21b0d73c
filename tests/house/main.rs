//! Proofs of the whole house, in one binary.

mod broken;
mod chain;
mod cli;
mod documents;
mod engine;
mod golden;
mod lab;
mod reading;
mod rework;
mod tidy;
