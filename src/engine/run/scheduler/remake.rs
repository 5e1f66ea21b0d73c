//! Recorded values that are needed and not at hand: taken from a live process that has them, or else made again, once.
//!
//! Whoever makes a value again holds the lock of its key from before it looks for what that needs until it is made. So what
//! another process has made and used up meanwhile is seen before anything is done twice.

use rockface_cache::Outcome;

use super::exchange::Found;
use super::schedule::{Scheduler, Turn};
use super::state::Status;
use crate::plan::hit;
use crate::run::RunError;

impl Scheduler<'_> {
    /// Calls for the inputs of an instance, for it and for others that want them, unless another process is doing without or
    /// has done so.
    pub fn call_for_inputs(&mut self, instance: usize) -> Result<(), RunError> {
        let mut calling = vec![instance];
        while let Some(instance) = calling.pop() {
            for producer in self.call_for(instance)? {
                let key = self.states[producer].key;
                calling.extend(key.and_then(|key| self.wanting.remove(&key)).unwrap_or_default());
            }
        }
        Ok(())
    }

    /// Returns the producers whose values are called for.
    fn call_for(&mut self, instance: usize) -> Result<Vec<usize>, RunError> {
        let is_called = !self.is_due(instance) || self.states[instance].missing > 0;
        let Some(key) = self.states[instance].key.filter(|_| !is_called) else { return Ok(Vec::new()) };
        self.store.refresh()?;
        if self.close_if_done(instance) {
            return Ok(Vec::new());
        }
        if self.store.try_lock(&key)?.is_none() {
            self.leave_elsewhere(instance);
            return Ok(Vec::new());
        }
        let absent = self.absent(instance);
        self.remake_all(instance, &absent);
        Ok(absent)
    }

    /// Takes the outcome of an instance that is due from its record, if there is one by now.
    pub fn close_if_done(&mut self, instance: usize) -> bool {
        let Some(key) = self.states[instance].key else { return false };
        let known = hit(self.store, &key, self.must_keep(instance), |outcome| self.plan.fits(instance, outcome));
        let Some(outcome) = known else { return false };
        self.states.set(instance, Status::Done);
        self.tell_cached(instance);
        self.turns.push_back(Turn::Finish(instance, outcome));
        true
    }

    /// Calls for values, after which the instance is looked at anew.
    pub fn remake_all(&mut self, instance: usize, absent: &[usize]) {
        self.states[instance].missing = absent.len();
        if absent.is_empty() {
            self.line_up(instance);
        }
        for producer in absent {
            let wanted_by = &mut self.states[*producer].wanted_by;
            if !wanted_by.contains(&instance) {
                wanted_by.push(instance);
            }
            self.remake(*producer);
        }
    }

    /// Producers whose values are neither in memory nor in the store.
    pub fn absent(&mut self, instance: usize) -> Vec<usize> {
        let given = self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let is_absent = |(producer, port): &(usize, &str)| {
            let state = &self.states[*producer];
            let digest = state.outcome.as_ref().map(|outcome| outcome.outputs[*port].digest);
            !state.holds(port) && !digest.is_some_and(|digest| self.store.contains(&digest))
        };
        let mut absent: Vec<usize> = Vec::new();
        for (producer, _) in given.map(|given| (given.instance, given.port)).filter(is_absent) {
            if !absent.contains(&producer) {
                absent.push(producer);
            }
        }
        absent.iter().for_each(|producer| self.tell_damaged(*producer));
        absent
    }

    /// Calls for the values of a recorded instance.
    fn remake(&mut self, instance: usize) {
        if self.states[instance].remaking {
            return;
        }
        self.states[instance].remaking = true;
        self.states.set(instance, Status::Due);
        for producer in self.plan.producers(instance) {
            self.states[producer].users += 1;
        }
        self.enter_again(instance);
    }

    /// Puts an instance whose values are called for in line with those of the same recipe.
    pub fn enter_again(&mut self, instance: usize) {
        let key = self.states[instance].key.unwrap_or_else(|| self.recipe(instance).key());
        self.enter(instance, key);
    }

    /// Sees to the values that are called for: whoever computes them is waited for, whoever has them is asked for them, and
    /// where nobody is or has, they are made again.
    pub fn take_up(&mut self, instance: usize) -> Result<(), RunError> {
        let state = &self.states[instance];
        let is_open = self.is_due(instance) && state.remaking && state.lease.is_none();
        let Some(key) = state.key.filter(|_| is_open) else { return Ok(()) };
        let Some(lease) = self.store.try_lock(&key)? else {
            self.leave_elsewhere(instance);
            return Ok(());
        };
        // Nobody makes them now. Whoever has made them since they were called for has them, or has done what needs them.
        self.store.refresh()?;
        if !self.is_still_wanted(instance) {
            self.call_off(instance);
            return Ok(());
        }
        match self.find_elsewhere(instance)? {
            Found::Here => self.take_over(instance),
            Found::Elsewhere => {
                self.exchange.fetching.push(instance);
                Ok(())
            }
            Found::Nowhere => {
                self.states[instance].lease = Some(lease);
                self.turns.push_back(Turn::Prepare(instance));
                Ok(())
            }
        }
    }

    /// Whether somebody still waits for the values of an instance; those whose work another process has done do not.
    pub fn is_still_wanted(&mut self, instance: usize) -> bool {
        let mut wanted_by = std::mem::take(&mut self.states[instance].wanted_by);
        wanted_by.retain(|by| self.is_due(*by) && (self.states[*by].remaking || !self.close_if_done(*by)));
        let is_wanted = !wanted_by.is_empty();
        self.states[instance].wanted_by = wanted_by;
        is_wanted
    }

    /// Nobody needs the values of an instance any more.
    pub fn call_off(&mut self, instance: usize) {
        let twins = self.end_line(instance);
        self.states[instance].remaking = false;
        self.states.set(instance, Status::Done);
        self.let_go(instance);
        for twin in twins.into_iter().filter(|twin| self.states[*twin].status() == Status::Due).collect::<Vec<_>>() {
            if self.states[twin].remaking {
                self.enter_again(twin);
            } else {
                self.turns.push_back(Turn::Settle(twin));
            }
        }
    }

    /// All values of an instance that are called for are here.
    pub fn take_over(&mut self, instance: usize) -> Result<(), RunError> {
        match self.states[instance].outcome.clone() {
            Some(outcome) => self.remade(instance, outcome, false),
            None => Ok(()),
        }
    }

    /// The values of an instance are there again: those who waited for them go on.
    pub fn remade(&mut self, instance: usize, outcome: Outcome, changed: bool) -> Result<(), RunError> {
        self.states.set(instance, Status::Done);
        let state = &mut self.states[instance];
        (state.remaking, state.outcome) = (false, Some(outcome));
        self.revised |= changed;
        if changed {
            // What is done keeps the former output; what is still to run has it in its recipe and looks again.
            for dependent in &self.plan.instances[instance].dependents {
                self.states[*dependent].again |= self.is_due(*dependent);
            }
        }
        self.deliver_to_twins(instance)?;
        for consumer in std::mem::take(&mut self.states[instance].wanted_by) {
            let state = &mut self.states[consumer];
            state.missing = state.missing.saturating_sub(1);
            if state.missing == 0 {
                self.turns.push_back(Turn::Prepare(consumer));
            }
        }
        self.let_go(instance);
        Ok(())
    }
}
