//! The command line: one file a command, and the exit codes they share.

mod candidates;
mod capacity;
mod completions;
pub mod environment;
mod expected_work;
mod explain;
mod export;
mod former;
mod gc;
mod graph;
mod init;
mod inspect;
mod kept;
mod manual;
pub mod output;
mod own_file;
mod params;
mod parts;
mod places;
mod plan;
mod programs;
mod remote;
mod repeat;
mod report;
mod run;
mod runs;
mod schema;
mod shipped;
mod signals;
mod sizes;
mod stages;
mod store;
mod submit;
mod table;
mod transfer;
mod verify;
mod watch;
mod work;

use std::path::{Path, PathBuf};

use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, Parser, Subcommand};
use rockface_cache::{Store, StoreError};
use rockface_core::Registry;

pub use candidates::answer;
use former::expanded;
use output::{complain, say};
pub use own_file::{check_own, write_own};
use rockface_engine::PHASE;
use rockface_engine::diagnostic::Diagnostics;
use rockface_engine::history::HistoryError;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::{Graph, Plan};
use rockface_engine::run::RunError;

/// What the program tells by its exit code.
const EXIT_CODES: &str = "Exit codes: 0 done, 1 a step failed, 2 the command or pipeline is wrong, 3 the store or disk failed, 130 interrupted.";

/// Simulates photogrammetric rockfall monitoring: runs pipelines of stages and caches every output.
#[derive(Debug, Parser)]
#[command(
    version = rockface_engine::version::TEXT,
    about,
    after_help = EXIT_CODES
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a pipeline; results that are cached are not computed again.
    Run(run::RunArgs),
    /// Help other processes with a run: take steps that are ready and that nobody has, until all are done.
    Work(work::WorkArgs),
    /// Start workers through the queue of a cluster: Slurm or HyperQueue.
    Submit(submit::SubmitArgs),
    /// Show how far a run is that other processes work on.
    Watch(watch::WatchArgs),
    /// Show what a run would do and why, without doing it.
    Plan(plan::PlanArgs),
    /// Show the recipe of one step instance, whether its result is cached, and if not, what changed.
    Explain(explain::ExplainArgs),
    /// Draw the steps and the data that flows between them. Targets have a bold or double frame; outputs that are not kept are dashed.
    Graph(graph::GraphArgs),
    /// List the stages, or show the manual page of one.
    Stages(stages::StagesArgs),
    /// List the parts that come with the program, or show how one is used.
    Parts(parts::PartsArgs),
    /// List the parameters of a pipeline with their values, units and ranges.
    Params(params::ParamsArgs),
    /// List, show, compare and pin past runs.
    Runs(runs::RunsArgs),
    /// Write the report of a past run again: steps, pictures, tables and metrics in one HTML file.
    Report(report::ReportArgs),
    /// Show what the store contains, verify it, remove what is not needed.
    Store(store::StoreArgs),
    /// Show what a blob, a record or a file contains: kind, size, ranges, missing values.
    Inspect(inspect::InspectArgs),
    /// Write an output of a past run to a file.
    Export(export::ExportArgs),
    /// Pack everything needed to check a past run into one file.
    Archive(export::ArchiveArgs),
    /// Create a folder with a commented pipeline to start from.
    Init(init::InitArgs),
    /// Write the manual: pages for `man`, the chapters of the reference, the schema of events.
    Manual(manual::ManualArgs),
    /// Print a completion script for a shell.
    Completions(completions::CompletionsArgs),
}

/// What every command that reads a pipeline takes.
#[derive(Debug, Args)]
struct PipelineArgs {
    /// The pipeline file (YAML), the name of one that ships with rockface such as `quickstart`, or the `run.json` of a past
    /// run to repeat it.
    #[arg(add = candidates::pipelines())]
    pipeline: PathBuf,
    /// The text of the pipeline, if it is not to be read from the file.
    #[arg(skip)]
    text: Option<String>,
    /// The texts of included files, if they are not to be read from disk.
    #[arg(skip)]
    included: std::collections::BTreeMap<PathBuf, String>,
    /// A copy of the input files that is read in their place.
    #[arg(skip)]
    copied: Option<std::sync::Arc<rockface_engine::pipeline::Copied>>,
    /// Whether these texts are part of the program.
    #[arg(skip)]
    shipped: bool,
    /// Whether no program may be asked what is in a file.
    #[arg(skip)]
    no_programs: bool,
    /// Run only this step and the steps it needs; may be given several times.
    #[arg(long, value_name = "STEP", add = candidates::steps())]
    target: Vec<String>,
    /// Override a value of the pipeline, such as `params.cell_m=0.02` or `steps.dem.with.method=tin`.
    #[arg(long, value_name = "PATH=VALUE")]
    set: Vec<String>,
    /// Sweep an axis, a parameter or a value of a step: `sigma_px=0.6,0.7`, `params.cell_m=0.01..0.05:5`.
    #[arg(long, value_name = "AXIS=VALUES")]
    sweep: Vec<String>,
    /// Override the pipeline's seed.
    #[arg(long, value_name = "N", value_parser = seed, allow_hyphen_values = true)]
    seed: Option<u64>,
    /// For an input file that is gone, go by the digest it had in the last run of this pipeline that read it: steps that read it are taken from
    /// the store, and one that has to be computed fails.
    #[arg(long)]
    recorded_inputs: bool,
    /// The folder of the runs that input files are looked up in, if it is not the one beside the pipeline.
    #[arg(skip)]
    former_runs: Option<PathBuf>,
    /// The store of results; by default `.rockface/store` beside the pipeline.
    #[arg(long, value_name = "DIR", env = "ROCKFACE_STORE", value_parser = folder_or_nothing())]
    store: Option<PathBuf>,
    #[command(flatten)]
    remote: remote::RemoteArgs,
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("a seed is a whole number from 0 to {}", u64::MAX))
}

/// A folder; an empty environment variable counts as unset.
fn folder_or_nothing() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(PathBuf::from)
}

impl PipelineArgs {
    fn overrides(&self, registry: &Registry) -> Overrides {
        Overrides { set: self.set.clone(), sweep: self.sweep.clone(), seed: self.seed, parts: registry.parts() }
    }

    fn load(&self, registry: &Registry) -> Result<Pipeline, CliError> {
        self.load_text(registry, &self.read()?)
    }

    /// The text of the pipeline: read once, so that what is asked about it and what is run is the same.
    fn read(&self) -> Result<String, CliError> {
        let given = self.text.clone().map(Ok);
        given.unwrap_or_else(|| Pipeline::read_file(&self.pipeline)).map_err(CliError::Pipeline)
    }

    /// The pipeline of the text that was read.
    fn load_text(&self, registry: &Registry, text: &str) -> Result<Pipeline, CliError> {
        let (path, overrides) = (&self.pipeline, self.overrides(registry));
        let trees = rockface_cache::trees(&self.store_dir());
        let _read = tracing::trace_span!(target: PHASE, "read").entered();
        let loaded = match &self.text {
            Some(_) => Pipeline::of_text(text, self.included.clone(), path, &overrides),
            None => Pipeline::of_read(text, path, &overrides, Some(&trees)),
        };
        let mut pipeline = loaded.map_err(CliError::Pipeline)?;
        pipeline.copied.clone_from(&self.copied);
        let no_programs = self.no_programs || programs::are_refused_by_environment();
        rockface_engine::plan::complete(&mut pipeline, registry.stages(), no_programs);
        if !pipeline.faults.is_empty() {
            rockface_engine::plan::resolve(&pipeline, &self.target, registry.stages()).map_err(CliError::Pipeline)?;
        }
        Ok(pipeline)
    }

    /// Plans for these targets; faults of the pipeline come before anything is made on disk. The steps of the document go: they
    /// are in the plan then.
    fn plan(
        &self,
        registry: &Registry,
        pipeline: &mut Pipeline,
        targets: &[String],
    ) -> Result<(Plan, Store), CliError> {
        let _plan = tracing::trace_span!(target: PHASE, "plan").entered();
        let resolve = || self.resolved(registry, pipeline, targets);
        // A store that is there is read meanwhile.
        let (graph, opened) = if Store::is_at(&self.store_dir()) {
            std::thread::scope(|scope| {
                let opened = std::thread::Builder::new().spawn_scoped(scope, || self.open_store()).ok();
                (resolve(), opened.and_then(|opened| opened.join().ok()))
            })
        } else {
            (resolve(), None)
        };
        let graph = graph?;
        pipeline.document.steps = Vec::new();
        let store = opened.unwrap_or_else(|| self.open_store())?;
        self.remote.attach(&store, false)?;
        Ok((expanded(graph, pipeline, &store)?, store))
    }

    /// [`PipelineArgs::plan`] for what only looks: where there is no store, none is made.
    fn look(&self, registry: &Registry, pipeline: &Pipeline, targets: &[String]) -> Result<(Plan, Looked), CliError> {
        let graph = self.resolved(registry, pipeline, targets)?;
        let store = Looked::open(&self.store_dir())?;
        self.remote.attach(&store, true)?;
        Ok((expanded(graph, pipeline, &store)?, store))
    }

    /// The graph for these targets, with what runs know of input files.
    fn resolved(&self, registry: &Registry, pipeline: &Pipeline, targets: &[String]) -> Result<Graph, CliError> {
        let resolved = rockface_engine::plan::resolve(pipeline, targets, registry.stages());
        let mut graph = resolved.map_err(CliError::Pipeline)?;
        graph.former = Some(self.former_inputs(&graph.name));
        Ok(graph)
    }

    fn open_store(&self) -> Result<Store, CliError> {
        if self.given_store().is_none() {
            own_folder(&self.pipeline)?;
        }
        Ok(Store::open(&self.store_dir())?)
    }

    fn given_store(&self) -> Option<&PathBuf> {
        self.store.as_ref().filter(|folder| !folder.as_os_str().is_empty())
    }

    /// Where the store is or will be.
    fn store_dir(&self) -> PathBuf {
        self.given_store().cloned().unwrap_or_else(|| beside(&self.pipeline).join("store"))
    }
}

/// A store to look into: where there is none, an empty one that goes away with this.
struct Looked {
    store: Store,
    /// Removed after the store is closed.
    _folder: Option<tempfile::TempDir>,
}

impl Looked {
    fn open(dir: &Path) -> Result<Self, CliError> {
        // An empty folder could become a store; one of other things is refused by opening it.
        let is_none = match std::fs::read_dir(dir) {
            Ok(mut entries) => entries.next().is_none(),
            Err(fault) => fault.kind() == std::io::ErrorKind::NotFound,
        };
        if !is_none {
            return Ok(Self { store: Store::open(dir)?, _folder: None });
        }
        let folder = tempfile::tempdir().map_err(CliError::Temporary)?;
        Ok(Self { store: Store::open(folder.path())?, _folder: Some(folder) })
    }
}

impl std::ops::Deref for Looked {
    type Target = Store;

    fn deref(&self) -> &Store {
        &self.store
    }
}

/// Marks a folder that backup programs may pass by; see <https://bford.info/cachedir/>, the first line is prescribed.
const CACHE_TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n\
    # Everything in this folder can be computed again from the pipeline beside it.\n";

/// Where the `.rockface` folder of a pipeline is or will be.
fn beside(pipeline: &Path) -> PathBuf {
    pipeline.parent().unwrap_or(Path::new("")).join(".rockface")
}

/// The `.rockface` folder of a pipeline, made if there is none: out of version control and out of backups.
fn own_folder(pipeline: &Path) -> Result<PathBuf, CliError> {
    let folder = beside(pipeline);
    let failed = |source| CliError::Run(RunError::Folder { path: folder.clone(), source });
    let is_new = !folder.exists();
    std::fs::create_dir_all(&folder).map_err(failed)?;
    for (name, text) in [(".gitignore", "*\n"), ("CACHEDIR.TAG", CACHE_TAG)] {
        if !folder.join(name).exists() {
            write_own(&folder.join(name), text.as_bytes()).map_err(failed)?;
        }
    }
    if is_new {
        // What is durable inside is lost with its name.
        let around = folder.parent().filter(|around| !around.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let synced = std::fs::File::open(around).and_then(|around| around.sync_all());
        synced
            .or_else(|error| if error.kind() == std::io::ErrorKind::PermissionDenied { Ok(()) } else { Err(error) })
            .map_err(failed)?;
    }
    Ok(folder)
}

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// The pipeline is wrong.
    #[error("{0}")]
    Pipeline(Diagnostics),
    /// The command is wrong.
    #[error("{0}")]
    Usage(String),
    /// Steps failed; already reported.
    #[error("")]
    Failed,
    /// Something in the store is damaged or missing; already reported.
    #[error("")]
    Damaged,
    /// A past run cannot be read.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// The store could not be opened, read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The run could not go on.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A page could not be written.
    #[error(transparent)]
    Report(#[from] crate::report::ReportError),
    /// The trace could not be written; the command itself went well.
    #[error("cannot write the trace to `{}`: {source}", path.display())]
    Trace {
        /// Where it was to go.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The output could not be written.
    #[error("cannot write to standard output: {0}")]
    Output(std::io::Error),
    /// No folder for a moment could be made.
    #[error("cannot make a folder in `{place}`: {0}; TMPDIR names another place", place = std::env::temp_dir().display())]
    Temporary(std::io::Error),
}

impl CliError {
    /// The exit code that tells which.
    pub fn exit_code(&self) -> i32 {
        match self {
            Self::Failed => 1,
            Self::History(HistoryError::Interrupted) => signals::INTERRUPTED,
            Self::History(HistoryError::Io { .. } | HistoryError::Changed { .. } | HistoryError::Store(_))
            | Self::Store(_)
            | Self::Damaged
            | Self::Report(_)
            | Self::Trace { .. }
            | Self::Output(_)
            | Self::Temporary(_) => 3,
            Self::Pipeline(_) | Self::Usage(_) | Self::History(_) => 2,
            Self::Run(error) => error.exit_code(),
        }
    }

    /// What to print on standard error.
    pub fn render(&self, colour: bool) -> String {
        match self {
            Self::Pipeline(diagnostics) => diagnostics.render(colour),
            Self::Failed | Self::Damaged => String::new(),
            other => rockface_engine::diagnostic::printable(&format!("error: {other}")).into_owned(),
        }
    }
}

impl Cli {
    /// The file that shows where the time of the command went, if one is asked for.
    pub fn trace_file(&self) -> Option<&Path> {
        if let Command::Run(args) = &self.command { args.trace() } else { None }
    }

    /// Runs the command, and makes sure that its output is written.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        rockface_core::limits::raise_memory_limit(rockface_engine::run::Options::default().memory_bytes as u64);
        match (self.command.run(registry), output::fault()) {
            // What there is to say about a failed step was part of what could not be written.
            (Ok(()) | Err(CliError::Failed | CliError::Damaged), Some(error)) => Err(CliError::Output(error)),
            (result, _) => result,
        }
    }
}

impl Command {
    fn run(self, registry: &Registry) -> Result<(), CliError> {
        match self {
            Self::Run(args) => args.run(registry),
            Self::Work(args) => args.run(registry),
            Self::Submit(args) => args.run(registry),
            Self::Watch(args) => args.run(),
            Self::Plan(args) => args.run(registry),
            Self::Explain(args) => args.run(registry),
            Self::Graph(args) => args.run(registry),
            Self::Stages(args) => args.run(registry),
            Self::Parts(args) => args.run(registry),
            Self::Params(args) => args.run(registry),
            Self::Runs(args) => args.run(registry),
            Self::Report(args) => args.run(registry),
            Self::Store(args) => args.run(),
            Self::Inspect(args) => args.run(registry),
            Self::Export(args) => args.run(),
            Self::Archive(args) => args.run(),
            Self::Init(args) => args.run(),
            Self::Manual(args) => args.run(registry),
            Self::Completions(args) => {
                args.run();
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_command_is_sound() {
        <super::Cli as clap::CommandFactory>::command().debug_assert();
    }
}
