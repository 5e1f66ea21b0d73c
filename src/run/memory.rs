//! Values in memory: held for their consumers, freed when nobody needs them or when room runs short.

use std::sync::Arc;

use rockface_stages::artefact::Artefact;

use super::schedule::Scheduler;
use super::state::State;

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

    /// Frees memory when more is held than the run may: stored values first, then transient ones after writing them.
    pub fn relieve(&mut self) {
        for transient in [false, true] {
            for instance in 0..self.states.len() {
                if self.memory_bytes <= self.options.memory_bytes {
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
