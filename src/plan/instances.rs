//! Expansion: a step becomes one instance for each point of the axes it depends on, and no others.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use rockface_cache::{Digest, Gathered, Recipe, RecipeInput, SeedMaterial};
use rockface_stages::{Arity, Point};

use super::graph::{Feed, Graph, GraphStep, Source};
use super::parameters::{self, HashFile, StepParams};
use crate::diagnostic::Diagnostic;

/// All step instances the targets need, producers before consumers.
pub struct Plan {
    /// The graph they belong to.
    pub graph: Graph,
    /// The instances.
    pub instances: Vec<Instance>,
    /// Instances of the target steps.
    pub targets: Vec<usize>,
}

/// A step at one point.
pub struct Instance {
    /// Index of the step in the graph.
    pub step: usize,
    /// The item of each axis of the step.
    pub items: Vec<usize>,
    /// Its parameters.
    pub params: Arc<StepParams>,
    /// Where each given port is fed from, in the stage's order of ports.
    pub inputs: Vec<(&'static str, Vec<Given>)>,
    /// Instances that read from it, ascending.
    pub dependents: Vec<usize>,
}

/// One element of an input.
pub struct Given {
    /// The producer.
    pub instance: usize,
    /// Its output port.
    pub port: &'static str,
    /// Items of the gathered axes.
    pub point: Point,
}

impl Plan {
    /// Expands a graph; faults of parameters and files are reported together.
    pub fn new(graph: Graph, hash: &HashFile) -> Result<Self, Vec<Diagnostic>> {
        let faults = too_many(&graph);
        if !faults.is_empty() {
            return Err(faults);
        }
        let needed = needed_points(&graph);
        match Expansion::new(&graph, hash).run(&needed) {
            Ok(instances) => {
                let targets = (0..instances.len()).filter(|i| graph.targets.contains(&instances[*i].step)).collect();
                Ok(Self { graph, instances, targets })
            }
            Err(faults) => Err(faults),
        }
    }

    /// The step of an instance.
    pub fn step(&self, instance: usize) -> &GraphStep {
        &self.graph.steps[self.instances[instance].step]
    }

    /// The point of an instance: the item of each axis it depends on.
    pub fn point(&self, instance: usize) -> Point {
        let instance = &self.instances[instance];
        named(&self.graph, &self.graph.steps[instance.step].axes, &instance.items)
    }

    /// `step[axis=item,...]`, as messages call an instance.
    pub fn label(&self, instance: usize) -> String {
        let step = self.step(instance);
        if step.axes.is_empty() { step.name.clone() } else { format!("{}[{}]", step.name, self.point_text(instance)) }
    }

    /// `axis=item,...` in the order of the axes' declaration.
    pub fn point_text(&self, instance: usize) -> String {
        let axes = &self.step(instance).axes;
        let items = &self.instances[instance].items;
        let parts = axes.iter().zip(items).map(|(axis, item)| {
            let axis = &self.graph.axes[*axis];
            format!("{}={}", axis.name.text, axis.items[*item])
        });
        parts.collect::<Vec<_>>().join(",")
    }

    /// Everything that decides the outputs of an instance, once the digests of its inputs are known.
    pub fn recipe(&self, instance: usize, digest: impl Fn(usize, &str) -> Digest) -> Recipe {
        let step = self.step(instance);
        let own = &self.instances[instance];
        let inputs = own.inputs.iter().map(|(port, given)| {
            let many = step.inputs.iter().any(|(p, feed)| p.name == *port && matches!(feed, Feed::Each { .. }));
            let input = match given.as_slice() {
                [one] if !many => RecipeInput::One(digest(one.instance, one.port)),
                list => RecipeInput::Many(
                    list.iter()
                        .map(|g| Gathered { point: g.point.clone(), digest: digest(g.instance, g.port) })
                        .collect(),
                ),
            };
            ((*port).to_owned(), input)
        });
        Recipe {
            stage: step.stage.name().to_owned(),
            version: step.stage.version(),
            params: own.params.recipe.clone(),
            inputs: inputs.collect(),
            seed: own.params.draws.then(|| self.seed(instance)),
        }
    }

    fn seed(&self, instance: usize) -> SeedMaterial {
        let step = self.step(instance);
        let items = self.point(instance);
        let counted = |axis: &usize| self.graph.axes[*axis].name.text.clone();
        let items = step.stream_axes.iter().map(counted).map(|axis| (axis.clone(), items[&axis].clone())).collect();
        SeedMaterial { seed: self.graph.seed, stream: step.stream.clone(), items }
    }
}

/// The most instances a plan may have: above, memory and patience end before the work does.
const INSTANCES_LIMIT: u64 = 10_000_000;

/// Counts before anything is expanded.
fn too_many(graph: &Graph) -> Vec<Diagnostic> {
    let mut total = 0_u64;
    let mut faults = Vec::new();
    for step in &graph.steps {
        let counts = step.axes.iter().map(|axis| graph.axes[*axis].items.len() as u64);
        let count = counts.fold(1_u64, u64::saturating_mul);
        total = total.saturating_add(count);
        if count > INSTANCES_LIMIT || total > INSTANCES_LIMIT {
            let axes: Vec<String> = step
                .axes
                .iter()
                .map(|axis| &graph.axes[*axis])
                .map(|a| format!("{} {}", a.items.len(), a.name.text))
                .collect();
            let message = format!("step `{}` brings the plan to {total} instances ({})", step.name, axes.join(" x "));
            let hint = format!("a plan has at most {INSTANCES_LIMIT}: shorten an axis, or divide the pipeline");
            faults.push(Diagnostic::at(step.span, message).hint(hint));
            return faults;
        }
    }
    faults
}

fn named(graph: &Graph, axes: &[usize], items: &[usize]) -> Point {
    let name = |(axis, item): (&usize, &usize)| {
        let axis = &graph.axes[*axis];
        (axis.name.text.clone(), axis.items[*item].clone())
    };
    axes.iter().zip(items).map(name).collect()
}

/// Every combination of items of some axes, the last axis fastest.
fn points(graph: &Graph, axes: &[usize]) -> Vec<Vec<usize>> {
    axes.iter().fold(vec![Vec::new()], |points, axis| {
        let extend = |point: Vec<usize>| {
            (0..graph.axes[*axis].items.len()).map(move |item| point.iter().copied().chain([item]).collect::<Vec<_>>())
        };
        points.into_iter().flat_map(extend).collect()
    })
}

/// One element of an input before instances have numbers: producer step, its items, its port, the gathered point.
type Element = (usize, Vec<usize>, &'static str, Point);

fn elements(graph: &Graph, step: &GraphStep, items: &[usize], feed: &Feed) -> Vec<Element> {
    let own: BTreeMap<usize, usize> = step.axes.iter().copied().zip(items.iter().copied()).collect();
    let element = |source: &Source, extra: &[(usize, usize)]| {
        let item = |axis: &usize| {
            let picked = source.picks.iter().chain(extra).find(|(a, _)| a == axis).map(|(_, item)| *item);
            picked.or_else(|| own.get(axis).copied()).unwrap_or_default()
        };
        let producer = &graph.steps[source.step];
        let (axes, chosen): (Vec<usize>, Vec<usize>) = extra.iter().copied().unzip();
        (source.step, producer.axes.iter().map(item).collect(), source.port.name, named(graph, &axes, &chosen))
    };
    match feed {
        Feed::Plain(source) => vec![element(source, &[])],
        Feed::By { axis, cases } => vec![element(&cases[own[axis]], &[])],
        Feed::Each { source, over } => {
            let extra =
                points(graph, over).into_iter().map(|items| over.iter().copied().zip(items).collect::<Vec<_>>());
            extra.map(|extra| element(source, &extra)).collect()
        }
    }
}

/// How many instances of every step the targets need.
pub fn counts(graph: &Graph) -> Result<Vec<usize>, Vec<Diagnostic>> {
    let faults = too_many(graph);
    if faults.is_empty() { Ok(needed_points(graph).iter().map(BTreeSet::len).collect()) } else { Err(faults) }
}

/// The points of every step that the targets need.
fn needed_points(graph: &Graph) -> Vec<BTreeSet<Vec<usize>>> {
    let mut needed: Vec<BTreeSet<Vec<usize>>> = vec![BTreeSet::new(); graph.steps.len()];
    for target in &graph.targets {
        needed[*target].extend(points(graph, &graph.steps[*target].axes));
    }
    for index in (0..graph.steps.len()).rev() {
        let step = &graph.steps[index];
        for items in needed[index].clone() {
            for (_, feed) in &step.inputs {
                for (producer, items, _, _) in elements(graph, step, &items, feed) {
                    needed[producer].insert(items);
                }
            }
        }
    }
    needed
}

struct Expansion<'a> {
    graph: &'a Graph,
    hash: &'a HashFile<'a>,
    params: HashMap<(usize, Vec<usize>), Option<Arc<StepParams>>>,
    faults: Vec<Diagnostic>,
}

impl<'a> Expansion<'a> {
    fn new(graph: &'a Graph, hash: &'a HashFile<'a>) -> Self {
        Self { graph, hash, params: HashMap::new(), faults: Vec::new() }
    }

    fn run(mut self, needed: &[BTreeSet<Vec<usize>>]) -> Result<Vec<Instance>, Vec<Diagnostic>> {
        let graph = self.graph;
        let mut numbers: Vec<HashMap<&Vec<usize>, usize>> = vec![HashMap::new(); graph.steps.len()];
        let mut instances: Vec<Instance> = Vec::with_capacity(needed.iter().map(BTreeSet::len).sum());
        for (index, step) in graph.steps.iter().enumerate() {
            if needed[index].is_empty() {
                self.check_unneeded(index, step);
            }
            for items in &needed[index] {
                let Some(params) = self.params(index, step, items) else { continue };
                let feeds = step.inputs.iter().map(|(port, feed)| {
                    let given =
                        elements(graph, step, items, feed).into_iter().filter_map(|(producer, items, port, point)| {
                            numbers[producer].get(&items).map(|instance| Given { instance: *instance, port, point })
                        });
                    (port.name, given.collect::<Vec<_>>())
                });
                let inputs: Vec<_> = feeds.collect();
                numbers[index].insert(items, instances.len());
                instances.push(Instance { step: index, items: items.clone(), params, inputs, dependents: Vec::new() });
            }
        }
        if !self.faults.is_empty() {
            return Err(self.faults);
        }
        link(&mut instances);
        Ok(instances)
    }

    /// Steps that no target needs are checked all the same; their files are not looked for.
    fn check_unneeded(&mut self, index: usize, step: &GraphStep) {
        for items in points(self.graph, &step.with_axes) {
            let items: BTreeMap<usize, usize> = step.with_axes.iter().copied().zip(items).collect();
            if let Err(faults) = parameters::check(self.graph, &self.graph.steps[index], &items) {
                self.report(faults);
            }
        }
    }

    fn params(&mut self, index: usize, step: &GraphStep, items: &[usize]) -> Option<Arc<StepParams>> {
        let own: BTreeMap<usize, usize> = step.axes.iter().copied().zip(items.iter().copied()).collect();
        let mentioned: BTreeMap<usize, usize> = step.with_axes.iter().map(|axis| (*axis, own[axis])).collect();
        let key = (index, mentioned.values().copied().collect::<Vec<_>>());
        if let Some(known) = self.params.get(&key) {
            return known.clone();
        }
        let checked = parameters::check(self.graph, step, &mentioned).and_then(|mut params| {
            let faults = parameters::find_files(self.graph, step, &mut params, self.hash);
            if faults.is_empty() { Ok(params) } else { Err(faults) }
        });
        let params = match checked {
            Ok(params) => Some(Arc::new(params)),
            Err(faults) => {
                self.report(faults);
                None
            }
        };
        self.params.insert(key, params.clone());
        params
    }

    fn report(&mut self, faults: Vec<Diagnostic>) {
        for fault in faults {
            if !self.faults.contains(&fault) {
                self.faults.push(fault);
            }
        }
    }
}

fn link(instances: &mut [Instance]) {
    for consumer in 0..instances.len() {
        let producers: BTreeSet<usize> =
            instances[consumer].inputs.iter().flat_map(|(_, given)| given.iter().map(|g| g.instance)).collect();
        for producer in producers {
            instances[producer].dependents.push(consumer);
        }
    }
}

/// Whether an output port of an instance is made: optional ones only where the input of the same name is given.
pub fn makes(instance: &Instance, port: &rockface_stages::Port) -> bool {
    port.arity != Arity::Optional || instance.inputs.iter().any(|(given, _)| *given == port.name)
}
