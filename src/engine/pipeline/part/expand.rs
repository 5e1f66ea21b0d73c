//! Parts written out: every use becomes the steps of its part, under full names.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde_json::Value;

use super::super::axis::Axis;
use super::super::include::Texts;
use super::super::node::{Data, Key, Node, Word};
use super::super::overrides::Late;
use super::super::reader::Reader;
use super::super::step::Step;
use super::super::substitute::{filled, mentioned, parted, value_of};
use super::compose::{Asked, Scope};
use super::late::LateValues;
use super::library::{Library, Uses};
use super::substitution::{Substitution, inside, outside};
use super::{INSIDE, KindCheck, Known, Part, PartText, Use, Used};
use crate::diagnostic::{Diagnostic, Origin, Source};

/// The most steps that parts may make: a part that uses others twice, and they others, grows without end.
const STEPS_LIMIT: usize = 100_000;

/// How deep parts may be nested.
const PARTS_DEEP: usize = 32;

/// The steps and axes of a pipeline after all parts have been written out.
#[derive(Debug, Default)]
pub struct Flat {
    /// Steps in the order of writing.
    pub steps: Vec<Step>,
    /// Axes of the pipeline, then those of parts.
    pub axes: Vec<Axis>,
    /// Groups of axes that are walked together.
    pub zips: Vec<Vec<Word>>,
    /// Axes that could not be read.
    pub unread_axes: BTreeSet<String>,
    /// The uses that were written out, each before those inside it.
    pub uses: Vec<Used>,
    /// What is to be held against the kinds of artefact that parts take.
    pub checks: Vec<KindCheck>,
    /// Names that the uses and axes of the pipeline mention.
    pub mentions: BTreeSet<String>,
}
/// The sections of a pipeline that parts are written out into.
#[derive(Debug)]
pub struct Sections {
    /// Its axes as written.
    pub axes: Vec<(Key, Node)>,
    /// Axes that are walked together.
    pub zip: Option<Node>,
    /// Its steps as written.
    pub steps: Vec<(Key, Node)>,
}

/// Writes out the parts of one pipeline.
pub struct Expansion<'e> {
    /// The parts that are known.
    pub library: Library<'e>,
    /// Values of the command line.
    late: LateValues,
    /// Values of the pipeline's parameters.
    pub values: &'e BTreeMap<String, Value>,
    /// Parameters of the pipeline that have no value, which has been reported.
    unknown: BTreeSet<&'e str>,
    /// By number of a part: which outputs somebody reads.
    pub read: BTreeMap<usize, BTreeSet<String>>,
    /// What has been made.
    pub flat: Flat,
}

impl<'e> Expansion<'e> {
    /// Nothing is written out yet.
    pub fn new(texts: &'e mut Texts, shipped: &'static [PartText], values: &'e BTreeMap<String, Value>) -> Self {
        Self {
            library: Library::new(texts, shipped),
            late: LateValues::new(Vec::new()),
            values,
            unknown: BTreeSet::new(),
            read: BTreeMap::new(),
            flat: Flat::default(),
        }
    }

    /// With values of the command line for what parts make.
    #[must_use]
    pub fn late(self, late: Vec<Late>) -> Self {
        Self { late: LateValues::new(late), ..self }
    }

    /// With parameters of the pipeline whose value could not be read, which has been reported.
    #[must_use]
    pub fn unknown(self, names: impl Iterator<Item = &'e str>) -> Self {
        Self { unknown: names.filter(|name| !self.values.contains_key(*name)).collect(), ..self }
    }

    /// Writes out a pipeline: its axes, groups of axes and steps.
    pub fn pipeline(&mut self, sections: Sections, known: &Known, reader: &mut Reader) {
        let Sections { axes, zip, steps } = sections;
        let nodes = axes.iter().map(|(_, node)| node);
        let with = steps.iter().filter(|(_, node)| node.get("use").is_some()).filter_map(|(_, node)| node.get("with"));
        let mut names = Vec::new();
        nodes.chain(with).for_each(|node| mentioned(node, &mut names));
        self.flat.mentions = names.into_iter().map(|(name, _)| name).collect();
        let uses = self.library.uses(&steps, known, reader);
        let asked = Asked::default();
        let output = |step: &str, port: &str| asked.output(&uses, "", step, port);
        let own = BTreeSet::new();
        let scope = Scope { prefix: "", inputs: None, axes: &own, over: &[], part: "", output: &output };
        for (key, node) in axes {
            let by_parameters = mentions_any(&node);
            self.axis(&key, node, by_parameters, &scope, reader);
        }
        let before = reader.fault_count();
        self.flat.zips = zip.map(|node| reader.zips(&node)).unwrap_or_default();
        reader.zips_unread = reader.fault_count() > before;
        self.steps(steps, &uses, &scope, &mut Vec::new(), reader);
        self.note_read(asked);
        let steps: Vec<&str> = self.flat.steps.iter().map(|step| step.name.text.as_str()).collect();
        let axes: Vec<&str> = self.flat.axes.iter().map(|axis| axis.name.text.as_str()).collect();
        self.late.check(&steps, &axes, reader);
    }

    fn note_read(&mut self, asked: Asked) {
        for (number, port) in asked.into_inner() {
            self.read.entry(number).or_default().insert(port);
        }
    }

    /// Steps as they are written: those of their own, and those that stand for a part.
    fn steps(
        &mut self,
        steps: Vec<(Key, Node)>,
        uses: &Uses,
        scope: &Scope,
        stack: &mut Vec<usize>,
        reader: &mut Reader,
    ) {
        self.flat.steps.reserve_exact(steps.len());
        for (key, mut node) in steps {
            let name = Word { span: key.span, text: inside(scope.prefix, &key.name) };
            self.late.put_into("steps", &name.text, &mut node, reader);
            if let Some(used) = uses.get(&key.name) {
                let Some(part) = used else {
                    reader.unread_step(name.text);
                    continue;
                };
                if let Some(one) = reader.used(name.clone(), &node) {
                    self.write_out(full(one, scope, reader), part.number, stack, reader);
                } else {
                    reader.unread_step(name.text);
                }
                continue;
            }
            match reader.step(name.clone(), &mut node) {
                Some(step) => {
                    let step = full_step(step, scope, reader);
                    self.flat.steps.push(step);
                }
                None => reader.unread_step(name.text),
            }
        }
    }

    /// Writes out the steps of one use of a part.
    fn write_out(&mut self, used: Use, number: usize, stack: &mut Vec<usize>, reader: &mut Reader) {
        let Some(part) = self.library.part(number).cloned() else { return };
        if let Some(fault) = self.too_deep(&used, number, stack) {
            reader.unread_step(used.name.text);
            reader.fault(fault);
            return;
        }
        let prefix: Arc<str> = format!("{}{INSIDE}", used.name.text).into();
        let source = self.copy_source(&part, &used, prefix.clone());
        let axes: BTreeSet<String> = part.axes.iter().map(|(key, _)| key.name.clone()).collect();
        let before = reader.fault_count();
        let mut filling =
            Substitution { args: BTreeMap::new(), axes: &axes, prefix: &prefix, part: &part.name, source };
        self.give(&part, &used, &mut filling, reader);
        let inputs = self.feed(&part, &used, reader);
        let is_whole = reader.fault_count() == before && used.unread_inputs.is_empty();
        let outs = self.library.outs(number, reader);
        self.flat.uses.push(Used {
            name: used.name.text.clone(),
            part: part.name.clone(),
            doc: part.interface.doc.clone(),
            digest: part.digest,
            outputs: outs.iter().map(|(name, to)| (name.clone(), outside(&prefix, to))).collect(),
        });
        if !is_whole {
            // Its steps would only repeat what has been reported.
            part.steps.iter().for_each(|(key, _)| reader.unread_step(inside(&prefix, &key.name)));
            outs.values().for_each(|to| reader.unread_step(inside(&prefix, &to.step)));
            return;
        }
        let uses = self.library.uses(&part.steps, &part.known, reader);
        let asked = Asked::default();
        let output = |step: &str, port: &str| asked.output(&uses, &prefix, step, port);
        let scope = Scope {
            prefix: &prefix,
            inputs: Some(&inputs),
            axes: &axes,
            over: &used.over,
            part: &part.name,
            output: &output,
        };
        for (key, node) in &part.axes {
            let by_parameters = mentions_any(node);
            let node = filling.node(node, reader);
            self.axis(&filling.key(key), node, by_parameters, &scope, reader);
        }
        if let Some(zip) = &part.zip {
            let node = filling.node(zip, reader);
            for group in reader.zips(&node) {
                let group = group.into_iter().map(|word| scope.axis(word, reader)).collect();
                self.flat.zips.push(group);
            }
        }
        let before = reader.fault_count();
        let steps: Vec<(Key, Node)> =
            part.steps.iter().map(|(key, node)| (filling.key(key), filling.node(node, reader))).collect();
        let made = self.flat.steps.len();
        let unfilled = reader.fault_count() > before;
        stack.push(number);
        self.steps(steps, &uses, &scope, stack, reader);
        stack.pop();
        if unfilled {
            self.flat.steps[made..].iter_mut().for_each(Step::mark_gaps);
        }
        self.note_read(asked);
    }

    fn too_deep(&self, used: &Use, number: usize, stack: &[usize]) -> Option<Diagnostic> {
        let name = |number: &usize| self.library.part(*number).map_or("", |part| part.name.as_str());
        let part = name(&number);
        if let Some(from) = stack.iter().position(|outer| *outer == number) {
            let ways: Vec<&str> = stack[from..].iter().skip(1).map(name).collect();
            let by = if ways.is_empty() { String::new() } else { format!(", by way of {}", ways.join(", ")) };
            let fault = Diagnostic::at(used.part.span, format!("part `{part}` uses itself{by}"));
            return Some(fault.hint("let it use a part that does not use it in turn"));
        }
        if stack.len() >= PARTS_DEEP {
            let message = format!("part `{part}` is nested {PARTS_DEEP} parts deep");
            return Some(Diagnostic::at(used.part.span, message).hint("use fewer parts in each other"));
        }
        if self.flat.steps.len() > STEPS_LIMIT {
            let message = format!("the parts of this pipeline make more than {STEPS_LIMIT} steps");
            return Some(Diagnostic::at(used.part.span, message).hint("let an axis repeat what is the same"));
        }
        None
    }

    /// The text of a part once more, so that every place in it knows which use it belongs to.
    fn copy_source(&mut self, part: &Part, used: &Use, prefix: Arc<str>) -> usize {
        let own = &self.library.texts.sources[part.place.source];
        let folder = match own.folder() {
            Some(folder) => folder.clone(),
            None => self.library.texts.folder(used.name.span),
        };
        let origin = Origin::Use { at: used.name.span, prefix, folder };
        let copy = Source { name: own.name.clone(), text: own.text.clone(), origin };
        self.library.texts.sources.push(copy);
        self.library.texts.sources.len() - 1
    }

    /// An axis of the pipeline or of a part, under its full name; `by_parameters`: whether parameters say its items.
    fn axis(&mut self, key: &Key, mut node: Node, by_parameters: bool, scope: &Scope, reader: &mut Reader) {
        let name = Word { span: key.span, text: inside(scope.prefix, &key.name) };
        self.late.put_into("axes", &name.text, &mut node, reader);
        if self.mentions_unknown(&node) {
            self.flat.unread_axes.insert(name.text);
            return;
        }
        let node = self.with_values(node, reader);
        match reader.axis(name.clone(), &node) {
            Some(mut axis) => {
                axis.by_parameters = by_parameters;
                axis.label.clone_from(&key.name);
                axis.from = axis.from.and_then(|from| scope.single(from, reader));
                self.flat.axes.push(axis);
            }
            None => drop(self.flat.unread_axes.insert(name.text)),
        }
    }

    /// Whether a value mentions a parameter of the pipeline that has no value.
    fn mentions_unknown(&self, node: &Node) -> bool {
        let mut names = Vec::new();
        mentioned(node, &mut names);
        names.iter().any(|(name, _)| self.unknown.contains(parted(name).0))
    }

    /// A declaration of an axis with the values of the pipeline's parameters.
    fn with_values(&self, node: Node, reader: &mut Reader) -> Node {
        match node.data {
            Data::Scalar(Value::String(ref text)) if text.contains("${") => {
                match filled(&node, &|name| value_of(self.values, name)) {
                    Ok(value) => Node::of_value(&value, node.span),
                    Err(faults) => {
                        for fault in faults {
                            reader.fault(fault.or_hint("an axis can mention parameters, and no other axis"));
                        }
                        node
                    }
                }
            }
            Data::Scalar(_) => node,
            Data::List(items) => {
                let items = items.into_iter().map(|item| self.with_values(item, reader)).collect();
                Node { data: Data::List(items), ..node }
            }
            Data::Map(entries) => {
                let entries = entries.into_iter().map(|(key, item)| (key, self.with_values(item, reader))).collect();
                Node { data: Data::Map(entries), ..node }
            }
        }
    }
}

/// Whether a declaration mentions a parameter.
fn mentions_any(node: &Node) -> bool {
    let mut names = Vec::new();
    mentioned(node, &mut names);
    !names.is_empty()
}

/// A use with full names.
fn full(mut one: Use, scope: &Scope, reader: &mut Reader) -> Use {
    one.over = scope.over(one.over, reader);
    for (port, input) in std::mem::take(&mut one.inputs) {
        let before = reader.fault_count();
        match scope.input(input, reader) {
            Some(input) => one.inputs.push((port, input)),
            // A fault in it has been reported; without one it is an optional input that is left out.
            None if reader.fault_count() > before => drop(one.unread_inputs.insert(port.text)),
            None => {}
        }
    }
    one
}

/// A step with full names.
fn full_step(mut step: Step, scope: &Scope, reader: &mut Reader) -> Step {
    step.over = scope.over(step.over, reader);
    let before = reader.fault_count();
    let inputs = std::mem::take(&mut step.inputs).into_iter();
    step.inputs = inputs.filter_map(|(port, input)| Some((port, scope.input(input, reader)?))).collect();
    if reader.fault_count() > before {
        (step.gaps.inputs, step.gaps.any) = (true, true);
    }
    if let Some(axes) = step.stream.as_mut().and_then(|stream| stream.axes.as_mut()) {
        *axes = std::mem::take(axes).into_iter().map(|axis| scope.axis(axis, reader)).collect();
    }
    step
}
