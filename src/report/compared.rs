//! Runs side by side as a page: what was changed, what came out, and their pictures.

use std::collections::BTreeMap;

use rockface_cache::Store;
use serde::Serialize;
use serde_json::Value;

use super::media::{self, Budget, Medium};
use super::number::Shown;
use super::source::Source;
use super::steps::Linker;
use super::{Links, ReportError, render};
use rockface_core::Look;
use rockface_engine::history::{PastRun, REPORT_FILE, Row, RunContents, compare, folded, with_short_digest};
use rockface_engine::watch::duration;

/// Headlines of a run that are shown.
const LINES: usize = 8;
/// Outputs whose pictures are shown.
const PICTURES: usize = 24;

#[derive(Debug, Serialize)]
struct Page {
    runs: Vec<RunView>,
    parameters: Vec<RowView>,
    metrics: Vec<RowView>,
    equal_parameters: usize,
    pictures: Vec<PictureRow>,
}

#[derive(Debug, Serialize)]
struct RunView {
    name: String,
    link: Option<String>,
    pipeline: String,
    status: String,
    wall: String,
    headlines: Vec<String>,
}

#[derive(Debug, Serialize)]
struct RowView {
    name: String,
    values: Vec<Shown>,
    difference: Option<Shown>,
    unit: String,
}

#[derive(Debug, Serialize)]
struct PictureRow {
    name: String,
    images: Vec<Option<Medium>>,
}

/// The page of some runs; pictures that are no longer in a run folder are looked for in the store.
///
/// # Errors
/// A template that does not fit.
pub fn comparison(runs: &[PastRun], store: Option<&Store>, look: &'static dyn Look) -> Result<String, ReportError> {
    let found = compare(runs);
    let page = Page {
        runs: runs.iter().map(|one| run(one, look)).collect(),
        parameters: found.parameters.iter().map(row).collect(),
        metrics: found.metrics.iter().map(row).collect(),
        equal_parameters: found.equal_parameters,
        pictures: pictures(runs, store, look),
    };
    render("compared.html", page)
}

fn run(run: &PastRun, look: &'static dyn Look) -> RunView {
    let run_files = RunContents { folder: &run.folder, manifest: &run.manifest, store: None, graph: None, logs: None };
    let source = Source { run: run_files, look };
    let linker = Linker::new(&source, Links::Absolute);
    RunView {
        name: run.name.clone(),
        link: linker.to(REPORT_FILE.as_ref()),
        pipeline: run.manifest.pipeline.name.clone(),
        status: run.manifest.status.clone(),
        wall: duration(run.manifest.wall_s),
        headlines: folded(&run.manifest.headlines, &run.manifest.executed()).into_iter().take(LINES).collect(),
    }
}

/// A value; the digest of a file is cut short.
fn shown(value: &Value) -> Shown {
    let text = value.as_str().map(with_short_digest).filter(|text| text.ends_with('…'));
    text.map_or_else(|| Shown::of_json(value), |text| Shown { text, exact: None })
}

fn row(row: &Row) -> RowView {
    let none = || Shown { text: "\u{2013}".to_owned(), exact: None };
    RowView {
        name: row.name.clone(),
        values: row.values.iter().map(|value| value.as_ref().map_or_else(none, shown)).collect(),
        difference: row.difference().map(|difference| Shown::of_json(&difference.into())),
        unit: row.unit.clone().filter(|unit| unit != "1").unwrap_or_default(),
    }
}

/// Finished pictures and figures, in a row for each output that at least one of the runs has.
fn pictures(runs: &[PastRun], store: Option<&Store>, look: &'static dyn Look) -> Vec<PictureRow> {
    let mut budget = Budget::new();
    let mut found: BTreeMap<String, Vec<Option<Medium>>> = BTreeMap::new();
    for (place, run) in runs.iter().enumerate() {
        let run_files = RunContents { folder: &run.folder, manifest: &run.manifest, store, graph: None, logs: None };
        let source = Source { run: run_files, look };
        let linker = Linker::new(&source, Links::Absolute);
        for done in &run.manifest.steps {
            for medium in media::finished_of(&source, done, &linker, &mut budget) {
                let images = found.entry(medium.from.clone()).or_insert_with(|| runs.iter().map(|_| None).collect());
                images[place] = Some(medium);
            }
            if found.len() >= PICTURES {
                break;
            }
        }
    }
    found.into_iter().map(|(name, images)| PictureRow { name, images }).collect()
}
