//! Values in memory: held for their consumers, freed when nobody needs them or when room runs short.

use std::sync::Arc;

use rockface_stages::InputSizes;
use rockface_stages::artefact::Artefact;

use super::schedule::Scheduler;
use super::state::State;
use crate::plan::Given;
use crate::watch::Event;

impl Scheduler<'_> {
    /// Keeps a value in memory.
    pub fn hold(&mut self, instance: usize, port: &'static str, value: Arc<Artefact>) {
        self.memory_bytes += value.memory_bytes();
        if let Some(former) = self.states[instance].values.insert(port, value) {
            self.memory_bytes -= former.memory_bytes().min(self.memory_bytes);
        }
    }

    /// Lets go of all values of an instance.
    pub fn forget(&mut self, instance: usize) {
        let values = std::mem::take(&mut self.states[instance].values);
        let freed: usize = values.values().map(|value| value.memory_bytes()).sum();
        self.memory_bytes -= freed.min(self.memory_bytes);
    }

    /// A consumer will not ask for the values any more.
    pub fn release(&mut self, producer: usize) {
        let state = &mut self.states[producer];
        state.users = state.users.saturating_sub(1);
        if state.users == 0 && state.wanted_by.is_empty() {
            self.forget(producer);
        }
    }

    /// Whether an instance may start beside those that run: what they and it are expected to need fits into the memory of
    /// the run. One that may not is put in line again; alone, every one may.
    pub fn has_room(&mut self, instance: usize, running: usize) -> bool {
        let need = self.need_bytes(instance);
        let taken: u64 = self.needs.values().sum();
        let left = (self.options.memory_bytes as u64).saturating_sub(taken.saturating_add(need));
        self.relieve_to(left as usize);
        let fits = self.memory_bytes as u64 <= left && taken.saturating_add(need) <= self.options.memory_bytes as u64;
        if fits || running == 0 {
            self.needs.insert(instance, need);
            return true;
        }
        if !std::mem::replace(&mut self.states[instance].held, true) {
            self.tell(&Event::Held { step: self.plan.label(instance), need_bytes: need });
        }
        self.line_up(instance);
        false
    }

    /// What an instance is expected to need beside its inputs, going by the sizes of these.
    fn need_bytes(&self, instance: usize) -> u64 {
        let own = &self.plan.instances[instance];
        let given = own.inputs.iter().flat_map(|(port, given)| given.iter().map(move |given| (*port, given)));
        let size = |given: &Given| {
            let outcome = self.states[given.instance].outcome.as_ref();
            outcome.and_then(|outcome| outcome.outputs.get(given.port)).map_or(0, |output| output.bytes)
        };
        let mut sizes: Vec<(&'static str, u64)> = given.map(|(port, given)| (port, size(given))).collect();
        let files = own.params.files.values().flatten();
        sizes.extend(files.map(|file| ("", std::fs::metadata(&file.path).map_or(0, |meta| meta.len()))));
        self.plan.step(instance).stage.memory_bytes(&own.params.canonical, &InputSizes(sizes))
    }

    /// Frees memory when more is held than the run may.
    pub fn relieve(&mut self) {
        self.relieve_to(self.options.memory_bytes);
    }

    /// Lets go of values until no more than this is held: stored values first, then transient ones after writing them.
    fn relieve_to(&mut self, memory_bytes: usize) {
        for transient in [false, true] {
            for instance in 0..self.states.len() {
                if self.memory_bytes <= memory_bytes {
                    return;
                }
                let state = &self.states[instance];
                let spilled = transient && self.spill(state);
                if !state.values.is_empty() && (spilled || self.is_stored(state)) {
                    self.forget(instance);
                }
            }
        }
    }

    fn spill(&self, state: &State) -> bool {
        state.values.values().all(|value| value.encode().is_ok_and(|bytes| self.store.put(&bytes).is_ok()))
    }

    /// Whether all outputs of an instance can be read from the store.
    pub fn is_stored(&self, state: &State) -> bool {
        let outcome = state.outcome.as_ref();
        outcome.is_some_and(|outcome| outcome.outputs.values().all(|output| self.store.contains(&output.digest)))
    }
}
