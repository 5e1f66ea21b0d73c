//! Other processes on the same store: what they do is waited for, and values that are not kept go from one to another.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Outcome, Room, Store, StoreError, Want};
use rockface_core::artefact::Kind;

use super::schedule::{Scheduler, Turn};
use super::spill::Spilled;
use super::state::Status;
use crate::run::RunError;
use crate::watch::Event;

/// How often it is looked at what others want while steps run here.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// The same when others were there the last time.
const LOOK_EVERY_BESIDE_OTHERS: Duration = Duration::from_millis(10);
/// The first and the longest pause while there is nothing to do but wait for others.
const PAUSES: (Duration, Duration) = (Duration::from_millis(1), Duration::from_millis(16));

/// Where the values of an instance are.
pub enum Found {
    /// In this process.
    Here,
    /// On the way, or in another process that was asked for them.
    Elsewhere,
    /// In no process that lives.
    Nowhere,
}

/// What goes on between this process and others.
#[derive(Default)]
pub struct Exchange {
    /// Instances whose keys other processes have.
    elsewhere: Vec<usize>,
    /// Instances whose values other processes were asked for.
    pub fetching: Vec<usize>,
    /// Where values come to, and where those go that memory has no room for, once there are any.
    room: Option<Room>,
    /// Others have rooms too.
    are_others: bool,
    looked: Option<Instant>,
    pause: Duration,
}

impl Exchange {
    /// The room of this process.
    pub fn room(&mut self, store: &Store) -> Result<&Room, StoreError> {
        match &mut self.room {
            Some(room) => Ok(room),
            none => Ok(none.insert(store.room()?)),
        }
    }

    /// Nothing happened: the next pause is longer.
    pub fn grow_patient(&mut self) {
        self.pause = (self.pause * 2).clamp(PAUSES.0, PAUSES.1);
    }

    fn waits(&self) -> bool {
        !self.elsewhere.is_empty() || !self.fetching.is_empty()
    }
}

impl Scheduler<'_> {
    /// Whether other processes have what is still to be done here, or what is needed for it.
    pub fn waits_for_others(&self) -> bool {
        self.exchange.waits()
    }

    /// How long to wait for a worker before looking around.
    pub fn patience(&mut self) -> Duration {
        if self.running > 0 {
            return if self.exchange.are_others { LOOK_EVERY_BESIDE_OTHERS } else { LOOK_EVERY };
        }
        self.tell_waiting();
        self.exchange.pause.max(PAUSES.0)
    }

    /// An instance has to be looked at again when another process has released its key.
    pub fn leave_elsewhere(&mut self, instance: usize) {
        self.states.set(instance, Status::Due);
        self.exchange.elsewhere.push(instance);
    }

    /// There is nothing to do but wait: tells for what, and asks whoever computes it for values that are not kept.
    fn tell_waiting(&mut self) {
        for instance in self.exchange.elsewhere.clone() {
            if !self.is_due(instance) || std::mem::replace(&mut self.states[instance].waited_for, true) {
                continue;
            }
            self.tell(&Event::Waiting { step: self.plan.label(instance) });
            let key = self.states[instance].key.filter(|_| !self.must_keep(instance));
            // Where it cannot be asked for, it is made here if need be.
            let asked = key.is_some_and(|key| self.exchange.room(self.store).is_ok_and(|room| room.want(&key).is_ok()));
            self.states[instance].asked |= asked;
        }
    }

    /// Gives others what they want, and looks whether what is waited for has come.
    pub fn look_around(&mut self) -> Result<(), RunError> {
        let every = if self.exchange.are_others { LOOK_EVERY_BESIDE_OTHERS } else { LOOK_EVERY };
        let idle = self.running == 0 && self.exchange.waits();
        if !idle && self.exchange.looked.is_some_and(|looked| looked.elapsed() < every) {
            return Ok(());
        }
        self.exchange.looked = Some(Instant::now());
        self.hand_over_wanted()?;
        if !self.exchange.waits() {
            return Ok(());
        }
        self.store.refresh()?;
        for instance in std::mem::take(&mut self.exchange.fetching) {
            self.look_for(instance)?;
        }
        for instance in std::mem::take(&mut self.exchange.elsewhere) {
            self.look_whether_free(instance)?;
        }
        self.take_turns()
    }

    /// Looks again for the values of an instance.
    fn look_for(&mut self, instance: usize) -> Result<(), RunError> {
        if !self.is_due(instance) || !self.states[instance].remaking {
            return Ok(());
        }
        if !self.is_still_wanted(instance) {
            self.moved();
            self.call_off(instance);
            return Ok(());
        }
        match self.find_elsewhere(instance)? {
            Found::Elsewhere => self.exchange.fetching.push(instance),
            Found::Here => {
                self.moved();
                self.take_over(instance)?;
            }
            Found::Nowhere => {
                self.moved();
                self.remakes.push_front(instance);
            }
        }
        Ok(())
    }

    /// Looks whether another process has done what it has the key of, or has released that.
    fn look_whether_free(&mut self, instance: usize) -> Result<(), RunError> {
        let Some(key) = self.states[instance].key.filter(|_| self.is_due(instance)) else { return Ok(()) };
        let is_remaking = self.states[instance].remaking;
        if !is_remaking && self.close_if_done(instance) {
            self.moved();
        } else if self.store.try_lock(&key)?.is_none() {
            self.exchange.elsewhere.push(instance);
        } else {
            self.moved();
            self.turns.push_back(Turn::Prepare(instance));
        }
        Ok(())
    }

    fn moved(&mut self) {
        self.exchange.pause = PAUSES.0;
    }

    /// Finds the values of an instance that somebody waits for; what has come is taken, what others have is asked for.
    pub fn find_elsewhere(&mut self, instance: usize) -> Result<Found, RunError> {
        let mut found = Found::Here;
        for (port, kind, digest) in self.called_for(instance) {
            if let Some(path) = self.exchange.room.as_ref().and_then(|room| room.take(&digest)) {
                let announced = Arc::new(self.store.announce(&digest)?);
                let state = &mut self.states[instance];
                state.spilled.extend(Spilled::brought(path, kind, digest).map(|file| (port, Arc::new(file))));
                state.announced.insert(port, announced);
            } else if self.store.is_at_hand_elsewhere(&digest)? {
                self.exchange.room(self.store)?.want(&digest)?;
                self.states[instance].asked = true;
                found = Found::Elsewhere;
            } else {
                self.discard_brought(instance);
                return Ok(Found::Nowhere);
            }
        }
        Ok(found)
    }

    /// The outputs of an instance that somebody waits for and that are not here.
    fn called_for(&self, instance: usize) -> Vec<(&'static str, Kind, Digest)> {
        let Some(outcome) = &self.states[instance].outcome else { return Vec::new() };
        let mut called: Vec<(&'static str, Kind, Digest)> = Vec::new();
        for by in &self.states[instance].wanted_by {
            let given = self.plan.instances[*by].inputs.iter().flat_map(|(_, given)| given);
            for port in given.filter(|given| given.instance == instance).map(|given| given.port) {
                let output = &outcome.outputs[port];
                let is_here = self.states[instance].holds(port) || self.store.contains(&output.digest);
                if !is_here && called.iter().all(|(other, ..)| *other != port) {
                    called.extend(output.kind.parse().ok().map(|kind| (port, kind, output.digest)));
                }
            }
        }
        called
    }

    /// Gives others what they want and is here.
    fn hand_over_wanted(&mut self) -> Result<(), RunError> {
        let (are_others, wanted) = self.store.wanted_elsewhere(self.exchange.room.as_ref())?;
        self.exchange.are_others = are_others;
        if wanted.is_empty() {
            return Ok(());
        }
        let mut here: HashMap<Digest, Vec<(usize, &'static str)>> = HashMap::new();
        for instance in 0..self.states.len() {
            let state = &self.states[instance];
            let Some((key, outcome)) = state.key.zip(state.outcome.as_ref()) else { continue };
            for port in state.announced.keys() {
                here.insert(outcome.outputs[*port].digest, vec![(instance, *port)]);
                here.entry(key).or_default().push((instance, *port));
            }
        }
        for want in wanted {
            let Some(values) = here.get(&want.name) else { continue };
            let outcome = values.first().and_then(|(instance, _)| self.states[*instance].outcome.clone());
            outcome.iter().for_each(|outcome| self.hand_over(&want, values, outcome));
        }
        Ok(())
    }

    /// Gives others what was just made, if they asked whoever makes it for it: it may be used up here in a moment.
    pub fn hand_over_made(&mut self, instance: usize, outcome: &Outcome) {
        if !self.exchange.are_others || self.states[instance].announced.is_empty() {
            return;
        }
        // Where that cannot be looked at now, they ask again.
        let wanted = self.store.wanted_elsewhere(self.exchange.room.as_ref()).unwrap_or_default().1;
        let values: Vec<_> = self.states[instance].announced.keys().map(|port| (instance, *port)).collect();
        let key = self.states[instance].key;
        for want in wanted.iter().filter(|want| Some(want.name) == key) {
            self.hand_over(want, &values, outcome);
        }
    }

    /// Brings values of one instance to who wants them. What cannot be brought is not announced any longer: then who wants it
    /// makes it.
    fn hand_over(&mut self, want: &Want, values: &[(usize, &'static str)], outcome: &Outcome) {
        for (instance, port) in values {
            if let Err(error) = self.bring(want, (*instance, port), outcome)
                && !want.is_moot()
            {
                tracing::warn!("`{port}` of {} cannot be handed to another run: {error}", self.plan.label(*instance));
                self.states[*instance].announced.remove(port);
            }
        }
        want.answered();
    }

    fn bring(
        &self,
        want: &Want,
        (instance, port): (usize, &'static str),
        outcome: &Outcome,
    ) -> std::io::Result<PathBuf> {
        let (state, digest) = (&self.states[instance], outcome.outputs[port].digest);
        let file = state.spilled.get(port).map(|file| file.path());
        want.bring(&digest, file, || {
            let encoded = match (state.values.get(port), file) {
                (Some(value), _) => value.encode().map_err(|error| std::io::Error::other(error.to_string()))?,
                (None, Some(file)) => std::fs::read(file)?,
                (None, None) => return Err(std::io::Error::other("it is not here any more")),
            };
            let is_same = Digest::of(&encoded) == digest;
            is_same.then_some(encoded).ok_or_else(|| std::io::Error::other("it is not what was recorded"))
        })
    }

    /// Removes what was brought of an instance and not taken; nobody is asked for it any longer.
    pub fn discard_brought(&mut self, instance: usize) {
        if !self.states[instance].asked {
            return;
        }
        let state = &self.states[instance];
        let Some(room) = &self.exchange.room else { return };
        state.key.iter().for_each(|key| room.unwant(key));
        for output in state.outcome.iter().flat_map(|outcome| outcome.outputs.values()) {
            room.unwant(&output.digest);
            if let Some(file) = room.take(&output.digest) {
                // What cannot be removed now goes with the room.
                let _ = std::fs::remove_file(file);
            }
        }
    }
}
