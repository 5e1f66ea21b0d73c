//! The memory the process has in use while steps run, looked at every now and then.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// How often it is looked at, at most.
const EVERY: Duration = Duration::from_millis(40);

/// The greatest memory seen since each running instance began, bytes; shared with its worker, which puts it on record.
#[derive(Default)]
pub struct Resident {
    peaks: HashMap<usize, Arc<AtomicU64>>,
    looked: Option<Instant>,
}

impl Resident {
    /// An instance begins.
    pub fn begin(&mut self, instance: usize) -> Arc<AtomicU64> {
        let peak = Arc::new(AtomicU64::new(0));
        self.peaks.insert(instance, peak.clone());
        peak
    }

    /// An instance has ended.
    pub fn end(&mut self, instance: usize) {
        self.peaks.remove(&instance);
    }

    /// Looks at the memory, unless that was done a moment ago.
    pub fn look(&mut self) {
        if self.peaks.is_empty() || self.looked.is_some_and(|at| at.elapsed() < EVERY) {
            return;
        }
        self.looked = Some(Instant::now());
        let Some(bytes) = resident_bytes() else { return };
        for peak in self.peaks.values() {
            peak.fetch_max(bytes, Ordering::Relaxed);
        }
    }
}

/// The resident memory of this process; `None` where the system does not tell it.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_in_use_is_seen_by_whoever_runs() {
        let mut resident = Resident::default();
        let peak = resident.begin(7);
        resident.look();
        let seen = peak.load(Ordering::Relaxed);
        // Where the system tells nothing, nothing is seen.
        assert!(seen > 1 << 20 || resident_bytes().is_none(), "{seen}");
        resident.end(7);
        resident.look();
        assert_eq!(Arc::strong_count(&peak), 1);
    }
}
