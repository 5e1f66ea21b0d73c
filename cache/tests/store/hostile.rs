//! Strangers: what somebody who may write to a store cannot make it do.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, GcPolicy, Store, StoreError};

use crate::{blob_path, finish, new_store, output, recipe, record};

/// A record as it lies in a segment, made by hand: under this key, with this recipe and outcome.
fn forge(dir: &Path, key: &Digest, recipe: &str, outcome: &str) {
    let payload = [&(recipe.len() as u32).to_le_bytes(), recipe.as_bytes(), outcome.as_bytes()].concat();
    let stamp = std::time::UNIX_EPOCH.elapsed().unwrap().as_nanos() as u64;
    let mut frame = b"RFS1\x02\0\0\0".to_vec();
    frame.extend((payload.len() as u32).to_le_bytes());
    frame.extend([0; 4]);
    frame.extend(stamp.to_le_bytes());
    frame.extend(key.as_bytes());
    frame.extend(&Digest::of(&payload).as_bytes()[..16]);
    let check = Digest::of(&frame);
    frame.extend(&check.as_bytes()[..8]);
    frame.extend(payload);
    fs::write(dir.join("segments").join(format!("{stamp:016x}-forged.seg")), frame).unwrap();
}

fn outcome(port: &str, bytes: &[u8]) -> String {
    let output = serde_json::json!({"kind": "mesh", "digest": Digest::of(bytes), "bytes": bytes.len(), "kept": true});
    let cost = serde_json::json!({"wall_s": 1.0, "cpu_s": 1.0, "peak_bytes": 1, "finished_unix_s": 1});
    serde_json::json!({"outputs": {port: output}, "log": null, "cost": cost}).to_string()
}

/// A folder that belongs to somebody, with a file in it.
fn home(place: &Path) -> PathBuf {
    let home = place.join("home");
    fs::create_dir(&home).unwrap();
    fs::write(home.join("letter"), "mine").unwrap();
    home
}

fn check_untouched(home: &Path) {
    assert_eq!(fs::read_to_string(home.join("letter")).unwrap(), "mine");
    assert_eq!(fs::read_dir(home).unwrap().count(), 1);
}

#[test]
fn a_record_whose_ports_lead_elsewhere_is_none_and_is_not_handed_on() {
    let (folder, store) = new_store();
    store.put(b"bytes").unwrap();
    for (number, port) in ["../../planted", "/planted", "a/b", "..", "planted\n"].into_iter().enumerate() {
        let recipe = recipe(number as u64);
        forge(folder.path(), &recipe.key(), &recipe.text(), &outcome(port, b"bytes"));
        store.refresh().unwrap();
        assert!(store.is_hit(&recipe.key()).is_none() && store.hit_outcome(&recipe.key()).is_none(), "{port}");
        let (_other_folder, other) = new_store();
        let handed = store.hand_to(&other, &[recipe.key()]).unwrap();
        assert_eq!((handed.records, handed.missing), (0, 1), "{port}");
        // The step can be done, and what it made counts from then on.
        assert_eq!(finish(&store, number as u64, b"bytes"), recipe.key());
        assert!(store.is_hit(&recipe.key()).is_some());
    }
}

#[test]
fn a_record_under_a_key_that_is_not_its_own_is_none() {
    let (folder, store) = new_store();
    store.put(b"bytes").unwrap();
    let (key, other) = (recipe(1).key(), recipe(2));
    forge(folder.path(), &key, &other.text(), &outcome("mesh", b"bytes"));
    store.refresh().unwrap();
    assert!(store.record(&key).is_none() && store.recipe_text(&key).is_none());
    forge(folder.path(), &other.key(), &other.text(), &outcome("mesh", b"bytes"));
    store.refresh().unwrap();
    assert!(store.record(&other.key()).is_some(), "what is forged well is a record like any other");
}

#[test]
fn sizes_nobody_could_have_written_do_no_harm() {
    let (folder, store) = new_store();
    for (number, size) in [(1, "1125899906842624"), (2, "18446744073709551615"), (3, "-1"), (4, "1e400")] {
        let recipe = recipe(number);
        let text = outcome("mesh", b"bytes").replace("\"bytes\":5", &format!("\"bytes\":{size}"));
        forge(folder.path(), &recipe.key(), &recipe.text(), &text);
    }
    store.refresh().unwrap();
    for policy in [GcPolicy { max_bytes: Some(10), ..GcPolicy::default() }, GcPolicy::default()] {
        store.plan_gc(&policy).unwrap();
    }
    store.stat_by_stage();
    assert!((1..5).all(|number| store.is_hit(&recipe(number).key()).is_none()));
}

#[test]
fn links_in_a_store_are_not_followed() {
    let (folder, store) = new_store();
    let home = home(folder.path());
    let bytes = vec![1; 100_000];
    let path = blob_path(folder.path(), &Digest::of(&bytes));
    symlink(&home, path.parent().unwrap()).unwrap();
    let fault = store.put(&bytes).unwrap_err();
    assert!(matches!(&fault, StoreError::Foreign { path: told } if told == path.parent().unwrap()), "{fault}");
    check_untouched(&home);
    fs::remove_file(path.parent().unwrap()).unwrap();
    let segment = folder.path().join("segments/0-planted.seg");
    symlink(home.join("letter"), &segment).unwrap();
    assert!(Store::open(folder.path()).is_err() && store.put(b"small").is_err());
    check_untouched(&home);
    fs::remove_file(segment).unwrap();
    fs::remove_file(folder.path().join("keys.lock")).unwrap_or_default();
    symlink(home.join("new"), folder.path().join("keys.lock")).unwrap();
    assert!(store.try_lock(&Digest::of(b"key")).is_err());
    check_untouched(&home);
}

#[test]
fn whatever_stands_in_the_place_of_a_blob_is_set_aside() {
    let (folder, store) = new_store();
    let bytes = vec![2; 100_000];
    let key = finish(&store, 1, &bytes);
    let path = blob_path(folder.path(), &Digest::of(&bytes));
    let home = home(folder.path());
    for stand_in in ["link", "folder", "pipe"] {
        fs::remove_file(&path).unwrap();
        match stand_in {
            "link" => symlink(home.join("letter"), &path).unwrap(),
            "folder" => fs::create_dir_all(path.join("inside")).unwrap(),
            _ => assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success()),
        }
        assert!(store.is_hit(&key).is_none(), "{stand_in}");
        assert!(matches!(store.get(&Digest::of(&bytes)), Err(StoreError::Missing { .. })), "{stand_in}");
        assert_eq!(store.put(&bytes).unwrap(), Digest::of(&bytes));
        assert!(store.is_hit(&key).is_some() && store.verify(false).unwrap().faults.is_empty());
    }
    check_untouched(&home);
    store.collect(&store.plan_gc(&GcPolicy::default()).unwrap()).unwrap();
    assert_eq!(store.stat().unwrap().quarantined, 0);
}

#[test]
fn pipes_among_locked_files_are_not_waited_for() {
    let (folder, store) = new_store();
    for place in ["live/run-pipe", "tmp/blob-pipe", "scratch/run-pipe.lock"] {
        let made = std::process::Command::new("mkfifo").arg(folder.path().join(place)).status().unwrap();
        assert!(made.success());
    }
    assert!(Store::open(folder.path()).is_ok());
    assert_eq!(store.live().unwrap().count, 0);
}

#[test]
fn a_store_is_not_blocked_by_a_blob_of_the_wrong_size() {
    let (folder, store) = new_store();
    let bytes = vec![3; 100_000];
    let key = finish(&store, 1, &bytes);
    let path = blob_path(folder.path(), &Digest::of(&bytes));
    let sealed = fs::metadata(&path).unwrap().modified().unwrap();
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    let file = fs::File::options().write(true).open(&path).unwrap();
    file.set_len(70_000).unwrap();
    file.set_modified(sealed).unwrap();
    let other = Store::open(folder.path()).unwrap();
    assert!(other.is_hit(&key).is_none());
    assert_eq!(other.take_damaged().len(), 1, "it is told of");
    assert_eq!(finish(&other, 1, &bytes), key);
    assert!(other.is_hit(&key).is_some());
}

#[test]
fn what_is_linked_has_been_read() {
    let (folder, store) = new_store();
    let bytes = vec![4; 3 << 20];
    store.put(&bytes).unwrap();
    drop(store);
    let path = blob_path(folder.path(), &Digest::of(&bytes));
    let sealed = fs::metadata(&path).unwrap().modified().unwrap();
    fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    let file = fs::File::options().write(true).open(&path).unwrap();
    std::os::unix::fs::FileExt::write_all_at(&file, &[5], 2 << 20).unwrap();
    file.set_modified(sealed).unwrap();
    let (store, to) = (Store::open(folder.path()).unwrap(), folder.path().join("linked"));
    assert!(store.contains(&Digest::of(&bytes)), "it looks whole");
    assert!(matches!(store.materialise(&Digest::of(&bytes), &to), Err(StoreError::Damaged { .. })));
    assert!(!to.exists() && !store.contains(&Digest::of(&bytes)));
    let record = record(9, &bytes, true);
    assert_eq!(record.outputs["mesh"], output(&bytes, true));
    assert!(store.commit(&record).is_err(), "until it is put again");
}
