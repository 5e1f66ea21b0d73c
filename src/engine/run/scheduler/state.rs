//! The state of each step instance, and the one place where it changes.

use std::collections::BTreeMap;
use std::sync::Arc;

use rockface_cache::{Announced, Digest, KeyLock, Outcome, Recipe, SafeName};
use rockface_core::artefact::Artefact;

use super::phase::{Due, Phase, Purpose};
use crate::plan::Plan;
use crate::run::StepFailure;
use crate::run::spill::Spilled;

/// How far one step instance is, and what is known of its result.
pub struct State {
    phase: Phase,
    /// The key of its recipe, once all producers are done.
    pub key: Option<Digest>,
    /// That recipe, until it is on record.
    pub recipe: Option<Box<Recipe>>,
    /// Its stage ran in this run.
    pub executed: bool,
    /// Its outputs that are in memory.
    pub values: BTreeMap<&'static str, Arc<Artefact>>,
    /// Its outputs spilled to disk, or brought there by another process.
    pub spilled: BTreeMap<&'static str, Arc<Spilled>>,
    /// The locks by which other processes see that an output is here although it is not in the store.
    pub announced: BTreeMap<&'static str, Arc<Announced>>,
    /// The number of consumers that may still ask for the values.
    pub users: usize,
    /// One of them stands for consumers that the plan does not have yet.
    awaits_readers: bool,
    /// Instances that wait for the values.
    pub wanted_by: Vec<usize>,
}

/// The states of all instances, and how many are closed: done or failed.
pub struct States {
    list: Vec<State>,
    /// The step of each instance.
    steps: Vec<usize>,
    closed: usize,
    /// The number of instances that are not closed, by step.
    open: Vec<usize>,
}

impl States {
    /// The instances of a plan, all waiting.
    pub fn new(plan: &Plan) -> Self {
        let mut unmet = vec![0; plan.instances.len()];
        for dependent in plan.instances.iter().flat_map(|instance| &instance.dependents) {
            unmet[*dependent] += 1;
        }
        let states = plan.instances.iter().zip(unmet);
        let list = states.map(|(instance, unmet)| State::new(unmet, instance.dependents.len())).collect();
        let steps: Vec<usize> = plan.instances.iter().map(|instance| instance.step).collect();
        let mut open = vec![0; plan.graph.steps.len()];
        steps.iter().for_each(|step| open[*step] += 1);
        let mut states = Self { list, steps, closed: 0, open };
        states.await_readers(plan, 0);
        states
    }

    /// Has the instances from number `from` on hold their values for consumers that the plan does not have yet.
    fn await_readers(&mut self, plan: &Plan, from: usize) {
        let awaits = plan.awaits_readers();
        if !awaits.contains(&true) {
            return;
        }
        for (state, _) in self.list.iter_mut().zip(&self.steps).skip(from).filter(|(_, step)| awaits[**step]) {
            (state.users, state.awaits_readers) = (state.users + 1, true);
        }
    }

    /// The instances that held their values for consumers which the plan has by now: each has a user that will not come.
    pub fn all_readers_are_there(&mut self, plan: &Plan) -> Vec<usize> {
        let awaits = plan.awaits_readers();
        let (states, steps) = (self.list.iter_mut().enumerate(), &self.steps);
        let there = states.filter(|(number, state)| state.awaits_readers && !awaits[steps[*number]]);
        there
            .map(|(number, state)| {
                state.awaits_readers = false;
                number
            })
            .collect()
    }

    /// Adds the instances that the plan has from number `from` on.
    pub fn grow(&mut self, plan: &Plan, from: usize) {
        for instance in &plan.instances[from..] {
            self.list.push(State::new(0, instance.dependents.len()));
            self.steps.push(instance.step);
            self.open[instance.step] += 1;
        }
        for instance in from..plan.instances.len() {
            let mut waited_for = 0;
            for producer in plan.producers(instance) {
                // The users of earlier instances were counted without the new ones.
                self.list[producer].users += usize::from(producer < from);
                // A producer that has notified its consumers will not do so again.
                waited_for += usize::from(!self.list[producer].is_delivered());
            }
            self.list[instance].phase = Phase::Waiting { unmet: waited_for };
        }
        self.await_readers(plan, from);
    }

    /// Reorders the states; `former` has the former number of each.
    pub fn reorder(&mut self, former: &[usize]) {
        let mut list: Vec<Option<State>> = std::mem::take(&mut self.list).into_iter().map(Some).collect();
        self.list = former.iter().filter_map(|old| list[*old].take()).collect();
        self.steps = former.iter().map(|old| self.steps[*old]).collect();
    }

    /// The instance has to run, for this purpose.
    pub fn make_due(&mut self, instance: usize, purpose: Purpose) {
        self.change(instance, |_| Phase::due(purpose));
    }

    /// The outcome is known but its values are needed; does nothing unless the instance is done. Returns whether it was.
    pub fn reopen(&mut self, instance: usize) -> bool {
        let is_done = self.list[instance].is_done();
        self.change(instance, |phase| match phase {
            Phase::Done { outcome, .. } => Phase::due(Purpose::Recompute { former: outcome }),
            other => other,
        });
        is_done
    }

    /// A worker takes the instance, and with it the lock of its key if that is held.
    pub fn start(&mut self, instance: usize) -> Option<KeyLock> {
        let mut lease = None;
        self.change(instance, |phase| match phase {
            Phase::Due(due) => {
                lease = due.lease;
                Phase::Running(due.purpose)
            }
            other => other,
        });
        lease
    }

    /// A worker gave the instance back: it is due again.
    pub fn give_back(&mut self, instance: usize) {
        self.change(instance, |phase| match phase {
            Phase::Running(purpose) => Phase::due(purpose),
            other => other,
        });
    }

    /// The outcome is known. Returns the former one if the instance was recomputed.
    pub fn finish(&mut self, instance: usize, outcome: Outcome) -> Option<Outcome> {
        let mut former = None;
        self.change(instance, |phase| {
            former = phase.into_former();
            Phase::Done { outcome, delivered: former.is_some() }
        });
        former
    }

    /// Values need not be recomputed any more: the former outcome holds.
    pub fn restore(&mut self, instance: usize) {
        self.change(instance, |phase| match phase {
            Phase::Due(Due { purpose: Purpose::Recompute { former }, .. }) => {
                Phase::Done { outcome: former, delivered: true }
            }
            other => other,
        });
    }

    /// The instance cannot be done; `cause` is the failure of its own stage.
    pub fn fail(&mut self, instance: usize, cause: Option<Box<StepFailure>>) {
        self.change(instance, |_| Phase::Failed(cause));
    }

    /// The only place where a phase changes after the instance was added.
    fn change(&mut self, instance: usize, next: impl FnOnce(Phase) -> Phase) {
        let state = &mut self.list[instance];
        let before = state.phase.is_closed();
        state.phase = next(std::mem::replace(&mut state.phase, Phase::Failed(None)));
        let open = &mut self.open[self.steps[instance]];
        match (before, state.phase.is_closed()) {
            (false, true) => (self.closed, *open) = (self.closed + 1, *open - 1),
            (true, false) => (self.closed, *open) = (self.closed - 1, *open + 1),
            _ => {}
        }
    }

    /// The number of instances.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// The number of instances that are done or failed.
    pub fn closed(&self) -> usize {
        self.closed
    }

    /// The number of instances that are neither, by step.
    pub fn open(&self) -> &[usize] {
        &self.open
    }

    /// All states, by instance.
    pub fn into_list(self) -> Vec<State> {
        self.list
    }
}

impl std::ops::Index<usize> for States {
    type Output = State;
    fn index(&self, instance: usize) -> &State {
        &self.list[instance]
    }
}

impl std::ops::IndexMut<usize> for States {
    fn index_mut(&mut self, instance: usize) -> &mut State {
        &mut self.list[instance]
    }
}

impl State {
    fn new(unmet: usize, users: usize) -> Self {
        Self {
            phase: Phase::Waiting { unmet },
            key: None,
            recipe: None,
            executed: false,
            values: BTreeMap::new(),
            spilled: BTreeMap::new(),
            announced: BTreeMap::new(),
            users,
            awaits_readers: false,
            wanted_by: Vec::new(),
        }
    }

    /// What is known of it while it is due.
    pub fn due(&self) -> Option<&Due> {
        if let Phase::Due(due) = &self.phase { Some(due) } else { None }
    }

    /// [`State::due`], to be changed.
    pub fn due_mut(&mut self) -> Option<&mut Due> {
        if let Phase::Due(due) = &mut self.phase { Some(due) } else { None }
    }

    /// Whether all its producers are done and no worker has it yet.
    pub fn is_due(&self) -> bool {
        self.due().is_some()
    }

    /// Whether it waits for producers, for values, or for a worker.
    pub fn is_pending(&self) -> bool {
        matches!(self.phase, Phase::Waiting { .. } | Phase::Due(_))
    }

    /// Whether all its producers are done and nothing was decided about it since.
    pub fn is_unsettled(&self) -> bool {
        matches!(self.phase, Phase::Waiting { unmet: 0 })
    }

    /// Whether its outcome is known and its values are at hand or not asked for.
    pub fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done { .. })
    }

    /// Whether it failed, or something it needs did.
    pub fn is_failed(&self) -> bool {
        matches!(self.phase, Phase::Failed(_))
    }

    /// Whether its outcome is known and its values are being recomputed.
    pub fn is_recompute(&self) -> bool {
        matches!(self.phase, Phase::Running(Purpose::Recompute { .. })) || self.due().is_some_and(Due::is_recompute)
    }

    /// Whether a record exists, though the stage has to run.
    pub fn is_recorded(&self) -> bool {
        match &self.phase {
            Phase::Due(Due { purpose, .. }) | Phase::Running(purpose) => {
                !matches!(purpose, Purpose::Compute { recorded: false })
            }
            _ => false,
        }
    }

    /// Whether its consumers have been notified that its outcome is known.
    pub fn is_delivered(&self) -> bool {
        matches!(self.phase, Phase::Done { delivered: true, .. }) || self.is_recompute()
    }

    /// One producer fewer is waited for. Returns whether it was the last.
    pub fn meet(&mut self) -> bool {
        let Phase::Waiting { unmet } = &mut self.phase else { return false };
        *unmet = unmet.saturating_sub(1);
        *unmet == 0
    }

    /// How many producers it waits for.
    pub fn unmet(&self) -> usize {
        if let Phase::Waiting { unmet } = &self.phase { *unmet } else { 0 }
    }

    /// Its consumers are being notified.
    pub fn set_delivered(&mut self) {
        if let Phase::Done { delivered, .. } = &mut self.phase {
            *delivered = true;
        }
    }

    /// What its record says: the former outcome while it is recomputed.
    pub fn outcome(&self) -> Option<&Outcome> {
        self.phase.outcome()
    }

    /// The outcome if it is done, and why its stage failed if it did.
    pub fn into_result(self) -> (Option<Outcome>, Option<StepFailure>) {
        self.phase.into_result()
    }

    /// Whether this output is in memory or in a file of this run.
    pub fn holds(&self, port: &str) -> bool {
        self.values.contains_key(port) || self.spilled.contains_key(port)
    }
}

/// Whether two outcomes have the same outputs, kept or not.
pub fn same_outputs(one: &Outcome, other: &Outcome) -> bool {
    fn digests(outcome: &Outcome) -> impl Iterator<Item = (&SafeName, Digest)> {
        outcome.outputs.iter().map(|(port, output)| (port, output.digest))
    }
    digests(one).eq(digests(other))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_cache::{Cost, Outputs};

    fn outcome(log: &[u8]) -> Outcome {
        Outcome { outputs: Outputs::default(), log: Some(Digest::of(log)), sketches: None, cost: Cost::default() }
    }

    fn one() -> States {
        States { list: vec![State::new(2, 0)], steps: vec![0], closed: 0, open: vec![1] }
    }

    #[test]
    fn an_instance_is_due_when_its_last_producer_is_done_and_closed_when_its_outcome_is_known() {
        let mut states = one();
        assert!(!states[0].meet() && states[0].meet() && states[0].is_unsettled());
        states.make_due(0, Purpose::Compute { recorded: false });
        assert!(states[0].is_due() && !states[0].is_recorded() && !states[0].meet());
        assert!(states.start(0).is_none() && !states[0].is_pending());
        states.give_back(0);
        assert!(states[0].is_due() && states.closed() == 0);
        states.start(0);
        assert!(states.finish(0, outcome(b"1")).is_none() && states[0].is_done());
        assert_eq!((states.closed(), states.open()), (1, &[0][..]));
        assert!(!states[0].is_delivered(), "consumers are notified by a turn of their own");
        states[0].set_delivered();
        assert!(states[0].is_delivered());
    }

    #[test]
    fn a_recomputed_instance_keeps_its_former_outcome_until_it_has_another() {
        let mut states = one();
        assert!(!states.reopen(0), "nothing is known yet");
        states.finish(0, outcome(b"1"));
        states[0].set_delivered();
        assert!(states.reopen(0) && !states.reopen(0));
        assert_eq!((states.closed(), states.open()), (0, &[1][..]));
        assert!(states[0].is_recompute() && states[0].is_recorded() && states[0].outcome() == Some(&outcome(b"1")));
        states.restore(0);
        assert!(states[0].is_done() && states[0].is_delivered());
        states.reopen(0);
        states.start(0);
        states.restore(0);
        assert!(states[0].is_recompute(), "what a worker has is not called off");
        assert_eq!(states.finish(0, outcome(b"2")), Some(outcome(b"1")));
        assert!(states[0].is_delivered() && states[0].outcome() == Some(&outcome(b"2")) && states.closed() == 1);
    }

    #[test]
    fn a_failed_instance_has_a_cause_and_no_outcome_and_is_not_reopened() {
        let mut states = one();
        states.finish(0, outcome(b"1"));
        states.reopen(0);
        states.fail(0, Some(Box::new(StepFailure { message: "no rock".to_owned(), ..StepFailure::default() })));
        assert!(states[0].is_failed() && states[0].outcome().is_none() && !states.reopen(0) && states.closed() == 1);
        let (outcome, failure) = states.into_list().remove(0).into_result();
        assert!(outcome.is_none() && failure.is_some_and(|failure| failure.message == "no rock"));
    }
}
