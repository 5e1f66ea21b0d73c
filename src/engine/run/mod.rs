//! Running a plan: the scheduler, its workers, and the run folder.

mod cgroup;
mod folder;
mod machine;
mod scheduler;
mod spill;
mod worker;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rockface_cache::{Digest, Outcome, Outputs, Recipe, Store, StoreError};
use rockface_core::{Look, Registry};

use crate::plan::Plan;
use crate::watch::Observer;

pub use folder::{Finished, LayOut, Reporter, RunFolder, execute_and_tell, finish, shortcut};
pub use machine::{MachineMemory, process_bytes};
pub use worker::{INHERITED, rerun, tools};

/// Runs a plan as the scheduler does; what was done is durable at the end. The plan grows as items of axes become known.
///
/// # Errors
///
/// Those of the store and the system, and a stop.
pub fn execute(
    plan: &mut Plan,
    store: &Arc<Store>,
    options: &Options,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
) -> Result<Summary, RunError> {
    let summary = scheduler::run(plan, store, options, stop, observer)?;
    store.sync()?;
    Ok(summary)
}

/// How a plan is run: threads, memory, checks, and whether a failure ends the run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Steps at once, and threads inside them.
    pub jobs: usize,
    /// Go on with what does not depend on a failed step.
    pub keep_going: bool,
    /// Memory for values handed from step to step, bytes; beyond it they are written to the store.
    pub memory_bytes: usize,
    /// Run every step twice and fail where its outputs differ.
    pub check_determinism: bool,
    /// What draws outputs for the log.
    pub look: &'static dyn Look,
    /// Where among the instances of each step this process begins, as a share of them, 0 to 1. Processes that share a run and begin
    /// at different places rarely take parts of one chain.
    pub start: f64,
}

impl Default for Options {
    fn default() -> Self {
        let jobs = std::thread::available_parallelism().map_or(1, usize::from);
        let (keep_going, check_determinism) = (false, false);
        let (memory_bytes, look) = (half_of_memory(), Registry::default().look());
        Self { jobs, keep_going, memory_bytes, check_determinism, look, start: 0.0 }
    }
}

/// Half of the memory of the machine or of the container; 4 GiB if the system does not report it.
fn half_of_memory() -> usize {
    MachineMemory::now().map_or(4 << 30, |memory| (memory.total / 2) as usize)
}

/// Why a run could not go on.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The store or the disk failed.
    #[error(transparent)]
    Store(StoreError),
    /// The user asked to stop.
    #[error("interrupted; everything that was finished is kept, and the next run goes on from there")]
    Interrupted,
    /// The system gave no threads.
    #[error("cannot start worker threads: {0}")]
    Threads(String),
    /// An output that turned out to be needed on disk could not be encoded.
    #[error("an output cannot be written: {0}")]
    Encode(String),
    /// The run folder could not be written.
    #[error("cannot write the run folder `{path}`: {source}{}", way_out(source))]
    Folder {
        /// What was to be written.
        path: std::path::PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// What helps where a folder of runs cannot be written to.
fn way_out(error: &std::io::Error) -> &'static str {
    use std::io::ErrorKind::{PermissionDenied, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    match error.kind() {
        StorageFull | QuotaExceeded => {
            "; free some space or give --runs on another disk; what is finished is kept and the next run continues"
        }
        PermissionDenied | ReadOnlyFilesystem => "; give folders you may write to with --runs and --store",
        _ => "",
    }
}

impl RunError {
    /// The exit code of the program.
    pub fn exit_code(&self) -> i32 {
        match self {
            Self::Interrupted => 130,
            Self::Store(_) | Self::Threads(_) | Self::Encode(_) | Self::Folder { .. } => 3,
        }
    }
}

/// What became of a run.
#[derive(Debug)]
pub struct Summary {
    /// By instance, in the order of the plan.
    pub instances: Vec<InstanceResult>,
    /// Wall time in seconds.
    pub wall_s: f64,
    /// Whether a step failed.
    pub failed: bool,
    /// Whether a recomputed step gave a different output after others had read the former one.
    revised: bool,
}

/// What became of one instance.
#[derive(Debug)]
pub struct InstanceResult {
    /// The key of its recipe, once it was known.
    pub key: Option<Digest>,
    /// Its recipe, if it was known and is not on record: see [`InstanceResult::recipe`].
    recipe: Option<Recipe>,
    /// Whether its stage ran in this run.
    pub executed: bool,
    /// Its outcome; `None` if it failed or was not reached.
    pub outcome: Option<Outcome>,
    /// Why its stage failed, if it did.
    pub failure: Option<StepFailure>,
}

/// Why a stage failed.
#[derive(Debug, Clone, Default)]
pub struct StepFailure {
    /// The cause and the way out.
    pub message: String,
    /// The log up to the failure, a blob, as [`Outcome::log`] is.
    pub log: Option<Digest>,
    /// Outputs that explain it, blobs too; they are in the run folder and no other step can use them.
    pub outputs: Outputs,
}

impl InstanceResult {
    /// Its log, a blob.
    pub fn log(&self) -> Option<Digest> {
        let failed = self.failure.as_ref().and_then(|failure| failure.log);
        self.outcome.as_ref().map_or(failed, |outcome| outcome.log)
    }

    /// Its recipe: that of its record, where it has one.
    pub fn recipe(&self, store: &Store) -> Option<Recipe> {
        let recorded = || store.record(&self.key?).map(|record| record.recipe);
        self.recipe.clone().or_else(recorded)
    }

    /// The text of its recipe, as it was hashed.
    pub fn recipe_text(&self, store: &Store) -> Option<String> {
        self.recipe.as_ref().map_or_else(|| store.recipe_text(&self.key?), |recipe| Some(recipe.text()))
    }
}

impl Summary {
    /// The instances that have an outcome, each with its key.
    pub fn keys(&self) -> impl Iterator<Item = (usize, Digest)> {
        let known = self.instances.iter().enumerate().filter(|(_, result)| result.outcome.is_some());
        known.filter_map(|(instance, result)| Some((instance, result.key?)))
    }

    /// How many instances ran in this run.
    pub fn executed(&self) -> usize {
        self.instances.iter().filter(|instance| instance.executed).count()
    }

    /// How many instances have an outcome without having run.
    pub fn cached(&self) -> usize {
        self.instances.iter().filter(|instance| !instance.executed && instance.outcome.is_some()).count()
    }
}
