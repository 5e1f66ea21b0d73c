//! What a plan says about the time its steps will take: what is known from records, and what is not known.

use std::collections::{BTreeMap, HashMap};

use rockface_cache::Store;
use rockface_engine::explain::{Answer, Versions};
use rockface_engine::plan::{Plan, Unknown, Wait};
use rockface_engine::watch::duration;
use serde_json::Value;

/// What records say of instances: the elapsed seconds of those that were alike and how many there were, and versions of stages.
#[derive(Default)]
pub struct OnRecord {
    alike: HashMap<String, (f64, u32)>,
    /// The versions of stages on record.
    pub versions: Versions,
}

impl OnRecord {
    /// Those of all records of a store.
    pub fn new(store: &Store) -> Self {
        let mut times = Self::default();
        for record in store.keys().iter().filter_map(|key| store.record(key)) {
            times.versions.add(&record.recipe);
            for likeness in likenesses(&record.recipe.stage, &record.recipe.params) {
                let (wall_s, count) = times.alike.entry(likeness).or_default();
                *wall_s += record.cost.wall_s;
                *count += 1;
            }
        }
        times
    }

    /// The mean of the instances closest to this one; `None` where no step of its stage is on record.
    pub fn expected_s(&self, plan: &Plan, instance: usize) -> Option<f64> {
        let params = &plan.instances[instance].params.recipe;
        let mut alike = likenesses(plan.step(instance).stage.name(), params).into_iter();
        alike.find_map(|likeness| self.alike.get(&likeness)).map(|(wall_s, count)| wall_s / f64::from(*count))
    }
}

/// What instances that take about as long have in common, the most telling first: the stage and the parameters but for
/// their numbers, which a sweep changes; but for those in texts too, such as the arguments of a program; the stage.
fn likenesses(stage: &str, params: &Value) -> [String; 3] {
    let without = params_without_numbers(params).to_string();
    let numberless: String = without.split(|letter: char| letter.is_ascii_digit()).collect();
    [format!("{stage} {without}"), format!("{stage} {numberless}"), stage.to_owned()]
}

fn params_without_numbers(value: &Value) -> Value {
    match value {
        Value::Number(_) => Value::Null,
        Value::Array(list) => list.iter().map(params_without_numbers).collect(),
        Value::Object(map) => map.iter().map(|(key, value)| (key.clone(), params_without_numbers(value))).collect(),
        other => other.clone(),
    }
}

impl OnRecord {
    /// The mean of all steps of a stage.
    fn of_stage(&self, stage: &str) -> Option<f64> {
        self.alike.get(stage).map(|(wall_s, count)| wall_s / f64::from(*count))
    }
}

/// Steps over an axis whose items are made by a step that has not run.
#[derive(Debug, Default)]
struct Later {
    steps: usize,
    /// Expected seconds of one item.
    item_s: f64,
    /// Instances of one item whose stage was never timed, by stage.
    untimed: BTreeMap<String, usize>,
}

/// The time that the open steps of a plan will take.
#[derive(Debug, Default)]
pub struct Work {
    timed: usize,
    timed_s: f64,
    /// Instances whose stage was never timed, by stage.
    untimed: BTreeMap<String, usize>,
    /// By name of the axis.
    later: BTreeMap<String, Later>,
}

/// Stages named where several were never timed.
const NAMED: usize = 4;

impl Work {
    /// Adds up what is open.
    pub fn of(plan: &Plan, answers: &[Answer], times: &OnRecord) -> Self {
        let mut work = Self::default();
        for instance in (0..answers.len()).filter(|instance| answers[*instance].is_open()) {
            match times.expected_s(plan, instance) {
                Some(wall_s) => {
                    work.timed += 1;
                    work.timed_s += wall_s;
                }
                None => *work.untimed.entry(plan.step(instance).stage.name().to_owned()).or_default() += 1,
            }
        }
        let (graph, wanted) = (&plan.graph, plan.graph.wanted());
        for (step, unknown) in plan.unknown().into_iter().enumerate().filter(|(step, _)| wanted[*step]) {
            let axis = match unknown {
                Some(Unknown::Items(axis)) => axis,
                Some(Unknown::Pairs(Wait { count, .. })) => {
                    work.add(graph.steps[step].stage.name(), count, times);
                    continue;
                }
                None => continue,
            };
            let later = work.later.entry(graph.axes[axis].name.text.clone()).or_default();
            later.steps += 1;
            // A step that gathers all items is one however many there are.
            let items = if graph.steps[step].axes.iter().any(|own| graph.is_pending(*own)) {
                known_items(plan, step)
            } else {
                0
            };
            let stage = graph.steps[step].stage.name();
            match times.of_stage(stage) {
                Some(wall_s) => later.item_s += wall_s * items as f64,
                None if items > 0 => *later.untimed.entry(stage.to_owned()).or_default() += items,
                None => {}
            }
        }
        work
    }

    /// Adds instances of a stage that are not in the plan yet.
    fn add(&mut self, stage: &str, count: usize, times: &OnRecord) {
        match times.of_stage(stage) {
            Some(wall_s) => {
                self.timed += count;
                self.timed_s += wall_s * count as f64;
            }
            None => *self.untimed.entry(stage.to_owned()).or_default() += count,
        }
    }

    /// What is printed; nothing where nothing is open.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let untimed: usize = self.untimed.values().sum();
        let record = format!("{} of work, going by {} steps of stages on record", duration(self.timed_s), self.timed);
        match (self.timed, untimed) {
            (0, 0) => {}
            (_, 0) if self.later.is_empty() => lines.push(format!("up to about {record}")),
            (_, 0) => lines.push(format!("about {record}, and what is not known yet")),
            (0, _) => lines.push(format!("how long {untimed} steps take is not known: {}", never(&self.untimed))),
            _ => lines.push(format!(
                "about {record}; how long {untimed} other steps take is not known: {}",
                never(&self.untimed)
            )),
        }
        for (axis, later) in &self.later {
            let mut parts = Vec::new();
            if later.item_s > 0.0 {
                parts.push(format!("each item adds about {}", duration(later.item_s)));
            }
            if !later.untimed.is_empty() {
                let count: usize = later.untimed.values().sum();
                parts.push(format!("each item adds {count} steps of unknown length: {}", never(&later.untimed)));
            }
            let added = if parts.is_empty() { String::new() } else { format!("; {}", parts.join(", ")) };
            lines.push(format!(
                "not counted: {} steps over axis `{axis}`, whose items are not known yet{added}",
                later.steps
            ));
        }
        lines
    }
}

/// The number of instances of a step at one item of each axis that is not known yet.
fn known_items(plan: &Plan, step: usize) -> usize {
    let graph = &plan.graph;
    let mut zips: Vec<usize> = Vec::new();
    let mut items = 1usize;
    for axis in graph.steps[step].axes.iter().filter(|axis| !graph.is_pending(**axis)) {
        // Axes that are walked together count once, and not at all together with one that is not known.
        let pending = graph.mates(*axis).any(|mate| graph.is_pending(mate));
        if !pending && !zips.contains(&graph.zips[*axis]) {
            zips.push(graph.zips[*axis]);
            items = items.saturating_mul(graph.axes[*axis].items.len());
        }
    }
    items
}

/// Stages that were never timed, the most frequent first.
fn never(untimed: &BTreeMap<String, usize>) -> String {
    let mut stages: Vec<(&String, &usize)> = untimed.iter().collect();
    stages.sort_by(|a, b| b.1.cmp(a.1).then(a.0.cmp(b.0)));
    let mut named: Vec<String> =
        stages.iter().take(NAMED).map(|(stage, count)| format!("{count} of {stage}")).collect();
    if stages.len() > NAMED {
        named.push(format!("{} more stages", stages.len() - NAMED));
    }
    format!("no step of these stages is on record ({})", named.join(", "))
}
