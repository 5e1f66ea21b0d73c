//! The typed document: parameters, axes, steps and targets, each with its place in the text.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;

use super::axis::Axis;
use super::include::Texts;
use super::input::Input;
use super::log_level::LogLevel;
use super::node::{Data, Key, Node, Word};
use super::overrides::Late;
use super::parameter::{Declared, is_declared};
use super::part::{Expansion, Flat, KindCheck, PartText, Used};
use crate::diagnostic::{Diagnostic, nearest};

/// A pipeline as written, after overrides; names are not yet resolved.
#[derive(Debug, Clone)]
pub struct Document {
    /// Its name, used for run folders.
    pub name: String,
    /// The pipeline seed.
    pub seed: u64,
    /// Values that `${name}` refers to.
    pub params: Vec<(Key, Node)>,
    /// Those of them that are declared with their type.
    pub declared: Vec<Declared>,
    /// Axes in the order of declaration.
    pub axes: Vec<Axis>,
    /// Groups of axes that are walked together instead of crossed.
    pub zips: Vec<Vec<Word>>,
    /// Steps in the order of declaration.
    pub steps: Vec<Step>,
    /// Steps to make; `None`: every step nobody reads.
    pub targets: Option<Vec<Word>>,
    /// How much the log of a run shows of steps that do not say it themselves; `None`: it depends on their instances.
    pub log: Option<LogLevel>,
    /// The uses of parts that have been written out into the steps.
    pub uses: Vec<Used>,
    /// What is to be held against the kinds of artefact that parts take.
    pub checks: Vec<KindCheck>,
    /// Names that uses of parts and axes mention.
    pub mentions: BTreeSet<String>,
    /// What is declared and could not be read.
    pub unread: Unread,
}

/// Declarations that could not be read, which is told of: what refers to one of them is not wrong for that.
#[derive(Debug, Clone, Default)]
pub struct Unread {
    /// Names of steps.
    pub steps: BTreeSet<String>,
    /// Names of axes.
    pub axes: BTreeSet<String>,
    /// Whether it is open which axes are walked together.
    pub zips: bool,
}

/// A named use of a stage.
#[derive(Debug, Clone)]
pub struct Step {
    /// Its name.
    pub name: Word,
    /// The stage it uses.
    pub stage: Word,
    /// Its parameters.
    pub with: Option<Arc<Node>>,
    /// Where its inputs come from, by port.
    pub inputs: Vec<(Word, Input)>,
    /// Axes it depends on besides those that follow from its inputs and parameters.
    pub over: Vec<Word>,
    /// Whether its outputs are kept on disk.
    pub keep: bool,
    /// Narrows or shares its random stream.
    pub stream: Option<Stream>,
    /// How long one go may take.
    pub timeout: Option<Duration>,
    /// How often it is tried again after a failure.
    pub retries: u32,
    /// How much the log of a run shows of it.
    pub log: Option<LogLevel>,
    /// Its heading in reports.
    pub title: Option<String>,
    /// What is said of it there.
    pub doc: Option<String>,
    /// What could not be read of it.
    pub gaps: Gaps,
}

/// The parts of a step that could not be read whole, which is told of: that something is lacking there is no other fault.
#[derive(Debug, Clone, Copy, Default)]
pub struct Gaps {
    /// Its parameters.
    pub with: bool,
    /// Its inputs.
    pub inputs: bool,
    /// Any part of it.
    pub any: bool,
}

impl Step {
    /// Notes that none of it could be read whole.
    pub fn mark_gaps(&mut self) {
        self.gaps = Gaps { with: true, inputs: true, any: true };
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

/// The keys of a pipeline.
pub const TOP: &[&str] =
    &["rockface", "name", "seed", "include", "parts", "params", "axes", "zip", "steps", "targets", "log"];

/// The keys of a step.
pub const STEP: &[&str] =
    &["stage", "with", "in", "over", "keep", "stream", "timeout", "retries", "log", "title", "doc"];

/// What is read besides the text of a pipeline: other texts, the parts of the program, and values for what parts make.
pub type Beside<'t> = (&'t mut Texts, &'static [PartText], Vec<Late>);

/// Reads a document and collects everything that is wrong with its shape; `None` where that leaves open what names it
/// declares. Axes and steps are taken out of the tree one by one: it may be large.
pub fn read(
    root: &mut Node,
    file_stem: &str,
    (texts, shipped, late): Beside,
    faults: &mut Vec<Diagnostic>,
) -> Option<Document> {
    let mut reader = Reader::new(faults);
    reader.check_numbers(root);
    let names_known = tells_names(root);
    let no_steps =
        root.get("steps").map_or(Some(root.span), |n| n.entries().is_some_and(<[_]>::is_empty).then_some(n.span));
    let unknown = |(key, _): &(Key, Node)| (!TOP.contains(&key.name.as_str())).then(|| key.name.clone());
    let top_keys: Vec<String> = root.entries().unwrap_or_default().iter().filter_map(unknown).collect();
    if matches!(root.data, Data::Scalar(Value::Null)) {
        let hint = "begin it with `rockface: 1`; `rockface init` makes a pipeline to start from";
        reader.fault(Diagnostic::at(root.span, "the pipeline is empty").hint(hint));
        return None;
    }
    let top = reader.map(root, "the pipeline", TOP)?;
    reader.format_version(root, top);
    reader.seed = root.get("seed").map_or(0, |n| reader.seed(n));
    let (params, declared) = reader.params(root);
    let axes = reader.named(root, "axes");
    let axis_names: Vec<&str> = axes.iter().map(|(key, _)| key.name.as_str()).collect();
    let (values, _) = super::values::resolve(&params, &axis_names);
    let steps = reader.named(root, "steps");
    let targets = root.get("targets").map(|n| reader.some_words(n, "a step name"));
    let mut expansion = Expansion::new(texts, shipped, late, &values);
    let known = expansion.declare(root.take("parts"), &mut reader);
    expansion.pipeline((axes, root.take("zip"), steps), &known, &mut reader);
    if reader.faults.is_empty() {
        reader.faults.extend(expansion.unused(&known, targets.as_deref()));
    }
    let Flat { steps, axes, zips, unread_axes, uses, checks, mentions } = expansion.flat;
    let document = Document {
        name: root
            .get("name")
            .and_then(|n| reader.identifier(n, "the name"))
            .map_or_else(|| file_stem.to_owned(), |w| w.text),
        seed: reader.seed,
        params,
        declared,
        axes,
        zips,
        steps,
        targets,
        log: root.get("log").and_then(|n| reader.log_level(n)),
        uses,
        checks,
        mentions,
        unread: Unread {
            steps: std::mem::take(&mut reader.unread_steps),
            axes: unread_axes.into_iter().chain(std::mem::take(&mut reader.unread_names)).collect(),
            zips: reader.zips_unread,
        },
    };
    // A misspelt `steps` is one fault.
    let is_misspelt = top_keys.iter().any(|key| crate::diagnostic::nearest(key, TOP) == Some("steps"));
    if let Some(span) = no_steps.filter(|_| !is_misspelt) {
        reader.fault(
            Diagnostic::at(span, "the pipeline has no `steps`")
                .hint("a small complete one is pipelines/quickstart.yaml"),
        );
    }
    names_known.then_some(document)
}

/// Whether it can be told what names a pipeline declares: it is of this format, and no section of names is unreadable or
/// behind an unknown key.
fn tells_names(root: &Node) -> bool {
    const SECTIONS: [&str; 3] = ["params", "axes", "steps"];
    let known = |(key, node): &(Key, Node)| match key.name.as_str() {
        "rockface" => node.to_value().as_u64() == Some(1),
        name if SECTIONS.contains(&name) => node.entries().is_some(),
        name => TOP.contains(&name) || is_aside(name, node),
    };
    let steps = root.get("steps").and_then(Node::entries);
    steps.is_some_and(|steps| !steps.is_empty()) && root.entries().is_some_and(|top| top.iter().all(known))
}

/// Whether an unknown key of a pipeline stands for none that names anything.
fn is_aside(name: &str, node: &Node) -> bool {
    let near = nearest(name, TOP);
    matches!(node.data, Data::Scalar(_)) && near.is_none_or(|near| matches!(near, "rockface" | "name" | "seed" | "log"))
}

/// Reads one section of a document after the other.
pub struct Reader<'f> {
    faults: &'f mut Vec<Diagnostic>,
    /// The pipeline seed.
    pub seed: u64,
    /// Whether there is a number that cannot be taken.
    bad_numbers: bool,
    /// Items and values of counted and drawn axes so far.
    pub drawn: u64,
    /// Names of steps that could not be read.
    unread_steps: BTreeSet<String>,
    /// Names that could not be read of what may be an axis.
    unread_names: BTreeSet<String>,
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

    /// Adds a fault.
    pub fn fault(&mut self, diagnostic: Diagnostic) {
        self.faults.push(diagnostic);
    }

    /// Numbers such as `017`, of which nobody can say whether the zero counts, and such as `.nan`, which are none.
    fn check_numbers(&mut self, node: &Node) {
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
            return; // Told of already.
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

    /// What a section declares, each under a name that can be one.
    fn named(&mut self, root: &mut Node, section: &str) -> Vec<(Key, Node)> {
        let Some(node) = root.take(section) else { return Vec::new() };
        if self.any_map(&node, &format!("`{section}`")).is_none() {
            return Vec::new();
        }
        let mut entries = node.into_entries();
        entries.retain(|(key, _)| {
            let sound = self.check_name(key);
            if !sound && section == "steps" {
                self.unread_steps.insert(key.name.clone());
            } else if !sound {
                self.unread_names.insert(key.name.clone());
            }
            sound
        });
        entries
    }

    /// The values of the parameters, and the declarations of those that have one.
    fn params(&mut self, root: &Node) -> (Vec<(Key, Node)>, Vec<Declared>) {
        let entries = root.get("params").and_then(|n| self.any_map(n, "`params`")).unwrap_or_default();
        let (mut params, mut all) = (Vec::with_capacity(entries.len()), Vec::new());
        for (key, node) in entries {
            if !is_declared(node) {
                params.push((key.clone(), node.clone()));
                continue;
            }
            let Some(declared) = self.declared(key, node) else {
                // What mentions it is not wrong for that.
                params.push((key.clone(), Node::made(node.span, Data::Scalar(Value::Null))));
                continue;
            };
            if declared.default.is_none() && node.get("default").is_none() {
                let message = format!("parameter `{}` has no value", key.name);
                let fault = Diagnostic::at(key.span, message);
                self.fault(fault.hint(format!("give one by `--set params.{}=…`, or a `default`", key.name)));
            }
            let null = || Node::made(node.span, Data::Scalar(Value::Null));
            params.push((key.clone(), declared.default.clone().unwrap_or_else(null)));
            all.push(declared);
        }
        (params, all)
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

    fn seed(&mut self, node: &Node) -> u64 {
        let seed = if let Data::Scalar(value) = &node.data { value.as_u64() } else { None };
        if seed.is_none() {
            self.expected(node, &format!("the seed to be a whole number from 0 to {}", u64::MAX));
        }
        seed.unwrap_or(0)
    }

    /// `true` or `false`.
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

    /// A step of its own.
    pub fn step(&mut self, name: Word, node: &mut Node) -> Option<Step> {
        let before = self.faults.len();
        let what = format!("step `{}`", name.text);
        if self.lacks_colon(&what, node) {
            return None;
        }
        self.map(node, &what, STEP)?;
        let strange_key = self.faults.len() > before;
        let stage = self.stage(&name, node);
        let bad_with =
            |with: &Node| self.any_map(with, "`with`").is_none() || self.bad_numbers && with.holds_bad_number();
        let gap_in_with = node.get("with").map_or(strange_key, bad_with);
        let (inputs, gap_in_inputs) = node.get("in").map_or((Vec::new(), strange_key), |n| self.inputs(n));
        let over = node.get("over").map(|n| self.words(n, "an axis")).unwrap_or_default();
        let keep = self.flag(node.get("keep"), true);
        let stream = node.get("stream").and_then(|n| self.stream(n));
        let timeout = node.get("timeout").and_then(|n| self.duration(n));
        let retries = node.get("retries").map_or(0, |n| self.retries(n));
        let log = node.get("log").and_then(|n| self.log_level(n));
        let title = node.get("title").and_then(|n| self.sentence(n, "title"));
        let doc = node.get("doc").and_then(|n| self.sentence(n, "doc"));
        let with = node.take("with").filter(|with| with.entries().is_some()).map(Arc::new);
        let any = gap_in_with || gap_in_inputs || self.faults.len() > before;
        let gaps = Gaps { with: gap_in_with, inputs: gap_in_inputs, any };
        Some(Step { name, stage: stage?, with, inputs, over, keep, stream, timeout, retries, log, title, doc, gaps })
    }

    /// Reports a key such as `stage rasterise-dem`, which is `stage: rasterise-dem` without its colon.
    fn lacks_colon(&mut self, what: &str, node: &Node) -> bool {
        let split = |(key, _): &(Key, Node)| {
            let (word, rest) = key.name.split_once(' ')?;
            STEP.contains(&word).then(|| (key.span, word.to_owned(), rest.trim().to_owned()))
        };
        let Some((span, word, rest)) = node.entries().and_then(|entries| entries.iter().find_map(split)) else {
            return false;
        };
        let fault = Diagnostic::at(span, format!("a colon is missing after `{word}` in {what}"));
        self.fault(fault.hint(format!("write `{word}: {rest}`")));
        true
    }

    /// Text for people.
    fn sentence(&mut self, node: &Node, what: &str) -> Option<String> {
        if let Data::Scalar(Value::String(text)) = &node.data {
            return Some(text.trim().to_owned()).filter(|text| !text.is_empty());
        }
        self.fault(Diagnostic::at(node.span, format!("`{what}` is text for people, in quotes where it is a number")));
        None
    }

    fn stage(&mut self, name: &Word, node: &Node) -> Option<Word> {
        let Some(stage) = node.get("stage") else {
            let fault = Diagnostic::at(name.span, format!("step `{}` names no `stage`", name.text));
            self.fault(fault.hint("`rockface stages` lists them; a step that stands for a part says `use`"));
            return None;
        };
        self.word(stage, "the name of a stage")
    }

    /// The inputs of a step, and whether some could not be read.
    pub fn inputs(&mut self, node: &Node) -> (Vec<(Word, Input)>, bool) {
        let Some(entries) = self.any_map(node, "`in`") else { return (Vec::new(), true) };
        let mut inputs = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            inputs.extend(self.input(node).map(|input| (Word { span: key.span, text: key.name.clone() }, input)));
        }
        let gap = inputs.len() < entries.len();
        (inputs, gap)
    }

    fn log_level(&mut self, node: &Node) -> Option<LogLevel> {
        let level = node.text().and_then(LogLevel::of_word);
        if level.is_none() {
            self.expected(node, "full, brief or none");
        }
        level
    }

    fn duration(&mut self, node: &Node) -> Option<Duration> {
        let text = node.text().map(humantime::parse_duration);
        match text {
            Some(Ok(duration)) if !duration.is_zero() => return Some(duration),
            _ => self.expected(node, "a time with its unit, such as 90s, 15min or 2h"),
        }
        None
    }

    fn retries(&mut self, node: &Node) -> u32 {
        let count = node.to_value().as_u64().filter(|count| *count <= 100);
        if count.is_none() {
            self.expected(node, "a count of retries from 0 to 100");
        }
        count.unwrap_or(0) as u32
    }

    fn stream(&mut self, node: &Node) -> Option<Stream> {
        self.map(node, "`stream`", &["label", "axes"])?;
        let said = |key| node.get(key).filter(|n| !matches!(n.data, Data::Scalar(Value::Null)));
        let label = said("label").and_then(|n| self.word(n, "a label"));
        let axes = said("axes").map(|n| self.words(n, "an axis"));
        Some(Stream { label, axes })
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
