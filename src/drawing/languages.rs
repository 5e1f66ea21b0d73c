//! A drawing in the languages of programs: Graphviz and Mermaid, which draw, and JSON.

use std::collections::BTreeMap;

use petgraph::dot::{Config, Dot, RankDir};
use petgraph::graph::{DiGraph, EdgeReference};
use petgraph::visit::EdgeRef;
use serde_json::{Value, json};

use super::{Arrow, Drawn};
use rockface_engine::pipeline::INSIDE;

impl std::fmt::Display for Drawn {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.lines().iter().try_for_each(|line| writeln!(f, "{line}"))
    }
}

impl std::fmt::Display for Arrow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.label)
    }
}

/// Graphviz makes a picture of it.
pub fn dot(drawing: &DiGraph<Drawn, Arrow>, uses: &[(String, String)]) -> String {
    let node = |_: &DiGraph<Drawn, Arrow>, (_, drawn): (_, &Drawn)| {
        let mut attributes = vec!["shape=box"];
        attributes.extend(drawn.target.then_some("peripheries=2"));
        attributes.extend((!drawn.keep).then_some("style=dashed"));
        attributes.extend((!drawn.needed).then_some("color=gray fontcolor=gray"));
        attributes.join(" ")
    };
    let edge = |_: &DiGraph<Drawn, Arrow>, _: EdgeReference<Arrow>| String::new();
    let text = Dot::with_attr_getters(drawing, &[Config::RankDir(RankDir::LR)], &edge, &node).to_string();
    let frame = |number: usize, name: &str, part: &str, inner: &str| {
        let label = format!("{name} ({part})").replace('\\', "\\\\").replace('"', "\\\"");
        format!("    subgraph cluster_{number} {{ label=\"{label}\" color=gray\n{inner}    }}\n")
    };
    let frames = framed(drawing, uses, &|node| format!("    {node}\n"), &frame);
    let end = text.trim_end().strip_suffix('}').unwrap_or(&text);
    format!("{end}{frames}}}\n")
}

/// Frames around the steps of every use, one in the other; each step stands in the innermost.
fn framed(
    drawing: &DiGraph<Drawn, Arrow>,
    uses: &[(String, String)],
    step: &dyn Fn(usize) -> String,
    frame: &dyn Fn(usize, &str, &str, &str) -> String,
) -> String {
    let outer = |name: &str| name.rsplit_once(INSIDE).map_or("", |(outer, _)| outer).to_owned();
    let mut inner: BTreeMap<String, String> = BTreeMap::new();
    for node in drawing.node_indices() {
        let outer = outer(&drawing[node].name);
        if !outer.is_empty() {
            *inner.entry(outer).or_default() += &step(node.index());
        }
    }
    // The innermost first: their frames are part of those around them.
    let mut order: Vec<usize> = (0..uses.len()).collect();
    order.sort_by_key(|number| std::cmp::Reverse(uses[*number].0.matches(INSIDE).count()));
    let mut top = String::new();
    for number in order {
        let (name, part) = &uses[number];
        let Some(content) = inner.remove(name) else { continue };
        let framed = frame(number, name, part, &content);
        match outer(name).as_str() {
            "" => top += &framed,
            around => *inner.entry(around.to_owned()).or_default() += &framed,
        }
    }
    top
}

/// Viewers of Markdown draw it.
pub fn mermaid(drawing: &DiGraph<Drawn, Arrow>, uses: &[(String, String)]) -> String {
    let mut text = String::from("flowchart LR\n");
    for node in drawing.node_indices() {
        let drawn = &drawing[node];
        let label = drawn.lines().iter().map(|line| escaped(line)).collect::<Vec<_>>().join("<br/>");
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
        text += &format!("  s{from} -->|\"{}\"| s{to}\n", escaped(&edge.weight().label));
    }
    let frame = |number: usize, name: &str, part: &str, inner: &str| {
        format!("  subgraph u{number}[\"{}\"]\n{inner}  end\n", escaped(&format!("{name} ({part})")))
    };
    text + &framed(drawing, uses, &|node| format!("  s{node}\n"), &frame)
}

/// Any program reads it. `instances` is null where it is not known.
pub fn json(drawing: &DiGraph<Drawn, Arrow>) -> Value {
    let node = |drawn: &Drawn| {
        let (instances, over) = drawn.over.clone().unwrap_or((Some(usize::from(drawn.needed)), String::new()));
        let axes: Vec<&str> = over.split(", ").filter(|axis| !axis.is_empty()).collect();
        json!({
            "step": drawn.name, "stage": drawn.stage, "instances": instances, "axes": axes, "target": drawn.target,
            "keep": drawn.keep, "needed": drawn.needed,
        })
    };
    let edge = |edge: EdgeReference<Arrow>| {
        let (from, to, arrow) = (&drawing[edge.source()].name, &drawing[edge.target()].name, edge.weight());
        json!({
            "from": from, "to": to, "output": arrow.output, "input": arrow.input, "label": arrow.label,
            "gathers": arrow.gathers, "from_item_before": arrow.back, "tells_items": arrow.lists(),
        })
    };
    let nodes: Vec<Value> = drawing.node_weights().map(node).collect();
    let edges: Vec<Value> = drawing.edge_references().map(edge).collect();
    json!({ "nodes": nodes, "edges": edges })
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
