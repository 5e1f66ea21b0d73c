//! The promises of the store, kept through its public face: round trips, records, sharing between handles and threads.

mod care;
mod crash;
mod faults;
mod hostile;
mod modes;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use rockface_cache::{Cost, Digest, OutputRecord, Recipe, Record, Store, StoreError};
use serde_json::json;

fn new_store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).unwrap();
    (folder, store)
}

fn recipe(number: u64) -> Recipe {
    let params = json!({ "number": number });
    Recipe { stage: "remove-blocks".into(), version: 1, params: params.into(), inputs: BTreeMap::new(), seed: None }
}

fn output(bytes: &[u8], kept: bool) -> OutputRecord {
    OutputRecord {
        kind: "mesh".into(),
        digest: Digest::of(bytes),
        bytes: bytes.len() as u64,
        kept,
        items: None,
        memory_bytes: None,
    }
}

fn record(number: u64, bytes: &[u8], kept: bool) -> Record {
    let outputs = [("mesh", output(bytes, kept))].try_into().unwrap();
    Record { recipe: recipe(number), outputs, log: None, sketches: None, cost: Cost { wall_s: 0.5, ..Cost::default() } }
}

/// Puts a blob and commits the record of a step that made it.
fn finish(store: &Store, number: u64, bytes: &[u8]) -> Digest {
    store.put(bytes).unwrap();
    store.commit(&record(number, bytes, true)).unwrap()
}

fn segments(dir: &Path) -> Vec<PathBuf> {
    fs::read_dir(dir.join("segments")).unwrap().map(|entry| entry.unwrap().path()).collect()
}

fn blob_path(dir: &Path, digest: &Digest) -> PathBuf {
    let text = digest.to_string();
    dir.join("blobs").join(&text[..2]).join(text)
}

fn sizes() -> [Vec<u8>; 5] {
    [0, 1, 65_535, 65_536, 1 << 20].map(|size| (0..size).map(|at: u32| (at % 253) as u8).collect())
}

#[test]
fn blobs_of_every_size_come_back_now_and_after_reopening() {
    let (folder, store) = new_store();
    for bytes in sizes() {
        let digest = store.put(&bytes).unwrap();
        assert_eq!(digest, Digest::of(&bytes));
        assert_eq!(store.size(&digest), Some(bytes.len() as u64));
        assert!(store.get(&digest).unwrap() == bytes);
    }
    drop(store);
    let store = Store::open(folder.path()).unwrap();
    for bytes in sizes() {
        assert!(store.get(&Digest::of(&bytes)).unwrap() == bytes);
    }
    let stat = store.stat().unwrap();
    assert_eq!((stat.small_blobs, stat.large_blobs, stat.segments), (3, 2, 1));
    assert_eq!((stat.small_blob_bytes, stat.large_blob_bytes), (65_536, 65_536 + (1 << 20)));
}

#[test]
fn what_is_there_is_not_written_again() {
    let (_folder, store) = new_store();
    for bytes in sizes() {
        store.put(&bytes).unwrap();
    }
    finish(&store, 1, b"mesh");
    store.sync().unwrap();
    let before = store.stat().unwrap();
    for bytes in sizes() {
        store.put(&bytes).unwrap();
    }
    finish(&store, 1, b"mesh");
    store.sync().unwrap();
    assert_eq!(store.stat().unwrap(), before);
}

#[test]
fn a_blob_that_is_not_there_is_missing() {
    let (folder, store) = new_store();
    let digest = Digest::of(b"nothing");
    assert!(!store.contains(&digest));
    assert!(matches!(store.get(&digest), Err(StoreError::Missing { digest: named }) if named == digest));
    assert!(matches!(store.materialise(&digest, &folder.path().join("out")), Err(StoreError::Missing { .. })));
}

#[test]
fn a_record_is_a_hit_as_long_as_its_kept_blobs_are_there() {
    let (folder, store) = new_store();
    let large = vec![1; 100_000];
    let key = finish(&store, 1, &large);
    let dropped = store.commit(&record(2, b"never stored", false)).unwrap();
    drop(store);
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(store.is_hit(&key), Some(record(1, &large, true)));
    assert!(store.is_hit(&dropped).is_some(), "what is not kept is not missed");
    fs::remove_file(blob_path(folder.path(), &Digest::of(&large))).unwrap();
    assert!(store.is_hit(&key).is_none() && store.record(&key).is_some());
    assert!(store.hit_outcome(&key).is_none());
    assert!(store.record(&recipe(3).key()).is_none());
}

#[test]
fn a_record_without_its_blobs_or_with_no_sane_cost_is_refused() {
    let (_folder, store) = new_store();
    let missing = store.commit(&record(1, b"not put", true)).unwrap_err().to_string();
    assert!(missing.contains("remove-blocks") && missing.contains(&Digest::of(b"not put").short()), "{missing}");
    let mut logless = record(1, b"", false);
    logless.log = Some(Digest::of(b"no such log"));
    assert!(matches!(store.commit(&logless), Err(StoreError::BadRecord { .. })));
    let mut endless = record(1, b"", false);
    endless.cost.wall_s = f64::NAN;
    assert!(matches!(store.commit(&endless), Err(StoreError::BadRecord { .. })));
}

#[test]
fn a_record_that_says_otherwise_supersedes_the_first() {
    let (folder, store) = new_store();
    let key = finish(&store, 1, b"first");
    let mut slower = record(1, b"first", true);
    slower.cost.wall_s = 9.0;
    store.commit(&slower).unwrap();
    let kept = store.record(&key).unwrap();
    assert_eq!(kept, record(1, b"first", true), "the same outcome: the first record stays");
    finish(&store, 1, b"second");
    drop(store);
    let record = Store::open(folder.path()).unwrap().is_hit(&key).unwrap();
    assert_eq!(record.outputs["mesh"].digest, Digest::of(b"second"));
}

#[test]
fn two_writers_see_each_other_after_a_refresh() {
    let (folder, ours) = new_store();
    let theirs = Store::open(folder.path()).unwrap();
    let (a, b) = (finish(&ours, 1, b"ours"), finish(&theirs, 2, b"theirs"));
    assert!(ours.is_hit(&b).is_none());
    ours.refresh().unwrap();
    theirs.refresh().unwrap();
    assert!(ours.is_hit(&b).is_some() && theirs.is_hit(&a).is_some());
    assert_eq!(ours.get(&Digest::of(b"theirs")).unwrap(), b"theirs");
    assert_eq!(segments(folder.path()).len(), 2);
    drop((ours, theirs));
    for number in 3..6 {
        finish(&Store::open(folder.path()).unwrap(), number, b"later");
    }
    assert_eq!(segments(folder.path()).len(), 2, "later writers continue what the former left");
    assert_eq!(Store::open(folder.path()).unwrap().keys().len(), 5);
}

#[test]
fn a_store_that_is_only_read_writes_nothing() {
    let (folder, store) = new_store();
    assert!(store.is_hit(&Digest::of(b"key")).is_none());
    store.sync().unwrap();
    drop(store);
    assert_eq!(segments(folder.path()).len(), 0);
}

#[test]
fn a_lock_holds_across_handles_and_is_released_on_drop() {
    let (folder, ours) = new_store();
    let theirs = Store::open(folder.path()).unwrap();
    let key = Digest::of(b"key");
    let held = ours.lock(&key, || panic!("nobody holds it")).unwrap();
    assert!(theirs.try_lock(&key).unwrap().is_none());
    let (say, hear) = std::sync::mpsc::channel();
    std::thread::scope(|scope| {
        let waiter = scope.spawn(|| theirs.lock(&key, || say.send(()).unwrap()).map(drop));
        hear.recv().unwrap();
        finish(&ours, 1, b"done");
        drop(held);
        waiter.join().unwrap().unwrap();
    });
    theirs.refresh().unwrap();
    assert!(theirs.is_hit(&recipe(1).key()).is_some());
}

#[test]
fn programs_that_start_meanwhile_hold_on_to_nothing() {
    let (folder, store) = new_store();
    drop(store);
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    std::process::Command::new("true").status().unwrap();
                }
            });
        }
        for number in 0..200 {
            let store = Store::open(folder.path()).unwrap();
            drop(store.try_lock(&Digest::of(b"key")).unwrap().expect("nobody holds it"));
            finish(&store, number, b"mesh");
        }
        done.store(true, std::sync::atomic::Ordering::Relaxed);
    });
    assert_eq!(segments(folder.path()).len(), 1);
}

#[test]
fn notes_on_runs_are_recalled_latest_first() {
    let (folder, store) = new_store();
    let plan = Digest::of(b"plan");
    assert!(store.memory().recalled_run(&plan).is_none());
    for run in ["first", "second"] {
        store.memory().remember_run(&plan, &json!({ "run": run })).unwrap();
        assert_eq!(store.memory().own_run(&plan), Some(json!({ "run": run })));
    }
    drop(store);
    assert_eq!(Store::open(folder.path()).unwrap().memory().own_run(&plan), Some(json!({ "run": "second" })));
}

#[test]
fn looking_for_news_while_a_segment_is_begun_forgets_nothing() {
    for _ in 0..200 {
        let (_folder, store) = new_store();
        let key = std::thread::scope(|scope| {
            let looking = scope.spawn(|| (0..20).for_each(|_| store.refresh().unwrap()));
            let key = finish(&store, 1, b"begun");
            looking.join().unwrap();
            key
        });
        assert!(store.has_record(&key));
    }
}

#[test]
fn threads_share_one_store() {
    let (_folder, store) = new_store();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for number in 0..100 {
                    finish(&store, number, &number.to_le_bytes());
                }
            });
        }
    });
    let stat = store.stat().unwrap();
    assert_eq!((stat.records, stat.small_blobs, stat.segments), (100, 100, 1));
    assert!((0..100).all(|number| store.is_hit(&recipe(number).key()).is_some()));
}
