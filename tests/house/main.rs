//! Proofs of the whole house, in one binary.

mod broken;
mod cli;
mod documents;
mod engine;
mod lab;
mod tidy;
