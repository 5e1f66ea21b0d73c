//! The description of a run folder as a Workflow Run RO-Crate, so that programs which know nothing of rockface find out
//! what was run, its inputs and its outputs.
//!
//! It follows the Provenance Run Crate profile 0.5: <https://w3id.org/ro/wfrun/provenance/0.5>.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use rockface_cache::RecipeInput;
use serde_json::{Value, json};

use super::manifest::{Manifest, StepDone};
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

/// The content of `ro-crate-metadata.json` for a run in `folder`.
pub fn crate_metadata(folder: &Path, manifest: &Manifest) -> Value {
    let mut crated = Crate { manifest, graph: BTreeMap::new(), parts: BTreeSet::new() };
    crated.software();
    crated.files(folder);
    let results = crated.steps();
    crated.run(&results);
    crated.root();
    let graph: Vec<Value> = crated.graph.into_values().collect();
    json!({
        "@context": ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"],
        "@graph": graph,
    })
}

struct Crate<'a> {
    manifest: &'a Manifest,
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

    /// The files of the folder that are not outputs of steps.
    fn files(&mut self, folder: &Path) {
        for (name, format, what) in [
            (MANIFEST_FILE, "application/json", "manifest: everything needed to repeat the run"),
            (LOG_FILE, "application/octet-stream", "log of the run, MCAP"),
            (REPORT_FILE, "text/html", "the run on one page, for people"),
            (POINTS_FILE, "text/csv", "numbers of all steps, a row a point of the axes"),
        ] {
            // Manifest and log are always written, the report where its template can be filled in.
            if ![REPORT_FILE, POINTS_FILE].contains(&name) || folder.join(name).is_file() {
                self.add(name, json!({"@type": "File", "name": name, "description": what, "encodingFormat": format}));
                self.parts.insert(name.to_owned());
            }
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
            let id = match done.paths.get(port.as_str()) {
                Some(path) => self.output_file(done, port, path, &output.kind),
                // Without actions nothing refers to what has no file.
                None if self.manifest.steps.len() > ACTIONS_LIMIT => continue,
                None => self.digest(&digest, &format!("{}.{port}", done.label())),
            };
            made.insert(digest, id.clone());
            ids.push(id);
        }
        ids
    }

    fn output_file(&mut self, done: &StepDone, port: &str, path: &Path, kind: &str) -> String {
        let id = address(path);
        let name = format!("{}.{port}", done.label());
        let format = match path.extension().and_then(|extension| extension.to_str()) {
            Some("json") => "application/json",
            Some("png") => "image/png",
            Some("tif") => "image/tiff",
            Some("exr") => "image/x-exr",
            _ => "application/octet-stream",
        };
        self.add(&id, json!({"@type": "File", "name": name, "description": kind, "encodingFormat": format}));
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
            let name = file.path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            inputs.push(self.digest(&file.blake3.to_string(), &name));
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
            let name = file.path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            given.insert(self.digest(&file.blake3.to_string(), &name));
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

fn step_id(step: &str) -> String {
    format!("{PIPELINE_FILE}#{}", address(Path::new(step)))
}
