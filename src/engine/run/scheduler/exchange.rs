//! Other processes on the same store: the scheduler waits for what they compute, and exchanges values that are not kept.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Want};
use rockface_core::artefact::Kind;

use super::others::PAUSES;
use super::phase::Due;
use super::schedule::{Scheduler, Turn};
use crate::run::RunError;
use crate::run::spill::Spilled;
use crate::watch::Event;

/// The time between two looks for requests of other processes while steps run here.
const POLL_EVERY: Duration = Duration::from_millis(50);
/// The same if the last look found other processes.
const POLL_EVERY_BESIDE_OTHERS: Duration = Duration::from_millis(10);
/// Where the values of an instance are.
pub enum Found {
    /// All that was wanted has arrived: this process holds it.
    Here,
    /// In another process, which was asked for them.
    Elsewhere,
    /// In no live process.
    Nowhere,
}

impl Scheduler<'_> {
    /// Whether an instance waits for another process.
    pub fn waits_for_others(&self) -> bool {
        self.exchange.waits()
    }

    /// How long to wait for a worker before polling other processes.
    pub fn poll_interval(&mut self) -> Duration {
        if self.running > 0 {
            return if self.exchange.are_others { POLL_EVERY_BESIDE_OTHERS } else { POLL_EVERY };
        }
        self.report_waiting();
        self.exchange.pause.max(PAUSES.0)
    }

    /// Another process has locked the key of an instance, which is looked at again once the lock is released.
    pub fn leave_elsewhere(&mut self, instance: usize) {
        self.states.give_back(instance);
        self.exchange.elsewhere.push(instance);
    }

    /// Only other processes can go on: reports what they are waited for, and requests values that are not kept from the
    /// processes that compute them.
    fn report_waiting(&mut self) {
        for instance in self.exchange.elsewhere.clone() {
            if !self.states[instance].is_due() || !self.exchange.reported.insert(instance) {
                continue;
            }
            self.report(&Event::Waiting { step: self.plan.label(instance) });
            let key = self.states[instance].key.filter(|_| !self.must_keep(instance));
            // A request that fails costs a recomputation at worst.
            if key.is_some_and(|key| self.exchange.room(self.store).is_ok_and(|room| room.want(&key).is_ok())) {
                self.exchange.requested.insert(instance);
            }
        }
    }

    /// Hands values to processes that want them, and looks whether what this process waits for has come.
    pub fn poll_others(&mut self) -> Result<(), RunError> {
        let every = if self.exchange.are_others { POLL_EVERY_BESIDE_OTHERS } else { POLL_EVERY };
        let idle = self.running == 0 && self.exchange.waits();
        if !idle && self.exchange.polled.is_some_and(|polled| polled.elapsed() < every) {
            return Ok(());
        }
        self.exchange.polled = Some(Instant::now());
        self.hand_over_wanted()?;
        if !self.exchange.waits() {
            return Ok(());
        }
        self.store.refresh()?;
        for instance in std::mem::take(&mut self.exchange.fetching) {
            self.fetch(instance)?;
        }
        for instance in std::mem::take(&mut self.exchange.elsewhere) {
            self.check_key(instance)?;
        }
        self.take_turns()
    }

    /// Looks whether the requested values of an instance have arrived.
    fn fetch(&mut self, instance: usize) -> Result<(), RunError> {
        if !self.states[instance].due().is_some_and(Due::is_recompute) {
            return Ok(());
        }
        if self.is_called_off(instance) {
            self.exchange.reset_pause();
            return Ok(());
        }
        match self.find_elsewhere(instance)? {
            Found::Elsewhere => self.exchange.fetching.push(instance),
            Found::Here => {
                self.exchange.reset_pause();
                self.accept_values(instance)?;
            }
            Found::Nowhere => {
                self.exchange.reset_pause();
                self.recomputes.push_front(instance);
            }
        }
        Ok(())
    }

    /// Looks whether another process has recorded the outcome of an instance, or has unlocked its key.
    fn check_key(&mut self, instance: usize) -> Result<(), RunError> {
        let state = &self.states[instance];
        let Some(key) = state.key.filter(|_| state.is_due()) else { return Ok(()) };
        if self.close_if_recorded(instance) {
            self.exchange.reset_pause();
        } else if !self.store.is_free(&key)? {
            self.exchange.elsewhere.push(instance);
        } else {
            self.exchange.reset_pause();
            self.turns.push_back(Turn::Prepare(instance));
        }
        Ok(())
    }

    /// Finds the wanted values of an instance: takes those that have arrived, and requests those that other processes have.
    pub fn find_elsewhere(&mut self, instance: usize) -> Result<Found, RunError> {
        let mut found = Found::Here;
        for (port, kind, digest) in self.wanted_outputs(instance) {
            if let Some(path) = self.exchange.room.as_ref().and_then(|room| room.take(&digest)) {
                let announced = Arc::new(self.store.announce(&digest)?);
                let state = &mut self.states[instance];
                state.spilled.extend(Spilled::brought(path, kind, digest).map(|file| (port, Arc::new(file))));
                state.announced.insert(port, announced);
            } else if self.store.is_at_hand_elsewhere(&digest)? {
                self.exchange.room(self.store)?.want(&digest)?;
                self.exchange.requested.insert(instance);
                found = Found::Elsewhere;
            } else {
                self.discard_brought(instance);
                return Ok(Found::Nowhere);
            }
        }
        Ok(found)
    }

    /// The outputs of an instance that others wait for and that are not here.
    fn wanted_outputs(&self, instance: usize) -> Vec<(&'static str, Kind, Digest)> {
        let Some(outcome) = self.states[instance].outcome() else { return Vec::new() };
        let mut wanted: Vec<(&'static str, Kind, Digest)> = Vec::new();
        for by in &self.states[instance].wanted_by {
            let given = self.plan.instances[*by].inputs.iter().flat_map(|(_, given)| given);
            for port in given.filter(|given| given.instance == instance).map(|given| given.port) {
                let output = &outcome.outputs[port];
                let is_here = self.states[instance].holds(port) || self.store.contains(&output.digest);
                if !is_here && wanted.iter().all(|(other, ..)| *other != port) {
                    wanted.extend(output.kind.parse().ok().map(|kind| (port, kind, output.digest)));
                }
            }
        }
        wanted
    }

    /// Hands over the values that other processes want and that are here.
    fn hand_over_wanted(&mut self) -> Result<(), RunError> {
        let (are_others, wanted) = self.store.wanted_elsewhere(self.exchange.room.as_ref())?;
        self.exchange.are_others = are_others;
        if wanted.is_empty() {
            return Ok(());
        }
        let mut here: HashMap<Digest, Vec<(usize, &'static str)>> = HashMap::new();
        for instance in 0..self.states.len() {
            let state = &self.states[instance];
            let Some((key, outcome)) = state.key.zip(state.outcome()) else { continue };
            for port in state.announced.keys() {
                here.insert(outcome.outputs[*port].digest, vec![(instance, *port)]);
                here.entry(key).or_default().push((instance, *port));
            }
        }
        for want in wanted {
            here.get(&want.name).into_iter().for_each(|values| self.hand_over(&want, values));
        }
        Ok(())
    }

    /// Hands over values just computed to processes that wait for them: they may be used up here in a moment.
    pub fn hand_over_new(&mut self, instance: usize) {
        if !self.exchange.are_others || self.states[instance].announced.is_empty() {
            return;
        }
        // If the requests cannot be read now, the other processes ask again.
        let wanted = self.store.wanted_elsewhere(self.exchange.room.as_ref()).unwrap_or_default().1;
        let values: Vec<_> = self.states[instance].announced.keys().map(|port| (instance, *port)).collect();
        let key = self.states[instance].key;
        for want in wanted.iter().filter(|want| Some(want.name) == key) {
            self.hand_over(want, &values);
        }
    }

    /// Brings values to the process that wants them. A value that cannot be brought is not announced any more, so that the
    /// other process computes it.
    fn hand_over(&mut self, want: &Want, values: &[(usize, &'static str)]) {
        for (instance, port) in values {
            if let Err(error) = self.bring(want, *instance, port)
                && !want.is_moot()
            {
                tracing::warn!("`{port}` of {} cannot be handed to another run: {error}", self.plan.label(*instance));
                self.states[*instance].announced.remove(port);
            }
        }
        want.answered();
    }

    fn bring(&self, want: &Want, instance: usize, port: &'static str) -> std::io::Result<()> {
        let gone = || std::io::Error::other("it is not here any more");
        let state = &self.states[instance];
        let digest = state.outcome().ok_or_else(gone)?.outputs[port].digest;
        let file = state.spilled.get(port).map(|file| file.path());
        want.bring(&digest, file, || {
            let encoded = match (state.values.get(port), file) {
                (Some(value), _) => value.encode().map_err(|error| std::io::Error::other(error.to_string()))?,
                (None, Some(file)) => std::fs::read(file)?,
                (None, None) => return Err(gone()),
            };
            let is_same = Digest::of(&encoded) == digest;
            is_same.then_some(encoded).ok_or_else(|| std::io::Error::other("its digest differs from the recorded one"))
        })
    }

    /// Withdraws the requests for the values of an instance, and removes files that have arrived and were not taken.
    pub fn discard_brought(&mut self, instance: usize) {
        if !self.exchange.requested.contains(&instance) {
            return;
        }
        let state = &self.states[instance];
        let Some(room) = &self.exchange.room else { return };
        state.key.iter().for_each(|key| room.unwant(key));
        for output in state.outcome().into_iter().flat_map(|outcome| outcome.outputs.values()) {
            room.unwant(&output.digest);
            if let Some(file) = room.take(&output.digest) {
                // A file that cannot be removed now goes with its folder.
                let _ = std::fs::remove_file(file);
            }
        }
    }
}
