//! What is said in words and numbers: notes on instances, log lines, metrics, tables.

use ::foxglove::messages::{self as proto, log::Level};
use rockface_stages::Point;
use rockface_stages::artefact::Table;
use serde_json::{Map, Value, json};

use super::super::step_log::Entry;
use super::{Message, Place, json_message, message, object_schema};

/// The note on an instance.
pub fn step(place: &Place, value: &Value) -> Message {
    let schema = object_schema(
        "rockface.Step",
        &[
            ("step", "string", "name of the step"),
            ("point", "object", "item of each axis"),
            ("stage", "string", "name of the stage"),
            ("version", "integer", "its version"),
            ("key", "string", "BLAKE3 of the recipe"),
            ("outputs", "object", "by port: kind, BLAKE3 digest, bytes, whether kept"),
            ("entries", "array", "notes, warnings, headlines and metrics in the order they were made"),
            (
                "shown",
                "array",
                "sketches: port, part, topics, what was left out, what colours mean, digest and file of the whole",
            ),
            ("unshown", "string", "why there are no sketches though they are wanted"),
        ],
    );
    json_message(schema, place.topic("step", ""), value)
}

/// A line a note, warning and headline.
pub fn log(place: &Place, label: &str, entries: &[Entry]) -> Vec<Message> {
    let line = |entry: &Entry| {
        let (level, text) = match entry {
            Entry::Note { text } | Entry::Headline { text } => (Level::Info, text),
            Entry::Warning { text } => (Level::Warning, text),
            Entry::Metric { .. } => return None,
        };
        let line = proto::Log {
            timestamp: Some(place.time()),
            level: level as i32,
            message: text.clone(),
            name: label.to_owned(),
            file: String::new(),
            line: 0,
        };
        Some(message("foxglove.Log", "/log".to_owned(), &line))
    };
    entries.iter().filter_map(line).collect()
}

/// All numbers an instance told, in one message; none if it told none.
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
    let schema = object_schema(
        "rockface.Metrics",
        &[
            ("point", "object", "item of each axis"),
            ("values", "object", "numbers by name"),
            ("units", "object", "their units by name"),
        ],
    );
    let value = json!({"point": point, "values": values, "units": units});
    vec![json_message(schema, place.topic("metrics", ""), &value)]
}

/// A table, a row an object.
pub fn table(topic: String, table: &Table) -> Message {
    let schema = object_schema(
        "rockface.Table",
        &[("columns", "array", "names of the columns"), ("rows", "array", "a row each: values by column")],
    );
    let row =
        |row: &Vec<_>| -> Value { table.columns.iter().cloned().zip(row.iter().map(|cell| json!(cell))).collect() };
    let rows: Vec<Value> = table.rows.iter().map(row).collect();
    json_message(schema, topic, &json!({"columns": table.columns, "rows": rows}))
}

/// Anything else.
pub fn values(topic: String, value: &Value) -> Message {
    let schema = object_schema("rockface.Values", &[("value", "object", "the artefact as it is kept")]);
    json_message(schema, topic, &json!({"value": value}))
}
