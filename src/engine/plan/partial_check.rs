//! What can still be checked of a pipeline that is wrong, without telling one fault twice: where the axes of a step are
//! not sure, what follows from them is left out, and only parameters that can be filled in are checked.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rockface_cache::Digest;

use super::graph::{Graph, GraphStep};
use super::parameters;
use super::points::{count, points};
use super::resolve::Resolver;
use super::sight::Sight;
use crate::diagnostic::Diagnostic;
use crate::pipeline::{Input, Reference, Step, Word, mentioned, parted};

/// At more points than this, parameters are checked only once the rest is right.
const POINTS_LIMIT: u64 = 100_000;

impl Resolver<'_> {
    /// The faults of steps whose axes are sure.
    pub fn where_sure(&self, faults: Vec<(usize, Diagnostic)>) -> Vec<Diagnostic> {
        if faults.is_empty() {
            return Vec::new();
        }
        let unsure = self.unsure_steps();
        faults.into_iter().filter(|(step, _)| !unsure[*step]).map(|(_, fault)| fault).collect()
    }

    /// Faults of what nothing uses, if all that could use it is read.
    pub fn if_all_is_read(&self, faults: Vec<Diagnostic>) -> Vec<Diagnostic> {
        let unread = &self.names.document.unread;
        let read = unread.steps.is_empty() && unread.axes.is_empty();
        let sure = !faults.is_empty() && read && !self.unsure_steps().contains(&true);
        if sure { faults } else { Vec::new() }
    }

    /// By step: whether it may have other axes than it seems, by something that is not known of it or of what it reads from.
    fn unsure_steps(&self) -> Vec<bool> {
        let steps = &self.names.document.steps;
        let own = |(index, step): (usize, &Step)| {
            self.circling[index] || self.missing_ports(index, step).next().is_some() || self.is_unsure(step)
        };
        let mut unsure: Vec<bool> = steps.iter().enumerate().map(own).collect();
        let mut readers: Vec<Vec<usize>> = vec![Vec::new(); steps.len()];
        for (reader, step) in steps.iter().enumerate() {
            let producers = references(step).filter_map(|to| self.names.steps.get(to.step.as_str()));
            producers.for_each(|producer| readers[*producer].push(reader));
        }
        let mut open: Vec<usize> = (0..steps.len()).filter(|step| unsure[*step]).collect();
        while let Some(step) = open.pop() {
            for reader in &readers[step] {
                if !std::mem::replace(&mut unsure[*reader], true) {
                    open.push(*reader);
                }
            }
        }
        unsure
    }

    fn is_unsure(&self, step: &Step) -> bool {
        let names = &self.names;
        let mut words = Vec::new();
        step.with.iter().for_each(|with| mentioned(with, &mut words));
        let stranger = |name: &str| names.mentioned_axis(name).is_none() && !names.is_param(name);
        let picked = references(step).flat_map(|to| to.picks.iter().map(|(axis, _)| axis));
        let mut axes =
            step.over.iter().chain(step.inputs.iter().flat_map(|(_, input)| input_axes(input))).chain(picked);
        step.gaps.any
            || names.document.unread.zips
            || words.iter().any(|(name, _)| stranger(name))
            || axes.any(|axis| !names.axes.contains_key(axis.text.as_str()))
            || references(step).any(|to| !names.steps.contains_key(to.step.as_str()))
    }

    /// Checks the parameters of every step that can be filled in, and looks for the files of steps that are needed for sure.
    pub fn check_parameters(&mut self, graph: &Graph, targets: &[String]) {
        let needed = self.needed(targets);
        for step in &graph.steps {
            let old = self.names.steps[step.name.as_str()];
            if !self.unfilled[old] && !self.names.document.steps[old].gaps.with {
                self.faults.extend(faults_at_all_points(graph, step, needed.contains(&old)));
            }
        }
    }

    /// Steps that a target needs at one point at least, whatever the items of the axes.
    fn needed(&self, targets: &[String]) -> BTreeSet<usize> {
        let document = self.names.document;
        let number = |name: &str| self.names.steps.get(name).copied();
        let mut open: Vec<usize> = match &document.targets {
            _ if !targets.is_empty() => targets.iter().filter_map(|name| number(name)).collect(),
            Some(words) => words.iter().filter_map(|word| number(&word.text)).collect(),
            None => self.unread_steps(),
        };
        let mut needed = BTreeSet::new();
        while let Some(step) = open.pop() {
            if needed.insert(step) {
                let step = &document.steps[step];
                let plain = step.inputs.iter().flat_map(|(_, input)| match input {
                    Input::Plain(_) => input.references(),
                    Input::Each { reference, paired, .. } => match paired.as_deref() {
                        Some(Input::Plain(list)) => vec![reference, list],
                        _ => vec![reference],
                    },
                    Input::By { .. } | Input::Chain { .. } => Vec::new(),
                });
                let axes = self.names.named_axes(step);
                let lists = axes.iter().filter_map(|axis| document.axes[*axis].from.as_ref());
                open.extend(plain.chain(lists).filter_map(|to| number(&to.step)));
            }
        }
        needed
    }

    /// Steps that no other reads and that tell the items of no axis.
    fn unread_steps(&self) -> Vec<usize> {
        let document = self.names.document;
        let lists = document.axes.iter().filter_map(|axis| axis.from.as_ref());
        let read: BTreeSet<&str> =
            document.steps.iter().flat_map(references).chain(lists).map(|to| to.step.as_str()).collect();
        (0..document.steps.len()).filter(|step| !read.contains(document.steps[*step].name.text.as_str())).collect()
    }
}

fn references(step: &Step) -> impl Iterator<Item = &Reference> {
    step.inputs.iter().flat_map(|(_, input)| input.references())
}

/// The axes an input names, besides those of its picks.
fn input_axes(input: &Input) -> impl Iterator<Item = &Word> {
    let over = if let Input::Each { over, .. } = input { over.as_slice() } else { &[] };
    over.iter().chain(input.choosing_axis())
}

/// What is wrong with the parameters of a step wherever it is needed: the faults that it has at every point.
fn faults_at_all_points(graph: &Graph, step: &GraphStep, with_files: bool) -> Vec<Diagnostic> {
    if count(graph, &step.with_axes) > POINTS_LIMIT {
        return Vec::new();
    }
    let fields = if with_files { step.stage.fields() } else { Vec::new() };
    let sight = Sight::new(&can_be_read);
    let mut common: Option<Vec<Diagnostic>> = None;
    for items in points(graph, &step.with_axes) {
        let items: BTreeMap<usize, usize> = step.with_axes.iter().copied().zip(items).collect();
        if !can_be_filled(graph, step, &items) {
            return Vec::new();
        }
        let here = parameters::check_with_files(graph, step, &items, &fields, &sight);
        let here = here.err().unwrap_or_default();
        let both = match common {
            Some(before) => before.into_iter().filter(|fault| here.contains(fault)).collect(),
            None => here,
        };
        if both.is_empty() {
            return both;
        }
        common = Some(both);
    }
    common.unwrap_or_default()
}

fn can_be_filled(graph: &Graph, step: &GraphStep, items: &BTreeMap<usize, usize>) -> bool {
    let mut names = Vec::new();
    step.with.iter().for_each(|with| mentioned(with, &mut names));
    // A value that a known map lacks is a fault of its own.
    names.iter().all(|(name, _)| parameters::lookup(graph, items, parted(name).0).is_some())
}

/// Stands for the hash of a file where nothing will be run.
fn can_be_read(path: &Path) -> Result<Digest, String> {
    std::fs::File::open(path)
        .map(|_| Digest::of(&[]))
        .map_err(|error| format!("cannot read `{}`: {error}", path.display()))
}
