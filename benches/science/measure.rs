//! Seconds of wall and of processor time, and the greatest memory of a process.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

use crate::resident;

/// Runs of a work, of which the median is taken.
const REPEATS: usize = 3;
/// A work whose first run takes as long runs once, seconds.
const LONG_S: f64 = 10.0;

/// What a work cost.
#[derive(Debug, Clone, Copy)]
pub struct Cost {
    /// From start to end, seconds.
    pub wall_s: f64,
    /// Processor time of all threads, seconds.
    pub cpu_s: f64,
    /// Greatest memory of the process meanwhile, with the input of the work, MB; 0 where it is not known.
    pub memory_mb: f64,
}

/// Threads that a work may use; its peer gets as many.
pub fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The last result of a work and what a run of it cost: the median of three, or one run of ten seconds.
pub fn measure<T>(mut work: impl FnMut() -> T) -> (T, Cost) {
    let mut last = None;
    let cost = median(|| {
        // The result of the run before is no memory of this one.
        last = None;
        // Without it the peak is that of the process.
        let _ = resident::forget_peak();
        let (wall, cpu) = (Instant::now(), cpu_s());
        last = Some(work());
        Cost { wall_s: wall.elapsed().as_secs_f64(), cpu_s: cpu_s() - cpu, memory_mb: peak_mb() }
    });
    (last.expect("a work runs at least once"), cost)
}

/// The median of three runs, or one run of ten seconds; the greatest memory of all.
pub fn median(mut run: impl FnMut() -> Cost) -> Cost {
    let mut costs = Vec::new();
    while costs.len() < REPEATS && costs.first().is_none_or(|first: &Cost| first.wall_s < LONG_S) {
        costs.push(run());
    }
    let middle = |get: fn(&Cost) -> f64| {
        let mut values: Vec<f64> = costs.iter().map(get).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let memory_mb = costs.iter().fold(0.0, |most: f64, cost| most.max(cost.memory_mb));
    Cost { wall_s: middle(|cost| cost.wall_s), cpu_s: middle(|cost| cost.cpu_s), memory_mb }
}

fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// MB; 0 where it is not known.
fn peak_mb() -> f64 {
    resident::bytes("VmHWM").map_or(0.0, |bytes| bytes as f64 / 1e6)
}
