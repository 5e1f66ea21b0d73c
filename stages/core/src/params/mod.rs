//! Typed parameters: one declaration ([`crate::params!`]) gives the struct, its defaults, its checks and its documentation.

mod macros;
mod reader;
mod types;

#[cfg(test)]
mod tests;

use serde_json::{Map, Value};

pub use macros::one_key;
pub use reader::MapReader;

/// The shape of a parameter, as the catalogue prints it.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind {
    /// A finite number.
    Number,
    /// A whole number that its Rust type can hold; `3.0` counts.
    Integer,
    /// `true` or `false`.
    Boolean,
    /// Text; a number is taken for the text of it.
    Text,
    /// One of a few words, each with what it means.
    Choice(&'static [(&'static str, &'static str)]),
    /// The path of one file, which the engine opens and hashes.
    File,
    /// The same for a file that may have a `.prj` of its name beside it, which is opened and hashed too.
    GeoFile,
    /// A folder, a file or a pattern such as `dir/*.tif`: any number of files.
    Files,
    /// A list of one kind; `Some(n)` fixes its length.
    List(Box<Kind>, Option<usize>),
    /// `null`, or the kind inside.
    Optional(Box<Kind>),
    /// A map with these keys, each a parameter of its own.
    Map(Vec<Field>),
    /// A map of any keys to one kind.
    Entries(Box<Kind>),
    /// Any value of YAML.
    Any,
    /// A map with exactly one of these keys, which says what its value is: `{prism: {...}}`. The bare word is enough where
    /// everything below the key has a default.
    Union(Vec<Field>),
    /// A number, or the kind inside: a distribution to draw it from.
    NumberOr(Box<Kind>),
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number => write!(f, "number"),
            Self::Integer => write!(f, "whole number"),
            Self::Boolean => write!(f, "true or false"),
            Self::Text => write!(f, "text"),
            Self::Choice(words) => {
                let words: Vec<_> = words.iter().map(|(word, _)| *word).collect();
                write!(f, "{}", words.join(" | "))
            }
            Self::File | Self::GeoFile => write!(f, "file"),
            Self::Files => write!(f, "files"),
            Self::List(kind, Some(length)) => write!(f, "list of {length} ({kind})"),
            Self::List(kind, None) => write!(f, "list ({kind})"),
            Self::Optional(kind) => write!(f, "{kind}, or null"),
            Self::Map(_) => write!(f, "map"),
            Self::Entries(kind) => write!(f, "map of names to {kind}"),
            Self::Any => write!(f, "any value"),
            Self::Union(fields) => {
                let words: Vec<_> = fields.iter().map(|field| field.name).collect();
                write!(f, "map with one of the keys {}", words.join(" | "))
            }
            Self::NumberOr(_) => write!(f, "number or distribution"),
        }
    }
}

/// One named parameter of a stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Its key in `with`; the unit is part of the name.
    pub name: &'static str,
    /// What it does, from its doc comment.
    pub doc: String,
    /// The shape of its value.
    pub kind: Kind,
    /// The value it has when left out; `None` for a required parameter.
    pub default: Option<Value>,
    /// The values it may take.
    pub range: Range,
}

/// The values a number (or every number of a list) may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// Any finite value.
    Any,
    /// Greater than zero.
    Positive,
    /// Zero or greater.
    NonNegative,
    /// At least this.
    AtLeast(f64),
    /// Between the two, both included.
    Between(f64, f64),
}

impl Range {
    /// Whether a value lies in the range.
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::Any => true,
            Self::Positive => value > 0.0,
            Self::NonNegative => value >= 0.0,
            Self::AtLeast(low) => value >= low,
            Self::Between(low, high) => (low..=high).contains(&value),
        }
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Any => Ok(()),
            Self::Positive => write!(f, "> 0"),
            Self::NonNegative => write!(f, ">= 0"),
            Self::AtLeast(low) => write!(f, ">= {low}"),
            Self::Between(low, high) => write!(f, "{low} to {high}"),
        }
    }
}

/// What is wrong with one value of `with`, and where.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// Keys and list positions that lead to the value.
    pub path: Vec<String>,
    /// What is wrong, in words for people. `path` says where.
    pub message: String,
    /// The keys or words that would have been right, for a suggestion.
    pub known: Vec<String>,
    /// The fault lies in the key, not in its value.
    pub at_key: bool,
}

impl Fault {
    /// A fault of a value; [`Fault::below`] adds the keys that lead to it.
    pub fn new(message: impl Into<String>) -> Self {
        Self { path: Vec::new(), message: message.into(), known: Vec::new(), at_key: false }
    }

    /// The same fault, one key or list position further down.
    #[must_use]
    pub fn below(mut self, segment: &str) -> Self {
        self.path.insert(0, segment.to_owned());
        self
    }
}

/// The value of a parameter that decides which ports a stage has, as the pipeline writes it; `None` where it is left out.
///
/// # Errors
/// The parameter differs between the items of an axis, as `${axis}` says: one step has one set of ports.
pub fn deciding<'a>(with: &'a Value, name: &str) -> Result<Option<&'a Value>, Vec<Fault>> {
    let value = with.get(name);
    match value.and_then(Value::as_str) {
        Some(text) if text.contains("${") => {
            let message = "it decides the inputs and outputs of the step, so it cannot differ between items: write a step for each";
            Err(vec![Fault::new(message).below(name)])
        }
        _ => Ok(value),
    }
}

/// A type that a parameter can have.
pub trait ParamType: Sized {
    /// The shape that the catalogue and the JSON Schema show.
    fn kind() -> Kind;
    /// Reads a value, or returns every fault in it.
    fn decode(value: &Value) -> Result<Self, Vec<Fault>>;
    /// The canonical form: `decode(encode(x)) = x`, and equal values have equal text.
    fn encode(&self) -> Value;
    /// Faults of a value that is no plain number but may leave the range: a distribution that can draw such values.
    fn outside(&self, _range: Range) -> Vec<Fault> {
        Vec::new()
    }
}

/// The whole of a stage's parameters, or a part that several stages have in common.
pub trait Params: ParamType {
    /// The fields, in the order of declaration.
    fn fields() -> Vec<Field>;
    /// Adds the keys to a list.
    fn names(known: &mut Vec<&'static str>);
    /// Reads the keys of a map that may hold others; `None` where there are faults.
    fn read(reader: &mut MapReader) -> Option<Self>;
    /// Adds every key with its canonical value to a map.
    fn write(&self, map: &mut Map<String, Value>);
}

/// A file named by a parameter; the engine opens and hashes it, [`crate::Context::file`] hands over a reader.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileRef(pub String);

/// A file named by a parameter that may state its coordinate reference system in a `.prj` beside it;
/// [`crate::Context::read_georeferenced`] reads both.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GeoFileRef(pub String);

/// A folder, file or pattern named by a parameter; [`crate::Context::files`] hands over its readers, sorted by name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FilesRef(pub String);

fn wrong(expected: &str, value: &Value) -> Vec<Fault> {
    vec![Fault::new(format!("expected {expected}, found {}", describe(value)))]
}

fn describe(value: &Value) -> String {
    match value {
        Value::Null => "nothing (null)".into(),
        Value::Bool(b) => format!("`{b}`"),
        Value::Number(n) => format!("the number {n}"),
        Value::String(s) => format!("the text \"{s}\""),
        Value::Array(list) => format!("a list of {}", list.len()),
        Value::Object(_) => "a map".into(),
    }
}
