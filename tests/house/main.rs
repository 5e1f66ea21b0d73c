//! Proofs of the whole house, in one binary.

mod broken;
mod chain;
mod cli;
mod commands;
mod documents;
mod dynamic;
mod engine;
mod golden;
mod lab;
mod language;
mod reading;
mod rework;
mod tidy;
