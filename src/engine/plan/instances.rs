//! Expansion: a step becomes one instance for each point of the axes it depends on, and no others.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use rockface_cache::{Digest, Gathered, Outcome, OutputRecord, Recipe, RecipeInput, SafeName, SeedMaterial};
use rockface_core::params::Field;
use rockface_core::{Arity, Point, Port};

use super::faults::{Counted, Faults};
use super::graph::{Feed, Graph, GraphStep, ListPoint};
use super::parameters::{self, StepParams};
use super::points::{Needed, Wait, elements, labels, named, points, too_many};
use super::sight::{HashFile, Looks, Sight};
use crate::diagnostic::Diagnostic;
use crate::pipeline::value_bytes;

/// All step instances the targets need, producers before consumers.
pub struct Plan {
    /// The graph they belong to.
    pub graph: Graph,
    /// The instances. Other places call one by its number in this list, which stays the same when more are added.
    pub instances: Vec<Instance>,
    /// Instances of the target steps.
    pub targets: Vec<usize>,
    /// By step: the list of pairs that instances wait for which are not there yet.
    pub waits: Vec<Option<Wait>>,
    /// The lists of pairs that instances wait for.
    pub lists: BTreeSet<ListPoint>,
    /// All that was looked at in the file system to make it.
    pub looks: Looks,
}

/// A step at one point.
pub struct Instance {
    /// Index of the step in the graph.
    pub step: usize,
    /// The item of each axis of the step.
    pub items: Vec<usize>,
    /// Its parameters, filled in and checked.
    pub params: Arc<StepParams>,
    /// Where each given port is fed from, in the stage's order of ports.
    pub inputs: Vec<(&'static str, Vec<Given>)>,
    /// Instances that read from it, ascending.
    pub dependents: Vec<usize>,
}

/// One element of an input.
pub struct Given {
    /// The number of the instance that makes it.
    pub instance: usize,
    /// The output port that is read.
    pub port: &'static str,
    /// Items of the gathered axes.
    pub point: Point,
}

impl Plan {
    /// Expands the steps of a graph whose axes have known items; faults of parameters and files are reported together.
    pub fn new(graph: Graph, hash: &HashFile) -> Result<Self, Vec<Diagnostic>> {
        let (instances, targets, waits) = (Vec::new(), Vec::new(), Vec::new());
        let mut plan = Self { graph, instances, targets, waits, lists: BTreeSet::new(), looks: Looks::new() };
        plan.grow(hash)?;
        plan.order()?;
        Ok(plan)
    }

    /// Adds the instances that were deferred. Those there are keep their numbers, and producers come before
    /// consumers; returns the number of the first new one.
    pub fn grow(&mut self, hash: &HashFile) -> Result<usize, Vec<Diagnostic>> {
        let faults = too_many(&self.graph);
        if !faults.is_empty() {
            return Err(faults);
        }
        let needed = Needed::of(&self.graph);
        let known = self.instances.len();
        let sight = Sight::new(hash);
        let new = Expansion::new(&self.graph, &sight).run(&needed, &self.instances)?;
        (self.waits, self.lists) = (needed.waits, needed.lists);
        self.instances.extend(new);
        self.looks.append(&mut sight.looks());
        link(&mut self.instances, known);
        let is_target = |instance: &usize| self.graph.targets.contains(&self.instances[*instance].step);
        self.targets = (0..self.instances.len()).filter(is_target).collect();
        Ok(known)
    }

    /// Gives every instance the number that it would have had if all items had been known: by step and point, producers
    /// before consumers. Returns the former number of each.
    pub fn order(&mut self) -> Result<Vec<usize>, Vec<Diagnostic>> {
        let chained = self.graph.steps.iter().any(|s| s.inputs.iter().any(|(_, f)| matches!(f, Feed::Chain { .. })));
        let mut order: Vec<usize> = (0..self.instances.len()).collect();
        let place = |i: &usize| (self.instances[*i].step, &self.instances[*i].items);
        order.sort_by(|one, other| place(one).cmp(&place(other)));
        if chained {
            order = self.sorted(&order)?;
        }
        if order.iter().enumerate().all(|(new, old)| new == *old) {
            return Ok(order);
        }
        let mut new = vec![0; order.len()];
        order.iter().enumerate().for_each(|(number, old)| new[*old] = number);
        let mut former: Vec<Option<Instance>> = std::mem::take(&mut self.instances).into_iter().map(Some).collect();
        self.instances = order.iter().filter_map(|old| former[*old].take()).collect();
        for instance in &mut self.instances {
            instance.dependents.iter_mut().for_each(|dependent| *dependent = new[*dependent]);
            instance.dependents.sort_unstable();
            let given = instance.inputs.iter_mut().flat_map(|(_, given)| given);
            given.for_each(|given| given.instance = new[given.instance]);
        }
        self.targets = self.targets.iter().map(|target| new[*target]).collect();
        self.targets.sort_unstable();
        Ok(order)
    }

    /// The same order with producers first, as near to the given one as that allows.
    fn sorted(&self, order: &[usize]) -> Result<Vec<usize>, Vec<Diagnostic>> {
        let mut rank = vec![0; order.len()];
        order.iter().enumerate().for_each(|(rank_of, instance)| rank[*instance] = rank_of);
        let mut unmet = vec![0_usize; order.len()];
        let dependents = self.instances.iter().flat_map(|instance| &instance.dependents);
        dependents.for_each(|dependent| unmet[*dependent] += 1);
        let mut ready: BTreeSet<usize> = (0..order.len()).filter(|at| unmet[order[*at]] == 0).collect();
        let mut sorted = Vec::with_capacity(order.len());
        while let Some(at) = ready.pop_first() {
            let instance = order[at];
            sorted.push(instance);
            for dependent in &self.instances[instance].dependents {
                unmet[*dependent] -= 1;
                if unmet[*dependent] == 0 {
                    ready.insert(rank[*dependent]);
                }
            }
        }
        match order.iter().find(|instance| unmet[**instance] > 0) {
            None => Ok(sorted),
            Some(stuck) => {
                let message = format!("`{}` waits for itself, by way of an item before", self.label(*stuck));
                let fault = Diagnostic::at(self.step(*stuck).span, message);
                Err(vec![fault.hint("an item may read from items before it, not from one that reads from it")])
            }
        }
    }

    /// The instances an instance reads from, ascending.
    pub fn producers(&self, instance: usize) -> Vec<usize> {
        let given = self.instances[instance].inputs.iter().flat_map(|(_, given)| given);
        let mut producers: Vec<usize> = given.map(|given| given.instance).collect();
        producers.sort_unstable();
        producers.dedup();
        producers
    }

    /// Whether an outcome is one that this instance can have: see [`has_ports`].
    pub fn fits(&self, instance: usize, outcome: &Outcome) -> bool {
        let (own, declared) = (&self.instances[instance], self.step(instance).ports.outputs);
        has_ports(outcome, declared, declared.iter().filter(|port| makes(own, port)).map(|port| port.name))
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
        let items = axes.iter().zip(&self.instances[instance].items);
        let items = items.map(|(axis, item)| &self.graph.axes[*axis].items[*item]);
        let parts = labels(&self.graph, axes).into_iter().zip(items).map(|(axis, item)| format!("{axis}={item}"));
        parts.collect::<Vec<_>>().join(",")
    }

    /// Everything that decides the outputs of an instance, once the digests of its inputs are known.
    pub fn recipe(&self, instance: usize, digest: impl Fn(usize, &str) -> Digest) -> Recipe {
        let (step, params) = (self.step(instance), &self.instances[instance].params);
        Recipe {
            stage: step.stage.name().to_owned(),
            version: step.stage.version(),
            params: params.recipe.clone(),
            inputs: self.inputs(instance, digest),
            seed: params.draws.then(|| self.seed(instance)),
        }
    }

    /// What each input port of an instance reads, once the digests of its inputs are known.
    pub fn inputs(&self, instance: usize, digest: impl Fn(usize, &str) -> Digest) -> BTreeMap<String, RecipeInput> {
        let step = self.step(instance);
        // One by one: to collect them would sort a list of one or two first.
        let mut inputs = BTreeMap::new();
        for (port, given) in &self.instances[instance].inputs {
            let many = step.inputs.iter().any(|(p, feed)| p.name == *port && matches!(feed, Feed::Each { .. }));
            let input = match given.as_slice() {
                [one] if !many => RecipeInput::One(digest(one.instance, one.port)),
                list => RecipeInput::Many(
                    list.iter()
                        .map(|g| Gathered { point: g.point.clone(), digest: digest(g.instance, g.port) })
                        .collect(),
                ),
            };
            inputs.insert((*port).to_owned(), input);
        }
        inputs
    }

    fn seed(&self, instance: usize) -> SeedMaterial {
        let step = self.step(instance);
        let own = &self.instances[instance].items;
        let item = |axis: &usize| step.axes.iter().position(|known| known == axis).map_or(0, |place| own[place]);
        let items: Vec<usize> = step.stream_axes.iter().map(item).collect();
        let items = named(&self.graph, &step.stream_axes, &items);
        SeedMaterial { seed: self.graph.seed, stream: step.stream.clone(), items }
    }
}

/// Parameters, or what is wrong with them.
type Checked = Result<Arc<StepParams>, Vec<Counted>>;

struct Expansion<'a> {
    graph: &'a Graph,
    sight: &'a Sight<'a>,
    params: HashMap<(usize, Vec<usize>), Checked>,
    /// The fields of the stages met.
    fields: HashMap<&'static str, Vec<Field>>,
    faults: Faults,
    /// Bytes that the parameters may still take.
    room: usize,
}

/// At how many points a step is checked whose other axes have no items yet; it is checked at all of them later.
const LATER_POINTS: usize = 100;

/// The most bytes that the parameters of a plan may take, all put together.
const PARAMETERS_BYTES: usize = 256 << 20;

impl<'a> Expansion<'a> {
    fn new(graph: &'a Graph, sight: &'a Sight<'a>) -> Self {
        Self {
            graph,
            sight,
            params: HashMap::new(),
            fields: HashMap::new(),
            faults: Faults::default(),
            room: PARAMETERS_BYTES,
        }
    }

    /// The instances at all needed points that are not there yet; new ones are numbered on from those.
    fn run(mut self, needed: &Needed, there: &[Instance]) -> Result<Vec<Instance>, Vec<Diagnostic>> {
        let graph = self.graph;
        let (deferred, needed, waits) = (graph.deferred(), &needed.points, &needed.waits);
        let is_idle = |step: &usize| needed[*step].is_empty() && deferred[*step].is_none() && waits[*step].is_none();
        // By step: its points, sorted, each with the number of its instance.
        let mut numbers: Vec<Vec<(&[usize], usize)>> = vec![Vec::new(); graph.steps.len()];
        for (number, instance) in there.iter().enumerate() {
            numbers[instance.step].push((&instance.items, number));
        }
        let mut new: Vec<(usize, &Vec<usize>)> = Vec::new();
        for (index, points) in needed.iter().enumerate() {
            let own = &mut numbers[index];
            own.sort_unstable();
            let known = own.len();
            for items in points {
                if number_at(&own[..known], items).is_none() {
                    own.push((items, there.len() + new.len()));
                    new.push((index, items));
                }
            }
            own.sort_unstable();
        }
        let mut instances: Vec<Instance> = Vec::with_capacity(new.len());
        for (index, items) in new {
            let step = &graph.steps[index];
            let Some(params) = self.params(index, step, items) else { continue };
            let mut inputs = Vec::with_capacity(step.inputs.len());
            for (port, feed) in &step.inputs {
                let mut given = Vec::new();
                elements(graph, step, items, feed, &mut |element| {
                    if let Some(instance) = number_at(&numbers[element.step], &element.items) {
                        given.push(Given { instance, port: element.port, point: element.point });
                    }
                });
                if !given.is_empty() {
                    given.shrink_to_fit();
                    inputs.push((port.name, given));
                }
            }
            instances.push(Instance { step: index, items: items.clone(), params, inputs, dependents: Vec::new() });
        }
        if there.is_empty() {
            (0..needed.len()).filter(is_idle).for_each(|step| self.check_unneeded(step, &graph.steps[step]));
            let is_later = |step: &usize| needed[*step].is_empty() && !is_idle(step);
            (0..needed.len()).filter(is_later).for_each(|step| self.check_later(&graph.steps[step]));
        }
        if self.faults.is_empty() { Ok(instances) } else { Err(self.faults.into_list()) }
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

    /// Steps that wait for the items of an axis: what the items cannot change is checked at once.
    fn check_later(&mut self, step: &GraphStep) {
        let known: Vec<usize> = step.with_axes.iter().copied().filter(|axis| !self.graph.is_pending(*axis)).collect();
        for items in points(self.graph, &known).into_iter().take(LATER_POINTS) {
            let items = known.iter().copied().zip(items).collect();
            let faults = parameters::check_known(self.graph, step, &items);
            self.report(faults);
        }
    }

    fn params(&mut self, index: usize, step: &GraphStep, items: &[usize]) -> Option<Arc<StepParams>> {
        let item =
            |axis: &usize| step.axes.iter().zip(items).find(|(own, _)| *own == axis).map_or(0, |(_, item)| *item);
        let key = (index, step.with_axes.iter().map(item).collect::<Vec<_>>());
        let checked = if let Some(checked) = self.params.get(&key) {
            checked
        } else {
            let mentioned = step.with_axes.iter().copied().zip(key.1.iter().copied()).collect();
            let checked = self.check(step, &mentioned).map_err(|faults| self.faults.enter(faults));
            self.params.entry(key).or_insert(checked)
        };
        match checked {
            Ok(params) => Some(params.clone()),
            Err(faults) => {
                self.faults.count(faults);
                None
            }
        }
    }

    fn check(&mut self, step: &GraphStep, items: &BTreeMap<usize, usize>) -> Result<Arc<StepParams>, Vec<Diagnostic>> {
        let fields = self.fields.entry(step.stage.name()).or_insert_with(|| step.stage.fields());
        let params = parameters::check_with_files(self.graph, step, items, fields, self.sight)?;
        let left = self.room.checked_sub(value_bytes(&params.canonical)).ok_or_else(|| {
            let mib = PARAMETERS_BYTES >> 20;
            let message = format!("the parameters of all step instances together take more than {mib} MiB");
            vec![Diagnostic::general(message).hint("put long values into a file that the steps read")]
        })?;
        self.room = left;
        Ok(Arc::new(params))
    }

    fn report(&mut self, faults: Vec<Diagnostic>) {
        let entered = self.faults.enter(faults);
        self.faults.count(&entered);
    }
}

/// The number of the instance at a point, among sorted points.
fn number_at(numbers: &[(&[usize], usize)], items: &[usize]) -> Option<usize> {
    numbers.binary_search_by(|(own, _)| (*own).cmp(items)).ok().map(|place| numbers[place].1)
}

/// Tells producers of their consumers from a number on.
fn link(instances: &mut [Instance], from: usize) {
    for consumer in from..instances.len() {
        let given = instances[consumer].inputs.iter().flat_map(|(_, given)| given.iter().map(|g| g.instance));
        let mut producers: Vec<usize> = given.collect();
        producers.sort_unstable();
        producers.dedup();
        for producer in producers {
            instances[producer].dependents.push(consumer);
        }
    }
}

/// Whether an outcome has all outputs that are owed, and none but those declared, each of its kind.
pub fn has_ports<'a>(outcome: &Outcome, declared: &[Port], mut owed: impl Iterator<Item = &'a str>) -> bool {
    let is_declared = |(name, output): (&SafeName, &OutputRecord)| {
        declared.iter().any(|port| port.name == name.as_str() && port.kinds[0].word() == output.kind)
    };
    outcome.outputs.iter().all(is_declared) && owed.all(|port| outcome.outputs.get(port).is_some())
}

/// Whether an output port of an instance is made: optional ones only where the input of the same name is given.
pub fn makes(instance: &Instance, port: &Port) -> bool {
    port.arity != Arity::Optional || instance.inputs.iter().any(|(given, _)| *given == port.name)
}
