//! Where the time of a command went: spans of the engine as a file that Perfetto and Chrome draw, a row for each thread.

use std::collections::HashMap;
use std::fmt::Debug;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::ThreadId;
use std::time::Instant;

use crate::cli::write_own;
use rockface_engine::PHASE;
use serde_json::{Value, json};
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::registry::LookupSpan;

/// What a file of a trace begins with.
pub const BEGINS: &[u8] = b"{\"displayTimeUnit\"";

/// Spans that are over, in memory until they are written: a step has about ten, of a hundred bytes each.
#[derive(Debug, Clone)]
pub struct Trace {
    begun: Instant,
    shared: Arc<Mutex<Recorded>>,
}

#[derive(Debug, Default)]
struct Recorded {
    spans: Vec<Over>,
    /// Rows in the order in which threads first did something, with their names.
    rows: HashMap<ThreadId, (usize, String)>,
}

#[derive(Debug)]
struct Over {
    name: &'static str,
    fields: Fields,
    row: usize,
    start_us: f64,
    duration_us: f64,
}

/// What a span says of itself.
#[derive(Debug, Clone, Default)]
struct Fields(serde_json::Map<String, Value>);

/// When a span was entered.
struct Entered(Instant);

impl Visit for Fields {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.0.insert(field.name().to_owned(), format!("{value:?}").into());
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.0.insert(field.name().to_owned(), value.into());
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.0.insert(field.name().to_owned(), value.into());
    }
}

impl Trace {
    /// A new trace; times in it count from now.
    pub fn begin() -> Self {
        Self { begun: Instant::now(), shared: Arc::default() }
    }

    /// Writes the spans so far as a Chrome trace (JSON, times in microseconds), whole or not at all.
    ///
    /// # Errors
    /// Those of the disk.
    pub fn write(&self, to: &Path) -> std::io::Result<()> {
        write_own(to, self.events().to_string().as_bytes())
    }

    fn events(&self) -> Value {
        let recorded = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let mut rows: Vec<_> = recorded.rows.values().collect();
        rows.sort_unstable();
        let rows = rows
            .into_iter()
            .map(|(row, name)| json!({"ph": "M", "name": "thread_name", "pid": 1, "tid": row, "args": {"name": name}}));
        let spans = recorded.spans.iter().map(|span| {
            let Over { name, fields, row, start_us, duration_us } = span;
            json!({"ph": "X", "name": name, "pid": 1, "tid": row, "ts": start_us, "dur": duration_us, "args": fields.0})
        });
        json!({"displayTimeUnit": "ms", "traceEvents": rows.chain(spans).collect::<Vec<_>>()})
    }
}

impl<S: tracing::Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Trace {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        if let Some(span) = context.span(id) {
            let mut fields = Fields::default();
            attributes.record(&mut fields);
            span.extensions_mut().insert(fields);
        }
    }

    fn on_enter(&self, id: &Id, context: Context<'_, S>) {
        if let Some(span) = context.span(id) {
            span.extensions_mut().replace(Entered(Instant::now()));
        }
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        let now = Instant::now();
        let Some(span) = context.span(id) else { return };
        let mut extensions = span.extensions_mut();
        let Some(Entered(start)) = extensions.remove::<Entered>() else { return };
        let fields = extensions.get_mut::<Fields>().cloned().unwrap_or_default();
        let micros = |from: Instant, to: Instant| to.saturating_duration_since(from).as_secs_f64() * 1e6;
        let mut recorded = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        let next = recorded.rows.len();
        let thread = std::thread::current();
        let named = || (next, thread.name().map_or_else(|| format!("worker {next}"), str::to_owned));
        let row = recorded.rows.entry(thread.id()).or_insert_with(named).0;
        let (start_us, duration_us) = (micros(self.begun, start), micros(start, now));
        recorded.spans.push(Over { name: span.name(), fields, row, start_us, duration_us });
    }
}

/// Whether a span is one that a trace shows.
pub fn is_phase(metadata: &tracing::Metadata<'_>) -> bool {
    metadata.is_span() && metadata.target() == PHASE
}

#[cfg(test)]
mod tests {
    use super::*;
    use tracing_subscriber::filter::filter_fn;
    use tracing_subscriber::prelude::*;

    #[test]
    fn spans_are_written_with_their_thread_and_what_they_say() {
        let trace = Trace::begin();
        let subscriber = tracing_subscriber::registry().with(trace.clone().with_filter(filter_fn(is_phase)));
        tracing::subscriber::with_default(subscriber, || {
            tracing::trace_span!(target: PHASE, "outer", step = "dem").in_scope(|| {
                tracing::trace_span!(target: PHASE, "inner", bytes = 7u64).in_scope(|| ());
                tracing::trace_span!("elsewhere").in_scope(|| ());
            });
        });
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("t.json");
        trace.write(&file).unwrap();
        let read: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
        let events = read["traceEvents"].as_array().unwrap();
        let names: Vec<_> = events.iter().filter(|event| event["ph"] == "X").map(|event| &event["name"]).collect();
        assert_eq!(names, ["inner", "outer"]);
        assert_eq!((&events[1]["args"]["bytes"], &events[2]["args"]["step"]), (&json!(7), &json!("dem")));
        assert!(events[1]["ts"].as_f64() >= events[2]["ts"].as_f64());
        trace.write(&folder.path().join("none/t.json")).unwrap_err();
    }
}
