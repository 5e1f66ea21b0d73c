//! Why a step instance did not finish.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;

use rockface_cache::{Digest, Outputs, StoreError};
use rockface_core::StageError;

/// Why an instance did not finish.
pub enum Failure {
    /// The stage failed; what it left is in the store.
    Stage(StageError, Left),
    /// An input blob is damaged or gone; its producer has to run again.
    Lost(usize, String),
    /// Another process has its key.
    Held,
    /// The store cannot go on.
    Store(StoreError),
}

/// What a stage that failed left: blobs of the store, which no record names.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Left {
    /// Its log up to the failure.
    pub log: Option<Digest>,
    /// The outputs that explain the failure.
    pub outputs: Outputs,
}

impl From<StageError> for Failure {
    fn from(error: StageError) -> Self {
        Self::Stage(error, Left::default())
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

/// Turns a panic into the failure of the step, with the message of the panic.
pub fn guarded<T>(work: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        let error = StageError::new(format!("the stage panicked: {}", said.unwrap_or("no message")));
        let hint = "this is a fault of rockface; please report it with the pipeline and the run folder";
        Err(error.hint(hint).into())
    })
}

/// Why an input could not be read or a program could not be started; the stage sees only that it failed.
pub type Trouble = Mutex<Option<Failure>>;
