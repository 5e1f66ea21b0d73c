//! What feeds the input ports of a step, as it is written.

use serde_json::Value;

use super::axis::PREV;
use super::node::{Data, Key, Node, Word};
use super::reader::Reader;
use super::reference::{Reference, parse_reference};
use crate::diagnostic::Diagnostic;

/// What a port is fed with.
#[derive(Debug, Clone)]
pub enum Input {
    /// One output, at the items of the step itself except where the reference picks others.
    Plain(Reference),
    /// One output, chosen by the item of an axis.
    By {
        /// The axis whose item chooses.
        axis: Word,
        /// The output for each item.
        cases: Vec<(Word, Reference)>,
    },
    /// The outputs at all items of some axes.
    Each {
        /// The output that is read.
        reference: Reference,
        /// The axes gathered over, outermost first.
        over: Vec<Word>,
        /// The list of pairs, a plain output or a choice, that tells which items are read: the step's own and those in a pair with it.
        paired: Option<Box<Input>>,
    },
    /// The output at the item before, and something else at the first item.
    Chain {
        /// The output; its pick of `prev` is taken out. Boxed, as most inputs are plain.
        reference: Box<Reference>,
        /// The axis it goes back on.
        axis: Word,
        /// What the first item gets; `None`: nothing.
        first: Option<Box<Reference>>,
    },
}

impl Input {
    /// Every reference in it.
    pub fn references(&self) -> Vec<&Reference> {
        match self {
            Self::Plain(reference) => vec![reference],
            Self::Each { reference, paired, .. } => {
                std::iter::once(reference).chain(paired.iter().flat_map(|list| list.references())).collect()
            }
            Self::By { cases, .. } => cases.iter().map(|(_, reference)| reference).collect(),
            Self::Chain { reference, first, .. } => std::iter::once(&**reference).chain(first.as_deref()).collect(),
        }
    }

    /// The axis whose item chooses what is read, or goes back.
    pub fn choosing_axis(&self) -> Option<&Word> {
        match self {
            Self::By { axis, .. } | Self::Chain { axis, .. } => Some(axis),
            Self::Each { paired, .. } => paired.as_deref()?.choosing_axis(),
            Self::Plain(_) => None,
        }
    }

    /// The references whose steps must be known before: all but the one that goes back along an axis.
    pub fn forward_references(&self) -> Vec<&Reference> {
        match self {
            Self::Chain { first, .. } => first.as_deref().into_iter().collect(),
            _ => self.references(),
        }
    }
}

/// How inputs are written.
const FORMS: &str = "one of: step.port · {by: axis, item: step.port, …} · {each: step.port, over: [axis]} · \
                     {each: step.port, over: [axis], paired: step.port} · {from: \"step.port[axis=prev]\", first: step.port}";

impl Reader<'_> {
    /// One entry of `in`.
    pub fn input(&mut self, node: &Node) -> Option<Input> {
        match &node.data {
            Data::Scalar(Value::String(_)) => self.forward(node).map(Input::Plain),
            Data::Map(_) if node.get("each").is_some() => self.each(node),
            Data::Map(_) if node.get("from").is_some() => self.chain(node),
            Data::Map(entries) if node.get("by").is_some() => self.by(node, entries),
            _ => {
                let message = format!("expected where the input comes from, found {}", node.describe());
                self.fault(Diagnostic::at(node.span, message).hint(FORMS));
                None
            }
        }
    }

    fn each(&mut self, node: &Node) -> Option<Input> {
        self.map(node, "a gathered input", &["each", "over", "paired"])?;
        let reference = self.forward(node.get("each")?);
        let Some(over) = node.get("over") else {
            self.fault(
                Diagnostic::at(node.span, "a gathered input needs `over`")
                    .hint("for example {each: noise.features, over: [replicate]}"),
            );
            return None;
        };
        let over = self.some_words(over, "an axis");
        let paired = match node.get("paired") {
            Some(list) => Some(Box::new(self.list_of_pairs(list)?)),
            None => None,
        };
        Some(Input::Each { reference: reference?, over, paired })
    }

    fn list_of_pairs(&mut self, node: &Node) -> Option<Input> {
        match self.input(node)? {
            list @ (Input::Plain(_) | Input::By { .. }) => Some(list),
            Input::Each { .. } | Input::Chain { .. } => {
                let message = "`paired` is one list of pairs: step.port, or {by: axis, item: step.port, …}";
                self.fault(Diagnostic::at(node.span, message));
                None
            }
        }
    }

    fn by(&mut self, node: &Node, entries: &[(Key, Node)]) -> Option<Input> {
        let axis = self.word(node.get("by")?, "an axis");
        let cases = entries.iter().filter(|(key, _)| key.name != "by");
        let cases: Vec<_> = cases
            .map(|(key, node)| Some((Word { span: key.span, text: key.name.clone() }, self.forward(node)?)))
            .collect();
        Some(Input::By { axis: axis?, cases: cases.into_iter().collect::<Option<_>>()? })
    }

    fn chain(&mut self, node: &Node) -> Option<Input> {
        self.map(node, "an input from the item before", &["from", "first"])?;
        let from = node.get("from")?;
        let mut reference = self.reference(from)?;
        let Some(at) = reference.picks.iter().position(|(_, item)| item == PREV) else {
            let message = "`from` is for an output at the item before";
            self.fault(Diagnostic::at(from.span, message).hint("write \"step.port[axis=prev]\", or step.port alone"));
            return None;
        };
        let (axis, _) = reference.picks.remove(at);
        if let Some((axis, _)) = reference.picks.iter().find(|(_, item)| item == PREV) {
            let message = format!("`prev` goes back along one axis, `{}` is the second", axis.text);
            self.fault(Diagnostic::at(from.span, message).hint("zip the two axes and name one of them"));
            return None;
        }
        let first = match node.get("first") {
            None => {
                self.fault(
                    Diagnostic::at(node.span, "it is not said what the first item gets")
                        .hint("add `first: step.port`, or `first: null` where the port is optional"),
                );
                return None;
            }
            Some(Node { data: Data::Scalar(Value::Null), .. }) => None,
            Some(first) => Some(Box::new(self.forward(first)?)),
        };
        Some(Input::Chain { reference: Box::new(reference), axis, first })
    }

    /// A reference that does not go back along an axis.
    fn forward(&mut self, node: &Node) -> Option<Reference> {
        let reference = self.reference(node)?;
        if reference.picks.iter().any(|(_, item)| item == PREV) {
            let message = format!("`{}` has no item before the first", node.text().unwrap_or_default());
            let hint = "say what the first item gets: {from: \"step.port[axis=prev]\", first: step.port}";
            self.fault(Diagnostic::at(node.span, message).hint(hint));
            return None;
        }
        Some(reference)
    }

    /// Reads `step.port` with its picks; `None` where it cannot be parsed, which is reported.
    pub fn reference(&mut self, node: &Node) -> Option<Reference> {
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
