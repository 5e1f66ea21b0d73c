//! Why a step instance would run: its recipe now against the recipes on record, up to the root cause.

mod answers;
mod difference;
mod former;
mod versions;

pub use answers::{Answer, Answers, Why};
pub use difference::{Change, InputPlace};
pub use versions::Versions;

use difference::Parts;
use std::path::Path;

use rockface_cache::{Digest, Recipe, Record, Store};

use crate::history::{self, PastRun, StepDone};
use crate::plan::Plan;

/// The answer of `explain` for one instance.
pub struct Explanation {
    /// The instance asked for.
    pub asked: usize,
    /// The instance explained: the one asked for, or the first upstream that would run before it.
    pub explained: usize,
    /// The recipe of the explained instance, as the pipeline stands now.
    pub recipe: Recipe,
    /// From the explained instance up to the root cause; empty where the recipe is on record.
    pub causes: Vec<Cause>,
    /// Where another instance is explained: the version of the stage of the one asked for, on record and now, if no result on record has that of
    /// this program.
    pub version: Option<String>,
}

/// What changed at one instance.
pub struct Cause {
    /// The instance whose recipe changed, by its number in the plan.
    pub instance: usize,
    /// The records of its stage that were looked at: all, or for a producer those that made the former input.
    pub records: usize,
    /// The record that this very instance had in the last run that computed or used another, else the closest of all; `None` when there is none.
    pub former: Option<Former>,
    /// Whether that is the record of this very instance.
    pub is_own: bool,
}

/// The record an instance is compared with.
pub struct Former {
    /// The key under which the store has this record.
    pub key: Digest,
    /// The latest run whose folder names it; `None` where none does any more.
    pub run: Option<String>,
    /// The components in which the recipe differs now from the one on record.
    pub changes: Vec<Change>,
}

/// Explains an instance, naming former runs by their folders in `runs`; `None` when the plan is not what the answers are for.
pub fn explain(plan: &Plan, store: &Store, answers: &Answers, asked: usize, runs: &Path) -> Option<Explanation> {
    let mut explained = asked;
    loop {
        explained = match answers.list()[explained] {
            Answer::Depends(producer) => producer,
            Answer::Same(leader) if explained != asked => leader,
            _ => break,
        };
    }
    let recipe = answers.recipe(explained)?;
    let is_new = matches!(answers.list()[explained], Answer::Runs(Why::New) | Answer::Same(_));
    let past = if is_new { history::runs_of(runs, &plan.graph.name, LOOKED_AT) } else { Vec::new() };
    let mut causes = if is_new { causes(plan, store, answers, explained, &recipe, &past) } else { Vec::new() };
    for former in causes.iter_mut().filter_map(|cause| cause.former.as_mut()) {
        former.run = former::run_naming(runs, &former.key);
    }
    let version = if explained == asked { None } else { Versions::on_record(store).change(plan, asked) };
    Some(Explanation { asked, explained, recipe, causes, version })
}

/// The runs of a pipeline, from the last on, in which the former record of an instance is looked for.
const LOOKED_AT: usize = 5;

/// Follows the first changed input to its producer, and on, until nothing upstream changed; `past` are runs of the pipeline, the last first.
fn causes(
    plan: &Plan,
    store: &Store,
    answers: &Answers,
    instance: usize,
    recipe: &Recipe,
    past: &[PastRun],
) -> Vec<Cause> {
    let mut causes = vec![against(plan, store, instance, recipe, past, |_| true)];
    while let Some((producer, port, old)) = causes.last().and_then(|cause| changed_input(plan, cause)) {
        let Some(recipe) = answers.recipe(producer) else { break };
        let made_it = |record: &Record| record.outputs.get(port).is_some_and(|output| output.digest == old);
        causes.push(against(plan, store, producer, &recipe, past, made_it));
    }
    causes
}

/// An instance against the record that it had in the last run that had another one; without such a run against the closest record.
fn against(
    plan: &Plan,
    store: &Store,
    instance: usize,
    recipe: &Recipe,
    past: &[PastRun],
    counts: impl Fn(&Record) -> bool,
) -> Cause {
    let (step, point) = (&plan.step(instance).name, plan.point(instance));
    let is_this = |done: &&StepDone| done.step == *step && done.point == point;
    let keys = past.iter().filter_map(|run| run.manifest.steps.iter().find(is_this)?.key);
    let own = keys.filter(|key| *key != recipe.key()).find_map(|key| {
        let record = store.record(&key).filter(|record| record.recipe.stage == recipe.stage && counts(record))?;
        Some(Former { key, run: None, changes: Parts::of(recipe).changes_from(&Parts::of(&record.recipe)) })
    });
    let closest = most_like(store, instance, recipe, counts);
    if own.is_none() { closest } else { Cause { former: own, is_own: true, ..closest } }
}

/// The producer and the port of the first input that changed, and what it was before.
fn changed_input(plan: &Plan, cause: &Cause) -> Option<(usize, &'static str, Digest)> {
    cause.former.as_ref()?.changes.iter().find_map(|change| {
        let (place, old) = (change.input.as_ref()?, change.old_digest()?);
        let (_, given) = plan.instances[cause.instance].inputs.iter().find(|(port, _)| *port == place.port)?;
        let given = given.iter().find(|given| given.point == place.point)?;
        Some((given.instance, given.port, old))
    })
}

/// The record of the same stage with the fewest differing components; of equals the latest, then the least key.
fn most_like(store: &Store, instance: usize, recipe: &Recipe, counts: impl Fn(&Record) -> bool) -> Cause {
    let now = Parts::of(recipe);
    let mut cause = Cause { instance, records: 0, former: None, is_own: false };
    let mut best = (usize::MAX, 0);
    for key in store.keys() {
        let Some(record) = store.record(&key).filter(|record| record.recipe.stage == recipe.stage && counts(record))
        else {
            continue;
        };
        cause.records += 1;
        let changes = now.changes_from(&Parts::of(&record.recipe));
        let rank = (changes.len(), u64::MAX - record.cost.finished_unix_s);
        if cause.former.is_none() || rank < best {
            (best, cause.former) = (rank, Some(Former { key, run: None, changes }));
        }
    }
    cause
}
