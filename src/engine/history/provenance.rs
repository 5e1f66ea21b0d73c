//! The description of a run folder as a Workflow Run RO-Crate, so that programs which know nothing of rockface find out
//! what was run, its inputs and its outputs.
//!
//! It follows the Provenance Run Crate profile 0.5: <https://w3id.org/ro/wfrun/provenance/0.5>.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use rockface_cache::{Digest, OutputRecord, RecipeInput, SafeName};
use serde_json::{Value, json};

use super::file_names::SUMS_FILE;
use super::inputs::INPUTS;
use super::manifest::{FileUsed, Manifest, StepDone};
use super::places::place_of;
use super::{CRATE_FILE, LOG_FILE, MANIFEST_FILE, PIPELINE_FILE, POINTS_FILE, REPORT_FILE};
use crate::watch::moment;

/// Runs of more instances are described as a whole, without an action for each.
const ACTIONS_LIMIT: usize = 2000;
/// The profiles the crate conforms to: address, name, version.
const PROFILES: [(&str, &str, &str); 4] = [
    ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate", "0.5"),
    ("https://w3id.org/ro/wfrun/provenance/0.5", "Provenance Run Crate", "0.5"),
    ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate", "1.0"),
];

/// What an archive has besides the files of a run folder: path, description. Paths of folders end with `/`.
const OF_ARCHIVES: [(&str, &str); 5] = [
    (SUMS_FILE, "the BLAKE3 of every other file"),
    ("README", "what is in the archive"),
    ("logs/", "what steps said"),
    ("pipeline/", "the pipeline and the files it includes, in their relative layout"),
    ("records/", "the recipe of every step"),
];

/// The content of `ro-crate-metadata.json` for a run in `folder`.
pub fn crate_metadata(folder: &Path, manifest: &Manifest) -> String {
    // Manifest and log are always written, the report where its template can be filled in.
    let has = |name: &str| ![REPORT_FILE, POINTS_FILE].contains(&name) || folder.join(name).is_file();
    let place = |done: &StepDone, port: &SafeName, _: &OutputRecord| {
        done.paths.get(port.as_str()).map(|path| path.to_path_buf())
    };
    described(manifest, &has, &place, None)
}

/// The same for an archive with these files.
pub(super) fn crate_of_archive(manifest: &Manifest, files: &BTreeMap<PathBuf, Digest>) -> String {
    let has = |name: &str| match name.strip_suffix('/') {
        Some(folder) => files.keys().any(|file| file.starts_with(folder)),
        // The sums are written last.
        None => name == SUMS_FILE || files.contains_key(Path::new(name)),
    };
    let place = |done: &StepDone, port: &SafeName, output: &OutputRecord| {
        let place = place_of(done, port, output).ok()?;
        files.contains_key(&*place).then(|| place.to_path_buf())
    };
    let inputs = files.iter().filter(|(file, _)| file.starts_with(INPUTS));
    described(manifest, &has, &place, Some(inputs.map(|(file, digest)| (*digest, file.as_path())).collect()))
}

/// A crate with the files that it `has`, with its outputs in their places; `archived` are the input files of an archive.
fn described(manifest: &Manifest, has: Has, place: Place, archived: Option<BTreeMap<Digest, &Path>>) -> String {
    let (is_archive, inputs) = (archived.is_some(), archived.unwrap_or_default());
    let mut crated = Crate { manifest, is_archive, has, place, inputs, graph: BTreeMap::new(), parts: BTreeSet::new() };
    crated.software();
    crated.files();
    let results = crated.steps();
    crated.run(&results);
    crated.root();
    let graph: Vec<Value> = crated.graph.into_values().collect();
    let described = json!({
        "@context": ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"],
        "@graph": graph,
    });
    format!("{described:#}\n")
}

/// Whether a file, or a folder with files, is in the crate.
type Has<'a> = &'a dyn Fn(&str) -> bool;
/// Where the file of an output is in the crate.
type Place<'a> = &'a dyn Fn(&StepDone, &SafeName, &OutputRecord) -> Option<PathBuf>;

struct Crate<'a> {
    manifest: &'a Manifest,
    /// Whether it is an archive, not the folder of a run.
    is_archive: bool,
    has: Has<'a>,
    place: Place<'a>,
    /// Files that steps have read and that are in the crate.
    inputs: BTreeMap<Digest, &'a Path>,
    /// Entities by their `@id`.
    graph: BTreeMap<String, Value>,
    /// The files of the crate.
    parts: BTreeSet<String>,
}

/// A reference to an entity.
fn to(id: &str) -> Value {
    json!({ "@id": id })
}

/// References to entities; a single one stands without a list, as the specification wants it.
fn all(ids: impl IntoIterator<Item = String>) -> Value {
    let mut references: Vec<Value> = ids.into_iter().map(|id| to(&id)).collect();
    if references.len() == 1 { references.remove(0) } else { references.into() }
}

/// A path as the part of an address: what is not plain is written in hexadecimal.
fn address(path: &Path) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/._-~,=".contains(&byte);
    let text = path.to_string_lossy();
    text.bytes().map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") }).collect()
}

impl Crate<'_> {
    fn add(&mut self, id: &str, mut entity: Value) {
        entity["@id"] = id.into();
        self.graph.insert(id.to_owned(), entity);
    }

    fn tool(done: &StepDone) -> String {
        format!("#stage-{}-{}", done.stage, done.version)
    }

    /// The pipeline, its language, its steps, the stages, and the engine.
    fn software(&mut self) {
        let manifest = self.manifest;
        let mut steps: Vec<(&str, String)> = Vec::new();
        for done in &manifest.steps {
            let tool = Self::tool(done);
            if steps.last().is_none_or(|(step, _)| *step != done.step) {
                steps.push((&done.step, tool.clone()));
            }
            if !self.graph.contains_key(&tool) {
                let version = done.version.to_string();
                let stage = json!({"@type": "SoftwareApplication", "name": done.stage, "softwareVersion": version});
                self.add(&tool, stage);
            }
        }
        for (place, (step, tool)) in steps.iter().enumerate() {
            let how =
                json!({"@type": "HowToStep", "name": step, "position": place.to_string(), "workExample": to(tool)});
            self.add(&step_id(step), how);
        }
        let tools: BTreeSet<String> = steps.iter().map(|(_, tool)| tool.clone()).collect();
        let workflow = json!({
            "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow", "HowTo"],
            "name": manifest.pipeline.name, "encodingFormat": "application/yaml",
            "programmingLanguage": to("#language"), "hasPart": all(tools),
            "step": all(steps.iter().map(|(step, _)| step_id(step))),
        });
        self.add(PIPELINE_FILE, workflow);
        self.parts.insert(PIPELINE_FILE.to_owned());
        let version = manifest.program["rockface"].as_str().unwrap_or("unknown").to_owned();
        let language = json!({"@type": "ComputerLanguage", "name": "rockface pipeline", "version": "1", "alternateName": "rockface"});
        self.add("#language", language);
        self.add("#engine", json!({"@type": "SoftwareApplication", "name": "rockface", "softwareVersion": version}));
    }

    /// The files that are not outputs of steps.
    fn files(&mut self) {
        for (name, format, what) in [
            (MANIFEST_FILE, "application/json", "manifest: everything needed to repeat the run"),
            (LOG_FILE, "application/octet-stream", "log of the run, MCAP"),
            (REPORT_FILE, "text/html", "the run on one page, for people"),
            (POINTS_FILE, "text/csv", "numbers of all steps, a row a point of the axes"),
        ] {
            if (self.has)(name) {
                self.add(name, json!({"@type": "File", "name": name, "description": what, "encodingFormat": format}));
                self.parts.insert(name.to_owned());
            }
        }
        // A run folder may have a file of such a name from somebody else.
        for (name, what) in OF_ARCHIVES {
            if self.is_archive && (self.has)(name) {
                let kind = if name.ends_with('/') { "Dataset" } else { "File" };
                self.add(name, json!({"@type": kind, "name": name.trim_end_matches('/'), "description": what}));
                self.parts.insert(name.to_owned());
            }
        }
        for (digest, path) in self.inputs.clone() {
            let (id, format) = (address(path), media_type(path));
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            self.add(&id, json!({"@type": "File", "name": name, "description": "input", "encodingFormat": format, "identifier": format!("blake3:{digest}")}));
            self.parts.insert(id);
        }
    }

    /// The actions of all step instances; returns what the whole run gave.
    fn steps(&mut self) -> BTreeSet<String> {
        let manifest = self.manifest;
        let mut made: BTreeMap<String, String> = BTreeMap::new();
        let mut results = BTreeSet::new();
        for (number, done) in manifest.steps.iter().enumerate() {
            let outputs = self.outputs(done, &mut made);
            results.extend(outputs.iter().filter(|id| !id.starts_with('#')).cloned());
            if manifest.steps.len() <= ACTIONS_LIMIT {
                self.action(number, done, &made, &outputs);
            }
        }
        if manifest.steps.len() <= ACTIONS_LIMIT {
            let controls = all((0..manifest.steps.len()).map(|number| format!("#control-{number}")));
            let organise = json!({
                "@type": "OrganizeAction", "name": "the work of the engine", "instrument": to("#engine"),
                "object": controls, "result": to("#run"),
            });
            self.add("#organise", organise);
        }
        results
    }

    /// The outputs of an instance as entities: files of the folder, and digests of what has no file.
    fn outputs(&mut self, done: &StepDone, made: &mut BTreeMap<String, String>) -> Vec<String> {
        let mut ids = Vec::new();
        for (port, output) in done.outputs.iter().flatten() {
            let digest = output.digest.to_string();
            let id = match (self.place)(done, port, output) {
                Some(path) => self.output_file(done, port, &path, output),
                // Without actions nothing refers to what has no file.
                None if self.manifest.steps.len() > ACTIONS_LIMIT => continue,
                None => self.digest(&digest, &format!("{}.{port}", done.label())),
            };
            made.insert(digest, id.clone());
            ids.push(id);
        }
        ids
    }

    fn output_file(&mut self, done: &StepDone, port: &str, path: &Path, output: &OutputRecord) -> String {
        let id = address(path);
        let name = format!("{}.{port}", done.label());
        let file = json!({
            "@type": "File", "name": name, "description": output.kind, "encodingFormat": media_type(path),
            "contentSize": output.bytes.to_string(), "identifier": format!("blake3:{}", output.digest),
        });
        self.add(&id, file);
        self.parts.insert(id.clone());
        id
    }

    /// What has no file in the folder is named by its digest.
    fn digest(&mut self, digest: &str, name: &str) -> String {
        let id = format!("#blake3-{digest}");
        if !self.graph.contains_key(&id) {
            self.add(&id, json!({"@type": "PropertyValue", "name": name, "value": format!("blake3:{digest}")}));
        }
        id
    }

    /// A file that a step has read: where it is in the crate, else its digest.
    fn input_file(&mut self, file: &FileUsed) -> String {
        if let Some(path) = self.inputs.get(&file.blake3) {
            return address(path);
        }
        let name = file.path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        self.digest(&file.blake3.to_string(), &name)
    }

    fn action(&mut self, number: usize, done: &StepDone, made: &BTreeMap<String, String>, outputs: &[String]) {
        let mut inputs = Vec::new();
        for (port, input) in &done.inputs {
            let digests = match input {
                RecipeInput::One(digest) => vec![digest.to_string()],
                RecipeInput::Many(list) => list.iter().map(|one| one.digest.to_string()).collect(),
            };
            for digest in digests {
                inputs.push(made.get(&digest).cloned().unwrap_or_else(|| self.digest(&digest, port)));
            }
        }
        for file in &done.files {
            inputs.push(self.input_file(file));
        }
        inputs.push(self.parameters(number, done));
        let failed = done.outputs.is_none();
        let mut action = json!({
            "@type": "CreateAction", "name": done.label(), "instrument": to(&Self::tool(done)),
            "object": all(inputs), "result": all(outputs.iter().cloned()),
            "actionStatus": if failed { "http://schema.org/FailedActionStatus" } else { "http://schema.org/CompletedActionStatus" },
        });
        if let Some(cost) = &done.cost {
            action["startTime"] = moment(cost.finished_unix_s as f64 - cost.wall_s).into();
            action["endTime"] = moment(cost.finished_unix_s as f64).into();
        }
        self.add(&format!("#step-{number}"), action);
        let control = json!({
            "@type": "ControlAction", "name": format!("orchestrate {}", done.label()),
            "instrument": to(&step_id(&done.step)), "object": to(&format!("#step-{number}")),
        });
        self.add(&format!("#control-{number}"), control);
    }

    fn parameters(&mut self, number: usize, done: &StepDone) -> String {
        let id = format!("#parameters-{number}");
        let name = format!("parameters of {}", done.label());
        self.add(&id, json!({"@type": "PropertyValue", "name": name, "value": done.parameters.to_string()}));
        id
    }

    /// The action of the whole run.
    fn run(&mut self, results: &BTreeSet<String>) {
        let manifest = self.manifest;
        let mut given = BTreeSet::from([self.setting("seed", &manifest.seed.to_string())]);
        for set in &manifest.overrides.set {
            let (name, value) = set.split_once('=').unwrap_or((set, ""));
            given.insert(self.setting(name, value));
        }
        for file in manifest.steps.iter().flat_map(|done| &done.files) {
            given.insert(self.input_file(file));
        }
        let ended = humantime::parse_rfc3339(&manifest.finished).unwrap_or(SystemTime::UNIX_EPOCH);
        let ended_s = ended.duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        let status = if manifest.status == "done" { "Completed" } else { "Failed" };
        let action = json!({
            "@type": "CreateAction", "name": format!("run of {}", manifest.pipeline.name),
            "instrument": to(PIPELINE_FILE), "object": all(given), "result": all(results.iter().cloned()),
            "startTime": moment(ended_s - manifest.wall_s), "endTime": manifest.finished,
            "actionStatus": format!("http://schema.org/{status}ActionStatus"),
        });
        self.add("#run", action);
    }

    fn setting(&mut self, name: &str, value: &str) -> String {
        let id = format!("#setting-{}", address(Path::new(name)));
        self.add(&id, json!({"@type": "PropertyValue", "name": name, "value": value}));
        id
    }

    /// The folder itself, and the file that describes it.
    fn root(&mut self) {
        let manifest = self.manifest;
        let whole = manifest.steps.len() <= ACTIONS_LIMIT;
        let profiles: Vec<_> = PROFILES.iter().filter(|profile| whole || profile.1 != "Provenance Run Crate").collect();
        for (id, name, version) in &profiles {
            self.add(id, json!({"@type": "CreativeWork", "name": name, "version": version}));
        }
        let licence = "Not stated by the run: ask whoever made the pipeline and its inputs.";
        self.add("#licence", json!({"@type": "CreativeWork", "name": "licence not stated", "description": licence}));
        let mut mentions = vec![to("#run")];
        mentions.extend(whole.then(|| to("#organise")));
        let root = json!({
            "@type": "Dataset", "name": format!("rockface run of {}", manifest.pipeline.name),
            "description": format!("What the pipeline `{}` gave, and how.", manifest.pipeline.name),
            "datePublished": manifest.finished, "license": to("#licence"),
            "conformsTo": all(profiles.iter().map(|profile| profile.0.to_owned())),
            "hasPart": all(self.parts.iter().cloned()), "mainEntity": to(PIPELINE_FILE), "mentions": mentions,
        });
        self.add("./", root);
        let descriptor = json!({
            "@type": "CreativeWork", "about": to("./"),
            "conformsTo": [to("https://w3id.org/ro/crate/1.1"), to("https://w3id.org/workflowhub/workflow-ro-crate/1.0")],
        });
        self.add(CRATE_FILE, descriptor);
    }
}

/// The media type of a file, by its ending; of those that have none, that of any bytes.
fn media_type(path: &Path) -> &'static str {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => "text/csv",
        Some("exr") => "image/x-exr",
        Some("geojson") => "application/geo+json",
        Some("html") => "text/html",
        Some("json") => "application/json",
        Some("kml") => "application/vnd.google-earth.kml+xml",
        Some("md") => "text/markdown",
        Some("png") => "image/png",
        Some("svg") => "image/svg+xml",
        Some("tar") => "application/x-tar",
        Some("tif") => "image/tiff",
        Some("yaml") => "application/yaml",
        _ => "application/octet-stream",
    }
}

fn step_id(step: &str) -> String {
    format!("{PIPELINE_FILE}#{}", address(Path::new(step)))
}
