//! What a run has to say in a line each.

use rockface_core::Entry;

use crate::plan::Plan;

/// The results in a line each: what the target steps have to say, and those whose results only targets without a word show; first
/// those that nothing reads and that are expanded over the fewest axes, otherwise as written. What all instances of a step say alike is
/// said once.
pub fn headlines(plan: &Plan, logs: &[Vec<Entry>]) -> Vec<String> {
    let (graph, ends) = (&plan.graph, plan.graph.ends());
    let shown_by_ends = shown_by_ends(plan, logs);
    let is_target = |instance: usize| plan.targets.binary_search(&instance).is_ok();
    let mut found: Vec<(usize, usize, &str)> = Vec::new();
    for (instance, entries) in logs.iter().enumerate() {
        let step = plan.instances[instance].step;
        if !is_target(instance) && !shown_by_ends[step] {
            continue;
        }
        for entry in entries {
            if let Entry::Headline { text } = entry {
                found.push((step, instance, text));
            }
        }
    }
    let rank = |step: usize| (!ends[step], graph.steps[step].axes.len(), graph.steps[step].written);
    found.sort_by_key(|(step, instance, _)| (!is_target(*instance), rank(*step)));
    let mut lines = Vec::new();
    for group in found.chunk_by(|one, other| one.0 == other.0) {
        let label = |instance: usize| plan.label(instance);
        match group {
            [(_, first, text), rest @ ..] if !rest.is_empty() && rest.iter().all(|(_, _, other)| other == text) => {
                lines.push(format!("{} and {} more: {text}", label(*first), rest.len()));
            }
            _ => lines.extend(group.iter().map(|(_, instance, text)| format!("{}: {text}", label(*instance)))),
        }
    }
    lines
}

/// The most instances of a step that is no target whose headlines are told: of a long sweep its table says more.
const INSTANCES: usize = 20;

/// By step: whether it is read, and only by targets that have no headline of their own, such as a picture or a table of what it found.
fn shown_by_ends(plan: &Plan, logs: &[Vec<Entry>]) -> Vec<bool> {
    let graph = &plan.graph;
    let (mut is_silent, mut counts) = (vec![true; graph.steps.len()], vec![0; graph.steps.len()]);
    for (instance, entries) in logs.iter().enumerate() {
        let speaks = entries.iter().any(|entry| matches!(entry, Entry::Headline { .. }));
        let step = plan.instances[instance].step;
        is_silent[step] &= !speaks;
        counts[step] += 1;
    }
    let wanted = graph.wanted();
    let mut readers: Vec<Vec<usize>> = vec![Vec::new(); graph.steps.len()];
    for (number, step) in graph.steps.iter().enumerate().filter(|(number, _)| wanted[*number]) {
        let sources = step.inputs.iter().flat_map(|(_, feed)| feed.sources());
        sources.for_each(|source| readers[source.step].push(number));
    }
    let mut is_target = vec![false; graph.steps.len()];
    graph.targets.iter().for_each(|target| is_target[*target] = true);
    let is_end = |reader: &usize| is_silent[*reader] && is_target[*reader];
    let is_shown =
        |readers: &Vec<usize>, count: &usize| *count <= INSTANCES && !readers.is_empty() && readers.iter().all(is_end);
    readers.iter().zip(&counts).map(|(readers, count)| is_shown(readers, count)).collect()
}
