//! What a part declares and does not use: most likely a mistake, so it is reported.

use std::collections::{BTreeMap, BTreeSet};

use super::super::node::{Node, Word};
use super::super::reference::Label;
use super::super::substitute::{mentioned, parted};
use super::expand::Expansion;
use super::{IN, INSIDE, Known, Part, Used, own_names, texts};
use crate::diagnostic::Diagnostic;

impl Part {
    /// Parameters, inputs and steps that nothing in the part needs.
    pub fn unused(&self) -> Vec<Diagnostic> {
        let mut faults = self.strange_outputs();
        let name = &self.name;
        let (mut mentions, mut read) = (Vec::new(), BTreeSet::new());
        let nodes = self.steps.iter().chain(&self.axes).map(|(_, node)| node).chain(&self.zip);
        nodes.for_each(|node| mentioned(node, &mut mentions));
        let defaults = self.interface.params.iter().filter_map(|param| param.default.as_ref());
        defaults.for_each(|node| mentioned(node, &mut mentions));
        let mentions: BTreeSet<&str> = mentions.iter().map(|(name, _)| parted(name).0).collect();
        for param in self.interface.params.iter().filter(|param| !mentions.contains(param.name.text.as_str())) {
            let own = &param.name.text;
            let message = format!("nothing in part `{name}` mentions its parameter `{own}`");
            faults.push(Diagnostic::at(param.name.span, message).hint(format!("write ${{{own}}}, or remove it")));
        }
        let fed = self.steps.iter().filter_map(|(_, node)| node.get("in"));
        let fed = fed.chain(self.axes.iter().filter_map(|(_, node)| node.get("from")));
        fed.for_each(|node| {
            labels(node, |label| read.extend(label.port.filter(|_| label.step == IN).map(str::to_owned)));
        });
        for input in self.interface.inputs.iter().filter(|input| !read.contains(&input.name.text)) {
            let own = &input.name.text;
            let message = format!("no step of part `{name}` reads its input `{own}`");
            faults.push(Diagnostic::at(input.name.span, message).hint(format!("read `{IN}.{own}`, or remove it")));
        }
        if faults.is_empty() {
            faults.extend(self.idle_steps());
        }
        faults
    }

    fn strange_outputs(&self) -> Vec<Diagnostic> {
        let steps = own_names(&self.steps);
        let strange = self.outputs.iter().filter(|(_, to)| !steps.contains(to.step.as_str()));
        let told = |(_, to): &(_, super::Reference)| {
            let fault = Diagnostic::at(to.span, format!("part `{}` has no step `{}`", self.name, to.step));
            fault.suggest(&to.step, steps.iter().copied())
        };
        strange.map(told).collect()
    }

    /// Steps that lead to no output.
    fn idle_steps(&self) -> Vec<Diagnostic> {
        let mut feeds: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        let mut open: Vec<String> = self.outputs.iter().map(|(_, to)| to.step.clone()).collect();
        for (key, node) in &self.steps {
            let feeding = feeds.entry(&key.name).or_default();
            node.get("in").into_iter().for_each(|node| labels(node, |label| feeding.push(label.step.to_owned())));
        }
        let lists = self.axes.iter().filter_map(|(_, node)| node.get("from"));
        lists.for_each(|node| labels(node, |label| open.push(label.step.to_owned())));
        let mut needed: BTreeSet<String> = BTreeSet::new();
        while let Some(step) = open.pop() {
            if needed.insert(step.clone()) {
                open.extend(feeds.get(step.as_str()).into_iter().flatten().cloned());
            }
        }
        let idle = self.steps.iter().filter(|(key, _)| !needed.contains(&key.name));
        let told = |(key, _): &(super::Key, Node)| {
            let message = format!("step `{}` of part `{}` leads to none of its outputs", key.name, self.name);
            Diagnostic::at(key.span, message).hint("name it under `out`, or remove it")
        };
        idle.map(told).collect()
    }
}

impl Expansion<'_> {
    /// Parts that nothing uses, and outputs that nothing reads and no target makes, of those declared in the pipeline.
    pub fn unused(&self, known: &Known, targets: Option<&[Word]>) -> Vec<Diagnostic> {
        let mut faults = Vec::new();
        for (name, part) in known.iter().filter_map(|(name, number)| Some((name, self.library.part(*number)?))) {
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
                let is_end = || !inner().any(|node| reads(node, &to.step));
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

/// Whether what a step is fed with names another.
fn reads(node: &Node, step: &str) -> bool {
    let mut found = false;
    labels(node, |label| found |= label.step == step);
    found
}

/// Calls a function with every label among the texts of a value.
fn labels(node: &Node, mut found: impl FnMut(Label)) {
    let mut all = Vec::new();
    texts(node, &mut all);
    all.iter().filter_map(|(text, _)| Label::parse(text)).for_each(&mut found);
}
