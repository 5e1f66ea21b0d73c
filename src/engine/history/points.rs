//! One tidy table of a run: a row for each point at which steps have logged numbers, a column for each axis and each metric.

use std::collections::{BTreeMap, BTreeSet};

use super::{Manifest, StepDone};

/// The file of a run folder that has the table.
pub const POINTS_FILE: &str = "points.csv";

type Point = BTreeMap<String, String>;

/// The table as CSV; `None` where no step has logged a number.
///
/// Axes come first, in alphabetical order, then `step.metric [unit]`, in the order of the run. A row also has the numbers of steps
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
    text.write_record(axes.iter().copied().chain(columns.iter().map(String::as_str))).ok()?;
    for point in at.keys().filter(|point| !parts.contains(**point)) {
        let mut cells = vec![String::new(); columns.len()];
        for set in &sets {
            for (place, value) in part(point, set).iter().filter_map(|part| at.get(part)).flatten() {
                cells[*place] = value.to_string();
            }
        }
        let items = axes.iter().map(|axis| point.get(*axis).map_or("", String::as_str));
        text.write_record(items.chain(cells.iter().map(String::as_str))).ok()?;
    }
    String::from_utf8(text.into_inner().ok()?).ok()
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
mod tests {
    use super::*;
    use crate::history::{Metric, PipelineText};

    fn done(step: &str, point: &[(&str, &str)], metrics: &[(&str, f64, &str)]) -> StepDone {
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
            files: Vec::new(),
            inputs: BTreeMap::new(),
            paths: BTreeMap::new(),
        }
    }

    fn manifest(steps: Vec<StepDone>) -> Manifest {
        let pipeline = PipelineText {
            name: "p".to_owned(),
            path: "p.yaml".into(),
            folder: "/".into(),
            text: String::new(),
            included: Vec::new(),
        };
        Manifest {
            format: super::super::FORMAT,
            pipeline,
            overrides: super::super::Overridden::default(),
            seed: 1,
            targets: Vec::new(),
            finished: String::new(),
            wall_s: 0.0,
            jobs: 1,
            status: "done".to_owned(),
            program: serde_json::Value::Null,
            headlines: Vec::new(),
            laid_out: String::new(),
            parts: Vec::new(),
            steps,
        }
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
}
