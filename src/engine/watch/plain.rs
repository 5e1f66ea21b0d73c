//! Plain lines, for logs and pipes.

use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::time::{Duration, Instant};

use super::{Event, Observer, Progress, duration};
use crate::diagnostic::printable;

/// How often a line of progress is due.
const PROGRESS_EVERY: Duration = Duration::from_secs(2);

/// After so long without a line, what is running is named.
const QUIET: Duration = Duration::from_secs(30);

/// How many of those that run are named.
const NAMED: usize = 2;

/// An instance that took as long as this gets a line of its own, seconds.
const LONG_S: f64 = 1.0;

/// Writes a line for each thing worth one, and now and then how far it is and what is running; with `verbose`, a line for every instance.
pub struct Plain<W> {
    out: W,
    verbose: bool,
    quiet: Duration,
    /// When how far it is was last told.
    last: Instant,
    /// When anything was last told.
    said: Instant,
    /// Since when each instance runs.
    running: BTreeMap<String, Instant>,
    lines: Lines,
}

impl<W: Write> Plain<W> {
    /// A watcher that writes lines to `out`; `verbose` adds those of cached, started and quickly done instances.
    pub fn new(out: W, verbose: bool) -> Self {
        let now = Instant::now();
        Self { out, verbose, quiet: QUIET, last: now, said: now, running: BTreeMap::new(), lines: Lines::default() }
    }

    /// A closed pipe ends the watching, not the run.
    fn say(&mut self, text: &str) {
        let _ = writeln!(self.out, "{text}");
        self.said = Instant::now();
    }

    /// Those that have run the longest, by name.
    fn longest(&self) -> String {
        let mut running: Vec<_> = self.running.iter().map(|(step, since)| (since, step)).collect();
        running.sort();
        let more = running.len().saturating_sub(NAMED);
        let named = running
            .iter()
            .take(NAMED)
            .map(|(since, step)| format!("{step} ({})", duration(since.elapsed().as_secs_f64())));
        let mut names = named.collect::<Vec<_>>().join(", ");
        if more > 0 {
            names += &format!(", and {more} more");
        }
        names
    }
}

/// Warnings that differ in their numbers only, of which so many are told in full.
const ALIKE: usize = 2;

/// Counts warnings that are alike.
#[derive(Default)]
pub struct Alike {
    /// How often each warning was given, by its text without digits.
    counts: HashMap<String, usize>,
}

impl Alike {
    /// How many like this one there were, this one among them.
    fn count(&mut self, text: &str) -> usize {
        let alike: String = text.chars().filter(|letter| !letter.is_ascii_digit()).collect();
        let count = self.counts.entry(alike).or_default();
        *count += 1;
        *count
    }

    /// Whether a warning is one of the first of its kind, which are told in full.
    pub fn is_told(&mut self, text: &str) -> bool {
        self.count(text) <= ALIKE
    }
}

/// The lines of events, of which warnings that are alike are not told again and again.
#[derive(Default)]
pub struct Lines {
    warnings: Alike,
}

impl Lines {
    /// The line an event is worth, if any; with `verbose` every warning is.
    pub fn line(&mut self, event: &Event, verbose: bool) -> Option<String> {
        let words = match event {
            Event::Warning { step, text } if !verbose => {
                let count = self.warnings.count(text);
                if count == ALIKE + 1 {
                    Some(format!("warning  {step}: another like these; further ones are in the report"))
                } else {
                    words(event, verbose).filter(|_| count <= ALIKE)
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

/// How far a run is.
fn so_far(progress: Progress) -> String {
    let left = progress.remaining_s.map(|s| format!(", about {} left", duration(s))).unwrap_or_default();
    format!("[{}/{}]{left}", progress.done, progress.total)
}

impl<W: Write> Observer for Plain<W> {
    fn ignores_cached(&self) -> bool {
        !self.verbose
    }

    fn event(&mut self, event: &Event, progress: Progress) {
        match event {
            Event::Started { step, .. } => {
                self.running.insert(step.clone(), Instant::now());
            }
            Event::Finished { step, .. } | Event::Failed { step, .. } | Event::Elsewhere { step } => {
                self.running.remove(step);
            }
            _ => {}
        }
        if let Some(line) = self.lines.line(event, self.verbose) {
            self.say(&line);
        }
        if matches!(event, Event::Finished { .. }) && self.last.elapsed() >= PROGRESS_EVERY {
            self.last = Instant::now();
            self.say(&so_far(progress));
        }
    }

    fn idle(&mut self, progress: Progress) {
        if self.said.elapsed() >= self.quiet && !self.running.is_empty() {
            let line = format!("{}; running {}", so_far(progress), self.longest());
            self.say(&printable(&line));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Reason;
    use super::*;

    #[test]
    fn what_runs_is_named_while_nothing_happens() {
        let mut plain = Plain::new(Vec::new(), false);
        let progress = Progress { done: 1, total: 9, remaining_s: Some(200.4) };
        let start = |step: &str| Event::Started { step: step.to_owned(), reason: Reason::New };
        plain.event(&start("learnt"), progress);
        plain.idle(progress);
        assert!(plain.out.is_empty(), "it has not been quiet for long");
        plain.quiet = Duration::ZERO;
        plain.idle(progress);
        for step in ["b", "a", "quick"] {
            plain.event(&start(step), progress);
        }
        plain.event(&Event::Finished { step: "quick".to_owned(), wall_s: 0.0 }, progress);
        plain.idle(progress);
        for step in ["learnt", "b", "a"] {
            plain.event(&Event::Finished { step: step.to_owned(), wall_s: 0.0 }, progress);
        }
        plain.idle(progress);
        let told = "[1/9], about 3 min 20 s left; running learnt (0.0 s)";
        assert_eq!(String::from_utf8(plain.out).unwrap(), format!("{told}\n{told}, b (0.0 s), and 1 more\n"));
    }

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
