//! Pipelines that ship with the program: called by name, and copied with what they read.

use rockface_core::artefact::{Cloud, Frame};
use rockface_core::format::cloud_laz;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;

use crate::cli::{House, SMALL};

/// A scan of a face that looks south, 6 m wide and 4 m high on a grid of 5 cm, with noise of 2 mm; a rockfall of 1 m by 0.8 m and 0.3 m has left it in week 2.
fn scan(week: u8) -> Vec<u8> {
    let noise = Key([week; 32]).field();
    let point = |i: i32| {
        let (column, row) = (i % 121, i / 121);
        let (east, up) = (0.05 * f64::from(column), 0.05 * f64::from(row));
        let relief = 0.3 * portable_math::sin(2.0 * east) * portable_math::cos(3.0 * up) + 0.3 * up;
        let gone = week == 2 && (2.0..3.0).contains(&east) && (1.5..2.3).contains(&up);
        let north = relief + 0.002 * noise.normal(column, row) + if gone { 0.3 } else { 0.0 };
        [412_300.0 + east, 5_098_700.0 + north, 870.0 + up]
    };
    cloud_laz::write(&Cloud::new(Frame::World, (0..121 * 81).map(point).collect())).unwrap()
}

#[test]
fn the_monitor_template_finds_a_rockfall_between_scans() {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["init", "site", "--template", "monitor"]);
    assert_eq!(code, Some(0), "{err}");
    std::fs::create_dir_all(house.path("site/scans")).unwrap();
    for (week, name) in ["first", "week01", "week02"].into_iter().enumerate() {
        std::fs::write(house.path(&format!("site/scans/{name}.laz")), scan(week as u8)).unwrap();
    }
    let (code, _, err) = house.rockface(&["run", "site/pipeline.yaml", "--set", "params.cell_m=0.05"]);
    assert_eq!(code, Some(0), "{err}");
    let list = std::fs::read_to_string(house.path("site/.rockface/runs/latest/outputs/list/table.csv")).unwrap();
    assert!(list.lines().count() == 2 && list.contains("week02"), "{list}");
}

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
