//! A remote place that fails is left alone: one warning, and work goes on without it.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::sync::{Mutex, OnceLock, PoisonError};

use super::backend::BackendError;

/// So many failures in succession, and no further attempt is made.
const FAILURES: u32 = 3;

/// Receives the warnings about a remote place.
pub type Warn = Box<dyn Fn(&str) + Send + Sync>;

/// Whether a remote place is used.
pub(crate) struct Breaker {
    url: String,
    warn: Warn,
    failures: AtomicU32,
    /// Why it is not used any more.
    off: OnceLock<String>,
    warned: Mutex<BTreeSet<String>>,
}

impl Breaker {
    pub fn new(url: String, warn: Warn) -> Self {
        Self { url, warn, failures: AtomicU32::new(0), off: OnceLock::new(), warned: Mutex::default() }
    }

    /// Whether the place is left alone.
    pub fn is_off(&self) -> bool {
        self.off.get().is_some()
    }

    /// Does something with the place unless it is left alone, and takes note of how that went.
    pub fn attempt<T>(&self, work: impl FnOnce() -> Result<T, BackendError>) -> Result<T, BackendError> {
        if let Some(why) = self.off.get() {
            return Err(BackendError::Unavailable(why.clone()));
        }
        let result = work();
        match &result {
            Err(BackendError::Unavailable(why)) if self.failures.fetch_add(1, Relaxed) + 1 >= FAILURES => {
                self.turn_off(why);
            }
            Err(BackendError::Forbidden(why)) => self.turn_off(&format!("access is forbidden: {why}")),
            Err(BackendError::Foreign(why)) => self.turn_off(why),
            Err(BackendError::Unavailable(_)) => {}
            _ => self.failures.store(0, Relaxed),
        }
        result
    }

    /// Leaves the place alone from now on.
    pub fn turn_off(&self, why: &str) {
        if self.off.set(why.to_owned()).is_ok() {
            self.warn(&format!("is not used any more, and work goes on with the local store: {why}"));
        }
    }

    /// Warns about the place unless it was said before.
    pub fn warn_once(&self, what: &str) {
        let mut warned = self.warned.lock().unwrap_or_else(PoisonError::into_inner);
        if warned.insert(what.to_owned()) {
            self.warn(what);
        }
    }

    /// Warns about the place.
    pub fn warn(&self, what: &str) {
        (self.warn)(&format!("remote {} {what}", self.url));
    }
}

impl std::fmt::Debug for Breaker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Breaker").field("failures", &self.failures).field("off", &self.off).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    #[test]
    fn failures_in_succession_end_the_use_with_one_warning() {
        let told = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&told);
        let breaker =
            Breaker::new("s3://b".to_owned(), Box::new(move |text| heard.lock().unwrap().push(text.to_owned())));
        let down = || Err::<(), _>(BackendError::Unavailable("no route".to_owned()));
        for _ in 0..10 {
            drop(breaker.attempt(down));
            drop(breaker.attempt(down));
            breaker.attempt(|| Ok(())).unwrap();
        }
        drop(breaker.attempt(|| Err::<(), _>(BackendError::Missing)));
        assert!(!breaker.is_off());
        for _ in 0..10 {
            drop(breaker.attempt(down));
        }
        assert!(breaker.attempt(|| -> Result<(), _> { panic!("it is left alone") }).is_err());
        let told = told.lock().unwrap();
        assert!(told.len() == 1 && told[0].contains("s3://b") && told[0].contains("no route"), "{told:?}");
    }
}
