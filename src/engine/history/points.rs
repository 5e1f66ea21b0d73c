//! One tidy table of a run: a row for each point at which steps have logged numbers, a column for each axis and each metric.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::{Manifest, StepDone};

type Point = BTreeMap<String, String>;

/// The table as CSV; `None` where no step has logged a number.
///
/// Axes come first, in alphabetical order, each with the values that its items have (`axis.name`), then `step.metric [unit]`, in the order of the run. A row also has the numbers of steps
/// that depend on fewer axes: those of the items it has in common with them. They have no row of their own beside it, so that means over
/// rows count each once for every point. A cell is empty where a step has no instance at the point.
pub fn table(manifest: &Manifest) -> Option<String> {
    let told: Vec<&StepDone> = manifest.steps.iter().filter(|done| !done.metrics.is_empty()).collect();
    let axes: BTreeSet<&str> = told.iter().flat_map(|done| done.point.keys().map(String::as_str)).collect();
    let mut columns: Vec<String> = Vec::new();
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut at: BTreeMap<&Point, Vec<(usize, f64)>> = BTreeMap::new();
    for done in &told {
        let cells = at.entry(&done.point).or_default();
        for metric in &done.metrics {
            let unit = if metric.unit == "1" { String::new() } else { format!(" [{}]", metric.unit) };
            let name = format!("{}.{}{unit}", done.step, metric.name);
            let place = *places.entry(name.clone()).or_insert_with(|| {
                columns.push(name);
                columns.len() - 1
            });
            cells.push((place, metric.value.unwrap_or(f64::NAN)));
        }
    }
    if columns.is_empty() {
        return None;
    }
    // The sets of axes that steps depend on: a row takes the values of each of its subsets.
    let sets: BTreeSet<BTreeSet<&str>> = at.keys().map(|point| point.keys().map(String::as_str).collect()).collect();
    let parts = parts(at.keys().copied(), &sets);
    let mut text = csv::Writer::from_writer(Vec::new());
    let axes: Vec<AxisColumns> = axes.into_iter().map(|axis| AxisColumns::new(axis, manifest, &columns)).collect();
    text.write_record(axes.iter().flat_map(AxisColumns::names).chain(columns.iter().cloned())).ok()?;
    for point in at.keys().filter(|point| !parts.contains(**point)) {
        let mut cells = vec![String::new(); columns.len()];
        for set in &sets {
            for (place, value) in part(point, set).iter().filter_map(|part| at.get(part)).flatten() {
                cells[*place] = value.to_string();
            }
        }
        text.write_record(axes.iter().flat_map(|axis| axis.cells(point, manifest)).chain(cells)).ok()?;
    }
    String::from_utf8(text.into_inner().ok()?).ok()
}

/// An axis, and the values that its items have.
struct AxisColumns<'a> {
    axis: &'a str,
    values: Vec<&'a str>,
}

impl<'a> AxisColumns<'a> {
    /// A value gives way to a metric whose column has its name.
    fn new(axis: &'a str, manifest: &'a Manifest, columns: &[String]) -> Self {
        let is_taken = |name: &str| columns.iter().any(|column| *column == format!("{axis}.{name}"));
        let values = manifest.value_names(axis).into_iter().filter(|name| !is_taken(name)).collect();
        Self { axis, values }
    }

    fn names(&self) -> impl Iterator<Item = String> {
        let values = self.values.iter().map(|name| format!("{}.{name}", self.axis));
        std::iter::once(self.axis.to_owned()).chain(values)
    }

    fn cells(&self, point: &Point, manifest: &Manifest) -> impl Iterator<Item = String> {
        let item = point.get(self.axis);
        let cell = move |name: &&str| match item.and_then(|item| manifest.value(self.axis, item, name)) {
            None | Some(Value::Null) => String::new(),
            Some(Value::String(text)) => text.clone(),
            Some(value) => value.to_string(),
        };
        std::iter::once(item.cloned().unwrap_or_default()).chain(self.values.iter().map(cell))
    }
}

/// The items of a point on some axes; `None` where it does not have all of them.
fn part(point: &Point, set: &BTreeSet<&str>) -> Option<Point> {
    set.iter().map(|axis| Some(((*axis).to_owned(), point.get(*axis)?.clone()))).collect()
}

/// What points have in common with points of fewer axes: these stand in the rows of the former.
fn parts<'a>(points: impl Iterator<Item = &'a Point>, sets: &BTreeSet<BTreeSet<&str>>) -> BTreeSet<Point> {
    let smaller =
        |point: &'a Point| sets.iter().filter(|set| set.len() < point.len()).filter_map(|set| part(point, set));
    points.flat_map(smaller).collect()
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::history::Metric;

    pub fn done(step: &str, point: &[(&str, &str)], metrics: &[(&str, f64, &str)]) -> StepDone {
        let metric = |(name, value, unit): &(&str, f64, &str)| Metric {
            name: (*name).to_owned(),
            value: Some(*value),
            unit: (*unit).to_owned(),
        };
        StepDone {
            step: step.to_owned(),
            point: point.iter().map(|(axis, item)| ((*axis).to_owned(), (*item).to_owned())).collect(),
            stage: "x".into(),
            version: 1,
            status: "executed".into(),
            failure: None,
            key: None,
            outputs: None,
            log: None,
            sketches: None,
            cost: None,
            parameters: std::sync::Arc::default(),
            metrics: metrics.iter().map(metric).collect(),
            warnings: Vec::new(),
            files: Vec::new(),
            inputs: BTreeMap::new(),
            paths: BTreeMap::new(),
        }
    }

    fn manifest(steps: Vec<StepDone>) -> Manifest {
        Manifest::of_test("p.yaml", "/", steps)
    }

    #[test]
    fn a_row_has_its_axes_and_the_numbers_of_coarser_steps() {
        let steps = vec![
            done("face", &[], &[("area", 12.5, "m2")]),
            done("score", &[("sigma", "0.5"), ("trial", "0")], &[("rate", 0.75, "1")]),
            done("score", &[("sigma", "0.7"), ("trial", "0")], &[("rate", 0.5, "1")]),
            done("noise", &[("sigma", "0.7")], &[("std", 0.01, "m")]),
            done("noise", &[("sigma", "0.9")], &[("std", 0.02, "m")]),
            done("quiet", &[("image", "a,b")], &[]),
        ];
        let expected = "sigma,trial,face.area [m2],score.rate,noise.std [m]\n0.5,0,12.5,0.75,\n0.7,0,12.5,0.5,0.01\n0.9,,12.5,,0.02\n";
        assert_eq!(table(&manifest(steps)).unwrap(), expected);
        assert_eq!(table(&manifest(Vec::new())), None);
    }

    #[test]
    fn values_of_a_design_stand_beside_its_items() {
        let steps = vec![
            done("score", &[("at", "0"), ("trial", "7")], &[("rate", 0.75, "1")]),
            done("score", &[("at", "1"), ("trial", "7")], &[("rate", 0.5, "1")]),
        ];
        let mut manifest = manifest(steps);
        let values = serde_json::json!({"at": {"0": {"a_m": 0.1, "kind": "block"}, "1": {"a_m": 2.5}}});
        manifest.values = serde_json::from_value(values).unwrap();
        let expected = "at,at.a_m,at.kind,trial,score.rate\n0,0.1,block,7,0.75\n1,2.5,,7,0.5\n";
        assert_eq!(table(&manifest).unwrap(), expected);
    }
}
