//! `rockface plan`.

use std::collections::HashMap;

use clap::Args;
use rockface_cache::Store;
use rockface_core::Registry;
use serde_json::{Value, json};

use super::programs::ProgramArgs;
use super::{CliError, PipelineArgs, complain, say};
use rockface_engine::explain::{Answer, Answers};
use rockface_engine::plan::Plan;
use rockface_engine::run::tools;
use rockface_engine::watch::duration;

/// Arguments of `rockface plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    programs: ProgramArgs,
    /// Print every step instance, not only one line for each step.
    #[arg(long, short)]
    verbose: bool,
    /// Print the plan as JSON.
    #[arg(long)]
    json: bool,
}

impl PlanArgs {
    /// Prints the plan.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        let pipeline = self.pipeline.load(registry)?;
        self.programs.check(registry, &pipeline, &self.pipeline.target)?;
        let (plan, store) = self.pipeline.look(registry, &pipeline, &self.pipeline.target)?;
        let answers = Answers::new(&plan, &store);
        for (label, text) in tools::behind(&plan, &store, answers.hits()).changed {
            complain(&format!("warning: {label}: {text}"));
        }
        let is_timed = answers.list().iter().any(|answer| answer.is_open());
        let times = if is_timed { Times::new(&store) } else { Times::default() };
        if self.json {
            print_json(&plan, answers.list(), &times);
        } else {
            self.print(&plan, answers.list(), &times);
        }
        Ok(())
    }

    fn print(&self, plan: &Plan, answers: &[Answer], times: &Times) {
        let width = plan.graph.steps.iter().map(|step| step.name.chars().count()).max().unwrap_or(0).max(4);
        say(&format!("{:width$}  {:>9} {:>6} {:>6} {:>8}  why", "step", "instances", "hit", "runs", "depends"));
        let mut instances: Vec<Vec<usize>> = vec![Vec::new(); plan.graph.steps.len()];
        plan.instances.iter().enumerate().for_each(|(number, instance)| instances[instance.step].push(number));
        for (step, own) in plan.graph.steps.iter().zip(instances).filter(|(_, own)| !own.is_empty()) {
            let count = |word: &str| own.iter().filter(|i| answers[**i].word() == word).count();
            let why = own.iter().find_map(|i| answers[*i].why(plan)).unwrap_or_default();
            let (hit, runs, depends) = (count("hit"), count("runs"), count("depends"));
            say(&format!("{:width$}  {:>9} {hit:>6} {runs:>6} {depends:>8}  {why}", step.name, own.len()));
            if self.verbose {
                own.iter().for_each(|i| say(&format!("    {:8} {}", answers[*i].word(), plan.label(*i))));
            }
        }
        for (step, axis) in unknown(plan) {
            let why = format!("the items of axis `{axis}` are made by a step that has not run");
            say(&format!("{step:width$}  {:>9} {:>6} {:>6} {:>8}  {why}", "?", "", "", ""));
        }
        if let Some(line) = estimate(plan, answers, times) {
            say(&line);
        }
        let total = |word: &str| answers.iter().filter(|answer| answer.word() == word).count();
        say(&format!("{} hit, {} run, {} depend on what runs", total("hit"), total("runs"), total("depends")));
    }
}

/// The steps whose instances cannot be told yet, each with the axis it waits for.
fn unknown(plan: &Plan) -> Vec<(&str, &str)> {
    let graph = &plan.graph;
    let wanted = graph.wanted();
    let deferred = graph.deferred().into_iter().enumerate().filter(|(step, _)| wanted[*step]);
    let told = deferred
        .filter_map(|(step, axis)| Some((graph.steps[step].name.as_str(), graph.axes[axis?].name.text.as_str())));
    told.collect()
}

/// Elapsed seconds of instances that were alike, and how many there were, from records.
#[derive(Default)]
struct Times(HashMap<String, (f64, u32)>);

impl Times {
    fn new(store: &Store) -> Self {
        let mut times: HashMap<String, (f64, u32)> = HashMap::new();
        for record in store.keys().iter().filter_map(|key| store.record(key)) {
            for likeness in likenesses(&record.recipe.stage, &record.recipe.params) {
                let (wall_s, count) = times.entry(likeness).or_default();
                *wall_s += record.cost.wall_s;
                *count += 1;
            }
        }
        Self(times)
    }

    /// The mean of the instances closest to this one.
    fn expected_s(&self, plan: &Plan, instance: usize) -> Option<f64> {
        let params = &plan.instances[instance].params.recipe;
        let mut alike = likenesses(plan.step(instance).stage.name(), params).into_iter();
        alike.find_map(|likeness| self.0.get(&likeness)).map(|(wall_s, count)| wall_s / f64::from(*count))
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

/// How long the instances that are no hits would take one after the other, going by records of such.
fn estimate(plan: &Plan, answers: &[Answer], times: &Times) -> Option<String> {
    let open: Vec<usize> = (0..answers.len()).filter(|i| answers[*i].is_open()).collect();
    let known = open.iter().filter_map(|i| times.expected_s(plan, *i));
    let (count, seconds) = known.fold((0, 0.0), |(count, sum), wall_s| (count + 1, sum + wall_s));
    if count == 0 {
        return None;
    }
    let untimed =
        if count < open.len() { format!("; {} of stages never timed", open.len() - count) } else { String::new() };
    Some(format!("up to about {} of work, going by {count} steps of stages on record{untimed}", duration(seconds)))
}

fn print_json(plan: &Plan, answers: &[Answer], times: &Times) {
    let instances = answers.iter().enumerate().map(|(instance, answer)| {
        let step = plan.step(instance);
        let estimate_s = if answer.is_open() { times.expected_s(plan, instance) } else { None };
        json!({
            "step": step.name, "point": plan.point(instance), "answer": answer.word(), "why": answer.why(plan),
            "estimate_s": estimate_s,
        })
    });
    let unknown =
        unknown(plan).into_iter().map(|(step, axis)| json!({ "step": step, "answer": "unknown", "axis": axis }));
    say(&serde_json::to_string_pretty(&instances.chain(unknown).collect::<Vec<_>>()).unwrap_or_default());
}
