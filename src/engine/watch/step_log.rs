//! The log of a step: what it said and measured, and sketches of its outputs; both are blobs that its record names.
//!
//! `Outcome::log` is the list of [`Entry`] as JSON, `Outcome::sketches` the list of [`Shown`]. The MCAP log and the report of a run
//! read these and open no artefact; so the log of a cached run is that of the first.

use std::collections::BTreeMap;
use std::sync::Arc;

use rockface_cache::{Digest, Outcome, Store, StoreError};
use rockface_core::artefact::{Artefact, CodecError};

use rockface_core::Look;

pub use rockface_core::Entry;
pub use rockface_core::artefact::sketch;
pub use rockface_core::artefact::{Shown, Sketch};

/// Why the log of a step cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum StepLogError {
    /// The store failed, or a blob is damaged.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The blob is another program's.
    #[error("the log of a step cannot be read: {0}")]
    Unreadable(String),
}

impl StepLogError {
    /// The message, where the fault is of this log alone.
    ///
    /// # Errors
    /// A store that cannot be read at all.
    pub fn of_one_step(self) -> Result<String, StoreError> {
        match self {
            Self::Store(error @ (StoreError::Missing { .. } | StoreError::Damaged { .. })) => {
                Ok(format!("the log of a step cannot be read: {error}"))
            }
            Self::Store(error) => Err(error),
            Self::Unreadable(_) => Ok(self.to_string()),
        }
    }
}

impl From<CodecError> for StepLogError {
    fn from(error: CodecError) -> Self {
        Self::Unreadable(error.to_string())
    }
}

/// What a step said and measured, in the order in which it did.
///
/// # Errors
/// The blob is damaged or not readable.
pub fn entries(log: Option<Digest>, store: &Store) -> Result<Vec<Entry>, StepLogError> {
    let Some(digest) = log else { return Ok(Vec::new()) };
    serde_json::from_slice(&store.get(&digest)?).map_err(|error| StepLogError::Unreadable(error.to_string()))
}

/// The sketches of a step's outputs; `None` where none were made when it ran.
///
/// # Errors
/// The blob is damaged or not readable.
pub fn read(outcome: &Outcome, store: &Store) -> Result<Option<Vec<Shown>>, StepLogError> {
    let Some(digest) = outcome.sketches else { return Ok(None) };
    Ok(Some(Shown::read_all(&store.get(&digest)?)?))
}

/// The bytes of the sketches of some outputs, in the order of their ports.
///
/// # Errors
/// A number in a sketch that cannot be written.
pub fn sketched(values: &BTreeMap<&'static str, Arc<Artefact>>, look: &dyn Look) -> Result<Vec<u8>, CodecError> {
    let shown = |(port, value): (&&'static str, &Arc<Artefact>)| {
        let port = (*port).to_owned();
        look.sketches(value).into_iter().map(move |sketch| Shown { port: port.clone(), sketch })
    };
    Shown::write_all(&values.iter().flat_map(shown).collect::<Vec<_>>())
}
