//! Tests of the way to the wall frame: real faces of every dip, bits kept, disagreements named.

use std::sync::Arc;

use serde_json::json;

use super::*;
use rockface_core::artefact::{Artefact, Georeference, Image};
use rockface_core::format::ply::read_mesh;
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, run_stage};

fn run(
    with: &serde_json::Value,
    mesh: Mesh,
    cameras: Option<Cameras>,
) -> Result<(Mesh, Transform, Outputs), StageError> {
    let params = TransformCrsParams::decode(with).unwrap();
    let mut inputs = Inputs::default();
    inputs.push("mesh", rockface_core::Point::new(), Arc::new(mesh.into()));
    if let Some(cameras) = cameras {
        inputs.push("cameras", rockface_core::Point::new(), Arc::new(cameras.into()));
    }
    let host = TestHost::default();
    let outputs = TransformCrs::run(&params, &inputs, &Context::new(&host))?;
    let made = outputs.clone().into_inner();
    match (&made["mesh"], &made["transform"]) {
        (Artefact::Mesh(mesh), Artefact::Transform(transform)) => Ok((mesh.clone(), transform.clone(), outputs)),
        other => panic!("{other:?}"),
    }
}

/// A vertical wall facing world -Y, 4 m wide and 2 m high.
fn wall() -> Mesh {
    let vertices = vec![[10.0, 5.0, 1.0], [14.0, 5.0, 1.0], [14.0, 5.0, 3.0], [10.0, 5.0, 3.0]];
    Mesh { frame: Frame::World, vertices, triangles: vec![[0, 1, 2], [0, 2, 3]], colours: Vec::new() }
}

fn camera_at(centre_m: [f64; 3]) -> Cameras {
    let image = Image { name: "a".into(), sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m };
    Cameras { frame: Frame::World, sensors: Vec::new(), images: vec![image] }
}

fn real(name: &str) -> Option<Mesh> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/faces/").to_owned() + name;
    let bytes = std::fs::read(&path).map_err(|_| println!("skipped: {name} is absent")).ok()?;
    Some(read_mesh(&bytes).unwrap())
}

#[test]
fn a_wall_gets_x_along_y_up_z_out() {
    let (mesh, transform, _) = run(&json!({}), wall(), None).unwrap();
    let expected = [[-2.0, -1.0, 0.0], [2.0, -1.0, 0.0], [2.0, 1.0, 0.0], [-2.0, 1.0, 0.0]];
    for (vertex, expected) in mesh.vertices.iter().zip(expected) {
        assert!((Vector3::from(*vertex) - Vector3::from(expected)).norm() < 1e-12, "{vertex:?}");
    }
    assert_eq!((mesh.frame, transform.from.as_str(), transform.to.as_str()), (Frame::Wall, "world", "wall"));
}

#[test]
fn a_mesh_in_the_wall_frame_keeps_its_way_to_the_world() {
    let (moved, transform, _) = run(&json!({}), wall(), None).unwrap();
    let way = Transform { crs: None, ..transform };
    let crs = "EPSG:32633".parse().ok();
    let frame = Frame::Wall.at(Some(Georeference { crs, wall_from_world: Some(way.clone()) }));
    for with in [json!({}), json!({"frame": "given"})] {
        let (again, stated, _) = run(&with, Mesh { frame, ..moved.clone() }, None).unwrap();
        assert_eq!((again.vertices, &stated), (moved.vertices.clone(), &way));
        let (_, unknown, _) = run(&with, Mesh { frame: Frame::Wall, ..moved.clone() }, None).unwrap();
        assert!(unknown.is_identity());
    }
}

#[test]
fn cameras_come_along() {
    let (_, _, outputs) = run(&json!({}), wall(), Some(camera_at([12.0, -1.0, 2.0]))).unwrap();
    let Some(Artefact::Cameras(cameras)) = outputs.into_inner().remove("cameras") else { panic!("no cameras") };
    assert!((cameras.images[0].centre() - Vector3::new(0.0, 0.0, 6.0)).norm() < 1e-12);
    assert_eq!(cameras.frame, Frame::Wall);
}

#[test]
fn a_given_frame_keeps_every_bit() {
    let mut mesh = wall();
    mesh.vertices = vec![[0.1 + 0.2, -0.0, 5e-324], [1.0 / 3.0, 0.0, 0.0], [1.0, 1.0, 0.1]];
    mesh.triangles = vec![[0, 1, 2]];
    let error = run(&json!({"frame": "given"}), mesh.clone(), None).unwrap_err();
    assert!(error.message.contains("says it is in the world frame"), "{error}");
    mesh.frame = Frame::Wall;
    let (moved, transform, _) = run(&json!({"frame": "given"}), mesh.clone(), None).unwrap();
    let bits = |mesh: &Mesh| mesh.vertices.iter().map(|v| v.map(f64::to_bits)).collect::<Vec<_>>();
    assert_eq!(bits(&moved), bits(&mesh));
    assert!(transform.is_identity());
}

#[test]
fn disagreement_about_the_outer_side_is_named() {
    let error = run(&json!({}), wall(), Some(camera_at([12.0, 11.0, 2.0]))).unwrap_err();
    assert!(error.message.contains("triangles' orientation and the direction to the cameras disagree"), "{error}");
    let error = run(&json!({"outward": [0, 1, 0]}), wall(), None).unwrap_err();
    assert!(error.message.contains("`outward` disagree"), "{error}");
    let inward = json!({"frame": "given", "given": {"rotation": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}});
    assert!(run(&inward, wall(), None).unwrap_err().message.contains("face into the rock"));
}

#[test]
fn cameras_of_another_place_are_no_reason_to_flip_triangles() {
    for with in [json!({}), json!({"outward": [0, -1, 0]})] {
        let error = run(&with, wall(), Some(camera_at([12.0, 5000.0, 2.0]))).unwrap_err();
        assert!(error.message.contains("cameras are 5.0 km from the mesh"), "{error}");
        assert!(error.hint.unwrap().contains("`offset_m`"));
    }
}

#[test]
fn a_direction_along_the_face_does_not_tell_its_outer_side() {
    // Into the rock by a cosine of 0.03 and of 0.01.
    let error = run(&json!({"outward": [1, 0.03, 0]}), wall(), None).unwrap_err();
    assert!(error.message.contains("`outward` disagree"), "{error}");
    assert!(run(&json!({"outward": [1, 0.01, 0]}), wall(), None).is_ok());
    let both_sides = Mesh { triangles: vec![[0, 1, 2], [0, 2, 1], [0, 2, 3], [0, 3, 2]], ..wall() };
    let error = run(&json!({"outward": [1, 0.01, 0]}), both_sides, None).unwrap_err();
    assert!(error.message.contains("neither triangles nor cameras tell"), "{error}");
    // With a direction it is known where the outside is, and that the triangles do not face it.
    let both_sides = Mesh { triangles: vec![[0, 1, 2], [0, 2, 1], [0, 2, 3], [0, 3, 2]], ..wall() };
    let error = run(&json!({"outward": [0, -1, 0]}), both_sides, None).unwrap_err();
    assert!(error.message.contains("a closed body, and no face"), "{error}");
}

#[test]
fn parameters_that_contradict_each_other_are_faults() {
    let faults = |with| TransformCrs::check(&TransformCrsParams::decode(&with).unwrap());
    let stretched = json!({"frame": "given", "given": {"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}});
    assert_eq!(faults(stretched)[0].path, ["given", "rotation"]);
    assert_eq!(faults(json!({"given": {}}))[0].path, ["given"]);
    assert_eq!(faults(json!({"up": [0, 0, 0]}))[0].path, ["up"]);
}

/// The dips are those of the best-fit plane in the data's own description.
#[test]
fn real_faces_of_every_dip_become_walls() {
    let dips = [("cliff_trier_wall_pre.ply", 68.0, 3.0), ("outcrop_bingie_5cm.ply", 1.6, 1.0)];
    for (name, dip_deg, tolerance_deg) in dips {
        let Some(mesh) = real(name) else { return };
        let (moved, transform, _) = run(&json!({}), mesh, None).unwrap();
        let axes = transform.matrix();
        assert!((axes.determinant() - 1.0).abs() < 1e-12);
        let dip = portable_math::acos(axes[(2, 2)]).to_degrees();
        assert!((dip - dip_deg).abs() < tolerance_deg, "{name}: {dip} deg");
        assert!(plane_fit::fit_plane(&moved).unwrap().mean_normal.z > 0.5);
        let y_up = if dip > 20.0 { axes[(1, 2)] } else { axes[(1, 1)] };
        assert!(y_up > 0.8, "{name}: Y does not point up the face");
    }
}

#[test]
fn another_epoch_takes_the_transform_of_the_first() {
    let (first, transform, _) = run(&json!({}), wall(), None).unwrap();
    let mut lowered = wall();
    lowered.vertices.iter_mut().for_each(|v| v[0] -= 0.25);
    let inputs = |transform: &Transform| {
        [("mesh", Artefact::Mesh(lowered.clone())), ("transform", Artefact::Transform(transform.clone()))]
    };
    let host = TestHost::default();
    let outputs = run_stage::<TransformCrs>(&host, &json!({}), &inputs(&transform)).unwrap().into_inner();
    let Some(Artefact::Mesh(second)) = outputs.get("mesh") else { panic!("no mesh") };
    for (a, b) in first.vertices.iter().zip(&second.vertices) {
        let moved = Vector3::from(*b) - Vector3::from(*a);
        assert!((moved.norm() - 0.25).abs() < 1e-12);
    }
    let error = run_stage::<TransformCrs>(&host, &json!({}), &inputs(&transform.inverse())).unwrap_err();
    assert!(error.message.contains("takes wall to world"), "{error}");
}
