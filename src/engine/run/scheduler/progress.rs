//! What the scheduler reports to its observer: events, how far the run is, and the time left.

use std::time::{Duration, Instant};

use super::schedule::Scheduler;
use crate::watch::{Event, Progress};

/// How long an estimate of the time left is used.
const ESTIMATE_EVERY: Duration = Duration::from_millis(100);
/// How long a run takes before records of earlier ones are looked through for the time that is left.
const SHORT: Duration = Duration::from_secs(1);

impl Scheduler<'_> {
    /// Tells the observer of an event, with the progress of the run and an estimate of the time left.
    pub fn report(&mut self, event: &Event) {
        let progress = self.progress();
        self.observer.event(event, progress);
    }

    /// Tells the observer that nothing has happened for a moment.
    pub fn report_idle(&mut self) {
        let progress = self.progress();
        self.observer.idle(progress);
    }

    fn progress(&mut self) -> Progress {
        if self.timing.estimate.1.is_none_or(|made| made.elapsed() > ESTIMATE_EVERY) {
            if self.begun.elapsed() > SHORT && self.timing.wants_records(self.states.open()) {
                let records = self.store.keys().into_iter().filter_map(|key| self.store.record(&key));
                self.timing.take_records(records.map(|record| (record.recipe.stage, record.cost.wall_s)));
            }
            let remaining_s = self.timing.remaining_s(self.states.open(), self.options.jobs);
            self.timing.estimate = (remaining_s, Some(Instant::now()));
        }
        Progress { done: self.states.closed(), total: self.states.len(), remaining_s: self.timing.estimate.0 }
    }

    /// Reports that the outcome of an instance was known.
    pub fn report_cached(&mut self, instance: usize) {
        if !self.observer.ignores_cached() {
            self.report(&Event::Cached { step: self.plan.label(instance) });
        }
    }

    /// Reports a warning about an instance.
    pub fn warn(&mut self, instance: usize, text: String) {
        self.report(&Event::Warning { step: self.plan.label(instance), text });
    }

    /// Warns about blobs that were found damaged while the store was searched for an instance.
    pub fn report_damaged(&mut self, instance: usize) {
        for damage in self.store.take_damaged() {
            let moved_to = damage.moved_to.display();
            let text = format!("a stored output was damaged; it was moved to `{moved_to}` and is recomputed");
            self.warn(instance, text);
        }
    }
}
