//! A manifest, the log of a step, and a small store.

use std::collections::BTreeMap;
use std::io;

use rockface_cache::{
    Cost, Digest, Gathered, OutputRecord, Outputs, Recipe, RecipeInput, Record, SafeName, SafePath, SeedMaterial, Store,
};
use rockface_core::Entry;
use rockface_engine::history::{FORMAT, FileUsed, IncludedText, Manifest, Metric, Overridden, PipelineText, StepDone};
use serde_json::json;

use super::{Seed, seed};
use crate::targets::{QUESTION, sealed};

/// Seeds of run folders and stores.
pub fn all() -> io::Result<Vec<Seed>> {
    let segment = segment()?;
    let mut written = Vec::new();
    manifest().write(&mut written)?;
    let answer = json!({"question": Digest::of(QUESTION), "looks": [], "made": ["/site/runs/1", []], "segments": [], "blobs": [], "answer": {"steps": 3}});
    Ok(vec![
        seed("manifest", "two-steps", written),
        seed("step-log", "every-kind", serde_json::to_vec(&entries())?),
        seed("record", "whole", record_in(&segment).ok_or_else(|| io::Error::other("a segment without a record"))?),
        seed("segment-sealed", "whole", &segment),
        seed("segment", "whole", segment),
        seed("answer", "plain", serde_json::to_vec(&answer)?),
    ])
}

fn entries() -> Vec<Entry> {
    vec![
        Entry::Note { text: "16 vertices".into() },
        Entry::Warning { text: "one piece was dropped".into() },
        Entry::Headline { text: "done".into() },
        Entry::Metric { name: "area_m2".into(), value: 9.0, unit: "m2".into() },
    ]
}

fn output() -> OutputRecord {
    let (digest, items) = (Digest::of(b"mesh"), Some(vec!["a".into(), "b".into()]));
    OutputRecord { kind: "mesh".into(), digest, bytes: 4, kept: true, memory_bytes: Some(24), items }
}

fn manifest() -> Manifest {
    let text = "rockface: 1\nname: two\nsteps:\n  face: {stage: synthesise-face}\n".to_owned();
    let included = vec![IncludedText { path: "/site/parts/a.yaml".into(), text: "rockface: 1\n".into() }];
    let pipeline = PipelineText {
        name: "two".into(),
        path: "two.yaml".into(),
        folder: "/site".into(),
        text,
        copied: None,
        asked: Vec::new(),
        included,
    };
    let overrides = Overridden { sweep: Vec::new(), set: vec!["seed=1".into()], seed: Some(7) };
    Manifest {
        format: FORMAT,
        pipeline,
        overrides,
        seed: 7,
        targets: vec!["face".into()],
        finished: "2026-01-01T00:00:00.000Z".into(),
        wall_s: 1.5,
        jobs: 2,
        status: "failed".into(),
        program: json!({"version": "0.1.0", "target": "x86_64"}),
        headlines: vec!["done".into()],
        laid_out: "some".into(),
        parts: Vec::new(),
        store: Some("/shared/store".into()),
        values: serde_json::from_value(json!({"at": {"0": {"a_m": 0.5}}})).unwrap_or_default(),
        steps: vec![done("face", "executed", None), done("dem", "failed", Some("no triangle".into()))],
    }
}

fn done(step: &str, status: &'static str, failure: Option<String>) -> StepDone {
    let gathered = Gathered { point: [("epoch".to_owned(), "pre".to_owned())].into(), digest: Digest::of(b"row") };
    StepDone {
        step: step.into(),
        point: [("epoch".to_owned(), "pre".to_owned())].into(),
        stage: "synthesise-face".into(),
        version: 1,
        status: status.into(),
        failure,
        key: Some(Digest::of(step.as_bytes())),
        outputs: Some(outputs()),
        log: Some(Digest::of(b"log")),
        sketches: None,
        cost: Some(Cost { wall_s: 0.5, cpu_s: 0.75, peak_bytes: 1 << 20, finished_unix_s: 1_700_000_000 }),
        parameters: json!({"width_m": 4.0, "file": {"blake3": Digest::of(b"file")}}).into(),
        metrics: vec![Metric { name: "area_m2".into(), value: Some(12.0), unit: "m2".into() }],
        warnings: vec!["a gap".into()],
        files: vec![FileUsed { path: "/site/face.ply".into(), blake3: Digest::of(b"file") }],
        inputs: BTreeMap::from([
            ("mesh".to_owned(), RecipeInput::One(Digest::of(b"mesh"))),
            ("rows".to_owned(), RecipeInput::Many(vec![gathered])),
        ]),
        paths: SafePath::new("outputs/mesh.ply").map(|path| ("mesh".to_owned(), path)).into_iter().collect(),
    }
}

fn outputs() -> Outputs {
    SafeName::new("mesh").map(|name| (name, output())).into_iter().collect()
}

/// The segment of a store with a blob, a record, a note and a mark, written at a time that is always the same.
fn segment() -> io::Result<Vec<u8>> {
    let folder = tempfile::tempdir()?;
    let store = Store::open(folder.path()).map_err(io::Error::other)?;
    let log = store.put(b"[]").map_err(io::Error::other)?;
    store.put(b"mesh").map_err(io::Error::other)?;
    let recipe = Recipe {
        stage: "synthesise-face".into(),
        version: 3,
        params: json!({"width_m": 4.0}).into(),
        inputs: [("mesh".to_owned(), RecipeInput::One(Digest::of(b"mesh")))].into(),
        seed: Some(SeedMaterial { seed: 7, stream: "face".into(), items: BTreeMap::new() }),
    };
    let record = Record { recipe, outputs: outputs(), log: Some(log), sketches: None, cost: Cost::default() };
    store.commit(&record).map_err(io::Error::other)?;
    store.memory().remember_run(&Digest::of(b"plan"), &json!({"folder": "runs/1"})).map_err(io::Error::other)?;
    store.sync().map_err(io::Error::other)?;
    let files = crate::corpus::files(&folder.path().join("segments"))?;
    let file = files.first().ok_or_else(|| io::Error::other("the store has no segment"))?;
    Ok(timeless(std::fs::read(file)?))
}

/// The frames of a segment: where each begins, its kind, and its length with the header.
fn frames(segment: &[u8]) -> Vec<(usize, u8, usize)> {
    let (mut frames, mut at) = (Vec::new(), 0);
    while let Some(header) = segment.get(at..at + 80) {
        let length = 80 + u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize;
        frames.push((at, header[4], length));
        at += length;
    }
    frames
}

/// The same with other stamps; that of a mark is no time.
fn timeless(mut segment: Vec<u8>) -> Vec<u8> {
    const MARK: u8 = 5;
    for (number, (at, kind, _)) in frames(&segment).into_iter().enumerate() {
        if kind != MARK {
            segment[at + 16..at + 24].copy_from_slice(&(1_700_000_000_000_000_000 + number as u64).to_le_bytes());
        }
    }
    sealed(&segment)
}

/// The payload of the first record.
fn record_in(segment: &[u8]) -> Option<&[u8]> {
    const RECORD: u8 = 2;
    let (at, _, length) = frames(segment).into_iter().find(|(_, kind, _)| *kind == RECORD)?;
    segment.get(at + 80..at + length)
}
