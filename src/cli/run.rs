//! `rockface run`.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use clap::Args;
use rockface_core::Registry;

use rockface_cache::remote::Remote;
use rockface_cache::{Digest, Store};

use super::capacity::CapacityArgs;
use super::programs::ProgramArgs;
use super::table::bytes;
use super::{CliError, PipelineArgs, beside, complain, own_folder, repeat, say, signals};
use crate::report::Pages;
use rockface_engine::history::REPORT_FILE;
use rockface_engine::run::shortcut::{self, Ended, Told};
use rockface_engine::run::{self, Finished, LayOut, Options, RunFolder, Summary};
use rockface_engine::watch::{Event, JsonLines, Observer, Plain, Progress, Reported, Role, Terminal, duration};

/// Files of the result that are named at the end.
const FILES_NAMED: usize = 5;

/// Arguments of `rockface run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    programs: ProgramArgs,
    #[command(flatten)]
    capacity: CapacityArgs,
    /// After a failed step, continue with steps that do not depend on it.
    #[arg(long)]
    keep_going: bool,
    /// Hash every input file again, even if its size and times are unchanged.
    #[arg(long)]
    rehash: bool,
    /// The folder that contains the run folders [default: `.rockface/runs` beside the pipeline].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// Which outputs appear as files in the run folder; `rockface export` writes any other later.
    #[arg(long, value_name = "WHICH", value_enum, default_value_t)]
    outputs: LayOut,
    /// Link outputs into the run folder without verifying them first. Faster for many gigabytes, but damage on disk is not
    /// noticed.
    #[arg(long)]
    trust_store: bool,
    /// Run every step that is not cached twice, and fail where the two outputs differ.
    #[arg(long)]
    check_determinism: bool,
    /// When a past run is repeated by its run.json: fail where an output is not the same, is missing, or was not made then (exit code 1).
    #[arg(long)]
    require_same: bool,
    /// Write where the time went: a trace for Perfetto (ui.perfetto.dev) or Chrome, with a row for each thread and a span for
    /// each phase of each step.
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Print events as JSON, one per line.
    #[arg(long)]
    json: bool,
    /// Print only the result, warnings and failures.
    #[arg(long, short)]
    quiet: bool,
    /// Print every step instance.
    #[arg(long, short, conflicts_with = "quiet")]
    verbose: bool,
}

impl RunArgs {
    /// The file that shows where the time went, if one is asked for.
    pub fn trace(&self) -> Option<&std::path::Path> {
        self.trace.as_deref()
    }

    /// Runs the pipeline, or tells the result of the same command last time if nothing it depends on has changed.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        let begun = std::time::Instant::now();
        self.pipeline.former_runs.clone_from(&self.runs);
        let former = self.pipeline.take()?;
        if self.require_same && former.is_none() {
            let told = "--require-same holds a repetition against the run it repeats: give the run.json of that run in place of a pipeline";
            return Err(CliError::Usage(told.to_owned()));
        }
        self.pipeline.no_programs = self.programs.are_refused();
        self.check_paths()?;
        let text = self.pipeline.read()?;
        let question = self.question(registry, &text);
        if let Some(told) = self.recall(question.as_ref())? {
            self.say_end(&told, 0, told.instances, false, begun.elapsed().as_secs_f64());
            return Ok(());
        }
        let mut pipeline = self.pipeline.load_text(registry, &text)?;
        self.programs.check(registry, &pipeline, &self.pipeline.target)?;
        let (mut plan, store) = self.pipeline.plan(registry, &mut pipeline, &self.pipeline.target)?;
        if self.rehash {
            let files = plan.instances.iter().flat_map(|instance| instance.params.files.values().flatten());
            for file in files.filter(|file| file.gone_since.is_none()) {
                store.rehash_file(&file.path)?;
            }
            plan = rockface_engine::plan::expand(plan.graph, &pipeline, &store).map_err(CliError::Pipeline)?;
        }
        store.trust(self.trust_store);
        let (keep_going, check_determinism) = (self.keep_going, self.check_determinism);
        let mut options = Options { keep_going, check_determinism, look: registry.look(), ..Options::default() };
        self.capacity.apply(&mut options);
        let stop = Arc::new(AtomicBool::new(false));
        signals::stop_on_signal(&stop);
        let store = Arc::new(store);
        let given = &self.pipeline.pipeline;
        let mut observer = Reported::new(self.observer(), &store, Role::Run, given, &pipeline.document.name);
        let runs = self.runs_folder()?;
        let about = RunFolder {
            runs: &runs,
            pipeline_path: &self.pipeline.pipeline,
            pipeline: &pipeline,
            overrides: &self.pipeline.overrides(registry),
            targets: &self.pipeline.target,
            jobs: options.jobs,
            lay_out: self.outputs,
            look: registry.look(),
            reporter: &Pages(registry.look()),
        };
        let (summary, finished) = run::execute_and_tell(&mut plan, &store, &options, &stop, &mut observer, &about)
            .inspect_err(|_| store.leave())?;
        let told = Told::of(&finished, &plan, &summary);
        let is_uploaded = upload(&store, &stop);
        if let Some(question) = question.filter(|_| is_uploaded) {
            let ended = Ended { summary: &summary, told: &told, finished: &finished };
            shortcut::remember(&store, &question, &plan, &ended, &pipeline.looks)?;
        }
        let repeated = former.map(|former| repeat::verdict(&former, pipeline.copied.as_deref(), &plan, &summary));
        let wall_s = begun.elapsed().as_secs_f64();
        if self.json {
            Self::report_json(&store, &summary, &finished, repeated.as_ref(), wall_s);
        } else {
            repeated.iter().flat_map(|repeated| &repeated.lines).for_each(|line| say(line));
            self.report(&store, &summary, &told, wall_s);
        }
        let unlike = repeated.filter(|repeated| self.require_same && !repeated.is_same());
        if let Some(unlike) = &unlike {
            complain(&unlike.fault());
        }
        let failed = summary.failed || unlike.is_some();
        // The process ends now: dropping a large plan would only take time.
        std::mem::forget((pipeline, plan, summary));
        if failed { Err(CliError::Failed) } else { Ok(()) }
    }

    fn runs_folder(&self) -> Result<PathBuf, CliError> {
        match &self.runs {
            Some(runs) => Ok(runs.clone()),
            None => Ok(own_folder(&self.pipeline.pipeline)?.join("runs")),
        }
    }

    fn observer(&self) -> Box<dyn Observer> {
        if self.json {
            Box::new(JsonLines::new(std::io::stdout()))
        } else if std::io::stderr().is_terminal() && !self.quiet {
            Box::new(Terminal::new(self.verbose))
        } else if self.quiet {
            quiet_observer()
        } else {
            Box::new(Plain::new(std::io::stderr(), self.verbose))
        }
    }

    /// The record of a run is a text, and it names these places.
    fn check_paths(&self) -> Result<(), CliError> {
        let (here, store) = (std::env::current_dir().unwrap_or_default(), self.pipeline.store_dir());
        let places = [Some(here.as_path()), Some(&self.pipeline.pipeline), Some(&store), self.runs.as_deref()];
        match places.into_iter().flatten().find(|place| place.to_str().is_none()) {
            Some(place) => Err(CliError::Usage(format!(
                "`{}` is no UTF-8 text, and the record of a run has to name it: rename the folder or file, or give another one",
                place.display()
            ))),
            None => Ok(()),
        }
    }

    /// The digest of everything that decides the result of this command; `None` if every step instance has to be printed.
    fn question(&self, registry: &Registry, text: &str) -> Option<Digest> {
        let is_repetition = self.pipeline.text.is_some() && !self.pipeline.shipped;
        if self.json
            || self.verbose
            || self.rehash
            || self.pipeline.recorded_inputs
            || self.trace.is_some()
            || self.programs.are_refused()
            || is_repetition
        {
            return None;
        }
        let arguments: Vec<_> = std::env::args_os().skip(1).collect();
        let program = rockface_engine::version::state_of_program()?;
        let place = (std::env::current_dir().ok()?, self.pipeline.store_dir(), &self.runs, self.pipeline.remote.url());
        // What decides which programs the steps run, and what these find.
        let stages = registry.stages().iter().flat_map(|stage| stage.variables());
        let search: Vec<_> = run::INHERITED.iter().chain(stages).map(std::env::var_os).collect();
        // Paths may be no text: they are asked for as they are written in Rust, which is one of a kind.
        Some(Digest::of(
            format!("{program} {place:?} {} {arguments:?} {search:?}", Digest::of(text.as_bytes())).as_bytes(),
        ))
    }

    fn recall(&self, question: Option<&Digest>) -> Result<Option<Told>, CliError> {
        let Some(question) = question else { return Ok(None) };
        let runs = self.runs.clone().unwrap_or_else(|| beside(&self.pipeline.pipeline).join("runs"));
        Ok(shortcut::recall(&self.pipeline.store_dir(), question, &runs)?)
    }

    fn report_json(
        store: &Store,
        summary: &Summary,
        finished: &Finished,
        repeated: Option<&repeat::Repeated>,
        wall_s: f64,
    ) {
        let event = serde_json::json!({
            "event": "ended", "failed": summary.failed, "executed": summary.executed(), "cached": summary.cached(),
            "wall_s": wall_s, "folder": finished.folder, "headlines": finished.headlines, "files": finished.files,
            "warnings": finished.warnings.iter().map(|(_, text)| text).collect::<Vec<_>>(),
            "repeated": repeated, "remote": store.remote().map(Remote::traffic),
        });
        say(&event.to_string());
    }

    fn report(&self, store: &Store, summary: &Summary, told: &Told, wall_s: f64) {
        let (ran, cached) = (summary.executed(), summary.cached());
        let traffic = store.remote().map(Remote::traffic);
        if let Some((remote, traffic)) = store.remote().zip(traffic).filter(|_| !self.quiet) {
            let requests = traffic.reads + traffic.writes + traffic.lists + traffic.deletes;
            let (down, up) = (bytes(traffic.bytes_read), bytes(traffic.bytes_written));
            say(&format!("  {requests} requests to {}: {down} fetched, {up} uploaded", remote.url()));
        }
        self.say_end(told, ran, cached, summary.failed, wall_s);
    }

    fn say_end(&self, told: &Told, ran: usize, cached: usize, failed: bool, wall_s: f64) {
        let folder = readable(&told.folder);
        let more = told.warning_count.saturating_sub(told.warnings_printed);
        if more > 0 && told.warnings_printed == 0 {
            told.warnings.iter().for_each(|text| complain(&format!("warning  {text}")));
        }
        let named = if told.warnings_printed == 0 { told.warnings.len() } else { 0 };
        if more > named {
            let report = folder.join(REPORT_FILE);
            complain(&format!("warning  {} more of cached steps, in {}", more - named, report.display()));
        }
        if told.unnamed > 0 && self.outputs == LayOut::Auto && !self.quiet {
            let ways = "`rockface export RUN STEP.PORT FILE` writes one, `--outputs all` names them all";
            say(&format!("  {} outputs are in the store only: {ways}", told.unnamed));
        }
        let report = folder.join(REPORT_FILE);
        if !self.quiet && report.is_file() {
            say(&format!("  {}", report.display()));
        }
        if !told.files.is_empty() && !self.quiet {
            let shown = &told.files[..told.files.len().min(FILES_NAMED)];
            say_some(shown, told.file_count, |file| format!("  {}", folder.join(file).display()));
            say("");
        }
        say_some(&told.headlines, told.headline_count, String::clone);
        let verdict = if failed { "failed" } else { "done" };
        let kept = if failed { "what was finished is kept and not run again; " } else { "" };
        let missing = match told.instances.saturating_sub(ran + cached) {
            0 => String::new(),
            missing => format!(", {missing} not made"),
        };
        say(&format!(
            "{verdict}: ran {ran}, cached {cached}{missing}, {}; {kept}results in {}",
            duration_or_ms(wall_s),
            folder.display()
        ));
    }
}

/// Tells of warnings and failures only.
pub fn quiet_observer() -> Box<dyn Observer> {
    Box::new(Quiet { plain: Plain::new(std::io::stderr(), false), waiting: None })
}

/// Waits until all is uploaded; says whether it was.
pub fn upload(store: &Store, stop: &AtomicBool) -> bool {
    let done = store.finish_uploads(stop);
    let Some(remote) = store.remote() else { return true };
    if done.failed > 0 {
        let way = format!("`rockface store push {}` uploads them later", remote.url());
        complain(&format!("warning: {} results were not uploaded: {way}", done.failed));
    }
    done.failed == 0 && !remote.is_off()
}

/// Prints the first of many lines, and how many more there are.
fn say_some<T>(items: &[T], count: usize, line: impl Fn(&T) -> String) {
    items.iter().for_each(|item| say(&line(item)));
    if count > items.len() {
        say(&format!("  … and {} more", count - items.len()));
    }
}

/// How long nothing happens before it is said what others are waited for.
const WAITED: Duration = Duration::from_secs(10);

/// Reports warnings and failures, and what others are waited for where that takes long.
struct Quiet<W: std::io::Write> {
    plain: Plain<W>,
    /// The first step that is waited for since anything else has happened, and when that was.
    waiting: Option<(Event, Instant)>,
}

impl<W: std::io::Write> Observer for Quiet<W> {
    fn ignores_cached(&self) -> bool {
        true
    }

    fn event(&mut self, event: &Event, progress: Progress) {
        match event {
            Event::Waiting { .. } if self.waiting.is_some() => return,
            Event::Waiting { .. } => self.waiting = Some((event.clone(), Instant::now())),
            Event::Elsewhere { .. } => {}
            _ => self.waiting = None,
        }
        if matches!(event, Event::Warning { .. } | Event::Failed { .. }) {
            self.plain.event(event, progress);
        }
    }

    fn idle(&mut self, progress: Progress) {
        if let Some((event, _)) = self.waiting.take_if(|(_, since)| since.elapsed() > WAITED) {
            self.plain.event(&event, progress);
        }
    }
}

fn duration_or_ms(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.0} ms", seconds * 1e3) } else { duration(seconds) }
}

/// A path relative to the working folder where that is shorter.
fn readable(path: &std::path::Path) -> PathBuf {
    let here = std::env::current_dir().ok();
    let relative = here.and_then(|here| path.strip_prefix(here).ok().map(std::path::Path::to_path_buf));
    relative.unwrap_or_else(|| path.to_path_buf())
}
