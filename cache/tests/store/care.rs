//! Care: what verification lists and repairs, what a collection removes, and who may go on meanwhile.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::Duration;

use rockface_cache::{Digest, FaultKind, GcPolicy, SegmentFaultKind, Store, StoreError};

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
fn damage_inside_a_segment_is_listed_with_its_place_and_repair_writes_the_segment_anew() {
    let (folder, store) = new_store();
    let keys = [finish(&store, 1, b"one"), finish(&store, 2, b"two"), finish(&store, 3, b"three")];
    store.sync().unwrap();
    drop(store);
    let segment = segments(folder.path()).remove(0);
    let whole = fs::read(&segment).unwrap();
    let size = whole.len() as u64;
    let verified = |bytes: &[u8]| {
        fs::write(&segment, bytes).unwrap();
        let found = Store::open(folder.path()).unwrap().verify(false).unwrap();
        assert!(fs::read(&segment).unwrap() == bytes, "nothing is changed");
        found
    };
    let found = verified(&whole);
    assert_eq!((found.records, found.segment_faults, found.half_written), (3, vec![], vec![]));

    let found = verified(&whole[..whole.len() - 100]);
    assert_eq!((found.records, found.segment_faults), (2, vec![]), "a killed process leaves that");
    assert_eq!(found.half_written.iter().map(|tail| tail.at + tail.bytes).collect::<Vec<_>>(), [size - 100]);

    let found = verified(&[&whole[..], &[7; 5000]].concat());
    let told: Vec<_> = found.segment_faults.iter().map(|fault| (fault.kind, fault.at, fault.bytes)).collect();
    assert_eq!(told, [(SegmentFaultKind::Unreadable, size, 5000)]);

    let mut damaged = whole;
    let at = damaged.windows(10).position(|some| some == b"\"number\":2").unwrap();
    damaged[at + 1] ^= 1;
    let found = verified(&damaged);
    assert_eq!((found.records, found.faults.len(), found.segment_faults.len()), (2, 0, 1), "{found:?}");
    let fault = &found.segment_faults[0];
    assert!(fault.kind == SegmentFaultKind::Damaged && fault.at < at as u64 && fault.at + fault.bytes > at as u64);
    assert!(fault.lost.contains(&keys[1].short()) && fault.lost.contains("of remove-blocks"), "{}", fault.lost);

    let store = Store::open(folder.path()).unwrap();
    let repaired = store.verify(true).unwrap();
    assert!(repaired.rewritten && repaired.busy_segments == 0 && repaired.segment_faults.len() == 1);
    drop(store);
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(store.verify(false).unwrap().segment_faults, []);
    let hits: Vec<bool> = keys.iter().map(|key| store.is_hit(key).is_some()).collect();
    assert_eq!(hits, [true, false, true]);
}

#[test]
fn a_damaged_record_that_was_written_again_is_no_damage_any_more() {
    let (folder, store) = new_store();
    let key = finish(&store, 2, b"two");
    store.sync().unwrap();
    drop(store);
    let segment = segments(folder.path()).remove(0);
    let mut bytes = fs::read(&segment).unwrap();
    let at = bytes.windows(10).position(|some| some == b"\"number\":2").unwrap();
    bytes[at + 1] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let store = Store::open(folder.path()).unwrap();
    assert_eq!((store.is_hit(&key), store.verify(false).unwrap().segment_faults.len()), (None, 1));
    finish(&store, 2, b"two");
    assert!(store.is_hit(&key).is_some());
    assert_eq!(store.verify(false).unwrap().segment_faults, []);
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
    let torn = GcPolicy { torn_s: Some(1 << 40), ..at_once() };
    assert_eq!(store.plan_gc(&torn).unwrap().records, [], "the torn part of a manifest may name them");
    let aged = GcPolicy { max_age_s: Some(100), pinned: [keys[0]].into(), ..GcPolicy::default() };
    assert_eq!(store.plan_gc(&aged).unwrap().records.len(), 3, "the test's records say they are from 1970");
    let (_folder, store) = new_store();
    let one = finish(&store, 0, &large(0));
    let now =
        [(one, std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs() + 60)].into();
    let all = GcPolicy { max_age_s: Some(0), used: now, ..GcPolicy::default() };
    assert_eq!(store.plan_gc(&all).unwrap().records, [one], "an age of 0 spares nothing, not even by the second");
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
    store.memory().remember_run(&keys[0], &serde_json::json!("note")).unwrap();
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
    assert!(store.is_hit(&recipe(50).key()).is_some() && store.memory().recalled_run(&keys[0]).is_some());
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

/// Everything no run names may go, but for what is younger than an hour; the records of these tests are from 1970.
fn after_an_hour() -> GcPolicy {
    GcPolicy { unnamed: true, grace_s: 3600, ..GcPolicy::default() }
}

/// Makes a large blob look as if it had last been put two hours ago.
fn age(dir: &Path, digest: &Digest) {
    let file = fs::File::open(blob_path(dir, digest)).unwrap();
    let then = file.metadata().unwrap().modified().unwrap() - Duration::from_hours(2);
    file.set_modified(then).unwrap();
}

/// A store with one old record of one old large blob, which nobody has open.
fn aged_store() -> (tempfile::TempDir, Digest) {
    let (folder, store) = new_store();
    let key = finish(&store, 1, &large(1));
    age(folder.path(), &Digest::of(&large(1)));
    (folder, key)
}

#[test]
fn a_blob_that_is_put_again_stays_though_its_record_leaves() {
    for is_planned_before in [true, false] {
        let (folder, key) = aged_store();
        let open = || Store::open(folder.path()).unwrap();
        let (store, run) = (open(), open());
        let former = store.plan_gc(&after_an_hour()).unwrap();
        assert_eq!((former.records.len(), former.blobs.len()), (1, 1));
        let digest = run.put(&large(1)).unwrap();
        let plan = if is_planned_before { former } else { open().plan_gc(&after_an_hour()).unwrap() };
        assert_eq!(plan.blobs.len(), usize::from(is_planned_before));
        let collected = store.collect(&plan).unwrap();
        assert_eq!((collected.records, collected.blobs), (1, 0));
        run.commit(&record(2, &large(1), true)).unwrap();
        drop((store, run));
        let store = open();
        assert!(store.is_hit(&recipe(2).key()).is_some() && !store.has_record(&key));
        age(folder.path(), &digest);
        assert_eq!(store.collect(&store.plan_gc(&after_an_hour()).unwrap()).unwrap().blobs, 1);
    }
}

#[test]
fn collections_never_take_a_blob_from_under_a_run() {
    let (folder, _) = aged_store();
    let digest = Digest::of(&large(1));
    for number in 10..60 {
        age(folder.path(), &digest);
        let (store, run) = (Store::open(folder.path()).unwrap(), Store::open(folder.path()).unwrap());
        let mut made = record(number, &large(1), true);
        made.cost.finished_unix_s = std::time::UNIX_EPOCH.elapsed().unwrap().as_secs();
        std::thread::scope(|scope| {
            scope.spawn(|| store.collect(&store.plan_gc(&after_an_hour()).unwrap()).unwrap());
            run.put(&large(1)).unwrap();
            run.commit(&made).unwrap();
        });
        drop((store, run));
        assert!(Store::open(folder.path()).unwrap().is_hit(&recipe(number).key()).is_some(), "{number}");
    }
}

#[test]
fn blobs_that_records_in_a_busy_segment_name_stay_with_them() {
    let (folder, writer) = new_store();
    let key = finish(&writer, 1, &large(1));
    finish(&writer, 2, b"small");
    let store = Store::open(folder.path()).unwrap();
    for _ in 0..2 {
        let collected = store.collect(&store.plan_gc(&at_once()).unwrap()).unwrap();
        assert_eq!((collected.records, collected.blobs, collected.bytes), (0, 0, 0));
        assert_eq!((collected.busy_segments, collected.spared_records), (1, 2));
        assert_eq!(store.verify(false).unwrap().faults, []);
        assert!(store.is_hit(&key).is_some());
    }
    drop(writer);
    let collected = store.collect(&store.plan_gc(&at_once()).unwrap()).unwrap();
    assert_eq!((collected.records, collected.blobs, collected.spared_records), (2, 2, 0));
}

#[test]
fn no_superseded_record_comes_back_when_the_latest_would_leave() {
    let (folder, writer) = new_store();
    finish(&writer, 1, b"first");
    let other = Store::open(folder.path()).unwrap();
    finish(&other, 1, b"second");
    drop(other);
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(store.collect(&store.plan_gc(&at_once()).unwrap()).unwrap().spared_records, 1);
    drop((store, writer));
    let store = Store::open(folder.path()).unwrap();
    assert_eq!(store.is_hit(&recipe(1).key()).unwrap().outputs["mesh"], output(b"second", true));
}

#[test]
fn what_comes_to_be_used_between_plan_and_removal_stays() {
    let (folder, store) = new_store();
    let keys: Vec<Digest> = (0..3).map(|number| finish(&store, number, &large(number))).collect();
    drop(store);
    let open = || Store::open(folder.path()).unwrap();
    let (store, run) = (open(), open());
    let plan = store.plan_gc(&at_once()).unwrap();
    assert_eq!(plan.records.len(), 3);
    run.count_on(&[]).unwrap();
    let collected = store.collect(&plan).unwrap();
    assert_eq!((collected.records, collected.blobs, collected.spared_records), (0, 0, 3), "who knows what it looks up");
    run.count_on(&keys[..1]).unwrap();
    let collected = store.collect(&plan).unwrap();
    assert_eq!((collected.records, collected.spared_records), (2, 1));
    run.refresh().unwrap();
    let hits: Vec<bool> = keys.iter().map(|key| run.is_hit(key).is_some()).collect();
    assert_eq!(hits, [true, false, false]);
    drop(run);
    assert_eq!(store.collect(&store.plan_gc(&at_once()).unwrap()).unwrap().records, 1);
}

#[test]
fn a_record_written_after_the_plan_and_runs_that_came_and_went_are_no_loss() {
    let (folder, store) = new_store();
    let keys: Vec<Digest> = (0..2).map(|number| finish(&store, number, b"former")).collect();
    drop(store);
    let open = || Store::open(folder.path()).unwrap();
    let store = open();
    let plan = store.plan_gc(&at_once()).unwrap();
    finish(&open(), 1, b"latter");
    let collected = store.collect(&plan).unwrap();
    assert_eq!((collected.records, collected.spared_records), (1, 1));
    assert_eq!(open().is_hit(&keys[1]).unwrap().outputs["mesh"], output(b"latter", true));
    let plan = store.plan_gc(&at_once()).unwrap();
    open().memory().remember_run(&keys[0], &serde_json::json!({})).unwrap();
    assert_eq!(store.collect(&plan).unwrap().records, 0, "that run may have used it");
}

#[test]
fn a_run_that_begins_sees_what_a_collection_left() {
    let (folder, key) = aged_store();
    let (store, run) = (Store::open(folder.path()).unwrap(), Store::open(folder.path()).unwrap());
    store.collect(&store.plan_gc(&after_an_hour()).unwrap()).unwrap();
    assert!(run.has_record(&key), "as it was read");
    run.count_on(&[]).unwrap();
    assert!(!run.has_record(&key));
}

#[test]
fn a_blob_that_left_after_it_was_put_is_put_again() {
    let (folder, store) = new_store();
    let digest = store.put(&large(1)).unwrap();
    fs::remove_file(blob_path(folder.path(), &digest)).unwrap();
    let record = record(1, &large(1), true);
    assert!(store.commit(&record).unwrap_err().to_string().contains("put it first"));
    let key = store.parcel().commit_or(&record, || store.put(&large(1)).map(drop)).unwrap();
    assert!(store.is_hit(&key).is_some());
    let never = store.parcel().commit_or(&record, || -> Result<(), StoreError> { panic!("all is there") });
    assert_eq!(never.unwrap(), key);
}

#[test]
fn a_collection_by_root_leaves_all_files_to_the_owner_of_the_store() {
    if !rustix::process::geteuid().is_root() {
        println!("skipped: only root can give files to others");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    fs::set_permissions(root, std::os::unix::fs::PermissionsExt::from_mode(0o700)).unwrap();
    std::os::unix::fs::chown(root, Some(1), Some(1)).unwrap();
    let store = Store::open(root).unwrap();
    let kept = [finish(&store, 0, b"small"), finish(&store, 1, &large(1))];
    drop(store);
    let store = Store::open(root).unwrap();
    let policy = GcPolicy { pinned: kept.into(), ..at_once() };
    store.collect(&store.plan_gc(&policy).unwrap()).unwrap();
    let mut folders = vec![root.to_owned()];
    let mut files = 0;
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let (path, meta) = entry.map(|entry| (entry.path(), entry.metadata().unwrap())).unwrap();
            assert_eq!(std::os::unix::fs::MetadataExt::uid(&meta), 1, "{}", path.display());
            if meta.is_dir() { folders.push(path) } else { files += 1 }
        }
    }
    assert!(files > 3, "{files}");
}
