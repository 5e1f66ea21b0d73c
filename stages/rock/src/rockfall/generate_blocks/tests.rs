//! `generate-blocks`: defaults, files of sizes, joint sets, libraries, and every fault at its place.

use serde_json::{Value, json};

use super::*;
use crate::rockfall::block::Solid;
use rockface_core::artefact::{Artefact, Frame, Noun, Part};
use rockface_core::testing::{TestHost, run_stage};

fn run_on(host: &TestHost, with: &Value, inputs: &[(&str, Artefact)]) -> Result<Candidates, StageError> {
    let outputs = run_stage::<GenerateBlocks>(host, with, inputs)?;
    match outputs.into_inner().remove("blocks") {
        Some(Artefact::Candidates(candidates)) => Ok(candidates),
        other => panic!("{other:?}"),
    }
}

fn run(with: &Value) -> Result<Candidates, StageError> {
    run_on(&TestHost::default(), with, &[])
}

fn places(with: &Value) -> Vec<String> {
    let faults = match GenerateBlocksParams::decode(with) {
        Ok(params) => GenerateBlocks::check(&params),
        Err(faults) => faults,
    };
    faults.iter().map(|fault| fault.path.join(".")).collect()
}

#[test]
fn the_default_mixes_the_four_shapes_of_the_paper() {
    let host = TestHost::default();
    let candidates = run_on(&host, &json!({}), &[]).unwrap();
    assert_eq!(candidates.class_names(), ["prism", "ellipsoid", "trapezoid", "pyramid"]);
    assert_eq!(host.metric("tried_candidates_rejected"), Some(0.0));
    assert_eq!(Candidates::decode(&candidates.encode().unwrap()).unwrap(), candidates);
    let other = run_on(&TestHost::seeded(1), &json!({}), &[]).unwrap();
    assert_ne!(other.key, candidates.key);
}

#[test]
fn sizes_come_from_a_column_of_a_file() {
    let host = TestHost::default().with("sizes.csv", &[("sizes.csv", b"id;length_m\na;0.5\nb;2\n")]);
    let class = |column: &str| json!({"classes": [{"shape": "prism", "size": {"axes": {"length_m": {"file": {"path": "sizes.csv", "column": column}}}}}]});
    let candidates = run_on(&host, &class("length_m"), &[]).unwrap();
    for number in 0..20 {
        let block = block::candidate(&candidates, number).unwrap();
        let side = Solid { vertices: block.vertices, triangles: block.triangles }.extent()[0];
        assert!((side - 0.5).abs() < 1e-12 || (side - 2.0).abs() < 1e-12);
    }
    assert!(run_on(&host, &class("width_m"), &[]).unwrap_err().message.contains("no column `width_m`"));
    let bad = TestHost::default().with("sizes.csv", &[("sizes.csv", b"length_m\n-1\n2\n")]);
    let error = run_on(&bad, &class("length_m"), &[]).unwrap_err();
    assert!(error.message.contains("`classes`: 0.size.axes.length_m"), "{error}");
}

#[test]
fn joint_sets_need_the_orientation_of_the_face_once() {
    let sets = json!([{"dip_deg": 60, "dip_direction_deg": 180}, {"dip_deg": 85, "dip_direction_deg": 90}, {"dip_deg": 5, "dip_direction_deg": 0}]);
    let classes = json!([{"shape": {"joint_block": {"sets": sets}}}]);
    assert!(run(&json!({ "classes": classes })).unwrap_err().hint.unwrap().contains("transform"));
    let face = json!({"dip_direction_deg": 180});
    let by_face = run(&json!({"classes": classes, "face": face})).unwrap();
    let axes = nalgebra::Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0);
    let zero = nalgebra::Vector3::zeros();
    let transform = Artefact::from(Transform::new("world", "wall", &axes, zero, zero));
    let inputs = [("transform", transform)];
    let by_transform = run_on(&TestHost::default(), &json!({ "classes": classes }), &inputs).unwrap();
    let (a, b) = (block::candidate(&by_face, 0).unwrap(), block::candidate(&by_transform, 0).unwrap());
    assert!(a.vertices.iter().flatten().zip(b.vertices.iter().flatten()).all(|(x, y)| (x - y).abs() < 1e-12));
    let both = run_on(&TestHost::default(), &json!({"classes": classes, "face": face}), &inputs);
    assert!(both.unwrap_err().message.contains("which one"));
    assert!(run(&json!({ "face": face })).unwrap_err().message.contains("no class is of the shape"));
}

#[test]
fn a_library_is_used_or_refused() {
    let cube = crate::rockfall::block::hull::hull(
        &(0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from)).collect::<Vec<_>>(),
    )
    .unwrap();
    let part = Part { name: "a".into(), class: "scan".into(), vertices: cube.vertices, triangles: cube.triangles };
    let library = Artefact::from(Meshes { frame: Frame::Wall, parts: vec![part] });
    let with = json!({"classes": [{"shape": "library", "modifiers": [{"scale": {"factor": 2}}]}]});
    let candidates = run_on(&TestHost::default(), &with, &[("library", library.clone())]).unwrap();
    let block = block::candidate(&candidates, 0).unwrap();
    assert!((Solid { vertices: block.vertices, triangles: block.triangles }.volume() - 8.0).abs() < 1e-12);
    assert!(run(&with).unwrap_err().message.contains("`library`"));
    assert!(run_on(&TestHost::default(), &json!({}), &[("library", library)]).is_err());
}

#[test]
fn what_never_gives_a_block_is_told_at_once() {
    let with = json!({"classes": [{"shape": "prism", "edge_m": 0.1}], "modifiers": [{"noise": {"sigma_m": 0.5}}]});
    let error = run(&with).unwrap_err();
    assert!(error.message.contains("pass through each other") && error.hint.unwrap().contains("convex_hull"));
    let fine = json!({"classes": [{"shape": "prism", "edge_m": 1e-4}]});
    assert!(run(&fine).unwrap_err().message.contains("a million triangles"));
}

#[test]
fn every_fault_has_its_place() {
    assert_eq!(places(&json!({"classes": [{"shape": "prism", "probability": 0}]})), ["classes"]);
    let two = json!([{"dip_deg": 1, "dip_direction_deg": 1}, {"dip_deg": 1, "dip_direction_deg": 1}]);
    let joints = json!({"classes": [{"shape": {"joint_block": {"sets": two}}}]});
    assert_eq!(places(&joints), ["classes.0.shape.joint_block.sets"]);
    let form = |form: Value| places(&json!({"classes": [{"shape": "prism", "size": {"sneed_folk": form}}]}));
    assert_eq!(form(json!({"class": "C", "long_m": 1})), Vec::<String>::new());
    assert_eq!(form(json!({"class": "C", "s_over_l": 0.5, "long_m": 1})), ["classes.0.size.sneed_folk"]);
    assert_eq!(form(json!({"class": "C", "long_m": 1, "volume_m3": 1})), ["classes.0.size.sneed_folk"]);
    let unbounded =
        json!({"classes": [{"shape": "prism", "modifiers": [{"scale": {"x": {"normal": {"mean": 1, "sd": 0.1}}}}]}]});
    assert_eq!(places(&unbounded), ["classes.0.modifiers.0.scale.x"]);
    assert_eq!(places(&json!({"classes": [{"shape": "prisma"}]})), ["classes.0.shape"]);
}
