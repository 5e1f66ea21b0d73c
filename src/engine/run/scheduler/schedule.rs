//! The scheduler: one thread owns every state, workers only compute, and a step whose output did not change stops the wave.

use std::collections::{BinaryHeap, HashMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Outcome, Store, StoreError};
use rockface_core::Look;
use rockface_core::artefact::Kind;

use super::exchange::Exchange;
use super::progress::Timing;
use super::rss::Resident;
use super::state::{State, States, Status, same_outputs};
use crate::pipeline::LogLevel;
use crate::plan::{Plan, makes};
use crate::run::worker::{self, Done, Failure, Feed, Task, Value, Workers};
use crate::run::{Options, RunError, Summary};
use crate::watch::{Event, Observer, Reason};

/// How long a stop may take before running stages are abandoned.
const GRACE: Duration = Duration::from_millis(700);

/// Runs a plan to its end, or to its stop. The plan grows as items of axes become known; in the end its instances are
/// in the order they would have had from the start.
///
/// A stage that does not notice the stop in time goes on in a thread of its own, which only the end of the process ends.
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

/// What the scheduler still has to do for an instance; done one after the other, so that no chain is too long.
pub enum Turn {
    /// All producers are done: find its recipe, and with it whether there is anything to do.
    Settle(usize),
    /// Put it in line for a worker.
    Prepare(usize),
    /// Its record is known.
    Finish(usize, Outcome),
}

/// Instances of one recipe: the first computes, the others wait for it.
pub struct Line {
    /// Who computes.
    pub leader: usize,
    /// Who waits.
    pub twins: Vec<usize>,
}

/// A run in progress.
pub struct Scheduler<'a> {
    pub(super) plan: &'a mut Plan,
    pub(super) store: &'a Store,
    pub(super) options: &'a Options,
    pub(super) observer: &'a mut dyn Observer,
    pub(super) states: States,
    pub(super) turns: VecDeque<Turn>,
    /// First what uses up values that are in memory only, then deeper steps, so that those values are used up before
    /// more are made.
    pub(super) ready: BinaryHeap<(bool, usize, std::cmp::Reverse<usize>)>,
    /// Instances whose inputs are on record and would have to be made again: another process may do without.
    pub(super) costly: VecDeque<usize>,
    /// The same by the keys of those inputs: what is made again is made for all of them.
    pub(super) wanting: HashMap<Digest, Vec<usize>>,
    /// Recorded instances whose values are needed and not at hand; the last one called for comes first.
    pub(super) remakes: VecDeque<usize>,
    /// What other processes do that this one would do too, and what is handed over between them.
    pub(super) exchange: Exchange,
    /// Instances were added to the plan.
    pub(super) grown: bool,
    pub(super) computing: HashMap<Digest, Line>,
    pub(super) timing: Timing,
    pub(super) memory_bytes: usize,
    pub(super) failure: bool,
    /// A step that was made again came out otherwise.
    pub(super) revised: bool,
    /// How much the log shows of each instance; found when it is first asked for.
    pub(super) log_levels: Option<Vec<LogLevel>>,
    /// What running instances are expected to need, bytes, by instance.
    pub(super) needs: HashMap<usize, u64>,
    /// What instances in line are expected to need, bytes, as far as that was asked for.
    pub(super) estimates: HashMap<usize, u64>,
    resident: Resident,
    /// Keys that were looked up and are not told of yet.
    pub(super) counted_on: Vec<Digest>,
    workers: Workers,
    pub(super) running: usize,
}

impl<'a> Scheduler<'a> {
    fn new(
        plan: &'a mut Plan,
        store: &'a Store,
        options: &'a Options,
        observer: &'a mut dyn Observer,
        workers: Workers,
    ) -> Self {
        Self {
            states: States::new(plan),
            timing: Timing::new(plan.graph.steps.len()),
            plan,
            store,
            options,
            observer,
            turns: VecDeque::new(),
            ready: BinaryHeap::new(),
            costly: VecDeque::new(),
            wanting: HashMap::new(),
            remakes: VecDeque::new(),
            exchange: Exchange::default(),
            grown: false,
            computing: HashMap::new(),
            memory_bytes: 0,
            failure: false,
            revised: false,
            log_levels: None,
            needs: HashMap::new(),
            estimates: HashMap::new(),
            resident: Resident::default(),
            counted_on: Vec::new(),
            workers,
            running: 0,
        }
    }

    fn run(mut self, results: &Receiver<worker::Result>, stop: &AtomicBool) -> Result<Summary, RunError> {
        let begun = Instant::now();
        self.store.count_on(&[])?;
        self.tell(&Event::Planned { steps: self.plan.instances.len() });
        let first = (0..self.states.len()).filter(|instance| self.states[*instance].unmet == 0);
        self.turns = first.map(Turn::Settle).collect();
        let outcome = self.work_off(results, stop);
        self.observer.end();
        let interrupted = stop.load(Ordering::Relaxed);
        if let Err(error) = outcome {
            return self.abandon(stop, results, error);
        }
        if interrupted {
            return self.abandon(stop, results, RunError::Interrupted);
        }
        self.store.sync()?;
        if self.grown
            && let Ok(former) = self.plan.order()
        {
            self.states.reorder(&former);
        }
        Ok(self.summary(begun.elapsed()))
    }

    fn work_off(&mut self, results: &Receiver<worker::Result>, stop: &AtomicBool) -> Result<(), RunError> {
        loop {
            self.take_turns()?;
            while self.running < self.options.jobs && !self.stopping(stop) {
                let Some(instance) = self.next()? else { break };
                if !self.has_room(instance, self.running) {
                    break;
                }
                self.begin(instance)?;
            }
            let is_over = self.running == 0 && (self.stopping(stop) || !self.waits_for_others());
            if is_over || stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let result = results.recv_timeout(self.patience());
            self.resident.look();
            match result {
                Ok((instance, result)) => self.end(instance, *result, stop)?,
                // Nothing came in time: there is a sender as long as there is a scheduler.
                Err(_) => self.exchange.grow_patient(),
            }
            self.look_around()?;
        }
    }

    fn end(&mut self, instance: usize, result: Result<Done, Failure>, stop: &AtomicBool) -> Result<(), RunError> {
        self.running -= 1;
        self.needs.remove(&instance);
        self.resident.end(instance);
        // What gives up because it was told to stop has not failed.
        let stopped = stop.load(Ordering::Relaxed) && matches!(result, Err(Failure::Stage(..)));
        if stopped { Ok(()) } else { self.take(instance, result) }
    }

    fn stopping(&self, stop: &AtomicBool) -> bool {
        stop.load(Ordering::Relaxed) || (self.failure && !self.options.keep_going)
    }

    /// The next instance a worker can have: one that is ready, or becomes so when its inputs are made again.
    fn next(&mut self) -> Result<Option<usize>, RunError> {
        loop {
            if let Some(instance) = self.next_ready()? {
                return Ok(Some(instance));
            }
            if let Some(instance) = self.remakes.pop_front() {
                self.take_up(instance)?;
            } else if let Some(instance) = self.costly.pop_front() {
                self.call_for_inputs(instance)?;
            } else {
                return Ok(None);
            }
            self.take_turns()?;
        }
    }

    fn next_ready(&mut self) -> Result<Option<usize>, RunError> {
        while let Some((_, _, std::cmp::Reverse(instance))) = self.ready.pop() {
            let state = &self.states[instance];
            if state.status() != Status::Due || state.missing > 0 {
                continue;
            }
            if !state.again {
                return Ok(Some(instance));
            }
            self.turns.push_back(Turn::Prepare(instance));
            self.take_turns()?;
        }
        Ok(None)
    }

    fn begin(&mut self, instance: usize) -> Result<(), RunError> {
        let levels = self.log_levels.get_or_insert_with(|| self.plan.log_levels());
        let sketch = (levels.get(instance) == Some(&LogLevel::Full)).then_some(self.options.look);
        let peak = self.resident.begin(instance);
        let mut task = self.task(instance, sketch, peak);
        task.lease = self.states[instance].lease.take();
        self.running += 1;
        self.states.set(instance, Status::Running);
        let reason = if task.remake || self.states[instance].recorded { Reason::Needed } else { Reason::New };
        self.tell(&Event::Started { step: self.plan.label(instance), reason });
        self.workers.start(task, self.running).inspect_err(|_| self.running -= 1)
    }

    /// Lets running stages notice the stop; those that do not in time are left behind.
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

    fn task(&self, instance: usize, sketch: Option<&'static dyn Look>, peak_bytes: Arc<AtomicU64>) -> Task {
        let own = &self.plan.instances[instance];
        let step = self.plan.step(instance);
        let state = &self.states[instance];
        let feeds = own.inputs.iter().flat_map(|(port, given)| {
            given.iter().map(move |given| Feed {
                port,
                point: given.point.clone(),
                from: (given.instance, given.port),
                value: self.value(given.instance, given.port),
            })
        });
        let outputs = step.ports.outputs.iter().filter(|port| makes(own, port)).map(|port| (port.name, port.kinds[0]));
        let recipe = self.known_recipe(instance);
        Task {
            instance,
            stage: step.stage,
            key: state.key.unwrap_or_else(|| recipe.key()),
            recipe,
            params: own.params.clone(),
            feeds: feeds.collect(),
            ports: step.ports.outputs,
            outputs: outputs.collect(),
            keep: self.must_keep(instance),
            remake: state.remaking,
            lease: None,
            timeout: step.timeout,
            retries: step.retries,
            sketch,
            peak_bytes,
        }
    }

    fn value(&self, producer: usize, port: &'static str) -> Value {
        let state = &self.states[producer];
        let recorded = state.outcome.as_ref().map(|outcome| &outcome.outputs[port]);
        if let Some(spilled) = state.spilled.get(port).filter(|_| !state.values.contains_key(port)) {
            return Value::Spilled(spilled.clone());
        }
        match (state.values.get(port), recorded) {
            (Some(value), _) => Value::Ready(value.clone()),
            (None, Some(recorded)) => Value::Stored(recorded.kind.parse().unwrap_or(Kind::Table), recorded.digest),
            (None, None) => Value::Stored(Kind::Table, Digest::of(b"")),
        }
    }

    fn take(&mut self, instance: usize, result: Result<Done, Failure>) -> Result<(), RunError> {
        match result {
            Ok(done) => self.complete(instance, done)?,
            Err(Failure::Store(error)) => return Err(RunError::Store(error)),
            Err(Failure::Held) => self.leave_elsewhere(instance),
            Err(Failure::Lost(producer, why)) => {
                self.warn(producer, format!("an output had to be made again: {why}"));
                let State { values, spilled, announced, .. } = &mut self.states[producer];
                spilled.clear();
                announced.retain(|port, _| values.contains_key(port));
                self.states.set(instance, Status::Due);
                self.turns.push_back(Turn::Prepare(instance));
            }
            Err(Failure::Stage(error, log)) => {
                let stage = self.plan.step(instance).stage.name().to_owned();
                let step = self.plan.label(instance);
                let help = error.hint.as_ref().map(|hint| format!("\nhelp: {hint}")).unwrap_or_default();
                let message = format!("{}{help}", error.message);
                self.states[instance].failure = Some(Box::new(crate::run::StepFailure { message, log }));
                self.tell(&Event::Failed { step, stage, message: error.message, hint: error.hint });
                self.fail(instance);
            }
        }
        Ok(())
    }

    fn complete(&mut self, instance: usize, done: Done) -> Result<(), RunError> {
        for text in &done.warnings {
            self.warn(instance, text.clone());
        }
        for ((producer, port), value) in done.loaded {
            if self.states[producer].users > 1 {
                self.hold(producer, port, value);
            }
        }
        for (port, value) in done.values {
            self.hold(instance, port, value);
        }
        self.states[instance].announced.extend(done.announced);
        self.states.set(instance, Status::Done);
        self.states[instance].recipe = None;
        self.tell_end(instance, done.elsewhere, done.outcome.cost.wall_s);
        if self.states[instance].remaking {
            let former = self.states[instance].outcome.as_ref();
            let changed = former.is_some_and(|former| !same_outputs(former, &done.outcome));
            if changed {
                let text =
                    "it was made again from the same recipe and came out otherwise: the stage is not deterministic";
                self.warn(instance, text.to_owned());
            }
            self.hand_over_made(instance, &done.outcome);
            self.remade(instance, done.outcome, changed)?;
        } else {
            self.hand_over_made(instance, &done.outcome);
            self.turns.push_front(Turn::Finish(instance, done.outcome));
        }
        self.take_turns()?;
        self.relieve();
        Ok(())
    }

    fn tell_end(&mut self, instance: usize, elsewhere: bool, wall_s: f64) {
        if elsewhere {
            return self.tell_cached(instance);
        }
        self.states[instance].executed = true;
        let timed = &mut self.timing.timed[self.plan.instances[instance].step];
        *timed = (timed.0 + 1, timed.1 + wall_s);
        self.tell(&Event::Finished { step: self.plan.label(instance), wall_s });
    }

    fn summary(self, elapsed: Duration) -> Summary {
        self.workers.end();
        let instances = self.states.into_list().into_iter().map(|state| crate::run::InstanceResult {
            outcome: if state.status() == Status::Done { state.outcome } else { None },
            key: state.key,
            recipe: state.recipe.map(|recipe| *recipe),
            executed: state.executed,
            failure: state.failure.map(|failure| *failure),
        });
        Summary {
            instances: instances.collect(),
            wall_s: elapsed.as_secs_f64(),
            failed: self.failure,
            revised: self.revised,
        }
    }
}

impl From<StoreError> for RunError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}
