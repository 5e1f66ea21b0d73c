//! Damage, torn tails, and writers that are killed.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use rockface_cache::{Digest, Store, StoreError};

use crate::{blob_path, finish, new_store, recipe, segments};

/// Set in the process that is to be killed: the store it writes to.
const VICTIM: &str = "ROCKFACE_CACHE_TEST_VICTIM";

#[test]
fn a_damaged_blob_is_set_aside_and_can_be_made_again() {
    for bytes in [b"a small blob".to_vec(), vec![7; 100_000]] {
        let (folder, store) = new_store();
        let key = finish(&store, 1, &bytes);
        store.sync().unwrap();
        damage(folder.path(), &bytes);
        let Err(StoreError::Damaged { moved_to, .. }) = store.get(&Digest::of(&bytes)) else {
            panic!("{} damaged bytes were accepted", bytes.len());
        };
        assert_eq!(fs::metadata(&moved_to).unwrap().len(), bytes.len() as u64);
        assert!(store.is_hit(&key).is_none());
        finish(&store, 1, &bytes);
        drop(store);
        let store = Store::open(folder.path()).unwrap();
        assert!(store.is_hit(&key).is_some() && store.get(&Digest::of(&bytes)).unwrap() == bytes);
    }
}

/// Changes the first byte of a blob where it lies on disk, and nothing else, not even the file's time.
fn damage(dir: &Path, blob: &[u8]) {
    let own = blob_path(dir, &Digest::of(blob));
    let path = if own.exists() { own } else { segments(dir).remove(0) };
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.windows(blob.len()).position(|some| some == blob).unwrap();
    bytes[at] ^= 1;
    let modified = fs::metadata(&path).unwrap().modified().unwrap();
    let mut permissions = fs::metadata(&path).unwrap().permissions();
    std::os::unix::fs::PermissionsExt::set_mode(&mut permissions, 0o644);
    fs::set_permissions(&path, permissions).unwrap();
    fs::write(&path, bytes).unwrap();
    fs::File::open(&path).unwrap().set_modified(modified).unwrap();
}

#[test]
fn a_segment_torn_anywhere_keeps_what_was_whole_and_goes_on() {
    let (folder, store) = new_store();
    let path = || segments(folder.path()).remove(0);
    let ends: Vec<u64> = (0..3)
        .map(|number| {
            finish(&store, number, &[number as u8]);
            fs::metadata(path()).unwrap().len()
        })
        .collect();
    drop(store);
    let whole = fs::read(path()).unwrap();
    for size in (0..=ends[2]).rev().step_by(7) {
        fs::write(path(), &whole[..size as usize]).unwrap();
        let store = Store::open(folder.path()).unwrap();
        let hits = (0..3).filter(|number| store.is_hit(&recipe(*number).key()).is_some()).count();
        assert_eq!(hits, ends.iter().filter(|end| **end <= size).count(), "torn at {size}");
        finish(&store, 9, b"after the tear");
        drop(store);
        let store = Store::open(folder.path()).unwrap();
        assert!(store.is_hit(&recipe(9).key()).is_some());
        assert_eq!(store.keys().len(), hits + 1, "torn at {size}");
        assert_eq!(segments(folder.path()).len(), 1);
    }
}

/// Not a test of its own: the process that the next test kills.
#[test]
fn victim() {
    let Some(dir) = std::env::var_os(VICTIM) else {
        return;
    };
    let store = Store::open(Path::new(&dir)).unwrap();
    for number in 0.. {
        let size = if number % 5 == 0 { 70_000 } else { 300 };
        let bytes: Vec<u8> = (0..size).map(|at: u64| (at * number) as u8).collect();
        let _held = store.lock(&recipe(number).key(), || ()).unwrap();
        finish(&store, number, &bytes);
        fs::write(Path::new(&dir).join("../finished"), number.to_string()).unwrap();
    }
}

#[test]
fn a_killed_writer_loses_nothing_finished_and_leaves_nothing_to_unlock() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("store");
    for delay_ms in [30, 47, 61, 83, 110] {
        let _ = fs::remove_file(folder.path().join("finished"));
        let mut child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "crash::victim"])
            .env(VICTIM, &dir)
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        await_file(&folder.path().join("finished"));
        std::thread::sleep(Duration::from_millis(delay_ms));
        child.kill().unwrap();
        child.wait().unwrap();
        // The killed process may have emptied this file and not yet filled it again: then it says nothing.
        let finished = fs::read_to_string(folder.path().join("finished")).unwrap().parse().unwrap_or(0);
        let store = Store::open(&dir).unwrap();
        for number in 0..=finished {
            let record = store.is_hit(&recipe(number).key()).unwrap_or_else(|| panic!("step {number} is lost"));
            store.get(&record.outputs["mesh"].digest).unwrap();
        }
        drop(store.lock(&recipe(finished + 1).key(), || panic!("a dead process holds a lock")).unwrap());
        assert_eq!(fs::read_dir(dir.join("tmp")).unwrap().count(), 0);
        assert_eq!(segments(&dir).len(), 1);
    }
}

fn await_file(path: &Path) {
    let started = Instant::now();
    while !path.exists() {
        assert!(started.elapsed() < Duration::from_secs(30), "the process to be killed never began");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn what_is_written_is_synced_within_moments_unasked() {
    let (folder, store) = new_store();
    finish(&store, 1, b"mesh");
    let size = || fs::metadata(&segments(folder.path())[0]).unwrap().len();
    // The background sync leaves a mark behind it in the segment.
    let (written, started) = (size(), Instant::now());
    while size() == written {
        assert!(started.elapsed() < Duration::from_secs(30), "never synced");
        std::thread::sleep(Duration::from_millis(20));
    }
    let marked = size();
    store.sync().unwrap();
    assert_eq!(size(), marked, "a sync with nothing new does nothing");
}
