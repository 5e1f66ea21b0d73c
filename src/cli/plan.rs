//! `rockface plan`.

use clap::Args;
use rockface_cache::{Digest, Outcome, Store};
use serde_json::json;

use super::{CliError, PipelineArgs, say};
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

/// What a run would do with one instance.
enum Answer {
    /// Its record is there.
    Hit(Outcome),
    /// It would run.
    Runs(Why),
    /// It depends on an instance that would run.
    Depends(usize),
}

/// Why an instance would run.
enum Why {
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
    fn word(&self) -> &'static str {
        match self {
            Self::Hit(_) => "hit",
            Self::Runs(_) => "runs",
            Self::Depends(_) => "depends",
        }
    }
}

impl PlanArgs {
    /// Prints the plan.
    pub fn run(self) -> Result<(), CliError> {
        let pipeline = self.pipeline.load()?;
        crate::plan::resolve(&pipeline, &self.pipeline.target, rockface_stages::all()).map_err(CliError::Pipeline)?;
        let store = self.pipeline.open_store()?;
        let plan = crate::plan::plan(&pipeline, &self.pipeline.target, rockface_stages::all(), &store)
            .map_err(CliError::Pipeline)?;
        let answers = answers(&plan, &store);
        if self.json {
            print_json(&plan, &answers);
        } else {
            self.print(&plan, &answers);
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
            let why = own.iter().find_map(|i| why(plan, &answers[*i])).unwrap_or_default();
            let (hit, runs, depends) = (count("hit"), count("runs"), count("depends"));
            say(&format!("{:width$}  {:>9} {hit:>6} {runs:>6} {depends:>8}  {why}", step.name, own.len()));
            if self.verbose {
                own.iter().for_each(|i| say(&format!("    {:8} {}", answers[*i].word(), plan.label(*i))));
            }
        }
        let total = |word: &str| answers.iter().filter(|answer| answer.word() == word).count();
        say(&format!("{} hit, {} run, {} depend on what runs", total("hit"), total("runs"), total("depends")));
    }
}

fn why(plan: &Plan, answer: &Answer) -> Option<String> {
    match answer {
        Answer::Hit(_) => None,
        Answer::Runs(Why::New) => Some("no record has this recipe".into()),
        Answer::Runs(Why::Gone) => Some("an output is gone from the store".into()),
        Answer::Runs(Why::Unkept) => Some("its outputs were not kept and now are to be".into()),
        Answer::Runs(Why::Needed) => Some("its values are needed".into()),
        Answer::Depends(producer) => Some(format!("waits for {}", plan.label(*producer))),
    }
}

fn print_json(plan: &Plan, answers: &[Answer]) {
    let instances = answers.iter().enumerate().map(|(instance, answer)| {
        json!({ "step": plan.step(instance).name, "point": plan.point(instance), "answer": answer.word(), "why": why(plan, answer) })
    });
    say(&serde_json::to_string_pretty(&instances.collect::<Vec<_>>()).unwrap_or_default());
}

/// Reads no blob: keys come from records, producers before consumers; then what runs calls for what was not kept.
fn answers(plan: &Plan, store: &Store) -> Vec<Answer> {
    let mut answers: Vec<Answer> = Vec::with_capacity(plan.instances.len());
    for index in 0..plan.instances.len() {
        let answer = answer(plan, store, &answers, index);
        answers.push(answer);
    }
    call_for_values(plan, store, &mut answers);
    answers
}

fn answer(plan: &Plan, store: &Store, answers: &[Answer], index: usize) -> Answer {
    let open = producers(plan, index).into_iter().find(|producer| !matches!(answers[*producer], Answer::Hit(_)));
    if let Some(producer) = open {
        return Answer::Depends(producer);
    }
    let recipe = plan.recipe(index, |producer, port| match &answers[producer] {
        Answer::Hit(outcome) => outcome.outputs[port].digest,
        _ => Digest::of(b""),
    });
    let key = recipe.key();
    match crate::run::hit(store, &key, plan.step(index).keep) {
        Some(outcome) => Answer::Hit(outcome),
        None if store.hit_outcome(&key).is_some() => Answer::Runs(Why::Unkept),
        None if store.has_record(&key) => Answer::Runs(Why::Gone),
        None => Answer::Runs(Why::New),
    }
}

fn producers(plan: &Plan, index: usize) -> Vec<usize> {
    plan.instances[index].inputs.iter().flat_map(|(_, given)| given.iter().map(|given| given.instance)).collect()
}

/// Producers that are recorded, but whose values are nowhere, run again for what is sure to run; consumers come last,
/// so one pass from the end finds them all.
fn call_for_values(plan: &Plan, store: &Store, answers: &mut [Answer]) {
    for index in (0..answers.len()).rev() {
        if !matches!(answers[index], Answer::Runs(_)) {
            continue;
        }
        for (_, given) in &plan.instances[index].inputs {
            for given in given {
                let absent = match &answers[given.instance] {
                    Answer::Hit(outcome) => !store.contains(&outcome.outputs[given.port].digest),
                    _ => false,
                };
                if absent {
                    answers[given.instance] = Answer::Runs(Why::Needed);
                }
            }
        }
    }
}
