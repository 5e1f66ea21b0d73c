//! Which input files of runs differ: by instance, since a step may read another file at each item of an axis.

use std::collections::{BTreeMap, BTreeSet};

use rockface_cache::Digest;
use serde_json::Value;

use super::compare::leaves;
use super::{PastRun, Row, StepDone};

/// Whether a parameter, by its path and value, is the digest of a file in the place of its path.
pub fn is_file(name: &str, value: &Value) -> bool {
    let is_digest = || value.as_str().is_some_and(|text| text.parse::<Digest>().is_ok());
    name.rsplit('.').next().is_some_and(|key| ["blake3", "prj"].contains(&key)) && is_digest()
}

/// A value of such a row with its digest cut short, for people.
pub fn with_short_digest(text: &str) -> String {
    let (file, end) = text.rsplit_once(' ').map_or(("", text), |(file, end)| (file, end));
    let digest = end.parse::<Digest>().ok().map(|digest| format!("{}…", digest.short()));
    digest.map_or_else(|| text.to_owned(), |digest| format!("{file} {digest}").trim_start().to_owned())
}

/// The digests of a parameter by instance, in one run.
type Digests = BTreeMap<String, String>;

/// For each parameter of a step that names a file: a row for each file that differs between the runs, with the first of the instances that read
/// it. Values are the path of the file and its BLAKE3.
pub fn of(runs: &[PastRun]) -> Vec<Vec<Row>> {
    let mut found: BTreeMap<String, Vec<Digests>> = BTreeMap::new();
    for (place, run) in runs.iter().enumerate() {
        for done in &run.manifest.steps {
            leaves(&done.parameters, &done.step, &mut |name, value| {
                if let Some(digest) = value.as_str().filter(|_| is_file(&name, &value)) {
                    let digests = found.entry(name.clone()).or_insert_with(|| vec![Digests::new(); runs.len()]);
                    digests[place].insert(done.label(), digest.to_owned());
                }
            });
        }
    }
    let paths: Vec<BTreeMap<String, &StepDone>> =
        runs.iter().map(|run| run.manifest.steps.iter().map(|done| (done.label(), done)).collect()).collect();
    found.into_iter().map(|(name, digests)| rows(&name, &digests, &paths)).collect()
}

fn rows(name: &str, digests: &[Digests], steps: &[BTreeMap<String, &StepDone>]) -> Vec<Row> {
    let labels: BTreeSet<&String> = digests.iter().flat_map(BTreeMap::keys).collect();
    // Instances that read the same files in each run are one row.
    let mut groups: Vec<(Vec<Option<&String>>, Vec<&String>)> = Vec::new();
    let mut known: BTreeMap<Vec<Option<&String>>, usize> = BTreeMap::new();
    for label in labels {
        let values: Vec<Option<&String>> = digests.iter().map(|run| run.get(label)).collect();
        let place = *known.entry(values.clone()).or_insert_with(|| {
            groups.push((values, Vec::new()));
            groups.len() - 1
        });
        groups[place].1.push(label);
    }
    let differing = groups.into_iter().filter(|(values, _)| values.windows(2).any(|pair| pair[0] != pair[1]));
    let row = |(values, labels): (Vec<Option<&String>>, Vec<&String>)| {
        let step = labels[0].split('[').next().unwrap_or_default();
        let rest = name.strip_prefix(step).unwrap_or_default();
        let more = if labels.len() > 1 { format!(" and {} more", labels.len() - 1) } else { String::new() };
        let told = |(run, digest): (usize, Option<&String>)| {
            let digest = digest?;
            let files = steps[run].get(labels[0]).map_or(&[][..], |done| &done.files);
            let file = files.iter().find(|file| file.blake3.to_string() == *digest);
            Some(file.map_or_else(|| digest.clone(), |file| format!("{} {digest}", file.path.display())).into())
        };
        Row {
            name: format!("{}{rest}{more}", labels[0]),
            values: values.into_iter().enumerate().map(told).collect(),
            unit: None,
        }
    };
    differing.map(row).collect()
}
