//! The store's own files: segments, the records in them, and answers.

use std::path::Path;

use rockface_cache::{Cost, Digest, GcPolicy, Recipe, Record, Store, recall};
use serde_json::json;

use super::Verdict;

/// The question that answers here are given to.
pub const QUESTION: &[u8] = b"question";
/// Bytes of the header of a frame; `cache/src/frame.rs` tells what stands in it.
const HEADER_BYTES: usize = 80;

/// The payload of a record, in a segment of its own, under the key of its recipe.
pub fn record(bytes: &[u8]) -> Verdict {
    segment(&frame(2, recipe_in(bytes).unwrap_or(b"key"), 1, bytes))
}

/// The text of the recipe in the payload of a record: its length stands before it.
fn recipe_in(payload: &[u8]) -> Option<&[u8]> {
    let (length, rest) = payload.split_first_chunk::<4>()?;
    rest.get(..u32::from_le_bytes(*length) as usize)
}

/// A frame with checksums.
fn frame(kind: u8, name: &[u8], stamp: u64, payload: &[u8]) -> Vec<u8> {
    let mut frame = b"RFS1".to_vec();
    frame.extend([kind, 0, 0, 0]);
    frame.extend((payload.len() as u32).to_le_bytes());
    frame.extend([0; 4]);
    frame.extend(stamp.to_le_bytes());
    frame.extend(blake3::hash(name).as_bytes());
    frame.extend([0; 24]);
    frame.extend(payload);
    sealed(&frame)
}

/// A segment in which the checksums of every frame are right.
pub fn sealed(bytes: &[u8]) -> Vec<u8> {
    let mut sealed = bytes.to_vec();
    let mut at = 0;
    while at + HEADER_BYTES <= sealed.len() {
        at += if sealed[at..].starts_with(b"RFS1") { seal(&mut sealed[at..]) } else { 1 };
    }
    sealed
}

/// Makes the checksums of the frame right that these bytes begin with; its length, as far as it is there.
fn seal(bytes: &mut [u8]) -> usize {
    let (header, rest) = bytes.split_at_mut(HEADER_BYTES);
    let length = u32::from_le_bytes([header[8], header[9], header[10], header[11]]) as usize;
    let payload = &rest[..length.min(rest.len())];
    header[56..72].copy_from_slice(&blake3::hash(payload).as_bytes()[..16]);
    let check = blake3::hash(&header[..72]);
    header[72..].copy_from_slice(&check.as_bytes()[..8]);
    HEADER_BYTES + payload.len()
}

/// A segment whose checksums are made right.
pub fn segment_sealed(bytes: &[u8]) -> Verdict {
    segment(&sealed(bytes))
}

/// A segment as it is: every record is read, everything is looked after, and the store goes on being used.
pub fn segment(bytes: &[u8]) -> Verdict {
    let Ok(folder) = tempfile::tempdir() else { return Verdict::Refused };
    let dir = folder.path().join("store");
    let written = Store::open(&dir).map(drop).is_ok() && std::fs::write(dir.join("segments/a.seg"), bytes).is_ok();
    if !written {
        return Verdict::Refused;
    }
    let store = Store::open(&dir).expect("no segment keeps a store from being opened");
    let records = look(&store);
    care(&store);
    go_on(&dir, store);
    if records > 0 { Verdict::Accepted } else { Verdict::Refused }
}

/// Reads every record; how many there were.
fn look(store: &Store) -> usize {
    let keys = store.keys();
    let read = keys.iter().filter_map(|key| {
        drop((store.is_hit(key), store.recipe_text(key), store.hit_outcome(key)));
        store.record(key)
    });
    let records: Vec<Record> = read.collect();
    for record in &records {
        let text = record.recipe.text();
        let again: Recipe = serde_json::from_str(&text).expect("the text of a recipe is read back");
        assert_eq!(again, record.recipe, "a recipe comes back as it was");
        record.blobs().for_each(|(blob, _)| drop(store.get(&blob)));
    }
    drop(store.memory().recalled_runs());
    records.len()
}

fn care(store: &Store) {
    drop((store.stat(), store.stat_by_stage(), store.verify(true), store.live()));
    let policy = GcPolicy { unnamed: true, max_age_s: Some(1), max_bytes: Some(10), ..GcPolicy::default() };
    if let Ok(plan) = store.plan_gc(&policy) {
        drop(store.collect(&plan));
    }
}

/// Whatever a segment holds, new work can be kept, and is there for the next process.
fn go_on(dir: &Path, store: Store) {
    let blob = store.put(b"new work").expect("a blob can be put");
    let recipe = Recipe {
        stage: "new".into(),
        version: 1,
        params: json!({}).into(),
        inputs: std::collections::BTreeMap::new(),
        seed: None,
    };
    let outputs = std::iter::empty().collect();
    let record = Record { recipe, outputs, log: Some(blob), sketches: None, cost: Cost::default() };
    let key = store.commit(&record).expect("a record can be committed");
    store.sync().expect("a store can be synced");
    drop(store);
    let store = Store::open(dir).expect("the store opens again");
    assert_eq!(store.is_hit(&key), Some(record), "what was committed is a hit");
}

/// An answer, with the mark of this user: its body is the case.
pub fn answer(bytes: &[u8]) -> Verdict {
    let Ok(folder) = tempfile::tempdir() else { return Verdict::Refused };
    let (dir, question) = (folder.path().join("store"), Digest::of(QUESTION));
    let answers = dir.join("answers");
    let Some(mark) = rockface_cache::mark(&[b"answer", bytes]) else { return Verdict::Refused };
    let text = [format!("rockface answer 3 {mark}\n").as_bytes(), bytes].concat();
    let put = Store::open(&dir).map(drop).is_ok()
        && std::fs::create_dir_all(&answers).is_ok()
        && std::fs::write(answers.join(&question.to_string()[..2]), text).is_ok();
    Verdict::of(put && recall(&dir, &question).is_some())
}
