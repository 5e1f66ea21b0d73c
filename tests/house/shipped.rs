//! Pipelines that ship with the program: called by name, and copied with what they read.

use crate::cli::{House, SMALL};

#[test]
fn a_shipped_pipeline_plans_without_a_file() {
    let house = House::new(SMALL);
    for name in ["quickstart", "rockface/benchmark", "paper/hunter-valley", "rockface/paper/nobbys-head"] {
        let (code, out, err) = house.rockface(&["plan", name]);
        assert!(code == Some(0) && out.contains("0 hit"), "{out}{err}");
    }
    let (code, out, err) = house.rockface(&["graph", "quickstart", "--format", "mermaid"]);
    assert!(code == Some(0) && out.contains("verdict"), "{err}");
    let (code, out, err) = house.rockface(&["explain", "quickstart", "face"]);
    assert!(code == Some(0) && out.contains("synthesise-face"), "{err}");
}

#[test]
fn the_experiments_of_the_paper_plan_and_end_in_a_table_of_agreement() {
    let house = House::new(SMALL);
    for name in ["hunter-valley", "nobbys-head", "replicate", "small-volumes", "ten-epochs"] {
        let name = format!("paper/{name}");
        let (code, _, err) = house.rockface(&["init", "copy", "--from", &name]);
        assert_eq!(code, Some(0), "{err}");
        let path = format!("copy/{name}.yaml");
        let (code, out, err) = house.rockface(&["plan", &path, "--target", "agreement"]);
        assert!(code == Some(0) && out.lines().any(|line| line.starts_with("agreement")), "{out}{err}");
        // At a quarter of the resolution, as the README of the folder has it.
        let (code, _, err) =
            house.rockface(&["plan", &path, "--set", "params.downscale=4", "--set", "params.cell_m=0.04"]);
        assert_eq!(code, Some(0), "{err}");
        std::fs::remove_dir_all(house.path("copy")).unwrap();
    }
}

#[test]
fn references_of_the_paper_s_sites_can_be_a_folder_of_one_s_own() {
    let house = House::new(SMALL);
    let own = ["--set", "params.references=own", "--set"];
    for name in ["paper/hunter-valley", "paper/nobbys-head"] {
        let (code, _, err) = house.rockface(&[&["plan", name][..], &own, &["params.rasters=gone/*.tif"]].concat());
        assert!(code == Some(2) && err.contains("gone") && !err.contains("item"), "{err}");
        std::fs::write(house.path("a.tif"), "a raster").unwrap();
        let raster = format!("params.rasters={}", house.path("*.tif").display());
        let (code, out, err) =
            house.rockface(&[&["plan", name, "--target", "features"][..], &own, &[raster.as_str()]].concat());
        let simulated = out.lines().any(|line| line.starts_with("flown"));
        assert!(code == Some(0) && out.contains("imported") && !simulated, "{out}{err}");
    }
}

#[test]
fn what_no_pipeline_is_called_gets_a_suggestion() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["run", "quickstrat"]);
    assert!(code == Some(2) && err.contains("did you mean `quickstart`?") && err.contains("benchmark"), "{err}");
    let (code, _, err) = house.rockface(&["init", "a", "--from", "bench"]);
    assert!(code == Some(2) && err.contains("one of benchmark-outcrop"), "{err}");
}

#[test]
fn a_copy_has_all_that_is_read_and_is_not_mistaken_for_the_shipped_one() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["plan", "python-script"]);
    assert!(code == Some(2) && err.contains("rockface init DIR --from python-script"), "{err}");
    let (code, out, err) = house.rockface(&["init", ".", "--from", "python-script"]);
    assert!(code == Some(0) && out.contains("rockface run ./python-script.yaml"), "{out}{err}");
    let (code, out, err) = house.rockface(&["plan", "python-script.yaml"]);
    assert!(code == Some(0) && out.contains("counted"), "{err}");
    let (code, _, err) = house.rockface(&["plan", "python-script"]);
    assert!(code == Some(2) && err.contains("`rockface/python-script` for the shipped one"), "{err}");
    let (code, _, err) = house.rockface(&["plan", "rockface/python-script"]);
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = house.rockface(&["init", ".", "--from", "python-script"]);
    assert!(code == Some(2) && err.contains("is there already"), "{err}");
}
