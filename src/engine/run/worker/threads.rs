//! The threads that stages compute on, and what is too short to be handed to them.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Stages that took less so far, on average, are not handed over: waking the threads would take as long.
const SHORT: Duration = Duration::from_millis(1);
/// How often a stage must have run before it counts as short.
const RUNS: u32 = 2;
/// Values of fewer bytes are worked on where they are.
const SMALL_BYTES: usize = 1 << 18;

/// A pool of threads that all workers share.
pub struct Threads {
    pool: ThreadPool,
    /// How often each stage has run, and how long it took in all.
    times: Mutex<HashMap<&'static str, (u32, Duration)>>,
}

impl Threads {
    /// So many threads.
    pub fn new(count: usize) -> Result<Self, ThreadPoolBuildError> {
        Ok(Self { pool: ThreadPoolBuilder::new().num_threads(count).build()?, times: Mutex::default() })
    }

    /// Makes the calling thread, a worker, do by itself what others are not woken for.
    pub fn adopt() -> Result<(), ThreadPoolBuildError> {
        // The pool of one lives as long as its thread.
        ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().map(drop)
    }

    /// Runs a stage on inputs of so many bytes, `None` where that is not known.
    pub fn run<T: Send>(&self, stage: &'static str, bytes: Option<usize>, work: impl FnOnce() -> T + Send) -> T {
        let is_short = bytes.is_some_and(|bytes| bytes < SMALL_BYTES) && self.is_short(stage);
        // Timed where it is done: waiting for a thread is no part of it.
        let timed = || {
            let start = Instant::now();
            (work(), start.elapsed())
        };
        let (made, took) = if is_short { timed() } else { self.pool.install(timed) };
        self.note(stage, took);
        made
    }

    fn note(&self, stage: &'static str, took: Duration) {
        let mut times = self.times.lock().unwrap_or_else(PoisonError::into_inner);
        let (count, total) = times.entry(stage).or_default();
        (*count, *total) = (*count + 1, *total + took);
    }

    /// Does something with values of so many bytes.
    pub fn compute<T: Send>(&self, bytes: usize, work: impl FnOnce() -> T + Send) -> T {
        if bytes < SMALL_BYTES { work() } else { self.pool.install(work) }
    }

    /// Whether a stage has been short so far.
    pub fn is_short(&self, stage: &'static str) -> bool {
        let times = self.times.lock().unwrap_or_else(PoisonError::into_inner);
        times.get(stage).is_some_and(|(count, total)| *count >= RUNS && *total < SHORT * *count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_short_and_is_small_stays_with_the_worker() {
        let threads = Threads::new(1).unwrap();
        let here = std::thread::current().id();
        let is_here = |stage, bytes| threads.run(stage, bytes, || std::thread::current().id() == here);
        let small = Some(1000);
        assert!(!is_here("new", small));
        for _ in 0..RUNS {
            threads.note("short", Duration::ZERO);
            threads.note("long", SHORT);
        }
        assert!(is_here("short", small) && !is_here("long", small));
        assert!(!is_here("short", Some(SMALL_BYTES)) && !is_here("short", None));
    }

    #[test]
    fn a_worker_that_stays_alone_wakes_no_other() {
        std::thread::spawn(|| {
            Threads::adopt().unwrap();
            let here = std::thread::current().id();
            let both = rayon::join(|| std::thread::current().id(), || std::thread::current().id());
            assert_eq!((both.0, both.1, rayon::current_num_threads()), (here, here, 1));
        })
        .join()
        .unwrap();
    }
}
