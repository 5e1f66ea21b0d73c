//! Group commit: a thread that makes what was written durable, at most a second later.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::error::StoreError;
use crate::journal::Journal;

/// The longest time that finished work may be lost to a power cut.
const DELAY: Duration = Duration::from_secs(1);

/// Syncs a journal in the background once something was written to it.
#[derive(Debug)]
pub(crate) struct Syncer {
    journal: Arc<Journal>,
    pulse: Arc<Pulse>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

#[derive(Debug, Default)]
struct Pulse {
    state: Mutex<State>,
    bell: Condvar,
}

#[derive(Debug, Default)]
struct State {
    dirty: bool,
    stopping: bool,
    fault: Option<StoreError>,
}

impl Syncer {
    /// A syncer at rest; its thread starts with the first write.
    pub(crate) fn new(journal: Arc<Journal>) -> Self {
        Self { journal, pulse: Arc::default(), thread: Mutex::default() }
    }

    /// Says that something was written; reports what went wrong with the last sync in the background.
    pub(crate) fn wake(&self) -> Result<(), StoreError> {
        let mut state = self.pulse.state();
        if let Some(fault) = state.fault.take() {
            return Err(fault);
        }
        if !state.dirty {
            state.dirty = true;
            self.pulse.bell.notify_one();
            drop(state);
            return self.start();
        }
        Ok(())
    }

    /// Syncs now; reports what went wrong with the last sync in the background, too: the system reports a lost write once,
    /// and a second sync succeeds without it.
    pub(crate) fn sync(&self) -> Result<(), StoreError> {
        let fault = self.pulse.state().fault.take();
        let synced = self.journal.sync();
        fault.map_or(synced, Err)
    }

    /// Starts the thread. On a system that starts no more threads, what was written is synced at once instead.
    fn start(&self) -> Result<(), StoreError> {
        let mut thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        if thread.is_some() {
            return Ok(());
        }
        let (journal, pulse) = (Arc::clone(&self.journal), Arc::clone(&self.pulse));
        if let Ok(started) = std::thread::Builder::new().spawn(move || pulse.beat(&journal)) {
            *thread = Some(started);
            return Ok(());
        }
        self.pulse.state().dirty = false;
        self.journal.sync()
    }
}

impl Drop for Syncer {
    fn drop(&mut self) {
        self.pulse.state().stopping = true;
        self.pulse.bell.notify_one();
        let thread = self.thread.get_mut().unwrap_or_else(PoisonError::into_inner);
        if let Some(thread) = thread.take() {
            // A panic of the thread has been printed; the sync below does its work.
            let _ = thread.join();
        }
        // Dropping cannot report; `Store::sync` does. What did not reach the disk is recomputed, never misread.
        let _ = self.journal.sync();
    }
}

impl Pulse {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn beat(&self, journal: &Journal) {
        while self.wait() {
            if let Err(fault) = journal.sync() {
                self.state().fault = Some(fault);
            }
        }
    }

    /// Waits for something to be written and then for the delay; false when the store is being dropped.
    fn wait(&self) -> bool {
        let idle = |state: &mut State| !state.dirty && !state.stopping;
        let state = self.bell.wait_while(self.state(), idle).unwrap_or_else(PoisonError::into_inner);
        let waited = self.bell.wait_timeout_while(state, DELAY, |state| !state.stopping);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.dirty = false;
        !state.stopping
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_went_wrong_in_the_background_is_reported_by_the_next_sync() {
        let folder = tempfile::tempdir().unwrap();
        let syncer = Syncer::new(Arc::new(Journal::open(folder.path(), None).unwrap()));
        syncer.pulse.state().fault = Some(StoreError::DiskFull { path: "a segment".into() });
        assert!(matches!(syncer.sync(), Err(StoreError::DiskFull { .. })));
        syncer.sync().unwrap();
    }
}
