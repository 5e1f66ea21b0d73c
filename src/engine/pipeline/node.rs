//! The YAML tree of a pipeline, every value and key with its place in the text.

use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::{Number, Value};
use serde_saphyr::Spanned;
use serde_saphyr::options::NonFiniteFloatPolicy;

use super::unreadable;
use crate::diagnostic::{Diagnostic, Span};

/// A value with its place.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Its place in the text.
    pub span: Span,
    /// The scalar, list or map.
    pub data: Data,
    /// A number as it is written; empty for anything else. One that is not finite has no value besides.
    pub written: String,
}

/// The content of a [`Node`].
#[derive(Debug, Clone, PartialEq)]
pub enum Data {
    /// `null`, a boolean, a number or text.
    Scalar(Value),
    /// A list, in the order of the text.
    List(Vec<Node>),
    /// A map, in the order of the text; keys are unique.
    Map(Vec<(Key, Node)>),
}

/// A word with its place.
#[derive(Debug, Clone, PartialEq)]
pub struct Word {
    /// Its place in the text.
    pub span: Span,
    /// The word as it was written, without quotes.
    pub text: String,
}

/// A key with its place.
#[derive(Debug, Clone, PartialEq)]
pub struct Key {
    /// Its place in the text.
    pub span: Span,
    /// The key as it was written, without quotes.
    pub name: String,
}

impl Node {
    /// Parses a text; `source` is its index in the list of sources.
    pub fn parse(text: &str, source: usize) -> Result<Self, Diagnostic> {
        let options = serde_saphyr::options! {
            strict_booleans: true,
            non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
        };
        match serde_saphyr::from_str_with_options::<Spanned<Raw>>(text, options) {
            Ok(raw) => match unreadable::second_merge(text, source) {
                Some(fault) => Err(fault),
                None => Ok(raw_node(raw, text, source)),
            },
            Err(error) => Err(unreadable::syntax_error(text, source, &error)),
        }
    }

    /// A node that no text holds.
    pub fn made(span: Span, data: Data) -> Self {
        Self { span, data, written: String::new() }
    }

    /// A value that stands at a place without being written there.
    pub fn of_value(value: &Value, span: Span) -> Self {
        let data = match value {
            Value::Array(items) => Data::List(items.iter().map(|item| Self::of_value(item, span)).collect()),
            Value::Object(map) => {
                let entry =
                    |(name, item): (&String, &Value)| (Key { span, name: name.clone() }, Self::of_value(item, span));
                Data::Map(map.iter().map(entry).collect())
            }
            scalar => Data::Scalar(scalar.clone()),
        };
        Self::made(span, data)
    }

    /// Whether it is a number with a zero before its first digit, which one reader drops and another keeps.
    pub fn has_leading_zero(&self) -> bool {
        let digits = self.written.trim_start_matches(['+', '-']);
        digits.len() > 1 && digits.starts_with('0') && digits[1..].starts_with(|c: char| c.is_ascii_digit())
    }

    /// Why a number cannot be taken as it is written, and the way out.
    pub fn bad_number(&self) -> Option<(String, &'static str)> {
        let written = &self.written;
        if self.has_leading_zero() {
            let message = format!("`{written}` has a zero before its first digit");
            Some((message, "write the number without it, or put the whole in quotes if it is text"))
        } else if matches!(self.data, Data::Scalar(Value::Null)) && !written.is_empty() {
            let message = format!("`{written}` is not a finite number");
            Some((message, "write a finite number, or put it in quotes if it is text"))
        } else {
            None
        }
    }

    /// Whether it or anything in it is such a number.
    pub fn holds_bad_number(&self) -> bool {
        match &self.data {
            Data::Scalar(_) => self.bad_number().is_some(),
            Data::List(items) => items.iter().any(Self::holds_bad_number),
            Data::Map(entries) => entries.iter().any(|(_, item)| item.holds_bad_number()),
        }
    }

    /// The plain value, without places.
    pub fn to_value(&self) -> Value {
        match &self.data {
            Data::Scalar(value) => value.clone(),
            Data::List(items) => items.iter().map(Self::to_value).collect(),
            Data::Map(entries) => entries.iter().map(|(key, node)| (key.name.clone(), node.to_value())).collect(),
        }
    }

    /// The text, if it is text.
    pub fn text(&self) -> Option<&str> {
        if let Data::Scalar(Value::String(text)) = &self.data { Some(text) } else { None }
    }

    /// The entries, if it is a map.
    pub fn entries(&self) -> Option<&[(Key, Node)]> {
        if let Data::Map(entries) = &self.data { Some(entries) } else { None }
    }

    /// The entries, taken over; none if it is no map.
    pub fn into_entries(self) -> Vec<(Key, Node)> {
        if let Data::Map(entries) = self.data { entries } else { Vec::new() }
    }

    /// The value of a key, if it is a map and has it.
    pub fn get(&self, name: &str) -> Option<&Node> {
        self.entries()?.iter().find(|(key, _)| key.name == name).map(|(_, node)| node)
    }

    /// The place of what a path of keys and list positions leads to, or of the last part that exists; with
    /// `at_key`, the place of the last key.
    pub fn locate(&self, path: &[String], at_key: bool) -> Span {
        let Some((first, rest)) = path.split_first() else { return self.span };
        match &self.data {
            Data::List(items) => {
                first.parse::<usize>().ok().and_then(|i| items.get(i)).map_or(self.span, |n| n.locate(rest, at_key))
            }
            Data::Map(entries) => match entries.iter().find(|(key, _)| key.name == *first) {
                Some((key, _)) if rest.is_empty() && at_key => key.span,
                Some((_, node)) => node.locate(rest, at_key),
                None => self.span,
            },
            Data::Scalar(_) => self.span,
        }
    }

    /// Takes the value of a key out of a map.
    pub fn take(&mut self, key: &str) -> Option<Node> {
        let Data::Map(entries) = &mut self.data else { return None };
        let place = entries.iter().position(|(own, _)| own.name == key)?;
        Some(entries.swap_remove(place).1)
    }

    /// What it is, for messages.
    pub fn describe(&self) -> String {
        match &self.data {
            Data::Scalar(Value::Null) => "nothing".into(),
            Data::Scalar(Value::String(text)) => format!("the text \"{text}\""),
            Data::Scalar(_) if !self.written.is_empty() => format!("`{}`", self.written),
            Data::Scalar(value) => format!("`{value}`"),
            Data::List(_) => "a list".into(),
            Data::Map(_) => "a map".into(),
        }
    }
}

/// What serde sees of a node.
enum Raw {
    Scalar(Value),
    NotFinite,
    List(Vec<Spanned<Raw>>),
    Map(Vec<(Spanned<String>, Spanned<Raw>)>),
}

impl<'de> Deserialize<'de> for Raw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RawVisitor)
    }
}

struct RawVisitor;

impl<'de> Visitor<'de> for RawVisitor {
    type Value = Raw;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a YAML value")
    }
    fn visit_bool<E>(self, value: bool) -> Result<Raw, E> {
        Ok(Raw::Scalar(value.into()))
    }
    fn visit_i64<E>(self, value: i64) -> Result<Raw, E> {
        Ok(Raw::Scalar(value.into()))
    }
    fn visit_u64<E>(self, value: u64) -> Result<Raw, E> {
        Ok(Raw::Scalar(value.into()))
    }
    fn visit_f64<E>(self, value: f64) -> Result<Raw, E> {
        Ok(Number::from_f64(value).map_or(Raw::NotFinite, |number| Raw::Scalar(Value::Number(number))))
    }
    fn visit_str<E>(self, value: &str) -> Result<Raw, E> {
        Ok(Raw::Scalar(value.into()))
    }
    fn visit_unit<E>(self) -> Result<Raw, E> {
        Ok(Raw::Scalar(Value::Null))
    }
    fn visit_none<E>(self) -> Result<Raw, E> {
        Ok(Raw::Scalar(Value::Null))
    }
    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Raw, D::Error> {
        Raw::deserialize(deserializer)
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Raw, A::Error> {
        let mut items = Vec::new();
        while let Some(item) = seq.next_element()? {
            items.push(item);
        }
        Ok(Raw::List(items))
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Raw, A::Error> {
        let mut entries = Vec::new();
        while let Some(entry) = map.next_entry()? {
            entries.push(entry);
        }
        Ok(Raw::Map(entries))
    }
}

fn raw_node(raw: Spanned<Raw>, text: &str, source: usize) -> Node {
    let span = span_of(&raw, source);
    let written = written(&raw.value, text, span);
    let data = match raw.value {
        Raw::Scalar(value) => Data::Scalar(value),
        Raw::NotFinite => Data::Scalar(Value::Null),
        Raw::List(items) => Data::List(items.into_iter().map(|item| raw_node(item, text, source)).collect()),
        Raw::Map(entries) => Data::Map(
            entries
                .into_iter()
                .map(|(key, value)| {
                    let span = span_of(&key, source);
                    (Key { span, name: key.value }, raw_node(value, text, source))
                })
                .collect(),
        ),
    };
    Node { span, data, written }
}

/// The text of a number; an alias stands for a number without being one.
fn written(raw: &Raw, text: &str, span: Span) -> String {
    let found = text.get(span.start..span.end).unwrap_or_default().trim();
    match raw {
        Raw::Scalar(Value::Number(_)) => {}
        Raw::NotFinite if found.is_empty() => return ".nan".to_owned(),
        Raw::NotFinite => return found.to_owned(),
        _ => return String::new(),
    }
    let number = found.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.'));
    if number { found.to_owned() } else { String::new() }
}

fn span_of<T>(spanned: &Spanned<T>, source: usize) -> Span {
    let span = spanned.referenced.span();
    let start = span.byte_offset().unwrap_or(span.offset()) as usize;
    let length = span.byte_len().unwrap_or(span.len()) as usize;
    Span { source, start, end: start + length.max(1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_and_key_knows_its_place() {
        let text = "name: two\nsteps:\n  a: {stage: b, with: {x: [1, 2.5]}}\n";
        let node = Node::parse(text, 0).unwrap();
        let at = |span: Span| &text[span.start..span.end];
        assert_eq!(at(node.get("name").unwrap().span), "two");
        let path: Vec<String> = ["steps", "a", "with", "x", "1"].map(String::from).to_vec();
        assert_eq!(at(node.locate(&path, false)), "2.5");
        assert_eq!(at(node.locate(&path[..4], true)), "x");
        assert_eq!(node.get("steps").unwrap().to_value().to_string(), r#"{"a":{"stage":"b","with":{"x":[1,2.5]}}}"#);
    }

    #[test]
    fn words_that_look_like_booleans_stay_words() {
        let node = Node::parse("y: no\nn: on\nt: true\n", 0).unwrap();
        assert_eq!(node.to_value().to_string(), r#"{"n":"on","t":true,"y":"no"}"#);
    }

    #[test]
    fn broken_yaml_and_double_keys_name_the_line() {
        let error = Node::parse("a: 1\nb: [1, 2\nc: 3\n", 0).unwrap_err();
        assert!(error.span.is_some(), "{error:?}");
        let error = Node::parse("a: 1\na: 2\n", 0).unwrap_err();
        assert_eq!(error.span.map(|s| s.start), Some(5), "{error:?}");
    }
}
