//! Care of the store from the command line, and the way around runs in which nothing is to be done.

use std::fs;

use serde_json::Value;

use crate::cli::{House, SMALL, damage, last_line};

/// A pipeline of numbers from a file, so that inputs can change.
fn aged(house: &House) {
    let file = fs::File::open(house.path("p.yaml")).unwrap();
    file.set_modified(std::time::SystemTime::now() - std::time::Duration::from_mins(1)).unwrap();
}

fn answers(house: &House) -> usize {
    fs::read_dir(house.path(".rockface/store/answers")).map_or(0, Iterator::count)
}

#[test]
fn a_run_of_hits_is_answered_without_the_store_and_never_wrongly() {
    let house = House::new(SMALL);
    aged(&house);
    let run = |expected: &str| {
        let (code, out, err) = house.rockface(&["run", "p.yaml"]);
        assert_eq!(code, Some(0), "{err}");
        assert!(last_line(&out).contains(expected), "{out}");
        out.lines().filter(|line| !line.starts_with("done")).map(str::to_owned).collect::<Vec<_>>()
    };
    let first = run("ran 2, cached 0");
    assert_eq!(answers(&house), 1);
    assert_eq!(run("ran 0, cached 2"), first, "the same files and headlines are named");
    // A store nobody can read would be noticed by whoever opens it: the answer does not.
    let mode = |mode| {
        fs::set_permissions(house.path(".rockface/store/tmp"), std::os::unix::fs::PermissionsExt::from_mode(mode))
    };
    mode(0o000).unwrap();
    assert_eq!(run("ran 0, cached 2"), first);
    mode(0o755).unwrap();
    // Whatever is gone or different is found out.
    fs::write(house.path("p.yaml"), SMALL.replace("cell_m: 0.05", "cell_m: 0.1")).unwrap();
    run("ran 1, cached 1");
    fs::write(house.path("p.yaml"), SMALL).unwrap();
    run("ran 0, cached 2");
    fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
    run("ran 0, cached 2");
    assert!(house.path(".rockface/runs/latest/run.json").is_file());
    fs::remove_dir_all(house.path(".rockface/runs/latest/outputs")).unwrap();
    run("ran 0, cached 2");
    assert!(house.path(".rockface/runs/latest/outputs").is_dir(), "deleted outputs are put back");
    fs::remove_dir_all(house.path(".rockface/store/segments")).unwrap();
    run("ran 2, cached 0");
}

#[test]
fn an_input_that_changed_is_never_answered_for() {
    let house = House::new("rockface: 1\nsteps: {face: {stage: import-mesh, with: {path: face.ply}}}\n");
    let ply = |z: u32| {
        let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n";
        format!(
            "{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 {z}\n3 0 1 2\n"
        )
    };
    let write = |z: u32, age_s: u64| {
        fs::write(house.path("face.ply"), ply(z)).unwrap();
        let modified = std::time::SystemTime::now() - std::time::Duration::from_secs(age_s);
        fs::File::options().write(true).open(house.path("face.ply")).unwrap().set_modified(modified).unwrap();
    };
    let run = |expected: &str| {
        let (code, out, err) = house.rockface(&["run", "p.yaml"]);
        assert_eq!(code, Some(0), "{err}");
        assert!(last_line(&out).contains(expected), "{out}");
    };
    write(1, 60);
    run("ran 1");
    run("ran 0");
    // The same size and the same time: its change time tells.
    write(2, 60);
    run("ran 1");
    run("ran 0");
    write(1, 90);
    run("ran 0");
    write(3, 0);
    run("ran 1");
    write(4, 0);
    run("ran 1");
}

#[test]
fn a_link_that_begins_to_lead_somewhere_is_noticed() {
    let house = House::new("rockface: 1\nsteps: {blocks: {stage: import-blocks, with: {path: \"d/*.ply\"}}}\n");
    let tetrahedron = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
        element face 4\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n\
        3 1 2 3\n3 0 3 2\n";
    fs::create_dir(house.path("d")).unwrap();
    fs::write(house.path("d/a.ply"), tetrahedron).unwrap();
    std::os::unix::fs::symlink("../later.ply", house.path("d/b.ply")).unwrap();
    let long_ago = std::time::SystemTime::now() - std::time::Duration::from_mins(1);
    for name in ["d", "d/a.ply", "p.yaml"] {
        fs::File::open(house.path(name)).unwrap().set_modified(long_ago).unwrap();
    }
    let run = |expected: &str| {
        let (code, out, err) = house.rockface(&["run", "p.yaml"]);
        assert!(code == Some(0) && last_line(&out).contains(expected), "{out}{err}");
    };
    run("ran 1");
    run("ran 0");
    // Elsewhere on the face: no two blocks may be the same.
    fs::write(house.path("later.ply"), tetrahedron.replace("\n0 0 1\n", "\n0 0 2\n")).unwrap();
    run("ran 1");
}

#[test]
fn damage_is_listed_set_aside_and_made_again() {
    let house = House::new(&SMALL.replace("width_m: 2,", "width_m: 40,"));
    house.rockface(&["run", "p.yaml"]);
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert!(code == Some(0) && out.contains("all whole"), "{out}");
    fs::remove_dir_all(house.path(".rockface/runs")).unwrap();
    assert_eq!(damage(&house.path(".rockface/store/blobs"), b"element vertex"), 1);
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert!(code == Some(3) && out.contains("damaged") && out.contains("mesh of synthesise-face"), "{out}");
    let (code, out, _) = house.rockface(&["store", "verify", "--repair", "--json"]);
    let found: Value = serde_json::from_str(&out).unwrap();
    assert!(code == Some(0) && found["faults"][0]["set_aside"] == true, "{out}");
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(last_line(&out).contains("ran 1, cached 1"), "{out}");
    let (code, _, _) = house.rockface(&["store", "verify"]);
    assert_eq!(code, Some(0));
}

#[test]
fn a_damaged_record_is_listed_and_its_step_runs_again() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml"]);
    assert_eq!(damage(&house.path(".rockface/store/segments"), b"spacing_m\":0.05"), 1);
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert!(code == Some(3) && out.contains("damaged  segment") && out.contains("of synthesise-face"), "{out}");
    assert!(last_line(&out).contains("1 damaged places in segments; `rockface store verify --repair`"), "{out}");
    let (code, out, _) = house.rockface(&["store", "verify", "--repair"]);
    assert!(code == Some(0) && out.contains("the segments were written anew"), "{out}");
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert!(code == Some(0) && out.contains("1 records: all whole"), "{out}");
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    assert!(code == Some(0) && last_line(&out).contains("ran 1, cached 1"), "{out}{err}");
}

#[test]
fn a_collection_spares_pinned_runs_and_explains_itself() {
    let house = House::new(SMALL);
    for cell in ["0.05", "0.1", "0.2"] {
        house.rockface(&["run", "p.yaml", "--set", &format!("steps.dem.with.cell_m={cell}")]);
        if cell == "0.1" {
            let (code, out, _) = house.rockface(&["runs", "pin", "latest"]);
            assert!(code == Some(0) && out.contains("pinned"), "{out}");
        }
    }
    let gc = ["store", "gc", "--max-age", "0", "--dry-run"];
    let (code, out, _) = house.rockface(&gc);
    assert_eq!(code, Some(0));
    assert!(last_line(&out).contains("0 records and 0 blobs"), "what is younger than an hour stays: {out}");
    let (code, out, _) = house.rockface(&["store", "stat"]);
    assert!(code == Some(0) && out.contains("rasterise-dem") && out.contains("4 records"), "{out}");
    let (code, out, _) = house.rockface(&["store", "gc", "--json"]);
    let done: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &done["records"]), (Some(0), &Value::from(0)));
    let (_, out, _) = house.rockface(&["run", "p.yaml"]);
    assert!(last_line(&out).contains("ran 0, cached 2"), "{out}");
    let (code, _, err) = house.rockface(&["store", "stat", "--store", "nowhere"]);
    assert!(code == Some(2) && err.contains("--store") && !house.path("nowhere").exists(), "{err}");
}

#[test]
fn results_are_copied_from_store_to_store() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml"]);
    house.rockface(&["run", "p.yaml", "--set", "steps.dem.with.cell_m=0.1"]);
    let (code, out, err) = house.rockface(&["store", "push", "shared", "--run", "latest"]);
    assert!(code == Some(0) && out.starts_with("copied 2 records with ") && out.contains("0 were there"), "{out}{err}");
    let (_, out, _) = house.rockface(&["store", "push", "shared"]);
    assert!(out.starts_with("copied 1 records with ") && out.contains("2 were there"), "{out}");
    std::fs::remove_dir_all(house.path(".rockface")).unwrap();
    let (code, out, err) = house.rockface(&["store", "pull", "shared"]);
    assert!(code == Some(0) && out.starts_with("copied 3 records"), "{out}{err}");
    let (_, out, _) = house.rockface(&["run", "p.yaml"]);
    assert!(last_line(&out).contains("ran 0, cached 2"), "{out}");
    let (code, _, err) = house.rockface(&["store", "pull", "nowhere"]);
    assert!(code == Some(2) && err.contains("no store in nowhere") && !house.path("nowhere").exists(), "{err}");
}

#[test]
fn a_collection_leaves_alone_what_a_live_run_counts_on() {
    let house = House::new(SMALL);
    house.rockface(&["run", "p.yaml"]);
    let store = rockface_cache::Store::open(&house.path(".rockface/store")).unwrap();
    let keys = store.keys();
    let plan = |store: &rockface_cache::Store| {
        let pinned = store.live().unwrap().keys;
        let policy = rockface_cache::GcPolicy { pinned, unnamed: true, ..Default::default() };
        store.plan_gc(&policy).unwrap().records.len()
    };
    assert_eq!(plan(&store), 2);
    store.count_on(&keys[..1]).unwrap();
    let other = rockface_cache::Store::open(&house.path(".rockface/store")).unwrap();
    assert_eq!(plan(&other), 1);
    drop(store);
    assert_eq!(plan(&other), 2);
}

#[test]
fn a_pipeline_of_several_files_is_answered_for_until_one_changes() {
    let house = House::new("rockface: 1\nname: whole\ninclude: part.yaml\n");
    let old = std::time::SystemTime::now() - std::time::Duration::from_mins(1);
    let write = |text: &str| {
        fs::write(house.path("part.yaml"), text).unwrap();
        fs::File::open(house.path("part.yaml")).unwrap().set_modified(old).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(30));
    };
    let ends = |expected: &str| {
        let (code, out, err) = house.rockface(&["run", "p.yaml"]);
        assert_eq!(code, Some(0), "{err}");
        assert!(last_line(&out).contains(expected), "{out}");
    };
    write(SMALL);
    ends("ran 2, cached 0");
    assert_eq!(answers(&house), 1);
    ends("ran 0, cached 2");
    write(&SMALL.replace("cell_m: 0.05", "cell_m: 0.1"));
    ends("ran 1, cached 1");
}

#[test]
fn what_is_missing_is_made_again_by_a_run_and_nothing_else_is_advised() {
    let house = House::new(&SMALL.replace("width_m: 2,", "width_m: 40,"));
    house.rockface(&["run", "p.yaml"]);
    let blobs = fs::read_dir(house.path(".rockface/store/blobs")).unwrap().flatten();
    let large: Vec<_> = blobs.flat_map(|folder| fs::read_dir(folder.path()).unwrap().flatten()).collect();
    fs::remove_file(large[0].path()).unwrap();
    let (code, out, _) = house.rockface(&["store", "verify"]);
    let told = last_line(&out);
    assert!(code == Some(3) && told.contains("0 damaged, 1 missing") && told.contains("`rockface run`"), "{out}");
    assert!(!told.contains("--repair"), "{out}");
    house.rockface(&["run", "p.yaml"]);
    let (code, out, _) = house.rockface(&["store", "verify"]);
    assert!(code == Some(0) && out.contains("all whole"), "{out}");
}

#[test]
fn looking_makes_no_store() {
    let house = House::new(SMALL);
    for arguments in [&["plan", "p.yaml"][..], &["explain", "p.yaml", "face"]] {
        fs::create_dir(house.path("empty")).unwrap();
        for place in [&[][..], &["--store", "new/store"], &["--store", "empty"]] {
            let (code, out, err) = house.rockface(&[arguments, place].concat());
            assert!(code == Some(0) && !out.is_empty(), "{arguments:?} {place:?}: {err}");
        }
        assert!(!house.path("new").exists() && !house.path(".rockface").exists());
        // Not removed if anything had been put there.
        fs::remove_dir(house.path("empty")).unwrap();
    }
    fs::write(house.path("file"), "in the way").unwrap();
    let (code, _, err) = house.rockface(&["plan", "p.yaml", "--store", "file/store"]);
    assert_eq!(code, Some(3), "{err}");
    let (code, _, err) = house.rockface(&["plan", "p.yaml", "--store", "."]);
    assert!(code == Some(3) && err.contains("is not a store"), "{err}");
    house.rockface(&["run", "p.yaml"]);
    let (_, out, _) = house.rockface(&["plan", "p.yaml"]);
    assert!(last_line(&out).starts_with("2 hit"), "{out}");
}
