//! What collections keep for the sake of runs, wherever their folders are and whatever became of them.

use std::fs;
use std::path::{Path, PathBuf};

use rockface_cache::{RunNote, Store};
use serde_json::Value;

use crate::cli::{House, SMALL};

/// `SMALL` with a step that fails.
fn failing() -> String {
    format!(
        "{SMALL}  bad:\n    stage: command\n    with: {{program: \"false\", outputs: {{list: file}}, version: \"1\"}}\n"
    )
}

/// A house with a store `shared` in which the records of `SMALL` are two hours old, so that no collection spares them for their age; its
/// runs go to `elsewhere/runs`.
fn aged(yaml: &str) -> House {
    let house = House::new(yaml);
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--target", "dem", "--store", "new"]);
    assert_eq!(code, Some(0), "{err}");
    let (new, shared) = (Store::open(&house.path("new")).unwrap(), Store::open(&house.path("shared")).unwrap());
    for key in new.keys() {
        let mut record = new.record(&key).unwrap();
        record.cost.finished_unix_s -= 7200;
        for (blob, _) in record.blobs() {
            shared.put(&new.get(&blob).unwrap()).unwrap();
        }
        shared.commit(&record).unwrap();
    }
    drop(new);
    for folder in ["new", ".rockface"] {
        fs::remove_dir_all(house.path(folder)).unwrap();
    }
    house
}

/// Runs the pipeline with results in `shared`; returns the run folder.
fn run(house: &House, expected: i32) -> PathBuf {
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--store", "shared", "--runs", "elsewhere/runs"]);
    assert_eq!(code, Some(expected), "{err}");
    house.path("elsewhere/runs/latest").canonicalize().unwrap()
}

/// How many records a collection removes, and what it says of them. Nothing is removed: what the next one sees is the same.
fn unnamed(house: &House) -> (usize, String) {
    let (code, out, err) = house.rockface(&["store", "gc", "--store", "shared", "--unnamed", "--dry-run", "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let plan: Value = serde_json::from_str(&out).unwrap();
    (plan["records"].as_array().unwrap().len(), err)
}

fn pin(house: &House, verb: &str, folder: &Path) -> String {
    let (code, out, err) = house.rockface(&["runs", verb, folder.to_str().unwrap(), "--store", "shared"]);
    assert_eq!((code, err.as_str()), (Some(0), ""), "{out}");
    out
}

#[test]
fn what_a_failed_run_names_stays_while_its_folder_is_there() {
    let house = aged(&failing());
    assert_eq!(unnamed(&house).0, 2);
    let folder = run(&house, 1);
    assert_eq!(unnamed(&house), (0, String::new()));
    let (code, out, err) = house.rockface(&["store", "gc", "--store", "shared", "--unnamed"]);
    assert!(code == Some(0) && out.starts_with("removed 0 records"), "{out}{err}");
    fs::remove_dir_all(folder).unwrap();
    assert_eq!(unnamed(&house), (2, String::new()));
}

#[test]
fn a_pinned_failed_run_is_kept_wherever_its_folder_is() {
    let house = aged(&failing());
    let folder = run(&house, 1);
    fs::create_dir(house.path("moved")).unwrap();
    let moved = house.path("moved").canonicalize().unwrap().join(folder.file_name().unwrap());
    fs::rename(&folder, &moved).unwrap();
    assert_eq!(unnamed(&house).0, 2, "nobody knows where it went");
    pin(&house, "pin", &moved);
    assert_eq!(unnamed(&house), (0, String::new()));
    // Taken away with its disk, and pinned where it is then.
    let disk = house.path("disk");
    fs::rename(house.path("moved"), &disk).unwrap();
    let (count, err) = unnamed(&house);
    assert!(count == 0 && err.contains(moved.to_str().unwrap()) && err.contains("2 records"), "{err}");
    let there = disk.canonicalize().unwrap().join(folder.file_name().unwrap());
    pin(&house, "pin", &there);
    assert_eq!(unnamed(&house), (0, String::new()), "the one that was moved is not missed");
    pin(&house, "unpin", &there);
    fs::remove_dir_all(&disk).unwrap();
    assert_eq!(unnamed(&house), (2, String::new()));
}

#[test]
fn the_pin_of_a_run_whose_folder_is_gone_can_be_removed() {
    let house = aged(SMALL);
    let folder = run(&house, 0);
    pin(&house, "pin", &folder);
    fs::remove_dir_all(&folder).unwrap();
    let (count, err) = unnamed(&house);
    assert!(count == 0 && err.contains("runs unpin") && err.contains(folder.to_str().unwrap()), "{err}");
    let told = pin(&house, "unpin", &folder);
    assert!(told.contains("no longer pinned; its folder is not there"), "{told}");
    assert_eq!(unnamed(&house), (2, String::new()));
}

#[test]
fn two_runs_of_one_pipeline_are_both_known() {
    let house = aged(SMALL);
    let first = run(&house, 0);
    pin(&house, "pin", &first);
    fs::remove_dir_all(first.join("outputs")).unwrap();
    let second = run(&house, 0);
    assert_ne!(first, second);
    fs::remove_dir_all(second).unwrap();
    assert_eq!(unnamed(&house), (0, String::new()));
    fs::remove_dir_all(&first).unwrap();
    let (count, err) = unnamed(&house);
    assert!(count == 0 && err.contains(first.to_str().unwrap()), "{err}");
}

#[test]
fn a_pin_that_no_store_can_note_says_so() {
    let house = aged(SMALL);
    let folder = run(&house, 0);
    fs::remove_dir_all(house.path("shared")).unwrap();
    let (code, out, err) = house.rockface(&["runs", "pin", folder.to_str().unwrap()]);
    assert!(code == Some(0) && out.contains("is pinned"), "{out}{err}");
    assert!(err.contains("was not found") && err.contains("--store"), "{err}");
}

#[test]
fn what_a_run_names_whose_folder_may_not_be_read_is_kept() {
    let house = aged(SMALL);
    let folder = run(&house, 0);
    // A manifest that the system refuses to open, to root too.
    let shut = |manifest: &Path| {
        let _ = fs::remove_file(manifest);
        std::os::unix::fs::symlink("run.json", manifest).unwrap();
    };
    shut(&folder.join("run.json"));
    let (count, err) = unnamed(&house);
    assert!(count == 0 && err.contains(folder.to_str().unwrap()) && err.contains("2 records"), "{err}");
    // Of this one the store knows nothing.
    let other = house.path("others/runs/one");
    fs::create_dir_all(&other).unwrap();
    shut(&other.join("run.json"));
    let gc = |more: &[&str]| {
        house.rockface(&[&["store", "gc", "--store", "shared", "--runs", "others/runs"], more].concat())
    };
    let (code, _, err) = gc(&["--unnamed"]);
    assert!(code == Some(3) && err.contains("others/runs/one/run.json"), "{err}");
    let (code, out, err) = gc(&[]);
    assert!(code == Some(0) && out.starts_with("removed 0 records") && err.contains("others/runs/one"), "{out}{err}");
}

#[test]
fn a_run_folder_with_two_paths_has_one_pin() {
    let house = aged(SMALL);
    let folder = run(&house, 0);
    std::os::unix::fs::symlink(house.path("elsewhere").canonicalize().unwrap(), house.path("other")).unwrap();
    let beside = house.path("other/runs").join(folder.file_name().unwrap());
    pin(&house, "pin", &folder);
    pin(&house, "unpin", &beside);
    fs::remove_dir_all(&folder).unwrap();
    assert_eq!(unnamed(&house), (2, String::new()));
}

#[test]
fn a_pin_is_noted_where_results_of_the_run_are() {
    let house = aged(SMALL);
    let folder = run(&house, 0);
    drop(Store::open(&house.path("empty")).unwrap());
    let noted = |store: &str| Store::open(&house.path(store)).unwrap().memory().noted_folder(&folder);
    let (code, out, err) = house.rockface(&["runs", "pin", folder.to_str().unwrap(), "--store", "empty"]);
    assert!(code == Some(0) && err.is_empty(), "{out}{err}");
    assert!(noted("empty").is_none() && noted("shared").unwrap().pinned);
    fs::remove_dir_all(house.path("shared")).unwrap();
    let (code, _, err) = house.rockface(&["runs", "pin", folder.to_str().unwrap(), "--store", "empty"]);
    assert!(code == Some(0) && err.contains("was not found"), "{err}");
}

#[test]
fn a_pin_that_no_note_tells_of_is_noted_by_a_collection() {
    let house = aged(SMALL);
    let folder = run(&house, 0);
    fs::write(folder.join("pinned"), "").unwrap();
    let is_noted = || Store::open(&house.path("shared")).unwrap().memory().noted_folder(&folder).unwrap().pinned;
    assert_eq!(unnamed(&house), (0, String::new()));
    assert!(!is_noted(), "a dry run changes nothing");
    let (code, out, err) = house.rockface(&["store", "gc", "--store", "shared", "--unnamed"]);
    assert!(code == Some(0) && out.starts_with("removed 0 records"), "{out}{err}");
    assert!(is_noted());
    fs::remove_dir_all(&folder).unwrap();
    assert_eq!(unnamed(&house).0, 0);
}

#[test]
fn old_notes_on_folders_that_are_gone_leave_with_a_collection() {
    let house = aged(SMALL);
    let store = Store::open(&house.path("shared")).unwrap();
    let (key, day) = (store.keys()[0], 86_400);
    let now = std::time::UNIX_EPOCH.elapsed().unwrap().as_secs();
    for (name, keys, days, pinned) in [
        ("/gone/old", vec![], 40, false),
        ("/gone/named", vec![key], 40, false),
        ("/gone/pinned", vec![], 40, true),
        ("/gone/young", vec![], 20, false),
    ] {
        let note = RunNote::new(Path::new(name), keys, now - days * day, pinned);
        assert!(store.memory().note_folder(&note).unwrap());
    }
    let there = house.path("there").canonicalize().unwrap_or_else(|_| house.path("there"));
    fs::create_dir_all(&there).unwrap();
    fs::write(there.join("run.json"), "{").unwrap();
    store.memory().note_folder(&RunNote::new(&there, [], now - 40 * day, false)).unwrap();
    drop(store);
    let noted = || -> Vec<String> {
        let notes = Store::open(&house.path("shared")).unwrap().memory().noted_folders();
        notes.iter().map(|note| note.folder.file_name().unwrap().to_str().unwrap().to_owned()).collect()
    };
    let gc = |more: &[&str]| {
        let (code, _, err) = house.rockface(&[&["store", "gc", "--store", "shared"], more].concat());
        assert_eq!(code, Some(0), "{err}");
    };
    gc(&["--dry-run"]);
    assert_eq!(noted().len(), 5);
    gc(&[]);
    assert_eq!(noted(), ["named", "pinned", "young", "there"]);
    // What only it names leaves too.
    gc(&["--unnamed"]);
    assert_eq!(noted(), ["pinned", "young", "there"]);
}

#[test]
fn notes_by_the_key_of_a_plan_leave_with_their_folders() {
    let house = aged(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml", "--target", "dem", "--store", "shared"]).0, Some(0));
    let run_folders = || -> Vec<String> {
        let store = Store::open(&house.path("shared")).unwrap();
        let of_folders: Vec<_> = store.memory().noted_folders().iter().map(RunNote::name).collect();
        let notes = store.memory().recalled_runs().into_iter().filter(|(key, _)| !of_folders.contains(key));
        notes.map(|(_, note)| note["folder"].as_str().unwrap().to_owned()).collect()
    };
    let there = run_folders();
    assert_eq!(there.len(), 1, "that of the run");
    let store = Store::open(&house.path("shared")).unwrap();
    let gone = serde_json::json!({"folder": "/gone/for/good", "headlines": []});
    store.memory().remember_run(&rockface_cache::Digest::of(b"a plan"), &gone).unwrap();
    drop(store);
    assert_eq!(run_folders().len(), 2);
    assert_eq!(house.rockface(&["store", "gc", "--store", "shared"]).0, Some(0));
    assert_eq!(run_folders(), there);
}
