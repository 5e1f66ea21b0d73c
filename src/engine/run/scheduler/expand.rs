//! Growing the plan while it runs: when a list of items is known, the steps over it are expanded.

use super::schedule::{Scheduler, Turn};
use crate::diagnostic::Diagnostic;
use crate::plan::{file_hash, items_of};
use crate::watch::Event;

impl Scheduler<'_> {
    /// Expands the axes that take their items from an instance whose outcome is known.
    pub fn expand(&mut self, instance: usize) {
        let waiting = self.plan.waiting_axes(instance);
        let Some(outcome) = self.states[instance].outcome().cloned().filter(|_| !waiting.is_empty()) else { return };
        for (axis, port) in waiting {
            let items = match items_of(&outcome, port, self.store) {
                Ok(items) => items,
                Err(why) => return self.report_unexpanded(instance, axis, &why, None),
            };
            let hash = file_hash(self.store);
            let grown = self.plan.set_items(axis, items).and_then(|()| self.plan.grow(&hash));
            match grown {
                Ok(first) => self.schedule_from(first),
                Err(faults) => {
                    let why: Vec<&str> = faults.iter().map(|fault: &Diagnostic| fault.message.as_str()).collect();
                    let hint = faults.iter().find_map(|fault| fault.hint.clone());
                    self.plan.unset_items(axis);
                    return self.report_unexpanded(instance, axis, &why.join("; "), hint);
                }
            }
        }
    }

    fn report_unexpanded(&mut self, instance: usize, axis: usize, why: &str, hint: Option<String>) {
        self.failed = true;
        let step = self.plan.step(instance);
        let stage = step.stage.name().to_owned();
        let axis = &self.plan.graph.axes[axis].name.text;
        let message = format!("its output cannot be used as the items of axis `{axis}`: {why}");
        self.report(&Event::Failed { step: self.plan.label(instance), stage, message, hint });
    }

    /// Schedules the instances that the plan has from number `first` on.
    fn schedule_from(&mut self, first: usize) {
        self.grown = true;
        self.log_levels = None;
        self.states.grow(self.plan, first);
        self.spans = super::schedule::spans(self.plan);
        for instance in first..self.plan.instances.len() {
            let failed = |producer: &usize| self.states[*producer].is_failed();
            if self.plan.producers(instance).iter().any(failed) {
                self.fail(instance, None);
            } else if self.states[instance].is_unsettled() {
                self.turns.push_back(Turn::Settle(instance));
            }
        }
    }
}
