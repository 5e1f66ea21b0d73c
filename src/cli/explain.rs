//! `rockface explain`.

use std::path::PathBuf;

use clap::Args;
use rockface_core::Registry;
use serde_json::{Value, json};

use super::{CliError, PipelineArgs, beside, expanded, say};
use rockface_engine::diagnostic;
use rockface_engine::diagnostic::nearest;
use rockface_engine::explain::{Answers, Cause, Change, Explanation, Former, explain};
use rockface_engine::pipeline::{Label, Pipeline};
use rockface_engine::plan::{Plan, Unknown};

/// The number of changes of an instance, or of points of a step, that are listed.
const NAMED: usize = 20;

/// Arguments of `rockface explain`.
#[derive(Debug, Args)]
pub struct ExplainArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The step, and its point if it has more than one instance: `dem[epoch=pre,replicate=3]`. Most shells need quotes.
    #[arg(value_name = "STEP[AXIS=ITEM,...]", add = super::candidates::steps())]
    step: String,
    /// The run folders in which the origin of a former record is looked up [default: `.rockface/runs` beside the pipeline].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// Print the explanation as JSON.
    #[arg(long)]
    json: bool,
}

impl ExplainArgs {
    /// Prints why the instance would run, for people or as JSON.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        self.pipeline.former_runs.clone_from(&self.runs);
        self.pipeline.take()?;
        let pipeline = self.pipeline.load(registry)?;
        let label = wanted(&self.step)?;
        let inner = behind(&pipeline, &label)?;
        let label = inner.as_ref().and_then(|inner| label.of_inner(inner)).unwrap_or(label);
        let name = label.step;
        check_step(&pipeline, name)?;
        let (mut plan, store) = self.pipeline.look(registry, &pipeline, &self.pipeline.target)?;
        if !(0..plan.instances.len()).any(|instance| plan.step(instance).name == name) {
            // No target needs it: explained as if it were one.
            plan = expanded(self.pipeline.resolved(registry, &pipeline, &[name.to_owned()])?, &pipeline, &store)?;
        }
        let instance = one_instance(&plan, &label)?;
        let answers = Answers::new(&plan, &store);
        let runs = self.runs.unwrap_or_else(|| beside(&self.pipeline.pipeline).join("runs"));
        let Some(told) = explain(&plan, &store, &answers, instance, &runs) else {
            return Err(CliError::Usage(format!("the inputs of `{}` are not on record", plan.label(instance))));
        };
        if self.json {
            print_json(&plan, &answers, &told);
        } else {
            print(&plan, &answers, &told);
        }
        Ok(())
    }
}

/// The step and the items of an argument; a port counts where the step is a use of a part.
fn wanted(text: &str) -> Result<Label<'_>, CliError> {
    let empty = text.trim_end().strip_suffix("[]").unwrap_or(text);
    let fault = || CliError::Usage(format!("`{text}` names no step instance; write STEP or 'STEP[axis=item,...]'"));
    Label::parse(empty).ok_or_else(fault)
}

/// What stands behind an output of a use: `use/step.port`.
fn behind(pipeline: &Pipeline, label: &Label) -> Result<Option<String>, CliError> {
    let Some(used) = pipeline.document.uses.iter().find(|used| used.name == label.step) else { return Ok(None) };
    let inner = label.port.and_then(|port| used.behind(port));
    inner.map(Some).ok_or_else(|| {
        let (name, part) = (&used.name, &used.part);
        let outputs: Vec<String> = used.outputs.keys().map(|output| format!("{name}.{output}")).collect();
        let named = diagnostic::listed(outputs.iter().map(String::as_str));
        CliError::Usage(format!("`{name}` uses part `{part}`: name one of its outputs ({named}), or a step inside"))
    })
}

fn check_step(pipeline: &Pipeline, name: &str) -> Result<(), CliError> {
    let known: Vec<&str> = pipeline.document.steps.iter().map(|step| step.name.text.as_str()).collect();
    if known.contains(&name) {
        return Ok(());
    }
    let hint = nearest(name, &known).map_or_else(
        || format!("there are {}", diagnostic::listed(known.iter().copied())),
        |near| format!("did you mean `{near}`?"),
    );
    Err(CliError::Usage(format!("the pipeline has no step `{name}`; {hint}")))
}

/// The one instance of a step that has all these items.
fn one_instance(plan: &Plan, label: &Label) -> Result<usize, CliError> {
    let name = label.step;
    let own: Vec<usize> = (0..plan.instances.len()).filter(|i| plan.step(*i).name == name).collect();
    let fitting: Vec<usize> = own.iter().copied().filter(|instance| label.fits(&plan.point(*instance))).collect();
    match fitting.as_slice() {
        [one] => Ok(*one),
        [] if own.is_empty() => Err(CliError::Usage(unexpanded(plan, name))),
        [] => {
            let items: Vec<String> = label.picks.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
            let message = format!("step `{name}` has no instance at [{}]; it has", items.join(","));
            Err(CliError::Usage(listed(plan, &message, &own)))
        }
        many => {
            let message = format!("step `{name}` has {} instances that fit; name one of", many.len());
            Err(CliError::Usage(listed(plan, &message, many)))
        }
    }
}

/// Why a step has no instance at all: some list of items is not known yet.
fn unexpanded(plan: &Plan, name: &str) -> String {
    let graph = &plan.graph;
    let step = graph.steps.iter().position(|step| step.name == name);
    let (maker, told) = match step.and_then(|step| plan.unknown()[step]) {
        Some(Unknown::Items(axis)) => {
            let maker = graph.dynamic[axis].as_ref().map(|dynamic| dynamic.source.step);
            (maker, format!("the items of axis `{}`", graph.axes[axis].name.text))
        }
        Some(Unknown::Pairs(wait)) => (Some(wait.maker), "the pairs that tell what is gathered".to_owned()),
        None => (None, String::new()),
    };
    let Some(maker) = maker.map(|maker| &graph.steps[maker].name) else {
        return format!("step `{name}` has no instance");
    };
    format!(
        "which instances step `{name}` has is not known: {told} are made by step `{maker}`, which has \
         not run; run it (`rockface run PIPELINE --target {maker}`), or explain `{maker}`"
    )
}

fn listed(plan: &Plan, message: &str, instances: &[usize]) -> String {
    let mut text = format!("{message}:");
    instances.iter().take(NAMED).for_each(|instance| text += &format!("\n  '{}'", plan.label(*instance)));
    if instances.len() > NAMED {
        text += &format!("\n  … and {} more", instances.len() - NAMED);
    }
    text
}

fn print(plan: &Plan, answers: &Answers, told: &Explanation) {
    say(&standing(plan, answers, told.asked));
    if told.explained != told.asked {
        if let Some(version) = &told.version {
            say(&format!("no result on record is of the version of its stage that this program has: {version}"));
        }
        say("its recipe is known only after upstream steps have run; the first of them:\n");
        say(&standing(plan, answers, told.explained));
    }
    let pretty = serde_json::to_string_pretty(&as_value(told)).unwrap_or_default();
    say(&format!("key {}\nrecipe {pretty}", told.recipe.key()));
    for (index, cause) in told.causes.iter().enumerate() {
        say(&format!("\n{}", headline(plan, cause, index == 0)));
        let changes = cause.former.as_ref().map_or(&[][..], |former| &former.changes);
        changes.iter().take(NAMED).for_each(|change| say(&format!("  {change}{}", origin(plan, cause, change))));
        if changes.len() > NAMED {
            say(&format!("  … and {} more", changes.len() - NAMED));
        }
    }
}

/// `step[point] (stage): answer, why`.
fn standing(plan: &Plan, answers: &Answers, instance: usize) -> String {
    let answer = answers.list()[instance];
    let why = answer.why(plan).map(|why| format!(", {why}")).unwrap_or_default();
    format!("{} ({}): {}{why}", plan.label(instance), plan.step(instance).stage.name(), answer.word())
}

fn headline(plan: &Plan, cause: &Cause, first: bool) -> String {
    let (label, stage) = (plan.label(cause.instance), plan.step(cause.instance).stage.name());
    match (&cause.former, first) {
        (None, true) => format!("{label}: no record of stage `{stage}` exists"),
        (None, false) => format!("{label} made that input; no record of what made the former input exists"),
        (Some(former), true) if cause.is_own => format!("{label}: against {}, which it had before", named(former)),
        (Some(former), true) => {
            format!("{label}: against {}, the closest of {} on record of `{stage}`", named(former), cause.records)
        }
        (Some(former), false) => format!("{label} made that input; against {}, which made the former", named(former)),
    }
}

/// The key of a former record and the run it is known from.
fn named(former: &Former) -> String {
    let run = former.run.as_ref().map_or_else(|| "no run folder names it".to_owned(), |run| format!("in run {run}"));
    format!("{}… ({run})", former.key.short())
}

/// Where a changed component comes from: the output of a step, or a file.
fn origin(plan: &Plan, cause: &Cause, change: &Change) -> String {
    let instance = &plan.instances[cause.instance];
    if let Some(place) = &change.input {
        let given = instance.inputs.iter().filter(|(port, _)| *port == place.port).flat_map(|(_, given)| given);
        let given = given.into_iter().find(|given| given.point == place.point);
        return given.map(|g| format!(" (from {}, port {})", plan.label(g.instance), g.port)).unwrap_or_default();
    }
    let digest = change.new.as_ref().and_then(Value::as_str).unwrap_or_default();
    let file = instance.params.files.values().flatten().find(|file| file.digest.to_string() == digest);
    file.map(|file| format!(" (the file {})", file.path.display())).unwrap_or_default()
}

/// The very text that is hashed, as a JSON value.
fn as_value(told: &Explanation) -> Value {
    serde_json::from_str(&told.recipe.text()).unwrap_or_default()
}

fn print_json(plan: &Plan, answers: &Answers, told: &Explanation) {
    let about = |instance: usize| {
        let answer = answers.list()[instance];
        json!({ "step": plan.step(instance).name, "point": plan.point(instance), "answer": answer.word(), "why": answer.why(plan) })
    };
    let change = |change: &Change| json!({ "path": change.path, "old": change.old, "new": change.new });
    let cause = |cause: &Cause| {
        let former = cause.former.as_ref();
        let changes = former.map_or(&[][..], |former| &former.changes);
        json!({
            "step": plan.step(cause.instance).name, "point": plan.point(cause.instance), "records": cause.records, "own_record": cause.is_own,
            "former_key": former.map(|former| former.key), "former_run": former.and_then(|former| former.run.as_ref()),
            "changes": changes.iter().map(change).collect::<Vec<_>>(),
        })
    };
    let whole = json!({
        "asked": about(told.asked), "stage_version": told.version, "explained": about(told.explained), "key": told.recipe.key(),
        "recipe": as_value(told), "recipe_text": told.recipe.text(),
        "causes": told.causes.iter().map(cause).collect::<Vec<_>>(),
    });
    say(&serde_json::to_string_pretty(&whole).unwrap_or_default());
}
