//! What feeds each input port: finds references, checks kinds, and separates picked and gathered axes from free ones.

use std::collections::BTreeMap;

use rockface_core::artefact::Kind;
use rockface_core::{Arity, Port};

use super::graph::{Feed, Later, Source};
use super::resolve::Resolver;
use crate::diagnostic::{Diagnostic, listed, nearest};
use crate::pipeline::{Input, Reference, Step, Word};

/// Stands for all items a choice does not name.
const ELSE: &str = "else";

/// An item that a reference picks: one that is known, by axis and number, or one of an axis whose items a step makes.
enum Pick {
    Item(usize, usize),
    Later(Later),
}

impl Resolver<'_> {
    /// The feeds of all given ports of a step, in the stage's order of ports.
    pub fn inputs(&mut self, step: &Step, own: usize) -> Vec<(&'static Port, Feed)> {
        let mut inputs = Vec::with_capacity(step.inputs.len());
        for (port, input) in &step.inputs {
            let feed = self.feed(input, own);
            let Some(declared) = self.port(own, step, port) else { continue };
            let Some(feed) = feed else { continue };
            self.check_kinds(declared, input, &feed);
            inputs.push((declared, feed));
        }
        self.check_missing_ports(own, step);
        let Some(ports) = self.ports[own] else { return Vec::new() };
        inputs.sort_by_key(|(port, _)| ports.inputs.iter().position(|p| p.name == port.name));
        inputs
    }

    fn feed(&mut self, input: &Input, own: usize) -> Option<Feed> {
        match input {
            Input::Plain(reference) => self.source(reference).map(Feed::Plain),
            Input::Each { reference, over, paired } => {
                let source = self.source(reference);
                let list = paired.as_deref().map(|list| self.list_of_pairs(list, over, own));
                let over: Vec<Option<usize>> = over.iter().map(|word| self.axis(word)).collect();
                let (source, over) = (source?, over.into_iter().collect::<Option<Vec<_>>>()?);
                let paired = match list {
                    Some(list) => Some(Box::new(list?)),
                    None => None,
                };
                self.check_gathered(reference, &source, &over).then(|| {
                    let over = self.with_mates(source.step, over);
                    Feed::Each { source, over, paired }
                })
            }
            Input::By { axis, cases } => self.choice(axis, cases),
            Input::Chain { reference, axis, first } => self.chain(reference, axis, first.as_deref()),
        }
    }

    /// The list that tells which items of an axis a step reads.
    fn list_of_pairs(&mut self, list: &Input, over: &[Word], own: usize) -> Option<Feed> {
        let feed = self.feed(list, own)?;
        let before = self.faults.len();
        for (source, reference) in feed.sources().into_iter().zip(self.references(list)) {
            let kind = source.port.kinds[0];
            let maker = &self.names.document.steps[self.names.steps[reference.step.as_str()]];
            if kind != Kind::Pairs {
                let message = format!("`{}.{}` is a {kind}, not a list of pairs", reference.step, reference.port);
                let hint = "the pairs of a block of images are made by `select-pairs`";
                self.faults.push(Diagnostic::at(reference.span, message).hint(hint));
            } else if !maker.keep {
                let message = format!("the pairs are read from the store, and `{}` is not kept", reference.step);
                let hint = format!("remove `keep: false` from step `{}`", reference.step);
                self.faults.push(Diagnostic::at(reference.span, message).hint(hint));
            }
        }
        let step = &self.names.document.steps[own].name.text;
        if let [_, second, ..] = over {
            let message = "a list of pairs tells the items of one axis";
            self.faults.push(Diagnostic::at(second.span, message).hint("gather over that axis alone"));
        } else if let Some(word) = over.first()
            && let Some(axis) = self.axis(word)
            && !self.position_axes(self.place[own]).contains(&axis)
        {
            let axis = &word.text;
            let message = format!("step `{step}` has no item of axis `{axis}` that pairs could be of");
            let fault = Diagnostic::at(word.span, message);
            self.unless_unsure(step, fault.hint(format!("mention ${{{axis}}} in its `with`, or say `over: [{axis}]`")));
        }
        (self.faults.len() == before).then_some(feed)
    }

    fn chain(&mut self, reference: &Reference, word: &Word, first: Option<&Reference>) -> Option<Feed> {
        let axis = self.axis(word);
        let source = self.source(reference);
        let first = first.map(|first| self.source(first));
        let (axis, source) = (axis?, source?);
        let reached = self.position_axes(source.step);
        if !reached.contains(&axis) {
            let message = format!("step `{}` does not depend on axis `{}`", reference.step, word.text);
            let fault = Diagnostic::at(reference.span, message).hint(format!("leave [{}=prev] out", word.text));
            self.unless_unsure(&reference.step, fault);
            return None;
        }
        let first = match first {
            Some(None) => return None,
            Some(Some(first)) => Some(Box::new(first)),
            None => None,
        };
        Some(Feed::Chain { source, axis, first })
    }

    fn choice(&mut self, axis: &Word, cases: &[(Word, Reference)]) -> Option<Feed> {
        let Some(index) = self.axis(axis) else {
            cases.iter().for_each(|(_, reference)| drop(self.source(reference)));
            return None;
        };
        let (others, named): (Vec<_>, Vec<_>) = cases.iter().partition(|(word, _)| self.is_other(index, word));
        let other = others.first().map(|(_, reference)| self.source(reference));
        let named: Vec<_> = named.into_iter().map(|(word, reference)| (word, self.source(reference))).collect();
        let other = match other {
            Some(None) => return None,
            Some(Some(source)) => Some(source),
            None => None,
        };
        if self.names.document.axes[index].from.is_some() {
            let named = named.into_iter().map(|(word, source)| Some((word.clone(), source?)));
            return Some(Feed::By {
                axis: index,
                cases: Vec::new(),
                named: named.collect::<Option<_>>()?,
                other: other.map(Box::new),
            });
        }
        let cases = self.cases(axis, index, named, other.as_ref())?;
        Some(Feed::By { axis: index, cases, named: Vec::new(), other: None })
    }

    /// Whether a case stands for all items that are not named: `else`, unless an item is called so.
    fn is_other(&self, axis: usize, word: &Word) -> bool {
        word.text == ELSE && self.names.item(axis, ELSE).is_none()
    }

    /// The source of every item.
    fn cases(
        &mut self,
        axis: &Word,
        index: usize,
        named: Vec<(&Word, Option<Source>)>,
        other: Option<&Source>,
    ) -> Option<Vec<Source>> {
        let mut sources = BTreeMap::new();
        let by_parameters = self.names.document.axes[index].by_parameters;
        for (word, source) in named {
            // What the axis has for another value of a parameter is chosen then.
            if by_parameters && self.names.item(index, &word.text).is_none() {
                continue;
            }
            if let Some(item) = self.item(index, word, &word.text) {
                sources.insert(item, source);
            }
        }
        let items = &self.names.document.axes[index].items;
        let missing: Vec<usize> = (0..items.len()).filter(|item| !sources.contains_key(item)).collect();
        if let Some(other) = other {
            sources.extend(missing.into_iter().map(|item| (item, Some(other.clone()))));
        } else if !missing.is_empty() {
            let missing = missing.into_iter().map(|item| items[item].as_str());
            let message = format!("choosing by `{}` leaves out {}", axis.text, listed(missing));
            let hint = "say where the input comes from at every item, or add `else: step.port`";
            self.faults.push(Diagnostic::at(axis.span, message).hint(hint));
            return None;
        }
        sources.into_values().collect()
    }

    /// The output a reference names.
    pub fn source(&mut self, reference: &Reference) -> Option<Source> {
        let Some(old) = self.names.steps.get(reference.step.as_str()).copied() else {
            if self.names.document.unread.steps.contains(&reference.step) {
                return None;
            }
            let fault = Diagnostic::at(reference.span, format!("unknown step `{}`", reference.step));
            let known = self.names.document.steps.iter().map(|step| step.name.text.as_str());
            self.faults.push(self.suggest(fault, &reference.step, || known));
            return None;
        };
        let picks: Vec<_> = reference.picks.iter().map(|(axis, item)| self.pick(axis, item)).collect();
        let picks = picks.into_iter().collect::<Option<Vec<_>>>();
        let (stage, ports) = (self.stages[old]?, self.ports[old]?);
        let Some(port) = ports.outputs.iter().find(|port| port.name == reference.port) else {
            let message = format!("step `{}` ({}) has no output `{}`", reference.step, stage.name(), reference.port);
            let known = ports.outputs.iter().map(|port| port.name);
            self.faults.push(self.suggest(Diagnostic::at(reference.span, message), &reference.port, || known));
            return None;
        };
        self.check_optional_output(reference, port, old);
        let (mut now, mut later) = (Vec::new(), Vec::new());
        for pick in picks? {
            match pick {
                Pick::Item(axis, item) => now.push((axis, item)),
                Pick::Later(pick) => later.push(pick),
            }
        }
        let source = Source { step: self.place[old], port, picks: now, later };
        self.check_picks(reference, &source).then(|| self.spread_picks(source))
    }

    fn pick(&mut self, word: &Word, item: &str) -> Option<Pick> {
        let axis = self.axis(word)?;
        if self.names.document.axes[axis].from.is_some() {
            let item = Word { span: word.span, text: item.to_owned() };
            return Some(Pick::Later(Later { axis, item, mates: Vec::new() }));
        }
        Some(Pick::Item(axis, self.item(axis, word, item)?))
    }

    /// A pick on one axis is a pick on all that are walked with it.
    fn spread_picks(&self, mut source: Source) -> Source {
        let reached = self.position_axes(source.step);
        for (axis, item) in source.picks.clone() {
            let mates = reached.iter().filter(|other| self.names.together(axis, **other));
            let new: Vec<usize> =
                mates.copied().filter(|mate| source.picks.iter().all(|(picked, _)| picked != mate)).collect();
            source.picks.extend(new.into_iter().map(|mate| (mate, item)));
        }
        for later in &mut source.later {
            let mates = reached.iter().copied().filter(|other| self.names.together(later.axis, *other));
            later.mates = mates.filter(|mate| *mate != later.axis).collect();
        }
        source
    }

    /// The axes gathered over, with those of the producer that are walked with them.
    fn with_mates(&self, step: usize, over: Vec<usize>) -> Vec<usize> {
        let reached = self.position_axes(step);
        let mates = reached.iter().copied().filter(|axis| over.iter().any(|own| self.names.together(*own, *axis)));
        let more: Vec<usize> = mates.filter(|axis| !over.contains(axis)).collect();
        over.into_iter().chain(more).collect()
    }

    fn check_optional_output(&mut self, reference: &Reference, port: &Port, old: usize) {
        let Step { inputs: given, gaps, .. } = &self.names.document.steps[old];
        if port.arity == Arity::Optional && !gaps.inputs && !given.iter().any(|(given, _)| given.text == port.name) {
            let message = format!("step `{}` makes no `{}`", reference.step, port.name);
            let hint = format!("it is made when the step is given an input `{}`", port.name);
            self.faults.push(Diagnostic::at(reference.span, message).hint(hint));
        }
    }

    fn check_picks(&mut self, reference: &Reference, source: &Source) -> bool {
        let reached = self.position_axes(source.step);
        let mut picked = source.picks.iter().map(|(axis, _)| *axis).chain(source.later.iter().map(|later| later.axis));
        let stray = picked.find(|axis| !reached.contains(axis));
        if let Some(axis) = stray {
            let axis = &self.names.document.axes[axis].name.text;
            let message = format!("step `{}` does not depend on axis `{axis}`", reference.step);
            let fault = Diagnostic::at(reference.span, message).hint(format!("leave [{axis}=…] out"));
            self.unless_unsure(&reference.step, fault);
        }
        stray.is_none()
    }

    fn check_gathered(&mut self, reference: &Reference, source: &Source, over: &[usize]) -> bool {
        let reached = self.position_axes(source.step);
        let lacking = over.iter().find(|axis| !reached.contains(axis) || source.picks_of(**axis));
        if let Some(axis) = lacking {
            let axis = &self.names.document.axes[*axis].name.text;
            let message = format!(
                "`{}.{}` cannot be gathered over `{axis}`: it does not depend on it",
                reference.step, source.port.name
            );
            self.unless_unsure(&reference.step, Diagnostic::at(reference.span, message));
        }
        lacking.is_none()
    }

    fn port(&mut self, own: usize, step: &Step, port: &Word) -> Option<&'static Port> {
        let (stage, ports) = (self.stages[own]?, self.ports[own]?);
        let found = ports.inputs.iter().find(|declared| declared.name == port.text);
        if found.is_none() {
            let message = format!("stage `{}` (step `{}`) has no input `{}`", stage.name(), step.name.text, port.text);
            let known = ports.inputs.iter().map(|port| port.name);
            let mut missing = self.missing_ports(own, step);
            let fault = match (missing.next(), missing.next()) {
                (Some(only), None) if nearest(&port.text, &[only.name]).is_none() => {
                    let hint = format!("its input `{}` ({}) is not given: is that meant?", only.name, kinds(only));
                    Diagnostic::at(port.span, message).hint(hint)
                }
                _ => self.suggest(Diagnostic::at(port.span, message), &port.text, || known),
            };
            self.faults.push(fault);
        }
        found
    }

    /// Inputs that a step needs and is not given.
    pub fn missing_ports<'s>(&self, own: usize, step: &'s Step) -> impl Iterator<Item = &'static Port> + use<'s> {
        let ports = self.ports[own].map_or(&[][..], |ports| ports.inputs);
        let given = |port: &Port| step.inputs.iter().any(|(word, _)| word.text == port.name);
        let needed = |port: &&Port| port.arity != Arity::Optional && !step.gaps.inputs;
        ports.iter().filter(needed).filter(move |port| !given(port))
    }

    fn check_missing_ports(&mut self, own: usize, step: &Step) {
        let Some(ports) = self.ports[own] else { return };
        // An input under another name is reported where it stands.
        if step.inputs.iter().any(|(word, _)| !ports.inputs.iter().any(|port| port.name == word.text)) {
            return;
        }
        for port in self.missing_ports(own, step).collect::<Vec<_>>() {
            let message = format!("step `{}` is not given its input `{}` ({})", step.name.text, port.name, kinds(port));
            self.faults.push(Diagnostic::at(step.stage.span, message).hint(port.doc));
        }
    }

    /// Holds what is fed into parts against the kinds of artefact that they take.
    pub fn check_part_inputs(&mut self) {
        for check in &self.names.document.checks {
            for reference in &check.given {
                let Some(old) = self.names.steps.get(reference.step.as_str()) else { continue };
                let ports = self.ports[*old].map_or(&[][..], |ports| ports.outputs);
                let Some(made) = ports.iter().find(|port| port.name == reference.port) else { continue };
                if made.kinds.iter().any(|kind| check.input.kinds.contains(kind)) {
                    continue;
                }
                let (name, takes) = (&check.input.name.text, check.input.kind_words());
                let given = format!("`{}.{}` is a {}", reference.step, reference.port, made.kinds[0]);
                let message = format!("part `{}` takes a {takes} as `{name}`, but {given}", check.part);
                let fault = Diagnostic::at(reference.span, message).also(check.input.name.span, "it is declared here");
                self.misfed.insert(reference.span);
                self.faults.push(fault);
            }
        }
    }

    fn check_kinds(&mut self, port: &Port, input: &Input, feed: &Feed) {
        let references = self.references(input);
        // What does not fit a part does not fit its steps either.
        let told = |reference: &&Reference| self.misfed.contains(&reference.span);
        if references.iter().any(told) {
            return;
        }
        for (source, reference) in feed.sources().into_iter().zip(references) {
            if let Some(kind) = source.port.kinds.first().filter(|kind| !port.kinds.contains(kind)) {
                let name = &reference.step;
                let (takes, made) = (kinds(port), source.port.name);
                let message = format!("input `{}` takes a {takes}, but `{name}.{made}` is a {kind}", port.name);
                let ports = self.names.steps.get(name.as_str()).and_then(|old| self.ports[*old]);
                let outputs = ports.map_or(&[][..], |ports| ports.outputs);
                let fits = outputs.iter().filter(|p| port.kinds.contains(&p.kinds[0]));
                let fits: Vec<String> = fits.map(|p| format!("{name}.{}", p.name)).collect();
                let fault = Diagnostic::at(reference.span, message);
                self.faults.push(if fits.is_empty() {
                    fault
                } else {
                    fault.hint(format!("did you mean `{}`?", fits.join("` or `")))
                });
            }
        }
        match input {
            Input::Each { reference, .. } if port.arity != Arity::Many => {
                let message = format!("input `{}` takes one {}, not a gathered list", port.name, kinds(port));
                self.faults.push(Diagnostic::at(reference.span, message));
            }
            Input::Chain { reference, first: None, .. } if port.arity != Arity::Optional => {
                let message = format!("input `{}` cannot be left out at the first item", port.name);
                self.faults.push(Diagnostic::at(reference.span, message).hint("give another output as `first`"));
            }
            _ => {}
        }
    }

    /// The references of an input in the order of its sources: those of a choice follow the items of its axis.
    fn references<'i>(&self, input: &'i Input) -> Vec<&'i Reference> {
        let (axis, cases) = match input {
            Input::By { axis, cases } => (axis, cases),
            // The list of pairs has been looked at by itself.
            Input::Each { reference, .. } => return vec![reference],
            Input::Plain(_) | Input::Chain { .. } => return input.references(),
        };
        let Some(index) = self.names.axes.get(axis.text.as_str()).copied() else { return Vec::new() };
        let (others, named): (Vec<_>, Vec<_>) = cases.iter().partition(|(word, _)| self.is_other(index, word));
        let other = others.first().map(|(_, reference)| reference);
        let own = &self.names.document.axes[index];
        if own.from.is_some() {
            return named.into_iter().map(|(_, reference)| reference).chain(other).collect();
        }
        let cases: BTreeMap<&str, &Reference> =
            named.into_iter().rev().map(|(word, reference)| (word.text.as_str(), reference)).collect();
        own.items.iter().filter_map(|item| cases.get(item.as_str()).copied().or(other)).collect()
    }
}

fn kinds(port: &Port) -> String {
    port.kinds.iter().map(ToString::to_string).collect::<Vec<_>>().join(" or ")
}
