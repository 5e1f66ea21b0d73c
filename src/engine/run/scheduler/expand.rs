//! Growing the plan while it runs: when a list of items or of pairs is known, the steps that wait for it are expanded.

use super::schedule::{Scheduler, Turn};
use crate::diagnostic::Diagnostic;
use crate::plan::{file_hash, items_of, partners_of};
use crate::watch::Event;

/// What a list of pairs is used as, for messages.
const PAIRS: &str = "pairs that tell what is gathered";

impl Scheduler<'_> {
    /// Expands what waits for the items that an instance makes, and reads the pairs that it makes; its outcome is known.
    pub fn expand(&mut self, instance: usize) {
        self.read_lists(instance);
        let axes = self.plan.waiting_axes(instance);
        let Some(outcome) = self.states[instance].outcome().cloned().filter(|_| !axes.is_empty()) else { return };
        for (axis, port) in axes {
            let use_of_it = format!("the items of axis `{}`", self.plan.graph.axes[axis].name.text);
            let items = match items_of(&outcome, port, self.store) {
                Ok(items) => items,
                Err(why) => return self.report_unexpanded(instance, &use_of_it, &why, None),
            };
            let taken = self.plan.set_items(axis, instance, items);
            if let Err(faults) = taken.and_then(|taken| if taken { self.grow() } else { Ok(()) }) {
                self.plan.unset_items(axis);
                return self.report_faults(instance, &use_of_it, &faults);
            }
        }
    }

    /// Reads the lists of pairs that an instance makes and that others wait for.
    fn read_lists(&mut self, instance: usize) {
        let lists = self.plan.waiting_lists(instance);
        let Some(outcome) = self.states[instance].outcome().cloned().filter(|_| !lists.is_empty()) else { return };
        for list in lists {
            match partners_of(&outcome, list.1, self.store) {
                Ok(partners) => {
                    self.plan.graph.partners.insert(list.clone(), partners);
                    self.told.push((instance, list));
                }
                Err(why) => return self.report_unexpanded(instance, PAIRS, &why, None),
            }
        }
    }

    /// Expands what waits for the lists of pairs that were read.
    pub fn grow_by_lists(&mut self) {
        let told = std::mem::take(&mut self.told);
        let Some((first, _)) = told.first() else { return };
        if let Err(faults) = self.grow() {
            told.iter().for_each(|(_, list)| _ = self.plan.graph.partners.remove(list));
            self.report_faults(*first, PAIRS, &faults);
        }
    }

    fn grow(&mut self) -> Result<(), Vec<Diagnostic>> {
        let hash = file_hash(self.store);
        let first = self.plan.grow(&hash)?;
        self.schedule_from(first);
        // What waits now may wait for a list that was made long ago.
        if !self.plan.lists.is_empty() {
            for instance in 0..first {
                if self.states[instance].is_delivered() {
                    self.read_lists(instance);
                }
            }
        }
        Ok(())
    }

    /// Nothing is left to do although not all is done: reported as a failure. Where pairs tell what is gathered, steps may wait for each
    /// other by way of items before, which no plan can see; elsewhere it is a fault of this program.
    pub fn report_stuck(&mut self) {
        if self.failed {
            return;
        }
        let is_open = |instance: &usize| {
            let state = &self.states[*instance];
            state.outcome().is_none() && !state.is_failed()
        };
        let stuck = (0..self.states.len()).find(is_open);
        let step = stuck.map(|instance| self.plan.instances[instance].step);
        let Some(step) = step.or_else(|| self.plan.lists.first().map(|list| list.0)) else { return };
        self.failed = true;
        let label = stuck.map_or_else(|| self.plan.graph.steps[step].name.clone(), |stuck| self.plan.label(stuck));
        let stage = self.plan.graph.steps[step].stage.name().to_owned();
        let (message, hint) = if self.plan.graph.pairs_items() {
            (
                "it waits for steps that wait for it, by the pairs of a list and by way of items before",
                "let an item read from items before it, and pairs be made without what they tell",
            )
        } else {
            (
                "it was left undone although nothing that it needs is: a fault of rockface, not of the pipeline",
                "run again, what is done is kept; and please report it with the pipeline",
            )
        };
        self.report(&Event::Failed { step: label, stage, message: message.to_owned(), hint: Some(hint.to_owned()) });
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
        self.states.all_readers_are_there(self.plan).into_iter().for_each(|producer| self.release(producer));
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
