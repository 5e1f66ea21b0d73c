//! What is said in words and numbers: notes on instances, log lines, metrics, tables.

use ::foxglove::messages::{self as proto, log::Level};
use rockface_core::Point;
use rockface_core::artefact::Table;
use serde_json::{Map, Value, json};

use super::super::step_log::Entry;
use super::{Message, Place, Schema, message};

const STEP: &str = r#"{"type": "object", "title": "rockface.Step", "properties": {
"step": {"type": "string", "description": "name of the step"},
"point": {"type": "object", "description": "item of each axis"},
"stage": {"type": "string", "description": "name of the stage"},
"version": {"type": "integer", "description": "its version"},
"key": {"type": "string", "description": "BLAKE3 of the recipe"},
"outputs": {"type": "object", "description": "by port: kind, BLAKE3 digest, bytes, whether kept"},
"failure": {"type": "string", "description": "why it failed; empty if it did not"},
"entries": {"type": "array", "description": "notes, warnings, headlines and metrics in the order they were made"},
"shown": {"type": "array", "description":
 "sketches: port, part, topics, what was left out, what colours mean, digest and file of the whole"},
"unshown": {"type": "string", "description": "why there are no sketches though they are wanted"}}}"#;

const METRICS: &str = r#"{"type": "object", "title": "rockface.Metrics", "properties": {
"point": {"type": "object", "description": "item of each axis"},
"values": {"type": "object", "description": "numbers by name"},
"units": {"type": "object", "description": "their units by name"}}}"#;

const TABLE: &str = r#"{"type": "object", "title": "rockface.Table", "properties": {
"columns": {"type": "array", "description": "names of the columns"},
"rows": {"type": "array", "description": "an object a row: values by column"}}}"#;

const VALUES: &str = r#"{"type": "object", "title": "rockface.Values", "properties": {
"value": {"description": "the artefact as it is kept"}}}"#;

fn of_json(name: &'static str, text: &'static str, topic: String, data: Vec<u8>) -> Message {
    Message { topic, schema: Schema { name, encoding: "jsonschema", text: text.as_bytes().into() }, data }
}

/// The note on an instance, JSON.
pub fn step(place: &Place, data: Vec<u8>) -> Message {
    of_json("rockface.Step", STEP, place.topic("step", ""), data)
}

/// A line a note, warning and headline, and the last for why the instance failed, if it did.
pub fn log(place: &Place, label: &str, entries: &[Entry], failure: Option<&str>) -> Vec<Message> {
    let said = |entry: &Entry| match entry {
        Entry::Note { text } | Entry::Headline { text } => Some((Level::Info, text.clone())),
        Entry::Warning { text } => Some((Level::Warning, text.clone())),
        Entry::Metric { .. } => None,
    };
    let line = |(level, text): (Level, String)| {
        let line = proto::Log {
            timestamp: Some(place.time()),
            level: level as i32,
            message: text,
            name: label.to_owned(),
            file: String::new(),
            line: 0,
        };
        message("foxglove.Log", "/log".to_owned(), &line)
    };
    let failure = failure.map(|text| (Level::Error, format!("failed: {text}")));
    entries.iter().filter_map(said).chain(failure).map(line).collect()
}

/// All metrics that an instance logged, in one message; none if it logged none.
pub fn metrics(place: &Place, point: &Point, entries: &[Entry]) -> Vec<Message> {
    let (mut values, mut units) = (Map::new(), Map::new());
    for entry in entries {
        if let Entry::Metric { name, value, unit } = entry {
            values.insert(name.clone(), json!(value));
            units.insert(name.clone(), json!(unit));
        }
    }
    if values.is_empty() {
        return Vec::new();
    }
    let value = json!({"point": point, "values": values, "units": units});
    vec![of_json("rockface.Metrics", METRICS, place.topic("metrics", ""), value.to_string().into_bytes())]
}

/// A table, a row an object.
pub fn table(topic: String, table: &Table) -> Message {
    let row =
        |row: &Vec<_>| -> Value { table.columns.iter().cloned().zip(row.iter().map(|cell| json!(cell))).collect() };
    let rows: Vec<Value> = table.rows.iter().map(row).collect();
    let value = json!({"columns": table.columns, "rows": rows});
    of_json("rockface.Table", TABLE, topic, value.to_string().into_bytes())
}

/// A value with no schema of its own, as JSON.
pub fn values(topic: String, value: &Value) -> Message {
    of_json("rockface.Values", VALUES, topic, json!({"value": value}).to_string().into_bytes())
}
