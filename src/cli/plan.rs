//! `rockface plan`.

use clap::Args;
use serde_json::json;

use super::{CliError, PipelineArgs, say};
use crate::explain::{Answer, Answers};
use crate::plan::Plan;

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
        let (plan, store) = self.pipeline.plan(&pipeline, &self.pipeline.target)?;
        let answers = Answers::new(&plan, &store);
        if self.json {
            print_json(&plan, answers.list());
        } else {
            self.print(&plan, answers.list());
        }
        Ok(())
    }

    fn print(&self, plan: &Plan, answers: &[Answer]) {
        let width = plan.graph.steps.iter().map(|step| step.name.chars().count()).max().unwrap_or(0).max(4);
        say(&format!("{:width$}  {:>9} {:>6} {:>6} {:>8}  why", "step", "instances", "hit", "runs", "depends"));
        for (index, step) in plan.graph.steps.iter().enumerate() {
            let own: Vec<usize> = (0..answers.len()).filter(|i| plan.instances[*i].step == index).collect();
            if own.is_empty() {
                continue;
            }
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

fn print_json(plan: &Plan, answers: &[Answer]) {
    let instances = answers.iter().enumerate().map(|(instance, answer)| {
        json!({ "step": plan.step(instance).name, "point": plan.point(instance), "answer": answer.word(), "why": answer.why(plan) })
    });
    let unknown =
        unknown(plan).into_iter().map(|(step, axis)| json!({ "step": step, "answer": "unknown", "axis": axis }));
    say(&serde_json::to_string_pretty(&instances.chain(unknown).collect::<Vec<_>>()).unwrap_or_default());
}
