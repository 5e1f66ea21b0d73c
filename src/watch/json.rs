//! One JSON object a line, for programs.

use std::io::Write;

use super::{Event, Observer, Progress};

/// Writes every event as a line of JSON.
pub struct JsonLines<W>(pub W);

impl<W: Write> Observer for JsonLines<W> {
    fn event(&mut self, event: &Event, progress: Progress) {
        let mut value = serde_json::json!(event);
        if let Some(map) = value.as_object_mut() {
            map.insert("done".into(), progress.done.into());
            map.insert("total".into(), progress.total.into());
        }
        // A closed pipe ends the watching, not the run.
        let _ = writeln!(self.0, "{value}");
    }
}
