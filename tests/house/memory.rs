//! What steps need of memory: estimated from their inputs before they run, and on record afterwards.

use serde_json::Value;

use crate::cli::House;

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
