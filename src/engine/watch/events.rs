//! What the lines of `rockface run --json` are: one list of events and their members, for the schema and for people.

use serde_json::{Map, Value, json};

/// The version of the lines. A member that is added leaves it; one that is renamed, removed or means something else raises it.
pub const VERSION: u32 = 1;

/// A member of an event.
struct Member {
    name: &'static str,
    /// Its type in JSON Schema, `|null` where it may be absent in meaning.
    kind: &'static str,
    doc: &'static str,
}

const fn member(name: &'static str, kind: &'static str, doc: &'static str) -> Member {
    Member { name, kind, doc }
}

const STEP: Member = member("step", "string", "the step instance, such as `dem[epoch=pre]`");

/// Every event: its name, when it is written, its members.
const EVENTS: &[(&str, &str, &[Member])] = &[
    (
        "planned",
        "The first line: the pipeline is read and planned.",
        &[
            member("version", "integer", "the version of these lines"),
            member("steps", "integer", "step instances, as far as they are known"),
        ],
    ),
    ("cached", "The outputs of an instance are known; it is not run.", &[STEP]),
    (
        "started",
        "An instance starts.",
        &[
            STEP,
            member(
                "reason",
                "new|needed",
                "`new`: no record has its recipe; `needed`: its outputs were not kept and are needed",
            ),
        ],
    ),
    ("finished", "An instance is done.", &[STEP, member("wall_s", "number", "elapsed seconds")]),
    (
        "held",
        "An instance could start and waits for memory.",
        &[STEP, member("need_bytes", "integer", "what it is expected to need")],
    ),
    (
        "elsewhere",
        "Another process has the instance, or has had it: it is not run here for now. A `started` of it before is taken back.",
        &[STEP],
    ),
    ("waiting", "Another process computes the same; this one waits for it.", &[STEP]),
    ("warning", "Something may be wrong.", &[STEP, member("text", "string", "the sentence")]),
    (
        "failed",
        "An instance failed.",
        &[
            STEP,
            member("stage", "string", "its stage"),
            member("message", "string", "the cause"),
            member("hint", "string|null", "the way out"),
        ],
    ),
    (
        "ended",
        "The last line: the run is over. Its exit code says the same as `failed`. A run that is interrupted, or whose store fails, ends without it.",
        &[
            member("failed", "boolean", "whether an instance failed"),
            member("executed", "integer", "instances that ran"),
            member("cached", "integer", "instances that were known"),
            member("wall_s", "number", "elapsed seconds"),
            member("folder", "string", "the run folder"),
            member("headlines", "strings", "the results in a sentence each"),
            member(
                "warnings",
                "strings",
                "what stages warned of, those of cached steps too; warnings of the engine itself are events `warning` only",
            ),
            member("files", "strings", "outputs of the target steps, by their paths in the run folder"),
            member(
                "repeated",
                "object|null",
                "where a `run.json` was run again: how many outputs are the `same`, how many `others` there are, and `lines` about them",
            ),
            member("remote", "object|null", "requests to the remote place and bytes, by kind"),
        ],
    ),
];

/// Members of every event but `ended`.
const PROGRESS: [Member; 2] = [
    member("done", "integer", "instances that are done, cached ones included"),
    member("total", "integer", "all instances; it grows where an axis takes its items from a step"),
];

fn members(name: &str, own: &'static [Member]) -> impl Iterator<Item = &'static Member> {
    own.iter().chain(if name == "ended" { &[][..] } else { &PROGRESS[..] })
}

/// The type of a member in JSON Schema.
fn kind(kind: &str) -> Value {
    match kind {
        "new|needed" => json!({"enum": ["new", "needed"]}),
        "object|null" => json!({"type": ["object", "null"]}),
        "string|null" => json!({"type": ["string", "null"]}),
        "strings" => json!({"type": "array", "items": {"type": "string"}}),
        "integer" => json!({"type": "integer", "minimum": 0}),
        "number" => json!({"type": "number", "minimum": 0}),
        other => json!({"type": other}),
    }
}

/// The JSON Schema of a line.
pub fn schema() -> Value {
    let event = |(name, doc, own): &(&str, &str, &'static [Member])| {
        let mut properties = Map::new();
        properties.insert("event".into(), json!({"const": name}));
        for member in members(name, own) {
            let mut value = kind(member.kind);
            value["description"] = member.doc.into();
            if member.name == "version" {
                value = json!({"const": VERSION, "description": member.doc});
            }
            properties.insert(member.name.into(), value);
        }
        let required: Vec<&String> = properties.keys().collect();
        json!({"title": name, "description": doc, "type": "object", "required": required, "properties": properties})
    };
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "a line of `rockface run --json`",
        "description": "Lines are JSON objects. Members and events may be added within a version: ignore those you do not know.",
        "oneOf": EVENTS.iter().map(event).collect::<Vec<_>>(),
    })
}

/// The chapter on events, as Markdown.
pub fn chapter() -> String {
    let mut text = format!(
        "# Events\n\n`rockface run --json` writes a JSON object a line to standard output, for programs that watch a run. This is version {VERSION} of them; \
         the line `planned` has it as `version`. Members and events may be added within a version: ignore those you do not know. One that is renamed, \
         removed or means something else raises the version.\n\nThe order of `started` and `finished` depends on the machine; which instances are run and \
         which are cached does not. A pipeline that is wrong writes no events: its faults are on standard error as text, and the exit code is 2.\n\n\
         `rockface manual events` prints the [JSON Schema](events.schema.json).\n"
    );
    for (name, doc, own) in EVENTS {
        text += &format!("\n## {name}\n\n{doc}\n\n| member | type | what |\n|---|---|---|\n");
        for member in members(name, own) {
            let kind = match member.kind {
                "new|needed" => "`new` or `needed`",
                "object|null" => "object or null",
                "string|null" => "text or null",
                "strings" => "list of texts",
                "string" => "text",
                "integer" => "whole number",
                other => other,
            };
            text += &format!("| `{}` | {kind} | {} |\n", member.name, member.doc);
        }
    }
    text + "\n## Example\n\n```text\n{\"version\":1,\"event\":\"planned\",\"steps\":2,\"done\":0,\"total\":2}\n{\"event\":\"cached\",\"step\":\"face\",\"done\":1,\"total\":2}\n\
            {\"event\":\"started\",\"step\":\"dem\",\"reason\":\"new\",\"done\":1,\"total\":2}\n{\"event\":\"finished\",\"step\":\"dem\",\"wall_s\":0.004,\"done\":2,\"total\":2}\n```\n"
}

#[cfg(test)]
mod tests {
    use super::super::{Event, JsonLines, Observer, Progress, Reason};
    use super::*;

    /// An event of each kind; a kind that is added does not compile until it is here.
    fn one_of_each() -> Vec<Event> {
        let step = || "a".to_owned();
        let all = vec![
            Event::Planned { steps: 1 },
            Event::Cached { step: step() },
            Event::Started { step: step(), reason: Reason::New },
            Event::Finished { step: step(), wall_s: 0.5 },
            Event::Held { step: step(), need_bytes: 7 },
            Event::Elsewhere { step: step() },
            Event::Waiting { step: step() },
            Event::Warning { step: step(), text: step() },
            Event::Failed { step: step(), stage: step(), message: step(), hint: None },
        ];
        for event in &all {
            match event {
                Event::Planned { .. }
                | Event::Cached { .. }
                | Event::Started { .. }
                | Event::Finished { .. }
                | Event::Held { .. }
                | Event::Elsewhere { .. }
                | Event::Waiting { .. }
                | Event::Warning { .. }
                | Event::Failed { .. } => {}
            }
        }
        all
    }

    #[test]
    fn every_event_has_the_members_that_are_documented_and_no_others() {
        let mut out = Vec::new();
        let mut lines = JsonLines::new(&mut out);
        one_of_each().iter().for_each(|event| lines.event(event, Progress::default()));
        drop(lines);
        let text = String::from_utf8(out).unwrap();
        assert_eq!(text.lines().count(), EVENTS.len() - 1, "`ended` is written by the command");
        for line in text.lines() {
            let line: Value = serde_json::from_str(line).unwrap();
            let (name, _, own) = EVENTS.iter().find(|(name, ..)| line["event"] == *name).unwrap();
            let mut told: Vec<&str> = line.as_object().unwrap().keys().map(String::as_str).collect();
            let mut known: Vec<&str> = members(name, own).map(|member| member.name).chain(["event"]).collect();
            told.sort_unstable();
            known.sort_unstable();
            assert_eq!(told, known);
        }
    }
}
