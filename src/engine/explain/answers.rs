//! What a run would do with every step instance, and why; from records, without reading a blob.

use std::collections::HashMap;

use rockface_cache::{Digest, Outcome, Recipe, Store};

use crate::plan::Plan;

/// What a run would do with one instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Its record is there.
    Hit,
    /// It has the recipe of this instance, which would run: the record will be there.
    Same(usize),
    /// It would run, for this reason.
    Runs(Why),
    /// It depends on this instance, which would run or depends on another.
    Depends(usize),
    /// It is recorded and keeps no outputs, and this instance, which depends on what runs, may need them.
    Lends(usize),
}

/// Why an instance would run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Why {
    /// No record has its recipe.
    New,
    /// A record has it, but an output it names is gone.
    Gone,
    /// A record has it, but the outputs were not kept then, and are to be kept now.
    Unkept,
    /// It is recorded and keeps no outputs, and something that runs needs them.
    Needed,
}

impl Answer {
    /// Whether it would or may run.
    pub fn is_open(self) -> bool {
        !matches!(self, Self::Hit | Self::Same(_))
    }

    /// One word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Hit | Self::Same(_) => "hit",
            Self::Runs(_) => "runs",
            Self::Depends(_) | Self::Lends(_) => "depends",
        }
    }

    /// Why it is not a hit.
    pub fn why(self, plan: &Plan) -> Option<String> {
        match self {
            Self::Hit => None,
            Self::Runs(Why::New) => Some("no record has this recipe".into()),
            Self::Runs(Why::Gone) => Some("an output is gone from the store".into()),
            Self::Runs(Why::Unkept) => Some("its outputs were not kept and now are to be".into()),
            Self::Runs(Why::Needed) => Some("its values are needed".into()),
            Self::Same(leader) => Some(format!("the same as {}", plan.label(leader))),
            Self::Depends(producer) => Some(format!("waits for {}", plan.label(producer))),
            Self::Lends(consumer) => Some(format!("its values may be needed by {}", plan.label(consumer))),
        }
    }
}

/// The answers for all instances of a plan.
pub struct Answers<'a> {
    plan: &'a Plan,
    list: Vec<Answer>,
    /// What is recorded, for hits and for what runs only because its values are needed.
    outcomes: Vec<Option<Outcome>>,
    /// The keys, where they are known.
    keys: Vec<Option<Digest>>,
}

impl<'a> Answers<'a> {
    /// Keys come from records, producers before consumers; then what is to run calls for what was not kept. Of equal
    /// recipes one runs, and is served before it calls.
    pub fn new(plan: &'a Plan, store: &Store) -> Self {
        let count = plan.instances.len();
        let (list, outcomes, keys) = (Vec::with_capacity(count), Vec::with_capacity(count), Vec::with_capacity(count));
        let mut answers = Self { plan, list, outcomes, keys };
        for instance in 0..count {
            let (answer, outcome, key) = answers.look_up(store, instance);
            answers.list.push(answer);
            answers.outcomes.push(outcome);
            answers.keys.push(key);
        }
        answers.fold_twins();
        answers.call_for_values(store);
        answers.fold_twins();
        answers
    }

    /// The answers, by instance.
    pub fn list(&self) -> &[Answer] {
        &self.list
    }

    /// The instances that are on record, each with its key.
    pub fn hits(&self) -> impl Iterator<Item = (usize, Digest)> {
        let hit = |instance: &usize| self.list[*instance] == Answer::Hit;
        (0..self.list.len()).filter(hit).filter_map(|instance| Some((instance, self.keys[instance]?)))
    }

    /// The recipe of an instance, if all its inputs are known.
    pub fn recipe(&self, instance: usize) -> Option<Recipe> {
        let given = self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let known = given.into_iter().all(|given| self.output(given.instance, given.port).is_some());
        known.then(|| self.plan.recipe(instance, |i, port| self.output(i, port).unwrap_or_else(|| Digest::of(b""))))
    }

    fn output(&self, instance: usize, port: &str) -> Option<Digest> {
        Some(self.outcomes[instance].as_ref()?.outputs.get(port)?.digest)
    }

    fn look_up(&self, store: &Store, instance: usize) -> (Answer, Option<Outcome>, Option<Digest>) {
        if let Some(producer) = self.producers(instance).find(|producer| self.list[*producer] != Answer::Hit) {
            return (Answer::Depends(producer), None, None);
        }
        let Some(key) = self.recipe(instance).map(|recipe| recipe.key()) else {
            return (Answer::Runs(Why::New), None, None);
        };
        let fits = |outcome: &Outcome| self.plan.fits(instance, outcome);
        let (answer, outcome) = match crate::plan::hit(store, &key, self.plan.step(instance).keep, fits) {
            Some(outcome) => (Answer::Hit, Some(outcome)),
            None if store.hit_outcome(&key).is_some() => (Answer::Runs(Why::Unkept), None),
            None if store.has_record(&key) => (Answer::Runs(Why::Gone), None),
            None => (Answer::Runs(Why::New), None),
        };
        (answer, outcome, Some(key))
    }

    /// Of the instances that run with one recipe, the first computes and the others take what it made.
    fn fold_twins(&mut self) {
        let mut leaders: HashMap<Digest, usize> = HashMap::new();
        for (instance, answer) in self.list.iter_mut().enumerate() {
            if let (Answer::Runs(_), Some(key)) = (*answer, self.keys[instance]) {
                let leader = *leaders.entry(key).or_insert(instance);
                *answer = if leader == instance { *answer } else { Answer::Same(leader) };
            }
        }
    }

    fn producers(&self, instance: usize) -> impl Iterator<Item = usize> {
        self.plan.instances[instance].inputs.iter().flat_map(|(_, given)| given.iter().map(|given| given.instance))
    }

    /// Producers that are recorded, but whose values are nowhere, run again for what is sure to run, and perhaps for what
    /// depends on that; consumers come last, so one pass from the end finds them all.
    fn call_for_values(&mut self, store: &Store) {
        for index in (0..self.list.len()).rev() {
            let called = match self.list[index] {
                Answer::Runs(_) => Answer::Runs(Why::Needed),
                Answer::Depends(_) | Answer::Lends(_) => Answer::Lends(index),
                Answer::Hit | Answer::Same(_) => continue,
            };
            for given in self.plan.instances[index].inputs.iter().flat_map(|(_, given)| given) {
                let is_open = match self.list[given.instance] {
                    Answer::Hit => true,
                    Answer::Lends(_) => matches!(called, Answer::Runs(_)),
                    _ => false,
                };
                let digest = self.output(given.instance, given.port);
                if is_open && digest.is_some_and(|digest| !store.contains(&digest)) {
                    self.list[given.instance] = called;
                }
            }
        }
    }
}
