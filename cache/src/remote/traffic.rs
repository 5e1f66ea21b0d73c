//! What goes to a remote place and comes from there: requests and bytes, and how many failed.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::backend::{Backend, BackendError, Object};

/// How many requests were sent, by kind, and how many bytes went each way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Traffic {
    /// Requests that read an object.
    pub reads: u64,
    /// Requests that wrote an object.
    pub writes: u64,
    /// Listings; one of more than 1000 objects takes several requests.
    pub lists: u64,
    /// Requests that removed an object.
    pub deletes: u64,
    /// Requests that failed after all attempts.
    pub failures: u64,
    /// Bytes of the objects that were read.
    pub bytes_read: u64,
    /// Bytes of the objects that were written.
    pub bytes_written: u64,
}

/// A backend whose traffic is counted.
#[derive(Debug)]
pub(crate) struct Counted {
    backend: Box<dyn Backend>,
    reads: AtomicU64,
    writes: AtomicU64,
    lists: AtomicU64,
    deletes: AtomicU64,
    failures: AtomicU64,
    bytes_read: AtomicU64,
    bytes_written: AtomicU64,
}

impl Counted {
    pub fn new(backend: Box<dyn Backend>) -> Self {
        let [reads, writes, lists, deletes, failures, bytes_read, bytes_written] = Default::default();
        Self { backend, reads, writes, lists, deletes, failures, bytes_read, bytes_written }
    }

    pub fn traffic(&self) -> Traffic {
        Traffic {
            reads: self.reads.load(Relaxed),
            writes: self.writes.load(Relaxed),
            lists: self.lists.load(Relaxed),
            deletes: self.deletes.load(Relaxed),
            failures: self.failures.load(Relaxed),
            bytes_read: self.bytes_read.load(Relaxed),
            bytes_written: self.bytes_written.load(Relaxed),
        }
    }

    fn count<T>(&self, what: &AtomicU64, result: Result<T, BackendError>) -> Result<T, BackendError> {
        what.fetch_add(1, Relaxed);
        if matches!(result, Err(BackendError::Unavailable(_) | BackendError::Forbidden(_) | BackendError::Foreign(_))) {
            self.failures.fetch_add(1, Relaxed);
        }
        result
    }
}

impl Backend for Counted {
    fn way_in(&self) -> String {
        self.backend.way_in()
    }

    fn url(&self) -> &str {
        self.backend.url()
    }

    fn is_read_only(&self) -> bool {
        self.backend.is_read_only()
    }

    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        let bytes = self.count(&self.reads, self.backend.get(name, limit))?;
        self.bytes_read.fetch_add(bytes.len() as u64, Relaxed);
        Ok(bytes)
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
        self.count(&self.writes, self.backend.put(name, bytes))?;
        self.bytes_written.fetch_add(bytes.len() as u64, Relaxed);
        Ok(())
    }

    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
        let is_new = self.count(&self.writes, self.backend.create(name, bytes))?;
        self.bytes_written.fetch_add(bytes.len() as u64, Relaxed);
        Ok(is_new)
    }

    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
        self.count(&self.lists, self.backend.list(prefix))
    }

    fn delete(&self, name: &str) -> Result<(), BackendError> {
        self.count(&self.deletes, self.backend.delete(name))
    }
}
