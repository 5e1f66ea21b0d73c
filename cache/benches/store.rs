//! Measures what an engine waits for: committing, opening, looking up and recalling many small steps.

use std::time::{Duration, Instant};

use rockface_cache::{Cost, Digest, OutputRecord, Recipe, RecipeInput, Record, SeedMaterial, Store};
use serde_json::json;

/// Steps in the store.
const STEPS: u64 = 10_000;
/// How often reading operations are repeated; the fastest time is reported.
const REPEATS: usize = 5;

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let store = Store::open(folder.path()).expect("a new store");
    let started = Instant::now();
    let records: Vec<Record> = (0..STEPS).map(|number| step(&store, number)).collect();
    report("put 2 blobs and commit", (started.elapsed(), records.len()));
    let started = Instant::now();
    store.sync().expect("a synced store");
    report("sync", (started.elapsed(), 1));
    drop(store);

    report("open", fastest(&[()], |()| Store::open(folder.path()).expect("the store")));
    let store = Store::open(folder.path()).expect("the store");
    report("recipe key", fastest(&records, |record| record.recipe.key()));
    let keys: Vec<Digest> = records.iter().map(|record| record.recipe.key()).collect();
    report("is_hit", fastest(&keys, |key| store.is_hit(key).expect("a hit")));
    report("hit_outcome", fastest(&keys, |key| store.hit_outcome(key).expect("a hit")));
    report("refresh with nothing new", fastest(&[()], |()| store.refresh().expect("a refreshed store")));
    report("lock and release", fastest(&keys, |key| store.lock(key, || ()).expect("a lock")));

    let file = folder.path().join("input.bin");
    std::fs::write(&file, vec![1; 64 << 20]).expect("a file");
    report("hash 64 MiB", fastest(&[()], |()| store.hash_file(&file).expect("a digest")));
    std::thread::sleep(Duration::from_secs(2));
    store.hash_file(&file).expect("a digest");
    report("hash it untouched", fastest(&keys, |_| store.hash_file(&file).expect("a digest")));
    println!("{:#?}", store.stat().expect("counts"));
}

/// What one cheap step leaves behind: an output, a log and a record.
fn step(store: &Store, number: u64) -> Record {
    let output = number.to_le_bytes();
    let log = format!("the log of step {number}");
    let items = [("replicate".to_owned(), number.to_string())].into();
    let recipe = Recipe {
        stage: "remove-blocks".to_owned(),
        version: 1,
        params: json!({"count": 100, "max_failed_attempts": 1000, "radius_m": 0.25, "number": number}).into(),
        inputs: ["mesh", "blocks", "mask"].map(|port| (port.to_owned(), RecipeInput::One(Digest::of(&output)))).into(),
        seed: Some(SeedMaterial { seed: 2747, stream: "removed".to_owned(), items }),
    };
    let digest = store.put(&output).expect("a stored blob");
    let kept = OutputRecord { kind: "mesh".to_owned(), digest, bytes: 8, kept: true, items: None, memory_bytes: None };
    let outputs = [("mesh", kept)].try_into().expect("names");
    let log = Some(store.put(log.as_bytes()).expect("a stored log"));
    let record = Record { recipe, outputs, log, sketches: None, cost: Cost::default() };
    store.commit(&record).expect("a committed record");
    record
}

/// The fastest of several rounds of `work` over all items, and how many items that were.
fn fastest<I, T>(items: &[I], work: impl Fn(&I) -> T) -> (Duration, usize) {
    let round = || {
        let started = Instant::now();
        for item in items {
            std::hint::black_box(work(item));
        }
        started.elapsed()
    };
    ((0..REPEATS).map(|_| round()).min().unwrap_or_default(), items.len())
}

fn report(what: &str, (taken, count): (Duration, usize)) {
    let taken_ms = taken.as_secs_f64() * 1e3;
    println!("{what:28} {taken_ms:10.3} ms {:10.2} us each", taken_ms * 1e3 / count as f64);
}
