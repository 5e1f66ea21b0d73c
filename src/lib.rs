//! The engine of rockface: it reads pipelines, plans them, runs them and remembers. It knows no rock.

// What cannot be written must not end the program: `cli::output` says and tells.
#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr))]

pub mod build;
pub mod cli;
pub mod diagnostic;
pub mod drawing;
pub mod explain;
pub mod history;
pub mod pipeline;
pub mod plan;
pub mod report;
pub mod run;
pub mod watch;
