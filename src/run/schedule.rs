//! The scheduler: one thread owns every state, workers only compute, and a step whose output did not change stops the wave.

use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Outcome, Recipe, Store, StoreError};
use rockface_stages::artefact::{Artefact, Kind};

use super::work::{self, Done, Failure, Feed, Task, Value};
use super::{Options, RunError, Summary};
use crate::plan::{Plan, makes};
use crate::watch::{Event, Observer, Progress, Reason};

/// How long a stop may take before running stages are abandoned.
const GRACE: Duration = Duration::from_millis(700);

/// How often the time left is estimated anew.
const ESTIMATE_EVERY: Duration = Duration::from_millis(100);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Status {
    /// Some producer is not done.
    Waiting,
    /// Waits for a producer's values to be made again, for a worker, or for its twin.
    Due,
    /// A worker has it.
    Running,
    /// Its record is known.
    Done,
    /// It failed, or something it needs did.
    Failed,
}

struct State {
    status: Status,
    /// Producers that are not done.
    unmet: usize,
    /// Producers whose values are being made again for this one.
    missing: usize,
    key: Option<Digest>,
    recipe: Option<Recipe>,
    outcome: Option<Outcome>,
    executed: bool,
    /// It is being made again for its values, though its record is known.
    remaking: bool,
    values: BTreeMap<&'static str, Arc<Artefact>>,
    /// Consumers that may still ask for the values.
    users: usize,
    /// Instances that wait for the values.
    wanted_by: Vec<usize>,
}

enum Message {
    Waiting(usize),
    Done(usize, Result<Done, Failure>),
}

/// Runs a plan to its end.
pub fn run(
    plan: &Plan,
    store: &Store,
    options: &Options,
    stop: &Arc<AtomicBool>,
    observer: &mut dyn Observer,
) -> Result<Summary, RunError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(options.jobs).build();
    let pool = pool.map_err(|error| RunError::Threads(error.to_string()))?;
    let (sender, receiver) = channel();
    std::thread::scope(|scope| {
        let start = |task: Task| {
            let sender: Sender<Message> = sender.clone();
            let pool = &pool;
            scope.spawn(move || {
                let instance = task.instance;
                let waiting = || drop(sender.send(Message::Waiting(instance)));
                let result = pool.install(|| work::work(&task, store, stop, waiting));
                // Nobody listens any more once the run was stopped.
                let _ = sender.send(Message::Done(instance, result));
            });
        };
        Scheduler::new(plan, store, options, observer).run(&start, &receiver, stop)
    })
}

struct Scheduler<'a> {
    plan: &'a Plan,
    store: &'a Store,
    options: &'a Options,
    observer: &'a mut dyn Observer,
    states: Vec<State>,
    /// Deeper steps first, so that transient values are used up before more are made.
    ready: BinaryHeap<(usize, std::cmp::Reverse<usize>)>,
    /// Who computes a key, and who waits for it because its recipe is the same.
    computing: HashMap<Digest, Vec<usize>>,
    running: usize,
    finished: usize,
    /// Count and seconds of executed instances by step.
    timed: Vec<(usize, f64)>,
    /// Instances that are not done, by step.
    open: Vec<usize>,
    /// The last estimate of the time left, and when it was made.
    estimate: (Option<f64>, Option<Instant>),
    failure: bool,
    memory_bytes: usize,
}

impl<'a> Scheduler<'a> {
    fn new(plan: &'a Plan, store: &'a Store, options: &'a Options, observer: &'a mut dyn Observer) -> Self {
        let mut states: Vec<State> = (plan.instances.iter())
            .map(|instance| State {
                status: Status::Waiting,
                unmet: 0,
                missing: 0,
                key: None,
                recipe: None,
                outcome: None,
                executed: false,
                remaking: false,
                values: BTreeMap::new(),
                users: instance.dependents.len(),
                wanted_by: Vec::new(),
            })
            .collect();
        for dependent in plan.instances.iter().flat_map(|instance| &instance.dependents) {
            states[*dependent].unmet += 1;
        }
        let steps = plan.graph.steps.len();
        let mut open = vec![0; steps];
        plan.instances.iter().for_each(|instance| open[instance.step] += 1);
        Self {
            plan,
            store,
            options,
            observer,
            states,
            ready: BinaryHeap::new(),
            computing: HashMap::new(),
            running: 0,
            finished: 0,
            timed: vec![(0, 0.0); steps],
            open,
            estimate: (None, None),
            failure: false,
            memory_bytes: 0,
        }
    }

    fn run(
        mut self,
        start: &dyn Fn(Task),
        receiver: &Receiver<Message>,
        stop: &AtomicBool,
    ) -> Result<Summary, RunError> {
        let begun = Instant::now();
        self.tell(&Event::Planned { steps: self.plan.instances.len() });
        // Instances are numbered producers first, so one pass settles all that is known already.
        for instance in 0..self.states.len() {
            if self.states[instance].unmet == 0 && self.states[instance].status == Status::Waiting {
                self.settle(instance);
            }
        }
        let outcome = self.work_off(start, receiver, stop);
        self.observer.end();
        let interrupted = stop.load(Ordering::Relaxed);
        if let Err(error) = outcome {
            return self.abandon(stop, receiver, error);
        }
        if interrupted {
            return self.abandon(stop, receiver, RunError::Interrupted);
        }
        self.store.sync()?;
        Ok(self.summary(begun.elapsed()))
    }

    fn work_off(
        &mut self,
        start: &dyn Fn(Task),
        receiver: &Receiver<Message>,
        stop: &AtomicBool,
    ) -> Result<(), RunError> {
        loop {
            while self.running < self.options.jobs && !self.stopping(stop) {
                let Some((_, std::cmp::Reverse(instance))) = self.ready.pop() else { break };
                let task = self.task(instance);
                self.running += 1;
                self.states[instance].status = Status::Running;
                let reason = if task.remake { Reason::Needed } else { Reason::New };
                self.tell(&Event::Started { step: self.plan.label(instance), reason });
                start(task);
            }
            if self.running == 0 || stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            match receiver.recv_timeout(Duration::from_millis(50)) {
                Ok(Message::Waiting(instance)) => self.tell(&Event::Waiting { step: self.plan.label(instance) }),
                Ok(Message::Done(instance, result)) => {
                    self.running -= 1;
                    self.take(instance, result)?;
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
            }
        }
    }

    fn stopping(&self, stop: &AtomicBool) -> bool {
        stop.load(Ordering::Relaxed) || (self.failure && !self.options.keep_going)
    }

    /// Lets running stages notice the stop; those that do not in time are left behind by ending the process.
    fn abandon(
        &mut self,
        stop: &AtomicBool,
        receiver: &Receiver<Message>,
        error: RunError,
    ) -> Result<Summary, RunError> {
        stop.store(true, Ordering::Relaxed);
        let until = Instant::now() + GRACE;
        while self.running > 0 && Instant::now() < until {
            if let Ok(Message::Done(..)) = receiver.recv_timeout(Duration::from_millis(20)) {
                self.running -= 1;
            }
        }
        self.store.sync()?;
        if self.running > 0 && self.options.exit_when_stuck {
            eprintln!("{error}");
            std::process::exit(error.exit_code());
        }
        Err(error)
    }

    /// All producers are done: the recipe is known, and with it whether there is anything to do.
    fn settle(&mut self, instance: usize) {
        let states = &self.states;
        let recipe = self.plan.recipe(instance, |producer, port| {
            states[producer].outcome.as_ref().map_or_else(|| Digest::of(b""), |outcome| outcome.outputs[port].digest)
        });
        let key = recipe.key();
        let state = &mut self.states[instance];
        (state.key, state.recipe, state.status) = (Some(key), Some(recipe), Status::Due);
        if let Some(outcome) = self.store.hit_outcome(&key) {
            self.tell_cached(instance);
            self.finish(instance, outcome);
        } else if let Some(twins) = self.computing.get_mut(&key) {
            twins.push(instance);
        } else {
            self.computing.insert(key, Vec::new());
            self.prepare(instance);
        }
    }

    fn tell_cached(&mut self, instance: usize) {
        self.finished += 1;
        self.tell(&Event::Cached { step: self.plan.label(instance) });
    }

    /// Puts an instance in line for a worker, after the producers whose values are neither in memory nor in the store.
    fn prepare(&mut self, instance: usize) {
        let plan = self.plan;
        let mut absent: Vec<usize> = Vec::new();
        for given in plan.instances[instance].inputs.iter().flat_map(|(_, given)| given) {
            let producer = &self.states[given.instance];
            let digest = producer.outcome.as_ref().map(|outcome| outcome.outputs[given.port].digest);
            let there = producer.values.contains_key(given.port) || digest.is_some_and(|d| self.store.contains(&d));
            if !there && !absent.contains(&given.instance) {
                absent.push(given.instance);
            }
        }
        self.states[instance].missing = absent.len();
        if absent.is_empty() {
            let depth = plan.instances[instance].step;
            self.ready.push((depth, std::cmp::Reverse(instance)));
        }
        for producer in absent {
            self.states[producer].wanted_by.push(instance);
            self.remake(producer);
        }
    }

    /// Runs a recorded instance again for its values.
    fn remake(&mut self, instance: usize) {
        if self.states[instance].remaking {
            return;
        }
        self.states[instance].remaking = true;
        self.finished -= 1;
        for producer in self.producers(instance) {
            self.states[producer].users += 1;
        }
        self.prepare(instance);
    }

    fn producers(&self, instance: usize) -> Vec<usize> {
        let given = self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let mut producers: Vec<usize> = given.map(|given| given.instance).collect();
        producers.sort_unstable();
        producers.dedup();
        producers
    }

    fn task(&self, instance: usize) -> Task {
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
        let outputs =
            step.stage.outputs().iter().filter(|port| makes(own, port)).map(|port| (port.name, port.kinds[0]));
        let (key, recipe) = (state.key, state.recipe.clone());
        let recipe = recipe.unwrap_or_else(|| self.plan.recipe(instance, |_, _| Digest::of(b"")));
        Task {
            instance,
            stage: step.stage,
            key: key.unwrap_or_else(|| recipe.key()),
            recipe,
            params: own.params.clone(),
            feeds: feeds.collect(),
            outputs: outputs.collect(),
            keep: step.keep,
            remake: state.remaking,
        }
    }

    fn value(&self, producer: usize, port: &'static str) -> Value {
        let state = &self.states[producer];
        let recorded = state.outcome.as_ref().map(|outcome| &outcome.outputs[port]);
        match (state.values.get(port), recorded) {
            (Some(value), _) => Value::Ready(value.clone()),
            (None, Some(recorded)) => Value::Stored(recorded.kind.parse().unwrap_or(Kind::Table), recorded.digest),
            (None, None) => Value::Stored(Kind::Table, Digest::of(b"")),
        }
    }

    fn take(&mut self, instance: usize, result: Result<Done, Failure>) -> Result<(), RunError> {
        match result {
            Ok(done) => self.complete(instance, done),
            Err(Failure::Store(error)) => return Err(RunError::Store(error)),
            Err(Failure::Lost(producer, why)) => {
                let text = format!("an output had to be made again: {why}");
                self.tell(&Event::Warning { step: self.plan.label(producer), text });
                self.states[instance].status = Status::Due;
                self.prepare(instance);
            }
            Err(Failure::Stage(error)) => {
                let stage = self.plan.step(instance).stage.name().to_owned();
                let step = self.plan.label(instance);
                self.tell(&Event::Failed { step, stage, message: error.message, hint: error.hint });
                self.fail(instance);
            }
        }
        Ok(())
    }

    fn complete(&mut self, instance: usize, done: Done) {
        let label = self.plan.label(instance);
        for text in &done.warnings {
            self.tell(&Event::Warning { step: label.clone(), text: text.clone() });
        }
        for ((producer, port), value) in done.loaded {
            if self.states[producer].users > 1 {
                self.hold(producer, port, value);
            }
        }
        let former = self.states[instance].outcome.take();
        let changed = former.is_some_and(|former| former.outputs != done.outcome.outputs);
        if changed && self.states[instance].remaking {
            let text = "it was made again from the same recipe and came out otherwise: the stage is not deterministic"
                .to_owned();
            self.tell(&Event::Warning { step: label.clone(), text });
        }
        for (port, value) in done.values {
            self.hold(instance, port, value);
        }
        let step = self.plan.instances[instance].step;
        self.finished += 1;
        if done.elsewhere {
            self.tell(&Event::Cached { step: label });
        } else {
            self.states[instance].executed = true;
            let wall_s = done.outcome.cost.wall_s;
            self.timed[step] = (self.timed[step].0 + 1, self.timed[step].1 + wall_s);
            self.tell(&Event::Finished { step: label, wall_s });
        }
        if self.states[instance].remaking {
            self.remade(instance, done.outcome, changed);
        } else {
            self.finish(instance, done.outcome);
        }
        self.relieve();
    }

    fn remade(&mut self, instance: usize, outcome: Outcome, changed: bool) {
        let state = &mut self.states[instance];
        (state.remaking, state.status, state.outcome) = (false, Status::Done, Some(outcome));
        for producer in self.producers(instance) {
            self.release(producer);
        }
        for consumer in std::mem::take(&mut self.states[instance].wanted_by) {
            let state = &mut self.states[consumer];
            state.missing -= 1;
            if changed && !state.remaking {
                // Its recipe names the former output: look again under the new one once all its producers are there.
                if let Some(twins) = state.key.and_then(|key| self.computing.remove(&key)) {
                    self.settle(consumer);
                    twins.into_iter().for_each(|twin| self.settle(twin));
                }
            } else if state.missing == 0 {
                self.prepare(consumer);
            }
        }
    }

    /// The record of an instance is known: tell its consumers, and free what only it needed.
    fn finish(&mut self, instance: usize, outcome: Outcome) {
        let state = &mut self.states[instance];
        (state.status, state.outcome) = (Status::Done, Some(outcome));
        self.open[self.plan.instances[instance].step] -= 1;
        let twins = state.key.and_then(|key| self.computing.remove(&key)).unwrap_or_default();
        for twin in twins {
            if let Some(outcome) = self.states[instance].outcome.clone() {
                // Equal recipes have equal outputs: the twin's consumers may take them from memory.
                let values = self.states[instance].values.clone();
                if self.states[twin].users > 0 {
                    values.into_iter().for_each(|(port, value)| self.hold(twin, port, value));
                }
                self.tell_cached(twin);
                self.finish(twin, outcome);
            }
        }
        for producer in self.producers(instance) {
            self.release(producer);
        }
        if self.states[instance].users == 0 {
            self.forget(instance);
        }
        for dependent in self.plan.instances[instance].dependents.clone() {
            let state = &mut self.states[dependent];
            state.unmet -= 1;
            if state.unmet == 0 && state.status == Status::Waiting {
                self.settle(dependent);
            }
        }
    }

    fn fail(&mut self, instance: usize) {
        self.failure = true;
        let mut failed = vec![instance];
        while let Some(instance) = failed.pop() {
            if self.states[instance].status == Status::Failed {
                continue;
            }
            self.states[instance].status = Status::Failed;
            self.finished += 1;
            failed.extend(&self.plan.instances[instance].dependents);
            failed.append(&mut self.states[instance].wanted_by);
            if let Some(twins) = self.states[instance].key.and_then(|key| self.computing.remove(&key)) {
                failed.extend(twins);
            }
        }
    }

    fn hold(&mut self, instance: usize, port: &'static str, value: Arc<Artefact>) {
        self.memory_bytes += value.memory_bytes();
        if let Some(former) = self.states[instance].values.insert(port, value) {
            self.memory_bytes -= former.memory_bytes().min(self.memory_bytes);
        }
    }

    fn forget(&mut self, instance: usize) {
        let values = std::mem::take(&mut self.states[instance].values);
        let freed: usize = values.values().map(|value| value.memory_bytes()).sum();
        self.memory_bytes -= freed.min(self.memory_bytes);
    }

    fn release(&mut self, producer: usize) {
        let state = &mut self.states[producer];
        state.users = state.users.saturating_sub(1);
        if state.users == 0 && state.wanted_by.is_empty() {
            self.forget(producer);
        }
    }

    /// Frees memory when more is held than the run may: stored values first, then transient ones after writing them.
    fn relieve(&mut self) {
        if self.memory_bytes <= self.options.memory_bytes {
            return;
        }
        let stored = |state: &State, store: &Store| {
            let outcome = state.outcome.as_ref();
            outcome.is_some_and(|outcome| outcome.outputs.values().all(|output| store.contains(&output.digest)))
        };
        for transient in [false, true] {
            for instance in 0..self.states.len() {
                if self.memory_bytes <= self.options.memory_bytes {
                    return;
                }
                let state = &self.states[instance];
                if state.values.is_empty() {
                    continue;
                }
                let spilled = transient
                    && state
                        .values
                        .values()
                        .all(|value| value.encode().is_ok_and(|bytes| self.store.put(&bytes).is_ok()));
                if spilled || stored(state, self.store) {
                    self.forget(instance);
                }
            }
        }
    }

    fn tell(&mut self, event: &Event) {
        if self.estimate.1.is_none_or(|made| made.elapsed() > ESTIMATE_EVERY) {
            self.estimate = (self.remaining_s(), Some(Instant::now()));
        }
        let progress = Progress { done: self.finished, total: self.states.len(), remaining_s: self.estimate.0 };
        self.observer.event(event, progress);
    }

    /// Time left if every instance that is not done runs as long as its step's executed ones did on average.
    fn remaining_s(&self) -> Option<f64> {
        let (count, seconds) = self.timed.iter().fold((0, 0.0), |sum, step| (sum.0 + step.0, sum.1 + step.1));
        let overall = (count > 0).then(|| seconds / count as f64)?;
        let each = |(count, seconds): (usize, f64)| if count > 0 { seconds / count as f64 } else { overall };
        let left: f64 = self.timed.iter().zip(&self.open).map(|(timed, open)| each(*timed) * *open as f64).sum();
        Some(left / self.options.jobs as f64)
    }

    fn summary(self, elapsed: Duration) -> Summary {
        let instances = self.states.into_iter().map(|state| super::InstanceResult {
            key: state.key,
            recipe: state.recipe,
            executed: state.executed,
            outcome: if state.status == Status::Done { state.outcome } else { None },
        });
        Summary { instances: instances.collect(), wall_s: elapsed.as_secs_f64(), failed: self.failure }
    }
}

impl From<StoreError> for RunError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}
