//! Values in memory: held for their consumers, freed when nobody needs them or when room runs short.

use std::sync::Arc;

use rockface_core::artefact::Artefact;
use rockface_core::{InputSize, InputSizes};

use super::schedule::Scheduler;
use super::spill::Spilled;
use super::state::State;
use crate::plan::Given;
use crate::watch::Event;

/// Inputs up to this size are read to estimate what a step needs.
const SMALL_BYTES: u64 = 1 << 20;

impl Scheduler<'_> {
    /// Keeps a value in memory.
    pub fn hold(&mut self, instance: usize, port: &'static str, value: Arc<Artefact>) {
        self.memory_bytes += value.memory_bytes();
        if let Some(former) = self.states[instance].values.insert(port, value) {
            self.memory_bytes -= former.memory_bytes().min(self.memory_bytes);
        }
    }

    /// Lets go of all values of an instance, wherever they are held.
    pub fn drop_values(&mut self, instance: usize) {
        self.forget(instance);
        self.discard_brought(instance);
        let state = &mut self.states[instance];
        state.spilled.clear();
        // Last: others may take what is not announced any more for used up.
        state.announced.clear();
    }

    /// Frees the memory of all values of an instance.
    fn forget(&mut self, instance: usize) {
        let values = std::mem::take(&mut self.states[instance].values);
        let freed: usize = values.values().map(|value| value.memory_bytes()).sum();
        self.memory_bytes -= freed.min(self.memory_bytes);
    }

    /// A consumer will not ask for the values any more.
    pub fn release(&mut self, producer: usize) {
        let state = &mut self.states[producer];
        state.users = state.users.saturating_sub(1);
        if state.users == 0 && state.wanted_by.is_empty() {
            self.drop_values(producer);
        }
    }

    /// Whether an instance may start beside those that run: what they and it are expected to need fits into the memory of
    /// the run. One that may not is put in line again; alone, every one may.
    pub fn has_room(&mut self, instance: usize, running: usize) -> bool {
        let need = self.need_bytes(instance);
        let taken = self.needs.values().copied().fold(0, u64::saturating_add);
        let left = (self.options.memory_bytes as u64).saturating_sub(taken.saturating_add(need));
        self.relieve_to(left as usize);
        let fits = self.memory_bytes as u64 <= left && taken.saturating_add(need) <= self.options.memory_bytes as u64;
        if fits || running == 0 {
            self.estimates.remove(&instance);
            self.needs.insert(instance, need);
            return true;
        }
        if !std::mem::replace(&mut self.states[instance].held, true) {
            self.tell(&Event::Held { step: self.plan.label(instance), need_bytes: need });
        }
        self.line_up(instance);
        false
    }

    /// What an instance is expected to need beside the inputs that are in memory; found when it is first asked for.
    fn need_bytes(&mut self, instance: usize) -> u64 {
        if let Some(known) = self.estimates.get(&instance) {
            return *known;
        }
        let need = self.estimate_bytes(instance).saturating_sub(self.held_bytes(instance));
        self.estimates.insert(instance, need);
        need
    }

    /// The inputs that are in memory already.
    fn held_bytes(&self, instance: usize) -> u64 {
        let given = self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let values = given.filter_map(|given| self.states[given.instance].values.get(given.port));
        values.map(|value| value.memory_bytes() as u64).sum()
    }

    fn estimate_bytes(&self, instance: usize) -> u64 {
        let own = &self.plan.instances[instance];
        let given = own.inputs.iter().flat_map(|(port, given)| given.iter().map(move |given| (*port, given)));
        let size = |(port, given): (&'static str, &Given)| {
            let outcome = self.states[given.instance].outcome.as_ref();
            let output = outcome.and_then(|outcome| outcome.outputs.get(given.port));
            let (stored_bytes, memory_bytes) = output.map_or((0, None), |output| (output.bytes, output.memory_bytes));
            InputSize { port, stored_bytes, memory_bytes }
        };
        let mut sizes: Vec<InputSize> = given.map(size).collect();
        sizes.extend(own.params.files.values().flatten().map(|file| InputSize {
            port: "",
            stored_bytes: std::fs::metadata(&file.path).map_or(0, |meta| meta.len()),
            memory_bytes: None,
        }));
        let small = |port: &str| self.small_input(instance, port);
        self.plan.step(instance).stage.memory_bytes(&own.params.canonical, &InputSizes::new(sizes, &small))
    }

    /// The only value at an input port, if it is in memory or small.
    fn small_input(&self, instance: usize, port: &str) -> Option<Arc<Artefact>> {
        let (_, given) = self.plan.instances[instance].inputs.iter().find(|(own, _)| *own == port)?;
        let [given] = given.as_slice() else { return None };
        let state = &self.states[given.instance];
        if let Some(value) = state.values.get(given.port) {
            return Some(value.clone());
        }
        let output = state.outcome.as_ref()?.outputs.get(given.port).filter(|output| output.bytes <= SMALL_BYTES)?;
        let bytes = self.store.get(&output.digest).ok()?;
        Artefact::decode(output.kind.parse().ok()?, &bytes).ok().map(Arc::new)
    }

    /// Frees memory when more is held than the run may.
    pub fn relieve(&mut self) {
        self.relieve_to(self.options.memory_bytes);
    }

    /// Frees memory until no more than this is held: of stored values first, then of transient ones after writing them.
    fn relieve_to(&mut self, memory_bytes: usize) {
        for transient in [false, true] {
            for instance in 0..self.states.len() {
                if self.memory_bytes <= memory_bytes {
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

    /// Writes the values of an instance to files that are gone when nobody needs them any more; not all may fit there.
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
        let outcome = state.outcome.as_ref();
        outcome.is_some_and(|outcome| outcome.outputs.values().all(|output| self.store.contains(&output.digest)))
    }
}
