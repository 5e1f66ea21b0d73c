//! How runs differ: the parameters that vary between them and their metrics, side by side.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use super::{Manifest, PastRun, files};

/// One parameter or number in each of the runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Such as `dem.cell_m`, or `dem[epoch=pre].holes_m2`.
    pub name: String,
    /// Its value in each run; `None` where it has none.
    pub values: Vec<Option<Value>>,
    /// The unit of a number.
    pub unit: Option<String>,
}

/// Runs side by side.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// The names of the runs.
    pub runs: Vec<String>,
    /// The parameters that are not the same in all.
    pub parameters: Vec<Row>,
    /// The metrics of all runs, sorted by name, whether they differ or not.
    pub metrics: Vec<Row>,
    /// How many parameters are the same in all.
    pub equal_parameters: usize,
}

/// Puts runs side by side.
pub fn compare(runs: &[PastRun]) -> Comparison {
    let parameters = side_by_side(runs.iter().map(|run| parameters(&run.manifest)));
    let files = files::of(runs);
    let equal =
        parameters.iter().filter(|row| !row.varies()).count() + files.iter().filter(|rows| rows.is_empty()).count();
    let mut varying: Vec<Row> = parameters.into_iter().filter(Row::varies).chain(files.into_iter().flatten()).collect();
    varying.sort_by(|one, other| one.name.cmp(&other.name));
    let units: BTreeMap<String, String> = runs.iter().flat_map(|run| units(&run.manifest)).collect();
    let mut metrics = side_by_side(runs.iter().map(|run| metrics(&run.manifest)));
    for row in &mut metrics {
        row.unit = units.get(&row.name).cloned();
    }
    Comparison {
        runs: runs.iter().map(|run| run.name.clone()).collect(),
        equal_parameters: equal,
        parameters: varying,
        metrics,
    }
}

impl Row {
    /// Whether it is not the same in all runs.
    pub fn varies(&self) -> bool {
        self.values.windows(2).any(|pair| pair[0] != pair[1])
    }

    /// Last less first, where both are numbers.
    pub fn difference(&self) -> Option<f64> {
        let number = |value: Option<&Option<Value>>| value?.as_ref()?.as_f64();
        Some(number(self.values.last())? - number(self.values.first())?)
    }
}

type Named = BTreeMap<String, Value>;

fn side_by_side(runs: impl Iterator<Item = Named>) -> Vec<Row> {
    let runs: Vec<Named> = runs.collect();
    let names: BTreeSet<&String> = runs.iter().flat_map(BTreeMap::keys).collect();
    let row = |name: &String| {
        let values = runs.iter().map(|run| run.get(name).cloned()).collect();
        Row { name: name.clone(), values, unit: None }
    };
    names.into_iter().map(row).collect()
}

/// Program, seed, stage versions and parameters. What is the same at every point of a step is listed once; what is not, as the
/// sorted list of its values.
fn parameters(manifest: &Manifest) -> Named {
    let mut found: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for done in &manifest.steps {
        found
            .entry(format!("{} (stage)", done.step))
            .or_default()
            .push(format!("{} {}", done.stage, done.version).into());
        leaves(&done.parameters, &done.step, &mut |name, value| {
            if !files::is_file(&name, &value) {
                found.entry(name).or_default().push(value);
            }
        });
    }
    found.insert("program".to_owned(), vec![manifest.made_by().into()]);
    found.insert("seed".to_owned(), vec![manifest.seed.into()]);
    found.into_iter().map(|(name, values)| (name, one_or_list(values))).collect()
}

fn one_or_list(mut values: Vec<Value>) -> Value {
    values.sort_by_cached_key(|value| (value.as_f64().map(f64::to_bits), value.to_string()));
    values.dedup();
    if values.len() == 1 { values.remove(0) } else { Value::Array(values) }
}

pub(super) fn leaves(value: &Value, path: &str, tell: &mut impl FnMut(String, Value)) {
    match value {
        Value::Object(map) if !map.is_empty() => {
            map.iter().for_each(|(key, inner)| leaves(inner, &format!("{path}.{key}"), tell));
        }
        other => tell(path.to_owned(), other.clone()),
    }
}

fn metrics(manifest: &Manifest) -> Named {
    let told = manifest.steps.iter().flat_map(|done| done.metrics.iter().map(move |metric| (done.label(), metric)));
    told.map(|(label, metric)| (format!("{label}.{}", metric.name), metric.value.map_or(Value::Null, Value::from)))
        .collect()
}

fn units(manifest: &Manifest) -> Vec<(String, String)> {
    let told = manifest.steps.iter().flat_map(|done| done.metrics.iter().map(move |metric| (done.label(), metric)));
    told.map(|(label, metric)| (format!("{label}.{}", metric.name), metric.unit.clone())).collect()
}
