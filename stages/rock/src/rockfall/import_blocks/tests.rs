//! `import-blocks`: real boulders, positions kept to the bit, repairs, modifiers, and clear refusals.

use nalgebra::{Rotation3, Vector3};
use serde_json::{Value, json};

use super::*;
use crate::rockfall::block::hull::hull;
use rockface_core::artefact::Artefact;
use rockface_core::format::ply;
use rockface_core::testing::{TestHost, run_stage, shared};

fn import_on(host: &TestHost, with: &Value, transform: Option<Transform>) -> Result<Meshes, StageError> {
    let inputs: Vec<_> = transform.into_iter().map(|t| ("transform", Artefact::from(t))).collect();
    let outputs = run_stage::<ImportBlocks>(host, with, &inputs)?;
    match outputs.into_inner().remove("blocks") {
        Some(Artefact::Meshes(meshes)) => Ok(meshes),
        other => panic!("{other:?}"),
    }
}

fn import(bytes: &[u8], with: &Value) -> Result<Meshes, StageError> {
    let mut with = with.clone();
    with["path"] = json!("b");
    import_on(&TestHost::default().with("b", &[("block.ply", bytes)]), &with, None)
}

fn cube(at: f64) -> Mesh {
    let corner = |i: u32| [i & 1, i >> 1 & 1, i >> 2].map(|bit| at + f64::from(bit));
    hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap().mesh()
}

fn two(a: &Mesh, b: &Mesh) -> Mesh {
    let count = a.vertices.len() as u32;
    let triangles = a.triangles.iter().copied().chain(b.triangles.iter().map(|t| t.map(|v| v + count))).collect();
    Mesh { vertices: [a.vertices.as_slice(), &b.vertices].concat(), triangles, ..a.clone() }
}

fn solid(part: &Part) -> Solid {
    Solid { vertices: part.vertices.clone(), triangles: part.triangles.clone() }
}

#[test]
fn a_block_keeps_its_place_to_the_bit() {
    let mesh = cube(451_000.1);
    let meshes = import(&ply::write_mesh(&mesh), &json!({})).unwrap();
    let part = &meshes.parts[0];
    assert_eq!((part.name.as_str(), part.class.as_str(), meshes.frame), ("block", "block", Frame::Wall));
    assert_eq!((&part.vertices, &part.triangles), (&mesh.vertices, &mesh.triangles));
    let centred = import(&ply::write_mesh(&cube(7.0)), &json!({"recentre": true, "class": "scan"})).unwrap();
    assert!(centred.parts[0].vertices.iter().flatten().all(|x| (x.abs() - 0.5).abs() < 1e-12));
    assert_eq!(centred.parts[0].class, "scan");
}

#[test]
fn a_transform_moves_a_block_as_it_moves_the_face() {
    let rotation = Rotation3::from_euler_angles(0.3, -0.2, 1.1).into_inner();
    let transform = Transform::new("world", "wall", &rotation, Vector3::new(3.0, 1.0, 2.0), Vector3::zeros());
    let mesh = cube(3.0);
    let bytes = ply::write_mesh(&mesh);
    let host = TestHost::default().with("b", &[("b.ply", &bytes)]);
    let meshes = import_on(&host, &json!({"path": "b", "frame": "world"}), Some(transform.clone())).unwrap();
    let moved = Moved::by(&transform).unwrap();
    let expected: Vec<[f64; 3]> = mesh.vertices.iter().map(|v| moved.apply(*v)).collect();
    assert_eq!((meshes.frame, &meshes.parts[0].vertices), (Frame::Wall, &expected));
    let error = import_on(&host, &json!({"path": "b"}), Some(transform)).unwrap_err();
    assert!(error.hint.unwrap().contains("frame: world"));
}

#[test]
fn what_is_safe_is_repaired_and_the_rest_refused_by_name() {
    let mut inside_out = cube(0.0);
    inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    inside_out.triangles[3].swap(0, 1);
    inside_out.triangles.push([2, 2, 5]);
    let part = import(&ply::write_mesh(&inside_out), &json!({})).unwrap().parts.remove(0);
    assert!((solid(&part).volume() - 1.0).abs() < 1e-12);
    let refused = |mesh: &Mesh| import(&ply::write_mesh(mesh), &json!({})).unwrap_err();
    let mut open = cube(0.0);
    open.triangles.pop();
    let error = refused(&open);
    assert!(
        error.message.contains("block `block`: it is open along 3 edges")
            && error.hint.unwrap().contains("convex_hull")
    );
    assert!(refused(&two(&cube(0.0), &cube(3.0))).message.contains("2 pieces"));
    let closed = import(&ply::write_mesh(&open), &json!({"modifiers": ["convex_hull"]})).unwrap();
    assert!((solid(&closed.parts[0]).volume() - 1.0).abs() < 1e-12);
    assert!(import(b"nothing", &json!({})).unwrap_err().message.contains("`block.ply`"));
}

#[test]
fn pieces_become_blocks_of_their_own() {
    let bytes = ply::write_mesh(&two(&cube(0.0), &cube(3.0)));
    let meshes = import(&bytes, &json!({"split": true})).unwrap();
    let names: Vec<&str> = meshes.parts.iter().map(|part| part.name.as_str()).collect();
    assert_eq!(names, ["block-1", "block-2"]);
    assert_eq!(meshes.parts[1].vertices, cube(3.0).vertices);
}

#[test]
fn modifiers_work_about_the_blocks_own_place() {
    let bytes = ply::write_mesh(&cube(10.0));
    let with = json!({"modifiers": [{"scale": {"factor": 2}}, {"subdivide": {"edge_m": 0.5}}, {"roughness": {"sigma_m": 0.01}}]});
    let meshes = import(&bytes, &with).unwrap();
    let (volume, centre) = solid(&meshes.parts[0]).volume_and_centroid();
    assert!((volume - 8.0).abs() < 0.2 && centre.iter().all(|x| (x - 10.5).abs() < 0.02), "{volume} {centre:?}");
    assert!(meshes.parts[0].vertices.len() > 100);
    let doubled = import(&bytes, &json!({"modifiers": [{"scale": {"factor": 2}}, "convex_hull"]})).unwrap();
    assert!((solid(&doubled.parts[0]).volume() - 8.0).abs() < 1e-9);
    let params = |with: &Value| <ImportBlocksParams as rockface_core::params::ParamType>::decode(with).unwrap();
    assert!(ImportBlocks::draws(&params(&json!({"path": "b", "modifiers": [{"roughness": {"sigma_m": 0.01}}]}))));
    assert!(!ImportBlocks::draws(&params(&json!({"path": "b", "modifiers": [{"scale": {"x": 2}}, "convex_hull"]}))));
    let drawn = json!({"path": "b", "modifiers": [{"scale": {"x": {"uniform": {"min": 1, "max": 2}}}}]});
    assert!(ImportBlocks::draws(&params(&drawn)));
}

#[test]
fn scanned_boulders_and_a_real_removed_block_are_read() {
    let files = ["block_sp1", "block_doublerock", "cliff_trier_block"];
    for name in files {
        let Some(bytes) = shared(&format!("faces/{name}.ply")) else { return };
        let with = json!({"min_piece_triangles": 100, "self_intersections": "smooth"});
        let meshes = import(&bytes, &with).unwrap_or_else(|e| panic!("{name}: {e}"));
        let whole = solid(&meshes.parts[0]);
        assert_eq!(whole.check(), Ok(()), "{name}");
        let plain = import(&bytes, &json!({"min_piece_triangles": 100}));
        // One of the scans passes through itself in places.
        assert_eq!(plain.is_err(), name == "block_doublerock", "{name}");
        println!("{name}: {} triangles, {} m3", whole.triangles.len(), whole.volume());
        if name == "cliff_trier_block" {
            // The volume its source states.
            assert!((whole.volume() / 14.9032 - 1.0).abs() < 1e-5, "{}", whole.volume());
        }
        let with =
            json!({"min_piece_triangles": 100, "modifiers": [{"scale": {"factor": 0.5}}, "tumble", "convex_hull"]});
        let convex = solid(&import(&bytes, &with).unwrap().parts[0]);
        let ratio = convex.volume() / (whole.volume() / 8.0);
        assert!((1.0..2.5).contains(&ratio), "{name}: {ratio}");
    }
}
