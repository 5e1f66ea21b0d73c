//! Dispatching: hands an instance to a worker, with its inputs, and takes back what came of it.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use rockface_cache::Digest;
use rockface_core::Look;
use rockface_core::artefact::Kind;

use super::schedule::{Priority, Scheduler, Turn};
use super::state::{State, same_outputs};
use crate::PHASE;
use crate::pipeline::LogLevel;
use crate::plan::makes;
use crate::run::worker::{Done, Failure, Feed, Source, Task, Value};
use crate::run::{RunError, StepFailure};
use crate::watch::{Event, Reason};

impl Scheduler<'_> {
    /// Hands an instance to a worker.
    pub fn begin(&mut self, instance: usize) -> Result<(), RunError> {
        let levels = self.log_levels.get_or_insert_with(|| self.plan.log_levels());
        let sketch = (levels.get(instance) == Some(&LogLevel::Full)).then_some(self.options.look);
        let peak = self.resident.begin(instance);
        let mut task = self.task(instance, sketch, peak);
        self.give_last(&mut task);
        self.take_ahead(&task.key);
        let reason = if self.states[instance].is_recorded() { Reason::Needed } else { Reason::New };
        task.lease = self.states.start(instance);
        self.running += 1;
        if !self.is_short(instance) {
            self.long.insert(instance);
        }
        self.report(&Event::Started { step: self.plan.label(instance), reason });
        self.workers.start(task, self.running).inspect_err(|_| self.running -= 1)
    }

    /// Takes the steps that will run next along with this one, where taking them one by one would take long.
    fn take_ahead(&mut self, key: &Digest) {
        /// So many are looked at for one that can be taken.
        const LOOKED_AT: usize = 8;
        let count = self.store.worth_ahead(key, self.ready.len());
        let next: Vec<Priority> = (0..count * LOOKED_AT).map_while(|_| self.ready.pop()).collect();
        if !next.is_empty() {
            let keys = next.iter().filter_map(|next| self.states[next.instance].key);
            self.store.take_ahead(keys.filter(|key| self.store.is_open(key)).take(count).collect());
            self.ready.extend(next);
        }
    }

    /// What a worker needs to run an instance.
    fn task(&self, instance: usize, sketch: Option<&'static dyn Look>, peak_bytes: Arc<AtomicU64>) -> Task {
        let planned = &self.plan.instances[instance];
        let step = self.plan.step(instance);
        let state = &self.states[instance];
        let feeds = planned.inputs.iter().flat_map(|(port, given)| {
            given.iter().map(move |given| Feed {
                port,
                point: given.point.clone(),
                from: (given.instance, given.port),
                blob: self.blob(given.instance, given.port),
                value: self.value(given.instance, given.port),
            })
        });
        let outputs = step.ports.outputs.iter().filter(|port| makes(planned, port));
        let outputs = outputs.map(|port| (port.name, port.kinds[0]));
        let recipe = self.known_recipe(instance);
        // What the span says is made only where a trace is written.
        let span = tracing::trace_span!(
            target: PHASE,
            "step",
            step = self.plan.label(instance),
            stage = step.stage.name(),
            need_bytes = self.budget.claim(instance).saturating_sub(self.moved_bytes(instance))
        );
        Task {
            span,
            instance,
            stage: step.stage,
            key: state.key.unwrap_or_else(|| recipe.key()),
            recipe,
            params: planned.params.clone(),
            feeds: feeds.collect(),
            ports: step.ports.outputs,
            outputs: outputs.collect(),
            keep: self.must_keep(instance),
            recompute: state.is_recompute(),
            lease: None,
            check: self.options.check_determinism,
            timeout: step.timeout,
            retries: step.retries,
            sketch,
            peak_bytes,
        }
    }

    /// Hands over to a task the values that its stage changes in place and that nothing else will ask for, so that it need not copy them.
    fn give_last(&mut self, task: &mut Task) {
        for moved in self.moved_inputs(task.instance) {
            let feeds = task.feeds.iter_mut();
            for feed in feeds.filter(|feed| feed.from == (moved.producer, moved.output)) {
                if let Some(value) = self.take_last(&moved) {
                    feed.value = Value::last(value);
                }
            }
        }
    }

    /// The digest of an output, and the bytes of its blob.
    fn blob(&self, producer: usize, port: &str) -> Option<(Digest, u64)> {
        self.states[producer].outcome().map(|outcome| (outcome.outputs[port].digest, outcome.outputs[port].bytes))
    }

    /// An output as a consumer gets it.
    fn value(&self, producer: usize, port: &'static str) -> Value {
        let state = &self.states[producer];
        let recorded = state.outcome().map(|outcome| &outcome.outputs[port]);
        if let Some(spilled) = state.spilled.get(port).filter(|_| !state.values.contains_key(port)) {
            return Value::Away(Source::Spilled(spilled.clone()));
        }
        match (state.values.get(port), recorded) {
            (Some(value), _) => Value::shared(value.clone()),
            (None, Some(recorded)) => {
                Value::Away(Source::Stored(recorded.kind.parse().unwrap_or(Kind::Table), recorded.digest))
            }
            (None, None) => Value::Away(Source::Stored(Kind::Table, Digest::of(b""))),
        }
    }

    /// Takes the result of a worker.
    pub fn take(&mut self, instance: usize, result: Result<Done, Failure>) -> Result<(), RunError> {
        match result {
            Ok(done) => self.complete(instance, done)?,
            Err(Failure::Store(error)) => return Err(RunError::Store(error)),
            Err(Failure::Held) => {
                self.report(&Event::Elsewhere { step: self.plan.label(instance) });
                self.leave_elsewhere(instance);
            }
            Err(Failure::Lost(producer, why)) => {
                self.warn(producer, format!("an output has to be recomputed: {why}"));
                let State { values, spilled, announced, .. } = &mut self.states[producer];
                spilled.clear();
                announced.retain(|port, _| values.contains_key(port));
                self.states.give_back(instance);
                self.turns.push_back(Turn::Prepare(instance));
            }
            Err(Failure::Stage(error, left)) => {
                let stage = self.plan.step(instance).stage.name().to_owned();
                let step = self.plan.label(instance);
                let help = error.hint.as_ref().map(|hint| format!("\nhelp: {hint}")).unwrap_or_default();
                let message = format!("{}{help}", error.message);
                let cause = Box::new(StepFailure { message, log: left.log, outputs: left.outputs });
                self.report(&Event::Failed { step, stage, message: error.message, hint: error.hint });
                self.fail(instance, Some(cause));
            }
        }
        Ok(())
    }

    /// A worker has computed the outputs of an instance, or found that another process did.
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
        let state = &mut self.states[instance];
        state.announced.extend(done.announced);
        state.recipe = None;
        let wall_s = done.outcome.cost.wall_s;
        let former = self.states.finish(instance, done.outcome);
        self.report_end(instance, done.elsewhere, wall_s);
        if let Some(former) = former {
            let changed = self.states[instance].outcome().is_some_and(|new| !same_outputs(&former, new));
            if changed {
                let text = "recomputing the same recipe gave a different output: the stage is not deterministic";
                self.warn(instance, text.to_owned());
            }
            self.hand_over_new(instance);
            self.recomputed(instance, changed)?;
        } else {
            self.hand_over_new(instance);
            self.turns.push_front(Turn::Finish(instance));
        }
        self.take_turns()?;
        self.relieve();
        Ok(())
    }

    fn report_end(&mut self, instance: usize, elsewhere: bool, wall_s: f64) {
        if elsewhere {
            self.report(&Event::Elsewhere { step: self.plan.label(instance) });
            return self.report_cached(instance);
        }
        self.states[instance].executed = true;
        self.timing.add(self.plan.instances[instance].step, wall_s);
        self.report(&Event::Finished { step: self.plan.label(instance), wall_s });
    }
}
