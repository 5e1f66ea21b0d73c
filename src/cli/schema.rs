//! The JSON Schema of pipelines, made from the stages' own declarations, so that editors complete and check what is written.

use rockface_core::params::{Field, Kind, Range};
use rockface_core::{AnyStage, Arity, Port};
use serde_json::{Map, Value, json};

use rockface_core::artefact::Kind as ArtefactKind;
use rockface_engine::pipeline::{LogLevel, ValueKind};

/// The schema of a pipeline file over these stages.
pub fn schema(stages: &[&'static dyn AnyStage]) -> Value {
    let steps: Vec<Value> = stages.iter().map(|stage| step(*stage)).collect();
    let names: Vec<&str> = stages.iter().map(|stage| stage.name()).collect();
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "rockface pipeline",
        "type": "object",
        "required": ["rockface"],
        "additionalProperties": false,
        "properties": {
            "rockface": {"const": 1, "description": "The format version."},
            "name": {"type": ["string", "number"], "description": "Used for run folders; by default the file's name."},
            "seed": {"type": "integer", "minimum": 0, "description": "From it every random number is drawn."},
            "include": one_or_many(&json!({"type": "string"}), "Pipelines whose parameters, axes and steps are added."),
            "params": {"type": "object", "additionalProperties": {"anyOf": [{"$ref": "#/$defs/parameter"}, {}]},
                       "description": "Values that `${name}` refers to; {type: number, default: 1, …} declares one with its type."},
            "parts": {"type": "object", "additionalProperties": {"anyOf": [{"$ref": "#/$defs/part"}, {"type": "string"}]},
                      "description": "Chains of steps that steps use by name; a text names the file of one."},
            "axes": {"type": "object", "additionalProperties": {"$ref": "#/$defs/axis"}, "description": "What steps fan out over."},
            "zip": {"type": "array", "items": {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]},
                    "description": "Axes that are walked together instead of crossed: [a, b], or a list of such lists."},
            "steps": {"type": "object", "minProperties": 1, "additionalProperties": {"$ref": "#/$defs/step"}},
            "targets": one_or_many(&json!({"type": "string"}), "Steps to make; by default every step nobody reads."),
            "log": log_level("How much the log of a run shows of the steps that do not say it themselves."),
        },
        "anyOf": [{"required": ["steps"]}, {"required": ["include"]}],
        "$defs": {
            "axis": axis(),
            "reference": {"type": "string", "pattern": "^[^.\\[]+\\.[^.\\[]+(\\[.+\\])?$", "description": "step.port, or step.port[axis=item]."},
            "input": input(),
            "parameter": parameter(),
            "part": part(),
            "step": {
                "type": "object",
                "if": {"required": ["use"]},
                "then": used(),
                "else": {"required": ["stage"], "properties": {"stage": {"enum": names}}, "allOf": steps},
            },
        },
    })
}

/// A parameter that is declared with its type.
fn parameter() -> Value {
    let words: Vec<&str> = ValueKind::WORDS.iter().map(|(_, word)| *word).collect();
    json!({"type": "object", "required": ["type"], "additionalProperties": false, "properties": {
        "type": {"enum": words}, "unit": {"type": "string"}, "min": {"type": "number"}, "max": {"type": "number"},
        "choices": {"type": "array", "minItems": 1}, "default": {}, "doc": {"type": "string"},
    }})
}

/// A part under `parts`.
fn part() -> Value {
    let kinds: Vec<&str> = ArtefactKind::ALL.iter().map(|kind| kind.word()).collect();
    let kind = one_or_many(&json!({"enum": kinds}), "The kind of artefact it takes.");
    json!({"type": "object", "required": ["out", "steps"], "additionalProperties": false, "properties": {
        "doc": {"type": "string", "description": "What it is about."},
        "params": {"type": "object", "additionalProperties": {"$ref": "#/$defs/parameter"}},
        "in": {"type": "object", "additionalProperties": {"anyOf": [kind, {"type": "object", "required": ["kind"],
            "additionalProperties": false,
            "properties": {"kind": kind, "optional": {"type": "boolean"}, "doc": {"type": "string"}}}]},
            "description": "What its steps read as `in.name`."},
        "out": {"type": "object", "minProperties": 1, "additionalProperties": {"$ref": "#/$defs/reference"},
                "description": "What others may read of it."},
        "axes": {"type": "object", "additionalProperties": {"$ref": "#/$defs/axis"}},
        "zip": {"type": "array"},
        "steps": {"type": "object", "minProperties": 1},
    }})
}

/// A step that stands for a part.
fn used() -> Value {
    json!({"required": ["use"], "additionalProperties": false, "properties": {
        "use": {"type": "string", "description": "A part: its name, the path of its file, or one that `rockface parts` lists."},
        "with": {"type": "object", "description": "Values for its parameters."},
        "in": {"type": "object", "additionalProperties": {"$ref": "#/$defs/input"}, "description": "What its inputs are fed with."},
        "over": one_or_many(&json!({"type": "string"}), "Axes that all its steps depend on."),
    }})
}

fn log_level(description: &str) -> Value {
    json!({"enum": LogLevel::WORDS, "description": description})
}

fn one_or_many(item: &Value, description: &str) -> Value {
    json!({"anyOf": [item, {"type": "array", "items": item}], "description": description})
}

fn axis() -> Value {
    let scalar = json!({"type": ["string", "number", "boolean"]});
    let range = json!({"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2});
    let spread = json!({"anyOf": [range, {"type": "object", "minProperties": 1, "maxProperties": 1,
        "additionalProperties": false, "properties": {"log": range, "whole": range}}]});
    let mention = json!({"type": "string", "pattern": "^\\$\\{.+\\}$", "description": "A parameter."});
    let or_mention = |shape: &Value| json!({"anyOf": [shape, mention]});
    let form = |name: &str, shape: &Value, what: &str| {
        json!({"type": "object", "required": [name], "additionalProperties": false,
               "properties": {name: shape, "reseeds": {"type": "boolean"}}, "description": what})
    };
    json!({"oneOf": [
        form("items", &or_mention(&json!({"type": "array", "items": scalar, "minItems": 1})), "Named items."),
        form("count", &or_mention(&json!({"type": "integer", "minimum": 1})), "Items 0, 1, 2, …"),
        form("values", &or_mention(&json!({"type": "array", "items": scalar, "minItems": 1})), "A swept value; does not reseed."),
        form("from", &json!({"$ref": "#/$defs/reference"}), "The items of a list another step makes."),
        {"type": "object", "required": ["sample", "count", "over"], "additionalProperties": false, "properties": {
            "sample": {"enum": ["grid", "random", "latin-hypercube", "sobol"]},
            "count": {"anyOf": [{"type": "integer", "minimum": 1}, {"type": "array", "items": {"type": "integer", "minimum": 1}}, mention]},
            "over": {"type": "object", "additionalProperties": spread, "minProperties": 1},
            "reseeds": {"type": "boolean"},
        }, "description": "Points of a drawn design, each value ${axis.name}."},
    ]})
}

fn input() -> Value {
    let reference = json!({"$ref": "#/$defs/reference"});
    let axes = one_or_many(&json!({"type": "string"}), "Axes gathered over.");
    let choice = json!({"type": "object", "required": ["by"], "properties": {"by": {"type": "string"}},
        "additionalProperties": reference});
    json!({"anyOf": [
        reference,
        {"type": "object", "required": ["each", "over"], "additionalProperties": false,
         "properties": {"each": reference, "over": axes, "paired": {"anyOf": [reference, choice]}}},
        {"type": "object", "required": ["from", "first"], "additionalProperties": false,
         "properties": {"from": reference, "first": {"anyOf": [reference, {"type": "null"}]}}},
        choice,
    ]})
}

/// What follows for a step from the name of its stage.
fn step(stage: &dyn AnyStage) -> Value {
    let fields = stage.fields();
    let needed = fields.iter().any(|field| field.default.is_none());
    let free = stage.inputs().is_empty() && stage.outputs().is_empty();
    let inputs = inputs(stage, &fields);
    let needs_input = !free && inputs.iter().all(|ports| ports.iter().any(|port| port.arity != Arity::Optional));
    let mut required = vec!["stage"];
    required.extend(needed.then_some("with"));
    required.extend(needs_input.then_some("in"));
    json!({
        "if": {"properties": {"stage": {"const": stage.name()}}},
        "then": {
            "required": required,
            "additionalProperties": false,
            "properties": {
                "stage": {"description": stage.page().what()},
                "with": map_of(&fields),
                "in": if free { json!({"type": "object", "additionalProperties": {"$ref": "#/$defs/input"}}) } else { ports(&inputs) },
                "over": one_or_many(&json!({"type": "string"}), "Axes it is expanded over besides those that follow."),
                "keep": {"type": "boolean", "description": "Whether its outputs stay on disk; true by default."},
                "stream": {"type": "object", "additionalProperties": false, "properties": {
                    "label": {"type": ["string", "number"]},
                    "axes": one_or_many(&json!({"type": "string"}), "Reseeding axes whose items count."),
                }},
                "timeout": {"type": "string", "description": "How long one go may take, such as 90s or 2h."},
                "retries": {"type": "integer", "minimum": 0, "maximum": 100},
                "title": {"type": "string", "description": "Its heading in reports."},
                "doc": {"type": "string", "description": "What reports say of it."},
                "log": log_level("How much the log of a run shows of it; by default the first instance and the last three in full, the others in brief."),
            },
        },
    })
}

/// The input ports there can be: those of each choice a parameter leaves.
fn inputs(stage: &dyn AnyStage, fields: &[Field]) -> Vec<&'static [Port]> {
    let words = |field: &Field| match field.kind {
        Kind::Choice(words) => words.iter().map(|(word, _)| json!({field.name: word})).collect(),
        _ => Vec::new(),
    };
    let choices = fields.iter().flat_map(words);
    let mut found = vec![stage.inputs()];
    for ports in choices.filter_map(|with: Value| stage.ports(&with).ok()) {
        if !found.iter().any(|known| names(known).eq(names(ports.inputs))) {
            found.push(ports.inputs);
        }
    }
    found
}

fn names(ports: &[Port]) -> impl Iterator<Item = &'static str> {
    ports.iter().map(|port| port.name)
}

/// What `in` may hold; needed is what every variant needs.
fn ports(variants: &[&[Port]]) -> Value {
    let entry = |port: &Port| {
        let kinds: Vec<&str> = port.kinds.iter().map(|kind| kind.word()).collect();
        let doc = format!("{} ({})", port.doc, kinds.join(" or "));
        (port.name.to_owned(), json!({"$ref": "#/$defs/input", "description": doc}))
    };
    let needed = |name: &str| {
        variants.iter().all(|ports| ports.iter().any(|port| port.name == name && port.arity != Arity::Optional))
    };
    let mut entries = Map::new();
    // The first variant is the usual one: its words stay.
    for port in variants.iter().rev().flat_map(|ports| ports.iter()) {
        entries.extend([entry(port)]);
    }
    let required: Vec<&str> = variants[0].iter().map(|port| port.name).filter(|name| needed(name)).collect();
    json!({"type": "object", "additionalProperties": false, "properties": entries, "required": required})
}

/// The schema of a map of parameters.
pub fn map_of(fields: &[Field]) -> Value {
    let property = |field: &Field| {
        let mut shape = shape(&field.kind, field.range);
        if let Value::Object(map) = &mut shape {
            map.insert("description".to_owned(), field.doc.trim().into());
            field.default.iter().for_each(|default| drop(map.insert("default".to_owned(), default.clone())));
        }
        (field.name.to_owned(), shape)
    };
    let required: Vec<&str> = fields.iter().filter(|field| field.default.is_none()).map(|field| field.name).collect();
    let properties: Map<String, Value> = fields.iter().map(property).collect();
    json!({"type": "object", "additionalProperties": false, "properties": properties, "required": required})
}

/// A value, or a text with `${…}` in it.
fn shape(kind: &Kind, range: Range) -> Value {
    let filled = json!({"type": "string", "pattern": "\\$\\{"});
    match kind {
        Kind::Text => json!({"type": ["string", "number"]}),
        Kind::File | Kind::GeoFile | Kind::Files => json!({"type": "string"}),
        Kind::Any => json!({}),
        other => json!({"anyOf": [plain(other, range), filled]}),
    }
}

fn plain(kind: &Kind, range: Range) -> Value {
    match kind {
        Kind::Number => number("number", range),
        Kind::Integer => number("integer", range),
        Kind::Boolean => json!({"type": "boolean"}),
        Kind::Text => json!({"type": ["string", "number"]}),
        Kind::File | Kind::GeoFile | Kind::Files => json!({"type": "string"}),
        Kind::Choice(words) => json!({"enum": words.iter().map(|(word, _)| *word).collect::<Vec<_>>()}),
        Kind::List(inner, length) => {
            let mut list = json!({"type": "array", "items": shape(inner, range)});
            if let Some(length) = length {
                list["minItems"] = (*length).into();
                list["maxItems"] = (*length).into();
            }
            list
        }
        Kind::Optional(inner) => json!({"anyOf": [{"type": "null"}, plain(inner, range)]}),
        Kind::Map(fields) => map_of(fields),
        Kind::Union(fields) => union_of(fields),
        Kind::NumberOr(inner) => json!({"anyOf": [number("number", range), plain(inner, range)]}),
        Kind::Entries(inner) => json!({"type": "object", "additionalProperties": shape(inner, range)}),
        Kind::Any => json!({}),
    }
}

/// One of the keys, or the bare word of one.
fn union_of(fields: &[Field]) -> Value {
    let words: Vec<&str> = fields.iter().map(|field| field.name).collect();
    let mut map = map_of(fields);
    map["minProperties"] = 1.into();
    map["maxProperties"] = 1.into();
    map["required"] = json!([]);
    json!({"anyOf": [{"enum": words}, map]})
}

fn number(word: &str, range: Range) -> Value {
    match range {
        Range::Any => json!({"type": word}),
        Range::Positive => json!({"type": word, "exclusiveMinimum": 0}),
        Range::NonNegative => json!({"type": word, "minimum": 0}),
        Range::AtLeast(low) => json!({"type": word, "minimum": low}),
        Range::Between(low, high) => json!({"type": word, "minimum": low, "maximum": high}),
    }
}
