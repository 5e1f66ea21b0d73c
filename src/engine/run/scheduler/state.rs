//! What the scheduler knows of each step instance, and the one place where that changes.

use std::collections::BTreeMap;
use std::sync::Arc;

use rockface_cache::{Announced, Digest, KeyLock, Outcome, Recipe, SafeName};
use rockface_core::artefact::Artefact;

use super::spill::Spilled;
use crate::plan::Plan;
use crate::run::StepFailure;

/// How far an instance is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Some producer is not done.
    Waiting,
    /// Waits for a producer's values to be made again, for a worker, or for its twin.
    Due,
    /// A worker has it.
    Running,
    /// Its record is known.
    Done,
    /// It failed, or something it needs did.
    Failed,
}

impl Status {
    fn is_closed(self) -> bool {
        matches!(self, Self::Done | Self::Failed)
    }
}

/// One instance.
pub struct State {
    status: Status,
    /// Producers that are not done.
    pub unmet: usize,
    /// Producers whose values are being made again for this one.
    pub missing: usize,
    /// The key of its recipe, once all producers are done.
    pub key: Option<Digest>,
    /// That recipe, until it is on record.
    pub recipe: Option<Box<Recipe>>,
    /// What its record says.
    pub outcome: Option<Outcome>,
    /// Its stage ran in this run.
    pub executed: bool,
    /// Why its stage gave up, if it did.
    pub failure: Option<Box<StepFailure>>,
    /// A record has its recipe, but outputs that are needed are not in the store.
    pub recorded: bool,
    /// It was told that it waits for memory.
    pub held: bool,
    /// It was told that another process has its key, and that there is nothing else to do.
    pub waited_for: bool,
    /// Other processes were asked for its values.
    pub asked: bool,
    /// The lock of its key, from when its values are to be made again until a worker has it.
    pub lease: Option<KeyLock>,
    /// It is being made again for its values, though its record is known.
    pub remaking: bool,
    /// A producer came out otherwise when it was made again: its recipe has to be looked at anew.
    pub again: bool,
    /// Its outputs, as far as they are in memory.
    pub values: BTreeMap<&'static str, Arc<Artefact>>,
    /// Its outputs that are in no store, as far as memory had no room for them.
    pub spilled: BTreeMap<&'static str, Arc<Spilled>>,
    /// Of these, what other processes see that it is here, since it is in no store.
    pub announced: BTreeMap<&'static str, Arc<Announced>>,
    /// Consumers that may still ask for the values.
    pub users: usize,
    /// Instances that wait for the values.
    pub wanted_by: Vec<usize>,
}

/// The states of all instances, and how many are closed.
pub struct States {
    list: Vec<State>,
    /// Step of each instance.
    steps: Vec<usize>,
    /// Instances that are done or failed.
    closed: usize,
    /// Instances that are neither, by step.
    open: Vec<usize>,
}

impl States {
    /// Every instance waits.
    pub fn new(plan: &Plan) -> Self {
        let mut list: Vec<State> =
            plan.instances.iter().map(|instance| State::new(instance.dependents.len())).collect();
        for dependent in plan.instances.iter().flat_map(|instance| &instance.dependents) {
            list[*dependent].unmet += 1;
        }
        let steps: Vec<usize> = plan.instances.iter().map(|instance| instance.step).collect();
        let mut open = vec![0; plan.graph.steps.len()];
        steps.iter().for_each(|step| open[*step] += 1);
        Self { list, steps, closed: 0, open }
    }

    /// Takes in the instances that were added to the plan from a number on.
    pub fn grow(&mut self, plan: &Plan, from: usize) {
        for instance in &plan.instances[from..] {
            self.list.push(State::new(instance.dependents.len()));
            self.steps.push(instance.step);
            self.open[instance.step] += 1;
        }
        for instance in from..plan.instances.len() {
            for producer in plan.producers(instance) {
                // Instances that were there before know of none of these.
                self.list[producer].users += usize::from(producer < from);
                // A producer whose outcome is known will not tell of it again.
                self.list[instance].unmet += usize::from(self.list[producer].outcome.is_none());
            }
        }
    }

    /// Puts the states in another order; `former` has the former number of each.
    pub fn reorder(&mut self, former: &[usize]) {
        let mut list: Vec<Option<State>> = std::mem::take(&mut self.list).into_iter().map(Some).collect();
        self.list = former.iter().filter_map(|old| list[*old].take()).collect();
        self.steps = former.iter().map(|old| self.steps[*old]).collect();
    }

    /// The only place where a status changes.
    pub fn set(&mut self, instance: usize, status: Status) {
        let state = &mut self.list[instance];
        let (before, after) = (state.status.is_closed(), status.is_closed());
        state.status = status;
        let open = &mut self.open[self.steps[instance]];
        match (before, after) {
            (false, true) => (self.closed, *open) = (self.closed + 1, *open - 1),
            (true, false) => (self.closed, *open) = (self.closed - 1, *open + 1),
            _ => {}
        }
    }

    /// How many instances there are.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// How many are done or failed.
    pub fn closed(&self) -> usize {
        self.closed
    }

    /// How many are neither, by step.
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
    fn new(users: usize) -> Self {
        Self {
            status: Status::Waiting,
            unmet: 0,
            missing: 0,
            key: None,
            recipe: None,
            outcome: None,
            executed: false,
            failure: None,
            recorded: false,
            held: false,
            waited_for: false,
            asked: false,
            lease: None,
            remaking: false,
            again: false,
            values: BTreeMap::new(),
            spilled: BTreeMap::new(),
            announced: BTreeMap::new(),
            users,
            wanted_by: Vec::new(),
        }
    }

    /// How far it is.
    pub fn status(&self) -> Status {
        self.status
    }

    /// Whether this output is in memory, or in a file until nobody needs it.
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
