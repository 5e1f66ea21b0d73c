//! Care: what verification lists and repairs, what a collection removes, and who may go on meanwhile.

use std::collections::BTreeSet;
use std::fs;

use rockface_cache::{Digest, FaultKind, GcPolicy, Store};

use crate::{blob_path, finish, new_store, output, recipe, record, segments};

fn large(number: u64) -> Vec<u8> {
    vec![number as u8; 100_000 + number as usize]
}

/// Everything may go at once, however young.
fn at_once() -> GcPolicy {
    GcPolicy { unnamed: true, ..GcPolicy::default() }
}

#[test]
fn verification_lists_what_is_damaged_and_missing_and_repair_sets_it_aside() {
    let (folder, store) = new_store();
    let keys = [finish(&store, 1, b"small and whole"), finish(&store, 2, &large(2)), finish(&store, 3, &large(3))];
    finish(&store, 4, b"small and soon damaged");
    store.sync().unwrap();
    assert_eq!(store.verify(false).unwrap().faults, []);
    let path = blob_path(folder.path(), &Digest::of(&large(2)));
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    fs::write(&path, b"other bytes").unwrap();
    fs::remove_file(blob_path(folder.path(), &Digest::of(&large(3)))).unwrap();
    let segment = segments(folder.path()).remove(0);
    let mut bytes = fs::read(&segment).unwrap();
    let at = bytes.windows(14).position(|some| some == b"small and soon").unwrap();
    bytes[at] = b'S';
    fs::write(&segment, bytes).unwrap();
    for repair in [false, true] {
        let verified = store.verify(repair).unwrap();
        let kinds: Vec<_> = verified.faults.iter().map(|fault| (fault.kind, fault.set_aside)).collect();
        let count = |kind| kinds.iter().filter(|found| **found == kind).count();
        assert_eq!(count((FaultKind::Damaged, repair)), 2, "{verified:?}");
        assert_eq!(count((FaultKind::Missing, false)), 1);
        assert!(verified.faults.iter().all(|fault| fault.outputs == ["mesh of remove-blocks"]));
    }
    let left = store.verify(false).unwrap();
    assert!(left.faults.iter().all(|fault| fault.kind == FaultKind::Missing), "{left:?}");
    assert_eq!(store.stat().unwrap().quarantined, 2);
    assert!(store.is_hit(&keys[0]).is_some() && keys[1..].iter().all(|key| store.is_hit(key).is_none()));
}

#[test]
fn a_collection_keeps_what_is_pinned_named_or_young_and_says_what_goes() {
    let (_folder, store) = new_store();
    let keys: Vec<Digest> = (0..4).map(|number| finish(&store, number, &large(number))).collect();
    store.put(b"an orphan").unwrap();
    let young = store.plan_gc(&GcPolicy { grace_s: 3600, ..GcPolicy::default() }).unwrap();
    assert_eq!((young.blobs, young.records), (vec![], vec![]));
    std::thread::sleep(std::time::Duration::from_millis(1100));
    let policy = GcPolicy { pinned: [keys[0]].into(), used: [(keys[1], 5)].into(), ..at_once() };
    let plan = store.plan_gc(&policy).unwrap();
    assert_eq!(plan.records.iter().copied().collect::<BTreeSet<_>>(), [keys[2], keys[3]].into());
    let told: Vec<(&str, &str)> = plan.blobs.iter().map(|item| (item.what.as_str(), item.why.as_str())).collect();
    assert_eq!(told.iter().filter(|item| **item == ("mesh of remove-blocks", "no run names it")).count(), 2);
    assert_eq!(told.iter().filter(|item| item.1 == "no record names it").count(), 1, "{told:?}");
    assert_eq!((plan.kept_records, plan.kept_bytes), (2, 200_001));
    assert_eq!(store.plan_gc(&GcPolicy::default()).unwrap().records, [], "without a reason no record goes");
    let aged = GcPolicy { max_age_s: Some(100), pinned: [keys[0]].into(), ..GcPolicy::default() };
    assert_eq!(store.plan_gc(&aged).unwrap().records.len(), 3, "the test's records say they are from 1970");
}

#[test]
fn a_budget_lets_the_longest_unused_go_first_and_counts_shared_blobs_once() {
    let (_folder, store) = new_store();
    let keys: Vec<Digest> = (0..4).map(|number| finish(&store, number, &large(0))).collect();
    let other = finish(&store, 9, &large(9));
    let used = [(keys[0], 50), (keys[1], 40), (keys[2], 30), (keys[3], 20), (other, 60)].into();
    let plan = |max_bytes| {
        store
            .plan_gc(&GcPolicy { max_bytes: Some(max_bytes), used: Clone::clone(&used), ..GcPolicy::default() })
            .unwrap()
    };
    assert_eq!(plan(300_000).records, []);
    // Only once all four records of the shared blob go is there any room.
    assert_eq!(plan(150_000).records, [keys[3], keys[2], keys[1], keys[0]]);
    assert_eq!(plan(150_000).kept_bytes, 100_009);
}

#[test]
fn a_collection_writes_segments_anew_and_other_handles_go_on() {
    let (folder, store) = new_store();
    let keys: Vec<Digest> = (0..20).map(|number| finish(&store, number, &[number as u8; 3000])).collect();
    finish(&store, 30, &large(30));
    store.remember_run(&keys[0], &serde_json::json!("note")).unwrap();
    drop(store);
    let before: u64 = segments(folder.path()).iter().map(|path| fs::metadata(path).unwrap().len()).sum();
    let bystander = Store::open(folder.path()).unwrap();
    let store = Store::open(folder.path()).unwrap();
    let used = (0..5).map(|number| (keys[number], 1)).collect();
    let plan = store.plan_gc(&GcPolicy { used, ..at_once() }).unwrap();
    let collected = store.collect(&plan).unwrap();
    assert_eq!((collected.records, collected.blobs, collected.busy_segments), (16, 16, 0));
    let after: u64 = segments(folder.path()).iter().map(|path| fs::metadata(path).unwrap().len()).sum();
    assert!(after < before / 3 && !blob_path(folder.path(), &Digest::of(&large(30))).exists(), "{before} -> {after}");
    // Who had read the old segments finds what stayed, and misses what left.
    for (number, key) in keys.iter().enumerate() {
        let digest = Digest::of(&[number as u8; 3000]);
        assert_eq!(bystander.get(&digest).is_ok(), number < 5);
        assert_eq!(bystander.is_hit(key).is_some(), number < 5, "{number}");
    }
    finish(&bystander, 50, b"written afterwards");
    drop((store, bystander));
    let store = Store::open(folder.path()).unwrap();
    assert!(store.is_hit(&recipe(50).key()).is_some() && store.recalled_run(&keys[0]).is_some());
    assert_eq!(store.keys().len(), 6);
    assert_eq!(store.verify(false).unwrap().faults, []);
}

#[test]
fn a_segment_that_is_being_written_to_stays() {
    let (folder, writer) = new_store();
    let key = finish(&writer, 1, b"one");
    let store = Store::open(folder.path()).unwrap();
    let collected = store.collect(&store.plan_gc(&GcPolicy::default()).unwrap()).unwrap();
    assert_eq!(collected.busy_segments, 1);
    finish(&writer, 2, b"two");
    store.refresh().unwrap();
    assert!(store.is_hit(&key).is_some() && store.is_hit(&recipe(2).key()).is_some());
}

#[test]
fn what_was_superseded_stays_so_through_collections() {
    let (folder, store) = new_store();
    let superseded = record(1, b"first", true);
    store.put(b"first").unwrap();
    store.commit(&superseded).unwrap();
    finish(&store, 1, b"second");
    assert_eq!(store.record(&recipe(1).key()).unwrap().outputs["mesh"], output(b"second", true));
    drop(store);
    for _ in 0..3 {
        let store = Store::open(folder.path()).unwrap();
        store.collect(&store.plan_gc(&GcPolicy::default()).unwrap()).unwrap();
        drop(store);
        let store = Store::open(folder.path()).unwrap();
        assert_eq!(store.record(&recipe(1).key()).unwrap().outputs["mesh"], output(b"second", true));
        assert_eq!(store.get(&Digest::of(b"second")).unwrap(), b"second");
    }
}

#[test]
fn what_is_held_is_told_by_stage() {
    let (_folder, store) = new_store();
    finish(&store, 1, &large(1));
    finish(&store, 2, &large(1));
    finish(&store, 3, b"small");
    let stat = store.stat_by_stage();
    assert_eq!(stat.len(), 1);
    let found = (stat[0].stage.as_str(), stat[0].records, stat[0].blobs, stat[0].bytes, stat[0].wall_s);
    assert_eq!(found, ("remove-blocks", 3, 2, 100_006, 1.5));
}
