//! Which axes each step depends on: those it names, and those that reach it along the arrows.

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};

use crate::pipeline::{Document, Input, Reference, Step, mentioned, parted};

/// Names of a pipeline by their position in the document.
pub struct Names<'d> {
    /// The pipeline as read.
    pub document: &'d Document,
    /// Numbers of steps by name.
    pub steps: HashMap<&'d str, usize>,
    /// Numbers of axes by name.
    pub axes: BTreeMap<&'d str, usize>,
    /// By axis: the first of those it is walked together with; itself where it is alone.
    pub zips: Vec<usize>,
    /// Names of the parameters of the pipeline, which `${name}` may stand for besides axes.
    params: BTreeSet<&'d str>,
    /// By axis: the numbers of its items, once one is asked for.
    items: Vec<OnceCell<HashMap<&'d str, usize>>>,
}

impl<'d> Names<'d> {
    /// The names of a document; a zip has those of its axes that are known.
    pub fn new(document: &'d Document) -> Self {
        let steps = document.steps.iter().enumerate().map(|(i, step)| (step.name.text.as_str(), i)).collect();
        let axes: BTreeMap<&str, usize> =
            document.axes.iter().enumerate().map(|(i, axis)| (axis.name.text.as_str(), i)).collect();
        let mut zips: Vec<usize> = (0..document.axes.len()).collect();
        for group in &document.zips {
            let members: Vec<usize> = group.iter().filter_map(|word| axes.get(word.text.as_str()).copied()).collect();
            let first = members.iter().copied().min();
            members.iter().for_each(|axis| zips[*axis] = first.unwrap_or(*axis));
        }
        let params = document.params.iter().map(|(key, _)| key.name.as_str()).collect();
        let items = document.axes.iter().map(|_| OnceCell::new()).collect();
        Self { document, steps, axes, zips, params, items }
    }

    /// The number of an item on an axis.
    pub fn item(&self, axis: usize, item: &str) -> Option<usize> {
        let numbered = || {
            let items = self.document.axes[axis].items.iter().enumerate();
            items.map(|(number, item)| (item.as_str(), number)).collect()
        };
        self.items[axis].get_or_init(numbered).get(item).copied()
    }

    /// The axis a `${name}` or `${name.value}` stands for.
    pub fn mentioned_axis(&self, name: &str) -> Option<usize> {
        self.axes.get(parted(name).0).copied().filter(|_| !self.is_param(name))
    }

    /// Whether a `${name}` stands for an axis that could not be read.
    pub fn is_unread_axis(&self, name: &str) -> bool {
        self.document.unread.axes.contains(parted(name).0)
    }

    /// Whether a parameter has this name.
    pub fn is_param(&self, name: &str) -> bool {
        self.params.contains(parted(name).0)
    }

    /// Axes a step names itself.
    pub fn named_axes(&self, step: &Step) -> BTreeSet<usize> {
        if self.axes.is_empty() {
            return BTreeSet::new();
        }
        let mut names = Vec::new();
        step.with.iter().for_each(|with| mentioned(with, &mut names));
        let mut axes: BTreeSet<usize> = names.iter().filter_map(|(name, _)| self.mentioned_axis(name)).collect();
        let words = step.inputs.iter().filter_map(|(_, input)| input.choosing_axis());
        let named = step.over.iter().chain(words).filter_map(|word| self.axes.get(word.text.as_str()));
        axes.extend(named);
        axes
    }

    /// Axes whose items have to be known before a step can be expanded.
    pub fn met_axes(&self, step: &Step) -> BTreeSet<usize> {
        let gathered = step.inputs.iter().filter_map(|(_, input)| match input {
            Input::Each { over, .. } => Some(over),
            _ => None,
        });
        let gathered = gathered.flatten().filter_map(|word| self.axes.get(word.text.as_str()).copied());
        self.named_axes(step).into_iter().chain(gathered).collect()
    }

    /// Whether two axes are the same or walked together.
    pub fn together(&self, one: usize, other: usize) -> bool {
        self.zips[one] == self.zips[other]
    }

    /// The axes every step depends on; `order` has producers first, but for arrows that go back along an axis.
    pub fn reach(&self, order: &[usize]) -> Vec<BTreeSet<usize>> {
        let mut reached: Vec<BTreeSet<usize>> = self.document.steps.iter().map(|step| self.named_axes(step)).collect();
        if self.axes.is_empty() {
            return reached;
        }
        loop {
            let mut grown = false;
            for step in order {
                let more: Vec<usize> = self.document.steps[*step]
                    .inputs
                    .iter()
                    .flat_map(|(_, input)| self.through(input, &reached))
                    .collect();
                for axis in more {
                    grown |= reached[*step].insert(axis);
                }
            }
            // Only an arrow back can bring something to a step that was looked at before its producer.
            if !grown || !self.has_chains() {
                return reached;
            }
        }
    }

    fn has_chains(&self) -> bool {
        let mut inputs = self.document.steps.iter().flat_map(|step| &step.inputs);
        inputs.any(|(_, input)| matches!(input, Input::Chain { .. }))
    }

    /// Axes that reach a step through one input.
    fn through(&self, input: &Input, reached: &[BTreeSet<usize>]) -> Vec<usize> {
        let own: Vec<usize> = match input {
            Input::Each { over, .. } => over.iter().filter_map(|w| self.axes.get(w.text.as_str()).copied()).collect(),
            _ => Vec::new(),
        };
        // Of a gathered input, the first; a list of pairs, which is behind it, is not gathered.
        let of = |(place, reference): (usize, &Reference)| {
            let gathered = if place == 0 { own.as_slice() } else { &[] };
            let picked: Vec<usize> =
                reference.picks.iter().filter_map(|(axis, _)| self.axes.get(axis.text.as_str()).copied()).collect();
            let producer = self.steps.get(reference.step.as_str()).map(|step| reached[*step].clone());
            let bound = picked.into_iter().chain(gathered.iter().copied()).collect::<Vec<_>>();
            let free = move |axis: &usize| !bound.iter().any(|bound| self.together(*bound, *axis));
            producer.unwrap_or_default().into_iter().filter(free).collect::<Vec<_>>()
        };
        input.references().into_iter().enumerate().flat_map(of).collect()
    }
}
