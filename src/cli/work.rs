//! `rockface work`: a process that helps others with a run and says little.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args;
use rockface_core::Registry;
use rockface_engine::run::{self, Options};
use rockface_engine::watch::{Reported, Role};

use super::capacity::CapacityArgs;
use super::programs::ProgramArgs;
use super::run::{quiet_observer, upload};
use super::{CliError, PipelineArgs, say, signals};

/// Arguments of `rockface work`.
#[derive(Debug, Args)]
pub struct WorkArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    programs: ProgramArgs,
    #[command(flatten)]
    capacity: CapacityArgs,
    /// After a failed step, continue with steps that do not depend on it.
    #[arg(long)]
    keep_going: bool,
}

/// Where a process begins: multiples of the golden ratio lie far apart, also those of successive numbers.
fn start(process: u32) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    (f64::from(process) * GOLDEN).fract()
}

impl WorkArgs {
    /// Takes steps that are ready and that no other process has, until all are done.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        self.pipeline.take()?;
        self.pipeline.no_programs = self.programs.are_refused();
        let mut pipeline = self.pipeline.load(registry)?;
        self.programs.check(registry, &pipeline, &self.pipeline.target)?;
        let (mut plan, store) = self.pipeline.plan(registry, &mut pipeline, &self.pipeline.target)?;
        let start = start(std::process::id());
        let mut options = Options { keep_going: self.keep_going, look: registry.look(), start, ..Options::default() };
        self.capacity.apply(&mut options);
        let stop = Arc::new(AtomicBool::new(false));
        signals::stop_on_signal(&stop);
        let store = Arc::new(store);
        let mut observer =
            Reported::new(quiet_observer(), &store, Role::Work, &self.pipeline.pipeline, &pipeline.document.name);
        let summary = run::execute(&mut plan, &store, &options, &stop, &mut observer).inspect_err(|_| store.leave())?;
        store.adopt(summary.keys().map(|(_, key)| key))?;
        upload(&store, &stop);
        let (ran, all) = (summary.executed(), summary.instances.len());
        let verdict = if summary.failed { "failed" } else { "done" };
        say(&format!("{verdict}: ran {ran} of {all} steps, {}", rockface_engine::watch::duration(summary.wall_s)));
        let failed = summary.failed;
        // The process ends now: dropping a large plan would only take time.
        drop((observer, store));
        std::mem::forget((pipeline, plan, summary));
        if failed { Err(CliError::Failed) } else { Ok(()) }
    }
}
