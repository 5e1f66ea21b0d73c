//! The engine of rockface: it reads pipelines, plans them, runs them and remembers. It knows no rock.
//!
//! What it can compute is handed to it as a [`rockface_core::Registry`].

pub mod diagnostic;
pub mod explain;
pub mod history;
pub mod pipeline;
pub mod plan;
pub mod run;
pub mod version;
pub mod watch;
