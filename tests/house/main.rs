//! Proofs of the whole house, in one binary.

mod broken;
mod engine;
mod lab;
