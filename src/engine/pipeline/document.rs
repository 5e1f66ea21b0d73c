//! The typed document: parameters, axes, steps and targets, each with its place in the text.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::axis::Axis;
use super::include::Texts;
use super::log_level::LogLevel;
use super::node::{Data, Key, Node, Word};
use super::overrides::{Late, Written};
use super::parameter::{Declared, is_declared};
use super::part::{Expansion, Flat, KindCheck, PartText, Sections, Used};
use super::reader::{Reader, TOP};
use super::step::Step;
use super::substitute::parted;
use crate::diagnostic::{Diagnostic, nearest};

/// A pipeline as written, after overrides; names are not yet resolved.
#[derive(Debug, Clone)]
pub struct Document {
    /// Its name, used for run folders.
    pub name: String,
    /// The seed of the pipeline, from which random streams follow.
    pub seed: u64,
    /// Values that `${name}` refers to.
    pub params: Vec<(Key, Node)>,
    /// Those of them that are declared with their type.
    pub declared: Vec<Declared>,
    /// The values of the parameters, each put into those that refer to it.
    pub values: BTreeMap<String, Value>,
    /// Why some parameters have no value.
    pub value_faults: Vec<Diagnostic>,
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
    /// Names that the files mention: values of the command line may have taken the place of that.
    pub written_mentions: BTreeSet<String>,
    /// What is declared and could not be read.
    pub unread: Unread,
}

/// Declarations that failed to parse; already reported, so references to them are not reported again.
#[derive(Debug, Clone, Default)]
pub struct Unread {
    /// Steps that could not be read.
    pub steps: BTreeSet<String>,
    /// Axes that could not be read.
    pub axes: BTreeSet<String>,
    /// Whether it is open which axes are walked together.
    pub zips: bool,
}

/// What is read besides the text of a pipeline.
pub struct Beside<'t> {
    /// Files that it includes or uses.
    pub texts: &'t mut Texts,
    /// The parts that come with the program.
    pub shipped: &'static [PartText],
    /// What its files say without the values of the command line.
    pub written: Written,
    /// Values of the command line for what parts make.
    pub late: Vec<Late>,
}

/// Reads a document and collects everything that is wrong with its shape; `None` where that leaves open what names it
/// declares. Axes and steps are taken out of the tree one by one: it may be large.
pub fn read(root: &mut Node, file_stem: &str, beside: Beside, faults: &mut Vec<Diagnostic>) -> Option<Document> {
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
    if let Some(fault) = held_part(root, beside.texts) {
        reader.fault(fault);
        return None;
    }
    let top = reader.map(root, "the pipeline", TOP)?;
    reader.format_version(root, top);
    reader.seed = root.get("seed").map_or(0, |n| reader.seed(n));
    let Params { written: params, declared, unread } = reader.params(root, &beside.written.needed);
    let axes = reader.named(root, "axes");
    let axis_names: Vec<&str> = axes.iter().map(|(key, _)| key.name.as_str()).collect();
    let (values, value_faults) = super::values::resolve(&params, &axis_names, &unread);
    let steps = reader.named(root, "steps");
    let targets = root.get("targets").map(|n| reader.some_words(n, "a step name"));
    let names = params.iter().map(|(key, _)| key.name.as_str());
    let mut expansion = Expansion::new(beside.texts, beside.shipped, &values).late(beside.late).unknown(names);
    let known = expansion.library.declare(root.take("parts"), &mut reader);
    expansion.pipeline(Sections { axes, zip: root.take("zip"), steps }, &known, &mut reader);
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
        values,
        value_faults,
        axes,
        zips,
        steps,
        targets,
        log: root.get("log").and_then(|n| reader.log_level(n)),
        uses,
        checks,
        mentions,
        written_mentions: beside.written.mentions,
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

/// Whether the names that a pipeline declares are known: it is of this format, and no section of names is unreadable or
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

/// The fault of a file that holds a part and is read as a pipeline.
fn held_part(root: &Node, texts: &Texts) -> Option<Diagnostic> {
    let (key, name) = root.entries()?.iter().find(|(key, _)| key.name == "part")?;
    let message = format!("this file holds the part `{}`, and no pipeline", name.text()?);
    let file = texts.sources.get(key.span.source).map_or("parts/name.yaml", |source| source.name.as_str());
    let hint =
        format!("a step of a pipeline uses it: `mine: {{use: {file}}}`; `rockface parts {file}` shows what it takes");
    Some(Diagnostic::at(key.span, message).hint(hint))
}

/// Whether an unknown key of a pipeline stands for none that names anything.
fn is_aside(name: &str, node: &Node) -> bool {
    let near = nearest(name, TOP);
    matches!(node.data, Data::Scalar(_)) && near.is_none_or(|near| matches!(near, "rockface" | "name" | "seed" | "log"))
}

/// The parameters of a pipeline.
#[derive(Default)]
struct Params {
    /// Each with its value as written.
    written: Vec<(Key, Node)>,
    /// The declarations of those that have one.
    declared: Vec<Declared>,
    /// Names of those whose declaration or value is wrong, which has been reported.
    unread: BTreeSet<String>,
}

impl Reader<'_> {
    fn format_version(&mut self, root: &Node, top: &[(Key, Node)]) {
        match root.get("rockface") {
            Some(Node { data: Data::Scalar(Value::Number(n)), .. }) if n.as_u64() == Some(1) => {}
            Some(node) => self.fault(
                Diagnostic::at(node.span, format!("pipeline format {} is not known to this rockface", node.to_value()))
                    .hint("this version reads `rockface: 1`; later formats need a later rockface"),
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
        if let (Data::List(_), "steps") = (&node.data, section) {
            let fault = Diagnostic::at(node.span, "`steps` is a list, and steps have names");
            self.fault(fault.hint("write each step under its name, without a dash: `face: {stage: synthesise-face}`"));
            return Vec::new();
        }
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

    /// The parameters of the pipeline; `needed` are those for which `null` is no value.
    fn params(&mut self, root: &Node, needed: &BTreeSet<String>) -> Params {
        let entries = root.get("params").and_then(|n| self.any_map(n, "`params`")).unwrap_or_default();
        let mut all = Params::default();
        for (key, node) in entries {
            if !self.check_name(key) {
                // What mentions it is not wrong for that.
                self.unread_names.insert(parted(&key.name).0.to_owned());
            }
            if !is_declared(node) {
                if !self.check_keys(node) {
                    all.unread.insert(key.name.clone());
                }
                all.written.push((key.clone(), node.clone()));
                continue;
            }
            let before = self.faults.len();
            let null = Node::made(node.span, Data::Scalar(Value::Null));
            let Some(declared) = self.declared(key, node) else {
                // What mentions it is not wrong for that.
                all.unread.insert(key.name.clone());
                all.written.push((key.clone(), null));
                continue;
            };
            if declared.default.is_none() && node.get("default").is_none() {
                let message = format!("parameter `{}` has no value", key.name);
                let fault = Diagnostic::at(key.span, message);
                self.fault(fault.hint(format!("give one by `--set params.{}=…`, or a `default`", key.name)));
            }
            let emptied = declared.default.as_ref().filter(|default| default.to_value().is_null());
            let emptied = emptied.filter(|_| needed.contains(&key.name));
            if let Some(fault) = emptied.and_then(|default| declared.value_fault(&Value::Null, default.span)) {
                self.fault(fault.or_hint("write a value; an empty one stands for `null`"));
            }
            if self.faults.len() > before {
                all.unread.insert(key.name.clone());
            }
            all.written.push((key.clone(), declared.default.clone().unwrap_or(null)));
            all.declared.push(declared);
        }
        all
    }

    fn seed(&mut self, node: &Node) -> u64 {
        let seed = if let Data::Scalar(value) = &node.data { value.as_u64() } else { None };
        if seed.is_none() {
            self.expected(node, &format!("the seed to be a whole number from 0 to {}", u64::MAX));
        }
        seed.unwrap_or(0)
    }
}
