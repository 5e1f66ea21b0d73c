//! What a Python file says of a function: asked of Python, which reads the text and executes nothing of it.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::super::declared::Declared;
use super::{INTERPRETER, types};
use rockface_core::Planner;
use rockface_core::params::{Fault, ParamType};

/// Finds the package without importing it, and runs the reader that is in it.
const READER: &str = "\
import importlib.util, runpy, sys
spec = importlib.util.find_spec('rockface')
if spec is None or not spec.submodule_search_locations:
    sys.exit('ModuleNotFoundError: No module named rockface')
runpy.run_path(spec.submodule_search_locations[0] + '/_describe.py', run_name='__main__')
";

/// What is known of a function.
#[derive(Deserialize)]
struct Described {
    inputs: Map<String, Value>,
    outputs: Map<String, Value>,
    types: Map<String, Value>,
    sources: BTreeMap<String, String>,
    packages: BTreeMap<String, String>,
    draws: bool,
    /// Files and folders all this rests on.
    rests_on: Vec<String>,
}

/// Why a function cannot be used.
#[derive(Deserialize)]
struct Refused {
    path: Vec<String>,
    message: String,
    #[serde(default)]
    known: Vec<String>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Reply {
    Refused { fault: Refused },
    Described(Described),
}

/// The keys that follow from module and function.
pub fn complete(with: &Value, planner: &dyn Planner) -> Result<Map<String, Value>, Vec<Fault>> {
    let text = |key: &str| with.get(key).and_then(Value::as_str);
    // What is missing or no text is reported with the other parameters.
    let (Some(module), Some(function)) = (text("module"), text("function")) else {
        return Err(missing(with));
    };
    let path = planner.path(module);
    if !path.is_file() {
        return Err(vec![
            Fault::new(format!("cannot read `{}`: there is no such file", path.display())).below("module"),
        ]);
    }
    let question = json!({ "module": path, "function": function }).to_string();
    let answer = planner.ask(INTERPRETER, &["-c", READER], &question).map_err(|error| vec![unasked(&error)])?;
    match serde_json::from_str(&answer) {
        Ok(Reply::Described(described)) => {
            described.rests_on.iter().for_each(|path| planner.rests_on(path.as_ref()));
            merged(with, described)
        }
        Ok(Reply::Refused { fault: Refused { path, message, known } }) => {
            let fault = Fault { known, ..Fault::new(message) };
            Err(vec![path.iter().rev().fold(fault, |fault, key| fault.below(key))])
        }
        Err(error) => Err(vec![Fault::new(format!("Python's answer about `{module}` cannot be read: {error}"))]),
    }
}

fn missing(with: &Value) -> Vec<Fault> {
    let fault = |key: &&str| Fault::new(format!("`{key}` (text) is missing: module: my_stages.py, function: my_stage"));
    let lacking: Vec<_> = ["module", "function"].into_iter().filter(|key| with.get(key).is_none()).collect();
    if lacking.is_empty() {
        return vec![Fault::new("`module` is a path and `function` a name")];
    }
    lacking.iter().map(fault).collect()
}

fn unasked(error: &str) -> Fault {
    if error.contains("No module named rockface") {
        let message = "Python has no package `rockface`: install it there (`pip install .` in a clone, or a wheel), or name another one in ROCKFACE_PYTHON";
        return Fault::new(message);
    }
    Fault::new(format!("Python cannot be asked what the module says: {error}"))
}

fn merged(with: &Value, described: Described) -> Result<Map<String, Value>, Vec<Fault>> {
    let Described { inputs, outputs, types, sources, packages, draws, .. } = described;
    let mut faults = Vec::new();
    for (key, follows) in [("inputs", &inputs), ("outputs", &outputs)] {
        faults.extend(with.get(key).and_then(|written| differs(key, written, follows)));
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    // Defaults are filled in, so that it makes no difference whether they are written.
    let mut params = with.get("params").and_then(Value::as_object).cloned().unwrap_or_default();
    for (name, kind) in types.iter().filter(|(_, kind)| !types::is_file(kind)) {
        if let (Some(default), false) = (kind.get("default"), params.contains_key(name)) {
            params.insert(name.clone(), default.clone());
        }
    }
    let mut added = Map::new();
    let parts = [("inputs", inputs), ("outputs", outputs), ("types", types), ("params", params)];
    added.extend(parts.into_iter().map(|(key, map)| (key.to_owned(), Value::Object(map))));
    added.insert("sources".to_owned(), json!(sources));
    added.insert("packages".to_owned(), json!(packages));
    added.insert("draws".to_owned(), Value::Bool(draws));
    Ok(added)
}

/// Ports that are written and are not those of the function.
fn differs(key: &str, written: &Value, follows: &Map<String, Value>) -> Option<Fault> {
    let read = |value: &Value| BTreeMap::<String, Declared>::decode(value);
    let (written, follows) = (read(written).ok()?, read(&Value::Object(follows.clone())).ok()?);
    let told = |ports: &BTreeMap<String, Declared>| {
        ports.iter().map(|(name, port)| format!("{name}: {}", port.kind)).collect::<Vec<_>>().join(", ")
    };
    (written != follows).then(|| {
        let message = format!(
            "the function has {{{}}}, not {{{}}}; leave them out, they follow from it",
            told(&follows),
            told(&written)
        );
        Fault::new(message).below(key)
    })
}
