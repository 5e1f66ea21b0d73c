//! Growing the plan while it runs: when a list is done, the steps over its items can be told.

use super::schedule::{Scheduler, Turn};
use super::state::Status;
use crate::diagnostic::Diagnostic;
use crate::plan::{file_hash, items_of};
use crate::watch::Event;

impl Scheduler<'_> {
    /// Expands the axes that take their items from an instance whose outcome is known.
    pub fn expand(&mut self, instance: usize) {
        let waiting = self.plan.waiting_axes(instance);
        let Some(outcome) = self.states[instance].outcome.clone().filter(|_| !waiting.is_empty()) else { return };
        for (axis, port) in waiting {
            let items = match items_of(&outcome, port, self.store) {
                Ok(items) => items,
                Err(why) => return self.tell_unexpanded(instance, axis, &why, None),
            };
            let hash = file_hash(self.store);
            let grown = self.plan.set_items(axis, items).and_then(|()| self.plan.grow(&hash));
            match grown {
                Ok(first) => self.take_in(first),
                Err(faults) => {
                    let why: Vec<&str> = faults.iter().map(|fault: &Diagnostic| fault.message.as_str()).collect();
                    let hint = faults.iter().find_map(|fault| fault.hint.clone());
                    self.plan.unset_items(axis);
                    return self.tell_unexpanded(instance, axis, &why.join("; "), hint);
                }
            }
        }
    }

    fn tell_unexpanded(&mut self, instance: usize, axis: usize, why: &str, hint: Option<String>) {
        self.failure = true;
        let step = self.plan.step(instance);
        let stage = step.stage.name().to_owned();
        let axis = &self.plan.graph.axes[axis].name.text;
        let message = format!("what it made cannot be the items of axis `{axis}`: {why}");
        self.tell(&Event::Failed { step: self.plan.label(instance), stage, message, hint });
    }

    /// Takes up the instances of the plan from a number on.
    fn take_in(&mut self, first: usize) {
        self.grown = true;
        self.log_levels = None;
        self.states.grow(self.plan, first);
        for instance in first..self.plan.instances.len() {
            let failed = |producer: &usize| self.states[*producer].status() == Status::Failed;
            if self.plan.producers(instance).iter().any(failed) {
                self.fail(instance);
            } else if self.states[instance].unmet == 0 && self.states[instance].status() == Status::Waiting {
                self.turns.push_back(Turn::Settle(instance));
            }
        }
    }
}
