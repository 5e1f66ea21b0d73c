//! `rockface runs`: past runs, listed, shown, compared and pinned.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use rockface_cache::{RunNote, StoreError};
use rockface_core::Registry;
use serde_json::{Value, json};

use super::places::Places;
use super::table::{self, Format, Printed};
use super::{CliError, complain, say};
use crate::report;
use rockface_engine::history;
use rockface_engine::history::{PastRun, Row};
use rockface_engine::watch::duration;

/// Failures that are named.
const NAMED: usize = 20;

/// Arguments of `rockface runs`.
#[derive(Debug, Args)]
pub struct RunsArgs {
    #[command(subcommand)]
    command: RunsCommand,
}

#[derive(Debug, Subcommand)]
enum RunsCommand {
    /// List the runs, oldest first.
    List {
        #[command(flatten)]
        places: Places,
        #[command(flatten)]
        printed: Printed,
    },
    /// Show one run: its overrides, what ran, and its metrics.
    Show {
        /// A run folder, its name or a part of it, `latest`, or a pipeline (its file or its name) for its last run; `~1` after it
        /// means the one before.
        #[arg(add = super::candidates::runs())]
        run: String,
        #[command(flatten)]
        places: Places,
        /// Print the manifest as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Compare runs: the parameters and metrics that differ between them.
    Compare {
        /// Two runs or more, such as `quickstart~1 quickstart`.
        #[arg(required = true, num_args = 2.., value_name = "RUN", add = super::candidates::runs())]
        compared: Vec<String>,
        #[command(flatten)]
        places: Places,
        #[command(flatten)]
        printed: Printed,
        /// Show metrics that are the same in all runs too; CSV and JSON have them anyway.
        #[arg(long)]
        all: bool,
        /// Write the comparison to this file as an HTML page with pictures.
        #[arg(long, value_name = "FILE", conflicts_with_all = ["format", "json"])]
        html: Option<PathBuf>,
    },
    /// Protect the results of a run from `rockface store gc`.
    Pin {
        /// A run folder, its name or a part of it, `latest`, or a pipeline (its file or its name) for its last run; `~1` after it
        /// means the one before.
        #[arg(add = super::candidates::runs())]
        run: String,
        #[command(flatten)]
        places: Places,
    },
    /// Remove the protection of a pinned run.
    Unpin {
        /// A run folder, its name or a part of it, `latest`, or a pipeline (its file or its name) for its last run; `~1` after it
        /// means the one before.
        #[arg(add = super::candidates::runs())]
        run: String,
        #[command(flatten)]
        places: Places,
    },
}

impl RunsArgs {
    /// Lists, shows, compares or pins runs, as the subcommand says.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        match self.command {
            RunsCommand::List { places, printed } => list(&places, printed.format()),
            RunsCommand::Show { run, places, json } => show(&places.find(&run)?, json),
            RunsCommand::Compare { compared, places, printed, all, html } => {
                let found = compared.iter().map(|run| places.find(run)).collect::<Result<Vec<_>, _>>()?;
                match html {
                    Some(to) => page(registry, &places, &found, &to),
                    None => compare(&found, printed.format(), all),
                }
            }
            RunsCommand::Pin { run, places } => pin(&places, &run, true),
            RunsCommand::Unpin { run, places } => pin(&places, &run, false),
        }
    }
}

fn list(places: &Places, format: Format) -> Result<(), CliError> {
    let (runs, faults) = places.list()?;
    for fault in faults {
        complain(&format!("warning: {fault}"));
    }
    let json: Value = runs
        .iter()
        .map(|run| {
            let ([executed, cached, _], manifest) = (run.manifest.counts(), &run.manifest);
            json!({
                "name": run.name, "folder": run.folder, "pipeline": manifest.pipeline.name, "status": manifest.status,
                "finished": manifest.finished, "wall_s": manifest.wall_s, "executed": executed, "cached": cached,
                "seed": manifest.seed, "pinned": run.pinned, "headlines": manifest.headlines,
            })
        })
        .collect();
    let rows = |row: fn(&PastRun) -> Vec<String>| runs.iter().map(row).collect::<Vec<_>>();
    match format {
        Format::Csv => table::print(format, &RECORD_HEAD, &rows(record), &json),
        Format::Table | Format::Json => table::print(format, &LINE_HEAD, &rows(line), &json),
    }
}

/// The columns of runs for people.
const LINE_HEAD: [&str; 7] = ["run", "status", "ran", "cached", "time", "", "result"];

fn line(run: &PastRun) -> Vec<String> {
    let [executed, cached, _] = run.manifest.counts();
    let pinned = if run.pinned { "pinned" } else { "" };
    let result = run.manifest.headline().unwrap_or_default().to_owned();
    let (status, wall) = (run.manifest.status.clone(), duration(run.manifest.wall_s));
    vec![run.name.clone(), status, executed.to_string(), cached.to_string(), wall, pinned.to_owned(), result]
}

/// The columns of runs for programs.
const RECORD_HEAD: [&str; 10] =
    ["run", "pipeline", "seed", "status", "finished", "executed", "cached", "wall_s", "pinned", "result"];

fn record(run: &PastRun) -> Vec<String> {
    let ([executed, cached, _], manifest) = (run.manifest.counts(), &run.manifest);
    vec![
        run.name.clone(),
        manifest.pipeline.name.clone(),
        manifest.seed.to_string(),
        manifest.status.clone(),
        manifest.finished.clone(),
        executed.to_string(),
        cached.to_string(),
        manifest.wall_s.to_string(),
        run.pinned.to_string(),
        manifest.headline().unwrap_or_default().to_owned(),
    ]
}

fn show(run: &PastRun, as_json: bool) -> Result<(), CliError> {
    let manifest = &run.manifest;
    if as_json {
        say(&serde_json::to_string_pretty(manifest).unwrap_or_default());
        return Ok(());
    }
    let [executed, cached, _] = run.manifest.counts();
    say(&format!("{} ({}){}", run.name, manifest.status, if run.pinned { ", pinned" } else { "" }));
    say(&format!("pipeline  {} ({})", manifest.pipeline.name, manifest.pipeline.path.display()));
    say(&format!("seed      {}", manifest.seed));
    say(&format!("program   {}", manifest.made_by()));
    manifest.overrides.set.iter().for_each(|set| say(&format!("set       {set}")));
    manifest.overrides.sweep.iter().for_each(|sweep| say(&format!("sweep     {sweep}")));
    say(&format!("finished  {}, ran {executed}, cached {cached}, {}", manifest.finished, duration(manifest.wall_s)));
    say(&format!("folder    {}", run.folder.display()));
    manifest.failures().take(NAMED).for_each(|(label, why)| say(&format!("failed    {label}: {why}")));
    let beyond = manifest.failures().count().saturating_sub(NAMED);
    if beyond > 0 {
        say(&format!("failed    {beyond} more: run.json has them"));
    }
    manifest.warnings().take(NAMED).for_each(|(label, text)| say(&format!("warning   {label}: {text}")));
    let beyond = manifest.warnings().count().saturating_sub(NAMED);
    if beyond > 0 {
        say(&format!("warning   {beyond} more: run.json and the report have them"));
    }
    manifest.headlines.iter().for_each(|line| say(line));
    let told = manifest.steps.iter().flat_map(|done| done.metrics.iter().map(move |metric| (done.label(), metric)));
    let rows: Vec<Vec<String>> = told
        .map(|(label, metric)| vec![label, metric.name.clone(), number(metric.value), metric.unit.clone()])
        .collect();
    if rows.is_empty() {
        return Ok(());
    }
    table::print(Format::Table, &["step", "metric", "value", "unit"], &rows, &Value::Null)
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "NaN".to_owned(), short)
}

/// The power of ten of a number's first digit.
fn exponent(value: f64) -> i32 {
    format!("{value:e}").split('e').nth(1).and_then(|digits| digits.parse().ok()).unwrap_or(0)
}

/// A number to four digits; whole ones as they are.
fn short(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e9 {
        return value.to_string();
    }
    if !(1e-4..1e9).contains(&value.abs()) {
        return format!("{value:.3e}");
    }
    let digits = (3 - exponent(value)).clamp(0, 7) as usize;
    format!("{value:.digits$}")
}

fn compare(runs: &[PastRun], format: Format, all: bool) -> Result<(), CliError> {
    let found = history::compare(runs);
    let shows = |one: &&Row| all || format != Format::Table || one.varies();
    // For programs every digit, for people four.
    let as_shown = format == Format::Table;
    let mut head = vec![if format == Format::Csv { "kind" } else { "" }, "name"];
    head.extend(found.runs.iter().map(String::as_str));
    head.extend(["last - first", "unit"]);
    let row = |what: &str, row: &Row| {
        let mut cells = vec![what.to_owned(), row.name.clone()];
        cells.extend(row.values.iter().map(|value| match value.as_ref() {
            Some(Value::Number(number)) if as_shown => number.as_f64().map_or_else(String::new, short),
            Some(Value::String(text)) if as_shown => history::with_short_digest(text),
            other => shown(other),
        }));
        let difference =
            row.difference().map_or_else(String::new, |found| if as_shown { short(found) } else { found.to_string() });
        cells.extend([difference, row.unit.clone().unwrap_or_default()]);
        cells
    };
    let parameters = found.parameters.iter().map(|one| row("parameter", one));
    let metrics: Vec<&Row> = found.metrics.iter().filter(shows).collect();
    let rows: Vec<Vec<String>> = parameters.chain(metrics.iter().map(|one| row("metric", one))).collect();
    table::print(format, &head, &rows, &json!(found))?;
    if format == Format::Table {
        let varying = found.metrics.iter().filter(|one| one.varies()).count();
        let equal = found.metrics.len() - varying;
        say(&format!("{} parameters and {equal} metrics are the same in all", found.equal_parameters));
    }
    Ok(())
}

/// Writes runs side by side as a page.
fn page(registry: &Registry, places: &Places, runs: &[PastRun], to: &Path) -> Result<(), CliError> {
    super::check_own(to, 0, report::BEGINS, "page of a comparison")?;
    let store = places.store_beside(&runs[0])?;
    report::save(to, &report::comparison(runs, store.as_ref(), registry.look())?)?;
    say(&to.display().to_string());
    Ok(())
}

fn shown(value: Option<&Value>) -> String {
    match value {
        None => "-".to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    }
}

/// Pins a run or removes its pin, in its folder and in the store, which so knows of it wherever the folder goes.
fn pin(places: &Places, name: &str, pinned: bool) -> Result<(), CliError> {
    let run = match places.find(name) {
        Ok(run) => run,
        Err(_) if !pinned && unpin_absent(places, name)? => return Ok(()),
        Err(fault) => return Err(fault),
    };
    run.pin(pinned)?;
    let now = PastRun { pinned, ..run.clone() };
    if let Err(why) = tell_store(places, &now) {
        let known = "the mark is in the run folder only";
        let when = "a collection heeds it as long as it finds that folder beside the store or in its `--runs`";
        complain(&format!("warning: {why}; {known}, and {when}"));
    }
    let done = match (pinned, run.pinned) {
        (true, false) => "is pinned: what it made is not collected",
        (true, true) => "was pinned already: what it made is not collected",
        (false, true) => "is no longer pinned",
        (false, false) => "was not pinned",
    };
    say(&format!("{} {done}", run.name));
    Ok(())
}

/// Notes in the store of a run whether it is pinned; says why it could not.
fn tell_store(places: &Places, run: &PastRun) -> Result<(), String> {
    let store = places.store_with(run).map_err(|fault| fault.to_string())?;
    let way = "give it with --store";
    let store = store.ok_or_else(|| format!("the store with the results of {} was not found ({way})", run.name))?;
    let memory = store.memory();
    let note = run.note(&run.folder);
    let told = || -> Result<bool, StoreError> {
        // Where it was before, it is no more; and a folder with two paths has one note on its pin.
        let real = |folder: &Path| folder.canonicalize().ok();
        let here = real(&note.folder);
        let is_former = |old: &RunNote| {
            let is_here = || here.is_some() && real(&old.folder) == here;
            let was_moved = || old.is_of_run(&note) && !history::may_be_run(&old.folder);
            old.pinned && old.folder != note.folder && (is_here() || was_moved())
        };
        for old in memory.noted_folders().into_iter().filter(is_former) {
            memory.note_folder(&old.with_pin(false))?;
        }
        let is_noted = memory.note_folder(&note)?;
        store.sync()?;
        Ok(is_noted)
    };
    match told() {
        Ok(true) => Ok(()),
        Ok(false) => Err(format!("the path {} is not UTF-8, which the store cannot note", run.folder.display())),
        Err(fault) => Err(fault.to_string()),
    }
}

/// Removes the pin of a run whose folder is not there any more, and which the store remembers; false where it remembers none.
fn unpin_absent(places: &Places, name: &str) -> Result<bool, CliError> {
    let Ok(store) = places.open_store() else { return Ok(false) };
    let path = std::path::absolute(name).unwrap_or_default();
    let is_meant = |note: &RunNote| {
        let is_named = note.folder == path || note.folder.file_name().is_some_and(|own| own == name);
        note.pinned && is_named && !history::may_be_run(&note.folder)
    };
    let gone: Vec<RunNote> = store.memory().noted_folders().into_iter().filter(is_meant).collect();
    for note in &gone {
        store.memory().note_folder(&note.clone().with_pin(false))?;
        say(&format!("{} is no longer pinned; its folder is not there", note.folder.display()));
    }
    store.sync()?;
    Ok(!gone.is_empty())
}
