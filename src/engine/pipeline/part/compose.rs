//! Inputs of a part's steps, in the names of the pipeline: what a use feeds takes the place of `in.name`.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

use super::super::input::Input;
use super::super::node::Word;
use super::super::reader::Reader;
use super::super::reference::Reference;
use super::library::Uses;
use super::substitution::outside;
use super::{IN, INSIDE};
use crate::diagnostic::Diagnostic;

/// The names that are in force inside one use of a part, or at the top of the pipeline.
pub struct Scope<'s> {
    /// What full names begin with: empty at the top, else the name of the use and `/`.
    pub prefix: &'s str,
    /// What the inputs of the part are fed with; `None` for one that is left out. At the top there are none.
    pub inputs: Option<&'s BTreeMap<String, Option<Input>>>,
    /// Axes of the part's own.
    pub axes: &'s BTreeSet<String>,
    /// Axes that all steps depend on.
    pub over: &'s [Word],
    /// What messages call the part.
    pub part: &'s str,
    /// What an output of a use is, both by their names here: a step and its port, or what is wrong.
    pub output: &'s dyn Fn(&str, &str) -> Output,
}

/// What stands behind `step.port`.
pub enum Output {
    /// It is no use of a part.
    Step,
    /// A use that could not be read.
    Unread,
    /// This output of a step, with full names.
    Of(Reference),
    /// The part has no such output: its name, and those it has.
    Missing(String, Vec<String>),
}

/// Outputs that somebody has asked for: the number of the part, and their names.
#[derive(Default)]
pub struct Asked(RefCell<Vec<(usize, String)>>);

impl Asked {
    /// What stands behind `step.port` where these uses are known; notes that it was asked for.
    pub fn output(&self, uses: &Uses, prefix: &str, step: &str, port: &str) -> Output {
        let Some(used) = uses.get(step) else { return Output::Step };
        let Some(part) = used else { return Output::Unread };
        let Some(to) = part.outs.get(port) else {
            return Output::Missing(part.name.clone(), part.outs.keys().cloned().collect());
        };
        self.0.borrow_mut().push((part.number, port.to_owned()));
        Output::Of(outside(&format!("{prefix}{step}{INSIDE}"), to))
    }

    /// All that were asked for.
    pub fn into_inner(self) -> Vec<(usize, String)> {
        self.0.into_inner()
    }
}

impl Scope<'_> {
    /// Whether it is the top of the pipeline.
    fn is_top(&self) -> bool {
        self.inputs.is_none()
    }

    /// An input of a step or use, with full names; `None` for an optional one that this use leaves out.
    pub fn input(&self, input: Input, reader: &mut Reader) -> Option<Input> {
        match input {
            Input::Plain(reference) => match self.fed(&reference) {
                None => Some(Input::Plain(self.reference(reference, reader))),
                Some(given) => self.picked(given.clone()?, &reference, reader),
            },
            Input::By { axis, cases } => {
                let axis = self.axis(axis, reader);
                let cases = cases.into_iter().map(|(item, to)| Some((item, self.single(to, reader)?)));
                Some(Input::By { axis, cases: cases.collect::<Option<_>>()? })
            }
            Input::Each { reference, over, paired } => {
                let over = over.into_iter().map(|axis| self.axis(axis, reader)).collect();
                // Without the list, where that is optional and left out, all items are gathered.
                let paired = paired.and_then(|list| self.list_of_pairs(*list, reader)).map(Box::new);
                Some(Input::Each { reference: self.single(reference, reader)?, over, paired })
            }
            Input::Chain { reference, axis, first } => {
                let axis = self.axis(axis, reader);
                let first = first.map(|first| self.single(*first, reader));
                let first = if let Some(first) = first { Some(Box::new(first?)) } else { None };
                Some(Input::Chain { reference: Box::new(self.single(*reference, reader)?), axis, first })
            }
        }
    }

    fn list_of_pairs(&self, list: Input, reader: &mut Reader) -> Option<Input> {
        if let Input::By { cases, .. } = &list
            && let Some((_, left_out)) = cases.iter().find(|(_, to)| matches!(self.fed(to), Some(None)))
        {
            let message =
                format!("part `{}` chooses pairs from `{IN}.{}`, which is left out here", self.part, left_out.port);
            reader.fault(Diagnostic::at(left_out.span, message).hint("give it where the part is used"));
            return None;
        }
        let written = list.references().first().map(|reference| (*reference).clone());
        match (self.input(list, reader)?, written) {
            (given @ (Input::Each { .. } | Input::Chain { .. }), Some(written)) => {
                self.refuse(&given, &written, reader);
                None
            }
            (given, _) => Some(given),
        }
    }

    /// What a use feeds where a reference is `in.name`: nothing in it where that is optional and left out.
    fn fed(&self, reference: &Reference) -> Option<&Option<Input>> {
        self.inputs.filter(|_| reference.step == IN)?.get(&reference.port)
    }

    /// What is fed, at the items that the part picks of it.
    fn picked(&self, given: Input, reference: &Reference, reader: &mut Reader) -> Option<Input> {
        let picks: Vec<_> =
            reference.picks.iter().map(|(axis, item)| (self.axis(axis.clone(), reader), item.clone())).collect();
        let add =
            |to: Reference| Reference { picks: to.picks.into_iter().chain(picks.iter().cloned()).collect(), ..to };
        Some(match given {
            given if picks.is_empty() => given,
            Input::Plain(to) => Input::Plain(add(to)),
            Input::By { axis, cases } => {
                Input::By { axis, cases: cases.into_iter().map(|(item, to)| (item, add(to))).collect() }
            }
            other => {
                self.refuse(&other, reference, reader);
                return None;
            }
        })
    }

    /// A reference that has to be one output.
    pub fn single(&self, reference: Reference, reader: &mut Reader) -> Option<Reference> {
        match self.fed(&reference) {
            None => Some(self.reference(reference, reader)),
            Some(None) => None,
            Some(Some(given)) => match self.picked(given.clone(), &reference, reader)? {
                Input::Plain(to) => Some(to),
                other => {
                    self.refuse(&other, &reference, reader);
                    None
                }
            },
        }
    }

    fn refuse(&self, given: &Input, reference: &Reference, reader: &mut Reader) {
        let form = match given {
            Input::By { .. } => "a choice by an axis",
            Input::Each { .. } => "a gathered list",
            Input::Chain { .. } => "an output at the item before",
            Input::Plain(_) => "one output",
        };
        let message =
            format!("part `{}` chooses or gathers from `{IN}.{}`, which is {form} here", self.part, reference.port);
        let fault = Diagnostic::at(reference.span, message);
        let fault = fault.hint("give one output there: let a step before the use choose or gather");
        reader.fault(match given.references().first().map(|given| given.span) {
            Some(span) => fault.also(span, "it is given here"),
            None => fault,
        });
    }

    /// A reference with full names.
    pub fn reference(&self, reference: Reference, reader: &mut Reader) -> Reference {
        if self.inputs.is_some() && reference.step == IN {
            let known = self.inputs.into_iter().flat_map(BTreeMap::keys).map(String::as_str);
            let message = format!("part `{}` has no input `{}`", self.part, reference.port);
            reader.fault(Diagnostic::at(reference.span, message).suggest(&reference.port, known));
            return reference;
        }
        let output = (self.output)(&reference.step, &reference.port);
        if self.is_top() && matches!(output, Output::Step | Output::Unread) {
            return reference; // Names at the top are full ones.
        }
        let picks: Vec<(Word, String)> =
            reference.picks.into_iter().map(|(axis, item)| (self.axis(axis, reader), item)).collect();
        let Reference { span, step, port, .. } = reference;
        match output {
            // The step could not be read, which has been reported; its readers are not reported.
            Output::Step | Output::Unread => Reference { span, step: format!("{}{step}", self.prefix), port, picks },
            Output::Of(to) => {
                let inner = to.picks.into_iter().map(|(axis, item)| (Word { span, ..axis }, item));
                Reference { span, step: to.step, port: to.port, picks: inner.chain(picks).collect() }
            }
            Output::Missing(part, known) => {
                let message = format!("step `{}{step}` uses part `{part}`, which has no output `{port}`", self.prefix);
                let fault = Diagnostic::at(span, message).suggest(&port, known.iter().map(String::as_str));
                let inside = format!("a step inside is read by its full name, such as `{step}{INSIDE}name.port`");
                reader.fault(if self.is_top() { fault.or_hint(inside) } else { fault });
                reader.unread_step(format!("{}{step}", self.prefix));
                Reference { span, step: format!("{}{step}", self.prefix), port, picks }
            }
        }
    }

    /// An axis under its full name. Inside a part only its own have a name: all others flow through.
    pub fn axis(&self, word: Word, reader: &mut Reader) -> Word {
        if self.is_top() {
            return word;
        }
        if self.axes.contains(&word.text) {
            return Word { text: format!("{}{}", self.prefix, word.text), ..word };
        }
        let message = format!("part `{}` has no axis `{}`", self.part, word.text);
        let fault = Diagnostic::at(word.span, message).suggest(&word.text, self.axes.iter().map(String::as_str));
        reader.fault(
            fault.or_hint("axes of the pipeline come in by `in`, `with` and `over` of the use, and need no name here"),
        );
        word
    }

    /// Axes that a step names under `over`, and those of the use.
    pub fn over(&self, own: Vec<Word>, reader: &mut Reader) -> Vec<Word> {
        let mut over: Vec<Word> = own.into_iter().map(|word| self.axis(word, reader)).collect();
        for word in self.over {
            if over.iter().all(|known| known.text != word.text) {
                over.push(word.clone());
            }
        }
        over
    }
}
