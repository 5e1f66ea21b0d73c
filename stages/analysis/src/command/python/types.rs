//! Checks the values of a function's parameters against the types it declares, before anything runs.

use serde_json::Value;

use super::PythonParams;
use rockface_core::params::Fault;

/// All that is wrong with `params` and `files`.
pub fn check(params: &PythonParams) -> Vec<Fault> {
    let mut faults = Vec::new();
    for (name, value) in &params.params {
        let kind = params.types.get(name).filter(|kind| !is_file(kind));
        let message = match kind {
            Some(kind) => fault(kind, value),
            None if params.types.contains_key(name) => Some("it is a file: name it under `files`".to_owned()),
            None => {
                faults.push(unknown(params, name, "params", |kind| !is_file(kind)));
                continue;
            }
        };
        faults.extend(message.map(|message| Fault::new(message).below(name).below("params")));
    }
    for name in params.files.keys() {
        if params.types.get(name).is_none_or(|kind| !is_file(kind)) {
            faults.push(unknown(params, name, "files", is_file));
        }
    }
    for (name, kind) in &params.types {
        let given = if is_file(kind) { params.files.contains_key(name) } else { params.params.contains_key(name) };
        if !given && kind.get("default").is_none() {
            let section = if is_file(kind) { "files" } else { "params" };
            let message = format!("`{name}` ({}) of the function is missing under `{section}`", word(kind));
            faults.push(Fault::new(message));
        }
    }
    faults
}

/// Whether it is a file, which stands under `files`.
pub fn is_file(kind: &Value) -> bool {
    word(kind) == "file"
}

fn word(kind: &Value) -> &str {
    kind.get("type").and_then(Value::as_str).unwrap_or("any")
}

fn unknown(params: &PythonParams, name: &str, section: &str, fits: impl Fn(&Value) -> bool) -> Fault {
    let known = params.types.iter().filter(|(_, kind)| fits(kind)).map(|(name, _)| name.clone()).collect();
    let message = format!("the function `{}` has no such parameter `{name}`", params.function);
    let fault = Fault { path: vec![name.to_owned()], known, at_key: true, ..Fault::new(message) };
    fault.below(section)
}

/// What is wrong with a value.
fn fault(kind: &Value, value: &Value) -> Option<String> {
    if value.is_null() && kind.get("optional") == Some(&Value::Bool(true)) {
        return None;
    }
    let wanted = word(kind);
    let fits = match wanted {
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|number| number.fract() == 0.0),
        "boolean" => value.is_boolean(),
        "text" => value.is_string(),
        "list" => value.is_array(),
        _ => true,
    };
    if !fits {
        return Some(format!("expected {}, found {value}", name_of(wanted)));
    }
    let items = value.as_array().into_iter().flatten();
    let inner = kind.get("of").and_then(|of| items.enumerate().find_map(|(at, item)| Some((at, fault(of, item)?))));
    if let Some((at, message)) = inner {
        return Some(format!("item {at}: {message}"));
    }
    let choices = kind.get("choices").and_then(Value::as_array);
    if let Some(choices) = choices.filter(|choices| !choices.contains(value)) {
        let listed: Vec<String> = choices.iter().map(ToString::to_string).collect();
        return Some(format!("expected one of {}, found {value}", listed.join(", ")));
    }
    let bound = |key: &str| kind.get(key).and_then(Value::as_f64);
    let number = value.as_f64()?;
    let (low, high) = (bound("min"), bound("max"));
    let holds = low.is_none_or(|low| number >= low) && high.is_none_or(|high| number <= high);
    let told = |bound: Option<f64>| bound.map_or_else(|| "any".to_owned(), |bound| bound.to_string());
    (!holds).then(|| format!("{number} is out of range: {} to {}", told(low), told(high)))
}

fn name_of(wanted: &str) -> &str {
    match wanted {
        "number" => "a number",
        "integer" => "a whole number",
        "boolean" => "true or false",
        "text" => "text",
        "list" => "a list",
        other => other,
    }
}
