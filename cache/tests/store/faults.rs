//! Power cuts: whatever part of the unsynced writes is lost or torn, nothing wrong is ever served, and what was synced
//! is there.

use std::fs;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, Store};

use crate::{blob_path, finish, new_store, recipe, segments};

/// Storage loses or keeps whole sectors of this size.
const SECTOR_BYTES: usize = 512;

/// The same sequence of numbers every time.
struct Draws(u64);

impl Draws {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

fn output(number: u64) -> Vec<u8> {
    let size = if number.is_multiple_of(4) { 70_000 } else { 200 + 37 * number };
    (0..size).map(|at| (at * (number + 3)) as u8).collect()
}

/// A store whose first three steps are durable and whose next five may or may not be, as it lies on disk.
struct Scene {
    folder: tempfile::TempDir,
    segment: PathBuf,
    bytes: Vec<u8>,
    synced: usize,
}

fn scene() -> Scene {
    let (folder, store) = new_store();
    (0..3).for_each(|number| drop(finish(&store, number, &output(number)).to_string()));
    store.sync().unwrap();
    let segment = segments(folder.path()).remove(0);
    let synced = fs::metadata(&segment).unwrap().len() as usize;
    (3..8).for_each(|number| drop(finish(&store, number, &output(number)).to_string()));
    let bytes = fs::read(&segment).unwrap();
    drop(store);
    Scene { folder, segment, bytes, synced }
}

/// Every record that is a hit must come with its very bytes; the durable ones must be hits, and all can be done again.
fn check(dir: &Path, context: &str) {
    let store = Store::open(dir).unwrap();
    for number in 0..8 {
        let key = recipe(number).key();
        match store.is_hit(&key) {
            Some(record) => match store.get(&record.outputs["mesh"].digest) {
                Ok(bytes) => assert!(bytes == output(number), "{context}: step {number} has other bytes"),
                // Looked whole and was not: found on reading, set aside, done again below.
                Err(error) => assert!(number >= 3, "{context}: durable step {number}: {error}"),
            },
            None => assert!(number >= 3, "{context}: durable step {number} is lost"),
        }
    }
    (0..8).for_each(|number| drop(finish(&store, number, &output(number)).to_string()));
    drop(store);
    let store = Store::open(dir).unwrap();
    for number in 0..8 {
        let record =
            store.is_hit(&recipe(number).key()).unwrap_or_else(|| panic!("{context}: {number} cannot be redone"));
        assert!(store.get(&record.outputs["mesh"].digest).unwrap() == output(number));
    }
    assert_eq!(store.verify(false).unwrap().faults, [], "{context}");
}

#[test]
fn whatever_sectors_a_power_cut_loses_nothing_wrong_is_served() {
    let scene = scene();
    let mut draws = Draws(7);
    for round in 0..60 {
        let mut bytes = scene.bytes.clone();
        let chance = 1 + draws.below(6);
        for start in (scene.synced..bytes.len()).step_by(SECTOR_BYTES) {
            let end = (start + SECTOR_BYTES).min(bytes.len());
            match draws.below(chance + 1) {
                0 => bytes[start..end].fill(0),
                // Half of a sector from before, where it was never written.
                1 if draws.below(4) == 0 => bytes[start..usize::midpoint(start, end)].fill(0xff),
                _ => {}
            }
        }
        bytes.truncate(
            bytes.len() - draws.below(2) as usize * draws.below((bytes.len() - scene.synced) as u64) as usize,
        );
        fs::write(&scene.segment, &bytes).unwrap();
        check(scene.folder.path(), &format!("round {round}"));
    }
}

#[test]
fn cut_off_after_any_byte_of_any_write_nothing_wrong_is_served() {
    let scene = scene();
    for size in (scene.synced..=scene.bytes.len()).step_by(127) {
        fs::write(&scene.segment, &scene.bytes[..size]).unwrap();
        check(scene.folder.path(), &format!("cut at {size}"));
    }
}

#[test]
fn large_blobs_that_a_power_cut_lost_emptied_or_tore_are_made_again() {
    let scene = scene();
    let path = blob_path(scene.folder.path(), &Digest::of(&output(4)));
    let restore = |bytes: Option<&[u8]>| {
        fs::write(&scene.segment, &scene.bytes).unwrap();
        let _ = fs::remove_file(&path);
        if let Some(bytes) = bytes {
            fs::write(&path, bytes).unwrap();
        }
    };
    let whole = output(4);
    for (bytes, context) in [
        (None, "lost"),
        (Some(&b""[..]), "emptied"),
        (Some(&whole[..1000]), "torn"),
        (Some(&vec![0; whole.len()][..]), "never written"),
    ] {
        restore(bytes);
        check(scene.folder.path(), context);
    }
}

#[test]
fn what_a_power_cut_tore_stays_out_when_later_writes_are_synced() {
    let scene = scene();
    let (mut bytes, torn) = (scene.bytes.clone(), output(5));
    let at = bytes.windows(torn.len()).position(|some| some == torn).unwrap();
    bytes[at + 10] ^= 1;
    fs::write(&scene.segment, &bytes).unwrap();
    let open = || Store::open(scene.folder.path()).unwrap();
    finish(&open(), 9, b"later");
    let store = open();
    assert!(!store.contains(&Digest::of(&torn)), "torn bytes count as a blob");
    assert!([2, 6, 9].iter().all(|number| store.is_hit(&recipe(*number).key()).is_some()));
    finish(&store, 5, &torn);
    drop(store);
    assert_eq!(open().verify(false).unwrap().faults, []);
    let store = open();
    store.collect(&store.plan_gc(&rockface_cache::GcPolicy::default()).unwrap()).unwrap();
    assert_eq!(segments(scene.folder.path()).len(), 1, "a collection writes the torn segment anew");
}
