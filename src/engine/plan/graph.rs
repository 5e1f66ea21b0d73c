//! The resolved graph of steps: every name found, every port checked, axes propagated along the arrows.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use rockface_core::artefact::Kind;
use rockface_core::{AnyStage, Port, Ports};
use serde_json::Value;

use super::dynamic::Items;
use super::former::FormerInputs;
use crate::diagnostic::Span;
use crate::pipeline::{Axis, Base, INSIDE, LogLevel, Node, Used, Word};

/// A pipeline whose every name is resolved; steps are in topological order, and as they are written wherever that allows it.
pub struct Graph {
    /// Name of the pipeline.
    pub name: String,
    /// The seed of the pipeline, from which random streams follow.
    pub seed: u64,
    /// The folder of the pipeline file.
    pub folder: PathBuf,
    /// Values that `${name}` refers to.
    pub params: BTreeMap<String, Value>,
    /// The axes, in the order of declaration.
    pub axes: Vec<Axis>,
    /// By axis: the first of those it is walked together with; itself where it is alone.
    pub zips: Vec<usize>,
    /// By axis: the output its items are taken from, and whether they are known.
    pub dynamic: Vec<Option<Dynamic>>,
    /// The lists of pairs that are known, of those that tell what a gathered input reads.
    pub partners: BTreeMap<ListPoint, Partners>,
    /// By axis: the numbers of its items, once pairs name one.
    pub numbers: Vec<OnceLock<HashMap<String, usize>>>,
    /// The steps, producers before consumers.
    pub steps: Vec<GraphStep>,
    /// Indices of the steps to make.
    pub targets: Vec<usize>,
    /// The uses of parts that some of the steps come from.
    pub uses: Vec<Used>,
    /// What past runs know of input files that are gone, where whoever plans has looked for runs.
    pub former: Option<Arc<FormerInputs>>,
}

impl Graph {
    /// The outermost use that a step comes from.
    pub fn use_of(&self, step: &str) -> Option<&Used> {
        let (name, _) = step.split_once(INSIDE)?;
        self.uses.iter().find(|used| used.name == name)
    }

    /// By step: whether nothing that is wanted reads what it makes, but to draw it.
    pub fn ends(&self) -> Vec<bool> {
        let wanted = self.wanted();
        let mut ends = vec![true; self.steps.len()];
        for (number, step) in self.steps.iter().enumerate().filter(|(number, step)| wanted[*number] && !step.draws()) {
            let sources = step.inputs.iter().flat_map(|(_, feed)| feed.sources());
            sources.filter(|source| source.step != number).for_each(|source| ends[source.step] = false);
        }
        ends
    }

    /// The steps as they are written, those of a part where it is used.
    pub fn as_written(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.steps.len()).collect();
        order.sort_by_key(|step| self.steps[*step].written);
        order
    }
}

/// Which items a list of pairs puts together: of each, those that it is in a pair with.
pub type Partners = HashMap<String, BTreeSet<String>>;

/// A list of pairs before instances have numbers: the step that makes it, the port, and the item of each axis of that step.
pub type ListPoint = (usize, &'static str, Vec<usize>);

/// Where the items of an axis come from.
#[derive(Debug, Clone)]
pub struct Dynamic {
    /// The output that is read.
    pub source: Source,
    /// Whether the items are known.
    pub known: bool,
    /// The lists that are known where the step that makes them has several instances: by the item of each of its axes.
    pub lists: BTreeMap<Vec<usize>, Items>,
}

/// A step whose stage, inputs and axes have been found.
pub struct GraphStep {
    /// Its name; of a step of a part, that of the use and its own with `/` between.
    pub name: String,
    /// Where its name stands.
    pub span: Span,
    /// How many steps are written before it, those of parts where they are used.
    pub written: usize,
    /// The stage it uses.
    pub stage: &'static dyn AnyStage,
    /// The ports it has with the parameters that are written.
    pub ports: Ports,
    /// What paths in its parameters are relative to.
    pub base: Base,
    /// Its parameters as written.
    pub with: Option<Arc<Node>>,
    /// What feeds each given input port, in the stage's order of ports.
    pub inputs: Vec<(&'static Port, Feed)>,
    /// Indices of the axes it is expanded over, ascending.
    pub axes: Vec<usize>,
    /// Indices of the axes its parameters mention, ascending.
    pub with_axes: Vec<usize>,
    /// Whether its outputs are kept.
    pub keep: bool,
    /// What stands for it in seed material.
    pub stream: String,
    /// The reseeding axes whose items are part of the seed material, ascending.
    pub stream_axes: Vec<usize>,
    /// How long one attempt may take.
    pub timeout: Option<Duration>,
    /// How often it is tried again after a failure.
    pub retries: u32,
    /// How much the log of a run shows of it; `None`: it depends on the number of its instances.
    pub log: Option<LogLevel>,
    /// Its heading in reports.
    pub title: Option<String>,
    /// The sentence below its heading.
    pub doc: Option<String>,
}

impl GraphStep {
    /// Whether all it makes are pictures.
    pub fn draws(&self) -> bool {
        let kinds = || self.ports.outputs.iter().flat_map(|port| port.kinds);
        kinds().count() > 0 && kinds().all(|kind| matches!(kind, Kind::Picture | Kind::Figure))
    }

    /// The file extension of an output of this kind at a port, without the dot.
    pub fn extension(&self, port: &str, kind: Kind) -> &'static str {
        let declared = self.ports.outputs.iter().find(|declared| declared.name == port);
        declared.and_then(|port| port.extension).unwrap_or(kind.extension())
    }
}

/// Where an input comes from.
#[derive(Debug, Clone)]
pub enum Feed {
    /// One output, at the items of the step itself except where it picks others.
    Plain(Source),
    /// The output chosen by the item of an axis: one source an item.
    By {
        /// Index of the axis.
        axis: usize,
        /// One source an item; none as long as the items are not known.
        cases: Vec<Source>,
        /// Where the items are not known beforehand: the sources of those that are named.
        named: Vec<(Word, Source)>,
        /// And of all others.
        other: Option<Box<Source>>,
    },
    /// The outputs at all items of some axes.
    Each {
        /// The output that is read.
        source: Source,
        /// Indices of the axes gathered over, outermost first.
        over: Vec<usize>,
        /// The list of pairs, a plain output or a choice, that tells which items are read.
        paired: Option<Box<Feed>>,
    },
    /// The output at the item before.
    Chain {
        /// The output that is read.
        source: Source,
        /// Index of the axis it goes back on.
        axis: usize,
        /// What the first item gets.
        first: Option<Box<Source>>,
    },
}

/// One output of a step, perhaps with the items of some axes picked.
#[derive(Debug, Clone)]
pub struct Source {
    /// Index of the step.
    pub step: usize,
    /// The output port that is read.
    pub port: &'static Port,
    /// Picked items: (axis, item).
    pub picks: Vec<(usize, usize)>,
    /// Picked items of axes whose items are not known yet.
    pub later: Vec<Later>,
}

/// A picked item whose number is not known yet.
#[derive(Debug, Clone)]
pub struct Later {
    /// Index of the axis.
    pub axis: usize,
    /// The item and its place in the text.
    pub item: Word,
    /// Axes walked with it that the output depends on too.
    pub mates: Vec<usize>,
}

impl Feed {
    /// Every source but one at the item before.
    pub fn forward_sources(&self) -> Vec<&Source> {
        match self {
            Self::Chain { first, .. } => first.as_deref().into_iter().collect(),
            _ => self.sources(),
        }
    }

    /// Every source in it.
    pub fn sources(&self) -> Vec<&Source> {
        match self {
            Self::Plain(source) => vec![source],
            Self::Each { source, paired, .. } => {
                std::iter::once(source).chain(paired.iter().flat_map(|list| list.sources())).collect()
            }
            Self::By { cases, named, other, .. } if cases.is_empty() => {
                named.iter().map(|(_, source)| source).chain(other.as_deref()).collect()
            }
            Self::By { cases, .. } => cases.iter().collect(),
            Self::Chain { source, first, .. } => std::iter::once(source).chain(first.as_deref()).collect(),
        }
    }
}

impl Source {
    /// Whether an item of an axis is picked.
    pub fn picks_of(&self, axis: usize) -> bool {
        let later = self.later.iter().any(|later| later.axis == axis || later.mates.contains(&axis));
        later || self.picks.iter().any(|(picked, _)| *picked == axis)
    }
}

impl Graph {
    /// Whether the items of an axis are not known yet.
    pub fn is_pending(&self, axis: usize) -> bool {
        self.dynamic[axis].as_ref().is_some_and(|dynamic| !dynamic.known)
    }

    /// The number of an item of an axis whose items are known.
    pub fn number(&self, axis: usize, item: &str) -> Option<usize> {
        let numbered = || {
            let items = self.axes[axis].items.iter().enumerate();
            items.map(|(number, item)| (item.clone(), number)).collect()
        };
        self.numbers[axis].get_or_init(numbered).get(item).copied()
    }

    /// The axes walked together with one, itself among them.
    pub fn mates(&self, axis: usize) -> impl Iterator<Item = usize> {
        (0..self.axes.len()).filter(move |other| self.zips[*other] == self.zips[axis])
    }

    /// The axes a step is expanded or gathers over.
    pub fn axes_met(&self, step: usize) -> Vec<usize> {
        let step = &self.steps[step];
        let gathered = step.inputs.iter().flat_map(|(_, feed)| match feed {
            Feed::Each { over, .. } => over.as_slice(),
            _ => &[],
        });
        step.axes.iter().chain(gathered).copied().collect()
    }

    /// The steps that targets need, also those that tell the items of their axes.
    pub fn wanted(&self) -> Vec<bool> {
        let mut wanted = vec![false; self.steps.len()];
        let mut open = self.targets.clone();
        while let Some(step) = open.pop() {
            if std::mem::replace(&mut wanted[step], true) {
                continue;
            }
            let feeds = self.steps[step].inputs.iter().flat_map(|(_, feed)| feed.sources());
            open.extend(feeds.map(|source| source.step));
            let tellers = self.axes_met(step).into_iter().filter_map(|axis| self.dynamic[axis].as_ref());
            open.extend(tellers.map(|dynamic| dynamic.source.step));
        }
        wanted
    }

    /// Whether a step that targets need is expanded or gathers over an axis.
    pub fn is_met(&self, axis: usize) -> bool {
        let wanted = self.wanted();
        (0..self.steps.len()).any(|step| wanted[step] && self.axes_met(step).contains(&axis))
    }

    /// Whether a list of pairs tells what some of the inputs read.
    pub fn pairs_items(&self) -> bool {
        let mut feeds = self.steps.iter().flat_map(|step| &step.inputs);
        feeds.any(|(_, feed)| matches!(feed, Feed::Each { paired: Some(_), .. }))
    }

    /// By step: whether it makes pairs that tell what is gathered, or leads to that; an empty list where there are none.
    pub fn leads_to_pairs(&self) -> Vec<bool> {
        if !self.pairs_items() {
            return Vec::new();
        }
        let lists = self.steps.iter().flat_map(|step| &step.inputs).filter_map(|(_, feed)| match feed {
            Feed::Each { paired, .. } => paired.as_deref(),
            _ => None,
        });
        self.leading_to(lists.flat_map(Feed::sources).map(|source| source.step).collect())
    }

    /// By step: whether it is kept and serves many consumers that each need values which are not kept too, made by a step that has its axes and
    /// more, or leads to such a step: values made before it would be held without being used up. An empty list where all values are kept.
    pub fn awaited(&self) -> Vec<bool> {
        if self.steps.iter().all(|step| step.keep) {
            return Vec::new();
        }
        let mut awaited = Vec::new();
        for step in &self.steps {
            let sources = || step.inputs.iter().flat_map(|(_, feed)| feed.sources()).map(|source| source.step);
            for held in sources().map(|source| &self.steps[source]).filter(|source| !source.keep) {
                awaited.extend(sources().filter(|source| {
                    let GraphStep { axes, keep, .. } = &self.steps[*source];
                    *keep && axes.len() < held.axes.len() && axes.iter().all(|axis| held.axes.contains(axis))
                }));
            }
        }
        self.leading_to(awaited)
    }

    /// By step: whether it is one of some steps, or what one of them reads or takes its items from follows from it.
    fn leading_to(&self, mut open: Vec<usize>) -> Vec<bool> {
        let mut leads = vec![false; self.steps.len()];
        while let Some(step) = open.pop() {
            if !std::mem::replace(&mut leads[step], true) {
                let feeds = self.steps[step].inputs.iter().flat_map(|(_, feed)| feed.sources());
                open.extend(feeds.map(|source| source.step));
                let tellers = self.axes_met(step).into_iter().filter_map(|axis| self.dynamic[axis].as_ref());
                open.extend(tellers.map(|dynamic| dynamic.source.step));
            }
        }
        leads
    }

    /// The steps whose instances are deferred until a list of items is known, each with the axis it waits for.
    pub fn deferred(&self) -> Vec<Option<usize>> {
        let mut deferred: Vec<Option<usize>> = vec![None; self.steps.len()];
        if !(0..self.axes.len()).any(|axis| self.is_pending(axis)) {
            return deferred;
        }
        // Arrows that go back along an axis lead upwards in the list of steps: until nothing changes.
        loop {
            let before = deferred.clone();
            for step in 0..self.steps.len() {
                let own = self.axes_met(step).into_iter().find(|axis| self.is_pending(*axis));
                let feeds = self.steps[step].inputs.iter().flat_map(|(_, feed)| feed.sources());
                let given = feeds.into_iter().find_map(|source| deferred[source.step]);
                deferred[step] = deferred[step].or(own).or(given);
            }
            if deferred == before {
                return deferred;
            }
        }
    }
}
