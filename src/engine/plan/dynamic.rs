//! Axes whose items are made by a step, and pairs that tell what is gathered: read from records at planning time, or from the output of the step during the run.

use std::collections::BTreeSet;
use std::sync::OnceLock;

use rockface_cache::{Outcome, Store};
use rockface_core::artefact::{Artefact, Cell, Kind, Pair, Table};
use serde_json::{Map, Value};

use super::graph::{Dynamic, ListPoint, Partners};
use super::instances::Plan;
use super::parameters::NAME_COLUMN;
use super::points::{Wait, count, list_points, named};
use super::sight::HashFile;
use crate::diagnostic::Diagnostic;
use crate::pipeline::bad_item;

/// The items of a list, each with what `${axis}` stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct Items {
    /// The names of the items, no two alike, in the order of the list.
    pub names: Vec<String>,
    /// A text each, or a map of the columns of a row.
    pub values: Vec<Value>,
}

impl Items {
    /// What is at the first place where another list differs, in this list and in that; with the values of the items, where `values` asks
    /// for them.
    fn difference(&self, other: &Self, values: bool) -> Option<[String; 2]> {
        if self.names.len() != other.names.len() {
            return Some([self, other].map(|list| format!("has {} items", list.names.len())));
        }
        let pairs = || self.names.iter().zip(&other.names).enumerate();
        if let Some((number, (own, name))) = pairs().find(|(_, (own, name))| own != name) {
            return Some([own, name].map(|name| format!("number {} is `{name}`", number + 1)));
        }
        let at = (0..self.names.len()).find(|at| values && self.values[*at] != other.values[*at])?;
        Some([self, other].map(|list| format!("`{}` is {}", list.names[at], list.values[at])))
    }
}

/// What a recorded list of pairs puts together.
pub fn partners_of(outcome: &Outcome, port: &str, store: &Store) -> Result<Partners, String> {
    let Some(output) = outcome.outputs.get(port) else { return Err(format!("it made no `{port}`")) };
    let bytes = store.get(&output.digest).map_err(|error| error.to_string())?;
    let pairs = match Artefact::decode(Kind::Pairs, &bytes) {
        Ok(Artefact::Pairs(pairs)) => pairs,
        Ok(other) => return Err(format!("`{port}` is a {}, not a list of pairs", other.kind())),
        Err(error) => return Err(format!("`{port}` cannot be read back: {error}")),
    };
    let mut partners = Partners::new();
    for Pair { first, second, .. } in pairs.pairs {
        partners.entry(first.clone()).or_default().insert(second.clone());
        partners.entry(second).or_default().insert(first);
    }
    Ok(partners)
}

/// The items of a recorded output: from its record, or for the rows of a table from the table itself.
pub fn items_of(outcome: &Outcome, port: &str, store: &Store) -> Result<Items, String> {
    let Some(output) = outcome.outputs.get(port) else { return Err(format!("it made no `{port}`")) };
    let items = match (&output.items, output.kind.parse::<Kind>()) {
        (Some(names), _) => {
            Items { names: names.clone(), values: names.iter().map(|name| Value::from(name.clone())).collect() }
        }
        (None, Ok(Kind::Table)) => {
            let bytes = store.get(&output.digest).map_err(|error| error.to_string())?;
            match Artefact::decode(Kind::Table, &bytes) {
                Ok(Artefact::Table(table)) => rows(&table),
                Ok(other) => return Err(format!("`{port}` is a {}, not a table", other.kind())),
                Err(error) => return Err(format!("`{port}` cannot be read back: {error}")),
            }
        }
        _ => return Err(format!("`{port}` is no list")),
    };
    check(&items)?;
    Ok(items)
}

fn rows(table: &Table) -> Items {
    let naming = table.column(NAME_COLUMN);
    let name = |(number, row): (usize, &Vec<Cell>)| naming.map_or_else(|| number.to_string(), |at| row[at].to_string());
    let value = |row: &Vec<Cell>| {
        let cells = table.columns.iter().zip(row).map(|(column, cell)| (column.clone(), cell_value(cell)));
        Value::Object(cells.collect::<Map<_, _>>())
    };
    Items { names: table.rows.iter().enumerate().map(name).collect(), values: table.rows.iter().map(value).collect() }
}

/// Whole numbers are written as such, so that they can stand in a text or be a count.
fn cell_value(cell: &Cell) -> Value {
    match cell {
        Cell::Number(x) if x.fract() == 0.0 && x.abs() < 9e15 => Value::from(*x as i64),
        Cell::Number(x) => Value::from(*x),
        Cell::Text(text) => Value::from(text.clone()),
        Cell::Flag(flag) => Value::from(*flag),
        Cell::Empty(()) => Value::Null,
    }
}

fn check(items: &Items) -> Result<(), String> {
    let mut seen = BTreeSet::new();
    if items.names.is_empty() {
        return Err("the list is empty, and an axis needs an item".to_owned());
    }
    for name in &items.names {
        if let Some(bad) = bad_item(name) {
            return Err(bad);
        }
        if !seen.insert(name) {
            return Err(format!("`{name}` occurs twice in the list"));
        }
    }
    Ok(())
}

/// Why the instances of a step cannot be told yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// The items of this axis are made by a step that has not run.
    Items(usize),
    /// The pairs that tell what is gathered are made by a step that has not run.
    Pairs(Wait),
}

impl Plan {
    /// By step: why some of its instances cannot be told yet.
    pub fn unknown(&self) -> Vec<Option<Unknown>> {
        let items = self.graph.deferred().into_iter().map(|axis| axis.map(Unknown::Items));
        items.zip(&self.waits).map(|(items, wait)| items.or(wait.map(Unknown::Pairs))).collect()
    }

    /// By step: whether instances that the plan does not have yet will read what it makes and does not keep.
    pub fn awaits_readers(&self) -> Vec<bool> {
        let (graph, unknown) = (&self.graph, self.unknown());
        let mut awaits = vec![false; graph.steps.len()];
        if unknown.iter().all(Option::is_none) {
            return awaits;
        }
        let mut counts = vec![0u64; graph.steps.len()];
        self.instances.iter().for_each(|instance| counts[instance.step] += 1);
        // What only such an instance reads is not in the plan either, nor what is read by that.
        let has_all = |step: usize| counts[step] >= count(graph, &graph.steps[step].axes);
        let wanted = graph.wanted();
        let mut open: Vec<usize> = (0..awaits.len()).filter(|step| wanted[*step] && unknown[*step].is_some()).collect();
        let mut seen: BTreeSet<usize> = open.iter().copied().collect();
        while let Some(step) = open.pop() {
            for source in graph.steps[step].inputs.iter().flat_map(|(_, feed)| feed.sources()) {
                awaits[source.step] |= !graph.steps[source.step].keep;
                if !has_all(source.step) && seen.insert(source.step) {
                    open.push(source.step);
                }
            }
        }
        awaits
    }

    /// The axes of wanted steps that wait for an instance, with the port their items come from.
    pub fn waiting_axes(&self, instance: usize) -> Vec<(usize, &'static str)> {
        let own = &self.instances[instance];
        let axes = &self.graph.steps[own.step].axes;
        let waits = |axis: usize| {
            let dynamic = self.graph.dynamic[axis].as_ref().filter(|dynamic| !dynamic.known)?;
            let source = &dynamic.source;
            let fits =
                |(axis, item): (&usize, &usize)| source.picks.iter().all(|(a, picked)| a != axis || picked == item);
            let here = source.step == own.step && axes.iter().zip(&own.items).all(fits);
            (here && self.graph.is_met(axis)).then_some((axis, source.port.name))
        };
        (0..self.graph.axes.len()).filter_map(waits).collect()
    }

    /// The lists of pairs made by an instance that others wait for.
    pub fn waiting_lists(&self, instance: usize) -> Vec<ListPoint> {
        if self.lists.is_empty() {
            return Vec::new();
        }
        let own = &self.instances[instance];
        let made = self.step(instance).ports.outputs.iter().map(|port| (own.step, port.name, own.items.clone()));
        made.filter(|list| self.lists.contains(list) && !self.graph.partners.contains_key(list)).collect()
    }

    /// Tells the plan the items of an axis that an instance makes; [`Plan::grow`] then adds what follows from them. Where other
    /// instances of its step make lists for the axis too, the items are taken when all lists are there. Returns whether they were taken.
    ///
    /// # Errors
    /// Lists that differ, and what was named beforehand and is no item.
    pub fn set_items(&mut self, axis: usize, instance: usize, items: Items) -> Result<bool, Vec<Diagnostic>> {
        let Some(dynamic) = &self.graph.dynamic[axis] else { return Ok(false) };
        let points = list_points(&self.graph, &dynamic.source);
        if points.len() > 1 {
            let own = self.instances[instance].items.clone();
            let lists = self.graph.dynamic[axis].as_mut().map(|dynamic| &mut dynamic.lists);
            let count = lists.map_or(0, |lists| {
                lists.insert(own, items.clone());
                lists.len()
            });
            if count < points.len() {
                return Ok(false);
            }
            self.check_equal(axis)?;
        }
        self.replace_items(axis, items, true);
        let faults = self.graph.settle(axis);
        if faults.is_empty() { Ok(true) } else { Err(faults) }
    }

    /// Whether all lists for an axis have the same items in the same order, and the same values where parameters take these.
    fn check_equal(&self, axis: usize) -> Result<(), Vec<Diagnostic>> {
        let graph = &self.graph;
        let Some(Dynamic { source, lists, .. }) = &graph.dynamic[axis] else { return Ok(()) };
        let mut lists = lists.iter();
        let Some((first, wanted)) = lists.next() else { return Ok(()) };
        let wanted_steps = graph.wanted();
        let is_mentioned =
            graph.steps.iter().zip(wanted_steps).any(|(step, wanted)| wanted && step.with_axes.contains(&axis));
        let differing = lists.find_map(|(point, items)| Some((point, wanted.difference(items, is_mentioned)?)));
        let Some((point, [here, there])) = differing else { return Ok(()) };
        let own = &graph.axes[axis];
        let step = &graph.steps[source.step];
        let label = |items: &[usize]| {
            let items = named(graph, &step.axes, items);
            items.iter().map(|(axis, item)| format!("{axis}={item}")).collect::<Vec<_>>().join(",")
        };
        let (list, first, point) = (format!("{}.{}", step.name, source.port.name), label(first), label(point));
        let message = format!(
            "axis `{}` takes its items from `{list}`, and the lists differ: at [{first}] {here}, at [{point}] {there}",
            own.name.text
        );
        let hint = format!(
            "make lists with the same items in the same order, or pick one: `{list}[{first}]`; of a parameter that changes the list, such as a number of images, make a run of each value by `--set` and hold them side by side by `runs compare`"
        );
        Err(vec![Diagnostic::at(own.from.as_ref().map_or(own.name.span, |from| from.span), message).hint(hint)])
    }

    fn replace_items(&mut self, axis: usize, items: Items, known: bool) {
        let own = &mut self.graph.axes[axis];
        (own.items, own.values) = (items.names, items.values.into());
        self.graph.numbers[axis] = OnceLock::new();
        if let Some(dynamic) = &mut self.graph.dynamic[axis] {
            dynamic.known = known;
            dynamic.lists.clear();
        }
    }

    /// Removes the items of an axis whose step failed.
    pub fn unset_items(&mut self, axis: usize) {
        self.replace_items(axis, Items { names: Vec::new(), values: Vec::new() }, false);
    }

    /// Takes the items of all lists that are on record, and grows accordingly.
    pub fn take_recorded(&mut self, store: &Store, hash: &HashFile) -> Result<(), Vec<Diagnostic>> {
        loop {
            let tells = |instance: &usize| {
                !self.waiting_axes(*instance).is_empty() || !self.waiting_lists(*instance).is_empty()
            };
            let tellers: Vec<usize> = (0..self.instances.len()).filter(tells).collect();
            let mut grown = false;
            for instance in tellers {
                let Some(outcome) = self.recorded(store, instance) else { continue };
                for (axis, port) in self.waiting_axes(instance) {
                    // What cannot be read now is reported when the run reaches it.
                    if let Ok(items) = items_of(&outcome, port, store) {
                        grown |= self.set_items(axis, instance, items)?;
                    }
                }
                for list in self.waiting_lists(instance) {
                    if let Ok(partners) = partners_of(&outcome, list.1, store) {
                        self.graph.partners.insert(list, partners);
                        grown = true;
                    }
                }
            }
            if !grown {
                return Ok(());
            }
            self.grow(hash)?;
            self.order()?;
        }
    }

    /// What is on record of an instance, if it and all it comes from are.
    fn recorded(&self, store: &Store, wanted: usize) -> Option<Outcome> {
        let mut upstream = BTreeSet::from([wanted]);
        let mut open = vec![wanted];
        while let Some(instance) = open.pop() {
            for given in self.instances[instance].inputs.iter().flat_map(|(_, given)| given) {
                if upstream.insert(given.instance) {
                    open.push(given.instance);
                }
            }
        }
        let mut outcomes: std::collections::BTreeMap<usize, Outcome> = std::collections::BTreeMap::new();
        for instance in upstream {
            // Producers have lower numbers, so their outcomes are there.
            let recipe = self.recipe(instance, |producer, port| outcomes[&producer].outputs[port].digest);
            let outcome =
                super::hit(store, &recipe.key(), self.step(instance).keep, |outcome| self.fits(instance, outcome))?;
            outcomes.insert(instance, outcome);
        }
        outcomes.remove(&wanted)
    }
}
