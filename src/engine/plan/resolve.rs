//! From document to graph: names, ports, cycles and axes, with all faults reported together.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::Path;
use std::sync::Arc;

use petgraph::algo::{kosaraju_scc, toposort};
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
    Axis, Document, Key, Label, Node, Pipeline, Reference, Step, Used, Word, escape_hint, mentioned, resolve_values,
};

/// Resolves a pipeline; `targets` on the command line take the place of the document's.
pub fn resolve(pipeline: &Pipeline, targets: &[String], stages: &Stages) -> Result<Graph, Diagnostics> {
    let mut resolver = Resolver::new(pipeline, stages);
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
    /// What is wrong.
    pub faults: Vec<Diagnostic>,
    available: &'d Stages,
    /// The folder of the pipeline.
    folder: Arc<Path>,
    /// The texts of the pipeline, of which each file has a folder.
    sources: &'d [Source],
    /// By number in the graph: the axes of the step.
    reach: Vec<BTreeSet<usize>>,
    /// Faults that are none where it is not sure which axes a step has: the step, and the fault.
    unsure: Vec<(usize, Diagnostic)>,
    /// By step: whether it waits for itself.
    pub circling: Vec<bool>,
    /// By step: whether a name in its parameters stands for nothing.
    pub unfilled: Vec<bool>,
    /// Where something is fed into a part that does not take it.
    pub misfed: HashSet<Span>,
}

impl<'d> Resolver<'d> {
    fn new(pipeline: &'d Pipeline, available: &'d Stages) -> Self {
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
            sources: &pipeline.sources,
            reach: Vec::new(),
            unsure: Vec::new(),
            circling: vec![false; document.steps.len()],
            unfilled: vec![false; document.steps.len()],
            misfed: HashSet::new(),
        };
        for (own, step) in document.steps.iter().enumerate() {
            let ports = resolver.stages[own].and_then(|stage| resolver.ports_of(step, stage));
            resolver.ports.push(ports);
        }
        resolver
    }

    fn ports_of(&mut self, step: &Step, stage: &dyn AnyStage) -> Option<Ports> {
        let with = step.with.as_ref().map_or(Value::Null, |with| with.to_value());
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

    fn document(&self) -> &'d Document {
        self.names.document
    }

    fn step_names(&self) -> Vec<&'d str> {
        self.document().steps.iter().map(|step| step.name.text.as_str()).collect()
    }

    fn axis_names(&self) -> Vec<&'d str> {
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
                self.faults.push(self.suggest(fault, &step.stage.text, || known));
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

    /// Adds a suggestion as long as the faults are few: to look for one takes time, and of many only the first are shown.
    pub fn suggest<'a, I: IntoIterator<Item = &'a str>>(
        &self,
        fault: Diagnostic,
        given: &str,
        known: impl FnOnce() -> I,
    ) -> Diagnostic {
        if self.faults.len() < SHOWN { fault.suggest(given, known()) } else { fault }
    }

    /// Adds a fault that follows from the axes of a step, if it turns out that those are sure.
    pub fn unless_unsure(&mut self, step: &str, fault: Diagnostic) {
        self.unsure.extend(self.names.steps.get(step).map(|step| (*step, fault)));
    }

    /// Document indices of the steps, producers first as far as there is no cycle.
    fn order(&mut self) -> Vec<usize> {
        let mut arrows = DiGraph::<usize, ()>::new();
        let document = self.document();
        let nodes: Vec<_> = (0..document.steps.len()).map(|i| arrows.add_node(i)).collect();
        for (consumer, step) in document.steps.iter().enumerate() {
            let references = step.inputs.iter().flat_map(|(_, input)| input.forward_references());
            let axes = self.names.met_axes(step);
            let lists = axes.iter().filter_map(|axis| document.axes[*axis].from.as_ref());
            // One arrow for each producer; asking the graph whether it has it would go through all arrows of the producer.
            let mut producers: Vec<usize> = Vec::new();
            for producer in references.chain(lists).filter_map(|to| self.names.steps.get(to.step.as_str())) {
                if !producers.contains(producer) {
                    producers.push(*producer);
                    arrows.add_edge(nodes[*producer], nodes[consumer], ());
                }
            }
        }
        if let Ok(order) = toposort(&arrows, None) {
            return order.into_iter().map(|node| arrows[node]).collect();
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
        let steps: Vec<GraphStep> = order.iter().filter_map(|old| self.step(&document.steps[*old], *old)).collect();
        let targets = self.targets(&steps, &dynamic, targets);
        let (params, faults) = resolve_values(&document.params, &self.axis_names());
        if faults.is_empty() {
            let unused: Vec<Diagnostic> = self.unused_axes().into_iter().chain(self.unused_params()).collect();
            self.faults.extend(self.if_all_is_read(unused));
        }
        self.faults.extend(faults);
        let unsure = std::mem::take(&mut self.unsure);
        self.faults.extend(self.where_sure(unsure));
        Graph {
            name: document.name.clone(),
            seed: document.seed,
            folder: pipeline.folder.clone(),
            params,
            axes: document.axes.clone(),
            zips: self.names.zips.clone(),
            dynamic,
            steps,
            targets,
            uses: document.uses.clone(),
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
        let free = self.position_axes(source.step).iter().find(|axis| !source.picks_of(**axis));
        let step = &self.document().steps[self.names.steps[from.step.as_str()]];
        if let Some(free) = free.filter(|_| kind.has_items()) {
            let free = &self.document().axes[*free].name.text;
            let message =
                format!("axis `{}` takes its items from one list, `{}` has one for each {free}", axis.text, from.step);
            let hint = format!("pick one: `{}.{}[{free}=…]`", from.step, from.port);
            self.unless_unsure(&from.step, Diagnostic::at(from.span, message).hint(hint));
            return None;
        }
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
            None => Some(Dynamic { source, known: false }),
        }
    }

    fn unused_axes(&self) -> Vec<Diagnostic> {
        // An input that is missing would bring axes with it.
        if self.faults.iter().any(|fault| fault.message.contains("is not given its input")) {
            return Vec::new();
        }
        let used: BTreeSet<usize> = self.reach.iter().flatten().copied().collect();
        let unused = self.document().axes.iter().enumerate().filter(|(index, _)| !used.contains(index));
        let told = |(_, axis): (usize, &Axis)| {
            let name = &axis.name.text;
            let fault = Diagnostic::at(axis.name.span, format!("no step depends on axis `{name}`")).hint(format!(
                "say `over: [{name}]` on the step where it begins, mention ${{{name}}} in a `with`, or remove it"
            ));
            let near = self.parameter_like(name).map(|path| format!("did you mean `{path}`?"));
            near.into_iter().fold(fault, Diagnostic::hint)
        };
        unused.map(told).collect()
    }

    /// The path of a value that an axis of this name may be meant to sweep.
    fn parameter_like(&self, name: &str) -> Option<String> {
        let document = self.document();
        let own = document.params.iter().map(|(key, _)| (key.name.clone(), format!("params.{}", key.name)));
        let steps = document.steps.iter().zip(&self.stages).filter_map(|(step, stage)| Some((step, (*stage)?)));
        let fields = steps.flat_map(|(step, stage)| {
            let path = move |field: &str| format!("steps.{}.with.{field}", step.name.text);
            stage.fields().into_iter().map(move |field| (field.name.to_owned(), path(field.name)))
        });
        let known: Vec<(String, String)> = own.chain(fields).collect();
        let names: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
        let begins = names.iter().find(|known| known.starts_with(&format!("{name}_"))).copied();
        let near = begins.or_else(|| crate::diagnostic::nearest(name, &names))?;
        known.iter().find(|(name, _)| name == near).map(|(_, path)| path.clone())
    }

    fn unused_params(&self) -> Vec<Diagnostic> {
        let document = self.document();
        let mut used = Vec::new();
        document.steps.iter().filter_map(|step| step.with.as_ref()).for_each(|with| mentioned(with, &mut used));
        document.params.iter().for_each(|(_, node)| mentioned(node, &mut used));
        let used = used.iter().map(|(name, _)| name.as_str());
        let used: BTreeSet<&str> = used.chain(document.mentions.iter().map(String::as_str)).collect();
        let unused = document.params.iter().filter(|(key, _)| !used.contains(key.name.as_str()));
        let told = |(key, _): &(Key, Node)| {
            let fault = Diagnostic::at(key.span, format!("nothing mentions parameter `{}`", key.name));
            fault.hint(format!("write ${{{}}} in a `with`, or remove it", key.name))
        };
        unused.map(told).collect()
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
            stage,
            ports,
            folder: self.folder_of(step.name.span),
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
        let field = name.split_once('.').map(|(_, field)| field);
        let own = &axis.name.text;
        let choices = || axis.fields.iter().map(|field| format!("${{{own}.{field}}}")).collect::<Vec<_>>().join(", ");
        match field {
            _ if axis.from.is_some() => None, // Told when the items are known.
            Some(_) if axis.fields.is_empty() => {
                Some((format!("an item of axis `{own}` is a single value"), format!("write ${{{own}}}")))
            }
            Some(field) if !axis.fields.iter().any(|known| known == field) => {
                Some((format!("axis `{own}` has no value `{field}`"), format!("there are {}", choices())))
            }
            None if !axis.fields.is_empty() => {
                Some((format!("an item of axis `{own}` has several values"), format!("name one: {}", choices())))
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

    fn targets(&mut self, steps: &[GraphStep], dynamic: &[Option<Dynamic>], given: &[String]) -> Vec<usize> {
        let declared = self.document().targets.as_deref();
        for word in declared.unwrap_or_default() {
            self.check_target(&word.text, Some(word));
        }
        given.iter().for_each(|name| self.check_target(name, None));
        let names: Vec<&str> = match declared {
            _ if !given.is_empty() => given.iter().map(String::as_str).collect(),
            Some(words) => words.iter().map(|word| word.text.as_str()).collect(),
            None => return unread(steps, dynamic),
        };
        let names: Vec<&str> = names.into_iter().flat_map(|name| self.steps_of_target(name)).collect();
        let numbers: BTreeMap<&str, usize> =
            steps.iter().enumerate().map(|(number, step)| (step.name.as_str(), number)).collect();
        names.iter().filter_map(|name| numbers.get(name).copied()).collect()
    }

    fn used(&self, name: &str) -> Option<&'d Used> {
        self.document().uses.iter().find(|used| used.name == name)
    }

    /// The step that a target names; of a part that is used, the steps that make its outputs.
    fn steps_of_target<'n>(&self, name: &'n str) -> Vec<&'n str>
    where
        'd: 'n,
    {
        let makers = self.used(name).map(|used| used.outputs.values().map(|to| to.step.as_str()).collect());
        makers.unwrap_or_else(|| vec![name])
    }

    /// Outputs of parts that no step reads are looked at too.
    fn check_part_outputs(&mut self) {
        let document = self.document();
        let inputs =
            document.steps.iter().flat_map(|step| step.inputs.iter().flat_map(|(_, input)| input.references()));
        let read: BTreeSet<(&str, &str)> = inputs.map(|to| (to.step.as_str(), to.port.as_str())).collect();
        for to in document.uses.iter().flat_map(|used| used.outputs.values()) {
            let is_there = self.names.steps.contains_key(to.step.as_str());
            if is_there && !read.contains(&(to.step.as_str(), to.port.as_str())) {
                self.source(to);
            }
        }
    }

    fn check_target(&mut self, name: &str, place: Option<&Word>) {
        if self.used(name).is_none()
            && !self.names.steps.contains_key(name)
            && !self.document().unread.steps.contains(name)
        {
            let message = format!("unknown target step `{name}`");
            let fault = place.map_or_else(
                || Diagnostic::general(message.clone()),
                |word| Diagnostic::at(word.span, message.clone()),
            );
            let step = Label::parse(name).map(|label| label.step).filter(|step| self.names.steps.contains_key(step));
            self.faults.push(match step {
                Some(step) => fault.hint(format!("a target is a whole step: write `{step}`")),
                None => self.suggest(fault, name, || self.step_names()),
            });
        }
    }
}

/// Steps that no other reads, but for those that go back along an axis, and that tell the items of none.
fn unread(steps: &[GraphStep], dynamic: &[Option<Dynamic>]) -> Vec<usize> {
    let feeds = steps.iter().flat_map(|step| step.inputs.iter().flat_map(|(_, feed)| feed.forward_sources()));
    let lists = dynamic.iter().flatten().map(|dynamic| &dynamic.source);
    let read: BTreeSet<usize> = feeds.chain(lists).map(|source| source.step).collect();
    (0..steps.len()).filter(|index| !read.contains(index)).collect()
}
