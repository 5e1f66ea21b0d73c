//! Reads the values of a document one by one and collects what is wrong with them.

use std::collections::BTreeSet;

use serde_json::Value;

use super::node::{Data, Key, Node, Word};
use super::substitute::filled_in_keys;
use crate::diagnostic::Diagnostic;

/// The keys of a pipeline.
pub const TOP: &[&str] =
    &["rockface", "name", "seed", "include", "parts", "params", "axes", "zip", "steps", "targets", "log"];

/// Reads one section of a document after the other.
pub struct Reader<'f> {
    /// What is wrong so far.
    pub(super) faults: &'f mut Vec<Diagnostic>,
    /// The seed of the pipeline, from which random streams follow.
    pub seed: u64,
    /// Whether there is a number that cannot be taken.
    pub(super) bad_numbers: bool,
    /// Items and values of counted and drawn axes so far.
    pub drawn: u64,
    /// Names of steps that could not be read.
    pub(super) unread_steps: BTreeSet<String>,
    /// Names that could not be read of what may be an axis.
    pub(super) unread_names: BTreeSet<String>,
    /// Whether it is open which axes are walked together.
    pub zips_unread: bool,
}

impl<'f> Reader<'f> {
    /// Collects faults in a list.
    pub fn new(faults: &'f mut Vec<Diagnostic>) -> Self {
        Self {
            faults,
            seed: 0,
            bad_numbers: false,
            drawn: 0,
            unread_steps: BTreeSet::new(),
            unread_names: BTreeSet::new(),
            zips_unread: false,
        }
    }
}

impl Reader<'_> {
    /// How many faults there are so far.
    pub fn fault_count(&self) -> usize {
        self.faults.len()
    }

    /// Notes a step that could not be read: what refers to it is not wrong for that.
    pub fn unread_step(&mut self, name: String) {
        self.unread_steps.insert(name);
    }

    /// Adds the fault of a name that cannot be one; says whether it is sound.
    pub fn check_name(&mut self, key: &Key) -> bool {
        let bad = bad_name(&key.name);
        if let Some(bad) = bad {
            self.fault(Diagnostic::at(key.span, format!("`{}` cannot be a name: {bad}", key.name)));
        }
        bad.is_none()
    }

    /// Adds the faults of keys such as `k${name}`; says whether there are none.
    pub fn check_keys(&mut self, node: &Node) -> bool {
        let mut keys = Vec::new();
        filled_in_keys(node, &mut keys);
        for key in &keys {
            let message = format!("`{}` is a key, and nothing is filled into keys", key.name);
            let hint = "write the key as it is to be called, or give the whole map by a parameter";
            self.fault(Diagnostic::at(key.span, message).hint(hint));
        }
        keys.is_empty()
    }

    /// Notes a fault and reads on, so that all faults are reported together.
    pub fn fault(&mut self, diagnostic: Diagnostic) {
        self.faults.push(diagnostic);
    }

    /// Numbers such as `017`, of which nobody can say whether the zero counts, and such as `.nan`, which are none.
    pub fn check_numbers(&mut self, node: &Node) {
        match &node.data {
            Data::List(items) => items.iter().for_each(|item| self.check_numbers(item)),
            Data::Map(entries) => entries.iter().for_each(|(_, item)| self.check_numbers(item)),
            Data::Scalar(_) => {
                if let Some((message, hint)) = node.bad_number() {
                    self.bad_numbers = true;
                    self.fault(Diagnostic::at(node.span, message).hint(hint));
                }
            }
        }
    }

    /// Adds the fault of a value that is of another kind than it should be.
    pub fn expected(&mut self, node: &Node, what: &str) {
        if node.bad_number().is_some() {
            return; // Already reported.
        }
        self.fault(Diagnostic::at(node.span, format!("expected {what}, found {}", node.describe())));
    }

    /// The entries of a map, or a fault.
    pub fn any_map<'n>(&mut self, node: &'n Node, what: &str) -> Option<&'n [(Key, Node)]> {
        let entries = node.entries();
        if entries.is_none() {
            self.expected(node, &format!("{what} to be a map"));
        }
        entries
    }

    /// A map with known keys.
    pub fn map<'n>(&mut self, node: &'n Node, what: &str, known: &[&str]) -> Option<&'n [(Key, Node)]> {
        let entries = self.any_map(node, what)?;
        for (key, _) in entries.iter().filter(|(key, _)| !known.contains(&key.name.as_str())) {
            self.fault(
                Diagnostic::at(key.span, format!("unknown key `{}` in {what}", key.name))
                    .suggest(&key.name, known.iter().copied()),
            );
        }
        Some(entries)
    }

    /// A name, or a fault.
    pub fn identifier(&mut self, node: &Node, what: &str) -> Option<Word> {
        let word = self.word(node, what)?;
        match bad_name(&word.text) {
            None => Some(word),
            Some(bad) => {
                self.fault(Diagnostic::at(word.span, format!("{what} `{}` will not do: {bad}", word.text)));
                None
            }
        }
    }

    /// A word, or a fault; a number is one as it is written.
    pub fn word(&mut self, node: &Node, what: &str) -> Option<Word> {
        let word = match &node.data {
            Data::Scalar(Value::String(text)) => Some(text.clone()),
            Data::Scalar(Value::Number(_)) if !node.written.is_empty() => Some(node.written.clone()),
            Data::Scalar(value @ (Value::Number(_) | Value::Bool(_))) => Some(value.to_string()),
            _ => None,
        };
        if word.is_none() {
            self.expected(node, what);
        }
        word.map(|text| Word { span: node.span, text })
    }

    /// One word or a list of different ones.
    pub fn words(&mut self, node: &Node, what: &str) -> Vec<Word> {
        let words: Vec<Word> = match &node.data {
            Data::List(items) => items.iter().filter_map(|item| self.word(item, what)).collect(),
            _ => self.word(node, &format!("{what} or a list of them")).into_iter().collect(),
        };
        let mut seen = BTreeSet::new();
        for word in &words {
            if !seen.insert(word.text.as_str()) {
                self.fault(Diagnostic::at(word.span, format!("`{}` is named twice", word.text)).hint("name it once"));
            }
        }
        words
    }

    /// One word or a list of at least one.
    pub fn some_words(&mut self, node: &Node, what: &str) -> Vec<Word> {
        if matches!(&node.data, Data::List(items) if items.is_empty()) {
            self.fault(
                Diagnostic::at(node.span, format!("this list is empty; {what} is needed"))
                    .hint("name at least one, or remove the line"),
            );
        }
        self.words(node, what)
    }

    /// Reads `true` or `false`; `default` where nothing is given, or something else, which is reported.
    pub fn flag(&mut self, node: Option<&Node>, default: bool) -> bool {
        match node.map(|n| (&n.data, n)) {
            None => default,
            Some((Data::Scalar(Value::Bool(flag)), _)) => *flag,
            Some((_, node)) => {
                self.expected(node, "true or false");
                default
            }
        }
    }

    /// Reads a text for people, without the space around it; `None` where it is empty or no text.
    pub fn sentence(&mut self, node: &Node, what: &str) -> Option<String> {
        if let Data::Scalar(Value::String(text)) = &node.data {
            return Some(text.trim().to_owned()).filter(|text| !text.is_empty());
        }
        self.fault(Diagnostic::at(node.span, format!("`{what}` is text for people, in quotes where it is a number")));
        None
    }
}

/// Why a word cannot name a step, an axis, a parameter, a part or a pipeline.
fn bad_name(name: &str) -> Option<&'static str> {
    let fits = |c: char| c.is_alphanumeric() || c == '_' || c == '-';
    if name.is_empty() {
        Some("it is empty")
    } else if !name.chars().all(fits) {
        Some("use letters, digits, `-` and `_`")
    } else {
        None
    }
}
