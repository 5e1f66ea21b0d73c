//! The face and its rockfalls.

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

pub mod face;
pub mod rockfall;
