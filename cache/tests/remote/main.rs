//! The one suite for all places that results are kept in, run against those that need no server; and what a place that fails does.

mod suite;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use rockface_cache::remote::{Backend, BackendError, Folder, InMemory, Object, Remote, Use};
use rockface_cache::{Digest, Store};

use suite::{fill, finish, large, new_store, over, small};

/// A handle to a place in memory.
#[derive(Debug)]
struct Shared(Arc<InMemory>);

impl Backend for Shared {
    fn url(&self) -> &str {
        self.0.url()
    }
    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        self.0.get(name, limit)
    }
    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
        self.0.put(name, bytes)
    }
    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
        self.0.create(name, bytes)
    }
    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
        self.0.list(prefix)
    }
    fn delete(&self, name: &str) -> Result<(), BackendError> {
        self.0.delete(name)
    }
}

fn in_memory() -> (Arc<InMemory>, impl Fn() -> Box<dyn Backend> + Sync) {
    let place = Arc::new(InMemory::default());
    let own = Arc::clone(&place);
    (place, move || Box::new(Shared(Arc::clone(&own))) as Box<dyn Backend>)
}

#[test]
fn memory_is_a_place_for_results() {
    suite::run(&|| Box::new(in_memory().1));
}

#[test]
fn a_folder_is_a_place_for_results() {
    let root = tempfile::tempdir().unwrap();
    let count = std::sync::atomic::AtomicU32::new(0);
    suite::run(&|| {
        let folder = root.path().join(count.fetch_add(1, Ordering::Relaxed).to_string());
        Box::new(move || Box::new(Folder::new(&folder)) as Box<dyn Backend>)
    });
}

#[test]
fn another_local_store_carries_results_as_a_remote_place_does() {
    suite::carries_results(&new_store().1);
}

#[test]
fn a_place_that_goes_down_costs_one_warning_and_no_result() {
    let (place, open) = in_memory();
    let (_a, maker) = over(&open);
    let keys = fill(&maker, 0..20);
    maker.finish_uploads(&AtomicBool::new(false));
    let told = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&told);
    let (_b, user) = new_store();
    let warn = Box::new(move |text: &str| heard.lock().unwrap().push(text.to_owned()));
    drop(user.attach(Remote::open(open(), None, Use::Layer, warn).unwrap()));
    assert!(user.hit_outcome(&keys[1]).is_some());
    place.is_down.store(true, Ordering::Relaxed);
    for number in 0..20 {
        let bytes = if number % 2 == 0 { small(number) } else { large(number) };
        assert!(user.get(&Digest::of(&bytes)).is_err(), "it cannot be had");
    }
    assert!(user.remote().unwrap().is_off() && keys.iter().all(|key| user.hit_outcome(key).is_none()));
    let new = finish(&user, 1, &large(1), true);
    assert!(user.hit_outcome(&new).is_some());
    user.finish_uploads(&AtomicBool::new(false));
    let told = told.lock().unwrap();
    assert!(told.len() == 1 && told[0].contains("not used any more") && told[0].contains("it is down"), "{told:?}");
}

#[test]
fn a_place_that_is_down_when_it_is_opened_is_a_warning_for_a_layer_and_a_fault_for_a_command_on_it() {
    let (place, open) = in_memory();
    place.is_down.store(true, Ordering::Relaxed);
    assert!(suite::remote(&open, Use::Layer).unwrap().is_off());
    let fault = suite::remote(&open, Use::Itself).unwrap_err().to_string();
    assert!(fault.contains("memory:") && fault.contains("it is down") && fault.contains("network"), "{fault}");
}

#[test]
fn a_command_on_the_contents_of_a_place_makes_none() {
    let (place, open) = in_memory();
    let fault = suite::remote(&open, Use::Contents).unwrap_err().to_string();
    assert!(fault.contains("no store of rockface there") && place.objects().is_empty(), "{fault}");
    drop(suite::remote(&open, Use::Itself).unwrap());
    assert!(suite::remote(&open, Use::Contents).is_ok());
}

#[test]
fn another_format_is_refused_and_not_written_to() {
    let (place, open) = in_memory();
    place.objects().insert("format".to_owned(), (b"rockface remote 99\n".to_vec(), 0));
    let fault = suite::remote(&open, Use::Layer).unwrap_err().to_string();
    assert!(fault.contains("`rockface remote 99`") && fault.contains("`rockface remote 1`"), "{fault}");
    assert_eq!(place.objects().len(), 1);
}

#[test]
fn a_place_that_is_only_read_is_not_written_to() {
    let (place, open) = in_memory();
    let (_a, user) = new_store();
    let told = Arc::new(Mutex::new(Vec::new()));
    let heard = Arc::clone(&told);
    let warn = Box::new(move |text: &str| heard.lock().unwrap().push(text.to_owned()));
    drop(user.attach(Remote::open(open(), Some(user.dir()), Use::ReadOnlyLayer, warn).unwrap()));
    // A misspelt address looks like a place without results.
    assert!(matches!(&told.lock().unwrap()[..], [warning] if warning.contains("holds no results yet")));
    fill(&user, 0..3);
    assert_eq!(user.finish_uploads(&AtomicBool::new(false)).records, 0);
    assert!(place.objects().is_empty());
}

#[test]
fn records_are_written_after_their_blobs_however_the_writer_ends() {
    // The place goes down after each number of writes: what is there then is a whole prefix.
    #[derive(Debug)]
    struct Failing(Arc<InMemory>, std::sync::atomic::AtomicI32);
    impl Backend for Failing {
        fn url(&self) -> &str {
            self.0.url()
        }
        fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
            self.0.get(name, limit)
        }
        fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
            if self.1.fetch_sub(1, Ordering::Relaxed) <= 0 {
                return Err(BackendError::Unavailable("it is full".to_owned()));
            }
            self.0.put(name, bytes)
        }
        fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
            self.0.create(name, bytes)
        }
        fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
            self.0.list(prefix)
        }
        fn delete(&self, name: &str) -> Result<(), BackendError> {
            self.0.delete(name)
        }
    }
    let mut whole = 0;
    for writes in 1..12 {
        let (place, open) = in_memory();
        let (_a, maker) = new_store();
        let failing = Box::new(Failing(place, writes.into()));
        drop(maker.attach(Remote::open(failing, None, Use::Layer, Box::new(|_| ())).unwrap()));
        let keys = fill(&maker, 0..8);
        let done = maker.finish_uploads(&AtomicBool::new(false));
        assert!(done.records + done.failed == 8, "{done:?}");
        let (_b, user) = over(&open);
        let hits = keys.iter().filter(|key| user.hit_outcome(key).is_some()).count();
        assert_eq!(hits as u64, done.records);
        if hits > 0 {
            whole += 1;
            user.bring((0..8).map(|number| Digest::of(&if number % 2 == 0 { small(number) } else { large(number) })))
                .unwrap();
            user.adopt(keys.clone()).unwrap();
            let dir = user.dir().to_owned();
            drop(user);
            assert!(keys.iter().all(|key| Store::open(&dir).unwrap().is_hit(key).is_some()));
        }
    }
    assert!((1..11).contains(&whole));
}

#[test]
fn batches_are_fetched_once_by_a_store() {
    let (_place, open) = in_memory();
    let (_a, maker) = over(&open);
    fill(&maker, 0..4);
    maker.finish_uploads(&AtomicBool::new(false));
    let (_b, user) = new_store();
    let opened = || Remote::open(open(), Some(user.dir()), Use::ReadOnlyLayer, Box::new(|_| ())).unwrap();
    let (first, second) = (opened(), opened());
    assert_eq!((first.traffic().reads, second.traffic().reads), (2, 1), "the format, and the batch the first time");
    assert_eq!(second.keys().len(), 4);
}
