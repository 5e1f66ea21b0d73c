//! Growing the plan while it runs: when a list of items or of pairs is known, the steps that wait for it are expanded.

use super::schedule::{Scheduler, Turn};
use crate::diagnostic::Diagnostic;
use crate::plan::{file_hash, items_of, partners_of};
use crate::watch::Event;

impl Scheduler<'_> {
    /// Expands what waits for lists that an instance makes, whose outcome is known.
    pub fn expand(&mut self, instance: usize) {
        let (axes, lists) = (self.plan.waiting_axes(instance), self.plan.waiting_lists(instance));
        let waits = !axes.is_empty() || !lists.is_empty();
        let Some(outcome) = self.states[instance].outcome().cloned().filter(|_| waits) else { return };
        for (axis, port) in axes {
            let use_of_it = format!("the items of axis `{}`", self.plan.graph.axes[axis].name.text);
            let items = match items_of(&outcome, port, self.store) {
                Ok(items) => items,
                Err(why) => return self.report_unexpanded(instance, &use_of_it, &why, None),
            };
            if let Err(faults) = self.plan.set_items(axis, items).and_then(|()| self.grow()) {
                self.plan.unset_items(axis);
                return self.report_faults(instance, &use_of_it, &faults);
            }
        }
        for list in lists {
            let use_of_it = "pairs that tell what is gathered";
            match partners_of(&outcome, list.1, self.store) {
                Ok(partners) => drop(self.plan.graph.partners.insert(list.clone(), partners)),
                Err(why) => return self.report_unexpanded(instance, use_of_it, &why, None),
            }
            if let Err(faults) = self.grow() {
                self.plan.graph.partners.remove(&list);
                return self.report_faults(instance, use_of_it, &faults);
            }
        }
    }

    fn grow(&mut self) -> Result<(), Vec<Diagnostic>> {
        let hash = file_hash(self.store);
        self.plan.grow(&hash).map(|first| self.schedule_from(first))
    }

    fn report_faults(&mut self, instance: usize, use_of_it: &str, faults: &[Diagnostic]) {
        let why: Vec<&str> = faults.iter().map(|fault| fault.message.as_str()).collect();
        let hint = faults.iter().find_map(|fault| fault.hint.clone());
        self.report_unexpanded(instance, use_of_it, &why.join("; "), hint);
    }

    fn report_unexpanded(&mut self, instance: usize, use_of_it: &str, why: &str, hint: Option<String>) {
        self.failed = true;
        let step = self.plan.step(instance);
        let stage = step.stage.name().to_owned();
        let message = format!("its output cannot be used as {use_of_it}: {why}");
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
