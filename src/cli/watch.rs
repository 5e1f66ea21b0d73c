//! `rockface watch`: how far a run is that other processes work on, from the files they leave in the store. Nothing is changed.

use std::collections::BTreeMap;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use rockface_cache::{Store, WorkerReport};
use rockface_engine::diagnostic::printable;
use rockface_engine::history::PastRun;
use rockface_engine::watch::{Report, Role, duration};
use serde_json::json;

use super::places::{Places, may_be_store};
use super::{CliError, beside, complain, say};

/// How long it takes at least until the next look, seconds.
const LEAST_INTERVAL_S: f64 = 0.1;
/// Running steps that are named.
const RUNNING_NAMED: usize = 6;

/// Arguments of `rockface watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// The pipeline that other processes run, or a past run: a run folder, its name, or `latest`.
    what: String,
    #[command(flatten)]
    places: Places,
    /// Print the state once and end.
    #[arg(long)]
    once: bool,
    /// Seconds between two looks.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0, value_parser = interval)]
    interval: f64,
    /// Print each state as a line of JSON.
    #[arg(long)]
    json: bool,
}

fn interval(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "give a number of seconds, such as 2".to_owned())?;
    if (LEAST_INTERVAL_S..=3600.0).contains(&seconds) {
        Ok(seconds)
    } else {
        Err("give seconds from 0.1 to 3600".to_owned())
    }
}

/// The processes that work on a pipeline.
#[derive(Default, PartialEq)]
struct State {
    workers: Vec<(WorkerReport, Report)>,
}

impl WatchArgs {
    /// Prints how far the run is until nobody works on it any more, and how it ended.
    pub fn run(self) -> Result<(), CliError> {
        let pipeline = Path::new(&self.what);
        let store = self.places.given_store().unwrap_or_else(|| beside(pipeline).join("store"));
        let is_manifest = pipeline.ends_with("run.json");
        let is_file = pipeline.is_file() && !is_manifest;
        let before = match self.places.find(&self.what) {
            // A past run is shown without the store.
            Ok(run) if !is_file && run.manifest.pipeline.name != self.what => return self.past(&run),
            Err(fault) if is_manifest => return Err(fault),
            before => before,
        };
        let is_there = may_be_store(&store);
        if !is_there && !is_file && self.places.given_store().is_none() {
            return before.and_then(|run| self.past(&run));
        }
        let before = before.ok();
        let ended = before.as_ref().map(|run| format!("the last run of it here {}", ended(run)));
        if !is_there {
            let way = "give its folder with --store, or wait until a process has begun";
            let ended = ended.map_or_else(String::new, |ended| format!("; {ended}"));
            return Err(CliError::Usage(format!("there is no store in {}: {way}{ended}", store.display())));
        }
        let mut state = State::of(&store, pipeline).inspect_err(|_| ended.iter().for_each(|ended| complain(ended)))?;
        if state.is_over() {
            return self.nobody(&state);
        }
        let mut lines = self.show(&state, None, 0);
        if self.once {
            return Ok(());
        }
        loop {
            std::thread::sleep(Duration::from_secs_f64(self.interval));
            let next = State::of(&store, pipeline)?;
            if next.is_over() {
                return self.end(&state, before.as_ref().map(|run| run.folder.as_path()));
            }
            lines = self.show(&next, Some(&state), lines);
            state = next;
        }
    }

    /// Nobody works on it: says how the last run of it ended, if there was one.
    fn nobody(&self, state: &State) -> Result<(), CliError> {
        let is_file = Path::new(&self.what).is_file();
        match self.places.find(&self.what) {
            Ok(run) => self.past(&run),
            Err(_) if is_file && self.json => {
                say(&state.json().to_string());
                Ok(())
            }
            Err(_) if is_file => {
                say("nobody works on it, and no run of it has ended yet");
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    /// Prints a state over the former one on a terminal, else below it where something has changed; returns its lines.
    fn show(&self, state: &State, former: Option<&State>, lines: usize) -> usize {
        if self.json {
            say(&state.json().to_string());
            return 0;
        }
        let text = state.text();
        let is_terminal = std::io::stdout().is_terminal() && !self.once;
        if is_terminal && lines > 0 {
            let mut out = std::io::stdout();
            super::output::note(std::io::Write::write_all(&mut out, format!("\u{1b}[{lines}A\u{1b}[J").as_bytes()));
        }
        if is_terminal || former.is_none_or(|former| former.text() != text) {
            say(&text);
        }
        text.lines().count()
    }

    /// Nobody works on it any more: says how it ended, or where no run folder was written since the watch began, what was last known; fails if
    /// steps failed.
    fn end(&self, last: &State, before: Option<&Path>) -> Result<(), CliError> {
        if let Ok(run) = self.places.find(&self.what)
            && before != Some(&run.folder)
        {
            return self.past(&run);
        }
        if !self.json {
            let (done, total) = last.progress();
            let way = format!("`rockface run {}` writes the run folder if none was written", self.what);
            say(&format!(
                "nobody works on it any more; {done} of {total} steps were done when it was last seen; {way}"
            ));
        }
        if last.failures().is_empty() { Ok(()) } else { Err(CliError::Failed) }
    }

    /// The end of a past run.
    fn past(&self, run: &PastRun) -> Result<(), CliError> {
        let [executed, cached, failed] = counts(run);
        if self.json {
            let folder = &run.folder;
            say(&json!({"folder": folder, "executed": executed, "cached": cached, "failed": failed}).to_string());
        } else {
            say(&format!("nobody works on it; the last run {}", ended(run)));
        }
        if failed == 0 { Ok(()) } else { Err(CliError::Failed) }
    }
}

/// How many steps of a past run ran, were cached and failed.
fn counts(run: &PastRun) -> [usize; 3] {
    ["executed", "cached", "failed"]
        .map(|wanted| run.manifest.steps.iter().filter(|step| step.status == wanted).count())
}

/// When and how a past run ended, behind its name.
fn ended(run: &PastRun) -> String {
    let ([executed, cached, failed], folder) = (counts(run), run.folder.display());
    let finished = &run.manifest.finished;
    format!("ended {finished}: ran {executed}, cached {cached}, failed {failed}; results in {folder}")
}

impl State {
    fn of(store: &Path, pipeline: &Path) -> Result<Self, CliError> {
        let path = std::path::absolute(pipeline).unwrap_or_else(|_| PathBuf::from(pipeline));
        let report = |worker: WorkerReport| {
            let report = serde_json::from_str::<Report>(&worker.text).ok()?;
            // One that ships is known by its name.
            let is_meant = report.pipeline == path || Some(report.name.as_str()) == pipeline.to_str();
            is_meant.then_some((worker, report))
        };
        Ok(Self { workers: Store::workers(store)?.into_iter().filter_map(report).collect() })
    }

    fn live(&self) -> impl Iterator<Item = &(WorkerReport, Report)> {
        self.workers.iter().filter(|(worker, _)| worker.is_live)
    }

    fn is_over(&self) -> bool {
        self.live().next().is_none()
    }

    /// What the one that knows most says.
    fn progress(&self) -> (usize, usize) {
        self.workers.iter().map(|(_, report)| (report.done, report.total)).max().unwrap_or_default()
    }

    fn failures(&self) -> BTreeMap<String, String> {
        self.workers.iter().flat_map(|(_, report)| report.failures.iter().cloned()).collect()
    }

    /// The expected seconds to the end: each says what it would take alone.
    fn remaining_s(&self) -> Option<f64> {
        let count = self.live().count() as f64;
        let alone = self.live().filter_map(|(_, report)| report.remaining_s).max_by(f64::total_cmp);
        alone.map(|seconds| seconds / count)
    }

    fn json(&self) -> serde_json::Value {
        let (done, total) = self.progress();
        let worker = |(worker, report): &(WorkerReport, Report)| {
            let mut told = json!(report);
            (told["is_live"], told["silent_s"]) = (json!(worker.is_live), json!(worker.silent.as_secs_f64()));
            told
        };
        let workers: Vec<_> = self.workers.iter().map(worker).collect();
        json!({"done": done, "total": total, "remaining_s": self.remaining_s(), "workers": workers, "failures": self.failures()})
    }

    fn text(&self) -> String {
        let (done, total) = self.progress();
        let left = self.remaining_s().map(|left| format!(", about {} left", duration(left))).unwrap_or_default();
        let count = self.live().count();
        let at_work = if count == 1 { "1 process works".to_owned() } else { format!("{count} processes work") };
        let mut lines = vec![format!("{done} of {total} steps done{left}; {at_work} on it")];
        for (worker, report) in &self.workers {
            let role = if report.role == Role::Run { "run" } else { "work" };
            let state = if worker.is_live { "" } else { ", dead" };
            let head = format!("  {role:4} {}/{}{state}: ran {}", report.host, report.pid, report.executed);
            let named: Vec<&str> = report.running.iter().map(String::as_str).take(RUNNING_NAMED).collect();
            let more = report.running.len().saturating_sub(named.len());
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let now = if named.is_empty() { "waits".to_owned() } else { format!("runs {}{more}", named.join(", ")) };
            lines.push(if worker.is_live { format!("{head}, {now}") } else { head });
        }
        let mut steps: BTreeMap<&str, usize> = BTreeMap::new();
        for (name, count) in self.workers.iter().flat_map(|(_, report)| &report.steps) {
            *steps.entry(name).or_default() += count;
        }
        let steps: Vec<String> = steps.iter().map(|(name, count)| format!("{name} {count}")).collect();
        lines.extend((!steps.is_empty()).then(|| format!("  ran {}", steps.join(", "))));
        lines.extend(self.failures().iter().map(|(step, why)| format!("  failed {step}: {why}")));
        lines.iter().map(|line| printable(line).into_owned()).collect::<Vec<_>>().join("\n")
    }
}
