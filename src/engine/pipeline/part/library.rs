//! The parts that a pipeline knows: declared in it, read from files, or shipped with the program; each is read once.

use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;

use rockface_cache::Digest;

use super::super::include::{Texts, check_format};
use super::super::node::{Key, Node, Word};
use super::super::reader::Reader;
use super::super::reference::Reference;
use super::declare::{FILE_KEYS, KEYS, is_path};
use super::substitution::outside;
use super::{INSIDE, Interface, Known, Part, PartText};
use crate::diagnostic::{Diagnostic, Origin, Source, Span};

/// The outputs of a part by name, with steps and axes as they are called inside it.
pub type Outs = Rc<BTreeMap<String, Reference>>;

/// The part that a step uses.
pub struct UsedPart {
    /// Its number in the library.
    pub number: usize,
    /// Its name for messages.
    pub name: String,
    /// What stands behind its outputs.
    pub outs: Outs,
}

/// The uses among the steps of a part or pipeline by name; `None` where the part could not be read.
pub type Uses = BTreeMap<String, Option<UsedPart>>;

/// All parts that are known, by number.
pub struct Library<'l> {
    /// The texts that have been read.
    pub texts: &'l mut Texts,
    shipped: &'static [PartText],
    /// The parts; `None` where one could not be read.
    parts: Vec<Option<Rc<Part>>>,
    /// The outputs of each, once they are asked for.
    outs: Vec<Option<Outs>>,
    /// Parts from files and those of the program: numbers by path or name.
    files: BTreeMap<String, usize>,
}

impl<'l> Library<'l> {
    /// No part is known yet but those of the program.
    pub fn new(texts: &'l mut Texts, shipped: &'static [PartText]) -> Self {
        Self { texts, shipped, parts: Vec::new(), outs: Vec::new(), files: BTreeMap::new() }
    }

    /// The part of this number, unless it could not be read.
    pub fn part(&self, number: usize) -> Option<&Rc<Part>> {
        self.parts[number].as_ref()
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
        self.part(number).map(|part| part.interface.clone())
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
                let last = |part: &&PartText| part.name.rsplit('/').next() == Some(word.text.as_str());
                reader.fault(if let Some(part) = self.shipped.iter().find(last) {
                    fault.hint(format!("did you mean `{}`?", part.name))
                } else {
                    let names = known.keys().map(String::as_str).chain(self.shipped.iter().map(|part| part.name));
                    fault.suggest(&word.text, names).or_hint(
                        "a file is named by its path, `parts/name.yaml`; a stage is named by `stage`, not by `use`",
                    )
                });
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
    pub fn outs(&mut self, number: usize, reader: &mut Reader) -> Outs {
        if let Some(outs) = &self.outs[number] {
            return outs.clone();
        }
        // A part that uses itself is reported where it is written out.
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
    pub fn uses(&mut self, steps: &[(Key, Node)], known: &Known, reader: &mut Reader) -> Uses {
        let mut uses = Uses::new();
        for (key, node) in steps {
            let Some(named) = node.get("use") else { continue };
            let word = named.text().map(|text| Word { span: named.span, text: text.to_owned() });
            let number = word.and_then(|word| self.find(&word, known, reader));
            let part = number.and_then(|number| Some((number, self.part(number)?.name.clone())));
            let used = part.map(|(number, name)| UsedPart { number, name, outs: self.outs(number, reader) });
            if used.is_none() {
                reader.unread_step(key.name.clone());
            }
            uses.insert(key.name.clone(), used);
        }
        uses
    }
}
