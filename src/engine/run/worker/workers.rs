//! The threads that compute, and what becomes of them at the end of a run.

use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use rockface_cache::Store;

use super::failure::{Failure, guarded};
use super::standing::Standing;
use super::threads::Threads;
use super::work::{self, Done, Place, Task};
use crate::run::{Options, RunError};

/// What came of a task, by instance.
pub type Result = (usize, Box<std::result::Result<Done, Failure>>);

/// Threads that take tasks, begun as they are needed.
pub struct Workers {
    tasks: Sender<Task>,
    results: Sender<Result>,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    jobs: usize,
}

/// What all of them use. They own it, so that one that does not notice a stop can be left behind.
struct Shared {
    queue: Mutex<Receiver<Task>>,
    store: Arc<Store>,
    threads: Threads,
    stop: Arc<AtomicBool>,
    standing: Standing,
}

impl Workers {
    /// None yet, and where their results will come from.
    pub fn new(
        store: &Arc<Store>,
        options: &Options,
        stop: &Arc<AtomicBool>,
    ) -> std::result::Result<(Self, Receiver<Result>), RunError> {
        let pool = Threads::new(options.jobs).map_err(|error| RunError::Threads(error.to_string()))?;
        let (tasks, queue) = channel();
        let (results, receiver) = channel();
        let (queue, standing) = (Mutex::new(queue), Standing::default());
        let shared = Shared { queue, store: store.clone(), threads: pool, stop: stop.clone(), standing };
        Ok((Self { tasks, results, shared: Arc::new(shared), threads: Vec::new(), jobs: options.jobs }, receiver))
    }

    /// Whether a stage takes so little time that its tasks may be handed over before a worker is free.
    pub fn is_short(&self, stage: &'static str) -> bool {
        self.shared.threads.is_short(stage)
    }

    /// Hands a task to one of them; so many are handed over and not done, with this one.
    pub fn start(&mut self, task: Task, running: usize) -> std::result::Result<(), RunError> {
        if self.threads.len() < running.min(self.jobs) {
            let (shared, results) = (self.shared.clone(), self.results.clone());
            let spawned = std::thread::Builder::new().spawn(move || {
                // Without it the parallel parts of short stages would go to further threads, and do as well.
                let _ = Threads::adopt();
                shared.work_off(&results);
            });
            self.threads.push(spawned.map_err(|error| RunError::Threads(error.to_string()))?);
        }
        self.tasks.send(task).map_err(|_| RunError::Threads("all of them are gone".to_owned()))
    }

    /// Waits for all of them, none of which has anything to do any more.
    pub fn end(self) {
        let Self { tasks, threads, .. } = self;
        drop(tasks);
        for thread in threads {
            // A panic in one was the failure of its step.
            let _ = thread.join();
        }
    }
}

impl Shared {
    fn work_off(&self, results: &Sender<Result>) {
        while let Some(task) = self.next_task() {
            let instance = task.instance;
            let place =
                Place { store: &self.store, threads: &self.threads, stop: &self.stop, standing: &self.standing };
            let result = guarded(|| work::work(&task, place));
            // Its inputs are released before the scheduler hears of it, which then counts what is in memory.
            drop(task);
            // Nobody listens any more once the run was stopped.
            let _ = results.send((instance, Box::new(result)));
        }
    }

    /// Waits for work; `None` when there will be none.
    fn next_task(&self) -> Option<Task> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
    }
}
