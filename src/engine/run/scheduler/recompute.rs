//! Values that are needed and that no store has, though their outcome is known: obtained from another live process, or else
//! recomputed once.
//!
//! A process that recomputes a value locks its key before it looks for the inputs, and keeps the lock until the value is there.
//! So it sees what another process has computed and used up meanwhile, and no two processes recompute the same value.

use super::exchange::Found;
use super::schedule::{Scheduler, Turn};
use crate::plan::hit;
use crate::run::RunError;

impl Scheduler<'_> {
    /// Requests the inputs of an instance, for it and for all others that want them; does nothing if another process
    /// computes the instance, or has done so.
    pub fn request_inputs(&mut self, instance: usize) -> Result<(), RunError> {
        let mut requesting = vec![instance];
        while let Some(instance) = requesting.pop() {
            for producer in self.request_inputs_of(instance)? {
                let key = self.states[producer].key;
                requesting.extend(key.and_then(|key| self.wanting.remove(&key)).unwrap_or_default());
            }
        }
        Ok(())
    }

    /// Requests the inputs of one instance; returns the producers whose values have to come.
    fn request_inputs_of(&mut self, instance: usize) -> Result<Vec<usize>, RunError> {
        // It may have been done since it was put here, and its values be needed again: then it has another place in another line.
        let is_open = self.states[instance].due().is_some_and(|due| due.missing == 0 && !due.is_recompute());
        let Some(key) = self.states[instance].key.filter(|_| is_open) else { return Ok(Vec::new()) };
        self.store.refresh()?;
        if self.close_if_recorded(instance) {
            return Ok(Vec::new());
        }
        if !self.store.is_free(&key)? {
            self.leave_elsewhere(instance);
            return Ok(Vec::new());
        }
        let absent = self.absent(instance);
        if absent.iter().any(|producer| self.states[*producer].is_failed()) {
            self.fail(instance, None);
            return Ok(Vec::new());
        }
        self.recompute_all(instance, &absent);
        Ok(absent)
    }

    /// Closes an instance that is to be computed if another process has recorded its outcome meanwhile. Returns whether it did. The
    /// outcome of an instance that is recomputed is known: others wait for its values, which this would not bring.
    pub fn close_if_recorded(&mut self, instance: usize) -> bool {
        let is_current = self.states[instance].due().is_some_and(|due| !due.is_stale && !due.is_recompute());
        let Some(key) = self.states[instance].key.filter(|_| is_current) else { return false };
        let known = hit(self.store, &key, self.must_keep(instance), |outcome| self.plan.fits(instance, outcome));
        let Some(outcome) = known else { return false };
        self.close(instance, outcome);
        true
    }

    /// Requests the values of these producers for an instance, which is prepared again once all have come.
    pub fn recompute_all(&mut self, instance: usize, absent: &[usize]) {
        if let Some(due) = self.states[instance].due_mut() {
            due.missing = absent.len();
        }
        if absent.is_empty() {
            self.queue(instance);
        }
        for producer in absent {
            let wanted_by = &mut self.states[*producer].wanted_by;
            if !wanted_by.contains(&instance) {
                wanted_by.push(instance);
            }
            self.recompute(*producer);
        }
    }

    /// Producers whose values are neither in memory nor in the store.
    pub fn absent(&mut self, instance: usize) -> Vec<usize> {
        let given = self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let is_absent = |(producer, port): &(usize, &str)| {
            let state = &self.states[*producer];
            let digest = state.outcome().map(|outcome| outcome.outputs[*port].digest);
            !state.holds(port) && !digest.is_some_and(|digest| self.store.contains(&digest))
        };
        let mut absent: Vec<usize> = Vec::new();
        for (producer, _) in given.map(|given| (given.instance, given.port)).filter(is_absent) {
            if !absent.contains(&producer) {
                absent.push(producer);
            }
        }
        absent.iter().for_each(|producer| self.report_damaged(*producer));
        absent
    }

    /// Requests the values of an instance that is done.
    fn recompute(&mut self, instance: usize) {
        if !self.states.reopen(instance) {
            return;
        }
        for producer in self.plan.producers(instance) {
            self.states[producer].users += 1;
        }
        self.enter_again(instance);
    }

    /// Queues an instance whose values are requested, in one line with those of the same recipe.
    pub fn enter_again(&mut self, instance: usize) {
        let key = self.states[instance].key.unwrap_or_else(|| self.recipe(instance).key());
        self.enter(instance, key);
    }

    /// Obtains the requested values of an instance: waits for the process that computes them, asks a process that has them, or
    /// recomputes them if there is neither.
    pub fn obtain_values(&mut self, instance: usize) -> Result<(), RunError> {
        let state = &self.states[instance];
        let is_open = state.due().is_some_and(|due| due.is_recompute() && due.lease.is_none());
        let Some(key) = state.key.filter(|_| is_open) else { return Ok(()) };
        let Some(lease) = self.store.try_lock(&key)? else {
            self.leave_elsewhere(instance);
            return Ok(());
        };
        // No process computes them now. One that did so since they were requested still has them, or has done what needs them.
        self.store.refresh()?;
        if self.is_called_off(instance) {
            return Ok(());
        }
        match self.find_elsewhere(instance)? {
            Found::Here => self.accept_values(instance),
            Found::Elsewhere => {
                self.exchange.fetching.push(instance);
                Ok(())
            }
            Found::Nowhere => {
                // Whoever had them may have recorded what needs them and let them go, both since the store was last read.
                self.store.refresh()?;
                if self.is_called_off(instance) {
                    return Ok(());
                }
                if let Some(due) = self.states[instance].due_mut() {
                    due.lease = Some(lease);
                }
                self.turns.push_back(Turn::Prepare(instance));
                Ok(())
            }
        }
    }

    /// Calls this instance off if no other waits for its values any more. Returns whether it did.
    pub fn is_called_off(&mut self, instance: usize) -> bool {
        let is_wanted = self.is_still_wanted(instance);
        if !is_wanted {
            self.call_off(instance);
        }
        !is_wanted
    }

    /// Whether an instance still waits for the values of this one. Instances that another process has done are closed.
    fn is_still_wanted(&mut self, instance: usize) -> bool {
        let mut wanted_by = std::mem::take(&mut self.states[instance].wanted_by);
        wanted_by.retain(|by| self.states[*by].is_due() && !self.close_if_recorded(*by));
        let is_wanted = !wanted_by.is_empty();
        self.states[instance].wanted_by = wanted_by;
        is_wanted
    }

    /// No instance needs the values of this one any more.
    fn call_off(&mut self, instance: usize) {
        let twins = self.end_line(instance);
        self.states.restore(instance);
        self.release_inputs(instance);
        for twin in twins {
            let Some(due) = self.states[twin].due() else { continue };
            if due.is_recompute() {
                self.enter_again(twin);
            } else {
                self.turns.push_back(Turn::Settle(twin));
            }
        }
    }

    /// All requested values of an instance are here.
    pub fn accept_values(&mut self, instance: usize) -> Result<(), RunError> {
        self.states.restore(instance);
        self.recomputed(instance, false)
    }

    /// The values of an instance are here again: the instances that waited for them continue.
    pub fn recomputed(&mut self, instance: usize, changed: bool) -> Result<(), RunError> {
        self.revised |= changed;
        if changed {
            // Instances that are done keep their outcome; the recipes of those that are due contain the former output.
            for dependent in &self.plan.instances[instance].dependents {
                if let Some(due) = self.states[*dependent].due_mut() {
                    due.is_stale = true;
                }
            }
        }
        self.deliver_to_twins(instance)?;
        for consumer in std::mem::take(&mut self.states[instance].wanted_by) {
            let Some(due) = self.states[consumer].due_mut() else { continue };
            due.missing = due.missing.saturating_sub(1);
            if due.missing == 0 {
                self.turns.push_back(Turn::Prepare(consumer));
            }
        }
        self.release_inputs(instance);
        Ok(())
    }
}
