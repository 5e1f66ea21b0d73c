//! Pictures of a pipeline: one box a step however many instances it has, and an arrow for what flows between two steps.

mod languages;
mod layers;
mod order;
mod place;
mod sheet;
mod svg;

pub use svg::escaped;

use std::collections::BTreeMap;

use petgraph::graph::{DiGraph, NodeIndex};
use petgraph::visit::EdgeRef;
use serde_json::Value;

use rockface_engine::diagnostic::Diagnostic;
use rockface_engine::pipeline::INSIDE;
use rockface_engine::plan::{Feed, Graph, GraphStep, Later, Source, counts};

/// A pipeline as it is drawn.
pub struct Drawing {
    /// One node a step, in topological order; one edge for each output that an input reads.
    graph: DiGraph<Drawn, Arrow>,
    notes: BTreeMap<String, Note>,
    /// The uses of parts, by name: what they use.
    uses: Vec<(String, String)>,
}

/// A step as it is drawn.
#[derive(Clone)]
pub(crate) struct Drawn {
    /// The name of the step; in a folded drawing, that of a use of a part.
    pub name: String,
    /// The name of its stage; in a folded drawing, that of the part used.
    pub stage: String,
    /// For a sweep, the count of instances, where it is known, and the axes.
    pub over: Option<(Option<usize>, String)>,
    /// Whether it is to be made.
    pub target: bool,
    /// Whether its outputs are kept.
    pub keep: bool,
    /// Whether a target needs it.
    pub needed: bool,
}

/// What flows from one step to another.
#[derive(Clone)]
pub(crate) struct Arrow {
    /// The output, with the items that are picked.
    pub output: String,
    /// The port that reads it; none where it is the list an axis takes its items from.
    pub input: Option<&'static str>,
    /// The output, the port that reads it, and when or over what.
    pub label: String,
    /// The items of some axes come together.
    pub gathers: bool,
    /// It comes from the item before.
    pub back: bool,
}

impl Arrow {
    /// Whether it is the list an axis takes its items from.
    pub fn lists(&self) -> bool {
        self.input.is_none()
    }
}

/// Something to be said of a step besides what it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Note {
    /// A few words, such as `1.2 s`.
    pub text: String,
    /// The colour of the step.
    pub tint: Tint,
}

/// A colour that means something.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Tint {
    /// No state to show, as in a drawing of a pipeline that has not run.
    #[default]
    Plain,
    /// Computed in this run, or would be.
    Ran,
    /// Its outputs are in the store already.
    Cached,
    /// It failed, or something it needs did.
    Failed,
}

impl Drawing {
    /// The drawing of a graph.
    ///
    /// # Errors
    ///
    /// When it has too many instances to count.
    pub fn of(graph: &Graph) -> Result<Self, Vec<Diagnostic>> {
        let counts = counts(graph)?;
        let mut drawing = DiGraph::new();
        let wanted = graph.wanted();
        let nodes: Vec<NodeIndex> = (0..graph.steps.len())
            .map(|index| drawing.add_node(drawn(graph, index, counts[index], wanted[index])))
            .collect();
        for (consumer, step) in graph.steps.iter().enumerate() {
            for (port, feed) in &step.inputs {
                for (source, when) in distinct(graph, feed) {
                    let output = output(graph, source);
                    let ports =
                        if output == port.name { output.clone() } else { format!("{output} → {}", port.name) };
                    let (gathers, back) = (matches!(feed, Feed::Each { .. }), source.step >= consumer);
                    let arrow = Arrow { output, input: Some(port.name), label: ports + &when, gathers, back };
                    drawing.add_edge(nodes[source.step], nodes[consumer], arrow);
                }
            }
            for (source, axis) in begun_lists(graph, step) {
                let output = output(graph, source);
                let label = format!("{output} → items of {axis}");
                let arrow = Arrow { output, input: None, label, gathers: false, back: false };
                drawing.add_edge(nodes[source.step], nodes[consumer], arrow);
            }
        }
        let uses = graph.uses.iter().map(|used| (used.name.clone(), used.part.clone())).collect();
        Ok(Self { graph: drawing, notes: BTreeMap::new(), uses })
    }

    /// With one box for every use of a part, in place of the steps inside.
    #[must_use]
    pub fn folded(self) -> Self {
        let mut graph: DiGraph<Drawn, Arrow> = DiGraph::new();
        let mut boxes: BTreeMap<String, NodeIndex> = BTreeMap::new();
        let mut place = Vec::with_capacity(self.graph.node_count());
        for drawn in self.graph.node_weights() {
            let outer = drawn.name.split_once(INSIDE).map(|(outer, _)| outer.to_owned());
            let Some(outer) = outer else {
                place.push(graph.add_node(drawn.clone()));
                continue;
            };
            let node = *boxes.entry(outer.clone()).or_insert_with(|| {
                let part = self.uses.iter().find(|(name, _)| *name == outer).map_or("", |(_, part)| part.as_str());
                let blank = Drawn { stage: part.to_owned(), name: outer, over: None, ..drawn.clone() };
                graph.add_node(Drawn { target: false, keep: false, needed: false, ..blank })
            });
            let folded = &mut graph[node];
            folded.target |= drawn.target;
            folded.keep |= drawn.keep;
            folded.needed |= drawn.needed;
            // The box says of its steps what the largest of them does.
            let count = |over: &Option<(Option<usize>, String)>| over.as_ref().and_then(|over| over.0).unwrap_or(0);
            if count(&drawn.over) > count(&folded.over) || folded.over.is_none() {
                folded.over.clone_from(&drawn.over);
            }
            place.push(node);
        }
        for edge in self.graph.edge_references() {
            let (from, to) = (place[edge.source().index()], place[edge.target().index()]);
            let is_known =
                || graph.edges_connecting(from, to).any(|known| known.weight().output == edge.weight().output);
            if from != to && !is_known() {
                graph.add_edge(from, to, edge.weight().clone());
            }
        }
        Self { graph, uses: Vec::new(), ..self }
    }

    /// Without the steps that no target needs.
    #[must_use]
    pub fn only_needed(self) -> Self {
        let needed = |drawn: &Drawn| drawn.needed.then(|| drawn.clone());
        let graph = self.graph.filter_map(|_, drawn| needed(drawn), |_, arrow| Some(arrow.clone()));
        Self { graph, ..self }
    }

    /// Says something of a step.
    #[must_use]
    pub fn note(mut self, step: &str, note: Note) -> Self {
        self.notes.insert(step.to_owned(), note);
        self
    }

    /// Says how many instances a step over axes turned out to have.
    #[must_use]
    pub fn count(mut self, step: &str, instances: usize) -> Self {
        let own = self.graph.node_weights_mut().filter(|drawn| drawn.name == step);
        own.filter_map(|drawn| drawn.over.as_mut()).for_each(|over| over.0 = Some(instances));
        self
    }

    /// In the language of Graphviz.
    pub fn dot(&self) -> String {
        languages::dot(&self.graph, &self.uses)
    }

    /// In the language of Mermaid, which Markdown viewers draw.
    pub fn mermaid(&self) -> String {
        languages::mermaid(&self.graph, &self.uses)
    }

    /// For programs: its steps and arrows.
    pub fn json(&self) -> Value {
        languages::json(&self.graph)
    }

    /// As a picture that any browser shows, from top to bottom, readable on light and dark pages; it may be embedded in
    /// HTML as it is.
    pub fn svg(&self) -> String {
        svg::svg(&self.graph, &self.uses, &self.notes)
    }
}

impl Drawn {
    /// Name, stage, and for a sweep the count of instances and the axes.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![self.name.clone(), self.stage.clone()];
        lines.extend(self.over.as_ref().map(|(count, axes)| {
            let count = count.map_or_else(|| "unknown".to_owned(), |count| count.to_string());
            format!("{count} instances over {axes}")
        }));
        lines
    }
}

fn drawn(graph: &Graph, index: usize, count: Option<usize>, wanted: bool) -> Drawn {
    let step = &graph.steps[index];
    let over = (!step.axes.is_empty()).then(|| (count, axes(graph, step)));
    Drawn {
        name: step.name.clone(),
        stage: step.stage.name().to_owned(),
        over,
        target: graph.targets.contains(&index),
        keep: step.keep,
        needed: count.map_or(wanted, |count| count > 0),
    }
}

/// The lists that tell the items of the axes which begin at a step.
fn begun_lists<'g>(graph: &'g Graph, step: &'g GraphStep) -> impl Iterator<Item = (&'g Source, &'g str)> {
    let given = |axis: usize| {
        let mut sources = step.inputs.iter().flat_map(|(_, feed)| feed.forward_sources());
        sources.any(|source| graph.steps[source.step].axes.contains(&axis))
    };
    let begun = step.axes.iter().filter(move |axis| !given(**axis));
    begun.filter_map(|axis| Some((&graph.dynamic[*axis].as_ref()?.source, graph.axes[*axis].name.text.as_str())))
}

fn axes(graph: &Graph, step: &GraphStep) -> String {
    step.axes.iter().map(|axis| graph.axes[*axis].name.text.as_str()).collect::<Vec<_>>().join(", ")
}

/// The outputs a port reads, each once, and what is to be said of it: the items it is chosen for, or the axes gathered.
fn distinct<'g>(graph: &Graph, feed: &'g Feed) -> Vec<(&'g Source, String)> {
    match feed {
        Feed::Plain(source) => vec![(source, String::new())],
        Feed::Chain { source, axis, first } => {
            let axis = &graph.axes[*axis].name.text;
            let start = first.iter().map(|first| (&**first, format!(" (first {axis})")));
            std::iter::once((source, format!(" ({axis} before)"))).chain(start).collect()
        }
        Feed::Each { source, over, paired } => {
            let names: Vec<&str> = over.iter().map(|axis| graph.axes[*axis].name.text.as_str()).collect();
            let lists = paired.iter().flat_map(|list| distinct(graph, list));
            let lists = lists.map(|(list, when)| (list, format!(" (pairs of {}){when}", names.join(", "))));
            std::iter::once((source, format!(" (each {})", names.join(", ")))).chain(lists).collect()
        }
        Feed::By { axis, cases, named, other } if cases.is_empty() => {
            let axis = &graph.axes[*axis].name.text;
            let named = named.iter().map(|(item, source)| (source, format!(" ({axis}={})", item.text)));
            named.chain(other.iter().map(|source| (&**source, format!(" (other {axis})")))).collect()
        }
        Feed::By { axis, cases, .. } => {
            let axis = &graph.axes[*axis];
            let mut groups: Vec<(&Source, Vec<&str>)> = Vec::new();
            for (source, item) in cases.iter().zip(&axis.items) {
                match groups.iter_mut().find(|(known, _)| same(known, source)) {
                    Some((_, items)) => items.push(item),
                    None => groups.push((source, vec![item])),
                }
            }
            let told = |items: Vec<&str>| format!(" ({}={})", axis.name.text, items.join("|"));
            groups.into_iter().map(|(source, items)| (source, told(items))).collect()
        }
    }
}

fn same(one: &Source, other: &Source) -> bool {
    let later = |source: &Source| source.later.iter().map(|l| (l.axis, l.item.text.clone())).collect::<Vec<_>>();
    let place = |source: &Source| (source.step, source.port.name, source.picks.clone(), later(source));
    place(one) == place(other)
}

/// How an arrow names an output: `port`, or `port[axis=item,...]` where items are picked.
fn output(graph: &Graph, source: &Source) -> String {
    let pick = |(axis, item): &(usize, usize)| {
        let axis = &graph.axes[*axis];
        format!("{}={}", axis.name.text, axis.items[*item])
    };
    let later = |later: &Later| format!("{}={}", graph.axes[later.axis].name.text, later.item.text);
    let picks: Vec<String> = source.picks.iter().map(pick).chain(source.later.iter().map(later)).collect();
    if picks.is_empty() { source.port.name.to_owned() } else { format!("{}[{}]", source.port.name, picks.join(",")) }
}
