//! Parameters that are declared with their type: what may stand for them, in which unit, and what they are if nobody says.

use std::fmt;

use serde_json::Value;

use super::node::{Data, Key, Node, Word};
use super::reader::Reader;
use super::substitute::mentioned;
use crate::diagnostic::{Diagnostic, Span, listed};

/// The way out for a text that is meant as a number: one with a decimal comma, or with its unit.
pub fn as_number(text: &str) -> Option<String> {
    let number = text.replace(',', ".");
    if text.contains(',') && number.parse::<f64>().is_ok() {
        return Some(format!("numbers are written with a point: {number}"));
    }
    let unit = text.trim_start_matches(|letter: char| letter.is_ascii_digit() || "+-.,".contains(letter));
    let value = &text[..text.len() - unit.len()];
    let is_unit =
        !unit.trim().is_empty() && unit.trim().chars().all(|letter| letter.is_alphabetic() || "°%²³/".contains(letter));
    (is_unit && value.replace(',', ".").parse::<f64>().is_ok()).then(|| {
        format!(
            "a number is written without `{}`: the end of a name has its unit, such as `_m` for metres",
            unit.trim()
        )
    })
}

/// The way out for a name with a space that looks like one and is none, as word processors and web pages have it.
pub fn odd_space(name: &str) -> Option<String> {
    let space = name.chars().find(|letter| letter.is_whitespace() && !letter.is_ascii() || *letter == '\u{200b}')?;
    Some(format!(
        "a character that looks like a space or like nothing (U+{:04X}) stands in it, as word processors and web pages have them: write it anew",
        space as u32
    ))
}

/// A parameter with its type.
#[derive(Debug, Clone)]
pub struct Declared {
    /// Its name, as `${name}` refers to it.
    pub name: Word,
    /// What may stand for it.
    pub kind: ValueKind,
    /// The unit of the value, for people.
    pub unit: Option<String>,
    /// The lowest number it may be.
    pub min: Option<f64>,
    /// The highest number it may be.
    pub max: Option<f64>,
    /// The values it may have; empty: any.
    pub choices: Vec<Value>,
    /// What it is if nobody says.
    pub default: Option<Node>,
    /// What it is about.
    pub doc: String,
}

/// What may stand for a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueKind {
    /// Any number, whole ones included.
    Number,
    /// A number without a fraction; `3.0` counts.
    Integer,
    /// `true` or `false`.
    Boolean,
    /// Text; a number is taken for the text of it, as it is written.
    Text,
    /// The path of a file or folder, or a pattern for several; relative to the file in which it is written.
    Path,
    /// A list of anything.
    List,
    /// A map of anything.
    Map,
    /// Any value, which is not checked.
    Any,
}

impl ValueKind {
    /// Every kind with the word for it.
    pub const WORDS: [(Self, &'static str); 8] = [
        (Self::Number, "number"),
        (Self::Integer, "integer"),
        (Self::Boolean, "boolean"),
        (Self::Text, "text"),
        (Self::Path, "path"),
        (Self::List, "list"),
        (Self::Map, "map"),
        (Self::Any, "any"),
    ];

    /// The word that a declaration says.
    pub fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(kind, _)| *kind == self).map_or("any", |(_, word)| *word)
    }

    fn of_word(word: &str) -> Option<Self> {
        Self::WORDS.iter().find(|(_, own)| *own == word).map(|(kind, _)| *kind)
    }

    /// A value as a parameter of this kind has it: of text, a number is the text as it is written.
    pub fn taken(self, node: Node) -> Node {
        match &node.data {
            Data::Scalar(value @ Value::Number(_)) if self == Self::Text => {
                let text = if node.written.is_empty() { value.to_string() } else { node.written.clone() };
                Node::made(node.span, Data::Scalar(Value::String(text)))
            }
            _ => node,
        }
    }

    fn fits(self, value: &Value) -> bool {
        match self {
            Self::Number => value.is_number(),
            Self::Integer => value.as_f64().is_some_and(|x| x.fract() == 0.0 && x.abs() < 9e15),
            Self::Boolean => value.is_boolean(),
            Self::Text | Self::Path => value.is_string(),
            Self::List => value.is_array(),
            Self::Map => value.is_object(),
            Self::Any => true,
        }
    }
}

impl fmt::Display for ValueKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Number => "a number",
            Self::Integer => "a whole number",
            Self::Boolean => "true or false",
            Self::Text => "text",
            Self::Path => "the path of a file or folder",
            Self::List => "a list",
            Self::Map => "a map",
            Self::Any => "any value",
        })
    }
}

/// The keys of a declaration.
pub const KEYS: &[&str] = &["type", "unit", "min", "max", "choices", "default", "doc"];

/// Whether a value under `params` declares a parameter: it is a map that says its `type`.
pub fn is_declared(node: &Node) -> bool {
    node.get("type").and_then(Node::text).is_some()
}

/// Whether a parameter is declared as text, or as a path, which is taken from the command line as it is written.
pub fn is_text(declared: Option<&Node>) -> bool {
    let word = declared.and_then(|declared| declared.get("type")?.text());
    word.is_some_and(|word| word == ValueKind::Text.word() || word == ValueKind::Path.word())
}

/// A text of the command line: what quotes around the whole contain, or all of it as it is written, without the space
/// around it. Nothing at all, `null` and `~` are no text but `null`. The place of the value leads into its own text.
pub fn text_as_written(written: &str, span: Span) -> Node {
    let trimmed = written.trim();
    let is_quoted = trimmed.starts_with(['"', '\'']);
    let parsed = Node::parse(trimmed, span.source).ok().filter(|node| {
        let is_nothing = matches!(node.data, Data::Scalar(Value::Null)) && node.written.is_empty();
        (is_quoted && node.text().is_some() || is_nothing) && comment_after(node, trimmed).is_none()
    });
    let data = parsed.map_or_else(|| Data::Scalar(Value::String(trimmed.to_owned())), |node| node.data);
    Node::made(span, data)
}

/// What a reader of YAML takes for a comment behind a single value: it would be lost.
pub fn comment_after<'t>(node: &Node, written: &'t str) -> Option<&'t str> {
    let is_nothing = matches!(node.data, Data::Scalar(Value::Null)) && node.written.is_empty();
    let rest = written.get(node.span.end.min(written.len())..)?.trim();
    let rest = if is_nothing && written.trim().starts_with('#') { written.trim() } else { rest };
    (matches!(node.data, Data::Scalar(_)) && rest.starts_with('#')).then_some(rest)
}

/// A value of the command line as the parameter takes it: where that is declared as text, also `1e3`, `017` and `true` are text, as
/// they are written. Places of the value lead into `text`.
pub fn as_given(declared: Option<&Node>, node: Node, text: &str) -> Node {
    let written = match &node.data {
        Data::Scalar(Value::Null) if node.written.is_empty() => return node,
        Data::Scalar(Value::Null | Value::Bool(_) | Value::Number(_)) if is_text(declared) => {
            if node.written.is_empty() {
                text.get(node.span.start..node.span.end).unwrap_or_default().trim().to_owned()
            } else {
                node.written.clone()
            }
        }
        _ => return node,
    };
    Node::made(node.span, Data::Scalar(Value::String(written)))
}

impl Declared {
    /// What is wrong with a value for it; one that depends on an axis is not known yet.
    pub fn fault(&self, node: &Node) -> Option<Diagnostic> {
        let mut names = Vec::new();
        mentioned(node, &mut names);
        // Where nobody need say anything, `null` says nothing.
        let is_null = |node: &Node| node.to_value().is_null();
        if is_null(node) && self.default.as_ref().is_some_and(is_null) {
            return None;
        }
        if names.is_empty() && node.bad_number().is_none() {
            self.value_fault(&self.kind.taken(node.clone()).to_value(), node.span)
        } else {
            None
        }
    }

    /// What is wrong with a value for it that stands at a place.
    pub fn value_fault(&self, value: &Value, span: Span) -> Option<Diagnostic> {
        let name = &self.name.text;
        let shown = if value.is_null() { "nothing".to_owned() } else { format!("`{value}`") };
        let message = if !self.kind.fits(value) {
            format!("parameter `{name}` is {}, found {shown}", self.kind)
        } else if !self.choices.is_empty() && !self.choices.contains(value) {
            format!("parameter `{name}` cannot be {shown}")
        } else {
            let stray = self.stray_number(value)?;
            format!("parameter `{name}` cannot be {stray}: {}", self.range())
        };
        let mut fault = Diagnostic::at(span, message).also(self.name.span, format!("`{name}` is declared here"));
        if let Some(hint) = value.as_str().filter(|_| !self.kind.fits(value)).and_then(as_number) {
            fault = fault.hint(hint);
        }
        Some(if self.choices.is_empty() { fault } else { fault.hint(format!("one of: {}", self.choice_words())) })
    }

    /// The first number of a value that is out of the range.
    fn stray_number(&self, value: &Value) -> Option<f64> {
        match value {
            Value::Number(number) => {
                number.as_f64().filter(|x| self.min.is_some_and(|min| *x < min) || self.max.is_some_and(|max| *x > max))
            }
            Value::Array(items) => items.iter().find_map(|item| self.stray_number(item)),
            _ => None,
        }
    }

    /// The range in words.
    pub fn range(&self) -> String {
        match (self.min, self.max) {
            (Some(min), Some(max)) => format!("from {min} to {max}"),
            (Some(min), None) => format!("at least {min}"),
            (None, Some(max)) => format!("at most {max}"),
            (None, None) => String::new(),
        }
    }

    /// The choices, with commas between them.
    pub fn choice_words(&self) -> String {
        let words: Vec<String> =
            self.choices.iter().map(|one| one.as_str().map_or_else(|| one.to_string(), str::to_owned)).collect();
        listed(words.iter().map(String::as_str))
    }
}

impl Reader<'_> {
    /// A declaration of a parameter.
    pub fn declared(&mut self, key: &Key, node: &Node) -> Option<Declared> {
        let what = format!("parameter `{}`", key.name);
        self.map(node, &what, KEYS)?;
        let name = Word { span: key.span, text: key.name.clone() };
        let word = self.word(node.get("type")?, "a type")?;
        let Some(kind) = ValueKind::of_word(&word.text) else {
            let fault = Diagnostic::at(word.span, format!("{what} has the unknown type `{}`", word.text));
            self.fault(fault.suggest(&word.text, ValueKind::WORDS.map(|(_, word)| word)));
            return None;
        };
        let unit = node.get("unit").and_then(|n| self.word(n, "a unit")).map(|word| word.text);
        let doc = node.get("doc").and_then(|n| self.sentence(n, "doc")).unwrap_or_default();
        let mut bound = |side: &str| {
            let node = node.get(side)?;
            let number = node.to_value().as_f64();
            if number.is_none() {
                self.expected(node, "a number");
            }
            number
        };
        let (min, max) = (bound("min"), bound("max"));
        let choices = match node.get("choices").map(|n| (&n.data, n)) {
            None => Vec::new(),
            Some((Data::List(list), n)) => {
                if list.is_empty() {
                    let fault = Diagnostic::at(n.span, format!("the list of choices of {what} is empty"));
                    self.fault(fault.hint("name the values that it may have, or remove `choices`"));
                }
                list.iter().map(|one| kind.taken(one.clone()).to_value()).collect()
            }
            Some((_, n)) => {
                self.expected(n, "a list of values");
                Vec::new()
            }
        };
        let declared = Declared { name, kind, unit, min, max, choices, default: None, doc };
        let default = node.get("default").filter(|n| n.bad_number().is_none() && self.check_keys(n));
        let default = default.map(|default| kind.taken(default.clone()));
        let declared = Declared { default, ..declared };
        if let Some(fault) = declared.default.as_ref().and_then(|default| declared.fault(default)) {
            self.fault(fault);
        }
        Some(declared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn declared(yaml: &str) -> Result<Declared, String> {
        let node = Node::parse(yaml, 0).unwrap();
        let mut faults = Vec::new();
        let key = Key { span: Span::default(), name: "x".into() };
        let found = Reader::new(&mut faults).declared(&key, &node);
        faults.first().map_or_else(|| found.ok_or_else(String::new), |fault| Err(fault.message.clone()))
    }

    #[test]
    fn numbers_with_a_comma_or_a_unit_and_odd_spaces_have_a_way_out() {
        assert!(as_number("0,05").unwrap().ends_with("with a point: 0.05"));
        for text in ["5 cm", "4m", "-1.5 °", "2,5 m²"] {
            assert!(as_number(text).is_some_and(|hint| hint.contains("written without `")), "{text}");
        }
        assert!(["wide", "a4", "1.2.3 m", "", "cm", "4 of 5"].into_iter().all(|text| as_number(text).is_none()));
        assert!(odd_space("width_m:\u{a0}4").unwrap().contains("(U+00A0)"));
        assert_eq!(odd_space("width m"), None);
    }

    #[test]
    fn values_are_held_against_type_range_and_choices() {
        for (declaration, good, bad) in [
            ("{type: number, min: 0, max: 2}", "1.5", "[-1, 3, word, null]"),
            ("{type: integer, min: 1}", "3.0", "[0, 1.5, word]"),
            ("{type: boolean}", "true", "[1, word]"),
            ("{type: text, choices: [a, b]}", "a", "[c, 1]"),
            ("{type: text, choices: [1.0, 1e3]}", "1e3", "[1, 1000]"),
            ("{type: list, max: 1}", "[0, 1]", "[[2], word]"),
            ("{type: map}", "{a: 1}", "[1, word]"),
            ("{type: path}", "a/b.ply", "[1]"),
            ("{type: text, default: null}", "null", "[true]"),
        ] {
            let declared = declared(declaration).unwrap();
            assert_eq!(declared.fault(&Node::parse(good, 0).unwrap()), None, "{declaration} {good}");
            let Data::List(bad) = Node::parse(bad, 0).unwrap().data else { panic!("a list") };
            for node in bad {
                assert!(declared.fault(&node).is_some(), "{declaration} {:?}", node.data);
            }
        }
        let open = declared("{type: number, min: 0}").unwrap();
        assert_eq!(open.fault(&Node::parse("'${axis}'", 0).unwrap()), None);
    }

    #[test]
    fn declarations_that_cannot_be_are_told() {
        for (declaration, said) in [
            ("{type: numbr}", "unknown type `numbr`"),
            ("{type: number, mni: 0}", "unknown key `mni`"),
            ("{type: number, min: low}", "expected a number"),
            ("{type: number, max: 1, default: 2}", "cannot be 2: at most 1"),
            ("{type: text, choices: a}", "a list of values"),
            ("{type: text, choices: []}", "the list of choices of parameter `x` is empty"),
            ("{type: map, default: {'k${e}': 1}}", "nothing is filled into keys"),
        ] {
            assert!(declared(declaration).unwrap_err().contains(said), "{declaration}");
        }
    }

    #[test]
    fn text_is_taken_as_it_is_written() {
        let default = declared("{type: text, default: 1.0}").unwrap().default.unwrap();
        assert_eq!(default.to_value(), "1.0");
        let text = Node::parse("{type: text}", 0).unwrap();
        let number = Node::parse("{type: number}", 0).unwrap();
        for written in ["1.0", "1e3", "0x10", "017", "true", ".inf"] {
            let given = || Node::parse(written, 0).unwrap();
            assert_eq!(as_given(Some(&text), given(), written).to_value(), written);
            for other in [Some(&number), None] {
                assert_eq!(as_given(other, given(), written), given());
            }
        }
        for (written, value) in [("'1'", Value::from("1")), ("null", Value::Null), ("", Value::Null)] {
            assert_eq!(as_given(Some(&text), Node::parse(written, 0).unwrap(), written).to_value(), value);
        }
    }
}
