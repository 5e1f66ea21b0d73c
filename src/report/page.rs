//! The contents of a run's page.

use std::collections::{BTreeMap, BTreeSet};

use rockface_cache::Digest;
use serde::Serialize;

use super::curves::{self, Curve};
use super::groups::{self, Group, PartView};
use super::media::{Budget, Medium};
use super::number::Shown;
use super::source::Source;
use super::steps::{self, Linker, Said, StepView};
use super::tables::TableView;
use super::{Links, graph};
use rockface_engine::history::{self, POINTS_FILE, Ran, StepDone};
use rockface_engine::watch::duration;

/// Headlines and warnings that are shown.
const LINES: usize = 40;

/// Bytes of the pipeline's text that are shown.
const TEXT_BYTES: usize = 200_000;

/// What the template is given.
#[derive(Debug, Serialize)]
pub struct Page {
    title: String,
    run: String,
    status: String,
    finished: String,
    wall: String,
    executed: usize,
    cached: usize,
    missing: usize,
    seed: u64,
    jobs: usize,
    command: String,
    headlines: Vec<Headlines>,
    curves: Vec<Curve>,
    more_curves: usize,
    points: Option<String>,
    failures: Vec<Warning>,
    more_failures: usize,
    warnings: Vec<Warning>,
    more_warnings: usize,
    pictures: Vec<Medium>,
    looks: Vec<Medium>,
    results: Vec<Result>,
    refused: usize,
    graph: Option<String>,
    groups: Vec<Group>,
    more_steps: usize,
    folder: String,
    manifest: String,
    log: String,
    program: Vec<(String, Shown)>,
    parts: Vec<PartView>,
    pipeline_path: String,
    pipeline_text: String,
    changed: Vec<String>,
}

/// The headlines of a step: one a line, or folded into a table where it is expanded over many points.
#[derive(Debug, Serialize)]
struct Headlines {
    title: String,
    step: String,
    folded: bool,
    lines: Vec<Line>,
    /// The last that was computed in this run, or else the last.
    newest: Line,
    more: usize,
}

/// A headline.
#[derive(Debug, Serialize)]
struct Line {
    label: String,
    text: String,
    /// How many are not shown before this one.
    gap: String,
}

/// The tables of a target step.
#[derive(Debug, Serialize)]
struct Result {
    step: String,
    title: String,
    tables: Vec<TableView>,
    folded: Vec<TableView>,
    more: usize,
}

/// A warning or the cause of a failure, and how many more of its step are like it.
#[derive(Debug, Serialize)]
struct Warning {
    step: String,
    label: String,
    text: String,
    alike: usize,
}

/// Gathers all that the template is filled with.
pub fn of(source: &Source, links: Links) -> Page {
    let manifest = source.manifest;
    let linker = Linker::new(source, links);
    let mut budget = Budget::new();
    let targets = targets(source);
    let mut gathered = steps::gather(&linker, &targets, &mut budget);
    let of_targets = gathered.steps.iter_mut().filter(|step| step.target);
    let (pictures, looks): (Vec<Medium>, Vec<Medium>) =
        of_targets.flat_map(StepView::shown_above).partition(|medium| medium.finished);
    let results = results(&mut gathered.steps);
    let warnings = folded(gathered.warnings);
    let failures = folded(gathered.failures);
    let [executed, cached, missing] = manifest.counts();
    let headlines = grouped(&manifest.headlines, &gathered.steps, &manifest.executed());
    let (curves, more_curves) =
        source.graph.map_or_else(Default::default, |graph| curves::of(manifest, graph, &targets));
    let changed = manifest.overrides.set.iter().map(|set| format!("--set {set}"));
    let swept = manifest.overrides.sweep.iter().map(|sweep| format!("--sweep {sweep}"));
    let reseeded = manifest.overrides.seed.map(|seed| format!("--seed {seed}"));
    Page {
        title: manifest.pipeline.name.clone(),
        run: source.folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
        status: manifest.status.clone(),
        finished: readable_time(&manifest.finished),
        wall: duration(manifest.wall_s),
        executed,
        cached,
        missing,
        seed: manifest.seed,
        jobs: manifest.jobs,
        command: "rockface run run.json".to_owned(),
        headlines,
        curves,
        more_curves,
        points: manifest.steps.iter().any(|done| !done.metrics.is_empty()).then(|| linker.certain(POINTS_FILE)),
        more_failures: failures.len().saturating_sub(LINES),
        failures: failures.into_iter().take(LINES).collect(),
        more_warnings: warnings.len().saturating_sub(LINES),
        warnings: warnings.into_iter().take(LINES).collect(),
        pictures,
        looks,
        results,
        refused: budget.refused,
        graph: source.graph.and_then(|graph| graph::svg(graph, &gathered.steps)),
        more_steps: gathered.more_steps,
        groups: groups::of(gathered.steps, &manifest.parts, source.graph),
        folder: source.folder.display().to_string(),
        manifest: linker.certain("run.json"),
        log: linker.certain("run.mcap"),
        program: program(&manifest.program),
        parts: groups::parts(&manifest.parts),
        pipeline_path: manifest.pipeline.path.display().to_string(),
        pipeline_text: beginning(&manifest.pipeline.text),
        changed: changed.chain(swept).chain(reseeded).collect(),
    }
}

/// The target steps: those of the graph, of the manifest, or without either those whose outputs nobody reads.
fn targets(source: &Source) -> Vec<String> {
    let manifest = source.manifest;
    if let Some(graph) = source.graph {
        return graph::targets(graph);
    }
    if !manifest.targets.is_empty() {
        return manifest.targets.clone();
    }
    let inputs = manifest.steps.iter().flat_map(|done| done.inputs.values());
    let read: BTreeSet<Digest> = inputs.flat_map(steps::digests).collect();
    let is_read = |done: &StepDone| done.outputs.iter().flatten().any(|(_, output)| read.contains(&output.digest));
    let read_steps: BTreeSet<&str> =
        manifest.steps.iter().filter(|done| is_read(done)).map(|done| done.step.as_str()).collect();
    let mut names: Vec<String> = manifest.steps.iter().map(|done| done.step.clone()).collect();
    names.dedup();
    names.retain(|name| !read_steps.contains(name.as_str()));
    names
}

/// Takes the tables of target steps to the top of the page, those of steps that nothing reads first. Where a step has many instances, the
/// tables of the newest stand there, the last that was computed in this run or else the last, and the others are folded.
fn results(steps: &mut [StepView]) -> Vec<Result> {
    let wanted = steps.iter_mut().filter(|step| step.target && !step.tables.is_empty());
    let result = |step: &mut StepView| {
        let all = std::mem::take(&mut step.tables);
        let newest = all.iter().rev().find(|table| table.ran).or(all.last()).map(|table| table.instance.clone());
        let (mut tables, folded): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|table| Some(&table.instance) == newest.as_ref());
        tables.iter_mut().for_each(|table| table.gap.clear());
        (!step.end, Result { step: step.name.clone(), title: step.title.clone(), tables, folded, more: step.more })
    };
    let mut results: Vec<(bool, Result)> = wanted.map(result).collect();
    results.sort_by_key(|(is_read, _)| *is_read);
    results.into_iter().map(|(_, result)| result).collect()
}

/// Headlines above which those of one step are folded.
const UNFOLDED: usize = 4;

/// Headlines by step, those of many points folded; `ran` are the instances that were computed in this run.
fn grouped(lines: &[String], steps: &[StepView], ran: &Ran) -> Vec<Headlines> {
    let mut groups: Vec<(String, Vec<&str>)> = Vec::new();
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    for line in lines {
        let step = said(line, String::new()).label.split('[').next().unwrap_or_default().to_owned();
        let place = *places.entry(step.clone()).or_insert(groups.len());
        match groups.get_mut(place) {
            Some((_, lines)) => lines.push(line),
            None => groups.push((step, vec![line])),
        }
    }
    let group = |(step, lines): (String, Vec<&str>)| {
        let ranks = history::ranks(&lines, ran);
        let shown = history::chosen(lines.len(), LINES, |number| ranks[number]);
        let newest = ranks.iter().rposition(|(is_cached, _)| !is_cached).unwrap_or(lines.len() - 1);
        Headlines {
            title: steps.iter().find(|view| view.name == step).map_or_else(|| step.clone(), |view| view.title.clone()),
            step,
            folded: lines.len() > UNFOLDED,
            more: lines.len().saturating_sub(LINES),
            newest: said(lines[newest], String::new()),
            lines: shown.into_iter().map(|one| said(lines[one.number], steps::gap(one))).collect(),
        }
    };
    groups.into_iter().map(group).collect()
}

/// Those of one step that differ in numbers only are told once, with how many there are.
fn folded(warnings: Vec<Said>) -> Vec<Warning> {
    let mut kinds: BTreeMap<(String, String), usize> = BTreeMap::new();
    let mut found: Vec<Warning> = Vec::new();
    for said in warnings {
        let step = said.label.split('[').next().unwrap_or_default().to_owned();
        let words: String = said.text.chars().filter(|letter| !letter.is_ascii_digit()).collect();
        let place = *kinds.entry((step.clone(), words)).or_insert(found.len());
        match found.get_mut(place) {
            Some(warning) => warning.alike += 1,
            None => found.push(Warning { step, label: said.label, text: said.text, alike: 0 }),
        }
    }
    found
}

/// A text, or its beginning where it is very long.
fn beginning(text: &str) -> String {
    if text.len() <= TEXT_BYTES {
        return text.to_owned();
    }
    let end = (0..=TEXT_BYTES).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    format!("{}\n\u{2026} {} more bytes: pipeline.yaml in the run folder has them", &text[..end], text.len() - end)
}

fn said(line: &str, gap: String) -> Line {
    let (label, text) = line.split_once(": ").unwrap_or(("", line));
    Line { label: label.to_owned(), text: text.to_owned(), gap }
}

/// `2026-11-21 19:05 UTC` of an RFC 3339 time.
pub fn readable_time(time: &str) -> String {
    match (time.get(..10), time.get(11..16)) {
        (Some(day), Some(minute)) => format!("{day} {minute} UTC"),
        _ => time.to_owned(),
    }
}

fn program(program: &serde_json::Value) -> Vec<(String, Shown)> {
    let shown = |value: &serde_json::Value| match value {
        serde_json::Value::Array(values) => {
            let words: Vec<&str> = values.iter().filter_map(serde_json::Value::as_str).collect();
            Shown { text: words.join(", "), exact: None }
        }
        other => Shown::of_json(other),
    };
    program
        .as_object()
        .map(|map| map.iter().map(|(name, value)| (name.clone(), shown(value))).collect())
        .unwrap_or_default()
}
