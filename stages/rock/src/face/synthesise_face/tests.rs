//! Tests of `synthesise-face`: a proper sheet without self-intersections, whatever is asked of it.

use nalgebra::Vector3;
use serde_json::json;

use super::*;
use crate::face::inspection::Inspection;
use rockface_core::artefact::Artefact;
use rockface_core::params::ParamType;
use rockface_core::testing::TestHost;

fn face(with: &serde_json::Value) -> Mesh {
    let params = SynthesiseFaceParams::decode(with).unwrap();
    let host = TestHost::default();
    let outputs = SynthesiseFace::run(&params, &Inputs::default(), &Context::new(&host)).unwrap();
    let Some(Artefact::Mesh(mesh)) = outputs.into_inner().remove("mesh") else { panic!("no mesh") };
    mesh
}

#[test]
fn the_mesh_is_a_proper_sheet_facing_the_viewer() {
    let mesh = face(&json!({"width_m": 2, "height_m": 1.5, "spacing_m": 0.05}));
    assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (41 * 31, 2 * 40 * 30));
    assert_eq!(Inspection::of(&mesh).border_edges, 140);
    let at = |i: u32| nalgebra::Vector3::from(mesh.vertices[i as usize]);
    let up = |t: &[u32; 3]| (at(t[1]) - at(t[0])).cross(&(at(t[2]) - at(t[0]))).z > 0.0;
    assert!(mesh.triangles.iter().all(up));
    let mean = mesh.vertices.iter().map(|v| v[2]).sum::<f64>();
    assert!(mean.abs() < 1e-9);
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let with = json!({"width_m": 3, "height_m": 2, "spacing_m": 0.04});
    let at = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| face(&with));
    assert_eq!(at(1), at(3));
}

/// Every feature at once.
fn believable() -> serde_json::Value {
    json!({
        "width_m": 1.6, "height_m": 1.3, "spacing_m": 0.05, "overhang_deg": 35, "fallen_share": 0.1, "fallen_depth_m": 0.3,
        "wear_m": 0.02, "roughness_m": 0.01, "relief_m": 0.05,
        "joints": [
            {"dip_deg": 80, "direction_deg": 40, "spacing_m": 0.4, "step_m": 0.2},
            {"dip_deg": 50, "direction_deg": 170, "spacing_m": 0.5, "step_m": 0.2, "persistence": 0.7, "steps": "exponential"},
        ],
        "bedding": {"thickness_m": 0.3, "step_m": 0.1},
    })
}

/// Whether a segment meets the inside of a triangle.
fn pierces(p: Vector3<f64>, q: Vector3<f64>, [a, b, c]: [Vector3<f64>; 3]) -> bool {
    let volume =
        |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, d: Vector3<f64>| (b - a).cross(&(c - a)).dot(&(d - a));
    let (above, below) = (volume(a, b, c, p), volume(a, b, c, q));
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    above * below < 0.0 && (sides.iter().all(|side| *side > 0.0) || sides.iter().all(|side| *side < 0.0))
}

#[test]
fn overhangs_are_real_and_no_triangle_meets_another() {
    let mesh = face(&believable());
    assert_eq!(Inspection::of(&mesh).border_edges, 2 * (32 + 26));
    let corners: Vec<[Vector3<f64>; 3]> =
        mesh.triangles.iter().map(|t| t.map(|i| Vector3::from(mesh.vertices[i as usize]))).collect();
    let back = corners.iter().filter(|[a, b, c]| (b - a).cross(&(c - a)).z < 0.0).count();
    assert!(back > 10, "{back} of {} triangles overhang", corners.len());
    let boxes: Vec<_> = corners.iter().map(|[a, b, c]| (a.inf(b).inf(c), a.sup(b).sup(c))).collect();
    let near = |one: usize, other: usize| (0..3).all(|k| boxes[one].0[k] <= boxes[other].1[k]);
    for (one, triangle) in corners.iter().enumerate() {
        for (other, edges) in corners.iter().enumerate().filter(|(other, _)| near(one, *other) && near(*other, one)) {
            let apart = mesh.triangles[one].iter().all(|i| !mesh.triangles[other].contains(i));
            let met = (0..3).any(|k| pierces(edges[k], edges[(k + 1) % 3], *triangle));
            assert!(!(apart && met), "triangles {one} and {other} meet");
        }
    }
}

#[test]
fn every_feature_changes_the_face() {
    let plain = json!({"width_m": 4, "height_m": 3, "spacing_m": 0.05});
    let changed = |extra: serde_json::Value| {
        let mut with = plain.clone();
        with.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        face(&with) != face(&plain)
    };
    for extra in [
        json!({"joints": []}),
        json!({"joints": [{}, {"dip_deg": 85, "direction_deg": -40}]}),
        json!({"joints": [{"persistence": 0.4}]}),
        json!({"joints": [{"steps": "exponential"}]}),
        json!({"bedding": {}}),
        json!({"fallen_share": 0.2}),
        json!({"overhang_deg": 20}),
        json!({"wear_m": 0.06}),
        json!({"roughness_m": 0.01}),
    ] {
        assert!(changed(extra.clone()), "{extra}");
    }
    assert!(!changed(json!({"joints": [{}]})));
}

#[test]
fn impossible_faces_are_faults_of_the_parameters() {
    let faults = |with| SynthesiseFace::check(&SynthesiseFaceParams::decode(&with).unwrap());
    assert_eq!(faults(json!({"spacing_m": 1e-4}))[0].path, ["spacing_m"]);
    assert_eq!(faults(json!({"joints": [{}, {"spacing_m": 0.1}]}))[0].path, ["joints", "1", "step_m"]);
    assert_eq!(faults(json!({"bedding": {"thickness_m": 1e-9}}))[0].path, ["bedding", "thickness_m"]);
    assert_eq!(faults(json!({"fallen_share": 0.1, "fallen_depth_m": 0}))[0].path, ["fallen_depth_m"]);
    assert!(faults(json!({})).is_empty());
}
