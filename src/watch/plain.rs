//! Plain lines, for logs and pipes.

use std::io::Write;

use super::{Event, Observer, Progress, duration};

/// Writes a line for each thing worth one; with `verbose`, cached instances too.
pub struct Plain<W> {
    out: W,
    verbose: bool,
}

impl<W: Write> Plain<W> {
    /// Writes to `out`.
    pub fn new(out: W, verbose: bool) -> Self {
        Self { out, verbose }
    }
}

/// The line an event is worth, if any.
pub fn line(event: &Event, verbose: bool) -> Option<String> {
    match event {
        Event::Planned { steps } => verbose.then(|| format!("{steps} step instances")),
        Event::Cached { step } => verbose.then(|| format!("cached   {step}")),
        Event::Started { step, .. } => verbose.then(|| format!("started  {step}")),
        Event::Finished { step, wall_s } => Some(format!("done     {step} ({})", duration(*wall_s))),
        Event::Waiting { step } => Some(format!("waiting  {step}: another run is computing it")),
        Event::Warning { step, text } => Some(format!("warning  {step}: {text}")),
        Event::Failed { step, stage, message, hint } => {
            let hint = hint.as_ref().map(|hint| format!("\n         help: {hint}")).unwrap_or_default();
            Some(format!("failed   {step} ({stage}): {message}{hint}"))
        }
    }
}

impl<W: Write> Observer for Plain<W> {
    fn event(&mut self, event: &Event, progress: Progress) {
        let Some(line) = line(event, self.verbose) else { return };
        let counted = matches!(event, Event::Finished { .. });
        let count = if counted { format!("[{}/{}] ", progress.done, progress.total) } else { String::new() };
        // A closed pipe ends the watching, not the run.
        let _ = writeln!(self.out, "{count}{line}");
    }
}
