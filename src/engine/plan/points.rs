//! Points of the axes: which combinations there are, which instances the targets need, and what each reads.

use std::collections::{BTreeMap, BTreeSet};

use rockface_core::Point;

use super::graph::{Feed, Graph, GraphStep, Source};
use crate::diagnostic::Diagnostic;

/// The most instances a plan may have: above, memory and patience end before the work does.
const INSTANCES_LIMIT: u64 = 10_000_000;

/// How many points some axes have: those walked together count once.
pub fn count(graph: &Graph, axes: &[usize]) -> u64 {
    if axes.is_empty() {
        return 1;
    }
    let leads: BTreeMap<usize, usize> = axes.iter().map(|axis| (graph.zips[*axis], *axis)).collect();
    leads.values().map(|axis| graph.axes[*axis].items.len() as u64).fold(1, u64::saturating_mul)
}

/// The most gathered elements that the inputs of a plan may have, all together.
const GATHERED_LIMIT: u64 = 20_000_000;

/// Counts before anything is expanded.
pub fn too_many(graph: &Graph) -> Vec<Diagnostic> {
    let (mut total, mut gathered) = (0_u64, 0_u64);
    for step in &graph.steps {
        total = total.saturating_add(count(graph, &step.axes));
        if total > INSTANCES_LIMIT {
            let axes = step.axes.iter().map(|axis| &graph.axes[*axis]);
            let axes: Vec<String> = axes.map(|a| format!("{} {}", a.items.len(), a.name.text)).collect();
            let message = format!("step `{}` brings the plan to {total} instances ({})", step.name, axes.join(" x "));
            let hint = format!("a plan has at most {INSTANCES_LIMIT}: shorten an axis, or divide the pipeline");
            return vec![Diagnostic::at(step.span, message).hint(hint)];
        }
        gathered = gathered.saturating_add(gathered_by(graph, step));
        if gathered > GATHERED_LIMIT {
            let (name, own) = (&step.name, count(graph, &step.axes));
            let message =
                format!("the {own} instances of step `{name}` bring the gathered inputs to {gathered} elements");
            let hint =
                format!("a plan has at most {GATHERED_LIMIT}: gather once and let the steps read what that makes");
            return vec![Diagnostic::at(step.span, message).hint(hint)];
        }
    }
    Vec::new()
}

/// How many elements all instances of a step gather.
fn gathered_by(graph: &Graph, step: &GraphStep) -> u64 {
    let each = step.inputs.iter().map(|(_, feed)| match feed {
        Feed::Each { over, .. } => count(graph, over),
        _ => 0,
    });
    let each = each.fold(0, u64::saturating_add);
    if each == 0 { 0 } else { each.saturating_mul(count(graph, &step.axes)) }
}

/// What some axes are called where they stand together: an axis of a part by its short name, unless two have the same.
pub fn labels<'g>(graph: &'g Graph, axes: &[usize]) -> Vec<&'g str> {
    let label = |axis: &usize| graph.axes[*axis].label.as_str();
    let is_double = |axis: &usize| axes.iter().any(|other| other != axis && label(other) == label(axis));
    axes.iter().map(|axis| if is_double(axis) { graph.axes[*axis].name.text.as_str() } else { label(axis) }).collect()
}

/// The name of each item of some axes.
pub fn named(graph: &Graph, axes: &[usize], items: &[usize]) -> Point {
    let items = axes.iter().zip(items).map(|(axis, item)| graph.axes[*axis].items[*item].clone());
    labels(graph, axes).into_iter().map(str::to_owned).zip(items).collect()
}

/// Every point of some axes, the last axis fastest; an axis walked with an earlier one has the same item.
pub fn points(graph: &Graph, axes: &[usize]) -> Vec<Vec<usize>> {
    let mut points = vec![Vec::new()];
    for (position, axis) in axes.iter().enumerate() {
        let leader = axes[..position].iter().position(|earlier| graph.zips[*earlier] == graph.zips[*axis]);
        let count = graph.axes[*axis].items.len();
        let extend = |point: Vec<usize>| {
            let items = leader.map_or(0..count, |leader| point[leader]..point[leader] + 1);
            items.map(move |item| point.iter().copied().chain([item]).collect::<Vec<_>>())
        };
        points = points.into_iter().flat_map(extend).collect();
    }
    points
}

/// One element of an input before instances have numbers.
pub struct Element {
    /// The number of the step that makes it.
    pub step: usize,
    /// The item of each axis of that step.
    pub items: Vec<usize>,
    /// The output port that is read.
    pub port: &'static str,
    /// Items of the gathered axes.
    pub point: Point,
}

/// Takes what an input of a step reads at one point, element by element.
pub fn elements(graph: &Graph, step: &GraphStep, items: &[usize], feed: &Feed, take: &mut dyn FnMut(Element)) {
    let own = |axis: usize| step.axes.iter().position(|own| *own == axis).map(|place| items[place]).unwrap_or_default();
    let element = |source: &Source, extra: &[(usize, usize)]| {
        let item = |axis: &usize| {
            let picked = source.picks.iter().chain(extra).find(|(a, _)| a == axis).map(|(_, item)| *item);
            picked.unwrap_or_else(|| own(*axis))
        };
        let producer = &graph.steps[source.step];
        let items = producer.axes.iter().map(item).collect();
        Element { step: source.step, items, port: source.port.name, point: Point::new() }
    };
    match feed {
        Feed::Plain(source) => take(element(source, &[])),
        Feed::By { axis, cases, .. } => take(element(&cases[own(*axis)], &[])),
        Feed::Each { source, over } => {
            for items in points(graph, over) {
                let extra: Vec<_> = over.iter().copied().zip(items.iter().copied()).collect();
                take(Element { point: named(graph, over, &items), ..element(source, &extra) });
            }
        }
        Feed::Chain { axis, first, .. } if own(*axis) == 0 => {
            first.iter().for_each(|first| take(element(first, &[])));
        }
        Feed::Chain { source, axis, .. } => {
            let before: Vec<_> = graph.mates(*axis).map(|mate| (mate, own(*axis) - 1)).collect();
            take(element(source, &before));
        }
    }
}

/// The points of every step that the targets need, and of the steps that tell the items of axes they need.
pub fn needed_points(graph: &Graph) -> Vec<BTreeSet<Vec<usize>>> {
    let mut needed: Vec<BTreeSet<Vec<usize>>> = vec![BTreeSet::new(); graph.steps.len()];
    let (wanted, deferred) = (graph.wanted(), graph.deferred());
    let mut open: Vec<(usize, Vec<usize>)> = Vec::new();
    let mut need = |step: usize, items: Vec<usize>, open: &mut Vec<(usize, Vec<usize>)>| {
        if deferred[step].is_none() && !needed[step].contains(&items) {
            needed[step].insert(items.clone());
            open.push((step, items));
        }
    };
    for target in &graph.targets {
        for point in points(graph, &graph.steps[*target].axes) {
            need(*target, point, &mut open);
        }
    }
    for source in tellers(graph, &wanted) {
        let step = &graph.steps[source.step];
        let items = step.axes.iter().map(|axis| source.picks.iter().find(|(a, _)| a == axis).map_or(0, |(_, i)| *i));
        need(source.step, items.collect(), &mut open);
    }
    while let Some((index, items)) = open.pop() {
        let step = &graph.steps[index];
        for (_, feed) in &step.inputs {
            elements(graph, step, &items, feed, &mut |element| need(element.step, element.items, &mut open));
        }
    }
    needed
}

/// The outputs that tell the items of the axes of wanted steps.
fn tellers<'g>(graph: &'g Graph, wanted: &'g [bool]) -> impl Iterator<Item = &'g Source> {
    let used: BTreeSet<usize> =
        (0..graph.steps.len()).filter(|step| wanted[*step]).flat_map(|step| graph.axes_met(step)).collect();
    used.into_iter().filter_map(|axis| graph.dynamic[axis].as_ref()).map(|dynamic| &dynamic.source)
}

/// How many instances of every step the targets need.
pub fn counts(graph: &Graph) -> Result<Vec<usize>, Vec<Diagnostic>> {
    let faults = too_many(graph);
    if faults.is_empty() { Ok(needed_points(graph).iter().map(BTreeSet::len).collect()) } else { Err(faults) }
}
