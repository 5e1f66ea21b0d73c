//! Plain lines, for logs and pipes.

use std::io::Write;
use std::time::{Duration, Instant};

use super::{Event, Observer, Progress, duration, printable};

/// How often a line of progress is due.
const PROGRESS_EVERY: Duration = Duration::from_secs(2);

/// An instance that took as long as this gets a line of its own, seconds.
const LONG_S: f64 = 1.0;

/// Writes a line for each thing worth one, and now and then how far it is; with `verbose`, a line for every instance.
pub struct Plain<W> {
    out: W,
    verbose: bool,
    last: Instant,
}

impl<W: Write> Plain<W> {
    /// A watcher that writes lines to `out`; `verbose` adds those of cached, started and quickly done instances.
    pub fn new(out: W, verbose: bool) -> Self {
        Self { out, verbose, last: Instant::now() }
    }

    /// A closed pipe ends the watching, not the run.
    fn say(&mut self, text: &str) {
        let _ = writeln!(self.out, "{text}");
    }
}

/// The line an event is worth, if any.
pub fn line(event: &Event, verbose: bool) -> Option<String> {
    words(event, verbose).map(|text| printable(&text).into_owned())
}

fn words(event: &Event, verbose: bool) -> Option<String> {
    match event {
        Event::Planned { steps } => verbose.then(|| format!("{steps} step instances")),
        Event::Cached { step } => verbose.then(|| format!("cached   {step}")),
        Event::Held { step, need_bytes } => {
            let mib = need_bytes.div_ceil(1 << 20);
            verbose.then(|| format!("held     {step}: it needs about {mib} MiB, and others are running"))
        }
        Event::Started { step, .. } => verbose.then(|| format!("started  {step}")),
        Event::Finished { step, wall_s } if verbose || *wall_s >= LONG_S => {
            Some(format!("done     {step} ({})", duration(*wall_s)))
        }
        Event::Finished { .. } | Event::Elsewhere { .. } => None,
        Event::Waiting { step } => Some(format!("waiting  {step}: another run is computing it")),
        Event::Warning { step, text } => Some(format!("warning  {step}: {text}")),
        Event::Failed { step, stage, message, hint } => {
            let hint = hint.as_ref().map(|hint| format!("\n         help: {hint}")).unwrap_or_default();
            Some(format!("failed   {step} ({stage}): {message}{hint}"))
        }
    }
}

impl<W: Write> Observer for Plain<W> {
    fn ignores_cached(&self) -> bool {
        !self.verbose
    }

    fn event(&mut self, event: &Event, progress: Progress) {
        if let Some(line) = line(event, self.verbose) {
            self.say(&line);
        }
        if matches!(event, Event::Finished { .. }) && self.last.elapsed() >= PROGRESS_EVERY {
            self.last = Instant::now();
            let left = progress.remaining_s.map(|s| format!(", about {} left", duration(s))).unwrap_or_default();
            self.say(&format!("[{}/{}]{left}", progress.done, progress.total));
        }
    }
}
