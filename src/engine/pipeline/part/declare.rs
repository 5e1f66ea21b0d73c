//! The declaration of a part, as it stands under `parts:` or in a file of its own.

use std::path::Path;
use std::rc::Rc;

use rockface_core::artefact::Kind;

use super::super::node::{Data, Key, Node, Word};
use super::super::parameter::is_declared;
use super::super::reader::Reader;
use super::{IN, Interface, Known, Part, PartInput};
use crate::diagnostic::Diagnostic;

/// The keys of a part.
pub const KEYS: &[&str] = &["doc", "params", "in", "out", "axes", "zip", "steps"];
/// The keys of a file that holds a part.
pub const FILE_KEYS: &[&str] = &["rockface", "part", "parts", "doc", "params", "in", "out", "axes", "zip", "steps"];

/// Whether the name of a part is the path of its file.
pub fn is_path(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|extension| extension == "yaml" || extension == "yml")
}

impl Reader<'_> {
    /// A part; `source` is the text it stands in.
    pub fn part(&mut self, name: &Word, node: &mut Node, keys: &[&str], known: Rc<Known>) -> Option<Part> {
        let before = self.fault_count();
        let what = format!("part `{}`", name.text);
        self.map(node, &what, keys)?;
        let doc = node.get("doc").and_then(|n| self.sentence(n, "doc")).unwrap_or_default();
        let params = self.part_params(node);
        let inputs = self.part_inputs(node);
        let outputs = self.part_outputs(node, name, &what);
        let axes = self.part_entries(node, "axes");
        let zip = node.take("zip");
        let steps = self.part_entries(node, "steps");
        if steps.is_empty() {
            self.fault(Diagnostic::at(name.span, format!("{what} has no `steps`")));
        }
        for (key, _) in steps.iter().filter(|(key, _)| key.name == IN) {
            let message = format!("no step of a part can be called `{IN}`");
            self.fault(Diagnostic::at(key.span, message).hint(format!("`{IN}.name` is an input of the part")));
        }
        for (key, _) in &axes {
            if params.iter().any(|param| param.name.text == key.name) {
                let message = format!("`{}` is both a parameter and an axis", key.name);
                self.fault(Diagnostic::at(key.span, message).hint("rename one: ${name} would be ambiguous"));
            }
        }
        let names = outputs.iter().map(|(word, _)| word.text.clone()).collect();
        let interface = Interface { doc, params, inputs, outputs: names };
        let (place, name) = (name.span, name.text.clone());
        let part = Part { name, interface, outputs, axes, zip, steps, known, place, digest: None };
        if self.fault_count() > before {
            return None;
        }
        part.unused().into_iter().for_each(|fault| self.fault(fault));
        Some(part)
    }

    fn part_params(&mut self, node: &Node) -> Vec<super::Declared> {
        let entries = node.get("params").and_then(|n| self.any_map(n, "`params`")).unwrap_or_default();
        let mut params = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            self.check_name(key);
            if is_declared(node) {
                params.extend(self.declared(key, node));
            } else {
                let message = format!("parameter `{}` of a part does not say its type", key.name);
                let hint = "for example {type: number, min: 0, default: 0.7, doc: what it is}";
                self.fault(Diagnostic::at(key.span, message).hint(hint));
            }
        }
        params
    }

    fn part_inputs(&mut self, node: &Node) -> Vec<PartInput> {
        let entries = node.get("in").and_then(|n| self.any_map(n, "`in`")).unwrap_or_default();
        entries.iter().filter_map(|(key, node)| self.part_input(key, node)).collect()
    }

    /// `name: kind`, or `name: {kind: …, optional: true, doc: …}`.
    fn part_input(&mut self, key: &Key, node: &Node) -> Option<PartInput> {
        let name = Word { span: key.span, text: key.name.clone() };
        let (kinds, optional, doc) = if matches!(node.data, Data::Map(_)) {
            self.map(node, &format!("input `{}`", key.name), &["kind", "optional", "doc"])?;
            let Some(kind) = node.get("kind") else {
                let fault = Diagnostic::at(key.span, format!("input `{}` does not say its kind", key.name));
                self.fault(fault.hint("for example {kind: mesh, optional: true}"));
                return None;
            };
            let doc = node.get("doc").and_then(|n| self.sentence(n, "doc"));
            (self.some_words(kind, "a kind of artefact"), self.flag(node.get("optional"), false), doc)
        } else {
            (self.some_words(node, "a kind of artefact"), false, None)
        };
        let kinds: Vec<Option<Kind>> = kinds.iter().map(|word| self.kind(word)).collect();
        let kinds = kinds.into_iter().collect::<Option<Vec<_>>>()?;
        Some(PartInput { name, kinds, optional, doc: doc.unwrap_or_default() })
    }

    fn kind(&mut self, word: &Word) -> Option<Kind> {
        let found = Kind::ALL.iter().find(|kind| kind.word() == word.text).copied();
        if found.is_none() {
            let fault = Diagnostic::at(word.span, format!("unknown kind of artefact `{}`", word.text));
            self.fault(fault.suggest(&word.text, Kind::ALL.iter().map(|kind| kind.word())));
        }
        found
    }

    fn part_outputs(&mut self, node: &Node, name: &Word, what: &str) -> Vec<(Word, super::Reference)> {
        let entries = node.get("out").and_then(|n| self.any_map(n, "`out`")).unwrap_or_default();
        if entries.is_empty() {
            let fault = Diagnostic::at(name.span, format!("{what} has no `out`"));
            self.fault(fault.hint("name what others may read of it: `out: {dem: dem.raster}`"));
        }
        let mut outputs = Vec::with_capacity(entries.len());
        // A step that is called so is a fault of its own.
        let is_step = node.get("steps").is_some_and(|steps| steps.get(IN).is_some());
        for (key, node) in entries {
            let reference = self.reference(node);
            if let Some(of_input) = reference.as_ref().filter(|reference| reference.step == IN && !is_step) {
                let message = format!("output `{}` only hands on the input `{}`", key.name, of_input.port);
                self.fault(Diagnostic::at(node.span, message).hint("an output is what a step of the part makes"));
            }
            outputs.extend(reference.map(|to| (Word { span: key.span, text: key.name.clone() }, to)));
        }
        outputs
    }

    /// The entries of a section, whose names are names; they are read where the part is used.
    fn part_entries(&mut self, node: &mut Node, section: &str) -> Vec<(Key, Node)> {
        let Some(node) = node.take(section) else { return Vec::new() };
        if self.any_map(&node, &format!("`{section}`")).is_none() {
            return Vec::new();
        }
        let mut entries = node.into_entries();
        entries.retain(|(key, _)| self.check_name(key));
        entries
    }
}
