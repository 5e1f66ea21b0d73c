//! The main loop of the scheduler. One thread owns every state; workers only compute.

use std::collections::{BinaryHeap, HashMap, HashSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Store, StoreError};

use super::budget::MemoryBudget;
use super::others::Exchange;
use super::rss::Resident;
use super::state::States;
use super::timing::Timing;
use crate::pipeline::LogLevel;
use crate::plan::{ListPoint, Plan};
use crate::run::worker::{self, Done, Failure, Workers};
use crate::run::{InstanceResult, Options, RunError, Summary};
use crate::watch::{Event, Observer};

/// Tasks for each worker that may wait for it, where all are short: it then goes from one to the next without a pause.
const AHEAD: usize = 4;
/// How long running stages may take to notice a stop before they are abandoned.
const GRACE: Duration = Duration::from_millis(700);

/// Runs a plan until it is done or stopped. The plan grows as items of axes become known; at the end its instances are
/// in the order they would have if all items had been known from the start.
///
/// A stage that does not notice a stop in time continues in its thread until the process ends. What was done is durable within a
/// second; whoever tells others of it syncs the store first.
pub fn run(
    plan: &mut Plan,
    store: &Arc<Store>,
    options: &Options,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
) -> Result<Summary, RunError> {
    let (workers, results) = Workers::new(store, options, stop)?;
    Scheduler::new(plan, store, options, observer, workers).run(&results, stop)
}

/// What the scheduler still has to do for an instance. A queue of turns replaces recursion, which long chains would overflow.
pub enum Turn {
    /// All producers are done: determine the recipe, and whether the instance has to run.
    Settle(usize),
    /// Queue the instance for a worker.
    Prepare(usize),
    /// The outcome is known: notify the consumers.
    Finish(usize),
}

/// Instances with the same recipe: the first is computed, the others wait for it.
pub struct Line {
    /// The instance that is computed.
    pub leader: usize,
    /// The instances that wait for it.
    pub twins: Vec<usize>,
}

/// The place of a ready instance in the queue: the greatest is run first.
///
/// Instances that lead to lists of pairs come first, since values that are made before would be released without what the lists bring.
/// Then come those that use up values held in memory, then those that many consumers of such values wait for, then deeper steps, so that values
/// are used up before more are made.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Priority {
    /// Whether others wait to be expanded by what it makes, or by what follows from that.
    pub tells: bool,
    /// Whether it uses values that are held in memory only.
    pub drains: bool,
    /// Whether many consumers of values that will be held in memory wait for it, or for what follows from it.
    pub awaited: bool,
    /// Its step; later steps are deeper in the graph.
    pub depth: usize,
    /// How many producers that consumer of it lacks which lacks the fewest: what a consumer needs is made together.
    pub lacking: std::cmp::Reverse<usize>,
    /// Its place among those of its step, counted from where this process begins; the first comes first.
    pub place: std::cmp::Reverse<usize>,
    /// The instance.
    pub instance: usize,
}

/// A run in progress.
pub struct Scheduler<'a> {
    pub(super) plan: &'a mut Plan,
    pub(super) store: &'a Store,
    pub(super) options: &'a Options,
    pub(super) observer: &'a mut dyn Observer,
    pub(super) states: States,
    pub(super) turns: VecDeque<Turn>,
    /// Instances that a worker may take now.
    pub(super) ready: BinaryHeap<Priority>,
    /// Instances whose inputs would have to be recomputed. They come last: another process may make that unnecessary.
    pub(super) costly: VecDeque<usize>,
    /// The first and the last instance of each step.
    pub(super) spans: Vec<(usize, usize)>,
    /// Instances that lack only inputs that many others need too. They come first.
    pub(super) shared: VecDeque<usize>,
    /// Costly instances by the keys of those inputs: a recomputed input serves all of them.
    pub(super) wanting: HashMap<Digest, Vec<usize>>,
    /// Instances whose values have to be recomputed; the one requested last comes first.
    pub(super) recomputes: VecDeque<usize>,
    /// What other processes compute meanwhile, and the values exchanged with them.
    pub(super) exchange: Exchange,
    /// By step: whether it makes pairs that tell what is gathered, or leads to that; empty where there are none.
    pub(super) tells: Vec<bool>,
    /// By step: whether many consumers of values that are not kept wait for it, or for what follows from it; empty where all are kept.
    pub(super) awaited: Vec<bool>,
    /// Whether instances were added to the plan.
    pub(super) grown: bool,
    /// Lists of pairs that were read, each with the instance that made it, and that nothing was expanded by yet.
    pub(super) told: Vec<(usize, ListPoint)>,
    /// Instances being computed or queued, by the key of their recipe.
    pub(super) computing: HashMap<Digest, Line>,
    /// When the run began.
    pub(super) begun: Instant,
    pub(super) timing: Timing,
    pub(super) budget: MemoryBudget,
    /// Whether a step failed.
    pub(super) failed: bool,
    /// Whether a recomputed step gave a different output.
    pub(super) revised: bool,
    /// How much the log shows of each instance; `None` until it is first asked for, and when the plan has grown.
    pub(super) log_levels: Option<Vec<LogLevel>>,
    pub(super) resident: Resident,
    /// Keys that were looked up and have yet to be listed in the lease of this process.
    pub(super) referenced: Vec<Digest>,
    pub(super) workers: Workers,
    /// Instances handed to workers and not done.
    pub(super) running: usize,
    /// Those of them whose stages take long, or may.
    pub(super) long: HashSet<usize>,
}

impl<'a> Scheduler<'a> {
    fn new(
        plan: &'a mut Plan,
        store: &'a Store,
        options: &'a Options,
        observer: &'a mut dyn Observer,
        workers: Workers,
    ) -> Self {
        let (tells, awaited) = (plan.graph.leads_to_pairs(), plan.graph.awaited());
        Self {
            states: States::new(plan),
            begun: Instant::now(),
            timing: Timing::new(&plan.graph.steps),
            spans: spans(plan),
            plan,
            store,
            options,
            observer,
            turns: VecDeque::new(),
            ready: BinaryHeap::new(),
            costly: VecDeque::new(),
            shared: VecDeque::new(),
            wanting: HashMap::new(),
            recomputes: VecDeque::new(),
            exchange: Exchange::default(),
            grown: false,
            told: Vec::new(),
            tells,
            awaited,
            computing: HashMap::new(),
            budget: MemoryBudget::new(options.memory_bytes),
            failed: false,
            revised: false,
            log_levels: None,
            resident: Resident::default(),
            referenced: Vec::new(),
            workers,
            running: 0,
            long: HashSet::new(),
        }
    }

    fn run(mut self, results: &Receiver<worker::Result>, stop: &AtomicBool) -> Result<Summary, RunError> {
        let begun = Instant::now();
        self.store.count_on(&[])?;
        self.report(&Event::Planned { steps: self.plan.instances.len() });
        let first = (0..self.states.len()).filter(|instance| self.states[*instance].is_unsettled());
        self.turns = first.map(Turn::Settle).collect();
        let outcome = self.main_loop(results, stop);
        self.observer.end();
        let interrupted = stop.load(Ordering::Relaxed);
        if let Err(error) = outcome {
            return self.abandon(stop, results, error);
        }
        if interrupted {
            return self.abandon(stop, results, RunError::Interrupted);
        }
        self.report_stuck();
        if self.grown
            && let Ok(former) = self.plan.order()
        {
            self.states.reorder(&former);
        }
        Ok(self.summary(begun.elapsed()))
    }

    fn main_loop(&mut self, results: &Receiver<worker::Result>, stop: &AtomicBool) -> Result<(), RunError> {
        loop {
            self.take_turns()?;
            if self.may_grow(stop) {
                self.grow_by_lists();
                continue;
            }
            while self.may_begin() && !self.stopping(stop) {
                let Some(instance) = self.next()? else { break };
                if !self.claim_memory(instance) {
                    break;
                }
                self.begin(instance)?;
            }
            if self.may_grow(stop) {
                continue;
            }
            let is_over = self.running == 0 && (self.stopping(stop) || !self.waits_for_others());
            if is_over || stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let result = results.recv_timeout(self.poll_interval());
            self.resident.sample();
            if let Ok((instance, result)) = result {
                self.end(instance, *result, stop)?;
            } else {
                // A timeout: the scheduler has a sender, so the channel is never closed.
                self.exchange.lengthen_pause();
                self.report_idle();
            }
            self.poll_others()?;
        }
    }

    /// Whether lists of pairs were read that more can be expanded by. All lists at once that are about to be made: each expansion looks at
    /// the whole plan.
    fn may_grow(&self, stop: &AtomicBool) -> bool {
        let more = self.ready.peek().is_some_and(|next| next.tells);
        !self.told.is_empty() && !more && !self.stopping(stop)
    }

    /// Whether a worker is free, or soon will be.
    fn may_begin(&self) -> bool {
        let jobs = self.options.jobs;
        let next = || self.ready.peek().is_some_and(|next| self.is_short(next.instance));
        self.running < jobs || (self.long.is_empty() && self.running < jobs * AHEAD && next())
    }

    /// Whether an instance is of a stage that has been short in this run.
    pub fn is_short(&self, instance: usize) -> bool {
        self.workers.is_short(self.plan.step(instance).stage.name())
    }

    fn end(&mut self, instance: usize, result: Result<Done, Failure>, stop: &AtomicBool) -> Result<(), RunError> {
        self.running -= 1;
        self.long.remove(&instance);
        self.budget.end(instance);
        self.resident.end(instance);
        // A stage that ends because of the stop has not failed.
        let stopped = stop.load(Ordering::Relaxed) && matches!(result, Err(Failure::Stage(..)));
        if stopped { Ok(()) } else { self.take(instance, result) }
    }

    fn stopping(&self, stop: &AtomicBool) -> bool {
        stop.load(Ordering::Relaxed) || (self.failed && !self.options.keep_going)
    }

    /// The next instance for a worker: one that is ready, or becomes ready when its inputs are recomputed.
    fn next(&mut self) -> Result<Option<usize>, RunError> {
        loop {
            if let Some(instance) = self.shared.pop_front() {
                self.request_inputs(instance)?;
                self.take_turns()?;
                continue;
            }
            if let Some(instance) = self.next_ready()? {
                return Ok(Some(instance));
            }
            if let Some(instance) = self.recomputes.pop_front() {
                self.obtain_values(instance)?;
            } else if let Some(instance) = self.costly.pop_front() {
                self.request_inputs(instance)?;
            } else {
                return Ok(None);
            }
            self.take_turns()?;
        }
    }

    fn next_ready(&mut self) -> Result<Option<usize>, RunError> {
        while let Some(Priority { instance, .. }) = self.ready.pop() {
            let Some(due) = self.states[instance].due().filter(|due| due.missing == 0 && due.is_queued) else {
                continue;
            };
            let is_stale = due.is_stale;
            if let Some(due) = self.states[instance].due_mut() {
                due.is_queued = false;
            }
            if !is_stale {
                return Ok(Some(instance));
            }
            self.turns.push_back(Turn::Prepare(instance));
            self.take_turns()?;
        }
        Ok(None)
    }

    /// Gives running stages time to notice the stop; those that do not are left behind.
    fn abandon(
        mut self,
        stop: &AtomicBool,
        results: &Receiver<worker::Result>,
        error: RunError,
    ) -> Result<Summary, RunError> {
        stop.store(true, Ordering::Relaxed);
        let until = Instant::now() + GRACE;
        while self.running > 0 && Instant::now() < until {
            if results.recv_timeout(Duration::from_millis(20)).is_ok() {
                self.running -= 1;
            }
        }
        self.store.sync()?;
        if self.running == 0 {
            self.workers.end();
        }
        Err(error)
    }

    fn summary(self, elapsed: Duration) -> Summary {
        self.workers.end();
        let instances = self.states.into_list().into_iter().map(|mut state| {
            let (key, recipe, executed) = (state.key, state.recipe.take().map(|recipe| *recipe), state.executed);
            let (outcome, failure) = state.into_result();
            InstanceResult { key, recipe, executed, outcome, failure }
        });
        Summary {
            instances: instances.collect(),
            wall_s: elapsed.as_secs_f64(),
            failed: self.failed,
            revised: self.revised,
        }
    }
}

/// The first and the last instance of each step.
pub fn spans(plan: &Plan) -> Vec<(usize, usize)> {
    let mut spans = vec![(usize::MAX, 0); plan.graph.steps.len()];
    for (number, instance) in plan.instances.iter().enumerate() {
        let (first, last) = &mut spans[instance.step];
        (*first, *last) = ((*first).min(number), (*last).max(number));
    }
    spans
}

impl From<StoreError> for RunError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}
