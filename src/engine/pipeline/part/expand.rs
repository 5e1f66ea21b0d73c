//! Parts written out: every use becomes the steps of its part, under full names.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;

use rockface_cache::Digest;
use serde_json::Value;

use super::super::axis::Axis;
use super::super::document::{Reader, Step};
use super::super::include::{Texts, check_format};
use super::super::input::Input;
use super::super::node::{Data, Key, Node, Word};
use super::super::overrides::Late;
use super::super::parameter::ValueKind;
use super::super::reference::Reference;
use super::super::substitute::{filled, mentioned, value_of};
use super::compose::{Output, Scope};
use super::declare::{FILE_KEYS, KEYS, is_path};
use super::substitution::{Substitution, inside};
use super::{INSIDE, Interface, KindCheck, Known, Part, PartText, Use, Used};
use crate::diagnostic::{Diagnostic, Origin, Source, Span};

/// The most steps that parts may make: a part that uses others twice, and they others, grows without end.
const STEPS_LIMIT: usize = 100_000;

/// How deep parts may lie in each other.
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

/// The outputs of a part by name, with steps and axes as they are called inside it.
type Outs = Rc<BTreeMap<String, Reference>>;

/// The entries of a section as they are written.
type Entries = Vec<(Key, Node)>;

/// Writes out the parts of one pipeline.
pub struct Expansion<'e> {
    texts: &'e mut Texts,
    shipped: &'static [PartText],
    /// Values for what parts make, and whether each has found its place.
    late: Vec<(Late, bool)>,
    /// Values of the pipeline's parameters.
    values: &'e BTreeMap<String, Value>,
    /// By number: a part, or nothing where it could not be read.
    parts: Vec<Option<Rc<Part>>>,
    /// By number: the outputs, once they are asked for.
    outs: Vec<Option<Outs>>,
    /// Parts that were read from files, and those of the program, by path or name.
    files: BTreeMap<String, usize>,
    /// By number: which outputs somebody reads.
    read: BTreeMap<usize, BTreeSet<String>>,
    /// What has been made.
    pub flat: Flat,
}

/// The uses among the steps of a part or pipeline: the number of the part, its name and its outputs.
type Uses = BTreeMap<String, Option<(usize, String, Outs)>>;

impl<'e> Expansion<'e> {
    /// Nothing is written out yet.
    pub fn new(
        texts: &'e mut Texts,
        shipped: &'static [PartText],
        late: Vec<Late>,
        values: &'e BTreeMap<String, Value>,
    ) -> Self {
        Self {
            texts,
            shipped,
            late: late.into_iter().map(|late| (late, false)).collect(),
            values,
            parts: Vec::new(),
            outs: Vec::new(),
            files: BTreeMap::new(),
            read: BTreeMap::new(),
            flat: Flat::default(),
        }
    }

    /// The parts that a section `parts` declares.
    pub fn declare(&mut self, section: Option<Node>, reader: &mut Reader) -> Rc<Known> {
        let Some(section) = section else { return Rc::default() };
        if reader.any_map(&section, "`parts`").is_none() {
            return Rc::default();
        }
        let entries = section.into_entries();
        let mut known = Known::new();
        for (key, node) in &entries {
            reader.check_name(key);
            let number = match node.text() {
                // Another name for a file, or for one of the program.
                Some(text) => {
                    let word = Word { span: node.span, text: text.to_owned() };
                    self.find(&word, &Known::new(), reader)
                }
                None => Some(self.reserve()),
            };
            known.insert(key.name.clone(), number.unwrap_or_else(|| self.reserve()));
        }
        let known = Rc::new(known);
        for (key, mut node) in entries.into_iter().filter(|(_, node)| node.text().is_none()) {
            let name = Word { span: key.span, text: key.name };
            let part = reader.part(&name, &mut node, KEYS, known.clone());
            self.parts[known[&name.text]] = part.map(Rc::new);
        }
        known
    }

    /// What has to be known to use a part.
    pub fn interface(&mut self, name: &str, reader: &mut Reader) -> Option<Interface> {
        let word = Word { span: Span { source: 0, start: 0, end: name.len() }, text: name.to_owned() };
        let number = self.find(&word, &Known::new(), reader)?;
        self.parts[number].as_ref().map(|part| part.interface.clone())
    }

    fn reserve(&mut self) -> usize {
        self.parts.push(None);
        self.outs.push(None);
        self.parts.len() - 1
    }

    /// The part that a use names.
    fn find(&mut self, word: &Word, known: &Known, reader: &mut Reader) -> Option<usize> {
        if let Some(number) = known.get(&word.text) {
            return Some(*number);
        }
        let shipped = self.shipped.iter().find(|part| part.name == word.text);
        let key = match shipped {
            Some(part) => part.name.to_owned(),
            None if is_path(&word.text) => {
                let path = self.texts.folder(word.span).join(&word.text);
                path.canonicalize().unwrap_or(path).display().to_string()
            }
            None => {
                let fault = Diagnostic::at(word.span, format!("unknown part `{}`", word.text));
                let names = known.keys().map(String::as_str).chain(self.shipped.iter().map(|part| part.name));
                reader
                    .fault(fault.suggest(&word.text, names).or_hint("a file is named by its path, `parts/name.yaml`"));
                return None;
            }
        };
        if let Some(number) = self.files.get(&key) {
            return Some(*number);
        }
        let number = self.reserve();
        self.files.insert(key, number);
        match self.read(word, shipped) {
            Ok((mut tree, source)) => self.parts[number] = self.file_part(&mut tree, source, word, reader).map(Rc::new),
            Err(fault) => reader.fault(fault),
        }
        Some(number)
    }

    /// The tree of a part that stands in a text of its own, and the number of that text.
    fn read(&mut self, word: &Word, shipped: Option<&PartText>) -> Result<(Node, usize), Diagnostic> {
        let source = if let Some(part) = shipped {
            let recorded = self.texts.given.get(Path::new(part.name));
            let text = recorded.map_or(part.text, String::as_str);
            Source { name: part.name.to_owned(), text: text.into(), origin: Origin::Shipped }
        } else {
            let path = self.texts.folder(word.span).join(&word.text);
            let text = self.texts.read(&path).map_err(|fault| Diagnostic { span: Some(word.span), ..fault })?;
            Source::file(path.display().to_string(), &text, path.parent().unwrap_or(Path::new("")))
        };
        let (text, number) = (source.text.clone(), self.texts.sources.len());
        self.texts.sources.push(source);
        let tree = Node::parse(&text, number)?;
        check_format(&tree)?;
        Ok((tree, number))
    }

    /// The part that a file holds.
    fn file_part(&mut self, tree: &mut Node, source: usize, used: &Word, reader: &mut Reader) -> Option<Part> {
        let Some(name) = tree.get("part").cloned() else {
            let file = &self.texts.sources[source].name;
            let fault = Diagnostic::at(used.span, format!("`{file}` holds no part: it does not say `part: name`"));
            reader.fault(fault.hint("what is put together as a whole is named by `include`"));
            return None;
        };
        let name = reader.word(&name, "the name of the part")?;
        let section = tree.take("parts");
        let known = self.declare(section, reader);
        let part = reader.part(&name, tree, FILE_KEYS, known)?;
        let digest = Some(Digest::of(self.texts.sources[source].text.as_bytes()));
        // A part of the program is called as it is used.
        let is_shipped = matches!(self.texts.sources[source].origin, Origin::Shipped);
        let name = if is_shipped { used.text.clone() } else { part.name };
        Some(Part { name, digest, ..part })
    }

    /// The outputs of a part, by way of the parts inside it.
    fn outs(&mut self, number: usize, reader: &mut Reader) -> Outs {
        if let Some(outs) = &self.outs[number] {
            return outs.clone();
        }
        // A part that uses itself is told of where it is written out.
        self.outs[number] = Some(Outs::default());
        let Some(part) = self.parts[number].clone() else { return Outs::default() };
        let mut outs = BTreeMap::new();
        for (name, to) in &part.outputs {
            let inner = part.steps.iter().find(|(key, _)| key.name == to.step).and_then(|(_, node)| node.get("use"));
            let Some(word) = inner.and_then(|node| Some(Word { span: node.span, text: node.text()?.to_owned() }))
            else {
                outs.insert(name.text.clone(), to.clone());
                continue;
            };
            let Some(inner) = self.find(&word, &part.known, reader) else { continue };
            let found = self.outs(inner, reader);
            match found.get(&to.port) {
                Some(behind) => {
                    let prefix = format!("{}{INSIDE}", to.step);
                    let Reference { step, port, picks, .. } = outside(&prefix, behind);
                    let picks = picks.into_iter().chain(to.picks.iter().cloned()).collect();
                    outs.insert(name.text.clone(), Reference { span: to.span, step, port, picks });
                }
                None if self.parts[inner].is_none() || found.is_empty() => {}
                None => {
                    let fault = Diagnostic::at(to.span, format!("part `{}` has no output `{}`", word.text, to.port));
                    reader.fault(fault.suggest(&to.port, found.keys().map(String::as_str)));
                }
            }
        }
        let outs = Rc::new(outs);
        self.outs[number] = Some(outs.clone());
        outs
    }

    /// The uses among some steps.
    fn uses(&mut self, steps: &[(Key, Node)], known: &Known, reader: &mut Reader) -> Uses {
        let mut uses = Uses::new();
        for (key, node) in steps {
            let Some(named) = node.get("use") else { continue };
            let word = named.text().map(|text| Word { span: named.span, text: text.to_owned() });
            let number = word.and_then(|word| self.find(&word, known, reader));
            let number = number.filter(|number| self.parts[*number].is_some());
            let found = number.map(|number| {
                let name = self.parts[number].as_ref().map(|part| part.name.clone()).unwrap_or_default();
                (number, name, self.outs(number, reader))
            });
            if found.is_none() {
                reader.unread_step(key.name.clone());
            }
            uses.insert(key.name.clone(), found);
        }
        uses
    }

    /// Writes out a pipeline: its axes, groups of axes and steps.
    pub fn pipeline(
        &mut self,
        (axes, zips, steps): (Entries, Option<Node>, Entries),
        known: &Known,
        reader: &mut Reader,
    ) {
        let nodes = axes.iter().map(|(_, node)| node);
        let with = steps.iter().filter(|(_, node)| node.get("use").is_some()).filter_map(|(_, node)| node.get("with"));
        let mut names = Vec::new();
        nodes.chain(with).for_each(|node| mentioned(node, &mut names));
        self.flat.mentions = names.into_iter().map(|(name, _)| name).collect();
        let uses = self.uses(&steps, known, reader);
        let asked = RefCell::new(Vec::new());
        let output = |step: &str, port: &str| told_output(&uses, "", step, port, &asked);
        let own = BTreeSet::new();
        let scope = Scope { prefix: "", inputs: None, axes: &own, over: &[], part: "", output: &output };
        for (key, node) in axes {
            self.axis(&key, node, &scope, reader);
        }
        let before = reader.fault_count();
        self.flat.zips = zips.map(|node| reader.zips(&node)).unwrap_or_default();
        reader.zips_unread = reader.fault_count() > before;
        self.steps(steps, &uses, &scope, &mut Vec::new(), reader);
        self.note_read(asked.into_inner());
        self.check_late(reader);
    }

    fn note_read(&mut self, asked: Vec<(usize, String)>) {
        for (number, port) in asked {
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
        for (key, mut node) in steps {
            let name = Word { span: key.span, text: inside(scope.prefix, &key.name) };
            self.put_late("steps", &name.text, &mut node, reader);
            if let Some(used) = uses.get(&key.name) {
                let Some((number, _, _)) = used else {
                    reader.unread_step(name.text);
                    continue;
                };
                if let Some(one) = reader.used(name.clone(), &node) {
                    self.write_out(Self::full(one, scope, reader), *number, stack, reader);
                } else {
                    reader.unread_step(name.text);
                }
                continue;
            }
            match reader.step(name.clone(), &mut node) {
                Some(step) => {
                    let step = Self::full_step(step, scope, reader);
                    self.flat.steps.push(step);
                }
                None => reader.unread_step(name.text),
            }
        }
    }

    /// A use with full names.
    fn full(one: Use, scope: &Scope, reader: &mut Reader) -> Use {
        let over = scope.over(one.over, reader);
        let inputs = one.inputs.into_iter();
        let inputs = inputs.filter_map(|(port, input)| Some((port, scope.input(input, reader)?))).collect();
        Use { inputs, over, ..one }
    }

    /// A step with full names.
    fn full_step(mut step: Step, scope: &Scope, reader: &mut Reader) -> Step {
        step.over = scope.over(step.over, reader);
        let inputs = std::mem::take(&mut step.inputs).into_iter();
        step.inputs = inputs.filter_map(|(port, input)| Some((port, scope.input(input, reader)?))).collect();
        if let Some(axes) = step.stream.as_mut().and_then(|stream| stream.axes.as_mut()) {
            *axes = std::mem::take(axes).into_iter().map(|axis| scope.axis(axis, reader)).collect();
        }
        step
    }

    /// Writes out the steps of one use of a part.
    fn write_out(&mut self, used: Use, number: usize, stack: &mut Vec<usize>, reader: &mut Reader) {
        let Some(part) = self.parts[number].clone() else { return };
        if let Some(fault) = self.too_deep(&used, number, stack) {
            reader.unread_step(used.name.text);
            reader.fault(fault);
            return;
        }
        let prefix: Arc<str> = format!("{}{INSIDE}", used.name.text).into();
        let source = self.copy_source(&part, &used, prefix.clone());
        let axes: BTreeSet<String> = part.axes.iter().map(|(key, _)| key.name.clone()).collect();
        let (args, whole) = self.arguments(&part, &used, (&axes, &prefix, source), reader);
        let (inputs, fed) = self.inputs(&part, &used, reader);
        let outs = self.outs(number, reader);
        self.flat.uses.push(Used {
            name: used.name.text.clone(),
            part: part.name.clone(),
            doc: part.interface.doc.clone(),
            digest: part.digest,
            outputs: outs.iter().map(|(name, to)| (name.clone(), outside(&prefix, to))).collect(),
        });
        if !(whole && fed) {
            // Its steps would only repeat what has been told.
            part.steps.iter().for_each(|(key, _)| reader.unread_step(inside(&prefix, &key.name)));
            outs.values().for_each(|to| reader.unread_step(inside(&prefix, &to.step)));
            return;
        }
        let uses = self.uses(&part.steps, &part.known, reader);
        let asked = RefCell::new(Vec::new());
        let output = |step: &str, port: &str| told_output(&uses, &prefix, step, port, &asked);
        let scope = Scope {
            prefix: &prefix,
            inputs: Some(&inputs),
            axes: &axes,
            over: &used.over,
            part: &part.name,
            output: &output,
        };
        let filling = Substitution { args: &args, axes: &axes, prefix: &prefix, part: &part.name, source };
        for (key, node) in &part.axes {
            let node = filling.node(node, reader);
            self.axis(&filling.key(key), node, &scope, reader);
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
        self.note_read(asked.into_inner());
    }

    fn too_deep(&self, used: &Use, number: usize, stack: &[usize]) -> Option<Diagnostic> {
        let name = |number: &usize| self.parts[*number].as_ref().map_or("", |part| part.name.as_str());
        let part = name(&number);
        if let Some(from) = stack.iter().position(|outer| *outer == number) {
            let ways: Vec<&str> = stack[from..].iter().skip(1).map(name).collect();
            let by = if ways.is_empty() { String::new() } else { format!(", by way of {}", ways.join(", ")) };
            let fault = Diagnostic::at(used.part.span, format!("part `{part}` uses itself{by}"));
            return Some(fault.hint("let it use a part that does not use it in turn"));
        }
        if stack.len() >= PARTS_DEEP {
            let message = format!("part `{part}` lies {PARTS_DEEP} parts deep");
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
        let own = &self.texts.sources[part.place.source];
        let folder = match own.folder() {
            Some(folder) => folder.clone(),
            None => self.texts.folder(used.name.span),
        };
        let origin = Origin::Use { at: used.name.span, prefix, folder };
        let copy = Source { name: own.name.clone(), text: own.text.clone(), origin };
        self.texts.sources.push(copy);
        self.texts.sources.len() - 1
    }

    /// The values of a part's parameters, and whether all are there.
    fn arguments(
        &self,
        part: &Part,
        used: &Use,
        (axes, prefix, source): (&BTreeSet<String>, &str, usize),
        reader: &mut Reader,
    ) -> (BTreeMap<String, Node>, bool) {
        let before = reader.fault_count();
        let params = &part.interface.params;
        let mut args: BTreeMap<String, Node> = BTreeMap::new();
        for (key, node) in &used.with {
            let Some(param) = params.iter().find(|param| param.name.text == key.name) else {
                let fault = Diagnostic::at(key.span, format!("part `{}` has no parameter `{}`", part.name, key.name));
                reader.fault(fault.suggest(&key.name, params.iter().map(|param| param.name.text.as_str())));
                continue;
            };
            let node = self.known_values(node);
            if let Some(fault) = param.fault(&node) {
                reader.fault(fault);
            }
            let node = if param.kind == ValueKind::Path { self.full_path(node, source) } else { node };
            args.insert(key.name.clone(), node);
        }
        for param in params.iter().filter(|param| !used.with.iter().any(|(key, _)| key.name == param.name.text)) {
            if let Some(default) = &param.default {
                let filling = Substitution { args: &args, axes, prefix, part: &part.name, source };
                let default = filling.node(default, reader);
                args.insert(param.name.text.clone(), default);
            } else {
                let name = &param.name.text;
                let message =
                    format!("step `{}` does not say `{name}`, which part `{}` needs", used.name.text, part.name);
                let fault = Diagnostic::at(used.part.span, message).also(param.name.span, "it is declared here");
                reader.fault(if param.doc.is_empty() { fault } else { fault.hint(format!("`{name}`: {}", param.doc)) });
            }
        }
        (args, reader.fault_count() == before)
    }

    /// A value with the pipeline's own parameters put in, as far as all that it mentions are such.
    fn known_values(&self, node: &Node) -> Node {
        let mut names = Vec::new();
        mentioned(node, &mut names);
        if names.is_empty() || names.iter().any(|(name, _)| value_of(self.values, name).is_none()) {
            return node.clone();
        }
        match filled(node, &|name| value_of(self.values, name)) {
            // What it mentions may hold a `${…}` that is text.
            Ok(value) if !value.to_string().contains("${") => Node::of_value(&value, node.span),
            _ => node.clone(),
        }
    }

    /// A path as the part finds it: it is relative to the file in which it is written.
    fn full_path(&self, node: Node, source: usize) -> Node {
        let folder = self.texts.folder(node.span);
        let part_folder = self.texts.sources[source].folder();
        let Some(text) = node.text() else { return node };
        if part_folder == Some(&folder) || Path::new(text).is_absolute() || text.starts_with("${") {
            return node;
        }
        let full = std::path::absolute(folder.join(text)).unwrap_or_else(|_| folder.join(text));
        Node { data: Data::Scalar(Value::String(full.display().to_string())), ..node }
    }

    /// What the inputs of a part are fed with, and whether all that are needed are there.
    fn inputs(&mut self, part: &Part, used: &Use, reader: &mut Reader) -> (BTreeMap<String, Option<Input>>, bool) {
        let before = reader.fault_count();
        let declared = &part.interface.inputs;
        for (port, _) in &used.inputs {
            if !declared.iter().any(|input| input.name.text == port.text) {
                let fault = Diagnostic::at(port.span, format!("part `{}` has no input `{}`", part.name, port.text));
                reader.fault(fault.suggest(&port.text, declared.iter().map(|input| input.name.text.as_str())));
            }
        }
        let mut fed = BTreeMap::new();
        for input in declared {
            let given =
                used.inputs.iter().find(|(port, _)| port.text == input.name.text).map(|(_, given)| given.clone());
            if let Some(given) = &given {
                let given = given.references().into_iter().cloned().collect();
                self.flat.checks.push(KindCheck { part: part.name.clone(), input: input.clone(), given });
            } else if !input.optional {
                let (name, kinds) = (&input.name.text, input.kind_words());
                let message = format!(
                    "step `{}` does not feed `{name}` ({kinds}), which part `{}` reads",
                    used.name.text, part.name
                );
                let fault = Diagnostic::at(used.part.span, message).also(input.name.span, "it is declared here");
                reader.fault(if input.doc.is_empty() { fault } else { fault.hint(input.doc.clone()) });
            }
            fed.insert(input.name.text.clone(), given);
        }
        (fed, reader.fault_count() == before)
    }

    /// An axis of the pipeline or of a part, under its full name.
    fn axis(&mut self, key: &Key, mut node: Node, scope: &Scope, reader: &mut Reader) {
        let name = Word { span: key.span, text: inside(scope.prefix, &key.name) };
        self.put_late("axes", &name.text, &mut node, reader);
        let node = self.with_values(node, reader);
        match reader.axis(name.clone(), &node) {
            Some(mut axis) => {
                axis.label.clone_from(&key.name);
                axis.from = axis.from.and_then(|from| scope.single(from, reader));
                self.flat.axes.push(axis);
            }
            None => drop(self.flat.unread_axes.insert(name.text)),
        }
    }

    /// A declaration of an axis with the values of the pipeline's parameters.
    fn with_values(&self, node: Node, reader: &mut Reader) -> Node {
        match node.data {
            Data::Scalar(Value::String(ref text)) if text.contains("${") => {
                match filled(&node, &|name| value_of(self.values, name)) {
                    Ok(value) => Node::of_value(&value, node.span),
                    Err(fault) => {
                        reader.fault(fault.hint("an axis can mention parameters, and no other axis"));
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

    /// Puts the values that were given for a step or axis on the command line into it.
    fn put_late(&mut self, section: &str, name: &str, node: &mut Node, reader: &mut Reader) {
        for (late, found) in &mut self.late {
            match late.put_into(section, name, node) {
                Ok(fits) => *found |= fits,
                Err(fault) => {
                    *found = true;
                    reader.fault(fault);
                }
            }
        }
    }

    /// A value for something that no part makes is a slip of the pen.
    fn check_late(&self, reader: &mut Reader) {
        for (late, _) in self.late.iter().filter(|(_, found)| !found) {
            let (section, name) = (late.keys[0].as_str(), late.keys[1].as_str());
            let what = if section == "steps" { "step" } else { "axis" };
            let steps = self.flat.steps.iter().map(|step| step.name.text.as_str());
            let axes = self.flat.axes.iter().map(|axis| axis.name.text.as_str());
            let known: Vec<&str> = if section == "steps" { steps.collect() } else { axes.collect() };
            let fault = Diagnostic::at(late.span, format!("the pipeline has no {what} `{name}`"));
            reader.fault(fault.suggest(name, known.into_iter().filter(|known| known.contains(INSIDE))));
        }
    }

    /// Parts that nothing uses, and outputs that nothing reads and no target makes, of those declared in the pipeline.
    pub fn unused(&self, known: &Known, targets: Option<&[Word]>) -> Vec<Diagnostic> {
        let mut faults = Vec::new();
        for (name, part) in known.iter().filter_map(|(name, number)| Some((name, self.parts[*number].as_ref()?))) {
            let uses: Vec<&Used> = self.flat.uses.iter().filter(|used| used.part == part.name).collect();
            if uses.is_empty() {
                let span = part.place;
                let fault = Diagnostic::at(span, format!("nothing uses part `{name}`"));
                faults.push(fault.hint(format!("write `use: {name}` on a step, or remove it")));
                continue;
            }
            let read = self.read.get(&known[name]);
            for (output, to) in &part.outputs {
                let is_read = read.is_some_and(|read| read.contains(&output.text));
                let inner = || part.steps.iter().filter_map(|(_, node)| node.get("in"));
                let is_end = || !inner().any(|node| super::check::reads(node, &to.step));
                let is_target = |used: &&&Used| {
                    let full = format!("{}{INSIDE}{}", used.name, to.step);
                    targets.is_some_and(|words| words.iter().any(|word| word.text == used.name || word.text == full))
                };
                if !is_read && !uses.iter().any(|used| is_target(&used)) && (targets.is_some() || !is_end()) {
                    let message = format!("nothing reads the output `{}` of part `{name}`", output.text);
                    let hint = "read it, name the use under `targets`, or remove it";
                    faults.push(Diagnostic::at(output.span, message).hint(hint));
                }
            }
        }
        faults
    }
}

/// An axis of something inside, as it is called outside.
fn under(prefix: &str, axis: &Word) -> Word {
    Word { span: axis.span, text: inside(prefix, &axis.text) }
}

/// What stands behind `step.port` where these uses are known; notes which outputs are asked for.
fn told_output(uses: &Uses, prefix: &str, step: &str, port: &str, asked: &RefCell<Vec<(usize, String)>>) -> Output {
    let Some(used) = uses.get(step) else { return Output::Step };
    let Some((number, part, outs)) = used else { return Output::Unread };
    let Some(to) = outs.get(port) else {
        return Output::Missing(part.clone(), outs.keys().cloned().collect());
    };
    asked.borrow_mut().push((*number, port.to_owned()));
    Output::Of(outside(&format!("{prefix}{step}{INSIDE}"), to))
}

/// What an output is, as it is called outside.
fn outside(prefix: &str, to: &Reference) -> Reference {
    let picks = to.picks.iter().map(|(axis, item)| (under(prefix, axis), item.clone())).collect();
    Reference { span: to.span, step: inside(prefix, &to.step), port: to.port.clone(), picks }
}
