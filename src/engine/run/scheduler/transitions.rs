//! Transitions between phases: what is known already, what has to run, and what follows from an outcome.

use std::sync::Arc;

use rockface_cache::{Digest, Outcome, Recipe, Record};
use rockface_core::artefact::Artefact;

use super::phase::{Due, Purpose};
use super::schedule::{Line, Priority, Scheduler, Turn};
use super::state::{State, same_outputs};
use crate::plan::hit;
use crate::run::{RunError, StepFailure};

/// Values that so many instances wait for are fetched or recomputed before anything else.
const SHARED_BY: usize = 4;
/// Consumers that gather more than this are not looked at when an order of their producers is sought.
const FEW: usize = 64;

impl Scheduler<'_> {
    /// Takes all turns that wait; none of them needs a worker.
    pub fn take_turns(&mut self) -> Result<(), RunError> {
        while let Some(turn) = self.turns.pop_front() {
            match turn {
                Turn::Settle(instance) => self.settle(instance),
                Turn::Prepare(instance) => self.prepare(instance),
                Turn::Finish(instance) => self.finish(instance)?,
            }
        }
        if !self.referenced.is_empty() {
            self.store.count_on(&std::mem::take(&mut self.referenced))?;
        }
        Ok(())
    }

    /// The recipe of an instance whose producers are done.
    pub fn recipe(&self, instance: usize) -> Recipe {
        let states = &self.states;
        self.plan.recipe(instance, |producer, port| {
            states[producer].outcome().map_or_else(|| Digest::of(b""), |outcome| outcome.outputs[port].digest)
        })
    }

    /// The recipe of an instance that has a key: the one held here, or else that of its record.
    pub fn known_recipe(&self, instance: usize) -> Recipe {
        let state = &self.states[instance];
        let recorded = || self.store.record(&state.key?).map(|record| record.recipe);
        state.recipe.as_deref().cloned().or_else(recorded).unwrap_or_else(|| self.recipe(instance))
    }

    /// Determines the recipe of an instance and its key.
    fn determine_recipe(&mut self, instance: usize) -> (Digest, Recipe) {
        let recipe = self.recipe(instance);
        let key = recipe.key();
        self.referenced.push(key);
        (self.states[instance].key, self.states[instance].recipe) = (Some(key), None);
        (key, recipe)
    }

    /// All producers are done: the outcome is on record, or the instance has to run.
    fn settle(&mut self, instance: usize) {
        let is_known = |producer: &usize| self.states[*producer].outcome().is_some();
        if !self.states[instance].is_pending() || !self.plan.producers(instance).iter().all(is_known) {
            return;
        }
        let (key, recipe) = self.determine_recipe(instance);
        let known = hit(self.store, &key, self.plan.step(instance).keep, |outcome| self.plan.fits(instance, outcome));
        self.report_damaged(instance);
        if let Some(outcome) = known {
            self.close(instance, outcome);
        } else {
            self.states[instance].recipe = Some(Box::new(recipe));
            self.states.make_due(instance, Purpose::Compute { recorded: self.store.has_record(&key) });
            self.enter(instance, key);
        }
    }

    /// The outcome of an instance is known although its stage did not run.
    pub fn close(&mut self, instance: usize, outcome: Outcome) {
        self.states.finish(instance, outcome);
        self.report_cached(instance);
        self.turns.push_back(Turn::Finish(instance));
    }

    /// Queues an instance, or lets it wait for one with the same recipe that is queued already.
    pub fn enter(&mut self, instance: usize, key: Digest) {
        if let Some(line) = self.computing.get_mut(&key) {
            line.twins.push(instance);
        } else {
            self.computing.insert(key, Line { leader: instance, twins: Vec::new() });
            self.turns.push_back(Turn::Prepare(instance));
        }
    }

    /// Removes the line that an instance leads, and returns the instances that waited in it.
    pub fn end_line(&mut self, instance: usize) -> Vec<usize> {
        let Some(key) = self.states[instance].key else { return Vec::new() };
        if self.computing.get(&key).is_none_or(|line| line.leader != instance) {
            return Vec::new();
        }
        self.computing.remove(&key).map(|line| line.twins).unwrap_or_default()
    }

    /// Whether the outputs of an instance are to be kept, for itself or for one that waits for it.
    pub fn must_keep(&self, instance: usize) -> bool {
        let line = self.states[instance].key.and_then(|key| self.computing.get(&key));
        let twins = line.into_iter().flat_map(|line| &line.twins).copied();
        twins.chain([instance]).any(|twin| self.plan.step(twin).keep)
    }

    /// Queues an instance for a worker; if values it needs are neither in memory nor in the store, behind all others.
    fn prepare(&mut self, instance: usize) {
        let Some(due) = self.states[instance].due() else { return };
        let (is_recompute, has_lease) = (due.is_recompute(), due.lease.is_some());
        if due.is_stale {
            return self.renew_recipes(instance);
        }
        if is_recompute && !has_lease {
            return self.recomputes.push_front(instance);
        }
        let absent = self.absent(instance);
        if absent.iter().any(|producer| self.states[*producer].is_failed()) {
            return self.fail(instance, None);
        }
        if absent.is_empty() {
            self.queue(instance);
        } else if is_recompute {
            self.recompute_all(instance, &absent);
        } else {
            // A value that many wait for is worth fetching at once: their chains go on here then.
            let is_shared = absent.iter().all(|producer| self.states[*producer].users >= SHARED_BY);
            let queue = if is_shared { &mut self.shared } else { &mut self.costly };
            queue.push_back(instance);
            for key in absent.iter().filter_map(|producer| self.states[*producer].key) {
                self.wanting.entry(key).or_default().push(instance);
            }
        }
    }

    /// Queues an instance whose inputs are at hand for a worker.
    pub fn queue(&mut self, instance: usize) {
        let (drains, depth) = (self.drains(instance), self.plan.instances[instance].step);
        let (first, last) = self.spans[depth];
        let count = last - first + 1;
        let start = (self.options.start * count as f64) as usize;
        let place = std::cmp::Reverse((instance - first + count - start.min(count - 1)) % count);
        let known = self.states[instance].due().and_then(|due| due.lacking);
        let lacking = known.unwrap_or_else(|| self.lacking(instance));
        if let Some(due) = self.states[instance].due_mut() {
            (due.is_queued, due.lacking) = (true, Some(lacking));
        }
        let [tells, awaited] = [&self.tells, &self.awaited].map(|steps| steps.get(depth).copied().unwrap_or(false));
        let lacking = std::cmp::Reverse(lacking);
        self.ready.push(Priority { tells, drains, awaited, depth, lacking, place, instance });
    }

    /// How many producers the consumer lacks that lacks the fewest, of an instance whose values are held for their consumers. Counted
    /// are consumers that gather few values and have one of them; without such a consumer it is the greatest number.
    fn lacking(&self, instance: usize) -> usize {
        if self.plan.step(instance).keep {
            return usize::MAX;
        }
        let unmet = |consumer: &usize| {
            let (unmet, given) = (self.states[*consumer].unmet(), self.given(*consumer));
            (unmet > 0 && unmet < given && given <= FEW).then_some(unmet)
        };
        self.plan.instances[instance].dependents.iter().filter_map(unmet).min().unwrap_or(usize::MAX)
    }

    /// How many values an instance is given.
    fn given(&self, instance: usize) -> usize {
        self.plan.instances[instance].inputs.iter().map(|(_, given)| given.len()).sum()
    }

    /// A consumer of values that are held lacks one producer less: those that it still lacks may come earlier now. Their former places in
    /// the queue are passed over when they are reached.
    fn advance_producers(&mut self, consumer: usize) {
        if self.given(consumer) > FEW {
            return;
        }
        let unmet = self.states[consumer].unmet();
        for producer in self.plan.producers(consumer) {
            let is_earlier = |due: &Due| due.is_queued && due.lacking.is_some_and(|lacking| unmet < lacking);
            if self.plan.step(producer).keep || !self.states[producer].due().is_some_and(is_earlier) {
                continue;
            }
            if let Some(due) = self.states[producer].due_mut() {
                due.lacking = Some(unmet);
            }
            self.queue(producer);
        }
    }

    /// Whether an instance uses values that no store has, so that running it may free them.
    fn drains(&self, instance: usize) -> bool {
        let transient = |producer: &usize| {
            let state = &self.states[*producer];
            let is_held = !state.values.is_empty() || !state.spilled.is_empty();
            is_held && !self.plan.step(*producer).keep
        };
        self.plan.producers(instance).iter().any(transient)
    }

    /// A producer gave a different output: determines the recipes of this instance, and of those that wait for it, again.
    fn renew_recipes(&mut self, instance: usize) {
        let twins = self.end_line(instance);
        for instance in std::iter::once(instance).chain(twins) {
            let Some(due) = self.states[instance].due_mut() else { continue };
            if !due.is_recompute() {
                self.turns.push_back(Turn::Settle(instance));
                continue;
            }
            (due.is_stale, due.lease) = (false, None);
            let (key, recipe) = self.determine_recipe(instance);
            self.states[instance].recipe = Some(Box::new(recipe));
            self.enter(instance, key);
        }
    }

    /// The outcome of an instance is known: notifies its consumers, and frees what only it needed.
    fn finish(&mut self, instance: usize) -> Result<(), RunError> {
        self.states[instance].set_delivered();
        self.deliver_to_twins(instance)?;
        self.release_inputs(instance);
        for dependent in self.plan.instances[instance].dependents.clone() {
            if self.states[dependent].meet() {
                self.turns.push_back(Turn::Settle(dependent));
            } else if !self.plan.step(instance).keep {
                self.advance_producers(dependent);
            }
        }
        self.expand(instance);
        Ok(())
    }

    /// Frees the values that an instance needed, and its own if no consumer is left.
    pub fn release_inputs(&mut self, instance: usize) {
        for producer in self.plan.producers(instance) {
            self.release(producer);
        }
        if self.states[instance].users == 0 {
            self.drop_values(instance);
        }
    }

    /// Gives the outcome of an instance to those that waited for it.
    pub fn deliver_to_twins(&mut self, instance: usize) -> Result<(), RunError> {
        for twin in self.end_line(instance) {
            self.deliver(instance, twin)?;
        }
        Ok(())
    }

    /// Gives the outcome of `leader` to an instance with the same recipe, with the values that are in memory or spilled.
    fn deliver(&mut self, leader: usize, twin: usize) -> Result<(), RunError> {
        let Some(due) = self.states[twin].due() else { return Ok(()) };
        let is_recompute = due.is_recompute();
        if due.is_stale {
            self.renew_recipes(twin);
            return Ok(());
        }
        let Some(outcome) = self.outcome_for(twin, leader)? else {
            if is_recompute {
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
        if let Some(former) = self.states[twin].outcome().filter(|_| is_recompute) {
            let changed = !same_outputs(former, &outcome);
            self.states.finish(twin, outcome);
            self.report_cached(twin);
            return self.recomputed(twin, changed);
        }
        self.close(twin, outcome);
        Ok(())
    }

    /// The outcome of `leader` as its twin needs it, which may have to keep the outputs; `None` when the values are nowhere.
    fn outcome_for(&mut self, twin: usize, leader: usize) -> Result<Option<Outcome>, RunError> {
        let leading = &self.states[leader];
        let Some(outcome) = leading.outcome().cloned() else { return Ok(None) };
        let values = leading.values.clone();
        let in_memory = outcome.outputs.keys().all(|port| values.contains_key(port.as_str()));
        if self.plan.step(twin).keep && !outcome.is_kept() {
            return if in_memory { self.store_values(leader, outcome, &values).map(Some) } else { Ok(None) };
        }
        let held = outcome.outputs.keys().all(|port| self.states[leader].holds(port));
        let is_there = !self.states[twin].is_recompute() || held || self.is_stored(&self.states[leader]);
        Ok(is_there.then_some(outcome))
    }

    /// Stores values that were not to be kept, and a record of them.
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

    /// An instance failed, with the cause if its own stage did: whatever waits for it fails too. Instances that are done or
    /// running are not affected.
    pub fn fail(&mut self, instance: usize, mut cause: Option<Box<StepFailure>>) {
        self.failed = true;
        let mut failed = vec![instance];
        while let Some(instance) = failed.pop() {
            if self.states[instance].is_done() || self.states[instance].is_failed() {
                continue;
            }
            failed.extend(self.end_line(instance));
            self.states.fail(instance, cause.take());
            self.plan.producers(instance).into_iter().for_each(|producer| self.release(producer));
            let waiting = self.plan.instances[instance].dependents.iter().copied();
            let waiting = waiting.chain(std::mem::take(&mut self.states[instance].wanted_by));
            failed.extend(waiting.filter(|instance| self.states[*instance].is_pending()).collect::<Vec<_>>());
        }
    }
}

type Values = std::collections::BTreeMap<&'static str, Arc<Artefact>>;
