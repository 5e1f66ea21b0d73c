//! What a use gives to its part: values for the parameters, and what the inputs are fed with.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use super::super::input::Input;
use super::super::node::{Data, Node};
use super::super::parameter::ValueKind;
use super::super::reader::Reader;
use super::super::substitute::{filled, mentioned, value_of};
use super::expand::Expansion;
use super::substitution::Substitution;
use super::{KindCheck, Part, Use};
use crate::diagnostic::Diagnostic;

/// What the inputs of a part are fed with, by name; `None` for one that is left out.
pub type Fed = BTreeMap<String, Option<Input>>;

impl Expansion<'_> {
    /// Adds the values of a part's parameters to the substitution of a use.
    pub fn give(&self, part: &Part, used: &Use, filling: &mut Substitution, reader: &mut Reader) {
        let params = &part.interface.params;
        for (key, node) in &used.with {
            let Some(param) = params.iter().find(|param| param.name.text == key.name) else {
                let fault = Diagnostic::at(key.span, format!("part `{}` has no parameter `{}`", part.name, key.name));
                reader.fault(fault.suggest(&key.name, params.iter().map(|param| param.name.text.as_str())));
                continue;
            };
            let node = param.kind.taken(self.known_values(node));
            reader.check_keys(&node);
            if let Some(fault) = param.fault(&node) {
                reader.fault(fault);
            }
            let node = if param.kind == ValueKind::Path { self.full_path(node, filling.source) } else { node };
            filling.args.insert(key.name.clone(), node);
        }
        for param in params.iter().filter(|param| !used.with.iter().any(|(key, _)| key.name == param.name.text)) {
            let name = &param.name.text;
            if let Some(default) = &param.default {
                let default = filling.node(default, reader);
                filling.args.insert(name.clone(), default);
                continue;
            }
            let message = format!("step `{}` does not say `{name}`, which part `{}` needs", used.name.text, part.name);
            let fault = Diagnostic::at(used.part.span, message).also(param.name.span, "it is declared here");
            reader.fault(if param.doc.is_empty() { fault } else { fault.hint(format!("`{name}`: {}", param.doc)) });
        }
    }

    /// A value with the parameters of the pipeline filled in, if it mentions nothing else.
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
        let folder = self.library.texts.folder(node.span);
        let part_folder = self.library.texts.sources[source].folder();
        let Some(text) = node.text() else { return node };
        if part_folder == Some(&folder) || Path::new(text).is_absolute() || text.starts_with("${") {
            return node;
        }
        let full = std::path::absolute(folder.join(text)).unwrap_or_else(|_| folder.join(text));
        Node { data: Data::Scalar(Value::String(full.display().to_string())), ..node }
    }

    /// What the inputs of a part are fed with.
    pub fn feed(&mut self, part: &Part, used: &Use, reader: &mut Reader) -> Fed {
        let declared = &part.interface.inputs;
        for (port, _) in &used.inputs {
            if !declared.iter().any(|input| input.name.text == port.text) {
                let fault = Diagnostic::at(port.span, format!("part `{}` has no input `{}`", part.name, port.text));
                reader.fault(fault.suggest(&port.text, declared.iter().map(|input| input.name.text.as_str())));
            }
        }
        let mut fed = Fed::new();
        for input in declared {
            let given =
                used.inputs.iter().find(|(port, _)| port.text == input.name.text).map(|(_, given)| given.clone());
            if let Some(given) = &given {
                let given = given.references().into_iter().cloned().collect();
                self.flat.checks.push(KindCheck { part: part.name.clone(), input: input.clone(), given });
            } else if !input.optional && !used.unread_inputs.contains(&input.name.text) {
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
        fed
    }
}
