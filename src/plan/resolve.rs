//! From document to graph: names, ports, cycles and axes, with all faults reported together.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use petgraph::algo::{kosaraju_scc, toposort};
use petgraph::graph::DiGraph;
use rockface_stages::{AnyStage, Arity, Port};

use super::graph::{Feed, Graph, GraphStep, Source};
use super::{Registry, values};
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::pipeline::{Document, Input, Node, Pipeline, Reference, Step, Word, mentioned};

/// Resolves a pipeline; `targets` on the command line take the place of the document's.
pub fn resolve(pipeline: &Pipeline, targets: &[String], stages: &Registry) -> Result<Graph, Diagnostics> {
    let document = &pipeline.document;
    let mut resolver = Resolver::new(document, stages);
    resolver.check_names();
    let order = resolver.order();
    let graph = order.map(|order| resolver.build(&order, pipeline, targets));
    match graph {
        Some(graph) if resolver.faults.is_empty() => Ok(graph),
        _ => Err(Diagnostics { sources: pipeline.sources.clone(), list: resolver.faults }),
    }
}

struct Resolver<'d> {
    document: &'d Document,
    steps: HashMap<&'d str, usize>,
    axes: HashMap<&'d str, usize>,
    registry: &'d Registry,
    stages: Vec<Option<&'static dyn AnyStage>>,
    faults: Vec<Diagnostic>,
}

impl<'d> Resolver<'d> {
    fn new(document: &'d Document, registry: &'d Registry) -> Self {
        let steps = document.steps.iter().enumerate().map(|(i, step)| (step.name.text.as_str(), i)).collect();
        let axes = document.axes.iter().enumerate().map(|(i, axis)| (axis.name.text.as_str(), i)).collect();
        let stages =
            document.steps.iter().map(|step| registry.iter().copied().find(|s| s.name() == step.stage.text)).collect();
        Self { document, steps, axes, registry, stages, faults: Vec::new() }
    }

    fn step_names(&self) -> Vec<&'d str> {
        self.document.steps.iter().map(|step| step.name.text.as_str()).collect()
    }

    fn axis_names(&self) -> Vec<&'d str> {
        self.document.axes.iter().map(|axis| axis.name.text.as_str()).collect()
    }

    fn check_names(&mut self) {
        for (step, stage) in self.document.steps.iter().zip(&self.stages) {
            if stage.is_none() {
                let known = self.registry.iter().map(|stage| stage.name());
                let fault = Diagnostic::at(step.stage.span, format!("unknown stage `{}`", step.stage.text));
                self.faults.push(fault.suggest(&step.stage.text, known));
            }
        }
        for (key, _) in &self.document.params {
            if self.axes.contains_key(key.name.as_str()) {
                let message = format!("`{}` is both a parameter and an axis", key.name);
                self.faults.push(Diagnostic::at(key.span, message).hint("rename one: ${name} would be ambiguous"));
            }
        }
    }

    fn axis(&mut self, word: &Word) -> Option<usize> {
        let found = self.axes.get(word.text.as_str()).copied();
        if found.is_none() {
            let fault = Diagnostic::at(word.span, format!("unknown axis `{}`", word.text));
            let fault = if self.axes.is_empty() {
                fault.hint("declare it under `axes:`")
            } else {
                fault.suggest(&word.text, self.axis_names())
            };
            self.faults.push(fault);
        }
        found
    }

    fn item(&mut self, axis: usize, word: &Word, item: &str) -> Option<usize> {
        let declared = &self.document.axes[axis];
        let found = declared.items.iter().position(|known| known == item);
        if found.is_none() {
            let message = format!("`{item}` is no item of axis `{}`", declared.name.text);
            self.faults
                .push(Diagnostic::at(word.span, message).suggest(item, declared.items.iter().map(String::as_str)));
        }
        found
    }

    /// Document indices of the steps, producers first; `None` on a cycle.
    fn order(&mut self) -> Option<Vec<usize>> {
        let mut arrows = DiGraph::<usize, ()>::new();
        let nodes: Vec<_> = (0..self.document.steps.len()).map(|i| arrows.add_node(i)).collect();
        for (consumer, step) in self.document.steps.iter().enumerate() {
            for reference in step.inputs.iter().flat_map(|(_, input)| input.references()) {
                if let Some(producer) = self.steps.get(reference.step.as_str()) {
                    arrows.update_edge(nodes[*producer], nodes[consumer], ());
                }
            }
        }
        if let Ok(order) = toposort(&arrows, None) {
            return Some(order.into_iter().map(|node| arrows[node]).collect());
        }
        for component in kosaraju_scc(&arrows) {
            let alone = component.len() == 1 && !arrows.contains_edge(component[0], component[0]);
            if !alone {
                let members: BTreeSet<usize> = component.into_iter().map(|node| arrows[node]).collect();
                self.report_cycle(&members);
            }
        }
        None
    }

    fn report_cycle(&mut self, members: &BTreeSet<usize>) {
        let name = |i: &usize| self.document.steps[*i].name.text.as_str();
        let names: Vec<&str> = members.iter().map(name).collect();
        let Some(first) = members.first().map(|i| &self.document.steps[*i]) else { return };
        let back = first.inputs.iter().flat_map(|(_, input)| input.references());
        let back = back.into_iter().find(|r| names.contains(&r.step.as_str())).map_or(first.name.span, |r| r.span);
        let message = format!("these steps wait for each other in a circle: {}", names.join(", "));
        self.faults.push(
            Diagnostic::at(back, message)
                .label("needs what comes after it")
                .hint("let one of them read from a step outside the circle"),
        );
    }

    fn build(&mut self, order: &[usize], pipeline: &Pipeline, targets: &[String]) -> Graph {
        let document = self.document;
        let mut position = vec![0; order.len()];
        for (new, old) in order.iter().enumerate() {
            position[*old] = new;
        }
        let mut steps: Vec<GraphStep> = Vec::with_capacity(order.len());
        let mut slots: Vec<Option<usize>> = vec![None; order.len()];
        for old in order {
            if let Some(step) = self.step(&document.steps[*old], *old, &steps, &slots) {
                slots[*old] = Some(steps.len());
                steps.push(step);
            }
        }
        let targets = self.targets(&steps, targets);
        let (params, faults) = values::resolve(&document.params, &self.axis_names());
        self.faults.extend(faults);
        self.unused_axes(&steps);
        self.unused_params(&steps);
        Graph {
            name: document.name.clone(),
            seed: document.seed,
            folder: pipeline.folder.clone(),
            params,
            axes: document.axes.clone(),
            steps,
            targets,
        }
    }

    fn unused_axes(&mut self, steps: &[GraphStep]) {
        if !self.faults.is_empty() {
            return;
        }
        let used: BTreeSet<usize> = steps.iter().flat_map(|step| step.axes.iter().copied()).collect();
        for (index, axis) in self.document.axes.iter().enumerate().filter(|(index, _)| !used.contains(index)) {
            let name = &self.document.axes[index].name.text;
            self.faults.push(Diagnostic::at(axis.name.span, format!("no step depends on axis `{name}`")).hint(
                format!(
                    "say `over: [{name}]` on the step where it begins, mention ${{{name}}} in a `with`, or remove it"
                ),
            ));
        }
    }

    fn unused_params(&mut self, steps: &[GraphStep]) {
        if !self.faults.is_empty() {
            return;
        }
        let mut used = Vec::new();
        steps.iter().filter_map(|step| step.with.as_ref()).for_each(|with| mentioned(with, &mut used));
        self.document.params.iter().for_each(|(_, node)| mentioned(node, &mut used));
        let used: BTreeSet<&str> = used.iter().map(|(name, _)| name.as_str()).collect();
        for (key, _) in self.document.params.iter().filter(|(key, _)| !used.contains(key.name.as_str())) {
            let fault = Diagnostic::at(key.span, format!("nothing mentions parameter `{}`", key.name));
            self.faults.push(fault.hint(format!("write ${{{}}} in a `with`, or remove it", key.name)));
        }
    }

    fn step(&mut self, step: &Step, old: usize, done: &[GraphStep], slots: &[Option<usize>]) -> Option<GraphStep> {
        let stage = self.stages[old]?;
        let mut axes = BTreeSet::new();
        let with_axes = step.with.as_ref().map(|with| self.mentioned_axes(with)).unwrap_or_default();
        axes.extend(with_axes.iter().copied());
        axes.extend(step.over.iter().filter_map(|word| self.axis(word)).collect::<Vec<_>>());
        let mut inputs = Vec::new();
        for (port, input) in &step.inputs {
            let feed = self.feed(input, done, slots);
            let Some(declared) = self.port(stage, step, port) else { continue };
            let Some(feed) = feed else { continue };
            self.check_kinds(declared, input, &feed, done);
            self.propagate(input, &feed, done, &mut axes);
            inputs.push((declared, feed));
        }
        self.check_missing_ports(stage, step);
        inputs.sort_by_key(|(port, _)| stage.inputs().iter().position(|p| p.name == port.name));
        let axes: Vec<usize> = axes.into_iter().collect();
        let (stream, stream_axes) = self.stream(step, &axes);
        Some(GraphStep {
            name: step.name.text.clone(),
            span: step.name.span,
            stage,
            with: step.with.clone(),
            inputs,
            axes,
            with_axes,
            keep: step.keep,
            stream,
            stream_axes,
        })
    }

    fn mentioned_axes(&mut self, with: &Node) -> Vec<usize> {
        let mut names = Vec::new();
        mentioned(with, &mut names);
        let mut axes = BTreeSet::new();
        for (name, span) in names {
            if let Some(axis) = self.axes.get(name.as_str()) {
                axes.insert(*axis);
            } else if !self.document.params.iter().any(|(key, _)| key.name == name) {
                let known: Vec<&str> =
                    self.document.params.iter().map(|(key, _)| key.name.as_str()).chain(self.axis_names()).collect();
                let message = format!("`${{{name}}}` names neither a parameter nor an axis");
                self.faults.push(Diagnostic::at(span, message).suggest(&name, known));
            }
        }
        axes.into_iter().collect()
    }

    fn feed(&mut self, input: &Input, done: &[GraphStep], slots: &[Option<usize>]) -> Option<Feed> {
        match input {
            Input::Plain(reference) => self.source(reference, done, slots).map(Feed::Plain),
            Input::Each { reference, over } => {
                let source = self.source(reference, done, slots);
                let over: Vec<Option<usize>> = over.iter().map(|word| self.axis(word)).collect();
                Some(Feed::Each { source: source?, over: over.into_iter().collect::<Option<_>>()? })
            }
            Input::By { axis, cases } => {
                let sources: BTreeMap<usize, Option<Source>> = self.cases(axis, cases, done, slots)?;
                let cases = sources.into_values().collect::<Option<Vec<_>>>()?;
                Some(Feed::By { axis: *self.axes.get(axis.text.as_str())?, cases })
            }
        }
    }

    fn cases(
        &mut self,
        axis: &Word,
        cases: &[(Word, Reference)],
        done: &[GraphStep],
        slots: &[Option<usize>],
    ) -> Option<BTreeMap<usize, Option<Source>>> {
        let index = self.axis(axis)?;
        let mut sources = BTreeMap::new();
        for (word, reference) in cases {
            let source = self.source(reference, done, slots);
            if let Some(item) = self.item(index, word, &word.text) {
                sources.insert(item, source);
            }
        }
        let items = &self.document.axes[index].items;
        let missing: Vec<&str> =
            (0..items.len()).filter(|i| !sources.contains_key(i)).map(|i| items[i].as_str()).collect();
        if !missing.is_empty() {
            let message = format!("choosing by `{}` leaves out {}", axis.text, missing.join(", "));
            self.faults.push(Diagnostic::at(axis.span, message).hint("say where the input comes from at every item"));
            return None;
        }
        Some(sources)
    }

    fn source(&mut self, reference: &Reference, done: &[GraphStep], slots: &[Option<usize>]) -> Option<Source> {
        let Some(old) = self.steps.get(reference.step.as_str()).copied() else {
            let fault = Diagnostic::at(reference.span, format!("unknown step `{}`", reference.step));
            self.faults.push(fault.suggest(&reference.step, self.step_names()));
            return None;
        };
        let picks: Vec<_> = reference
            .picks
            .iter()
            .map(|(axis, item)| {
                let index = self.axis(axis)?;
                Some((index, self.item(index, axis, item)?))
            })
            .collect();
        let stage = self.stages[old]?;
        let Some(port) = stage.outputs().iter().find(|port| port.name == reference.port) else {
            let message = format!("step `{}` ({}) has no output `{}`", reference.step, stage.name(), reference.port);
            let known = stage.outputs().iter().map(|port| port.name);
            self.faults.push(Diagnostic::at(reference.span, message).suggest(&reference.port, known));
            return None;
        };
        let step = slots[old]?;
        self.check_optional_output(reference, port, &done[step]);
        let source = Source { step, port, picks: picks.into_iter().collect::<Option<_>>()? };
        self.check_picks(reference, &source, &done[step]).then_some(source)
    }

    fn check_optional_output(&mut self, reference: &Reference, port: &Port, step: &GraphStep) {
        if port.arity == Arity::Optional && !step.inputs.iter().any(|(given, _)| given.name == port.name) {
            let message = format!("step `{}` makes no `{}`", step.name, port.name);
            let hint = format!("it is made when the step is given an input `{}`", port.name);
            self.faults.push(Diagnostic::at(reference.span, message).hint(hint));
        }
    }

    fn check_picks(&mut self, reference: &Reference, source: &Source, step: &GraphStep) -> bool {
        let stray = source.picks.iter().find(|(axis, _)| !step.axes.contains(axis));
        if let Some((axis, _)) = stray {
            let axis = &self.document.axes[*axis].name.text;
            let message = format!("step `{}` does not depend on axis `{axis}`", step.name);
            self.faults.push(Diagnostic::at(reference.span, message).hint(format!("leave [{axis}=…] out")));
        }
        stray.is_none()
    }

    fn port(&mut self, stage: &'static dyn AnyStage, step: &Step, port: &Word) -> Option<&'static Port> {
        let found = stage.inputs().iter().find(|declared| declared.name == port.text);
        if found.is_none() {
            let message = format!("stage `{}` (step `{}`) has no input `{}`", stage.name(), step.name.text, port.text);
            let known = stage.inputs().iter().map(|port| port.name);
            self.faults.push(Diagnostic::at(port.span, message).suggest(&port.text, known));
        }
        found
    }

    fn check_missing_ports(&mut self, stage: &'static dyn AnyStage, step: &Step) {
        let given = |port: &Port| step.inputs.iter().any(|(word, _)| word.text == port.name);
        for port in stage.inputs().iter().filter(|port| port.arity != Arity::Optional && !given(port)) {
            let message = format!("step `{}` is not given its input `{}` ({})", step.name.text, port.name, kinds(port));
            self.faults.push(Diagnostic::at(step.stage.span, message).hint(port.doc));
        }
    }

    fn check_kinds(&mut self, port: &Port, input: &Input, feed: &Feed, done: &[GraphStep]) {
        for (source, reference) in feed.sources().iter().zip(self.references(input)) {
            if let Some(kind) = source.port.kinds.first().filter(|kind| !port.kinds.contains(kind)) {
                let step = &done[source.step];
                let message = format!(
                    "input `{}` takes a {}, but `{}.{}` is a {kind}",
                    port.name,
                    kinds(port),
                    step.name,
                    source.port.name
                );
                let fits: Vec<String> = step
                    .stage
                    .outputs()
                    .iter()
                    .filter(|p| port.kinds.contains(&p.kinds[0]))
                    .map(|p| format!("{}.{}", step.name, p.name))
                    .collect();
                let fault = Diagnostic::at(reference.span, message);
                self.faults.push(if fits.is_empty() {
                    fault
                } else {
                    fault.hint(format!("did you mean `{}`?", fits.join("` or `")))
                });
            }
        }
        if let (Input::Each { reference, .. }, true) = (input, port.arity != Arity::Many) {
            let message = format!("input `{}` takes one {}, not a gathered list", port.name, kinds(port));
            self.faults.push(Diagnostic::at(reference.span, message));
        }
    }

    /// The references of an input in the order of its sources: those of a choice follow the items of its axis.
    fn references<'i>(&self, input: &'i Input) -> Vec<&'i Reference> {
        let Input::By { axis, cases } = input else { return input.references() };
        let items = self.axes.get(axis.text.as_str()).map(|axis| self.document.axes[*axis].items.as_slice());
        let of_item = |item: &String| cases.iter().find(|(word, _)| word.text == *item).map(|(_, reference)| reference);
        items.unwrap_or_default().iter().filter_map(of_item).collect()
    }

    fn propagate(&mut self, input: &Input, feed: &Feed, done: &[GraphStep], axes: &mut BTreeSet<usize>) {
        if let Feed::By { axis, .. } = feed {
            axes.insert(*axis);
        }
        let gathered: &[usize] = if let Feed::Each { over, .. } = feed { over } else { &[] };
        for source in feed.sources() {
            let step = &done[source.step];
            let free = |axis: &usize| !source.picks.iter().any(|(picked, _)| picked == axis);
            axes.extend(step.axes.iter().copied().filter(|axis| free(axis) && !gathered.contains(axis)));
            let lacking = gathered.iter().find(|axis| !step.axes.contains(axis) || !free(axis));
            if let (Some(axis), Input::Each { reference, .. }) = (lacking, input) {
                let axis = &self.document.axes[*axis].name.text;
                let message = format!(
                    "`{}.{}` cannot be gathered over `{axis}`: it does not depend on it",
                    step.name, source.port.name
                );
                self.faults.push(Diagnostic::at(reference.span, message));
            }
        }
    }

    fn stream(&mut self, step: &Step, axes: &[usize]) -> (String, Vec<usize>) {
        let label = step.stream.as_ref().and_then(|stream| stream.label.as_ref()).unwrap_or(&step.name);
        let reseeding = |axis: &usize| self.document.axes[*axis].reseeds;
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
                    self.faults.push(Diagnostic::at(word.span, message));
                }
                None => {}
            }
        }
        (label.text.clone(), narrowed.into_iter().collect())
    }

    fn targets(&mut self, steps: &[GraphStep], given: &[String]) -> Vec<usize> {
        let declared = self.document.targets.as_deref();
        for word in declared.unwrap_or_default() {
            self.check_target(&word.text, Some(word));
        }
        given.iter().for_each(|name| self.check_target(name, None));
        let names: Vec<&str> = match declared {
            _ if !given.is_empty() => given.iter().map(String::as_str).collect(),
            Some(words) => words.iter().map(|word| word.text.as_str()).collect(),
            None => return unread(steps),
        };
        names.iter().filter_map(|name| steps.iter().position(|step| step.name == *name)).collect()
    }

    fn check_target(&mut self, name: &str, place: Option<&Word>) {
        if !self.steps.contains_key(name) {
            let message = format!("unknown target step `{name}`");
            let fault = place.map_or_else(
                || Diagnostic::general(message.clone()),
                |word| Diagnostic::at(word.span, message.clone()),
            );
            self.faults.push(fault.suggest(name, self.step_names()));
        }
    }
}

/// Steps that no other reads.
fn unread(steps: &[GraphStep]) -> Vec<usize> {
    let feeds = steps.iter().flat_map(|step| step.inputs.iter().flat_map(|(_, feed)| feed.sources()));
    let read: BTreeSet<usize> = feeds.map(|source| source.step).collect();
    (0..steps.len()).filter(|index| !read.contains(index)).collect()
}

fn kinds(port: &Port) -> String {
    port.kinds.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or ")
}
