//! The turns of the scheduler: what is known already, what has to run, and what follows from a result.

use std::sync::Arc;

use rockface_cache::{Digest, Outcome, Recipe, Record};
use rockface_core::artefact::Artefact;

use super::schedule::{Line, Scheduler, Turn};
use super::state::{State, Status, same_outputs};
use crate::plan::hit;
use crate::run::RunError;

impl Scheduler<'_> {
    /// Does all that is to be done without a worker.
    pub fn take_turns(&mut self) -> Result<(), RunError> {
        while let Some(turn) = self.turns.pop_front() {
            match turn {
                Turn::Settle(instance) => self.settle(instance),
                Turn::Prepare(instance) => self.prepare(instance),
                Turn::Finish(instance, outcome) => self.finish(instance, outcome)?,
            }
        }
        if !self.counted_on.is_empty() {
            self.store.count_on(&std::mem::take(&mut self.counted_on))?;
        }
        Ok(())
    }

    pub fn is_due(&self, instance: usize) -> bool {
        self.states[instance].status() == Status::Due
    }

    /// The recipe of an instance whose producers are done.
    pub fn recipe(&self, instance: usize) -> Recipe {
        let states = &self.states;
        self.plan.recipe(instance, |producer, port| {
            states[producer].outcome.as_ref().map_or_else(|| Digest::of(b""), |outcome| outcome.outputs[port].digest)
        })
    }

    /// The recipe an instance has or had when it was done: that of its record, where it is not at hand.
    pub fn known_recipe(&self, instance: usize) -> Recipe {
        let state = &self.states[instance];
        let recorded = || self.store.record(&state.key?).map(|record| record.recipe);
        state.recipe.as_deref().cloned().or_else(recorded).unwrap_or_else(|| self.recipe(instance))
    }

    /// Finds the recipe of an instance; kept by whoever has to compute it.
    fn set_recipe(&mut self, instance: usize) -> (Digest, Recipe) {
        let recipe = self.recipe(instance);
        let key = recipe.key();
        self.counted_on.push(key);
        let state = &mut self.states[instance];
        (state.key, state.recipe, state.again, state.lease) = (Some(key), None, false, None);
        (key, recipe)
    }

    fn settle(&mut self, instance: usize) {
        if !matches!(self.states[instance].status(), Status::Waiting | Status::Due) {
            return;
        }
        let (key, recipe) = self.set_recipe(instance);
        self.states.set(instance, Status::Due);
        let known = hit(self.store, &key, self.plan.step(instance).keep, |outcome| self.plan.fits(instance, outcome));
        self.tell_damaged(instance);
        if let Some(outcome) = known {
            self.states.set(instance, Status::Done);
            self.tell_cached(instance);
            self.turns.push_back(Turn::Finish(instance, outcome));
        } else {
            let state = &mut self.states[instance];
            (state.recorded, state.recipe) = (self.store.has_record(&key), Some(Box::new(recipe)));
            self.enter(instance, key);
        }
    }

    /// Computes a recipe, or waits for the one that does.
    pub fn enter(&mut self, instance: usize, key: Digest) {
        if let Some(line) = self.computing.get_mut(&key) {
            line.twins.push(instance);
        } else {
            self.computing.insert(key, Line { leader: instance, twins: Vec::new() });
            self.turns.push_back(Turn::Prepare(instance));
        }
    }

    /// Ends the line of an instance, if it leads one, and gives back who waited in it.
    pub fn end_line(&mut self, instance: usize) -> Vec<usize> {
        let Some(key) = self.states[instance].key else { return Vec::new() };
        if self.computing.get(&key).is_none_or(|line| line.leader != instance) {
            return Vec::new();
        }
        self.computing.remove(&key).map(|line| line.twins).unwrap_or_default()
    }

    /// Whether an instance or one that waits for it keeps its outputs.
    pub fn must_keep(&self, instance: usize) -> bool {
        let line = self.states[instance].key.and_then(|key| self.computing.get(&key));
        let twins = line.into_iter().flat_map(|line| &line.twins).copied();
        twins.chain([instance]).any(|twin| self.plan.step(twin).keep)
    }

    /// Puts an instance in line for a worker; where values it needs are neither in memory nor in the store, behind all others.
    fn prepare(&mut self, instance: usize) {
        if !self.is_due(instance) {
            return;
        }
        if self.states[instance].again {
            return self.look_again(instance);
        }
        if self.states[instance].remaking && self.states[instance].lease.is_none() {
            return self.remakes.push_front(instance);
        }
        let absent = self.absent(instance);
        if absent.iter().any(|producer| self.states[*producer].status() == Status::Failed) {
            return self.fail(instance);
        }
        if absent.is_empty() {
            self.line_up(instance);
        } else if self.states[instance].remaking {
            self.remake_all(instance, &absent);
        } else {
            self.costly.push_back(instance);
            for key in absent.iter().filter_map(|producer| self.states[*producer].key) {
                self.wanting.entry(key).or_default().push(instance);
            }
        }
    }

    /// Puts an instance in line for a worker.
    pub fn line_up(&mut self, instance: usize) {
        let depth = self.plan.instances[instance].step;
        self.ready.push((self.drains(instance), depth, std::cmp::Reverse(instance)));
    }

    /// Whether it uses values that are held in memory only, so that they can be let go.
    fn drains(&self, instance: usize) -> bool {
        let transient = |producer: &usize| {
            let state = &self.states[*producer];
            let is_held = !state.values.is_empty() || !state.spilled.is_empty();
            is_held && !self.plan.step(*producer).keep
        };
        self.plan.producers(instance).iter().any(transient)
    }

    /// A producer came out otherwise: the recipe of this instance, and of who waits for it, is not what it was.
    fn look_again(&mut self, instance: usize) {
        let twins = self.end_line(instance);
        for due in std::iter::once(instance).chain(twins) {
            if !self.is_due(due) {
                continue;
            }
            if self.states[due].remaking {
                let (key, recipe) = self.set_recipe(due);
                self.states[due].recipe = Some(Box::new(recipe));
                self.enter(due, key);
            } else {
                self.turns.push_back(Turn::Settle(due));
            }
        }
    }

    /// The record of an instance is known: tell its consumers, and free what only it needed.
    fn finish(&mut self, instance: usize, outcome: Outcome) -> Result<(), RunError> {
        self.states[instance].outcome = Some(outcome);
        self.deliver_to_twins(instance)?;
        self.let_go(instance);
        for dependent in self.plan.instances[instance].dependents.clone() {
            let state = &mut self.states[dependent];
            state.unmet -= 1;
            if state.unmet == 0 && state.status() == Status::Waiting {
                self.turns.push_back(Turn::Settle(dependent));
            }
        }
        self.expand(instance);
        Ok(())
    }

    /// Frees the values an instance needed, and its own if nobody needs them.
    pub fn let_go(&mut self, instance: usize) {
        for producer in self.plan.producers(instance) {
            self.release(producer);
        }
        if self.states[instance].users == 0 {
            self.drop_values(instance);
        }
    }

    pub fn deliver_to_twins(&mut self, instance: usize) -> Result<(), RunError> {
        for twin in self.end_line(instance) {
            self.deliver(instance, twin)?;
        }
        Ok(())
    }

    /// Equal recipes have equal outputs: a twin takes them, from memory where they are.
    fn deliver(&mut self, leader: usize, twin: usize) -> Result<(), RunError> {
        if !self.is_due(twin) {
            return Ok(());
        }
        if self.states[twin].again {
            self.look_again(twin);
            return Ok(());
        }
        let Some(outcome) = self.kept_as(twin, leader)? else {
            if self.states[twin].remaking {
                self.enter_again(twin);
            } else {
                self.turns.push_back(Turn::Settle(twin));
            }
            return Ok(());
        };
        if self.states[twin].users > 0 {
            let State { values, spilled, announced, .. } = &self.states[leader];
            let (values, spilled, announced) = (values.clone(), spilled.clone(), announced.clone());
            (self.states[twin].spilled, self.states[twin].announced) = (spilled, announced);
            values.into_iter().for_each(|(port, value)| self.hold(twin, port, value));
        }
        self.states.set(twin, Status::Done);
        self.tell_cached(twin);
        if self.states[twin].remaking {
            let changed = self.states[twin].outcome.as_ref().is_some_and(|former| !same_outputs(former, &outcome));
            return self.remade(twin, outcome, changed);
        }
        self.turns.push_back(Turn::Finish(twin, outcome));
        Ok(())
    }

    /// What came out of `leader`, with its values where its twin needs them; `None` when they are nowhere.
    fn kept_as(&mut self, twin: usize, leader: usize) -> Result<Option<Outcome>, RunError> {
        let leading = &self.states[leader];
        let Some(outcome) = leading.outcome.clone() else { return Ok(None) };
        let values = leading.values.clone();
        let in_memory = outcome.outputs.keys().all(|port| values.contains_key(port.as_str()));
        if self.plan.step(twin).keep && !outcome.is_kept() {
            return if in_memory { self.store_values(leader, outcome, &values).map(Some) } else { Ok(None) };
        }
        let held = outcome.outputs.keys().all(|port| self.states[leader].holds(port));
        let there = !self.states[twin].remaking || held || self.is_stored(&self.states[leader]);
        Ok(there.then_some(outcome))
    }

    /// Writes values that were not kept, and a record that says so.
    fn store_values(&self, leader: usize, mut outcome: Outcome, values: &Values) -> Result<Outcome, RunError> {
        for (port, output) in outcome.outputs.iter_mut() {
            let encoded = values[port.as_str()].encode();
            let encoded =
                encoded.map_err(|error| RunError::Encode(format!("{}.{port}: {error}", self.plan.label(leader))))?;
            output.digest = self.store.put(&encoded)?;
            output.kept = true;
        }
        let recipe = self.known_recipe(leader);
        let Outcome { outputs, log, sketches, cost } = outcome.clone();
        self.store.commit(&Record { recipe, outputs, log, sketches, cost })?;
        Ok(outcome)
    }

    /// An instance failed: so does what waits for it, and nothing that is done or running.
    pub fn fail(&mut self, instance: usize) {
        self.failure = true;
        let mut failed = vec![instance];
        while let Some(instance) = failed.pop() {
            let status = self.states[instance].status();
            if matches!(status, Status::Failed | Status::Done) {
                continue;
            }
            failed.extend(self.end_line(instance));
            self.states.set(instance, Status::Failed);
            self.states[instance].lease = None;
            self.plan.producers(instance).into_iter().for_each(|producer| self.release(producer));
            let waiting = self.plan.instances[instance].dependents.iter().copied();
            let waiting = waiting.chain(std::mem::take(&mut self.states[instance].wanted_by));
            let open = |i: &usize| matches!(self.states[*i].status(), Status::Waiting | Status::Due);
            failed.extend(waiting.filter(open).collect::<Vec<_>>());
        }
    }
}

type Values = std::collections::BTreeMap<&'static str, Arc<Artefact>>;
