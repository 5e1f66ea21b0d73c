//! What a use gives, put into the text of a part.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::super::document::Reader;
use super::super::node::{Data, Key, Node};
use super::super::substitute::{FILLED_BYTES, escape_hint};
use super::INSIDE;
use crate::diagnostic::{Diagnostic, Span};

/// Replaces `${name}` by what a use gives for it, and moves places into the text of the use.
pub struct Substitution<'s> {
    /// Values by the names of parameters.
    pub args: &'s BTreeMap<String, Node>,
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

    /// What a name stands for: the value of a parameter, or an axis under its full name.
    fn named(&self, name: &str) -> Option<Node> {
        if let Some(given) = self.args.get(name) {
            return Some(given.clone());
        }
        let base = name.split_once('.').map_or(name, |(base, _)| base);
        let mention = || Value::String(format!("${{{}{name}}}", self.prefix));
        self.axes.contains(base).then(|| Node::made(Span::default(), Data::Scalar(mention())))
    }

    fn text(&self, text: &str, node: &Node, reader: &mut Reader) -> Node {
        let span = self.moved(node.span);
        let whole = text.strip_prefix("${").and_then(|rest| rest.strip_suffix('}')).filter(|name| !name.contains('}'));
        if let Some(name) = whole {
            let name = name.trim();
            return match self.named(name) {
                // An axis has no place of its own.
                Some(given) if given.span == Span::default() => Node { span, ..given },
                Some(given) => given,
                None => self.unknown(name, node, reader),
            };
        }
        let (mut filled, mut rest) = (String::new(), text);
        while let Some((before, after)) = rest.split_once("${") {
            filled.push_str(before);
            let (false, Some((name, tail))) = (before.ends_with('$'), after.split_once('}')) else {
                filled.push_str("${");
                rest = after;
                continue;
            };
            let name = name.trim();
            match self.named(name).map(|given| (given.written.clone(), given.data)) {
                None => return self.unknown(name, node, reader),
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
        Node::made(span, Data::Scalar(Value::String(filled)))
    }

    fn unknown(&self, name: &str, node: &Node, reader: &mut Reader) -> Node {
        let span = self.moved(node.span);
        let message = format!("part `{}` has neither a parameter nor an axis `{name}`", self.part);
        let known = self.args.keys().chain(self.axes).map(String::as_str);
        let fault = Diagnostic::at(span, message).suggest(name, known);
        reader.fault(fault.or_hint(escape_hint(name)));
        Node::made(span, Data::Scalar(Value::Null))
    }
}

/// The full name of something inside a use.
pub fn inside(prefix: &str, name: &str) -> String {
    debug_assert!(prefix.is_empty() || prefix.ends_with(INSIDE));
    format!("{prefix}{name}")
}
