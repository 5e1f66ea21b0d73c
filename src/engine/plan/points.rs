//! Points of the axes: which combinations there are, which instances the targets need, and what each reads.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use rockface_core::Point;

use super::certain::read_by_deferred;
use super::graph::{Feed, Graph, GraphStep, ListPoint, Partners, Source};
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
        // What pairs tell is counted once they are known.
        Feed::Each { over, paired: Some(list), .. } => most_partners(graph, list).min(count(graph, over)),
        Feed::Each { over, .. } => count(graph, over),
        _ => 0,
    });
    let each = each.fold(0, u64::saturating_add);
    if each == 0 { 0 } else { each.saturating_mul(count(graph, &step.axes)) }
}

/// How many items one is read with by the known pairs of an input: the mean of the list where they are most, itself among them.
fn most_partners(graph: &Graph, list: &Feed) -> u64 {
    let makers: Vec<usize> = list.sources().iter().map(|source| source.step).collect();
    let mean = |partners: &Partners| {
        let total: usize = partners.values().map(BTreeSet::len).sum();
        1 + total.div_ceil(partners.len().max(1)) as u64
    };
    let own = graph.partners.iter().filter(|((step, ..), _)| makers.contains(step));
    own.map(|(_, partners)| mean(partners)).max().unwrap_or(1)
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

/// Takes what an input of a step reads at one point, element by element; of what pairs tell, where they are not known, its own item.
pub fn elements(graph: &Graph, step: &GraphStep, items: &[usize], feed: &Feed, take: &mut dyn FnMut(Element)) {
    let own = |axis: usize| own_item(step, items, axis);
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
        Feed::Each { source, over, paired } => {
            let points = match paired.as_deref() {
                None => points(graph, over),
                // Axes that are walked with the one have the same item.
                Some(list) => {
                    paired_items(graph, step, items, over[0], list).map(|item| vec![item; over.len()]).collect()
                }
            };
            for items in points {
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

/// The item that a step has of an axis at one of its points; the first where it does not depend on the axis.
pub fn own_item(step: &GraphStep, items: &[usize], axis: usize) -> usize {
    step.axes.iter().position(|own| *own == axis).map(|place| items[place]).unwrap_or_default()
}

/// The items of an axis that a step reads by pairs, ascending: its own, and those known to be in a pair with it.
fn paired_items(
    graph: &Graph,
    step: &GraphStep,
    items: &[usize],
    axis: usize,
    list: &Feed,
) -> impl Iterator<Item = usize> + use<> {
    let own = own_item(step, items, axis);
    let partners = list_point(graph, step, items, list).and_then(|list| graph.partners.get(&list));
    let partners = partners.and_then(|partners| partners.get(&graph.axes[axis].items[own]));
    let numbers = partners.into_iter().flatten().filter_map(|item| graph.number(axis, item));
    numbers.chain([own]).collect::<BTreeSet<usize>>().into_iter()
}

/// The list of pairs that tells what a step reads at one point.
fn list_point(graph: &Graph, step: &GraphStep, items: &[usize], list: &Feed) -> Option<ListPoint> {
    let mut point = None;
    elements(graph, step, items, list, &mut |element| point = Some((element.step, element.port, element.items)));
    point
}

/// A step at the item of each of its axes.
pub type StepPoint = (usize, Vec<usize>);

/// Instances that cannot be expanded before a list of pairs is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wait {
    /// The step that makes the list.
    pub maker: usize,
    /// How many they are.
    pub count: usize,
}

/// What the targets of a graph need, by what is known.
pub struct Needed {
    /// The points of every step, those that tell the items of axes and the pairs among them.
    pub points: Vec<BTreeSet<Vec<usize>>>,
    /// By step: what some of its instances wait for.
    pub waits: Vec<Option<Wait>>,
    /// The lists of pairs that are needed and not known.
    pub lists: BTreeSet<ListPoint>,
}

impl Needed {
    /// The points that are needed; those whose inputs pairs tell are left out as long as these are not known.
    pub fn of(graph: &Graph) -> Self {
        let deferred = graph.deferred();
        let mut starts = starts(graph);
        if deferred.iter().any(Option::is_some) {
            let sure = read_by_deferred(graph, &deferred, &starts);
            starts.extend(sure);
        }
        let is_expanded = |point: &StepPoint| deferred[point.0].is_none();
        if !graph.pairs_items() {
            let waits = vec![None; graph.steps.len()];
            return Self { points: reached(graph, starts, is_expanded), waits, lists: BTreeSet::new() };
        }
        let points = reached(graph, starts.clone(), is_expanded);
        if !misses_a_list(graph, &points) {
            return Self { points, waits: vec![None; graph.steps.len()], lists: BTreeSet::new() };
        }
        let waiting = Waiting::of(graph, starts.clone(), is_expanded);
        let lists = waiting.lists.iter().map(|(step, _, items)| (*step, items.clone()));
        let starts = starts.into_iter().chain(lists).collect();
        let points = reached(graph, starts, |point| is_expanded(point) && !waiting.points.contains_key(point));
        let waits = waiting.waits(&points);
        Self { points, waits, lists: waiting.lists }
    }
}

/// The points that are needed whatever they read: those of the targets, and of the steps that tell the items of axes.
fn starts(graph: &Graph) -> Vec<StepPoint> {
    let mut starts: Vec<StepPoint> = Vec::new();
    for target in &graph.targets {
        starts.extend(points(graph, &graph.steps[*target].axes).into_iter().map(|items| (*target, items)));
    }
    for source in tellers(graph, &graph.wanted()) {
        starts.extend(list_points(graph, source).into_iter().map(|items| (source.step, items)));
    }
    starts
}

/// The points at which the output is made that tells the items of an axis, in order: several where items are not picked. An axis whose
/// own items are not known yet has the item 0.
pub fn list_points(graph: &Graph, source: &Source) -> Vec<Vec<usize>> {
    let axes = &graph.steps[source.step].axes;
    let free: Vec<usize> =
        axes.iter().copied().filter(|axis| !source.picks_of(*axis) && !graph.is_pending(*axis)).collect();
    let full = |items: Vec<usize>| {
        let picked = |axis: &usize| source.picks.iter().find(|(picked, _)| picked == axis).map(|(_, item)| *item);
        let walked = |axis: &usize| free.iter().position(|own| own == axis).map(|place| items[place]);
        axes.iter().map(|axis| picked(axis).or_else(|| walked(axis)).unwrap_or_default()).collect()
    };
    points(graph, &free).into_iter().map(full).collect()
}

/// The points that are reached against the arrows, of those that may be.
fn reached(graph: &Graph, starts: Vec<StepPoint>, may_be: impl Fn(&StepPoint) -> bool) -> Vec<BTreeSet<Vec<usize>>> {
    let mut needed: Vec<BTreeSet<Vec<usize>>> = vec![BTreeSet::new(); graph.steps.len()];
    let mut open: Vec<StepPoint> = Vec::new();
    let mut need = |point: StepPoint, open: &mut Vec<StepPoint>| {
        if !needed[point.0].contains(&point.1) && may_be(&point) {
            needed[point.0].insert(point.1.clone());
            open.push(point);
        }
    };
    starts.into_iter().for_each(|point| need(point, &mut open));
    while let Some((index, items)) = open.pop() {
        let step = &graph.steps[index];
        for (_, feed) in &step.inputs {
            elements(graph, step, &items, feed, &mut |element| need((element.step, element.items), &mut open));
            if let Feed::Each { paired: Some(list), .. } = feed {
                list_point(graph, step, &items, list).into_iter().for_each(|list| need((list.0, list.2), &mut open));
            }
        }
    }
    needed
}

/// Whether a list of pairs is not known that tells what one of these points reads.
fn misses_a_list(graph: &Graph, points: &[BTreeSet<Vec<usize>>]) -> bool {
    points.iter().enumerate().any(|(step, points)| {
        let step = &graph.steps[step];
        let paired = step.inputs.iter().filter(|(_, feed)| matches!(feed, Feed::Each { paired: Some(_), .. }));
        paired.into_iter().any(|(_, feed)| points.iter().any(|items| unknown_list(graph, step, items, feed).is_some()))
    })
}

/// The points that cannot be expanded before some list of pairs is known.
struct Waiting {
    /// Each with the step that makes the list.
    points: BTreeMap<StepPoint, usize>,
    lists: BTreeSet<ListPoint>,
    /// By step: how many points it has at least, those that wait among them.
    counts: Vec<usize>,
}

impl Waiting {
    fn of(graph: &Graph, starts: Vec<StepPoint>, may_be: impl Fn(&StepPoint) -> bool) -> Self {
        let mut own = Self { points: BTreeMap::new(), lists: BTreeSet::new(), counts: vec![0; graph.steps.len()] };
        let mut readers: HashMap<StepPoint, Vec<StepPoint>> = HashMap::new();
        let mut open: Vec<StepPoint> = starts;
        let mut seen: HashSet<StepPoint> = open.iter().cloned().collect();
        while let Some(point) = open.pop() {
            if !may_be(&point) {
                continue;
            }
            let step = &graph.steps[point.0];
            own.counts[point.0] += 1;
            let mut read: Vec<StepPoint> = Vec::new();
            for (_, feed) in &step.inputs {
                let unknown = unknown_list(graph, step, &point.1, feed);
                read.extend(unknown.iter().map(|(step, _, items)| (*step, items.clone())));
                own.points.extend(unknown.iter().map(|(maker, ..)| (point.clone(), *maker)));
                own.lists.extend(unknown);
                elements(graph, step, &point.1, feed, &mut |element| read.push((element.step, element.items)));
            }
            for producer in read {
                readers.entry(producer.clone()).or_default().push(point.clone());
                if seen.insert(producer.clone()) {
                    open.push(producer);
                }
            }
        }
        own.spread(&readers);
        own
    }

    /// What the steps wait for, given the points that do not: those that wait, and those that only they read.
    fn waits(&self, expanded: &[BTreeSet<Vec<usize>>]) -> Vec<Option<Wait>> {
        let first = self.points.values().next().copied();
        let mut makers: BTreeMap<usize, usize> = BTreeMap::new();
        self.points.iter().for_each(|((step, _), maker)| _ = makers.entry(*step).or_insert(*maker));
        let wait = |(step, points): (usize, &BTreeSet<Vec<usize>>)| {
            let count = self.counts[step].saturating_sub(points.len());
            let maker = makers.get(&step).copied().or(first)?;
            (count > 0).then_some(Wait { maker, count })
        };
        expanded.iter().enumerate().map(wait).collect()
    }

    /// Whatever reads from a point that waits has to wait too.
    fn spread(&mut self, readers: &HashMap<StepPoint, Vec<StepPoint>>) {
        let mut open: Vec<(StepPoint, usize)> =
            self.points.iter().map(|(point, maker)| (point.clone(), *maker)).collect();
        while let Some((point, maker)) = open.pop() {
            for reader in readers.get(&point).into_iter().flatten() {
                if !self.points.contains_key(reader) {
                    self.points.insert(reader.clone(), maker);
                    open.push((reader.clone(), maker));
                }
            }
        }
    }
}

/// The list of pairs that tells what an input reads, if there is one and it is not known.
fn unknown_list(graph: &Graph, step: &GraphStep, items: &[usize], feed: &Feed) -> Option<ListPoint> {
    let Feed::Each { paired: Some(list), .. } = feed else { return None };
    list_point(graph, step, items, list).filter(|list| !graph.partners.contains_key(list))
}

/// The outputs that tell the items of the axes of wanted steps.
fn tellers<'g>(graph: &'g Graph, wanted: &'g [bool]) -> impl Iterator<Item = &'g Source> {
    let used: BTreeSet<usize> =
        (0..graph.steps.len()).filter(|step| wanted[*step]).flat_map(|step| graph.axes_met(step)).collect();
    used.into_iter().filter_map(|axis| graph.dynamic[axis].as_ref()).map(|dynamic| &dynamic.source)
}

/// How many instances of every step the targets need; `None` where a list that is not known tells.
pub fn counts(graph: &Graph) -> Result<Vec<Option<usize>>, Vec<Diagnostic>> {
    let faults = too_many(graph);
    if !faults.is_empty() {
        return Err(faults);
    }
    let (needed, deferred) = (Needed::of(graph), graph.deferred());
    let is_told = |step: usize| deferred[step].is_none() && needed.waits[step].is_none();
    let counts = needed.points.iter().enumerate().map(|(step, points)| is_told(step).then_some(points.len()));
    Ok(counts.collect())
}
