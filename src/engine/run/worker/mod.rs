//! The workers: threads that run one step instance each, and what they lend a stage.

mod failure;
mod host;
mod program;
pub mod rerun;
mod standing;
mod threads;
pub mod tools;
mod work;
mod workers;

pub use failure::Failure;
pub use program::INHERITED;
pub use work::{Done, Feed, Source, Task, Value};
pub use workers::{Result, Workers};
