//! Reads the keys of one map of parameters and collects every fault.

use serde_json::{Map, Value};

use super::{Fault, ParamType, Range, wrong};

/// Reads the keys of one map; used by [`crate::params!`].
pub struct MapReader<'a> {
    map: Option<&'a Map<String, Value>>,
    faults: Vec<Fault>,
}

impl<'a> MapReader<'a> {
    /// Starts on a value that should be a map; nothing (null) counts as an empty one.
    pub fn new(value: &'a Value) -> Self {
        let faults = match value {
            Value::Object(_) | Value::Null => Vec::new(),
            other => wrong("a map of parameters", other),
        };
        Self { map: value.as_object(), faults }
    }

    /// Reads one key, or its default.
    pub fn field<T: ParamType>(&mut self, name: &str, default: Option<T>, range: Range) -> Option<T> {
        let Some(value) = self.map.and_then(|map| map.get(name)) else {
            if default.is_none() && self.faults.is_empty() | self.map.is_some() {
                self.faults.push(Fault::new(format!("parameter `{name}` ({}) is missing", T::kind())));
            }
            return default;
        };
        match T::decode(value) {
            Ok(decoded) => {
                self.check_range(name, value, range);
                self.faults.extend(decoded.outside(range).into_iter().map(|fault| fault.below(name)));
                Some(decoded)
            }
            Err(faults) => {
                self.faults.extend(faults.into_iter().map(|fault| fault.below(name)));
                None
            }
        }
    }

    fn check_range(&mut self, name: &str, value: &Value, range: Range) {
        match value {
            Value::Number(number) if !number.as_f64().is_some_and(|x| range.holds(x)) => {
                self.faults.push(Fault::new(format!("{number} is out of range: must be {range}")).below(name));
            }
            Value::Array(list) => list.iter().for_each(|item| self.check_range(name, item, range)),
            _ => {}
        }
    }

    /// All faults found, unknown keys among them.
    pub fn finish(mut self, known: &[&str]) -> Vec<Fault> {
        for key in self.map.into_iter().flat_map(Map::keys).filter(|key| !known.contains(&key.as_str())) {
            self.faults.push(Fault {
                path: vec![key.clone()],
                message: format!("unknown parameter `{key}`"),
                known: known.iter().map(ToString::to_string).collect(),
                at_key: true,
            });
        }
        self.faults
    }
}
