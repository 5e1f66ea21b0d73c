//! The memory budget of a run: what values take, what running instances are expected to need, and whether another fits.

use std::collections::{HashMap, HashSet};

/// The memory of a run, shared between values and running instances; all sizes in bytes.
pub struct MemoryBudget {
    limit: u64,
    /// What the values in memory take.
    held: u64,
    /// What each running instance is expected to need.
    running: HashMap<usize, u64>,
    /// What instances that are ready are expected to need, where that was asked for.
    estimates: HashMap<usize, u64>,
    /// Instances whose wait for memory has been reported.
    reported: HashSet<usize>,
}

impl MemoryBudget {
    /// A budget of `limit` bytes, of which nothing is used.
    pub fn new(limit: usize) -> Self {
        let (running, estimates, reported) = (HashMap::new(), HashMap::new(), HashSet::new());
        Self { limit: limit as u64, held: 0, running, estimates, reported }
    }

    /// A value is in memory now.
    pub fn hold(&mut self, bytes: usize) {
        self.held += bytes as u64;
    }

    /// A value is not in memory any more.
    pub fn release(&mut self, bytes: usize) {
        self.held = self.held.saturating_sub(bytes as u64);
    }

    /// Whether the values take more than this.
    pub fn holds_more_than(&self, bytes: u64) -> bool {
        self.held > bytes
    }

    /// The whole budget, bytes, whether used or not.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// What is left for values while an instance that needs `need` runs beside those that run now.
    pub fn left_beside(&self, need: u64) -> u64 {
        self.limit.saturating_sub(self.claimed().saturating_add(need))
    }

    /// Whether an instance that needs `need` fits beside those that run and the values in memory. Alone, every one does.
    pub fn admits(&self, need: u64) -> bool {
        let claimed = self.claimed().saturating_add(need);
        self.running.is_empty() || claimed.saturating_add(self.held) <= self.limit
    }

    fn claimed(&self) -> u64 {
        self.running.values().copied().fold(0, u64::saturating_add)
    }

    /// An instance starts that is expected to need this.
    pub fn start(&mut self, instance: usize, need: u64) {
        self.estimates.remove(&instance);
        self.running.insert(instance, need);
    }

    /// An instance has ended.
    pub fn end(&mut self, instance: usize) {
        self.running.remove(&instance);
    }

    /// What a running instance is expected to need.
    pub fn claim(&self, instance: usize) -> u64 {
        self.running.get(&instance).copied().unwrap_or(0)
    }

    /// What a ready instance is expected to need, if that is known.
    pub fn estimate(&self, instance: usize) -> Option<u64> {
        self.estimates.get(&instance).copied()
    }

    /// Keeps what a ready instance is expected to need.
    pub fn set_estimate(&mut self, instance: usize, need: u64) {
        self.estimates.insert(instance, need);
    }

    /// Whether the wait of an instance for memory is still to be reported; true once for each.
    pub fn is_first_wait(&mut self, instance: usize) -> bool {
        self.reported.insert(instance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instance_fits_beside_others_and_values_or_runs_alone() {
        let mut budget = MemoryBudget::new(100);
        assert!(budget.admits(1000), "alone");
        budget.start(0, 60);
        assert!(budget.admits(40) && !budget.admits(41) && !budget.admits(u64::MAX));
        assert_eq!((budget.left_beside(30), budget.left_beside(50)), (10, 0));
        budget.hold(30);
        assert!(budget.admits(10) && !budget.admits(11) && budget.holds_more_than(29));
        budget.release(50);
        assert!(!budget.holds_more_than(0), "never below nothing");
        budget.end(0);
        assert!(budget.admits(1000));
    }

    #[test]
    fn an_estimate_lasts_until_the_start_and_a_wait_is_reported_once() {
        let mut budget = MemoryBudget::new(100);
        budget.set_estimate(7, 5);
        assert_eq!(budget.estimate(7), Some(5));
        budget.start(7, 5);
        assert_eq!(budget.estimate(7), None);
        assert_eq!([budget.is_first_wait(7), budget.is_first_wait(7), budget.is_first_wait(8)], [true, false, true]);
    }
}
