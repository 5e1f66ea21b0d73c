//! Whether other programs kept the processors busy while a work was measured.

use std::time::{Duration, Instant};

use crate::measure::threads;

/// Share of the processors that other programs may take without a word.
pub const QUIET: f64 = 0.05;

/// When a work began, and how busy the processors had been until then, seconds, without programs of low priority.
pub struct Busy {
    begun: Instant,
    cpu_s: Option<f64>,
}

impl Busy {
    /// From now on.
    pub fn now() -> Self {
        let ticks = rustix::param::clock_ticks_per_second() as f64;
        let text = std::fs::read_to_string("/proc/stat").unwrap_or_default();
        let numbers: Vec<f64> =
            text.lines().next().unwrap_or_default().split(' ').filter_map(|n| n.parse().ok()).collect();
        // user, nice, system
        let cpu_s = numbers.get(..3).map(|numbers| (numbers[0] + numbers[2]) / ticks);
        Self { begun: Instant::now(), cpu_s }
    }

    /// The share of the processors that other programs took since, `ours` being what the work took.
    pub fn others(&self, ours: Duration) -> f64 {
        let (Some(before), Some(after)) = (self.cpu_s, Self::now().cpu_s) else { return 0.0 };
        let all_s = self.begun.elapsed().as_secs_f64() * threads() as f64;
        (after - before - ours.as_secs_f64()) / all_s
    }

    /// Says so where that is much.
    pub fn warn(&self, name: &str, ours: Duration) {
        let others = self.others(ours);
        if others > QUIET {
            eprintln!("{name}: other programs took {:.0} % of the processors", 100.0 * others);
        }
    }
}
