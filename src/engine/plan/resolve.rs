//! From document to graph: names, ports, cycles and axes, with all faults reported together.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, HashSet};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use petgraph::algo::kosaraju_scc;
use petgraph::graph::DiGraph;
use rockface_core::artefact::Kind;
use rockface_core::{AnyStage, Ports};
use serde_json::Value;

use super::axis_propagation::Names;
use super::graph::{Dynamic, Graph, GraphStep};
use super::points::too_many;
use super::{Stages, parameters};
use crate::diagnostic::{Diagnostic, Diagnostics, SHOWN, Source, Span, listed};
use crate::pipeline::{
    Base, Copied, Document, Key, Node, Pipeline, Reference, Step, Word, escape_hint, filled, mentioned, parted,
    value_of,
};

/// The parameters of a step with the values of the pipeline's parameters; what mentions an axis stays as it is written.
fn with_values(with: &Node, values: &BTreeMap<String, Value>) -> Value {
    let Some(entries) = with.entries() else { return with.to_value() };
    let value = |(key, node): &(Key, Node)| {
        let value = filled(node, &|name| value_of(values, name)).unwrap_or_else(|_| node.to_value());
        (key.name.clone(), value)
    };
    Value::Object(entries.iter().map(value).collect())
}

/// Resolves a pipeline; `targets` on the command line take the place of the document's.
///
/// Where there are faults, it is resolved once more with suggestions for those that are shown: to look for a suggestion
/// takes time, and which faults are shown is known only when all are.
pub fn resolve(pipeline: &Pipeline, targets: &[String], stages: &Stages) -> Result<Graph, Diagnostics> {
    let faults = match attempt(pipeline, targets, stages, HashSet::new()) {
        Ok(graph) => return Ok(graph),
        Err(faults) => faults,
    };
    let shown = faults.told_once().into_iter().take(SHOWN).filter_map(|fault| fault.span).collect();
    attempt(pipeline, targets, stages, shown)
}

fn attempt(
    pipeline: &Pipeline,
    targets: &[String],
    stages: &Stages,
    shown: HashSet<Span>,
) -> Result<Graph, Diagnostics> {
    let mut resolver = Resolver::new(pipeline, stages, shown);
    resolver.check_names();
    resolver.check_zips();
    resolver.check_part_inputs();
    let order = resolver.order();
    let graph = resolver.build(&order, pipeline, targets);
    if resolver.faults.is_empty() {
        resolver.faults = too_many(&graph);
    }
    if resolver.faults.is_empty() {
        return Ok(graph);
    }
    resolver.check_parameters(&graph, targets);
    Err(Diagnostics { sources: pipeline.sources.clone(), list: resolver.faults })
}

/// A graph in the making. Steps are numbered as in the document; `place` tells their number in the graph.
pub struct Resolver<'d> {
    /// What the pipeline calls what.
    pub names: Names<'d>,
    /// By step: its stage.
    pub stages: Vec<Option<&'static dyn AnyStage>>,
    /// By step: its ports.
    pub ports: Vec<Option<Ports>>,
    /// By step: its number in the graph.
    pub place: Vec<usize>,
    /// The faults found so far, which are reported together.
    pub faults: Vec<Diagnostic>,
    available: &'d Stages,
    /// The folder of the pipeline.
    folder: Arc<Path>,
    copied: Option<Arc<Copied>>,
    /// The texts of the pipeline, of which each file has a folder.
    pub(super) sources: &'d [Source],
    /// By number in the graph: the axes of the step.
    pub reach: Vec<BTreeSet<usize>>,
    /// Faults that are none where it is not sure which axes a step has: the step, and the fault.
    unsure: Vec<(usize, Diagnostic)>,
    /// By step: whether it waits for itself.
    pub circling: Vec<bool>,
    /// By step: whether a name in its parameters stands for nothing.
    pub unfilled: Vec<bool>,
    /// Where something is fed into a part that does not take it.
    pub misfed: HashSet<Span>,
    /// Where the faults are that are shown, once that is known.
    shown: HashSet<Span>,
}

impl<'d> Resolver<'d> {
    fn new(pipeline: &'d Pipeline, available: &'d Stages, shown: HashSet<Span>) -> Self {
        let document = &pipeline.document;
        let known: BTreeMap<&str, &'static dyn AnyStage> =
            available.iter().map(|stage| (stage.name(), *stage)).collect();
        let stages: Vec<_> = document.steps.iter().map(|step| known.get(step.stage.text.as_str()).copied()).collect();
        let mut resolver = Self {
            names: Names::new(document),
            ports: Vec::with_capacity(stages.len()),
            stages,
            place: vec![0; document.steps.len()],
            faults: pipeline.faults.clone(),
            available,
            folder: Arc::from(pipeline.folder.as_path()),
            copied: pipeline.copied.clone(),
            sources: &pipeline.sources,
            reach: Vec::new(),
            unsure: Vec::new(),
            circling: vec![false; document.steps.len()],
            unfilled: vec![false; document.steps.len()],
            misfed: HashSet::new(),
            shown,
        };
        for (own, step) in document.steps.iter().enumerate() {
            let ports = resolver.stages[own].and_then(|stage| resolver.ports_of(step, stage));
            resolver.ports.push(ports);
        }
        resolver
    }

    fn ports_of(&mut self, step: &Step, stage: &dyn AnyStage) -> Option<Ports> {
        let values = &self.names.document.values;
        let with = step.with.as_deref().map_or(Value::Null, |with| with_values(with, values));
        let place =
            parameters::Place { step: &step.name.text, stage, with: step.with.as_deref(), span: step.name.span };
        match stage.ports(&with) {
            Ok(ports) => Some(ports),
            Err(_) if step.gaps.with => None,
            Err(faults) => {
                self.faults.extend(faults.into_iter().map(|fault| parameters::told(&place, &with, &fault)));
                None
            }
        }
    }

    /// The folder that paths written at a place are relative to.
    fn folder_of(&self, span: Span) -> Arc<Path> {
        self.sources.get(span.source).and_then(Source::folder).unwrap_or(&self.folder).clone()
    }

    /// The document that is being resolved.
    pub fn document(&self) -> &'d Document {
        self.names.document
    }

    /// The names of all steps.
    pub fn step_names(&self) -> Vec<&'d str> {
        self.document().steps.iter().map(|step| step.name.text.as_str()).collect()
    }

    /// The names of all axes.
    pub fn axis_names(&self) -> Vec<&'d str> {
        self.document().axes.iter().map(|axis| axis.name.text.as_str()).collect()
    }

    /// The axes of a step, by its number in the graph.
    pub fn position_axes(&self, position: usize) -> &BTreeSet<usize> {
        &self.reach[position]
    }

    fn check_names(&mut self) {
        for (step, stage) in self.document().steps.iter().zip(&self.stages) {
            if stage.is_none() {
                let known = self.available.iter().map(|stage| stage.name());
                let fault = Diagnostic::at(step.stage.span, format!("unknown stage `{}`", step.stage.text));
                let fault = self.suggest(fault, &step.stage.text, || known);
                // Names of stages have no slash, those of parts that come with the program do.
                let is_part = step.stage.text.contains('/');
                self.faults.push(if is_part { fault.hint("a part is named by `use`, not by `stage`") } else { fault });
            }
        }
        for (key, _) in &self.document().params {
            if self.names.axes.contains_key(key.name.as_str()) {
                let message = format!("`{}` is both a parameter and an axis", key.name);
                self.faults.push(Diagnostic::at(key.span, message).hint("rename one: ${name} would be ambiguous"));
            }
        }
    }

    fn check_zips(&mut self) {
        let mut seen: Vec<usize> = Vec::new();
        for group in &self.document().zips {
            let members: Vec<(usize, &Word)> = group.iter().filter_map(|word| Some((self.axis(word)?, word))).collect();
            for (axis, word) in &members {
                let own = &self.document().axes[*axis];
                let (first, _) = members[0];
                let (count, wanted) = (own.items.len(), self.document().axes[first].items.len());
                let unknown = own.from.is_some() || self.document().axes[first].from.is_some();
                let first = &self.document().axes[first].name.text;
                let fault = if seen.contains(axis) {
                    Some((format!("axis `{}` is zipped twice", word.text), "name all axes in one list"))
                } else if !unknown && count != wanted {
                    let message = format!("axis `{}` has {count} items, `{first}` has {wanted}", word.text);
                    Some((message, "axes that are walked together have as many items as each other"))
                } else {
                    None
                };
                self.faults.extend(fault.map(|(message, hint)| Diagnostic::at(word.span, message).hint(hint)));
                seen.push(*axis);
            }
        }
    }

    /// The axis of a name.
    pub fn axis(&mut self, word: &Word) -> Option<usize> {
        let found = self.names.axes.get(word.text.as_str()).copied();
        if found.is_none() && !self.document().unread.axes.contains(&word.text) {
            let fault = Diagnostic::at(word.span, format!("unknown axis `{}`", word.text));
            let fault = if self.names.axes.is_empty() {
                fault.hint("declare it under `axes:`")
            } else {
                self.suggest(fault, &word.text, || self.axis_names())
            };
            self.faults.push(fault);
        }
        found
    }

    /// The number of an item on an axis.
    pub fn item(&mut self, axis: usize, word: &Word, item: &str) -> Option<usize> {
        let declared = &self.document().axes[axis];
        let found = self.names.item(axis, item);
        if found.is_none() {
            let message = format!("`{item}` is no item of axis `{}`", declared.name.text);
            let known = || declared.items.iter().map(String::as_str);
            self.faults.push(self.suggest(Diagnostic::at(word.span, message), item, known));
        }
        found
    }

    /// Adds a suggestion to a fault that is shown.
    pub fn suggest<'a, I: IntoIterator<Item = &'a str>>(
        &self,
        fault: Diagnostic,
        given: &str,
        known: impl FnOnce() -> I,
    ) -> Diagnostic {
        let is_shown = fault.span.is_none_or(|span| self.shown.contains(&span));
        if is_shown { fault.suggest(given, known()) } else { fault }
    }

    /// Adds a fault that follows from the axes of a step, if it turns out that those are sure.
    pub fn unless_unsure(&mut self, step: &str, fault: Diagnostic) {
        self.unsure.extend(self.names.steps.get(step).map(|step| (*step, fault)));
    }

    /// Document indices of the steps, producers first, except within a cycle; otherwise as they are written.
    fn order(&mut self) -> Vec<usize> {
        let document = self.document();
        let mut producers: Vec<Vec<usize>> = Vec::with_capacity(document.steps.len());
        for step in &document.steps {
            let references = step.inputs.iter().flat_map(|(_, input)| input.forward_references());
            let axes = self.names.met_axes(step);
            let lists = axes.iter().filter_map(|axis| document.axes[*axis].from.as_ref());
            let named = references.chain(lists).filter_map(|to| self.names.steps.get(to.step.as_str()));
            let mut named: Vec<usize> = named.copied().collect();
            named.sort_unstable();
            named.dedup();
            producers.push(named);
        }
        if let Some(order) = producers_first(&producers) {
            return order;
        }
        let mut arrows = DiGraph::<usize, ()>::new();
        let nodes: Vec<_> = (0..document.steps.len()).map(|i| arrows.add_node(i)).collect();
        for (consumer, producers) in producers.iter().enumerate() {
            producers.iter().for_each(|producer| _ = arrows.add_edge(nodes[*producer], nodes[consumer], ()));
        }
        let components = kosaraju_scc(&arrows);
        for component in &components {
            let alone = component.len() == 1 && !arrows.contains_edge(component[0], component[0]);
            if !alone {
                let members: BTreeSet<usize> = component.iter().map(|node| arrows[*node]).collect();
                self.report_cycle(&members);
                members.into_iter().for_each(|step| self.circling[step] = true);
            }
        }
        components.into_iter().rev().flatten().map(|node| arrows[node]).collect()
    }

    fn report_cycle(&mut self, members: &BTreeSet<usize>) {
        let document = self.document();
        let name = |i: &usize| document.steps[*i].name.text.as_str();
        let Some(first) = members.first().map(|i| &document.steps[*i]) else { return };
        let is_member = |to: &&Reference| self.names.steps.get(to.step.as_str()).is_some_and(|i| members.contains(i));
        let back = first.inputs.iter().flat_map(|(_, input)| input.references());
        let back = back.into_iter().find(is_member).map_or(first.name.span, |r| r.span);
        let message = format!("these steps wait for each other in a circle: {}", listed(members.iter().map(name)));
        self.faults.push(
            Diagnostic::at(back, message)
                .label("needs what comes after it")
                .hint("let one of them read from a step outside the circle"),
        );
    }

    fn build(&mut self, order: &[usize], pipeline: &Pipeline, targets: &[String]) -> Graph {
        let document = self.document();
        for (new, old) in order.iter().enumerate() {
            self.place[*old] = new;
        }
        let reach = self.names.reach(order);
        self.reach = order.iter().map(|old| reach[*old].clone()).collect();
        let dynamic = self.dynamic();
        self.check_part_outputs();
        let mut steps: Vec<GraphStep> = Vec::with_capacity(order.len());
        for old in order {
            steps.extend(self.step(&document.steps[*old], *old));
        }
        let targets = self.targets(&steps, &dynamic, targets);
        if document.value_faults.is_empty() {
            let unused: Vec<Diagnostic> = self.unused_axes().into_iter().chain(self.unused_params()).collect();
            self.faults.extend(self.if_all_is_read(unused));
        }
        self.faults.extend(document.value_faults.iter().cloned());
        let unsure = std::mem::take(&mut self.unsure);
        self.faults.extend(self.where_sure(unsure));
        Graph {
            name: document.name.clone(),
            seed: document.seed,
            folder: pipeline.folder.clone(),
            params: document.values.clone(),
            axes: document.axes.clone(),
            zips: self.names.zips.clone(),
            dynamic,
            partners: BTreeMap::new(),
            numbers: document.axes.iter().map(|_| OnceLock::new()).collect(),
            steps,
            targets,
            uses: document.uses.clone(),
            former: None,
        }
    }

    /// By axis: the output its items are taken from.
    fn dynamic(&mut self) -> Vec<Option<Dynamic>> {
        let document = self.document();
        document.axes.iter().map(|axis| self.teller(&axis.name, axis.from.as_ref()?)).collect()
    }

    fn teller(&mut self, axis: &Word, from: &Reference) -> Option<Dynamic> {
        let source = self.source(from)?;
        let kind = source.port.kinds[0];
        let step = &self.document().steps[self.names.steps[from.step.as_str()]];
        let fault = if !kind.has_items() {
            let message = format!("axis `{}` cannot take items from a {kind}", axis.text);
            let lists: Vec<&str> = Kind::ALL.iter().filter(|kind| kind.has_items()).map(|kind| kind.word()).collect();
            Some((message, format!("lists are: {}", lists.join(", "))))
        } else if kind == Kind::Table && !step.keep {
            let message =
                format!("the rows of axis `{}` are read from the store, and `{}` is not kept", axis.text, from.step);
            Some((message, format!("remove `keep: false` from step `{}`", from.step)))
        } else {
            None
        };
        match fault {
            Some((message, hint)) => {
                self.faults.push(Diagnostic::at(from.span, message).hint(hint));
                None
            }
            None => Some(Dynamic { source, known: false, lists: BTreeMap::new() }),
        }
    }

    fn step(&mut self, step: &Step, old: usize) -> Option<GraphStep> {
        let before = self.faults.len();
        let with_axes = step.with.as_ref().map(|with| self.mentioned_axes(with)).unwrap_or_default();
        self.unfilled[old] = self.faults.len() > before;
        for word in &step.over {
            self.axis(word);
        }
        let inputs = self.inputs(step, old);
        let axes: Vec<usize> = self.position_axes(self.place[old]).iter().copied().collect();
        let (stream, stream_axes) = self.stream(step, &axes);
        let (stage, ports) = (self.stages[old]?, self.ports[old]?);
        Some(GraphStep {
            name: step.name.text.clone(),
            span: step.name.span,
            written: old,
            stage,
            ports,
            base: Base::new(self.folder_of(step.name.span), self.copied.clone()),
            with: step.with.clone(),
            inputs,
            axes,
            with_axes,
            keep: step.keep,
            stream,
            stream_axes,
            timeout: step.timeout,
            retries: step.retries,
            log: step.log.or(self.document().log),
            title: step.title.clone(),
            doc: step.doc.clone(),
        })
    }

    fn mentioned_axes(&mut self, with: &Node) -> Vec<usize> {
        let mut names = Vec::new();
        mentioned(with, &mut names);
        let mut axes = BTreeSet::new();
        for (name, span) in names {
            if let Some(axis) = self.names.mentioned_axis(&name) {
                axes.insert(axis);
                let fault = self.field_fault(axis, &name);
                self.faults.extend(fault.map(|(message, hint)| Diagnostic::at(span, message).hint(hint)));
            } else if !self.names.is_param(&name) && !self.names.is_unread_axis(&name) {
                let params = self.document().params.iter().map(|(key, _)| key.name.as_str());
                let fault = Diagnostic::at(span, format!("`${{{name}}}` names neither a parameter nor an axis"));
                let fault = self.suggest(fault, &name, || params.chain(self.axis_names()));
                self.faults.push(fault.or_hint(escape_hint(&name)));
            }
        }
        axes.into_iter().collect()
    }

    /// What is wrong with the part of a mentioned name behind its dot.
    fn field_fault(&self, axis: usize, name: &str) -> Option<(String, String)> {
        let axis = &self.document().axes[axis];
        let field = parted(name).1;
        let own = &axis.name.text;
        let choices = || axis.fields.iter().map(|field| format!("${{{own}.{field}}}")).collect::<Vec<_>>().join(", ");
        match field {
            _ if axis.from.is_some() => None, // Reported once the items are known.
            Some(_) if axis.fields.is_empty() => {
                Some((format!("an item of axis `{own}` is a single value"), format!("write ${{{own}}}")))
            }
            Some(field) if !axis.fields.iter().any(|known| known == field) => {
                Some((format!("axis `{own}` has no value `{field}`"), format!("there are {}", choices())))
            }
            _ => None,
        }
    }

    fn stream(&mut self, step: &Step, axes: &[usize]) -> (String, Vec<usize>) {
        let label = step.stream.as_ref().and_then(|stream| stream.label.as_ref()).unwrap_or(&step.name);
        let reseeding = |axis: &usize| self.document().axes[*axis].reseeds;
        let own: Vec<usize> = axes.iter().copied().filter(reseeding).collect();
        let Some(words) = step.stream.as_ref().and_then(|stream| stream.axes.as_ref()) else {
            return (label.text.clone(), own);
        };
        let mut narrowed = BTreeSet::new();
        for word in words {
            match self.axis(word) {
                Some(axis) if axes.contains(&axis) => {
                    narrowed.insert(axis);
                }
                Some(_) => {
                    let message = format!("step `{}` does not depend on axis `{}`", step.name.text, word.text);
                    self.unless_unsure(&step.name.text, Diagnostic::at(word.span, message));
                }
                None => {}
            }
        }
        (label.text.clone(), narrowed.into_iter().collect())
    }
}

/// The numbers of a list of producers with producers before consumers, otherwise ascending; `None` where some wait for each other.
fn producers_first(producers: &[Vec<usize>]) -> Option<Vec<usize>> {
    let mut consumers: Vec<Vec<usize>> = vec![Vec::new(); producers.len()];
    for (consumer, producers) in producers.iter().enumerate() {
        producers.iter().for_each(|producer| consumers[*producer].push(consumer));
    }
    let mut unmet: Vec<usize> = producers.iter().map(Vec::len).collect();
    let mut ready: BinaryHeap<Reverse<usize>> =
        (0..unmet.len()).filter(|node| unmet[*node] == 0).map(Reverse).collect();
    let mut order = Vec::with_capacity(unmet.len());
    while let Some(Reverse(node)) = ready.pop() {
        order.push(node);
        for consumer in &consumers[node] {
            unmet[*consumer] -= 1;
            if unmet[*consumer] == 0 {
                ready.push(Reverse(*consumer));
            }
        }
    }
    (order.len() == producers.len()).then_some(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_stand_as_written_but_for_producers() {
        let order =
            |producers: &[&[usize]]| producers_first(&producers.iter().map(|list| list.to_vec()).collect::<Vec<_>>());
        assert_eq!(order(&[&[], &[], &[0], &[1], &[]]), Some(vec![0, 1, 2, 3, 4]));
        assert_eq!(order(&[&[2], &[], &[1], &[0]]), Some(vec![1, 2, 0, 3]));
        assert_eq!(order(&[&[1], &[0]]), None);
        assert_eq!(order(&[&[0]]), None);
    }
}
