//! Canonical JSON: sorted keys, no spaces, one text for each value, so that it can be hashed.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde_json::{Map, Value};

use crate::Digest;

/// Appends the canonical text of `value`. Numbers keep their kind: `1` and `1.0` are different values.
pub(crate) fn write_value(out: &mut String, value: &Value) {
    match value {
        Value::Null => out.push_str("null"),
        Value::Bool(true) => out.push_str("true"),
        Value::Bool(false) => out.push_str("false"),
        Value::Number(number) => push_display(out, number),
        Value::String(text) => write_str(out, text),
        Value::Array(items) => write_list(out, items, write_value),
        Value::Object(map) => write_object(out, map),
    }
}

/// Appends `text` as a JSON string: quotes, backslashes and control characters escaped, everything else as it is.
pub(crate) fn write_str(out: &mut String, text: &str) {
    out.push('"');
    if text.bytes().all(|byte| byte >= 0x20 && byte != b'"' && byte != b'\\') {
        out.push_str(text);
        out.push('"');
        return;
    }
    for letter in text.chars() {
        match letter {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            control if (control as u32) < 0x20 => {
                push_display(out, format_args!("\\u{:04x}", control as u32));
            }
            other => out.push(other),
        }
    }
    out.push('"');
}

/// Appends a digest as a JSON string.
pub(crate) fn write_digest(out: &mut String, digest: &Digest) {
    out.push('"');
    digest.hex(|text| out.push_str(text));
    out.push('"');
}

/// Appends a map of strings, in key order.
pub(crate) fn write_strings(out: &mut String, map: &BTreeMap<String, String>) {
    write_entries(out, map.iter(), |out, text| write_str(out, text));
}

/// Appends `{"key":value,...}` in the order given; the caller's order must be the sorted one.
pub(crate) fn write_entries<'a, V: 'a>(
    out: &mut String,
    entries: impl Iterator<Item = (&'a String, V)>,
    write: impl Fn(&mut String, V),
) {
    out.push('{');
    for (place, (key, value)) in entries.enumerate() {
        if place > 0 {
            out.push(',');
        }
        write_str(out, key);
        out.push(':');
        write(out, value);
    }
    out.push('}');
}

/// Appends `[item,...]`.
pub(crate) fn write_list<T>(out: &mut String, items: &[T], write: impl Fn(&mut String, &T)) {
    out.push('[');
    for (place, item) in items.iter().enumerate() {
        if place > 0 {
            out.push(',');
        }
        write(out, item);
    }
    out.push(']');
}

/// Appends anything that displays itself; a `String` takes every byte it is given.
pub(crate) fn push_display(out: &mut String, value: impl std::fmt::Display) {
    write!(out, "{value}").expect("writing to a String cannot fail");
}

/// Keys are sorted here because `Map` keeps insertion order when any crate of the build asks `serde_json` for it.
fn write_object(out: &mut String, map: &Map<String, Value>) {
    let mut entries: Vec<_> = map.iter().collect();
    entries.sort_unstable_by_key(|(key, _)| *key);
    write_entries(out, entries.into_iter(), write_value);
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::json;

    fn text(value: &Value) -> String {
        let mut out = String::new();
        write_value(&mut out, value);
        out
    }

    /// Any JSON value of moderate size.
    pub(crate) fn any_value() -> impl Strategy<Value = Value> {
        let number = prop_oneof![
            any::<i64>().prop_map(Value::from),
            any::<u64>().prop_map(Value::from),
            any::<f64>().prop_filter("JSON has no NaN", |x| x.is_finite()).prop_map(Value::from),
        ];
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            number,
            any::<String>().prop_map(Value::from),
        ];
        leaf.prop_recursive(3, 24, 5, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..5).prop_map(Value::from),
                proptest::collection::btree_map(any::<String>(), inner, 0..5)
                    .prop_map(|map| Value::Object(map.into_iter().collect())),
            ]
        })
    }

    #[test]
    fn key_order_is_irrelevant_and_number_kind_is_not() {
        let given: Value = serde_json::from_str(r#"{"b": [1, 1.0, true], "a": {"z": null, "y": "é\n"}}"#).unwrap();
        assert_eq!(text(&given), r#"{"a":{"y":"é\n","z":null},"b":[1,1.0,true]}"#);
        assert_ne!(text(&json!(1)), text(&json!(1.0)));
    }

    proptest! {
        #[test]
        fn the_text_is_the_value(value in any_value()) {
            let once = text(&value);
            let back: Value = serde_json::from_str(&once).unwrap();
            prop_assert_eq!(&back, &value);
            prop_assert_eq!(text(&back), once);
        }

        #[test]
        fn strings_are_escaped_as_serde_json_does(given: String) {
            let mut out = String::new();
            write_str(&mut out, &given);
            prop_assert_eq!(serde_json::from_str::<String>(&out).unwrap(), given);
        }
    }
}
