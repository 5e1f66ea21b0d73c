//! What a user of an older program meets: results of other versions of stages, and runs that another program made.

use rockface_cache::Store;
use serde_json::Value;

use crate::cli::{House, SMALL, last_line};

/// A store with the results of another one, as if the next version of each stage had made them.
fn of_next_versions(house: &House, from: &str, to: &str) {
    let (from, to) = (Store::open(&house.path(from)).unwrap(), Store::open(&house.path(to)).unwrap());
    for key in from.keys() {
        let mut record = from.record(&key).unwrap();
        record.recipe.version += 1;
        record.sketches = None;
        for digest in record.outputs.values().map(|output| output.digest).chain(record.log) {
            to.put(&from.get(&digest).unwrap()).unwrap();
        }
        to.commit(&record).unwrap();
    }
}

#[test]
fn stages_of_another_version_than_their_results_are_named() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    of_next_versions(&house, ".rockface/store", "other");
    let (code, out, err) = house.rockface(&["plan", "p.yaml", "--store", "other"]);
    assert_eq!(code, Some(0), "{err}");
    let face = out.lines().find(|line| line.starts_with("face ")).unwrap();
    assert!(face.contains("no record has this recipe: synthesise-face "), "{out}");
    let all = out.lines().find(|line| line.starts_with("stages of another version than their results on record: "));
    let all = all.unwrap_or_else(|| panic!("{out}"));
    assert!(all.contains("rasterise-dem ") && all.contains("synthesise-face ") && all.contains(" -> "), "{all}");
    // A step that waits says it of its own stage too.
    let (code, out, err) = house.rockface(&["explain", "p.yaml", "dem", "--store", "other"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("no result on record is of the version of its stage that this program has: rasterise-dem "));
    assert!(out.contains("version: "), "{out}");
    let (_, out, _) = house.rockface(&["plan", "p.yaml", "--set", "seed=2"]);
    assert!(out.contains("no record has this recipe") && !out.contains(" -> "), "{out}");
}

#[test]
fn a_repetition_names_stages_and_program_that_changed() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let path = house.path(".rockface/runs/latest/run.json").canonicalize().unwrap();
    let mut manifest: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    manifest["program"]["source"] = "0.0.9 (commit abc)".into();
    for done in manifest["steps"].as_array_mut().unwrap() {
        if done["step"] == "dem" {
            done["version"] = 99.into();
            let digest = done["outputs"]["raster"]["digest"].as_str().unwrap().to_owned();
            done["outputs"]["raster"]["digest"] = digest.chars().rev().collect::<String>().into();
        }
    }
    std::fs::write(&path, manifest.to_string()).unwrap();
    let again = ["run", path.to_str().unwrap()];
    let (code, out, err) = house.rockface(&again);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("changed  stage rasterise-dem: version 99 then, ") && !out.contains("synthesise"), "{out}");
    assert!(out.contains("the run was made by rockface 0.0.9 (commit abc), this is rockface "), "{out}");
    let required = [&again[..], &["--require-same"]].concat();
    let (code, _, err) = house.rockface(&required);
    assert!(code == Some(1) && err.contains("1 output is not as the run had it"), "{err}");
    let (code, out, _) = house.rockface(&[&required[..], &["--json"]].concat());
    let ended: Value = serde_json::from_str(last_line(&out)).unwrap();
    assert_eq!((code, &ended["failed"], &ended["repeated"]["others"]), (Some(1), &false.into(), &1.into()), "{out}");
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--require-same"]);
    assert!(code == Some(2) && err.contains("give the run.json"), "{err}");
}

#[test]
fn a_repetition_has_to_make_all_that_the_run_made() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let path = house.path(".rockface/runs/latest/run.json").canonicalize().unwrap();
    let required = ["run", path.to_str().unwrap(), "--require-same"];
    let (code, out, err) = house.rockface(&required);
    assert!(code == Some(0) && out.contains("all 2 outputs are the same"), "{out}{err}");
    let mut manifest: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for done in manifest["steps"].as_array_mut().unwrap() {
        if done["step"] == "dem" {
            done["outputs"]["slope"] = done["outputs"]["raster"].clone();
        }
    }
    std::fs::write(&path, manifest.to_string()).unwrap();
    let (code, out, err) = house.rockface(&required);
    assert!(code == Some(1) && out.contains("missing  dem.slope: the former run made it"), "{out}{err}");
    // What is not asked for now is not missing.
    let (code, out, err) = house.rockface(&[&required[..], &["--target", "face"]].concat());
    assert!(code == Some(0) && out.contains("all 1 outputs are the same"), "{out}{err}");
}

#[test]
fn files_name_the_program_that_made_the_run() {
    let house = House::new(SMALL);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(0));
    let path = house.path(".rockface/runs/latest/run.json");
    let mut manifest: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    let source = manifest["program"]["source"].as_str().unwrap().to_owned();
    manifest["program"]["source"] = "0.0.9 (commit abc)".into();
    std::fs::write(&path, manifest.to_string()).unwrap();
    let (code, _, err) = house.rockface(&["export", "latest", "face.mesh", "face.ply"]);
    assert_eq!(code, Some(0), "{err}");
    let file = std::fs::read(house.path("face.ply")).unwrap();
    let head = String::from_utf8_lossy(&file[..2000]).into_owned();
    assert!(head.contains("\"program\":\"rockface 0.0.9 (commit abc)\""), "{head}");
    assert!(head.contains(&format!("\"exported_by\":\"rockface {source}\"")), "{head}");
    for told in [&["runs", "show", "latest"][..], &["inspect", "face.ply"], &["inspect", path.to_str().unwrap()]] {
        let (code, out, err) = house.rockface(told);
        assert!(code == Some(0) && out.contains("rockface 0.0.9 (commit abc)"), "{told:?}: {out}{err}");
    }
}
