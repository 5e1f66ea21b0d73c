//! `${name}`: parameters and axis items put into the values of a step. `$${name}` stands for the text `${name}`.

use std::cell::Cell;
use std::collections::BTreeMap;

use serde_json::Value;

use super::node::{Data, Node};
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
/// inside a longer text the value is written out.
pub fn filled(node: &Node, lookup: &dyn Fn(&str) -> Option<Value>) -> Result<Value, Diagnostic> {
    Filler { lookup, room: Cell::new(FILLED_BYTES) }.value(node)
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
    /// Bytes that may still come in.
    room: Cell<usize>,
}

impl Filler<'_> {
    fn value(&self, node: &Node) -> Result<Value, Diagnostic> {
        match &node.data {
            Data::Scalar(Value::String(text)) => self.text(text).map_err(|e| Diagnostic::at(node.span, e)),
            Data::Scalar(value) => Ok(value.clone()),
            Data::List(items) => items.iter().map(|item| self.value(item)).collect(),
            Data::Map(entries) => entries.iter().map(|(key, item)| Ok((key.name.clone(), self.value(item)?))).collect(),
        }
    }

    /// What a name stands for.
    fn named(&self, name: &str) -> Result<Value, String> {
        let value = (self.lookup)(name).ok_or_else(|| match parted(name) {
            (base, Some(field)) => format!("`${{{name}}}`: `{base}` has no value `{field}`"),
            (_, None) => format!("`${{{name}}}` names neither a parameter nor an axis"),
        })?;
        let left = self.room.get().checked_sub(value_bytes(&value));
        self.room.set(left.ok_or_else(|| {
            let mib = FILLED_BYTES >> 20;
            format!("with `${{{name}}}` this value takes more than {mib} MiB; put a long one into a file")
        })?);
        Ok(value)
    }

    fn text(&self, text: &str) -> Result<Value, String> {
        if let Some(name) = text.strip_prefix("${").and_then(|rest| rest.strip_suffix('}')).filter(|n| !n.contains('}'))
        {
            return self.named(name.trim());
        }
        let (mut filled, mut rest) = (String::new(), text);
        while let Some((before, after)) = rest.split_once("${") {
            if let Some(before) = before.strip_suffix('$') {
                filled.push_str(before);
                filled.push_str("${");
                rest = after;
                continue;
            }
            let (name, tail) = after.split_once('}').ok_or_else(|| format!("`{text}`: `${{` without `}}`"))?;
            filled.push_str(before);
            match self.named(name.trim())? {
                Value::String(text) => filled.push_str(&text),
                Value::Array(_) | Value::Object(_) => {
                    return Err(format!("`${{{name}}}` is a list or map and cannot stand inside a text"));
                }
                other => filled.push_str(&other.to_string()),
            }
            rest = tail;
        }
        filled.push_str(rest);
        Ok(Value::String(filled))
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

    fn fill(yaml: &str) -> Result<Value, Diagnostic> {
        let node = Node::parse(yaml, 0).unwrap();
        filled(&node, &|name| match name {
            "cell" => Some(json!(0.01)),
            "dir" => Some(json!("data")),
            "list" => Some(json!([1, 2])),
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
            let message = filled_with(bad).unwrap_err().message;
            assert!(message.contains("`${a}`") && message.contains("4 MiB"), "{message}");
        }
    }

    #[test]
    fn unknown_names_and_open_braces_are_faults() {
        for bad in ["'${nobody}'", "'a ${cell'", "'x${list}'"] {
            assert!(fill(bad).is_err(), "{bad}");
        }
    }
}
