//! What steps over axes whose items are not known yet are sure to read: instances that a run need not wait with.

use std::collections::BTreeSet;

use super::graph::{Feed, Graph, GraphStep, Source};
use super::points::{StepPoint, own_item, points};

/// The item of an axis whose items are not known yet.
const UNKNOWN: usize = usize::MAX;

/// The points of steps that are not deferred which deferred steps read whatever the items of their axes will be; an axis
/// has one item at least. `starts` are points that are needed in any case.
pub fn read_by_deferred(graph: &Graph, deferred: &[Option<usize>], starts: &[StepPoint]) -> Vec<StepPoint> {
    let targets = graph.targets.iter().filter(|target| deferred[**target].is_some());
    let mut open: Vec<StepPoint> = targets.flat_map(|target| points_of(graph, *target)).collect();
    let is_deferred = |(step, _): &&StepPoint| deferred[*step].is_some();
    open.extend(starts.iter().filter(is_deferred).map(|(step, items)| {
        let axes = graph.steps[*step].axes.iter().zip(items);
        (*step, axes.map(|(axis, item)| if graph.is_pending(*axis) { UNKNOWN } else { *item }).collect())
    }));
    let mut seen: BTreeSet<StepPoint> = open.iter().cloned().collect();
    let mut read = Vec::new();
    while let Some((number, items)) = open.pop() {
        let step = &graph.steps[number];
        for (_, feed) in &step.inputs {
            sure(graph, step, &items, feed, &mut |point| {
                if !seen.insert(point.clone()) {
                    return;
                }
                if deferred[point.0].is_some() {
                    open.push(point);
                } else if !point.1.contains(&UNKNOWN) {
                    read.push(point);
                }
            });
        }
    }
    read
}

/// The points of a step, with no item of the axes whose items are not known.
fn points_of(graph: &Graph, step: usize) -> Vec<StepPoint> {
    let axes = &graph.steps[step].axes;
    let known: Vec<usize> = axes.iter().copied().filter(|axis| !graph.is_pending(*axis)).collect();
    let full = |items: Vec<usize>| {
        let item = |axis: &usize| known.iter().position(|own| own == axis).map_or(UNKNOWN, |place| items[place]);
        (step, axes.iter().map(item).collect())
    };
    points(graph, &known).into_iter().map(full).collect()
}

/// Takes the points that an input of a step is sure to read.
fn sure(graph: &Graph, step: &GraphStep, items: &[usize], feed: &Feed, take: &mut dyn FnMut(StepPoint)) {
    let own = |axis: usize| own_item(step, items, axis);
    let point = |source: &Source, extra: &[(usize, usize)]| {
        let item = |axis: &usize| {
            let picked = source.picks.iter().chain(extra).find(|(a, _)| a == axis).map(|(_, item)| *item);
            if graph.is_pending(*axis) { UNKNOWN } else { picked.unwrap_or_else(|| own(*axis)) }
        };
        (source.step, graph.steps[source.step].axes.iter().map(item).collect())
    };
    match feed {
        Feed::Plain(source) => take(point(source, &[])),
        Feed::By { axis, cases, named, .. } => match own(*axis) {
            // Which items there are besides those that are named is open.
            UNKNOWN => named.iter().for_each(|(_, source)| take(point(source, &[]))),
            item => cases.get(item).into_iter().for_each(|source| take(point(source, &[]))),
        },
        // Of what pairs tell, only the step's own item is sure, and that the list is read.
        Feed::Each { source, over, paired: Some(list) } => {
            let here: Vec<(usize, usize)> = over.iter().map(|axis| (*axis, own(over[0]))).collect();
            take(point(source, &here));
            sure(graph, step, items, list, take);
        }
        Feed::Each { source, over, paired: None } => {
            let known: Vec<usize> = over.iter().copied().filter(|axis| !graph.is_pending(*axis)).collect();
            for items in points(graph, &known) {
                let here: Vec<(usize, usize)> = known.iter().copied().zip(items).collect();
                take(point(source, &here));
            }
        }
        Feed::Chain { source, axis, first } => match own(*axis) {
            // Whether there is an item before is open; that there is a first one is sure.
            0 | UNKNOWN => first.iter().for_each(|first| take(point(first, &[]))),
            item => {
                let before: Vec<(usize, usize)> = graph.mates(*axis).map(|mate| (mate, item - 1)).collect();
                take(point(source, &before));
            }
        },
    }
}

#[cfg(test)]
mod tests {
    use crate::pipeline::{Overrides, Pipeline};
    use crate::plan::{Plan, resolve};

    /// The steps and points that are planned before the items of `row` are known.
    fn planned(steps: &str, targets: &str) -> Vec<String> {
        // An axis that no step depends on is a fault.
        let count = if steps.contains("[k]") { ", k: {count: 2}" } else { "" };
        let row = if steps.contains("row") { "row: {from: tab.table}" } else { "" };
        let text = format!(
            "rockface: 1\naxes: {{{row}{count}}}\ntargets: [{targets}]\nsteps:\n  \
             flat: {{stage: synthesise-face, with: {{width_m: 2, height_m: 2, spacing_m: 0.1}}}}\n  \
             low: {{stage: rasterise-dem, in: {{surface: flat.mesh}}, with: {{cell_m: 0.1, method: tin}}}}\n  \
             low_noise: {{stage: describe-noise, in: {{raster: low.raster}}, with: {{scales_cells: [1, 2]}}}}\n  \
             tab: {{stage: tabulate, in: {{rows: low_noise.features}}}}\n{steps}"
        );
        let pipeline = Pipeline::parse(&text, "p", "p", ".".into(), &Overrides::default()).unwrap();
        let graph =
            resolve(&pipeline, &[], rockface_stages::registry().stages()).unwrap_or_else(|told| panic!("{told}"));
        let plan = Plan::new(graph, &|path| panic!("{}", path.display())).unwrap_or_else(|told| panic!("{told:?}"));
        let own = ["flat", "low", "low_noise", "tab"];
        let labels = (0..plan.instances.len()).map(|instance| plan.label(instance));
        labels.filter(|label| !own.contains(&label.as_str())).collect()
    }

    const FACES: &str = "  face: {stage: synthesise-face, over: [k], with: {width_m: 2, height_m: 2, spacing_m: 0.1}}\n  \
                         dem: {stage: rasterise-dem, in: {surface: face.mesh}, over: [row], with: {cell_m: 0.1, method: tin}}\n";

    #[test]
    fn what_every_item_reads_is_planned_before_the_items_are_known() {
        assert_eq!(planned(FACES, "dem"), ["face[k=0]", "face[k=1]"]);
        // One point is read of it, whatever the items are.
        let picked = format!("{FACES}  last: {{stage: draw-picture, in: {{subject: \"dem.raster[k=1]\"}}}}\n");
        assert_eq!(planned(&picked, "last"), ["face[k=1]"]);
        let chosen = "  a: {stage: synthesise-face, with: {width_m: 2, height_m: 2, spacing_m: 0.1}}\n  \
                      b: {stage: synthesise-face, with: {width_m: 2, height_m: 2, spacing_m: 0.1}}\n  \
                      dem: {stage: rasterise-dem, in: {surface: {by: row, x: a.mesh, else: b.mesh}}, with: {cell_m: 0.1, method: tin}}\n";
        // Whether there are others than `x` is not known.
        assert_eq!(planned(chosen, "dem"), ["a"]);
        let gathered = format!(
            "{FACES}  all: {{stage: tabulate, in: {{rows: {{each: noise.features, over: [row, k]}}}}}}\n  \
                                noise: {{stage: describe-noise, in: {{raster: dem.raster}}, with: {{scales_cells: [1, 2]}}}}\n"
        );
        assert_eq!(planned(&gathered, "all"), ["face[k=0]", "face[k=1]"]);
        // What no target needs is not planned.
        assert_eq!(planned(FACES, "tab"), Vec::<String>::new());
    }
}
