//! A remote place in memory, for tests: it can be made to fail in the ways that remote places do.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

use super::backend::{Backend, BackendError, Object};

/// A remote place whose objects are kept in memory.
#[derive(Debug, Default)]
pub struct InMemory {
    objects: Mutex<BTreeMap<String, (Vec<u8>, u64)>>,
    /// Whether every operation fails.
    pub is_down: AtomicBool,
}

/// Objects by name, with the time of their writing, in seconds since 1970.
type Objects = BTreeMap<String, (Vec<u8>, u64)>;

impl InMemory {
    /// All objects by name, with the time of their writing, to be changed as a fault would.
    pub fn objects(&self) -> MutexGuard<'_, Objects> {
        self.objects.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn reach(&self) -> Result<MutexGuard<'_, Objects>, BackendError> {
        if self.is_down.load(Ordering::Relaxed) {
            return Err(BackendError::Unavailable("it is down".to_owned()));
        }
        Ok(self.objects())
    }
}

fn now_s() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

impl Backend for InMemory {
    fn url(&self) -> &'static str {
        "memory:"
    }

    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        let objects = self.reach()?;
        let (bytes, _) = objects.get(name).ok_or(BackendError::Missing)?;
        if bytes.len() as u64 > limit { Err(BackendError::TooLarge { limit }) } else { Ok(bytes.clone()) }
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
        self.reach()?.insert(name.to_owned(), (bytes.to_owned(), now_s()));
        Ok(())
    }

    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
        let mut objects = self.reach()?;
        if objects.contains_key(name) {
            return Ok(false);
        }
        objects.insert(name.to_owned(), (bytes.to_owned(), now_s()));
        Ok(true)
    }

    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
        let objects = self.reach()?;
        let found = objects.iter().filter(|(name, _)| name.starts_with(prefix));
        let object = |(name, (bytes, modified)): (&String, &(Vec<u8>, u64))| Object {
            name: name.clone(),
            bytes: bytes.len() as u64,
            modified_unix_s: *modified,
        };
        Ok(found.map(object).collect())
    }

    fn delete(&self, name: &str) -> Result<(), BackendError> {
        self.reach()?.remove(name);
        Ok(())
    }
}
