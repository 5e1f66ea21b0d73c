//! What is wrong with a text that cannot be read as YAML, in words that need no knowledge of the reader behind it.

use std::fmt;

use serde::de::{Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_saphyr::options::{MergeKeyPolicy, NonFiniteFloatPolicy};

use super::first_words;
use crate::diagnostic::{Diagnostic, MARK, Span};

/// The key that puts the entries of another map in.
const MERGE: &str = "<<";

/// The fault of a second `<<` in one map: the reader would take both, though a key stands once.
pub fn second_merge(text: &str, source: usize) -> Option<Diagnostic> {
    text.matches(MERGE).nth(1)?;
    let options = serde_saphyr::options! {
        strict_booleans: true,
        non_finite_float_policy: NonFiniteFloatPolicy::PassThrough,
        merge_keys: MergeKeyPolicy::AsOrdinary,
    };
    let error = serde_saphyr::from_str_with_options::<Keys>(text, options).err()?;
    match error.without_snippet() {
        serde_saphyr::Error::DuplicateMappingKey { key: Some(key), .. } if key == MERGE => {
            let fault = syntax_error(text, source, &error);
            Some(fault.hint("give one `<<` a list: `<<: [*one, *other]`, of which the first has precedence"))
        }
        _ => None,
    }
}

/// A text of which only the keys are looked at.
struct Keys;

impl<'de> Deserialize<'de> for Keys {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Self)
    }
}

impl<'de> Visitor<'de> for Keys {
    type Value = Self;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a YAML value")
    }
    fn visit_bool<E>(self, _: bool) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_i64<E>(self, _: i64) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_u64<E>(self, _: u64) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_f64<E>(self, _: f64) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_str<E>(self, _: &str) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_unit<E>(self) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_none<E>(self) -> Result<Self, E> {
        Ok(self)
    }
    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self, D::Error> {
        Self::deserialize(deserializer)
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Self, A::Error> {
        while seq.next_element::<Self>()?.is_some() {}
        Ok(self)
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self, A::Error> {
        while map.next_entry::<String, Self>()?.is_some() {}
        Ok(self)
    }
}

/// What is wrong with a text that is no YAML, or none that a pipeline may be, and where.
pub fn syntax_error(text: &str, source: usize, error: &serde_saphyr::Error) -> Diagnostic {
    let (message, hint) = fault_of_text(error.without_snippet());
    let diagnostic = match error.location() {
        Some(location) => {
            let start = byte_position(text, location.line() as usize, location.column() as usize);
            if let Some(mention) = open_mention(text, start) {
                let message = format!("`{mention}` without quotes cannot stand between braces or brackets");
                let span = Span { source, start: start - 1, end: start - 1 + mention.len() };
                return Diagnostic::at(span, message).hint(format!("put quotes around it: \"{mention}\""));
            }
            if let Some(slip) = first_words::slip(text, start, &message) {
                let span = Span { source, start: slip.bytes.start, end: slip.bytes.end };
                return Diagnostic::at(span, slip.message).hint(slip.hint);
            }
            Diagnostic::at(Span { source, start, end: start + 1 }, message)
        }
        None => Diagnostic::general(message),
    };
    if hint.is_empty() { diagnostic } else { diagnostic.hint(hint) }
}

/// What is wrong with a text, and the way out, in words that need no knowledge of the reader behind it.
fn fault_of_text(error: &serde_saphyr::Error) -> (String, &'static str) {
    use serde_saphyr::Error;
    match error {
        Error::MultipleDocuments { .. } => {
            ("a second document begins here".to_owned(), "a pipeline is one document: remove the line `---` before it")
        }
        Error::DuplicateMappingKey { key, .. } => {
            let key = key.as_deref().map(|key| format!(" `{key}`")).unwrap_or_default();
            (format!("the key{key} occurs twice"), "rename or remove one of the two")
        }
        Error::UnknownAnchor { .. } => {
            ("this alias names no anchor".to_owned(), "write `&name` before the value that `*name` repeats")
        }
        // A key is the only place where nothing but text will do.
        Error::NullIntoString { .. } => {
            ("a key is empty, `~` or `null`, and so has no name".to_owned(), "give it a name, or put it in quotes")
        }
        Error::RecursiveReferencesRequireWeakTypes { .. } => {
            let message = "this alias stands inside of the value that it repeats".to_owned();
            (message, "let `*name` repeat a value that has ended before it")
        }
        Error::MergeValueNotMapOrSeqOfMaps { .. } => {
            ("`<<` takes a map or a list of maps".to_owned(), "write `<<: *name`, where `&name` stands before a map")
        }
        Error::Eof { .. } => ("there is nothing in it".to_owned(), "begin with `rockface: 1`"),
        Error::Budget { .. }
        | Error::AliasReplayLimitExceeded { .. }
        | Error::AliasExpansionLimitExceeded { .. }
        | Error::AliasReplayStackDepthExceeded { .. } => too_large(),
        Error::Message { msg, .. } => (format!("this is not YAML that can be read: {msg}"), ""),
        other => {
            let told = other.to_string();
            let reason = told.split(" at line ").next().unwrap_or_default();
            if reason.contains("recursion limit") || reason.contains("budget breached") {
                return too_large();
            }
            let message = format!("this is not YAML that can be read: {reason}");
            (message, "look for a missing quote, bracket or space after `:`")
        }
    }
}

fn too_large() -> (String, &'static str) {
    let message = "the text is larger or nested deeper than a pipeline may be".to_owned();
    (message, "divide it, or repeat less by `*`")
}

/// The `${name}` whose brace stands at a place, on which readers stumble where it is not quoted.
fn open_mention(text: &str, at: usize) -> Option<&str> {
    let mention = text.get(at.checked_sub(1)?..).filter(|rest| rest.starts_with("${"))?;
    let end = mention.find(['}', '\n']).filter(|end| mention[*end..].starts_with('}'))?;
    mention.get(..=end)
}

/// The byte of a line and column, both counted from one, the column in characters.
fn byte_position(text: &str, line: usize, column: usize) -> usize {
    // The mark of UTF-8 at the start of a text is no column of it.
    let mark = if line <= 1 && text.starts_with(MARK) { MARK.len_utf8() } else { 0 };
    let line_start = mark + text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum::<usize>();
    let rest = &text[line_start.min(text.len())..];
    line_start + rest.char_indices().nth(column.saturating_sub(1)).map_or(rest.len(), |(offset, _)| offset)
}

#[cfg(test)]
mod tests {
    use super::super::node::Node;

    #[test]
    fn unreadable_texts_say_why() {
        let said = |text: &str| {
            let fault = Node::parse(text, 0).unwrap_err();
            format!("{} | {}", fault.message, fault.hint.unwrap_or_default())
        };
        for text in ["a: {b: ${x}}", "a: [${x}, 1]", "a: {b: ${x}/y, c: 1}"] {
            assert!(said(text).contains("`${x}` without quotes") && said(text).contains("\"${x}\""), "{}", said(text));
        }
        assert!(said("a: {b: 1").contains("can be read: ") && said("a: b: c").contains("not allowed"));
        let deep = format!("a: {}{}", "[".repeat(5000), "]".repeat(5000));
        let level = |i: u32| format!("a{i}: &a{i} [{}]\n", vec![format!("*a{}", i.wrapping_sub(1)); 10].join(", "));
        let repeated = format!("a0: &a0 [1, 2]\n{}", (1..9).map(level).collect::<String>());
        for text in [deep, repeated] {
            assert!(said(&text).contains("larger or nested deeper"), "{}", said(&text));
        }
    }

    #[test]
    fn faults_of_keys_and_aliases_are_told_plainly() {
        let said = |text: &str| {
            let fault = Node::parse(text, 0).unwrap_err();
            format!("{} | {} | {:?}", fault.message, fault.hint.unwrap_or_default(), fault.span.map(|span| span.start))
        };
        for text in ["a: 1\n~: {b: 1}\n", "a: 1\nnull: 2\n"] {
            assert!(said(text).contains("has no name") && said(text).ends_with("Some(5)"), "{}", said(text));
        }
        assert!(
            said("a: &s\n  b: *s\n").contains("inside of the value that it repeats"),
            "{}",
            said("a: &s\n  b: *s\n")
        );
        assert!(
            said("a: &s 1\nb: {<<: *s}\n").contains("a map or a list of maps"),
            "{}",
            said("a: &s 1\nb: {<<: *s}\n")
        );
        let twice = "a: &a {x: 1}\nb: &b {y: 2}\nc:\n  <<: *a\n  <<: *b\n";
        assert!(said(twice).contains("`<<` occurs twice") && said(twice).contains("[*one, *other]"), "{}", said(twice));
        assert!(Node::parse("a: &a {x: 1}\nb: {<<: *a}\nc: {<<: *a, t: '<<'}\n", 0).is_ok());
        assert!(Node::parse("a: &a {x: 1}\nb: &b {y: 2}\nc: {<<: [*a, *b]}\nd: {<<: *a}\n", 0).is_ok());
    }

    #[test]
    fn the_mark_of_utf_8_is_no_column() {
        for text in ["\u{feff}a: [1\n", "\u{feff}b: 1\nb: 2\n"] {
            let (marked, plain) = (Node::parse(text, 0).unwrap_err(), Node::parse(&text[3..], 0).unwrap_err());
            let start = |fault: &crate::diagnostic::Diagnostic| fault.span.unwrap().start;
            assert_eq!(start(&marked), start(&plain) + 3, "{text:?}");
        }
    }
}
