//! The run folder: readable names for outputs, the log, the manifest, and the shortcut around a run that would change nothing.

mod files;
mod headlines;
mod lay_out;
mod log;
mod made;
mod manifest_writer;
mod run_folder;
pub mod shortcut;
mod side_by_side;
mod tell;
mod unfinished;

pub use lay_out::LayOut;
pub use run_folder::{Finished, Reporter, RunFolder, finish};
pub use tell::execute_and_tell;
