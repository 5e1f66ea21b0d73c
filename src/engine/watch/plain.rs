//! Plain lines, for logs and pipes.

use std::collections::HashMap;
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
    lines: Lines,
}

impl<W: Write> Plain<W> {
    /// A watcher that writes lines to `out`; `verbose` adds those of cached, started and quickly done instances.
    pub fn new(out: W, verbose: bool) -> Self {
        Self { out, verbose, last: Instant::now(), lines: Lines::default() }
    }

    /// A closed pipe ends the watching, not the run.
    fn say(&mut self, text: &str) {
        let _ = writeln!(self.out, "{text}");
    }
}

/// Warnings that differ in their numbers only, of which so many are told in full.
const ALIKE: usize = 2;

/// The lines of events, of which warnings that are alike are not told again and again.
#[derive(Default)]
pub struct Lines {
    /// How often each warning was given, by its text without digits.
    warnings: HashMap<String, usize>,
}

impl Lines {
    /// The line an event is worth, if any; with `verbose` every warning is.
    pub fn line(&mut self, event: &Event, verbose: bool) -> Option<String> {
        let words = match event {
            Event::Warning { step, text } if !verbose => {
                let alike: String = text.chars().filter(|letter| !letter.is_ascii_digit()).collect();
                let count = self.warnings.entry(alike).or_default();
                *count += 1;
                if *count == ALIKE + 1 {
                    Some(format!("warning  {step}: another like these; further ones are in the report"))
                } else {
                    words(event, verbose).filter(|_| *count <= ALIKE)
                }
            }
            _ => words(event, verbose),
        };
        words.map(|text| printable(&text).into_owned())
    }
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
        if let Some(line) = self.lines.line(event, self.verbose) {
            self.say(&line);
        }
        if matches!(event, Event::Finished { .. }) && self.last.elapsed() >= PROGRESS_EVERY {
            self.last = Instant::now();
            let left = progress.remaining_s.map(|s| format!(", about {} left", duration(s))).unwrap_or_default();
            self.say(&format!("[{}/{}]{left}", progress.done, progress.total));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_that_are_alike_are_told_twice_and_then_once_for_all() {
        let mut lines = Lines::default();
        let mut told = |step: &str, text: &str, verbose: bool| {
            lines.line(&Event::Warning { step: step.to_owned(), text: text.to_owned() }, verbose)
        };
        assert_eq!(told("a[i=1]", "3 cells", false).unwrap(), "warning  a[i=1]: 3 cells");
        assert!(told("a[i=2]", "41 cells", false).is_some_and(|line| line.ends_with("41 cells")));
        assert!(told("b", "no cells", false).is_some());
        assert!(told("a[i=3]", "7 cells", false).is_some_and(|line| line.contains("a[i=3]: another like these")));
        assert_eq!(told("a[i=4]", "8 cells", false), None);
        assert!(told("a[i=5]", "9 cells", true).is_some());
    }
}
