//! What a use gives, put into the text of a part.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::super::node::{Data, Key, Node, Word};
use super::super::reader::Reader;
use super::super::reference::Reference;
use super::super::substitute::{FILLED_BYTES, escape_hint, one_level_hint, parted};
use super::INSIDE;
use crate::diagnostic::{Diagnostic, Span};

/// Replaces `${name}` by what a use gives for it, and moves places into the text of the use.
pub struct Substitution<'s> {
    /// Values by the names of parameters.
    pub args: BTreeMap<String, Node>,
    /// Axes of the part's own.
    pub axes: &'s BTreeSet<String>,
    /// The name of the use, with `/` at its end.
    pub prefix: &'s str,
    /// What messages call the part.
    pub part: &'s str,
    /// The text that places belong to.
    pub source: usize,
}

impl Substitution<'_> {
    /// A value of the part as this use has it.
    pub fn node(&self, node: &Node, reader: &mut Reader) -> Node {
        let data = match &node.data {
            Data::Scalar(Value::String(text)) if text.contains("${") => return self.text(text, node, reader),
            Data::Scalar(value) => Data::Scalar(value.clone()),
            Data::List(items) => Data::List(items.iter().map(|item| self.node(item, reader)).collect()),
            Data::Map(entries) => {
                Data::Map(entries.iter().map(|(key, item)| (self.key(key), self.node(item, reader))).collect())
            }
        };
        Node { span: self.moved(node.span), data, written: node.written.clone() }
    }

    /// A key of the part.
    pub fn key(&self, key: &Key) -> Key {
        Key { span: self.moved(key.span), name: key.name.clone() }
    }

    /// A place of the part.
    pub fn moved(&self, span: Span) -> Span {
        Span { source: self.source, ..span }
    }

    /// What a name stands for: the value of a parameter or a value inside it, or an axis under its full name.
    fn named(&self, name: &str) -> Option<Node> {
        let (base, field) = parted(name);
        if let Some(given) = self.args.get(base) {
            return field.map_or_else(|| Some(given.clone()), |field| Self::inner(given, field));
        }
        let mention = || Value::String(format!("${{{}{name}}}", self.prefix));
        self.axes.contains(base).then(|| Node::made(Span::default(), Data::Scalar(mention())))
    }

    /// A value inside of what is given for a parameter: an entry of a map, or a value of what `${name}` will stand for.
    fn inner(given: &Node, field: &str) -> Option<Node> {
        if let Data::Map(_) = given.data {
            return given.get(field).cloned();
        }
        let text = mention_alone(given.text()?).filter(|name| parted(name).1.is_none())?;
        Some(Node::made(given.span, Data::Scalar(Value::String(format!("${{{text}.{field}}}")))))
    }

    fn text(&self, text: &str, node: &Node, reader: &mut Reader) -> Node {
        let span = self.moved(node.span);
        if let Some(name) = mention_alone(text) {
            return match self.named(name) {
                // An axis has no place of its own.
                Some(given) if given.span == Span::default() => Node { span, ..given },
                Some(given) => given,
                None => self.unknown(name, node, reader),
            };
        }
        let (mut filled, mut rest, mut is_whole) = (String::new(), text, true);
        while let Some((before, after)) = rest.split_once("${") {
            filled.push_str(before);
            let (false, Some((name, tail))) = (before.ends_with('$'), after.split_once('}')) else {
                filled.push_str("${");
                rest = after;
                continue;
            };
            let name = name.trim();
            match self.named(name).map(|given| (given.written.clone(), given.data)) {
                None => {
                    self.unknown(name, node, reader);
                    is_whole = false;
                }
                Some((_, Data::Scalar(Value::String(text)))) => filled.push_str(&text),
                Some((written, Data::Scalar(_))) if !written.is_empty() => filled.push_str(&written),
                Some((_, Data::Scalar(value))) => filled.push_str(&value.to_string()),
                Some((_, Data::List(_) | Data::Map(_))) => {
                    let message = format!("`${{{name}}}` is a list or map and cannot stand inside a text");
                    reader.fault(Diagnostic::at(span, message));
                }
            }
            if filled.len() > FILLED_BYTES {
                let mib = FILLED_BYTES >> 20;
                let message = format!("with `${{{name}}}` this value takes more than {mib} MiB");
                reader.fault(Diagnostic::at(span, message).hint("put a long one into a file"));
                return Node::made(span, Data::Scalar(Value::Null));
            }
            rest = tail;
        }
        filled.push_str(rest);
        Node::made(span, Data::Scalar(if is_whole { Value::String(filled) } else { Value::Null }))
    }

    fn unknown(&self, name: &str, node: &Node, reader: &mut Reader) -> Node {
        let span = self.moved(node.span);
        let (base, field) = parted(name);
        let inside = self.args.get(base).zip(field).map(|(given, field)| strange_field(given, base, field, span));
        reader.fault(inside.unwrap_or_else(|| {
            let message = format!("part `{}` has neither a parameter nor an axis `{name}`", self.part);
            let known = self.args.keys().chain(self.axes).map(String::as_str);
            Diagnostic::at(span, message).suggest(name, known).or_hint(escape_hint(name))
        }));
        Node::made(span, Data::Scalar(Value::Null))
    }
}

/// The name in a text that is nothing but `${name}`.
fn mention_alone(text: &str) -> Option<&str> {
    text.strip_prefix("${")?.strip_suffix('}').filter(|name| !name.contains('}')).map(str::trim)
}

/// The fault of a value that a parameter does not have as it is given.
fn strange_field(given: &Node, name: &str, field: &str, span: Span) -> Diagnostic {
    let message = format!("parameter `{name}` has no value `{field}`");
    let fault = Diagnostic::at(span, message).also(given.span, "it is given here");
    match &given.data {
        Data::Map(entries) => {
            let is_there = |known: &str| parted(known).1.is_some_and(|field| given.get(field).is_some());
            match one_level_hint(&format!("{name}.{field}"), is_there) {
                Some(hint) => fault.hint(hint),
                None => fault.suggest(field, entries.iter().map(|(key, _)| key.name.as_str())),
            }
        }
        Data::Scalar(_) | Data::List(_) => {
            fault.hint("give a map, or `${axis}` of an axis whose items have several values")
        }
    }
}

/// The full name of something inside a use.
pub fn inside(prefix: &str, name: &str) -> String {
    debug_assert!(prefix.is_empty() || prefix.ends_with(INSIDE));
    format!("{prefix}{name}")
}

/// An axis of something inside, as it is called outside.
fn under(prefix: &str, axis: &Word) -> Word {
    Word { span: axis.span, text: inside(prefix, &axis.text) }
}

/// What an output is, as it is called outside.
pub fn outside(prefix: &str, to: &Reference) -> Reference {
    let picks = to.picks.iter().map(|(axis, item)| (under(prefix, axis), item.clone())).collect();
    Reference { span: to.span, step: inside(prefix, &to.step), port: to.port.clone(), picks }
}
