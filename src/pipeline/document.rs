//! The typed document: parameters, axes, steps and targets, each with its place in the text.

use serde_json::Value;

use super::node::{Data, Key, Node, Word};
use super::reference::{Reference, parse_reference};
use crate::diagnostic::Diagnostic;

/// A pipeline as written, after overrides; names are not yet resolved.
#[derive(Debug, Clone)]
pub struct Document {
    /// Its name, used for run folders.
    pub name: String,
    /// The pipeline seed.
    pub seed: u64,
    /// Values that `${name}` refers to.
    pub params: Vec<(Key, Node)>,
    /// Axes in the order of declaration.
    pub axes: Vec<Axis>,
    /// Steps in the order of declaration.
    pub steps: Vec<Step>,
    /// Steps to make; `None`: every step nobody reads.
    pub targets: Option<Vec<Word>>,
}

/// A named list over which steps fan out.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Its name.
    pub name: Word,
    /// Item names, unique, in order.
    pub items: Vec<String>,
    /// What `${axis}` stands for at each item.
    pub values: Vec<Value>,
    /// Whether its items enter the seed of a random stream.
    pub reseeds: bool,
}

/// A named use of a stage.
#[derive(Debug, Clone)]
pub struct Step {
    /// Its name.
    pub name: Word,
    /// The stage it uses.
    pub stage: Word,
    /// Its parameters.
    pub with: Option<Node>,
    /// Where its inputs come from, by port.
    pub inputs: Vec<(Word, Input)>,
    /// Axes it depends on besides those that follow from its inputs and parameters.
    pub over: Vec<Word>,
    /// Whether its outputs are kept on disk.
    pub keep: bool,
    /// Narrows or shares its random stream.
    pub stream: Option<Stream>,
}

/// What a port is fed with.
#[derive(Debug, Clone)]
pub enum Input {
    /// One output.
    Plain(Reference),
    /// One output, chosen by the item of an axis.
    By {
        /// The axis.
        axis: Word,
        /// The output for each item.
        cases: Vec<(Word, Reference)>,
    },
    /// The outputs at all items of some axes.
    Each {
        /// The output.
        reference: Reference,
        /// The axes gathered over, outermost first.
        over: Vec<Word>,
    },
}

impl Input {
    /// Every reference in it.
    pub fn references(&self) -> Vec<&Reference> {
        match self {
            Self::Plain(reference) | Self::Each { reference, .. } => vec![reference],
            Self::By { cases, .. } => cases.iter().map(|(_, reference)| reference).collect(),
        }
    }
}

/// The random stream of a step.
#[derive(Debug, Clone)]
pub struct Stream {
    /// Takes the place of the step's name in the seed material.
    pub label: Option<Word>,
    /// The reseeding axes whose items count; `None`: all the step depends on.
    pub axes: Option<Vec<Word>>,
}

/// Reads a document and collects everything that is wrong with its shape.
pub fn read(root: &Node, file_stem: &str, faults: &mut Vec<Diagnostic>) -> Option<Document> {
    let mut reader = Reader { faults };
    reader.check_numbers(root);
    let top = reader.map(root, "the pipeline", &["rockface", "name", "seed", "params", "axes", "steps", "targets"])?;
    reader.format_version(root, top);
    let document = Document {
        name: root
            .get("name")
            .and_then(|n| reader.identifier(n, "the name"))
            .map_or_else(|| file_stem.to_owned(), |w| w.text),
        seed: root.get("seed").map_or(0, |n| reader.seed(n)),
        params: root.get("params").and_then(|n| reader.any_map(n, "`params`")).map(<[_]>::to_vec).unwrap_or_default(),
        axes: reader.named(root, "axes", Reader::axis),
        steps: reader.named(root, "steps", Reader::step),
        targets: root.get("targets").map(|n| reader.some_words(n, "a step name")),
    };
    let no_steps =
        root.get("steps").map_or(Some(root.span), |n| n.entries().is_some_and(<[_]>::is_empty).then_some(n.span));
    if let Some(span) = no_steps {
        reader.fault(
            Diagnostic::at(span, "the pipeline has no `steps`")
                .hint("a small complete one is pipelines/quickstart.yaml"),
        );
    }
    Some(document)
}

struct Reader<'f> {
    faults: &'f mut Vec<Diagnostic>,
}

impl Reader<'_> {
    fn fault(&mut self, diagnostic: Diagnostic) {
        self.faults.push(diagnostic);
    }

    /// Numbers such as `017`, of which nobody can say whether the zero counts.
    fn check_numbers(&mut self, node: &Node) {
        match &node.data {
            Data::List(items) => items.iter().for_each(|item| self.check_numbers(item)),
            Data::Map(entries) => entries.iter().for_each(|(_, item)| self.check_numbers(item)),
            Data::Scalar(_) if node.has_leading_zero() => {
                let message = format!("`{}` has a zero before its first digit", node.written);
                let hint = "write the number without it, or put the whole in quotes if it is text";
                self.fault(Diagnostic::at(node.span, message).hint(hint));
            }
            Data::Scalar(_) => {}
        }
    }

    fn expected(&mut self, node: &Node, what: &str) {
        if node.has_leading_zero() {
            return; // Told of already.
        }
        self.fault(Diagnostic::at(node.span, format!("expected {what}, found {}", node.describe())));
    }

    fn any_map<'n>(&mut self, node: &'n Node, what: &str) -> Option<&'n [(Key, Node)]> {
        let entries = node.entries();
        if entries.is_none() {
            self.expected(node, &format!("{what} to be a map"));
        }
        entries
    }

    /// A map with known keys.
    fn map<'n>(&mut self, node: &'n Node, what: &str, known: &[&str]) -> Option<&'n [(Key, Node)]> {
        let entries = self.any_map(node, what)?;
        for (key, _) in entries.iter().filter(|(key, _)| !known.contains(&key.name.as_str())) {
            self.fault(
                Diagnostic::at(key.span, format!("unknown key `{}` in {what}", key.name))
                    .suggest(&key.name, known.iter().copied()),
            );
        }
        Some(entries)
    }

    fn format_version(&mut self, root: &Node, top: &[(Key, Node)]) {
        match root.get("rockface") {
            Some(Node { data: Data::Scalar(Value::Number(n)), .. }) if n.as_u64() == Some(1) => {}
            Some(node) => self.fault(
                Diagnostic::at(node.span, format!("pipeline format {} is not known to this rockface", node.to_value()))
                    .hint("this version reads `rockface: 1`"),
            ),
            None => {
                let span = top.first().map_or(root.span, |(key, _)| key.span);
                self.fault(
                    Diagnostic::at(span, "the format version is missing").hint("begin the file with `rockface: 1`"),
                );
            }
        }
    }

    fn named<T>(&mut self, root: &Node, section: &str, read: fn(&mut Self, Word, &Node) -> Option<T>) -> Vec<T> {
        let Some(node) = root.get(section) else { return Vec::new() };
        let Some(entries) = self.any_map(node, &format!("`{section}`")) else { return Vec::new() };
        let named = entries.iter().filter_map(|(key, node)| {
            let word = Word { span: key.span, text: key.name.clone() };
            if let Some(bad) = bad_name(&key.name) {
                self.fault(Diagnostic::at(key.span, format!("`{}` cannot be a name: {bad}", key.name)));
                return None;
            }
            read(self, word, node)
        });
        named.collect()
    }

    fn identifier(&mut self, node: &Node, what: &str) -> Option<Word> {
        let word = self.word(node, what)?;
        match bad_name(&word.text) {
            None => Some(word),
            Some(bad) => {
                self.fault(Diagnostic::at(word.span, format!("{what} `{}` will not do: {bad}", word.text)));
                None
            }
        }
    }

    fn word(&mut self, node: &Node, what: &str) -> Option<Word> {
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

    fn words(&mut self, node: &Node, what: &str) -> Vec<Word> {
        let words: Vec<Word> = match &node.data {
            Data::List(items) => items.iter().filter_map(|item| self.word(item, what)).collect(),
            _ => self.word(node, &format!("{what} or a list of them")).into_iter().collect(),
        };
        for (index, word) in words.iter().enumerate() {
            if words[..index].iter().any(|earlier| earlier.text == word.text) {
                self.fault(Diagnostic::at(word.span, format!("`{}` is named twice", word.text)).hint("name it once"));
            }
        }
        words
    }

    fn some_words(&mut self, node: &Node, what: &str) -> Vec<Word> {
        if matches!(&node.data, Data::List(items) if items.is_empty()) {
            self.fault(
                Diagnostic::at(node.span, format!("this list is empty; {what} is needed"))
                    .hint("name at least one, or remove the line"),
            );
        }
        self.words(node, what)
    }

    fn seed(&mut self, node: &Node) -> u64 {
        let seed = if let Data::Scalar(value) = &node.data { value.as_u64() } else { None };
        if seed.is_none() {
            self.expected(node, "the seed to be a whole number, zero or greater");
        }
        seed.unwrap_or(0)
    }

    fn flag(&mut self, node: Option<&Node>, default: bool) -> bool {
        match node.map(|n| (&n.data, n)) {
            None => default,
            Some((Data::Scalar(Value::Bool(flag)), _)) => *flag,
            Some((_, node)) => {
                self.expected(node, "true or false");
                default
            }
        }
    }

    fn axis(&mut self, name: Word, node: &Node) -> Option<Axis> {
        self.map(node, &format!("axis `{}`", name.text), &["items", "count", "values", "reseeds"])?;
        let forms = ["items", "count", "values"].map(|form| node.get(form).map(|n| (form, n)));
        let given: Vec<_> = forms.into_iter().flatten().collect();
        let [(form, list)] = given[..] else {
            self.fault(
                Diagnostic::at(
                    name.span,
                    format!("axis `{}` needs exactly one of `items`, `count` and `values`", name.text),
                )
                .hint("for example `items: [pre, post]`, `count: 50` or `values: [0.6, 0.8]`"),
            );
            return None;
        };
        let (items, values) = match form {
            "count" => self.count(list)?,
            _ => self.items(list, &name)?,
        };
        let reseeds = self.flag(node.get("reseeds"), form != "values");
        Some(Axis { name, items, values, reseeds })
    }

    fn count(&mut self, node: &Node) -> Option<(Vec<String>, Vec<Value>)> {
        let count = if let Data::Scalar(value) = &node.data { value.as_u64() } else { None };
        let Some(count @ 1..=1_000_000) = count else {
            self.expected(node, "a count from 1 to 1000000");
            return None;
        };
        Some(((0..count).map(|i| i.to_string()).collect(), (0..count).map(Value::from).collect()))
    }

    fn items(&mut self, node: &Node, axis: &Word) -> Option<(Vec<String>, Vec<Value>)> {
        let Data::List(list) = &node.data else {
            self.expected(node, "a list");
            return None;
        };
        if list.is_empty() {
            self.fault(Diagnostic::at(node.span, format!("axis `{}` has no items", axis.text)));
            return None;
        }
        let mut items: Vec<String> = Vec::with_capacity(list.len());
        for node in list {
            let item = self.word(node, "a name, a number or true/false")?.text;
            if item.is_empty() || item.contains(['/', '\\', ',', '=', '[', ']', '\0']) {
                self.fault(Diagnostic::at(
                    node.span,
                    format!("`{item}` cannot be an item: an item is not empty and has none of / \\ , = [ ]"),
                ));
                return None;
            }
            if items.contains(&item) {
                self.fault(Diagnostic::at(node.span, format!("`{item}` occurs twice on axis `{}`", axis.text)));
                return None;
            }
            items.push(item);
        }
        let values: Vec<Value> = list.iter().map(Node::to_value).collect();
        self.check_equal_numbers(list, &values, axis);
        Some((items, values))
    }

    /// One number written in two ways would be one point with two names.
    fn check_equal_numbers(&mut self, list: &[Node], values: &[Value], axis: &Word) {
        for (index, value) in values.iter().enumerate() {
            let number = value.as_f64();
            let twin = values[..index].iter().position(|earlier| number.is_some() && earlier.as_f64() == number);
            if let Some(twin) = twin {
                let (here, there) = (&list[index].written, &list[twin].written);
                let message = format!("`{here}` is the same number as `{there}` on axis `{}`", axis.text);
                self.fault(Diagnostic::at(list[index].span, message).hint("leave one out, or put both in quotes"));
            }
        }
    }

    fn step(&mut self, name: Word, node: &Node) -> Option<Step> {
        let what = format!("step `{}`", name.text);
        self.map(node, &what, &["stage", "with", "in", "over", "keep", "stream"])?;
        let Some(stage) = node.get("stage") else {
            self.fault(
                Diagnostic::at(name.span, format!("{what} names no `stage`")).hint("`rockface stages` lists them"),
            );
            return None;
        };
        let stage = self.word(stage, "the name of a stage")?;
        let with = node.get("with").filter(|n| self.any_map(n, "`with`").is_some()).cloned();
        let inputs = node.get("in").and_then(|n| self.any_map(n, "`in`")).unwrap_or_default();
        let inputs = inputs
            .iter()
            .filter_map(|(key, node)| Some((Word { span: key.span, text: key.name.clone() }, self.input(node)?)))
            .collect();
        let over = node.get("over").map(|n| self.words(n, "an axis")).unwrap_or_default();
        let keep = self.flag(node.get("keep"), true);
        let stream = node.get("stream").and_then(|n| self.stream(n));
        Some(Step { name, stage, with, inputs, over, keep, stream })
    }

    fn stream(&mut self, node: &Node) -> Option<Stream> {
        self.map(node, "`stream`", &["label", "axes"])?;
        let label = node.get("label").and_then(|n| self.word(n, "a label"));
        let axes = node.get("axes").map(|n| self.words(n, "an axis"));
        Some(Stream { label, axes })
    }

    fn input(&mut self, node: &Node) -> Option<Input> {
        match &node.data {
            Data::Scalar(Value::String(_)) => self.reference(node).map(Input::Plain),
            Data::Map(_) if node.get("each").is_some() => self.each(node),
            Data::Map(entries) if node.get("by").is_some() => self.by(node, entries),
            _ => {
                self.fault(
                    Diagnostic::at(
                        node.span,
                        format!("expected where the input comes from, found {}", node.describe()),
                    )
                    .hint("one of: step.port · {by: axis, item: step.port, …} · {each: step.port, over: [axis]}"),
                );
                None
            }
        }
    }

    fn each(&mut self, node: &Node) -> Option<Input> {
        self.map(node, "a gathered input", &["each", "over"])?;
        let reference = self.reference(node.get("each")?)?;
        let Some(over) = node.get("over") else {
            self.fault(
                Diagnostic::at(node.span, "a gathered input needs `over`")
                    .hint("for example {each: noise.features, over: [replicate]}"),
            );
            return None;
        };
        Some(Input::Each { reference, over: self.some_words(over, "an axis") })
    }

    fn by(&mut self, node: &Node, entries: &[(Key, Node)]) -> Option<Input> {
        let axis = self.word(node.get("by")?, "an axis")?;
        let cases = entries.iter().filter(|(key, _)| key.name != "by");
        let cases = cases
            .map(|(key, node)| Some((Word { span: key.span, text: key.name.clone() }, self.reference(node)?)))
            .collect::<Option<Vec<_>>>()?;
        Some(Input::By { axis, cases })
    }

    fn reference(&mut self, node: &Node) -> Option<Reference> {
        let parsed = node.text().ok_or_else(|| format!("expected step.port, found {}", node.describe()));
        match parsed.and_then(|text| parse_reference(text, node.span)) {
            Ok(reference) => Some(reference),
            Err(message) => {
                self.fault(
                    Diagnostic::at(node.span, message)
                        .hint("write step.port, or \"step.port[axis=item]\" in quotes for one point"),
                );
                None
            }
        }
    }
}

/// Why a word cannot name a step, an axis or a pipeline.
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
