//! What `rockface inspect` says of a run: its manifest in short.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::Facts;
use rockface_engine::history::Manifest;

/// The file of a run folder that tells of its run.
const MANIFEST: &str = "run.json";
/// What every manifest has.
const FIELDS: [&str; 3] = ["format", "pipeline", "steps"];

/// The manifest meant by a path: that of a run folder, or the file itself.
pub fn file_meant(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(MANIFEST) } else { path.to_owned() }
}

/// Whether these bytes are those of a manifest, be it of a version this program reads or not.
pub fn is_manifest(bytes: &[u8]) -> bool {
    let found = serde_json::from_slice::<serde_json::Map<String, Value>>(bytes);
    found.is_ok_and(|found| FIELDS.iter().all(|field| found.contains_key(*field)))
}

/// What there is to say of a run.
pub fn of_manifest(manifest: &Manifest) -> Facts {
    let [executed, cached, missing] = manifest.counts();
    let (overrides, pipeline) = (&manifest.overrides, &manifest.pipeline);
    let mut facts: Facts = vec![
        ("kind".into(), "run".into()),
        ("pipeline".into(), pipeline.name.clone().into()),
        ("pipeline file".into(), pipeline.path.display().to_string().into()),
        ("status".into(), manifest.status.clone().into()),
        ("finished".into(), manifest.finished.clone().into()),
        ("seconds".into(), manifest.wall_s.into()),
        ("seed".into(), manifest.seed.into()),
        ("step instances".into(), manifest.steps.len().into()),
        ("executed, cached, not made".into(), json!([executed, cached, missing])),
        ("program".into(), manifest.made_by().into()),
    ];
    let given = [("targets", &manifest.targets), ("set", &overrides.set), ("sweep", &overrides.sweep)];
    let given = given.into_iter().filter(|(_, texts)| !texts.is_empty());
    facts.extend(given.map(|(name, texts)| (name.to_owned(), json!(texts))));
    if !pipeline.included.is_empty() {
        let files = pipeline.included.iter().map(|file| file.path.display().to_string());
        facts.push(("includes".into(), files.collect()));
    }
    let failures: Vec<String> = manifest.failures().map(|(label, why)| format!("{label}: {why}")).collect();
    if !failures.is_empty() {
        facts.push(("failures".into(), json!(failures)));
    }
    facts.push(("results".into(), json!(manifest.headlines)));
    facts
}
