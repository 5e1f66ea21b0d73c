//! Values in memory: held for their consumers, freed when no consumer is left or when memory runs short.

use std::sync::Arc;

use rockface_core::artefact::Artefact;
use rockface_core::{InputSize, InputSizes};

use super::schedule::Scheduler;
use super::state::State;
use crate::plan::Given;
use crate::run::spill::Spilled;
use crate::watch::Event;

/// Inputs up to this size are read to estimate what a step needs.
const SMALL_BYTES: u64 = 1 << 20;

/// An input that a stage is handed to change it in place.
pub struct Moved {
    /// The input port.
    pub port: &'static str,
    /// The instance that made it.
    pub producer: usize,
    /// The output port it came from.
    pub output: &'static str,
}

impl Scheduler<'_> {
    /// Keeps a value in memory.
    pub fn hold(&mut self, instance: usize, port: &'static str, value: Arc<Artefact>) {
        self.budget.hold(value.memory_bytes());
        if let Some(former) = self.states[instance].values.insert(port, value) {
            self.budget.release(former.memory_bytes());
        }
    }

    /// Drops all values of an instance, in memory and on disk.
    pub fn drop_values(&mut self, instance: usize) {
        self.forget(instance);
        self.discard_brought(instance);
        let state = &mut self.states[instance];
        state.spilled.clear();
        // Last: another process takes a value that is not announced any more for gone.
        state.announced.clear();
    }

    /// Frees the memory of all values of an instance.
    fn forget(&mut self, instance: usize) {
        let values = std::mem::take(&mut self.states[instance].values);
        let freed: usize = values.values().map(|value| value.memory_bytes()).sum();
        self.budget.release(freed);
    }

    /// A consumer of `producer` will not ask for its values any more.
    pub fn release(&mut self, producer: usize) {
        let state = &mut self.states[producer];
        state.users = state.users.saturating_sub(1);
        if state.users == 0 && state.wanted_by.is_empty() {
            self.drop_values(producer);
        }
    }

    /// Claims the memory that an instance is expected to need, if it fits beside the instances that run; otherwise queues the
    /// instance again. Returns whether it may start.
    pub fn claim_memory(&mut self, instance: usize) -> bool {
        let need = self.need_bytes(instance);
        self.relieve_to(self.budget.left_beside(need));
        if self.budget.admits(need) {
            self.budget.start(instance, need);
            return true;
        }
        if self.budget.is_first_wait(instance) {
            self.report(&Event::Held { step: self.plan.label(instance), need_bytes: need });
        }
        self.queue(instance);
        false
    }

    /// What an instance is expected to need beside the inputs that are in memory.
    fn need_bytes(&mut self, instance: usize) -> u64 {
        if let Some(known) = self.budget.estimate(instance) {
            return known;
        }
        let moved = self.moved_inputs(instance);
        let need = self.estimate_bytes(instance, &moved).saturating_sub(self.held_bytes(instance, &moved));
        self.budget.set_estimate(instance, need);
        need
    }

    /// The inputs of an instance that its stage changes in place and that nothing else will ask for: they are handed over, and count among
    /// what it needs. What may run more than once, or is handed to other processes, keeps its inputs.
    pub fn moved_inputs(&self, instance: usize) -> Vec<Moved> {
        let step = self.plan.step(instance);
        let runs_once = !self.options.check_determinism && step.retries == 0;
        if !runs_once || self.exchange.are_others || step.ports.inputs.iter().all(|input| !input.changed) {
            return Vec::new();
        }
        let inputs = &self.plan.instances[instance].inputs;
        let is_once = |from: (usize, &str)| {
            let given = inputs.iter().flat_map(|(_, given)| given);
            given.filter(|given| (given.instance, given.port) == from).count() == 1
        };
        let is_changed = |port: &str| step.ports.inputs.iter().any(|input| input.name == port && input.changed);
        let changed = inputs.iter().filter(|(port, _)| is_changed(port));
        let given =
            changed.flat_map(|(port, given)| given.iter().map(move |given| (*port, given.instance, given.port)));
        given
            .map(|(port, producer, output)| Moved { port, producer, output })
            .filter(|moved| {
                let state = &self.states[moved.producer];
                let is_last = state.users == 1 && state.wanted_by.is_empty();
                is_last && state.values.contains_key(moved.output) && is_once((moved.producer, moved.output))
            })
            .collect()
    }

    /// What these inputs take, bytes.
    pub fn moved_bytes(&self, instance: usize) -> u64 {
        let moved = self.moved_inputs(instance);
        let values = moved.iter().filter_map(|moved| self.states[moved.producer].values.get(moved.output));
        values.map(|value| value.memory_bytes() as u64).sum()
    }

    /// Takes what an instance may change in place: the value is held here no more.
    pub fn take_last(&mut self, moved: &Moved) -> Option<Arc<Artefact>> {
        let state = &mut self.states[moved.producer];
        let value = state.values.remove(moved.output)?;
        // Other processes compute what is not announced.
        state.announced.remove(moved.output);
        self.budget.release(value.memory_bytes());
        Some(value)
    }

    /// What the inputs take that are in memory already and stay there.
    fn held_bytes(&self, instance: usize, moved: &[Moved]) -> u64 {
        let given = self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let stays =
            |given: &&Given| moved.iter().all(|moved| (moved.producer, moved.output) != (given.instance, given.port));
        let values = given.filter(stays).filter_map(|given| self.states[given.instance].values.get(given.port));
        values.map(|value| value.memory_bytes() as u64).sum()
    }

    fn estimate_bytes(&self, instance: usize, moved: &[Moved]) -> u64 {
        let planned = &self.plan.instances[instance];
        let given = planned.inputs.iter().flat_map(|(port, given)| given.iter().map(move |given| (*port, given)));
        let size = |(port, given): (&'static str, &Given)| {
            let outcome = self.states[given.instance].outcome();
            let output = outcome.and_then(|outcome| outcome.outputs.get(given.port));
            let (stored_bytes, memory_bytes) = output.map_or((0, None), |output| (output.bytes, output.memory_bytes));
            InputSize { port, stored_bytes, memory_bytes }
        };
        let mut sizes: Vec<InputSize> = given.map(size).collect();
        sizes.extend(planned.params.files.values().flatten().map(|file| InputSize {
            port: "",
            stored_bytes: std::fs::metadata(&file.path).map_or(0, |meta| meta.len()),
            memory_bytes: None,
        }));
        let small = |port: &str| self.small_input(instance, port);
        let sizes = InputSizes::new(sizes, &small).kept(self.must_keep(instance)).on_threads(self.options.jobs);
        let sizes = sizes.moved(moved.iter().map(|moved| moved.port).collect());
        self.plan.step(instance).stage.memory_bytes(&planned.params.canonical, &sizes)
    }

    /// The only value at an input port, if it is in memory or small.
    fn small_input(&self, instance: usize, port: &str) -> Option<Arc<Artefact>> {
        let (_, given) = self.plan.instances[instance].inputs.iter().find(|(name, _)| *name == port)?;
        let [given] = given.as_slice() else { return None };
        let state = &self.states[given.instance];
        if let Some(value) = state.values.get(given.port) {
            return Some(value.clone());
        }
        let output = state.outcome()?.outputs.get(given.port).filter(|output| output.bytes <= SMALL_BYTES)?;
        let bytes = self.store.get(&output.digest).ok()?;
        Artefact::decode(output.kind.parse().ok()?, &bytes).ok().map(Arc::new)
    }

    /// Frees memory if the values take more than the run may use.
    pub fn relieve(&mut self) {
        self.relieve_to(self.budget.limit());
    }

    /// Frees memory until values take no more than `bytes`: first values that the store has, then others, which are spilled.
    fn relieve_to(&mut self, bytes: u64) {
        for transient in [false, true] {
            for instance in 0..self.states.len() {
                if !self.budget.holds_more_than(bytes) {
                    return;
                }
                if self.states[instance].values.is_empty() {
                    continue;
                }
                if self.is_stored(&self.states[instance]) || (transient && self.spill(instance)) {
                    self.forget(instance);
                }
            }
        }
    }

    /// Spills the values of an instance to files, which are removed with the last consumer. False if the disk refuses.
    fn spill(&mut self, instance: usize) -> bool {
        let Ok(room) = self.exchange.room(self.store) else { return false };
        let State { values, spilled, .. } = &mut self.states[instance];
        for (port, value) in values.iter() {
            if !spilled.contains_key(port) {
                let Some(written) = Spilled::write(value, room.path()) else { return false };
                spilled.insert(*port, Arc::new(written));
            }
        }
        true
    }

    /// Whether all outputs of an instance can be read from the store.
    pub fn is_stored(&self, state: &State) -> bool {
        state
            .outcome()
            .is_some_and(|outcome| outcome.outputs.values().all(|output| self.store.contains(&output.digest)))
    }
}
