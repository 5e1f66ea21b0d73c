//! Ports that a pipeline declares: a kind, how many, and the extension of the file.

use std::collections::BTreeMap;
use std::sync::Mutex;

use serde_json::{Value, json};

use rockface_core::artefact::{Artefact, Kind};
use rockface_core::params;
use rockface_core::params::{Fault, ParamType};
use rockface_core::{Arity, Port, Ports, StageError};

/// A port as the parameters of a step declare it, without its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Declared {
    /// The kind of artefact.
    pub kind: Kind,
    /// How many artefacts it takes.
    pub arity: Arity,
    /// The extension of the file, where it is not that of the kind.
    extension: Option<String>,
}

impl Declared {
    /// The extension of the file, without the dot.
    pub fn extension(&self) -> &str {
        self.extension.as_deref().unwrap_or(self.kind.extension())
    }

    /// Whether a table is written as CSV.
    pub fn is_csv(&self) -> bool {
        self.kind == Kind::Table && self.extension() == "csv"
    }

    /// Where the file of a port lies: what `{in.port}` or `{out.port}` stands for.
    pub fn place(&self, side: &str, port: &str) -> String {
        if self.arity == Arity::Many { format!("{side}/{port}") } else { format!("{side}/{port}.{}", self.extension()) }
    }

    /// The file of an artefact.
    pub fn bytes(&self, port: &str, artefact: &Artefact) -> Result<Vec<u8>, StageError> {
        let bytes = match artefact {
            Artefact::Table(table) if self.is_csv() => table.to_csv(),
            other => other.encode(),
        };
        bytes.map_err(|error| StageError::new(format!("input `{port}` cannot be written: {error}")))
    }

    fn from_map(map: &serde_json::Map<String, Value>) -> Result<Self, Vec<Fault>> {
        const KEYS: [&str; 4] = ["kind", "many", "optional", "extension"];
        if let Some(key) = map.keys().find(|key| !KEYS.contains(&key.as_str())) {
            let known = KEYS.iter().map(ToString::to_string).collect();
            let message = format!("unknown key `{key}` of a port");
            return Err(vec![Fault { path: vec![key.clone()], message, known, at_key: true }]);
        }
        let flag = |key: &str| map.get(key).map_or(Ok(false), bool::decode);
        let kind = kind(map.get("kind").unwrap_or(&Value::Null))?;
        let arity = match (flag("many")?, flag("optional")?) {
            (true, true) => return Err(vec![Fault::new("a port is `many` or `optional`, not both")]),
            (true, false) => Arity::Many,
            (false, true) => Arity::Optional,
            (false, false) => Arity::One,
        };
        let extension = map.get("extension").map(String::decode).transpose()?;
        if let Some(extension) = &extension {
            let fits = kind == Kind::File
                || extension == kind.extension()
                || (kind, extension.as_str()) == (Kind::Table, "csv");
            let plain = !extension.is_empty() && extension.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            if !fits || !plain {
                let message =
                    format!("a {kind} has no extension `{extension}`; letters and digits for a file, csv for a table");
                return Err(vec![Fault { path: vec!["extension".to_owned()], ..Fault::new(message) }]);
            }
        }
        let extension = extension.filter(|extension| extension != kind.extension());
        Ok(Self { kind, arity, extension })
    }
}

fn kind(value: &Value) -> Result<Kind, Vec<Fault>> {
    let found = value.as_str().and_then(|word| word.parse().ok());
    found.ok_or_else(|| {
        let known = Kind::ALL.iter().map(|kind| kind.word().to_owned()).collect();
        let message = format!("{value} is no kind of artefact");
        vec![Fault { known, ..Fault::new(message) }]
    })
}

impl ParamType for Declared {
    fn kind() -> params::Kind {
        params::Kind::Any
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        match value {
            Value::Object(map) => Self::from_map(map),
            word => Ok(Self { kind: kind(word)?, arity: Arity::One, extension: None }),
        }
    }
    fn encode(&self) -> Value {
        let (many, optional) = (self.arity == Arity::Many, self.arity == Arity::Optional);
        json!({ "kind": self.kind.word(), "many": many, "optional": optional, "extension": self.extension() })
    }
}

/// The ports that a step's `with` declares; `without` is the fault of one that declares no output.
pub fn ports(with: &Value, without: &str) -> Result<Ports, Vec<Fault>> {
    let empty = Value::Object(serde_json::Map::new());
    let side = |key: &str| {
        let declared = BTreeMap::<String, Declared>::decode(with.get(key).unwrap_or(&empty));
        let bad = |name: &String| name.is_empty() || !name.chars().all(|c| c.is_alphanumeric() || c == '_' || c == '-');
        let declared = declared.and_then(|ports| match ports.keys().find(|name| bad(name)) {
            Some(name) => Err(vec![Fault::new(format!("`{name}` cannot name a port: letters, digits, `-` and `_`"))]),
            None => Ok(ports),
        });
        declared.map_err(|faults| faults.into_iter().map(|fault| fault.below(key)).collect::<Vec<_>>())
    };
    let (inputs, outputs) = (side("inputs")?, side("outputs")?);
    if outputs.is_empty() {
        return Err(vec![Fault::new(without)]);
    }
    if let Some(port) = outputs.iter().find(|(_, declared)| declared.arity != Arity::One).map(|(port, _)| port) {
        let fault = Fault::new("every output is one file that is always made; no `many` or `optional`");
        return Err(vec![fault.below(port).below("outputs")]);
    }
    Ok(ports_of(&inputs, &outputs))
}

/// Ports live as long as the program; equal declarations share theirs.
static KNOWN: Mutex<BTreeMap<String, Ports>> = Mutex::new(BTreeMap::new());

/// The ports of declarations.
pub fn ports_of(inputs: &BTreeMap<String, Declared>, outputs: &BTreeMap<String, Declared>) -> Ports {
    let key = json!([inputs.encode(), outputs.encode()]).to_string();
    let mut known = KNOWN.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    *known.entry(key).or_insert_with(|| Ports { inputs: leaked(inputs), outputs: leaked(outputs) })
}

fn leaked(declared: &BTreeMap<String, Declared>) -> &'static [Port] {
    let text = |text: &str| -> &'static str { Box::leak(text.to_owned().into_boxed_str()) };
    let port = |(name, declared): (&String, &Declared)| Port {
        name: text(name),
        kinds: Box::leak(vec![declared.kind].into_boxed_slice()),
        arity: declared.arity,
        doc: "declared by the step",
        extension: declared.extension.as_deref().filter(|_| declared.kind == Kind::File).map(text),
        changed: false,
    };
    Box::leak(declared.iter().map(port).collect::<Vec<_>>().into_boxed_slice())
}
