//! The engine of rockface: it reads pipelines, plans them, runs them and remembers. It knows no rock.
//!
//! What it can compute is handed to it as a [`rockface_core::Registry`].

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

/// Target of the spans that say where the time of a run goes, at level TRACE.
pub const PHASE: &str = "rockface::phase";

/// Does some work as a phase that a trace of the run shows.
macro_rules! phase {
    ($name:literal, $work:expr) => {
        tracing::trace_span!(target: $crate::PHASE, $name).in_scope(|| $work)
    };
}

pub mod diagnostic;
pub mod explain;
pub mod history;
pub mod pipeline;
pub mod plan;
pub mod run;
pub mod version;
pub mod watch;
