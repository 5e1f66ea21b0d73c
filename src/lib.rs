//! The engine of rockface: it reads pipelines, plans them, runs them and remembers. It knows no rock.

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
