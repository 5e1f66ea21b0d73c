//! The steps of a run, each with its instances folded into one.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::Path;

use rockface_cache::{Digest, RecipeInput};
use rockface_core::Entry;
use serde::Serialize;
use serde_json::Value;

use super::Links;
use super::media::{self, Budget, Medium};
use super::number::{Shown, bytes};
use super::source::Source;
use super::tables::{self, TableView};
use rockface_engine::history::{Chosen, StepDone, chosen};
use rockface_engine::plan::GraphStep;
use rockface_engine::watch::duration;

/// Instances of a step whose pictures, tables and files are shown.
const SHOWN: usize = 4;
/// Instances of a step whose notes and numbers are read.
const READ: usize = 2000;
/// Steps that are shown: targets, and the first of the others.
const STEPS: usize = 300;
/// Values of a parameter that are shown.
const VALUES: usize = 6;
/// Notes of a step that are shown, the newest among them.
const NOTES: usize = 12;
/// Files of a step that are listed.
const FILES: usize = 24;

/// A step as the page shows it.
#[derive(Debug, Clone, Serialize)]
pub struct StepView {
    /// The name of the step; of a part, with that of its use before it.
    pub name: String,
    /// Its heading: what the pipeline calls it, or its name.
    pub title: String,
    /// What the pipeline says of it.
    pub doc: String,
    /// Its stage and version.
    pub stage: String,
    /// The version of the stage.
    pub version: u32,
    /// Whether it is what was asked for.
    pub target: bool,
    /// Whether no other step reads what it makes, but to draw it.
    pub end: bool,
    /// How many instances it has, ran, had cached, and did not finish.
    pub instances: usize,
    /// How many instances ran in this run.
    pub executed: usize,
    /// How many were cached.
    pub cached: usize,
    /// How many failed or were not reached.
    pub missing: usize,
    /// The axes it is expanded over.
    pub axes: Vec<String>,
    /// What it took when it was computed, all instances together.
    pub wall: String,
    /// The same in seconds.
    pub wall_s: f64,
    /// Its share of the longest step's time, percent.
    pub share: f64,
    /// Bytes of what it made.
    pub size: String,
    /// Pictures of the first and the last instances, and of what was computed in this run.
    pub media: Vec<Medium>,
    /// Tables of the same instances.
    pub tables: Vec<TableView>,
    /// Instances whose pictures and tables are not shown.
    pub more: usize,
    /// The metrics it logged, in the order they were first met.
    pub metrics: Vec<MetricView>,
    /// The notes and headlines it logged, a few of them.
    pub notes: Vec<Said>,
    /// Notes that are not shown.
    pub more_notes: usize,
    /// Its parameters with their values in this run.
    pub parameters: Vec<ParameterView>,
    /// The outputs of its instances, a few of them.
    pub files: Vec<FileView>,
    /// Files that are not listed.
    pub more_files: usize,
    /// Files its parameters name.
    pub sources: Vec<(String, String)>,
}

/// A sentence of an instance.
#[derive(Debug, Clone, Serialize)]
pub struct Said {
    /// The instance that said it, as `step[axis=item]`.
    pub label: String,
    /// The text as it was logged.
    pub text: String,
}

/// A number over the instances that told it.
#[derive(Debug, Clone, Serialize)]
pub struct MetricView {
    /// The name the stage gave the metric.
    pub name: String,
    /// The unit of the values; empty where they have none.
    pub unit: String,
    /// How many instances told it.
    pub count: usize,
    /// The only value, or the median.
    pub value: Shown,
    /// Smallest and largest of several.
    pub range: Option<[Shown; 2]>,
}

/// A parameter with its value, or the first of its values where they differ between instances.
#[derive(Debug, Clone, Serialize)]
pub struct ParameterView {
    /// The keys that lead to the parameter, with dots between them.
    pub name: String,
    /// The first different values, in the order they were met.
    pub values: Vec<Shown>,
    /// How many different ones there are.
    pub count: usize,
}

/// A file of the run folder.
#[derive(Debug, Clone, Serialize)]
pub struct FileView {
    /// The instance and the port, as `step[axis=item].port`.
    pub name: String,
    /// The kind of artefact, such as `raster`.
    pub kind: String,
    /// Its size in units for people, or `not kept`.
    pub size: String,
    /// The beginning of its digest.
    pub digest: String,
    /// The address of the file; `None` where the run folder has no file of it.
    pub link: Option<String>,
}

/// Writes links to the files of a run folder.
pub struct Linker<'a> {
    /// The run whose files are linked to.
    pub source: &'a Source<'a>,
    /// Whether addresses are relative to the run folder or absolute.
    pub links: Links,
    /// The steps as they are written, by name.
    written: HashMap<&'a str, &'a GraphStep>,
    /// The steps whose outputs no other reads, but to draw them.
    pub ends: BTreeSet<String>,
    /// The outputs that pictures show: they need no second one.
    pub drawn: BTreeSet<Digest>,
}

impl<'a> Linker<'a> {
    /// Links of a run's page.
    pub fn new(source: &'a Source<'a>, links: Links) -> Self {
        let ends = source.graph.map(|graph| {
            let ends = graph.ends();
            graph.steps.iter().zip(ends).filter(|(_, end)| *end).map(|(step, _)| step.name.clone()).collect()
        });
        let draws = |done: &&StepDone| {
            let kinds = || done.outputs.iter().flatten().map(|(_, output)| output.kind.as_str());
            kinds().count() > 0 && kinds().all(|kind| matches!(kind, "picture" | "figure"))
        };
        let drawn = source.manifest.steps.iter().filter(draws).flat_map(|done| done.inputs.values());
        let written =
            source.graph.iter().flat_map(|graph| &graph.steps).map(|step| (step.name.as_str(), step)).collect();
        Self { source, links, written, ends: ends.unwrap_or_default(), drawn: drawn.flat_map(digests).collect() }
    }

    /// The address of an output's file, where there is one.
    pub fn output(&self, done: &StepDone, port: &str) -> Option<String> {
        done.paths.get(port).and_then(|path| self.to(path))
    }

    /// The address of the file with this extension beside an output's.
    pub fn beside(&self, done: &StepDone, port: &str, extension: &str) -> Option<String> {
        self.to(&done.paths.get(port)?.with_extension(extension))
    }

    /// The address of a file of the folder that is there.
    pub fn to(&self, path: &Path) -> Option<String> {
        let full = self.source.file(path)?;
        Some(self.address(if self.links == Links::Relative { path } else { &full }))
    }

    /// The address of a file that every run folder has, though this one may get it after its report.
    pub fn certain(&self, name: &str) -> String {
        self.address(&if self.links == Links::Relative { name.into() } else { self.source.folder.join(name) })
    }

    fn address(&self, path: &Path) -> String {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-~,=".contains(&byte);
        let letter = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
        let address: String = path.to_string_lossy().bytes().map(letter).collect();
        if self.links == Links::Relative { address } else { format!("file://{address}") }
    }
}

/// The digests an input reads.
pub fn digests(input: &RecipeInput) -> Vec<Digest> {
    match input {
        RecipeInput::One(digest) => vec![*digest],
        RecipeInput::Many(elements) => elements.iter().map(|element| element.digest).collect(),
    }
}

/// What the steps said, beside what they are.
#[derive(Debug, Default)]
pub struct Gathered {
    /// By step, in the order of the run.
    pub steps: Vec<StepView>,
    /// The errors of failed instances, each with the instance.
    pub failures: Vec<Said>,
    /// The warnings that instances logged, each with the instance.
    pub warnings: Vec<Said>,
    /// Steps that are not shown.
    pub more_steps: usize,
}

/// Gathers the steps of a run. Pictures of target steps come first into the budget.
pub fn gather(linker: &Linker, targets: &[String], budget: &mut Budget) -> Gathered {
    let all = &linker.source.manifest.steps;
    let mut order: Vec<(&str, Vec<usize>)> = Vec::new();
    let mut known: BTreeMap<&str, usize> = BTreeMap::new();
    for (place, done) in all.iter().enumerate() {
        let row = *known.entry(&done.step).or_insert_with(|| {
            order.push((&done.step, Vec::new()));
            order.len() - 1
        });
        order[row].1.push(place);
    }
    let targeted: HashSet<&str> = targets.iter().map(String::as_str).collect();
    let is_target = |name: &str| targeted.contains(name);
    let mut gathered = Gathered { more_steps: order.len().saturating_sub(STEPS), ..Gathered::default() };
    if gathered.more_steps > 0 {
        let mut others = STEPS.saturating_sub(targets.len());
        order.retain(|(name, _)| {
            let kept = is_target(name) || others > 0;
            others -= usize::from(kept && !is_target(name));
            kept
        });
        order.truncate(STEPS);
    }
    order.sort_by_key(|(name, _)| linker.written.get(name).map(|step| step.written));
    for (name, places) in &order {
        let mut view = step(linker, name, &places.iter().map(|place| &all[*place]).collect::<Vec<_>>());
        view.target = is_target(name);
        let failed = places.iter().filter_map(|place| {
            let text = all[*place].failure.clone()?;
            Some(Said { label: all[*place].label(), text })
        });
        gathered.failures.extend(failed);
        view.say(linker.source, places, &mut gathered.warnings);
        gathered.steps.push(view);
    }
    let longest = gathered.steps.iter().map(|step| step.wall_s).fold(0.0, f64::max);
    for wanted in [true, false] {
        for (view, (_, places)) in gathered.steps.iter_mut().zip(&order).filter(|(view, _)| view.target == wanted) {
            view.share = if longest > 0.0 { 100.0 * view.wall_s / longest } else { 0.0 };
            let shown = shown(all, places, SHOWN);
            // The newest are the last to be left out where the pictures are too many bytes.
            let made = |one: &Chosen| media::of(linker.source, &all[places[one.number]], linker, budget);
            let mut media: Vec<Vec<Medium>> = shown.iter().rev().map(made).collect();
            media.reverse();
            for (one, media) in shown.into_iter().zip(media) {
                let (gap, media) = (gap(one), media.into_iter());
                let tables = tables::of(linker.source, &all[places[one.number]], linker).into_iter();
                view.media.extend(media.map(|medium| Medium { gap: gap.clone(), ..medium }));
                view.tables.extend(tables.map(|table| TableView { gap: gap.clone(), ..table }));
            }
        }
    }
    gathered
}

/// The instances of a step, by their places in the manifest, that are shown where there is room for so many.
fn shown(all: &[StepDone], places: &[usize], room: usize) -> Vec<Chosen> {
    chosen(places.len(), room, |number| all[places[number]].status != "executed")
}

/// What stands before an instance that does not follow the one shown before it.
pub fn gap(one: Chosen) -> String {
    match one.left_out {
        0 => String::new(),
        left_out => format!("… {left_out} more {}", if one.number == left_out { "before" } else { "between" }),
    }
}

fn step(linker: &Linker, name: &str, instances: &[&StepDone]) -> StepView {
    let count = |status: &str| instances.iter().filter(|done| done.status == status).count();
    let (executed, cached) = (count("executed"), count("cached"));
    // A sum of nothing is -0.
    let wall_s = instances.iter().filter_map(|done| done.cost).fold(0.0, |sum, cost| sum + cost.wall_s);
    let outputs = || instances.iter().flat_map(|done| done.outputs.iter().flatten().map(move |(p, o)| (*done, p, o)));
    let file = |(done, port, output): (&StepDone, &rockface_cache::SafeName, &rockface_cache::OutputRecord)| FileView {
        name: format!("{}.{port}", done.label()),
        kind: output.kind.clone(),
        size: if output.kept { bytes(output.bytes) } else { "not kept".to_owned() },
        digest: output.digest.short(),
        link: linker.output(done, port),
    };
    let written = linker.written.get(name);
    let outputs: Vec<_> = outputs().collect();
    let listed = chosen(outputs.len(), FILES, |number| outputs[number].0.status != "executed");
    StepView {
        name: name.to_owned(),
        title: written.and_then(|step| step.title.clone()).unwrap_or_else(|| name.to_owned()),
        doc: written.and_then(|step| step.doc.clone()).unwrap_or_default(),
        stage: instances[0].stage.to_string(),
        version: instances[0].version,
        target: false,
        end: written.is_none() || linker.ends.contains(name),
        instances: instances.len(),
        executed,
        cached,
        missing: instances.len() - executed - cached,
        axes: instances[0].point.keys().cloned().collect(),
        wall: duration(wall_s),
        wall_s,
        share: 0.0,
        size: bytes(outputs.iter().map(|(_, _, output)| output.bytes).fold(0, u64::saturating_add)),
        media: Vec::new(),
        tables: Vec::new(),
        more: instances.len().saturating_sub(SHOWN),
        metrics: metrics(instances),
        more_notes: 0,
        notes: Vec::new(),
        parameters: parameters(instances),
        files: listed.into_iter().map(|one| file(outputs[one.number])).collect(),
        more_files: outputs.len().saturating_sub(FILES),
        sources: sources(instances),
    }
}

impl StepView {
    /// Takes what is shown at the top of the page: all but looks at what a picture there shows already.
    pub fn shown_above(&mut self) -> Vec<Medium> {
        let media = std::mem::take(&mut self.media);
        let (kept, shown) = media.into_iter().partition(|medium| medium.shown_elsewhere);
        self.media = kept;
        shown
    }

    /// Takes in what its instances said; warnings go to the list of all.
    fn say(&mut self, source: &Source, places: &[usize], warnings: &mut Vec<Said>) {
        let all = &source.manifest.steps;
        let mut notes = Vec::new();
        for place in shown(all, places, READ).into_iter().map(|one| places[one.number]) {
            let label = all[place].label();
            for entry in source.entries(place) {
                let said = |text| Said { label: label.clone(), text };
                match entry {
                    Entry::Note { text } | Entry::Headline { text } => notes.push((place, said(text))),
                    Entry::Warning { text } => warnings.push(said(text)),
                    Entry::Metric { .. } => {}
                }
            }
        }
        self.more_notes = notes.len().saturating_sub(NOTES);
        let told = chosen(notes.len(), NOTES, |number| all[notes[number].0].status != "executed");
        self.notes = told.into_iter().map(|one| notes[one.number].1.clone()).collect();
    }
}

fn metrics(instances: &[&StepDone]) -> Vec<MetricView> {
    let mut told: Vec<(&str, &str, Vec<f64>)> = Vec::new();
    for metric in instances.iter().flat_map(|done| &done.metrics) {
        let Some(value) = metric.value else { continue };
        match told.iter_mut().find(|(name, _, _)| *name == metric.name) {
            Some((_, _, values)) => values.push(value),
            None => told.push((&metric.name, &metric.unit, vec![value])),
        }
    }
    let exact = |value: f64| Shown::of_json(&Value::from(value));
    let view = |(name, unit, mut values): (&str, &str, Vec<f64>)| {
        values.sort_by(f64::total_cmp);
        let ends = [values[0], values[values.len() - 1]];
        MetricView {
            name: name.to_owned(),
            unit: if unit == "1" { String::new() } else { unit.to_owned() },
            count: values.len(),
            value: exact(values[(values.len() - 1) / 2]),
            range: (values.len() > 1).then(|| ends.map(exact)),
        }
    };
    told.into_iter().map(view).collect()
}

/// Every parameter with its values.
fn parameters(instances: &[&StepDone]) -> Vec<ParameterView> {
    let mut found: Vec<(String, Vec<Shown>, BTreeSet<String>)> = Vec::new();
    for done in instances.iter().take(READ) {
        leaves(&done.parameters, "", &mut |name, value| {
            let known = found.iter().position(|(known, _, _)| known == name);
            let place = known.unwrap_or_else(|| {
                found.push((name.to_owned(), Vec::new(), BTreeSet::new()));
                found.len() - 1
            });
            let (_, values, texts) = &mut found[place];
            if texts.insert(value.to_string()) && values.len() < VALUES {
                values.push(Shown::of_json(value));
            }
        });
    }
    found.into_iter().map(|(name, values, texts)| ParameterView { name, values, count: texts.len() }).collect()
}

fn leaves(value: &Value, path: &str, tell: &mut impl FnMut(&str, &Value)) {
    match value {
        Value::Object(map) if !map.is_empty() => map.iter().for_each(|(key, inner)| {
            let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
            leaves(inner, &path, tell);
        }),
        other => tell(path, other),
    }
}

fn sources(instances: &[&StepDone]) -> Vec<(String, String)> {
    let files = instances.iter().take(READ).flat_map(|done| &done.files);
    let named: BTreeMap<String, String> =
        files.map(|file| (file.path.display().to_string(), file.blake3.to_string())).collect();
    named.into_iter().collect()
}
