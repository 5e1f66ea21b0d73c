//! `rockface plan`.

use std::collections::BTreeMap;

use clap::Args;
use rockface_cache::Store;
use serde_json::json;

use super::{CliError, PipelineArgs, say};
use crate::explain::{Answer, Answers};
use crate::plan::Plan;
use crate::watch::duration;

/// Arguments of `rockface plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// Print every step instance, not only a line a step.
    #[arg(long, short)]
    verbose: bool,
    /// Print the plan as JSON.
    #[arg(long)]
    json: bool,
}

impl PlanArgs {
    /// Prints the plan.
    pub fn run(self) -> Result<(), CliError> {
        let pipeline = self.pipeline.load()?;
        let (plan, store) = self.pipeline.look(&pipeline, &self.pipeline.target)?;
        let answers = Answers::new(&plan, &store);
        let times = times(&store);
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

/// Mean elapsed seconds of an instance by stage, from records.
type Times = BTreeMap<String, f64>;

fn times(store: &Store) -> Times {
    let stats = store.stat_by_stage().into_iter().filter(|stat| stat.records > 0);
    stats.map(|stat| (stat.stage, stat.wall_s / stat.records as f64)).collect()
}

/// How long the instances that are no hits would take one after the other, going by records of their stages.
fn estimate(plan: &Plan, answers: &[Answer], times: &Times) -> Option<String> {
    let open: Vec<usize> = (0..answers.len()).filter(|i| answers[*i] != Answer::Hit).collect();
    let known = open.iter().filter_map(|i| times.get(plan.step(*i).stage.name()));
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
        let estimate_s = if *answer == Answer::Hit { None } else { times.get(step.stage.name()) };
        json!({
            "step": step.name, "point": plan.point(instance), "answer": answer.word(), "why": answer.why(plan),
            "estimate_s": estimate_s,
        })
    });
    let unknown =
        unknown(plan).into_iter().map(|(step, axis)| json!({ "step": step, "answer": "unknown", "axis": axis }));
    say(&serde_json::to_string_pretty(&instances.chain(unknown).collect::<Vec<_>>()).unwrap_or_default());
}
