//! What a remote place for results must be able to do: a few operations on named objects.

use crate::StoreError;

/// An object in a remote place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Object {
    /// Its name, `/` between the parts.
    pub name: String,
    /// Its size, bytes.
    pub bytes: u64,
    /// When it was last written, by the clock of the place, seconds since 1970.
    pub modified_unix_s: u64,
}

/// Why an operation on a remote place failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BackendError {
    /// There is no object of this name.
    #[error("it is not there")]
    Missing,
    /// There is nothing of rockface in the place.
    #[error("there is no store of rockface there; `rockface store push` makes one")]
    NoStore,
    /// The place refuses these credentials.
    #[error("access is forbidden: {0}")]
    Forbidden(String),
    /// The place cannot be reached, is too slow, or fails; another attempt later may succeed.
    #[error("{0}")]
    Unavailable(String),
    /// What is there is no store of rockface, or not as one writes it.
    #[error("{0}")]
    Foreign(String),
    /// The place cannot do this.
    #[error("this kind of place cannot {0}")]
    Unsupported(&'static str),
    /// The object is larger than it may be.
    #[error("it has more than {limit} bytes")]
    TooLarge {
        /// The greatest size that fits, in bytes.
        limit: u64,
    },
}

/// A remote place: named objects that are written whole, read whole, listed and deleted.
///
/// All calls block, may come from several threads at once, and return within a time that the backend states. Names consist of
/// ASCII letters, digits, `-`, `.` and `/`. What is read is verified by whoever reads it.
pub trait Backend: std::fmt::Debug + Send + Sync {
    /// Where it is, for messages; without secrets.
    fn url(&self) -> &str;

    /// Whether it can only be read.
    fn is_read_only(&self) -> bool {
        false
    }

    /// What to do where it refuses access.
    fn way_in(&self) -> String {
        "give credentials that may do this by the environment (AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY for s3://), or add --remote-read-only if they may only read".to_owned()
    }

    /// The bytes of an object, at most `limit` of them: a larger one is refused before it is read whole.
    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError>;

    /// Writes an object, whole or not at all; one of this name is replaced.
    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError>;

    /// Writes an object unless there is one of this name; says whether it did. Of several who try at once, one succeeds.
    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError>;

    /// The objects whose names start with `prefix`, which ends with `/`.
    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError>;

    /// Removes an object; one that is not there counts as removed.
    fn delete(&self, name: &str) -> Result<(), BackendError>;
}

impl BackendError {
    /// The fault of a command that cannot do without the remote place.
    pub(crate) fn at(self, action: &'static str, backend: &dyn Backend) -> StoreError {
        let url = backend.url().to_owned();
        let hint = match &self {
            Self::Forbidden(_) => format!("; {}", backend.way_in()),
            Self::Unavailable(_) => "; check the address and the network".to_owned(),
            _ => String::new(),
        };
        StoreError::Remote { action, url, why: format!("{self}{hint}") }
    }
}
