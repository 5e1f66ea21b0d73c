//! The resident memory of the process, sampled while steps run.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::run::process_bytes;

/// The shortest time between two samples.
const EVERY: Duration = Duration::from_millis(40);

/// The greatest resident memory since each running instance began, bytes; shared with its worker, which records it.
#[derive(Default)]
pub struct Resident {
    peaks: HashMap<usize, Arc<AtomicU64>>,
    sampled: Option<Instant>,
}

impl Resident {
    /// Starts to watch an instance; what is returned holds its peak so far, bytes.
    pub fn begin(&mut self, instance: usize) -> Arc<AtomicU64> {
        let peak = Arc::new(AtomicU64::new(0));
        self.peaks.insert(instance, peak.clone());
        peak
    }

    /// An instance has ended.
    pub fn end(&mut self, instance: usize) {
        self.peaks.remove(&instance);
    }

    /// Takes a sample, unless the last one is recent.
    pub fn sample(&mut self) {
        if self.peaks.is_empty() || self.sampled.is_some_and(|at| at.elapsed() < EVERY) {
            return;
        }
        self.sampled = Some(Instant::now());
        let Some(bytes) = resident_bytes() else { return };
        for peak in self.peaks.values() {
            peak.fetch_max(bytes, Ordering::Relaxed);
        }
    }
}

fn resident_bytes() -> Option<u64> {
    process_bytes("self", "VmRSS")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_in_use_is_seen_by_whoever_runs() {
        let mut resident = Resident::default();
        let peak = resident.begin(7);
        resident.sample();
        let seen = peak.load(Ordering::Relaxed);
        // Where the system reports nothing, nothing is seen.
        assert!(seen > 1 << 20 || resident_bytes().is_none(), "{seen}");
        resident.end(7);
        resident.sample();
        assert_eq!(Arc::strong_count(&peak), 1);
    }
}
