//! Parts: a chain of steps that is written once and used many times.
//!
//! A part is declared under `parts:`, in a file of its own, or comes with the program. A step that says `use:` stands for the
//! steps of the part, whose names begin with its own: `before/noisy`. [`expand`] writes them out before anything else looks at
//! the pipeline, so that plans, keys and runs know only steps.

mod check;
mod compose;
mod declare;
mod expand;
mod given;
mod late;
mod library;
mod substitution;

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use rockface_cache::Digest;
pub use rockface_core::PartText;
use rockface_core::artefact::Kind;

use super::include::Texts;
use super::input::Input;
use super::node::{Key, Node, Word};
use super::parameter::Declared;
use super::reader::Reader;
pub use super::reference::INSIDE;
use super::reference::Reference;
use crate::diagnostic::{Diagnostic, Span};

pub use declare::KEYS as PART_KEYS;
pub use expand::{Expansion, Flat, Sections};

/// What the inputs of a part are called inside it: `in.name`.
pub const IN: &str = "in";

/// A part as it is declared.
#[derive(Debug)]
pub struct Part {
    /// What messages call it.
    pub name: String,
    /// What a user has to know of it.
    pub interface: Interface,
    /// Its outputs: by name, what they are inside.
    pub outputs: Vec<(Word, Reference)>,
    /// Axes of its own.
    pub axes: Vec<(Key, Node)>,
    /// Axes that are walked together.
    pub zip: Option<Node>,
    /// The steps inside as they are written, not read yet: what they mean depends on the parameters of a use.
    pub steps: Vec<(Key, Node)>,
    /// The parts it may use by name.
    pub known: Rc<Known>,
    /// Where its name stands; its text is the whole one of this place.
    pub place: Span,
    /// The BLAKE3 of its text, where it has one of its own: it stands in a file, or comes with the program.
    pub digest: Option<Digest>,
}

/// What a user has to know of a part.
#[derive(Debug, Clone, Default)]
pub struct Interface {
    /// What it is about.
    pub doc: String,
    /// Its parameters, filled in and checked.
    pub params: Vec<Declared>,
    /// What has to be fed into it from outside.
    pub inputs: Vec<PartInput>,
    /// The names of its outputs.
    pub outputs: Vec<String>,
}

/// An input of a part.
#[derive(Debug, Clone)]
pub struct PartInput {
    /// The name that a use feeds under `in`, and that steps inside read as `in.name`.
    pub name: Word,
    /// The kinds of artefact it takes.
    pub kinds: Vec<Kind>,
    /// Whether a use may leave it out.
    pub optional: bool,
    /// What it is about.
    pub doc: String,
}

/// The parts of a file or pipeline by name, each with its number.
pub type Known = BTreeMap<String, usize>;

/// A step that stands for the steps of a part.
#[derive(Debug, Clone)]
pub struct Use {
    /// The name of the step, which stands before the names of the steps inside.
    pub name: Word,
    /// The part: its name, or the path of its file.
    pub part: Word,
    /// Values for its parameters.
    pub with: Vec<(Key, Node)>,
    /// What its inputs are fed with.
    pub inputs: Vec<(Word, Input)>,
    /// Inputs that could not be read, which has been reported.
    pub unread_inputs: BTreeSet<String>,
    /// Axes that all its steps depend on.
    pub over: Vec<Word>,
}

/// A use that has been written out, for drawings and lists.
#[derive(Debug, Clone)]
pub struct Used {
    /// The name of the step that uses it, with those of the uses around it.
    pub name: String,
    /// The name of the part.
    pub part: String,
    /// What the part is about.
    pub doc: String,
    /// The BLAKE3 of the part's text, where it has one of its own.
    pub digest: Option<Digest>,
    /// Its outputs: by name, what stands behind them under full names.
    pub outputs: BTreeMap<String, Reference>,
}

/// Something fed into a part, to be held against the kinds of artefact that it takes.
#[derive(Debug, Clone)]
pub struct KindCheck {
    /// The name of the part.
    pub part: String,
    /// The input of the part.
    pub input: PartInput,
    /// What it is fed with.
    pub given: Vec<Reference>,
}

/// The keys of a step that uses a part.
pub const USE_KEYS: &[&str] = &["use", "with", "in", "over"];

impl Reader<'_> {
    /// A step that uses a part.
    pub fn used(&mut self, name: Word, node: &Node) -> Option<Use> {
        let what = format!("step `{}`", name.text);
        if node.get("stage").is_some() {
            let message = format!("{what} says both `use` and `stage`");
            self.fault(Diagnostic::at(name.span, message).hint("it is a use of a part, or a step of its own"));
            return None;
        }
        let known = [USE_KEYS, &["title", "doc"]].concat();
        self.map(node, &what, &known)?;
        let part = self.word(node.get("use")?, "the name of a part or the path of its file");
        let with = node.get("with").and_then(|n| self.any_map(n, "`with`")).map(<[_]>::to_vec).unwrap_or_default();
        let (inputs, _) = node.get("in").map_or((Vec::new(), false), |n| self.inputs(n));
        let written = node.get("in").and_then(Node::entries).unwrap_or_default().iter().map(|(key, _)| &key.name);
        let unread_inputs =
            written.filter(|name| inputs.iter().all(|(port, _)| port.text != **name)).cloned().collect();
        let over = node.get("over").map(|n| self.words(n, "an axis")).unwrap_or_default();
        Some(Use { name, part: part?, with, inputs, unread_inputs, over })
    }
}

impl Used {
    /// What stands behind an output, as points and messages write it: `use/step.port[axis=item]`.
    pub fn behind(&self, output: &str) -> Option<String> {
        let Reference { step, port, picks, .. } = self.outputs.get(output)?;
        let label = |axis: &str| axis.rsplit(INSIDE).next().unwrap_or_default().to_owned();
        let picks: Vec<String> = picks.iter().map(|(axis, item)| format!("{}={item}", label(&axis.text))).collect();
        let picks = if picks.is_empty() { String::new() } else { format!("[{}]", picks.join(",")) };
        Some(format!("{step}.{port}{picks}"))
    }
}

impl PartInput {
    /// The kinds it takes, for messages.
    pub fn kind_words(&self) -> String {
        self.kinds.iter().map(|kind| kind.word()).collect::<Vec<_>>().join(" or ")
    }
}

/// What has to be known to use a part; `texts` begins with the one that names it.
pub fn interface(
    name: &str,
    texts: &mut Texts,
    shipped: &'static [PartText],
    faults: &mut Vec<Diagnostic>,
) -> Option<Interface> {
    let mut reader = Reader::new(faults);
    let values = BTreeMap::new();
    Expansion::new(texts, shipped, &values).library.interface(name, &mut reader)
}

/// All texts anywhere in a value, with their places.
fn texts<'n>(node: &'n Node, found: &mut Vec<(&'n str, Span)>) {
    if let Some(text) = node.text() {
        found.push((text, node.span));
    }
    match &node.data {
        super::node::Data::Scalar(_) => {}
        super::node::Data::List(items) => items.iter().for_each(|item| texts(item, found)),
        super::node::Data::Map(entries) => entries.iter().for_each(|(_, item)| texts(item, found)),
    }
}

/// The names that a part gives to its own steps and axes.
fn own_names(entries: &[(Key, Node)]) -> BTreeSet<&str> {
    entries.iter().map(|(key, _)| key.name.as_str()).collect()
}
