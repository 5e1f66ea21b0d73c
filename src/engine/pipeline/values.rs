//! The values of a pipeline's parameters, of which one may refer to another.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::node::{Key, Node};
use super::substitute::{escape_hint, filled, mentioned, parted, value_bytes, value_of};
use crate::diagnostic::{Diagnostic, SHOWN, Span, listed};

/// The most bytes that all parameters together may take once they are filled in.
const PARAMETERS_BYTES: usize = 64 << 20;

/// A parameter that has no value yet.
struct Open<'n> {
    key: &'n Key,
    node: &'n Node,
    /// The names it needs.
    needs: BTreeSet<String>,
}

/// Fills the values of parameters into each other until no `${name}` is left, and reports what prevents that. Parameters that
/// cannot be filled in, and those that need them, are left out; `unread` ones have been reported already.
pub fn resolve(
    params: &[(Key, Node)],
    axes: &[&str],
    unread: &BTreeSet<String>,
) -> (BTreeMap<String, Value>, Vec<Diagnostic>) {
    // Whether a parameter has got its value.
    let mut known: BTreeMap<String, bool> = BTreeMap::new();
    let mut values: BTreeMap<String, Value> = BTreeMap::new();
    let mut faults = Vec::new();
    let names: BTreeSet<&str> = params.iter().map(|(key, _)| key.name.as_str()).collect();
    let mut open: Vec<Open> = Vec::new();
    for (key, node) in params {
        let mut needs = Vec::new();
        mentioned(node, &mut needs);
        let few = faults.len() < SHOWN;
        let strange = |(name, span): &(String, Span)| stranger(name, *span, &names, axes, few);
        let strangers: Vec<_> = needs.iter().filter_map(strange).collect();
        if strangers.is_empty() && !node.holds_bad_number() && !unread.contains(&key.name) {
            let needs = needs.into_iter().map(|(name, _)| parted(&name).0.to_owned()).collect();
            open.push(Open { key, node, needs });
        } else {
            known.insert(key.name.clone(), false);
        }
        faults.extend(strangers);
    }
    let mut room = PARAMETERS_BYTES;
    for Open { key, node, needs } in ordered(open, &known, &mut faults) {
        let able = needs.iter().all(|name| known.get(name) == Some(&true));
        let value = able.then(|| filled(node, &|name| value_of(&values, name)));
        let value = value.transpose().and_then(|value| within(value, &mut room, node).map_err(|fault| vec![fault]));
        let value = value.unwrap_or_else(|found| {
            faults.extend(found);
            None
        });
        known.insert(key.name.clone(), value.is_some());
        values.extend(value.map(|value| (key.name.clone(), value)));
    }
    (values, faults)
}

/// Takes the bytes of a value off those that are left.
fn within(value: Option<Value>, room: &mut usize, node: &Node) -> Result<Option<Value>, Diagnostic> {
    let left = room.checked_sub(value.as_ref().map_or(0, value_bytes));
    *room = left.ok_or_else(|| {
        let message = format!("with this one all parameters together take more than {} MiB", PARAMETERS_BYTES >> 20);
        Diagnostic::at(node.span, message).hint("put long values into files that the steps read")
    })?;
    Ok(value)
}

/// Parameters after those they need; the fault of a circle where there is one, and its parameters are left out.
fn ordered<'n>(open: Vec<Open<'n>>, known: &BTreeMap<String, bool>, faults: &mut Vec<Diagnostic>) -> Vec<Open<'n>> {
    let mut needed_by: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    let mut unmet = vec![0_usize; open.len()];
    for (number, one) in open.iter().enumerate() {
        for name in one.needs.iter().filter(|name| !known.contains_key(*name)) {
            needed_by.entry(name).or_default().push(number);
            unmet[number] += 1;
        }
    }
    let mut order: Vec<usize> = (0..open.len()).filter(|number| unmet[*number] == 0).collect();
    let mut done = 0;
    while let Some(number) = order.get(done) {
        for later in needed_by.get(open[*number].key.name.as_str()).into_iter().flatten() {
            unmet[*later] -= 1;
            if unmet[*later] == 0 {
                order.push(*later);
            }
        }
        done += 1;
    }
    if order.len() < open.len() {
        let circling: Vec<&Open> =
            open.iter().zip(&unmet).filter(|(_, unmet)| **unmet > 0).map(|(one, _)| one).collect();
        faults.extend(circle(&circling));
    }
    let mut open: Vec<Option<Open>> = open.into_iter().map(Some).collect();
    order.into_iter().filter_map(|number| open[number].take()).collect()
}

/// The fault of a name that is no parameter, with a suggestion while the faults are few.
fn stranger(name: &str, span: Span, params: &BTreeSet<&str>, axes: &[&str], few: bool) -> Option<Diagnostic> {
    let base = parted(name).0;
    if params.contains(base) {
        None
    } else if axes.contains(&base) {
        let message = format!("a parameter cannot depend on axis `{name}`");
        Some(Diagnostic::at(span, message).hint(format!("mention ${{{name}}} in the `with` of a step")))
    } else {
        let fault = Diagnostic::at(span, format!("`${{{name}}}` names no parameter"));
        let fault = if few { fault.suggest(name, params.iter().copied()) } else { fault };
        Some(fault.or_hint(escape_hint(name)))
    }
}

fn circle(open: &[&Open]) -> Option<Diagnostic> {
    let names = open.iter().map(|one| one.key.name.as_str());
    let message = format!("these parameters wait for each other in a circle: {}", listed(names));
    let first = open.first().map(|one| Diagnostic::at(one.node.span, message));
    first.map(|fault| fault.hint("give one of them a value of its own"))
}
