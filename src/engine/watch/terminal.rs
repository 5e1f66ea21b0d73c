//! A progress line with the remaining time, for people at a terminal.

use std::collections::BTreeSet;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use super::plain::Lines;
use super::{Event, Observer, Progress, duration};
use crate::diagnostic::printable;

/// A bar, what is running, and the time left; warnings and failures scroll above it.
pub struct Terminal {
    bar: ProgressBar,
    running: BTreeSet<String>,
    verbose: bool,
    lines: Lines,
}

impl Terminal {
    /// Draws on standard error.
    pub fn new(verbose: bool) -> Self {
        let bar = ProgressBar::new(0);
        let style = ProgressStyle::with_template("{bar:24} {pos}/{len} {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("━╸ "));
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { bar, running: BTreeSet::new(), verbose, lines: Lines::default() }
    }
}

impl Observer for Terminal {
    fn ignores_cached(&self) -> bool {
        !self.verbose
    }

    fn event(&mut self, event: &Event, progress: Progress) {
        match event {
            Event::Started { step, .. } => {
                self.running.insert(step.clone());
            }
            Event::Finished { step, .. } | Event::Failed { step, .. } => {
                self.running.remove(step);
            }
            _ => {}
        }
        let telling = matches!(event, Event::Warning { .. } | Event::Failed { .. } | Event::Waiting { .. });
        if let Some(line) = self.lines.line(event, self.verbose).filter(|_| telling || self.verbose) {
            self.bar.println(line);
        }
        self.bar.set_length(progress.total as u64);
        self.bar.set_position(progress.done as u64);
        let left = progress.remaining_s.map(|s| format!("about {} left  ", duration(s))).unwrap_or_default();
        let names: Vec<&str> = self.running.iter().take(2).map(String::as_str).collect();
        self.bar.set_message(format!("{left}{}", printable(&names.join("  "))));
    }

    fn end(&mut self) {
        self.bar.finish_and_clear();
    }
}
