//! `rockface graph`: the steps of a pipeline and what flows between them, for programs that draw.

use clap::{Args, ValueEnum};
use petgraph::dot::{Config, Dot, RankDir};
use petgraph::graph::DiGraph;
use petgraph::visit::EdgeRef;

use super::{CliError, PipelineArgs, say};
use crate::diagnostic::Diagnostics;
use crate::plan::{Feed, Graph, GraphStep, Source, counts, resolve};

/// Arguments of `rockface graph`.
#[derive(Debug, Args)]
pub struct GraphArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// The language to write; Graphviz makes a picture of the first: `rockface graph p.yaml | dot -Tsvg > p.svg`.
    #[arg(long, value_enum, default_value_t = Format::Dot)]
    format: Format,
}

/// A language for graphs.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Format {
    /// Graphviz.
    Dot,
    /// Mermaid, which Markdown viewers draw.
    Mermaid,
}

/// A step as it is drawn.
struct Drawn {
    /// Name, stage, and for a sweep the count of instances and the axes.
    lines: Vec<String>,
    target: bool,
    keep: bool,
    /// Whether a target needs it.
    needed: bool,
}

impl std::fmt::Display for Drawn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.lines.iter().try_for_each(|line| writeln!(f, "{line}"))
    }
}

impl GraphArgs {
    /// Prints the graph.
    pub fn run(self) -> Result<(), CliError> {
        let pipeline = self.pipeline.load()?;
        let graph = resolve(&pipeline, &self.pipeline.target, rockface_stages::all()).map_err(CliError::Pipeline)?;
        let counts = counts(&graph)
            .map_err(|list| CliError::Pipeline(Diagnostics { sources: pipeline.sources.clone(), list }))?;
        let drawing = drawing(&graph, &counts);
        say(match self.format {
            Format::Dot => dot(&drawing),
            Format::Mermaid => mermaid(&drawing),
        }
        .trim_end());
        Ok(())
    }
}

/// One node a step, in topological order, and one arrow for each output that an input reads.
fn drawing(graph: &Graph, counts: &[usize]) -> DiGraph<Drawn, String> {
    let mut drawing = DiGraph::new();
    let (deferred, wanted) = (graph.deferred(), graph.wanted());
    let nodes: Vec<_> = (0..graph.steps.len())
        .map(|index| drawing.add_node(drawn(graph, index, counts[index], deferred[index], wanted[index])))
        .collect();
    for (consumer, step) in graph.steps.iter().enumerate() {
        for (port, feed) in &step.inputs {
            for (source, when) in distinct(graph, feed) {
                let output = output(graph, source);
                let ports = if output == port.name { output } else { format!("{output} → {}", port.name) };
                drawing.add_edge(nodes[source.step], nodes[consumer], ports + &when);
            }
        }
    }
    drawing
}

fn drawn(graph: &Graph, index: usize, count: usize, unknown: Option<usize>, wanted: bool) -> Drawn {
    let step = &graph.steps[index];
    let mut lines = vec![step.name.clone(), step.stage.name().to_owned()];
    if !step.axes.is_empty() {
        let count = if unknown.is_some() { "unknown".to_owned() } else { count.to_string() };
        lines.push(format!("{count} instances over {}", axes(graph, step)));
    }
    Drawn {
        lines,
        target: graph.targets.contains(&index),
        keep: step.keep,
        needed: count > 0 || (wanted && unknown.is_some()),
    }
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
            let start = first.iter().map(|first| (first, format!(" (first {axis})")));
            std::iter::once((source, format!(" ({axis} before)"))).chain(start).collect()
        }
        Feed::Each { source, over } => {
            let names: Vec<&str> = over.iter().map(|axis| graph.axes[*axis].name.text.as_str()).collect();
            vec![(source, format!(" (each {})", names.join(", ")))]
        }
        Feed::By { axis, cases } => {
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
    (one.step, one.port.name, &one.picks) == (other.step, other.port.name, &other.picks)
}

/// `port`, or `port[axis=item,...]`.
fn output(graph: &Graph, source: &Source) -> String {
    if source.picks.is_empty() {
        return source.port.name.to_owned();
    }
    let pick = |(axis, item): &(usize, usize)| {
        let axis = &graph.axes[*axis];
        format!("{}={}", axis.name.text, axis.items[*item])
    };
    format!("{}[{}]", source.port.name, source.picks.iter().map(pick).collect::<Vec<_>>().join(","))
}

fn dot(drawing: &DiGraph<Drawn, String>) -> String {
    let node = |_: &DiGraph<Drawn, String>, (_, drawn): (_, &Drawn)| {
        let mut attributes = vec!["shape=box"];
        attributes.extend(drawn.target.then_some("peripheries=2"));
        attributes.extend((!drawn.keep).then_some("style=dashed"));
        attributes.extend((!drawn.needed).then_some("color=gray fontcolor=gray"));
        attributes.join(" ")
    };
    let edge = |_: &DiGraph<Drawn, String>, _: petgraph::graph::EdgeReference<String>| String::new();
    Dot::with_attr_getters(drawing, &[Config::RankDir(RankDir::LR)], &edge, &node).to_string()
}

fn mermaid(drawing: &DiGraph<Drawn, String>) -> String {
    let mut text = String::from("flowchart LR\n");
    for node in drawing.node_indices() {
        let drawn = &drawing[node];
        let label = drawn.lines.iter().map(|line| escaped(line)).collect::<Vec<_>>().join("<br/>");
        let (open, close) = if drawn.target { ("[[", "]]") } else { ("[", "]") };
        text += &format!("  s{}{open}\"{label}\"{close}\n", node.index());
        if !drawn.keep {
            text += &format!("  style s{} stroke-dasharray: 5 5\n", node.index());
        }
        if !drawn.needed {
            text += &format!("  style s{} color:gray,stroke:gray\n", node.index());
        }
    }
    for edge in drawing.edge_references() {
        let (from, to) = (edge.source().index(), edge.target().index());
        text += &format!("  s{from} -->|\"{}\"| s{to}\n", escaped(edge.weight()));
    }
    text
}

/// What stands for itself between the quotes of a Mermaid label.
fn escaped(text: &str) -> String {
    let letter = |letter: char| match letter {
        '"' => "#quot;".to_owned(),
        '#' => "#35;".to_owned(),
        '<' => "#lt;".to_owned(),
        '>' => "#gt;".to_owned(),
        other => other.to_string(),
    };
    text.chars().map(letter).collect()
}
