//! `${name}`: parameters and axis items put into the values of a step. `$${name}` stands for the text `${name}`.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;

use serde_json::Value;

use super::node::{Data, Key, Node};
use crate::diagnostic::{Diagnostic, Span};

/// The names mentioned anywhere in a value, with their places.
pub fn mentioned(node: &Node, found: &mut Vec<(String, Span)>) {
    match &node.data {
        Data::Scalar(Value::String(text)) if text.contains('$') => {
            found.extend(names(text).map(|name| (name.to_owned(), node.span)));
        }
        Data::Scalar(_) => {}
        Data::List(items) => items.iter().for_each(|item| mentioned(item, found)),
        Data::Map(entries) => entries.iter().for_each(|(_, item)| mentioned(item, found)),
    }
}

/// A mentioned name: what it names, and which of its values behind the dot.
pub fn parted(name: &str) -> (&str, Option<&str>) {
    name.split_once('.').map_or((name, None), |(base, field)| (base, Some(field)))
}

/// What a mentioned name stands for among some values: one of them, or a value of one that is a map.
pub fn value_of(values: &BTreeMap<String, Value>, name: &str) -> Option<Value> {
    let (base, field) = parted(name);
    let value = values.get(base)?;
    field.map_or(Some(value), |field| value.get(field)).cloned()
}

/// How a text that looks like a mention is written.
pub fn escape_hint(name: &str) -> String {
    format!("write $${{{name}}} for the text itself")
}

/// The most bytes that `${name}` may bring into one value; names of names of names grow without end.
pub const FILLED_BYTES: usize = 4 << 20;

/// The value with every `${name}` replaced. A value that is nothing but `${name}` takes the type of what it names;
/// inside a longer text the value is written out. All that cannot be filled in is reported.
pub fn filled(node: &Node, lookup: &dyn Fn(&str) -> Option<Value>) -> Result<Value, Vec<Diagnostic>> {
    let filler = Filler { lookup, room: Cell::new(Some(FILLED_BYTES)), faults: RefCell::default() };
    let value = filler.value(node);
    let faults = filler.faults.into_inner();
    if faults.is_empty() { Ok(value) } else { Err(faults) }
}

/// The way out where a name has two dots and its first two words mean a value that is there.
pub fn one_level_hint(name: &str, is_there: impl Fn(&str) -> bool) -> Option<String> {
    let (base, field) = parted(name);
    let (first, inner) = field?.split_once('.')?;
    let known = format!("{base}.{first}");
    is_there(&known).then(|| {
        format!(
            "a name leads one level into a map: put `{inner}` into `{base}` itself, or write ${{{known}}} for all of it"
        )
    })
}

/// The keys below a value that look as if something were to be filled in, with their places.
pub fn filled_in_keys<'n>(node: &'n Node, found: &mut Vec<&'n Key>) {
    match &node.data {
        Data::Scalar(_) => {}
        Data::List(items) => items.iter().for_each(|item| filled_in_keys(item, found)),
        Data::Map(entries) => {
            for (key, item) in entries {
                found.extend(names(&key.name).next().map(|_| key));
                filled_in_keys(item, found);
            }
        }
    }
}

/// About the bytes that a value takes: those of its texts, and some for each other part.
pub fn value_bytes(value: &Value) -> usize {
    const PART: usize = 8;
    match value {
        Value::String(text) => PART + text.len(),
        Value::Array(items) => PART + items.iter().map(value_bytes).sum::<usize>(),
        Value::Object(map) => PART + map.iter().map(|(key, item)| key.len() + value_bytes(item)).sum::<usize>(),
        Value::Null | Value::Bool(_) | Value::Number(_) => PART,
    }
}

struct Filler<'a> {
    lookup: &'a dyn Fn(&str) -> Option<Value>,
    /// Bytes that may still come in; `None` once they were too many, which has been reported.
    room: Cell<Option<usize>>,
    /// What cannot be filled in.
    faults: RefCell<Vec<Diagnostic>>,
}

impl Filler<'_> {
    fn value(&self, node: &Node) -> Value {
        match &node.data {
            Data::Scalar(Value::String(text)) => self.text(text, node.span),
            Data::Scalar(value) => value.clone(),
            Data::List(items) => items.iter().map(|item| self.value(item)).collect(),
            Data::Map(entries) => entries.iter().map(|(key, item)| (key.name.clone(), self.value(item))).collect(),
        }
    }

    fn fault(&self, fault: Diagnostic) {
        self.faults.borrow_mut().push(fault);
    }

    /// What a name stands for; `None` where that is nothing or too much, which is reported.
    fn named(&self, name: &str, span: Span) -> Option<Value> {
        let Some(value) = (self.lookup)(name) else {
            let message = match parted(name) {
                (base, Some(field)) => format!("`${{{name}}}`: `{base}` has no value `{field}`"),
                (_, None) => format!("`${{{name}}}` names neither a parameter nor an axis"),
            };
            let hint = one_level_hint(name, |known| (self.lookup)(known).is_some());
            self.fault(hint.into_iter().fold(Diagnostic::at(span, message), Diagnostic::hint));
            return None;
        };
        let left = self.room.get()?.checked_sub(value_bytes(&value));
        if left.is_none() {
            let mib = FILLED_BYTES >> 20;
            let message =
                format!("with `${{{name}}}` this value takes more than {mib} MiB; put a long one into a file");
            self.fault(Diagnostic::at(span, message));
        }
        self.room.set(left);
        left.map(|_| value)
    }

    fn text(&self, text: &str, span: Span) -> Value {
        if let Some(name) = text.strip_prefix("${").and_then(|rest| rest.strip_suffix('}')).filter(|n| !n.contains('}'))
        {
            return self.named(name.trim(), span).unwrap_or_default();
        }
        let (mut filled, mut rest) = (String::new(), text);
        while let Some((before, after)) = rest.split_once("${") {
            if let Some(before) = before.strip_suffix('$') {
                filled.push_str(before);
                filled.push_str("${");
                rest = after;
                continue;
            }
            let Some((name, tail)) = after.split_once('}') else {
                self.fault(Diagnostic::at(span, format!("`{text}`: `${{` without `}}`")));
                return Value::Null;
            };
            filled.push_str(before);
            match self.named(name.trim(), span) {
                None => {}
                Some(Value::String(text)) => filled.push_str(&text),
                Some(Value::Array(_) | Value::Object(_)) => {
                    let message = format!("`${{{name}}}` is a list or map and cannot stand inside a text");
                    self.fault(Diagnostic::at(span, message));
                }
                Some(other) => filled.push_str(&other.to_string()),
            }
            rest = tail;
        }
        filled.push_str(rest);
        Value::String(filled)
    }
}

fn names(text: &str) -> impl Iterator<Item = &str> {
    let parts = text.split("${");
    let before = parts.clone().map(|part| part.ends_with('$'));
    let meant = parts.skip(1).zip(before).filter(|(_, escaped)| !escaped);
    meant.filter_map(|(part, _)| part.split_once('}')).map(|(name, _)| name.trim())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn fill(yaml: &str) -> Result<Value, Vec<Diagnostic>> {
        let node = Node::parse(yaml, 0).unwrap();
        filled(&node, &|name| match name {
            "cell" => Some(json!(0.01)),
            "dir" => Some(json!("data")),
            "list" => Some(json!([1, 2])),
            "m.k" => Some(json!({"z": 5})),
            _ => None,
        })
    }

    #[test]
    fn whole_values_keep_their_type_and_texts_are_joined() {
        assert_eq!(
            fill("{a: '${cell}', b: '${dir}/x_${cell}.ply', c: ['${list}']}").unwrap(),
            json!({"a": 0.01, "b": "data/x_0.01.ply", "c": [[1, 2]]})
        );
    }

    #[test]
    fn a_doubled_dollar_stands_for_the_text() {
        assert_eq!(
            fill("{a: '$${cell}', b: 'x $${ ${dir}/$${cell} ${cell}$', c: '$$${cell}', d: '$$x ${dir}'}").unwrap(),
            json!({"a": "${cell}", "b": "x ${ data/${cell} 0.01$", "c": "$${cell}", "d": "$$x data"})
        );
        assert_eq!(names("$${a} ${b} $${c ${d}").collect::<Vec<_>>(), ["b", "d"]);
    }

    #[test]
    fn what_names_bring_in_is_bounded() {
        let long = Value::from("x".repeat(FILLED_BYTES / 4));
        let filled_with = |yaml: &str| filled(&Node::parse(yaml, 0).unwrap(), &|_| Some(long.clone()));
        assert!(filled_with("'${a}${a}${a}'").is_ok());
        for bad in ["'${a}${a}${a}${a}'", "['${a}', ['${a}', '${a}'], {b: '${a}'}]"] {
            let faults = filled_with(bad).unwrap_err();
            let message = &faults[0].message;
            assert!(faults.len() == 1 && message.contains("`${a}`") && message.contains("4 MiB"), "{faults:?}");
        }
    }

    #[test]
    fn unknown_names_and_open_braces_are_faults() {
        for bad in ["'${nobody}'", "'a ${cell'", "'x${list}'"] {
            assert!(fill(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn all_that_cannot_be_filled_in_is_told() {
        let faults = fill("{a: 'v${list}', b: ['${', 'a ${list} ${who}'], c: '${dir}'}").unwrap_err();
        let told: Vec<&str> = faults.iter().map(|fault| fault.message.as_str()).collect();
        let no_text = "`${list}` is a list or map and cannot stand inside a text";
        let unknown = "`${who}` names neither a parameter nor an axis";
        assert_eq!(told, [no_text, "`${`: `${` without `}`", no_text, unknown]);
    }

    #[test]
    fn names_lead_one_level_into_a_map() {
        let fault = fill("'${m.k.z}'").unwrap_err().remove(0);
        assert_eq!(fault.message, "`${m.k.z}`: `m` has no value `k.z`");
        let hint = fault.hint.unwrap();
        assert!(hint.contains("one level") && hint.contains("${m.k}"), "{hint}");
        assert_eq!(fill("'${m.a.z}'").unwrap_err()[0].hint, None);
    }

    #[test]
    fn keys_that_look_filled_in_are_found() {
        let node = Node::parse("{'k${e}': [{'${f}': 1}], '$${g}': 2, h: '${i}'}", 0).unwrap();
        let mut found = Vec::new();
        filled_in_keys(&node, &mut found);
        assert_eq!(found.iter().map(|key| key.name.as_str()).collect::<Vec<_>>(), ["k${e}", "${f}"]);
    }
}
