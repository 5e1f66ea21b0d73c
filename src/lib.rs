//! The command line of rockface, its drawings and its reports, as a library: a program of your own can add stages to it.

// What cannot be written must not end the program: `cli::output` says and complains.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

pub mod cli;
pub mod drawing;
pub mod memory;
pub mod program;
pub mod report;
pub mod trace;
