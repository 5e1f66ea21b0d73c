//! `rockface plan`.

use std::collections::BTreeSet;

use clap::Args;
use rockface_core::Registry;
use serde_json::json;

use super::expected_work::{OnRecord, Work};
use super::programs::ProgramArgs;
use super::{CliError, PipelineArgs, complain, say};
use rockface_engine::explain::{Answer, Answers, Why};
use rockface_engine::plan::{Plan, Unknown};
use rockface_engine::run::tools;

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
    /// Prints what a run would do with each step and why, for people or as JSON.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        self.pipeline.take()?;
        self.pipeline.no_programs = self.programs.are_refused();
        let pipeline = self.pipeline.load(registry)?;
        self.programs.check(registry, &pipeline, &self.pipeline.target)?;
        let (plan, store) = self.pipeline.look(registry, &pipeline, &self.pipeline.target)?;
        let answers = Answers::new(&plan, &store);
        for (label, text) in tools::behind(&plan, &store, answers.hits()).changed {
            complain(&format!("warning: {label}: {text}"));
        }
        for (instance, answer) in answers.list().iter().enumerate() {
            let files = plan.instances[instance].params.files.values().flatten();
            let gone = files.filter(|file| file.gone_since.is_some() && matches!(answer, Answer::Runs(_)));
            gone.for_each(|file| {
                let (label, path) = (plan.label(instance), file.path.display());
                complain(&format!("warning: {label} has to be computed and would fail: {path} is not there"));
            });
        }
        let is_timed = answers.list().iter().any(|answer| answer.is_open()) || !unknown(&plan).is_empty();
        let times = if is_timed { OnRecord::new(&store) } else { OnRecord::default() };
        if self.json {
            print_json(&plan, answers.list(), &times);
        } else {
            self.print(&plan, answers.list(), &times);
        }
        Ok(())
    }

    fn print(&self, plan: &Plan, answers: &[Answer], times: &OnRecord) {
        let changes = changes(plan, answers, times);
        let width = plan.graph.steps.iter().map(|step| step.name.chars().count()).max().unwrap_or(0).max(4);
        say(&format!("{:width$}  {:>9} {:>6} {:>6} {:>8}  why", "step", "instances", "hit", "runs", "depends"));
        let mut instances: Vec<Vec<usize>> = vec![Vec::new(); plan.graph.steps.len()];
        plan.instances.iter().enumerate().for_each(|(number, instance)| instances[instance.step].push(number));
        let mut used = "";
        for number in plan.graph.as_written() {
            let (step, own) = (&plan.graph.steps[number], &instances[number]);
            if own.is_empty() {
                continue;
            }
            let outer = plan.graph.use_of(&step.name);
            let name = outer.map_or("", |outer| outer.name.as_str());
            if name != used {
                outer.iter().for_each(|outer| say(&format!("{name} ({})", outer.part)));
                used = name;
            }
            let count = |word: &str| own.iter().filter(|i| answers[**i].word() == word).count();
            let why = own.iter().find_map(|i| why(plan, answers, &changes, *i)).unwrap_or_default();
            let (hit, runs, depends) = (count("hit"), count("runs"), count("depends"));
            say(&format!("{:width$}  {:>9} {hit:>6} {runs:>6} {depends:>8}  {why}", step.name, own.len()));
            if self.verbose {
                own.iter().for_each(|i| say(&format!("    {:8} {}", answers[*i].word(), plan.label(*i))));
            }
        }
        for (step, unknown) in unknown(plan) {
            let why = match unknown {
                Unknown::Items(axis) => {
                    let axis = &plan.graph.axes[axis].name.text;
                    format!("the items of axis `{axis}` are made by a step that has not run")
                }
                Unknown::Pairs(wait) => {
                    let maker = &plan.graph.steps[wait.maker].name;
                    format!("waits for the pairs of `{maker}`, which has not run")
                }
            };
            say(&format!("{step:width$}  {:>9} {:>6} {:>6} {:>8}  {why}", "?", "", "", ""));
        }
        let changed: BTreeSet<&str> = changes.iter().flatten().map(String::as_str).collect();
        if !changed.is_empty() {
            let changed: Vec<&str> = changed.into_iter().collect();
            say(&format!("stages of another version than their results on record: {}", changed.join(", ")));
        }
        Work::of(plan, answers, times).lines().iter().for_each(|line| say(line));
        let total = |word: &str| answers.iter().filter(|answer| answer.word() == word).count();
        say(&format!("{} hit, {} run, {} depend on what runs", total("hit"), total("runs"), total("depends")));
    }
}

/// Of each instance that is open, the change of the version of its stage, if its results on record are of another.
fn changes(plan: &Plan, answers: &[Answer], times: &OnRecord) -> Vec<Option<String>> {
    let change = |(instance, answer): (usize, &Answer)| {
        if answer.is_open() { times.versions.change(plan, instance) } else { None }
    };
    answers.iter().enumerate().map(change).collect()
}

/// Why an instance is not a hit; where nothing on record has its recipe, the versions of its stage too, if that may be why.
fn why(plan: &Plan, answers: &[Answer], changes: &[Option<String>], instance: usize) -> Option<String> {
    let why = answers[instance].why(plan)?;
    match &changes[instance] {
        Some(change) if answers[instance] == Answer::Runs(Why::New) => Some(format!("{why}: {change}")),
        _ => Some(why),
    }
}

/// The steps some of whose instances cannot be told yet, each with what it waits for.
fn unknown(plan: &Plan) -> Vec<(&str, Unknown)> {
    let wanted = plan.graph.wanted();
    let unknown = plan.unknown().into_iter().enumerate().filter(|(step, _)| wanted[*step]);
    unknown.filter_map(|(step, unknown)| Some((plan.graph.steps[step].name.as_str(), unknown?))).collect()
}

fn print_json(plan: &Plan, answers: &[Answer], times: &OnRecord) {
    let changes = changes(plan, answers, times);
    let instances = answers.iter().enumerate().map(|(instance, answer)| {
        let step = plan.step(instance);
        let estimate_s = if answer.is_open() { times.expected_s(plan, instance) } else { None };
        json!({
            "step": step.name, "point": plan.point(instance), "answer": answer.word(), "why": why(plan, answers, &changes, instance),
            "stage_version": changes[instance],
            "estimate_s": estimate_s,
        })
    });
    let unknown = unknown(plan).into_iter().map(|(step, unknown)| match unknown {
        Unknown::Items(axis) => {
            json!({ "step": step, "answer": "unknown", "axis": plan.graph.axes[axis].name.text })
        }
        Unknown::Pairs(wait) => {
            json!({ "step": step, "answer": "unknown", "pairs_of": plan.graph.steps[wait.maker].name })
        }
    });
    say(&serde_json::to_string_pretty(&instances.chain(unknown).collect::<Vec<_>>()).unwrap_or_default());
}
