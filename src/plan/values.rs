//! The values of a pipeline's parameters, of which one may refer to another.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::diagnostic::{Diagnostic, Span};
use crate::pipeline::{Key, Node, escape_hint, filled, mentioned};

/// Puts the values of parameters into each other until no `${name}` is left; says what stands in the way. Parameters that
/// cannot be told, and those that need them, are left out.
pub fn resolve(params: &[(Key, Node)], axes: &[&str]) -> (BTreeMap<String, Value>, Vec<Diagnostic>) {
    let mut known: BTreeMap<String, Option<Value>> = BTreeMap::new();
    let mut faults = Vec::new();
    let names: Vec<&str> = params.iter().map(|(key, _)| key.name.as_str()).collect();
    let mut open: Vec<(&Key, &Node, BTreeSet<String>)> = Vec::new();
    for (key, node) in params {
        let mut needs = Vec::new();
        mentioned(node, &mut needs);
        let strangers: Vec<_> = needs.iter().filter_map(|(name, span)| stranger(name, *span, &names, axes)).collect();
        if strangers.is_empty() && !node.holds_bad_number() {
            open.push((key, node, needs.into_iter().map(|(name, _)| name).collect()));
        } else {
            known.insert(key.name.clone(), None);
        }
        faults.extend(strangers);
    }
    while !open.is_empty() {
        let (now, later): (Vec<_>, Vec<_>) =
            open.into_iter().partition(|(_, _, needs)| needs.iter().all(|name| known.contains_key(name)));
        if now.is_empty() {
            faults.extend(circle(&later));
            break;
        }
        for (key, node, needs) in now {
            let able = needs.iter().all(|name| known.get(name).is_some_and(Option::is_some));
            let value = able.then(|| filled(node, &|name| known.get(name).cloned().flatten()));
            let value = value.transpose().unwrap_or_else(|fault| {
                faults.push(fault);
                None
            });
            known.insert(key.name.clone(), value);
        }
        open = later;
    }
    (known.into_iter().filter_map(|(name, value)| Some((name, value?))).collect(), faults)
}

/// The fault of a name that is no parameter.
fn stranger(name: &str, span: Span, params: &[&str], axes: &[&str]) -> Option<Diagnostic> {
    if params.contains(&name) {
        None
    } else if axes.contains(&name) {
        let message = format!("a parameter cannot depend on axis `{name}`");
        Some(Diagnostic::at(span, message).hint(format!("mention ${{{name}}} in the `with` of a step")))
    } else {
        let message = format!("`${{{name}}}` names no parameter");
        Some(Diagnostic::at(span, message).suggest(name, params.iter().copied()).or_hint(escape_hint(name)))
    }
}

fn circle(open: &[(&Key, &Node, BTreeSet<String>)]) -> Vec<Diagnostic> {
    let names: Vec<&str> = open.iter().map(|(key, _, _)| key.name.as_str()).collect();
    let message = format!("these parameters wait for each other in a circle: {}", names.join(", "));
    let first = open.first().map(|(_, node, _)| Diagnostic::at(node.span, message));
    first.map(|fault| fault.hint("give one of them a value of its own")).into_iter().collect()
}
