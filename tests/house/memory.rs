//! What steps need of memory: estimated from their inputs before they run, and on record afterwards.

use serde_json::Value;

use rockface_core::artefact::Table;
use rockface_engine::run::Options;

use crate::cli::House;
use crate::lab::{Bench, Ran};

const FACES: &str = "rockface: 1
name: faces
axes: {width_m: {values: [2, 2.5, 3, 3.5]}}
steps:
  face: {stage: synthesise-face, with: {width_m: \"${width_m}\", height_m: 2, spacing_m: 0.02}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.05, method: tin}}
";

/// The steps that were held, with what they were expected to need, bytes.
fn held(memory_gib: &str) -> Vec<(String, u64)> {
    let house = House::new(FACES);
    let (code, out, err) = house.rockface(&["run", "p.yaml", "--jobs", "3", "--memory", memory_gib, "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let events = out.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let held = events.filter(|event| event["event"] == "held");
    held.map(|event| (event["step"].as_str().unwrap().to_owned(), event["need_bytes"].as_u64().unwrap())).collect()
}

#[test]
fn heavy_steps_wait_for_memory_by_what_they_will_need() {
    assert_eq!(held("1"), []);
    let held = held("0.002");
    let need = |step: &str| held.iter().find(|(name, _)| name.starts_with(step)).map(|(_, bytes)| *bytes);
    // Vertices 2 cm apart on 2.5 x 2 m and more, 110 bytes each.
    assert!(need("face").is_some_and(|bytes| (1_300_000..2_000_000).contains(&bytes)), "{held:?}");
}

#[test]
fn megabytes_given_as_gigabytes_are_warned_of() {
    let house = House::new(FACES);
    let (code, _, err) = house.rockface(&["run", "p.yaml", "--memory", "900000"]);
    let warned = "warning: `--memory 900000` is more than there is here, ";
    assert!(
        code == Some(0) && err.contains(warned) && err.contains("GiB; it is in GiB, or with a unit (500MB)"),
        "{err}"
    );
}

#[test]
fn records_tell_what_a_step_took_and_what_its_outputs_take() {
    let house = House::new(FACES);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    let manifest = std::fs::read(house.path(".rockface/runs/latest/run.json")).unwrap();
    let manifest: Value = serde_json::from_slice(&manifest).unwrap();
    for done in manifest["steps"].as_array().unwrap() {
        let made: u64 =
            done["outputs"].as_object().unwrap().values().map(|o| o["memory_bytes"].as_u64().unwrap()).sum();
        assert!(made > 1000 && done["cost"]["peak_bytes"].as_u64().unwrap() >= made, "{done}");
    }
}

/// The number that a step made, and how often it and those before it were given a value to change without a copy.
fn raised(bench: &Bench, ran: &Ran, label: &str) -> [Option<f64>; 2] {
    let table: Table = ran.value(&bench.store, label, "out");
    [0, 1].map(|column| table.rows[0][column].number())
}

#[test]
fn a_value_is_changed_in_place_by_the_last_step_that_asks_for_it() {
    let pipeline = "rockface: 1
name: test
steps:
  a: {stage: emit, with: {value: 1}}
  b: {stage: raise, in: {in: a.out}}
  c: {stage: raise, in: {in: b.out}}
  d: {stage: raise, in: {in: c.out}}
  fork: {stage: raise, with: {plus: 10}, in: {in: d.out}}
  fork2: {stage: raise, with: {plus: 20}, in: {in: d.out}}
";
    let bench = Bench::new();
    let ran = bench.run_with(pipeline, &[], &Options { jobs: 1, ..Options::default() });
    assert_eq!(raised(&bench, &ran, "d"), [Some(4.0), Some(2.0)]);
    // The first of two has to copy it, whatever the order; the second is the last unless both begin at once.
    let [fork, fork2] = ["fork", "fork2"].map(|step| raised(&bench, &ran, step));
    assert_eq!([fork[0], fork2[0]], [Some(14.0), Some(24.0)]);
    assert!([4.0, 5.0].contains(&(fork[1].unwrap() + fork2[1].unwrap())), "{fork:?} {fork2:?}");
    // What runs twice is given its inputs twice.
    let bench = Bench::new();
    let ran = bench.run_with(pipeline, &[], &Options { check_determinism: true, ..Options::default() });
    assert_eq!(raised(&bench, &ran, "d"), [Some(4.0), Some(0.0)]);
}

#[test]
fn a_value_that_was_changed_in_place_is_made_again_where_it_is_needed_again() {
    let pipeline = |more: &str| {
        format!(
            "rockface: 1
name: test
steps:
  a: {{stage: emit, keep: false, with: {{value: 1}}}}
  b: {{stage: raise, keep: false, in: {{in: a.out}}}}
  c: {{stage: raise, in: {{in: b.out}}}}
{more}"
        )
    };
    let bench = Bench::new();
    let ran = bench.run(&pipeline(""), &[]);
    assert_eq!(raised(&bench, &ran, "c"), [Some(3.0), Some(1.0)]);
    let ran = bench.run(&pipeline("  late: {stage: raise, with: {plus: 5}, in: {in: b.out}}\n"), &[]);
    assert_eq!((ran.executed(), ran.remade()), (vec!["late".to_owned()], vec!["a".to_owned(), "b".to_owned()]));
    assert_eq!(raised(&bench, &ran, "late")[0], Some(7.0));
}
