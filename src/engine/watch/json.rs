//! One JSON object a line, for programs.

use std::io::Write;

use super::{Event, Observer, Progress};

/// Lines about what is cached are written together up to this size: there may be very many of them, all at once.
const TOGETHER_BYTES: usize = 32 << 10;

/// Writes every event as a line of JSON.
pub struct JsonLines<W: Write> {
    out: W,
    /// Lines that are not written yet.
    pending: Vec<u8>,
}

impl<W: Write> JsonLines<W> {
    /// A watcher that writes one line for each event to `out`.
    pub fn new(out: W) -> Self {
        Self { out, pending: Vec::new() }
    }

    /// A closed pipe ends the watching, not the run.
    fn flush(&mut self) {
        let _ = self.out.write_all(&self.pending).and_then(|()| self.out.flush());
        self.pending.clear();
    }
}

impl<W: Write> Observer for JsonLines<W> {
    fn event(&mut self, event: &Event, progress: Progress) {
        #[derive(serde::Serialize)]
        struct Line<'a> {
            #[serde(skip_serializing_if = "Option::is_none")]
            version: Option<u32>,
            #[serde(flatten)]
            event: &'a Event,
            done: usize,
            total: usize,
        }
        let version = matches!(event, Event::Planned { .. }).then_some(super::events::VERSION);
        let line = Line { version, event, done: progress.done, total: progress.total };
        if let Ok(line) = serde_json::to_string(&line) {
            self.pending.extend(crate::diagnostic::printable(&line).as_bytes());
            self.pending.push(b'\n');
        }
        if !matches!(event, Event::Cached { .. }) || self.pending.len() > TOGETHER_BYTES {
            self.flush();
        }
    }

    fn end(&mut self) {
        self.flush();
    }
}

impl<W: Write> Drop for JsonLines<W> {
    fn drop(&mut self) {
        self.flush();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_event_is_a_line_and_none_but_cached_ones_wait() {
        let mut out = Vec::new();
        let mut lines = JsonLines::new(&mut out);
        let progress = Progress { done: 1, total: 2, remaining_s: None };
        lines.event(&Event::Cached { step: "a".into() }, progress);
        lines.event(&Event::Finished { step: "b".into(), wall_s: 0.5 }, progress);
        assert!(lines.pending.is_empty());
        lines.event(&Event::Cached { step: "c".into() }, progress);
        drop(lines);
        let text = String::from_utf8(out).unwrap();
        let first: serde_json::Value = serde_json::from_str(text.lines().next().unwrap()).unwrap();
        assert_eq!(first, serde_json::json!({"event": "cached", "step": "a", "done": 1, "total": 2}));
        assert_eq!(text.lines().count(), 3);
    }
}
