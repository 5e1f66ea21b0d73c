//! What every place for results has to do, whatever it is made of. Each place opens handles to itself, as several machines would.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use rockface_cache::remote::{Backend, BackendError, Remote, RemoteGcPolicy, Use};
use rockface_cache::{Cost, Digest, Handed, OutputRecord, Recipe, Record, Store, StoreError};

/// Opens a backend: each call gives another handle to the same place.
pub type Open<'a> = &'a (dyn Fn() -> Box<dyn Backend> + Sync);

pub fn new_store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("store")).unwrap();
    (folder, store)
}

/// Puts the output of a step and commits its record.
pub fn finish(store: &Store, number: u64, bytes: &[u8], kept: bool) -> Digest {
    let digest = if kept { store.put(bytes).unwrap() } else { Digest::of(bytes) };
    let log = store.put(format!("log of {number}").as_bytes()).unwrap();
    let output =
        OutputRecord { kind: "mesh".into(), digest, bytes: bytes.len() as u64, kept, items: None, memory_bytes: None };
    let params = serde_json::json!({ "number": number });
    let recipe = Recipe { stage: "s".into(), version: 1, params: params.into(), inputs: BTreeMap::new(), seed: None };
    let outputs = [("mesh", output)].try_into().unwrap();
    let cost = Cost { finished_unix_s: 1_000_000 + number, ..Cost::default() };
    store.commit(&Record { recipe, outputs, log: Some(log), sketches: None, cost }).unwrap()
}

pub fn small(number: u64) -> Vec<u8> {
    format!("small {number}").into_bytes()
}

pub fn large(number: u64) -> Vec<u8> {
    (0..100_000_u64).map(|at| (at * (number + 1) % 251) as u8).collect()
}

/// Records with a small and a large output in turn.
pub fn fill(store: &Store, numbers: std::ops::Range<u64>) -> Vec<Digest> {
    let bytes = |number: u64| if number.is_multiple_of(2) { small(number) } else { large(number) };
    numbers.map(|number| finish(store, number, &bytes(number), true)).collect()
}

pub fn remote(open: Open, what_for: Use) -> Result<Remote, StoreError> {
    Remote::open(open(), None, what_for, Box::new(|_| ()))
}

fn itself(open: Open) -> Remote {
    remote(open, Use::Itself).unwrap()
}

/// A store over the place.
pub fn over(open: Open) -> (tempfile::TempDir, Store) {
    let (folder, store) = new_store();
    store.attach(remote(open, Use::Layer).unwrap()).unwrap();
    (folder, store)
}

fn never() -> AtomicBool {
    AtomicBool::new(false)
}

/// All promises of a backend that only moves bytes.
pub fn moves_bytes(open: Open) {
    let (one, other) = (open(), open());
    assert_eq!(one.get("a/none", 10), Err(BackendError::Missing));
    assert_eq!(one.list("a/"), Ok(vec![]));
    for size in [0, 1, 70_000] {
        let bytes: Vec<u8> = (0..size).map(|at: u32| (at % 251) as u8).collect();
        one.put("a/b/c", &bytes).unwrap();
        assert_eq!(other.get("a/b/c", 70_000), Ok(bytes), "the last one counts");
    }
    assert_eq!(other.get("a/b/c", 69_999), Err(BackendError::TooLarge { limit: 69_999 }));
    assert_eq!(one.create("a/b/c", b"second"), Ok(false));
    assert_eq!(one.create("a/d", b"first"), Ok(true));
    one.put("ab/e", b"beside").unwrap();
    let mut names: Vec<(String, u64)> =
        other.list("a/").unwrap().into_iter().map(|one| (one.name, one.bytes)).collect();
    names.sort();
    assert_eq!(names, [("a/b/c".to_owned(), 70_000), ("a/d".to_owned(), 5)]);
    for name in ["a/b/c", "a/b/c", "a/d", "ab/e"] {
        other.delete(name).unwrap();
    }
    assert_eq!(one.list("a/"), Ok(vec![]));
    assert_eq!(one.get("a/d", 10), Err(BackendError::Missing));
}

/// Of many who create one object, one does, and its bytes stay.
pub fn has_one_winner(open: Open) {
    for round in 0..3 {
        let (name, wins) = (format!("race/{round}"), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for contender in 0..32 {
                let (name, wins) = (&name, &wins);
                scope.spawn(move || {
                    let won = open().create(name, format!("{contender}").as_bytes()).unwrap();
                    wins.fetch_add(u32::from(won), Ordering::Relaxed);
                });
            }
        });
        assert_eq!(wins.into_inner(), 1);
        open().delete(&name).unwrap();
    }
}

/// A place that results are copied to and from: a remote one, or another local store.
pub trait Place {
    fn push(&self, from: Store, keys: &[Digest]) -> (Handed, Store);
    fn pull(&self, to: Store, keys: &[Digest]) -> (Handed, Store);
}

impl Place for Open<'_> {
    fn push(&self, from: Store, keys: &[Digest]) -> (Handed, Store) {
        let handed = from.push_to(itself(self), keys, &never()).unwrap();
        let dir = from.dir().to_owned();
        drop(from);
        (handed, Store::open(&dir).unwrap())
    }

    fn pull(&self, to: Store, keys: &[Digest]) -> (Handed, Store) {
        let handed = to.pull_from(itself(self), keys).unwrap();
        let dir = to.dir().to_owned();
        drop(to);
        (handed, Store::open(&dir).unwrap())
    }
}

impl Place for Store {
    fn push(&self, from: Store, keys: &[Digest]) -> (Handed, Store) {
        (from.hand_to(self, keys).unwrap(), from)
    }

    fn pull(&self, to: Store, keys: &[Digest]) -> (Handed, Store) {
        (self.hand_to(&to, keys).unwrap(), to)
    }
}

/// What is pushed is pulled elsewhere, once, and what is worse does not replace what is better.
pub fn carries_results(place: &dyn Place) {
    let ((_a, one), (_b, other)) = (new_store(), new_store());
    let mut keys = fill(&one, 0..6);
    keys.push(finish(&one, 100, b"value", false));
    let unknown = Digest::of(b"nothing");
    let (handed, one) = place.push(one, &[keys.as_slice(), &[unknown]].concat());
    assert_eq!((handed.records, handed.known, handed.missing), (7, 0, 1));
    assert_eq!(handed.blobs, 6 + 7, "each output and each log");
    let (again, one) = place.push(one, &keys);
    assert_eq!((again.records, again.known, again.missing, again.blobs), (0, 7, 0, 0));
    let (pulled, other) = place.pull(other, &keys);
    assert_eq!((pulled.records, pulled.known, pulled.missing), (7, 0, 0));
    assert_eq!((pulled.blobs, pulled.bytes), (handed.blobs, handed.bytes));
    for key in &keys {
        assert_eq!(other.is_hit(key), one.is_hit(key));
    }
    assert_eq!(other.get(&Digest::of(&large(1))).unwrap(), large(1));
    let (again, other) = place.pull(other, &keys);
    assert_eq!((again.records, again.known), (0, 7));
    // Kept outputs take the place of those that are only told of, and never the other way round.
    let key = finish(&other, 100, b"value", true);
    assert_eq!(key, keys[6]);
    let (better, other) = place.push(other, &[key]);
    assert_eq!((better.records, better.known), (1, 0));
    let (worse, one) = place.push(one, &[key]);
    assert_eq!((worse.records, worse.known), (0, 1));
    let (taken, one) = place.pull(one, &[key]);
    assert_eq!(taken.records, 1);
    assert!(one.is_hit(&key).unwrap().outputs["mesh"].kept && other.is_hit(&key).is_some());
}

/// A store over the place finds what others made, fetches what it needs and no more, and uploads what it makes.
pub fn is_a_layer(open: Open) {
    let (_a, maker) = over(open);
    let keys = fill(&maker, 0..4);
    let done = maker.finish_uploads(&never());
    assert_eq!((done.records, done.failed), (4, 0));
    let (folder, user) = over(open);
    assert!(keys.iter().all(|key| user.hit_outcome(key).is_some() && user.is_hit(key).is_some()));
    assert_eq!(user.keys(), [], "nothing is copied before it is needed");
    assert!(user.contains(&Digest::of(&large(1))) && user.size(&Digest::of(&large(3))) == Some(100_000));
    let before = user.remote().unwrap().traffic().bytes_read;
    assert_eq!(user.get(&Digest::of(&large(1))).unwrap(), large(1));
    assert_eq!(user.remote().unwrap().traffic().bytes_read - before, 100_000);
    user.materialise(&Digest::of(&large(3)), &folder.path().join("out")).unwrap();
    assert_eq!(std::fs::read(folder.path().join("out")).unwrap(), large(3));
    assert_eq!(user.get(&Digest::of(&small(0))).unwrap(), small(0));
    let reads = user.remote().unwrap().traffic().reads;
    for number in [0, 2] {
        assert_eq!(user.get(&Digest::of(&small(number))).unwrap(), small(number));
    }
    assert_eq!(user.remote().unwrap().traffic().reads, reads, "they came in one pack");
    user.adopt(keys.clone()).unwrap();
    // What it makes others find.
    let new = finish(&user, 50, &large(50), true);
    assert_eq!(user.finish_uploads(&never()).records, 1);
    let dir = user.dir().to_owned();
    drop(user);
    let alone = Store::open(&dir).unwrap();
    assert!(keys.iter().all(|key| alone.is_hit(key).is_some()), "all of it is in the store by now");
    assert!(over(open).1.is_hit(&new).is_some());
}

/// Objects that are gone or damaged are missing, never wrong and never a fault; whoever makes them again heals the place.
pub fn survives_loss(open: Open) {
    let (_a, maker) = over(open);
    let keys = fill(&maker, 0..4);
    maker.finish_uploads(&never());
    let backend = open();
    let names = |prefix| backend.list(prefix).unwrap().into_iter().map(|object| object.name).collect::<Vec<_>>();
    let blobs = names("blobs/");
    backend.delete(&blobs[0]).unwrap();
    backend.put(&blobs[1], b"damaged").unwrap();
    backend.put(&names("packs/")[0], &[7; 64]).unwrap();
    let (_b, user) = over(open);
    for number in 0..4 {
        let bytes = if number % 2 == 0 { small(number) } else { large(number) };
        let digest = Digest::of(&bytes);
        assert!(matches!(user.get(&digest), Err(StoreError::Missing { .. })));
        assert!(!user.contains(&digest) && user.hit_outcome(&keys[number as usize]).is_none());
    }
    assert!(!user.remote().unwrap().is_off());
    assert_eq!(fill(&user, 0..4), keys);
    assert_eq!(user.finish_uploads(&never()).records, 4);
    let (_c, third) = over(open);
    assert!(keys.iter().all(|key| third.is_hit(key).is_some()));
    for number in 0..4 {
        let bytes = if number % 2 == 0 { small(number) } else { large(number) };
        assert_eq!(third.get(&Digest::of(&bytes)).unwrap(), bytes);
    }
    // Records that are damaged are none.
    for name in names("records/") {
        backend.put(&name, b"damaged").unwrap();
    }
    assert!(keys.iter().all(|key| over(open).1.hit_outcome(key).is_none()));
}

/// What many write at once is all there.
pub fn takes_many_writers(open: Open) {
    std::thread::scope(|scope| {
        for writer in 0..6 {
            scope.spawn(move || {
                let (_folder, store) = over(open);
                // Each shares half of what it makes with the next.
                fill(&store, writer * 10..writer * 10 + 20);
                assert_eq!(store.finish_uploads(&never()).failed, 0);
            });
        }
    });
    let (_a, reader) = over(open);
    let (_b, reference) = new_store();
    for key in fill(&reference, 0..70) {
        assert!(reader.is_hit(&key).is_some());
    }
    reader.bring((0..70).map(|number| Digest::of(&small(number)))).unwrap();
}

/// Stores that share nothing but the place do each step once, and find what the others did.
pub fn shares_steps(open: Open) {
    const STEPS: u64 = 24;
    let done: Vec<AtomicU32> = (0..STEPS).map(|_| AtomicU32::new(0)).collect();
    let (_reference, reference) = new_store();
    let keys = fill(&reference, 0..STEPS);
    std::thread::scope(|scope| {
        for worker in 0..3 {
            let (done, keys) = (&done, &keys);
            scope.spawn(move || {
                let (_folder, store) = over(open);
                let mut open: Vec<u64> = (0..STEPS).map(|number| (number + worker * 8) % STEPS).collect();
                while !open.is_empty() {
                    open.retain(|number| {
                        let key = &keys[*number as usize];
                        let Some(_lock) = store.try_lock(key).unwrap() else { return true };
                        if store.hit_outcome(key).is_none() {
                            done[*number as usize].fetch_add(1, Ordering::Relaxed);
                            assert_eq!(fill(&store, *number..*number + 1), [*key]);
                        }
                        false
                    });
                    std::thread::sleep(std::time::Duration::from_millis(5));
                }
                assert_eq!(store.finish_uploads(&never()).failed, 0);
            });
        }
    });
    assert!(done.iter().all(|count| count.load(Ordering::Relaxed) == 1), "{done:?}");
    assert_eq!(open().list("workers/").unwrap(), [], "who has ended left nothing behind");
}

/// A collection removes what is old, puts batches together, and leaves the rest whole.
pub fn is_collected(open: Open) {
    for part in 0..3 {
        let (_folder, store) = over(open);
        fill(&store, part * 10..part * 10 + 10);
        store.finish_uploads(&never());
    }
    let stat = itself(open).stat().unwrap();
    assert_eq!((stat.records, stat.batches, stat.packs, stat.large_blobs, stat.incomplete), (30, 3, 3, 15, 0));
    let now = 1_000_000 + 100_000_000;
    let policy = RemoteGcPolicy { max_age_s: Some(now - 1_000_014), ..RemoteGcPolicy::default() };
    let planned = itself(open).collect(&RemoteGcPolicy { dry_run: true, ..policy }, now).unwrap();
    assert_eq!((planned.records, planned.kept_records), (15, 15));
    assert_eq!(itself(open).stat().unwrap(), stat, "nothing was touched");
    assert_eq!(itself(open).collect(&policy, now).unwrap(), planned);
    let stat = itself(open).stat().unwrap();
    assert_eq!((stat.records, stat.batches, stat.incomplete), (15, 1, 0));
    let (_folder, user) = over(open);
    let (_other, reference) = new_store();
    let keys = fill(&reference, 0..30);
    for (number, key) in keys.iter().enumerate() {
        assert_eq!(user.is_hit(key).is_some(), number >= 15, "{number}");
    }
    assert_eq!(user.get(&Digest::of(&large(29))).unwrap(), large(29));
    let all = itself(open).collect(&RemoteGcPolicy { max_bytes: Some(0), ..RemoteGcPolicy::default() }, now).unwrap();
    assert_eq!(all.kept_records, 0);
    assert!(itself(open).keys().is_empty());
}

/// The whole suite; every part has a place of its own.
pub fn run(new_place: &dyn Fn() -> Box<dyn Fn() -> Box<dyn Backend> + Sync>) {
    for part in [
        moves_bytes,
        has_one_winner,
        is_a_layer,
        survives_loss,
        takes_many_writers,
        shares_steps,
        is_collected,
        |open: Open| {
            carries_results(&open);
        },
    ] {
        let place = new_place();
        part(&*place);
    }
    let place = new_place();
    assert!(itself(&*place).honours_create().unwrap());
}
