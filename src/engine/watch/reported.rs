//! What a process that runs something reports to whoever watches it from another process: how far it is, what it does now,
//! and what failed.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rockface_cache::Store;
use serde::{Deserialize, Serialize};

use super::{Event, Observer, Progress};

/// How often a report is written while something happens.
const EVERY: Duration = Duration::from_millis(500);
/// The number of failures that are reported.
const FAILURES_TOLD: usize = 20;

/// What a process is there for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// It writes a run folder at the end.
    Run,
    /// It takes steps of a run that another process has begun.
    Work,
}

/// The report of a process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// What it is there for.
    pub role: Role,
    /// The number of the process on its machine.
    pub pid: u32,
    /// Its machine, by name.
    pub host: String,
    /// The pipeline file, absolute, or the name of one that ships.
    pub pipeline: PathBuf,
    /// The name of the pipeline.
    pub name: String,
    /// When it began, seconds since 1970.
    pub begun_unix_s: u64,
    /// Instances that are done, whoever ran them.
    pub done: usize,
    /// All instances that are known.
    pub total: usize,
    /// Expected seconds to the end, were it alone.
    pub remaining_s: Option<f64>,
    /// How many instances this process ran to their end.
    pub executed: usize,
    /// Instances it ran by step.
    pub steps: BTreeMap<String, usize>,
    /// Instances it runs now.
    pub running: BTreeSet<String>,
    /// Instances that failed here, each with the cause.
    pub failures: Vec<(String, String)>,
}

/// Passes events on, and reports them in the store.
pub struct Reported {
    inner: Box<dyn Observer>,
    shared: Arc<Shared>,
    writer: Option<JoinHandle<()>>,
}

/// What the observer and the thread that writes share.
struct Shared {
    store: Arc<Store>,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    report: Report,
    is_new: bool,
    is_over: bool,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes what is new, now and then, until the end.
    fn write_on(&self) {
        let mut state = self.state();
        loop {
            if std::mem::take(&mut state.is_new) {
                let text = serde_json::to_string(&state.report).unwrap_or_default();
                drop(state);
                // Who watches misses one report; the run is not affected.
                if let Err(error) = self.store.report(&text) {
                    tracing::debug!("no report: {error}");
                }
                state = self.state();
            }
            if state.is_over && !state.is_new {
                return;
            }
            // Not to be woken by every event: there may be very many.
            state = self.changed.wait_timeout(state, EVERY).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Reported {
    /// Reports every event that `inner` gets.
    pub fn new(inner: Box<dyn Observer>, store: &Arc<Store>, role: Role, pipeline: &Path, name: &str) -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default().trim().to_owned();
        let pipeline = if pipeline.is_file() { std::path::absolute(pipeline).ok() } else { None }
            .unwrap_or_else(|| pipeline.to_owned());
        let report = Report {
            role,
            pid: std::process::id(),
            host,
            pipeline,
            name: name.to_owned(),
            begun_unix_s: since.as_secs(),
            done: 0,
            total: 0,
            remaining_s: None,
            executed: 0,
            steps: BTreeMap::new(),
            running: BTreeSet::new(),
            failures: Vec::new(),
        };
        let state = Mutex::new(State { report, is_new: true, is_over: false });
        let shared = Arc::new(Shared { store: Arc::clone(store), state, changed: Condvar::new() });
        let own = Arc::clone(&shared);
        // Without it nobody can watch, and the run goes on.
        let writer = std::thread::Builder::new().name("report".to_owned()).spawn(move || own.write_on()).ok();
        Self { inner, shared, writer }
    }
}

impl Report {
    fn note(&mut self, event: &Event) {
        let report = self;
        match event {
            Event::Started { step, .. } => {
                report.running.insert(step.clone());
            }
            Event::Finished { step, .. } => {
                report.running.remove(step);
                report.executed += 1;
                let name = step.split('[').next().unwrap_or(step);
                *report.steps.entry(name.to_owned()).or_default() += 1;
            }
            Event::Elsewhere { step } => {
                report.running.remove(step);
            }
            Event::Failed { step, message, .. } => {
                report.running.remove(step);
                if report.failures.len() < FAILURES_TOLD {
                    report.failures.push((step.clone(), message.clone()));
                }
            }
            Event::Planned { .. }
            | Event::Cached { .. }
            | Event::Held { .. }
            | Event::Waiting { .. }
            | Event::Warning { .. } => {}
        }
    }
}

impl Observer for Reported {
    fn event(&mut self, event: &Event, progress: Progress) {
        let mut state = self.shared.state();
        state.report.note(event);
        (state.report.done, state.report.total) = (progress.done, progress.total);
        state.report.remaining_s = progress.remaining_s;
        state.is_new = true;
        drop(state);
        self.inner.event(event, progress);
    }

    fn idle(&mut self, progress: Progress) {
        self.inner.idle(progress);
    }

    fn ignores_cached(&self) -> bool {
        self.inner.ignores_cached()
    }

    fn end(&mut self) {
        let mut state = self.shared.state();
        state.report.running.clear();
        state.is_new = true;
        drop(state);
        self.inner.end();
    }
}

impl Drop for Reported {
    fn drop(&mut self) {
        self.shared.state().is_over = true;
        self.shared.changed.notify_all();
        // It has nothing to tell anybody if it panicked.
        let _ = self.writer.take().map(JoinHandle::join);
    }
}
