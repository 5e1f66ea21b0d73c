//! Tests of `import-cloud`: real and made clouds, and the side the rock is on.

use serde_json::json;

use super::*;
use crate::face::inspection::Inspection;
use rockface_core::artefact::{Mesh, Noun};
use rockface_core::testing::{TestHost, run_stage, shared};

fn import(bytes: &[u8], extra: &serde_json::Value) -> (Result<Mesh, StageError>, TestHost) {
    let host = TestHost::default().with("cloud", &[("cloud", bytes)]);
    let mut with = json!({"path": "cloud"});
    with.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
    let outputs = run_stage::<ImportCloud>(&host, &with, &[]);
    let mesh = outputs.map(|outputs| Mesh::of(&outputs.into_inner()["mesh"]).unwrap().clone());
    (mesh, host)
}

/// A vertical wall in the plane of X and Z, as columns with colours.
fn wall() -> String {
    (0..400)
        .map(|i| {
            format!(
                "{} {} {} 10 {} 30\n",
                451_000.0 + 0.1 * f64::from(i % 20),
                5e-3 * f64::from(i * 7 % 11),
                f64::from(i / 20) * 0.1,
                i % 256
            )
        })
        .collect()
}

#[test]
fn a_vertical_wall_needs_to_be_told_its_side() {
    let error = import(wall().as_bytes(), &json!({})).0.unwrap_err();
    assert!(error.message.contains("on which side the rock is") && error.hint.unwrap().contains("outward"));
    for side in [-1.0, 1.0] {
        let mesh = import(wall().as_bytes(), &json!({"outward": [0, side, 0]})).0.unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len(), mesh.colours.len()), (400, 722, 400));
        assert_eq!(mesh.colours[255], [10, 255, 30]);
        assert!(Inspection::of(&mesh).open_area().unwrap().1.y * side > 3.6);
    }
}

/// A face that looks north and overhangs by 12 degrees, as text or as PLY with normals.
fn overhang(normals: &str) -> String {
    let point = |i: u32| {
        let (x, up) = (0.1 * f64::from(i % 20), 0.1 * f64::from(i / 20));
        format!("{} {} {}{normals}\n", 451_000.0 + x, 5_512_000.0 + 0.2126 * up + 0.003 * f64::from(i * 7 % 11), up)
    };
    (0..400).map(point).collect()
}

#[test]
fn normals_tell_the_side_of_an_overhang_and_without_them_it_is_warned() {
    let north = |mesh: &Mesh| Inspection::of(mesh).open_area().unwrap().1.y;
    let (mesh, host) = import(overhang("").as_bytes(), &json!({}));
    assert!(north(&mesh.unwrap()) < -3.0, "taken not to overhang");
    let warning = host.warnings().join("\n");
    assert!(warning.contains("does not overhang (dips 78") && warning.contains("give `outward: ["), "{warning}");
    let header = "ply\nformat ascii 1.0\nelement vertex 400\nproperty double x\nproperty double y\nproperty double z\n\
                  property float nx\nproperty float ny\nproperty float nz\nend_header\n";
    let rows = overhang(" 0 0.98 -0.2");
    for text in [format!("{header}{rows}"), format!("x y z nx ny nz\n{rows}")] {
        let (mesh, host) = import(text.as_bytes(), &json!({}));
        assert!(north(&mesh.unwrap()) > 3.0 && host.warnings().is_empty(), "{:?}", host.warnings());
    }
    // LAZ with extra dimensions, as `export-cloud` writes it.
    let points: Vec<[f64; 3]> = overhang("")
        .lines()
        .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap())
        .collect();
    let mut cloud = rockface_core::artefact::Cloud::new(Frame::World, points);
    cloud.normals = vec![[0.0, 0.98, -0.2]; 400];
    let (mesh, host) = import(&rockface_core::format::cloud_laz::write(&cloud).unwrap(), &json!({}));
    assert!(north(&mesh.unwrap()) > 3.0 && host.warnings().is_empty(), "{:?}", host.warnings());
    // Those that cancel tell nothing.
    let text = format!("x y z nx ny nz\n{}", rows.replacen("0.98 -0.2", "-0.98 0.2", 200));
    assert!(!import(text.as_bytes(), &json!({})).1.warnings().is_empty());
    let (mesh, host) = import(overhang("").as_bytes(), &json!({"outward": [0, 1, 0]}));
    assert!(north(&mesh.unwrap()) > 3.0 && host.warnings().is_empty());
}

#[test]
fn unreadable_clouds_are_refused_by_name() {
    let refused = |bytes: &[u8]| import(bytes, &json!({})).0.unwrap_err().message;
    assert!(refused(b"1 2 3\n1 2\n").contains("`cloud`: line 2"));
    assert!(refused(b"1 2 3\n1 2 4\n").contains("2 points"));
    assert!(refused(b"\0\0\0").contains("not LAS, LAZ, PLY"));
    assert!(import(b"1 2 3\n1 2 4\n1 2 5\n1 2 6\n", &json!({"outward": [1, 1, 1]})).0.is_err(), "all on one line");
}

#[test]
fn a_real_scan_becomes_one_clean_sheet() {
    let Some(bytes) = shared("faces/outcrop_bingie_points.laz") else { return };
    let (mesh, host) = import(&bytes, &json!({"cell_m": 0.05}));
    let mesh = mesh.unwrap();
    assert_eq!(host.metric("points"), Some(268_035.0));
    // The mesh of the shared data was made from one point a 5 cm cell by other means: 31,720 vertices, 63,228 triangles.
    assert!((mesh.vertices.len() as f64 / 31_720.0 - 1.0).abs() < 0.03, "{} vertices", mesh.vertices.len());
    assert!((mesh.triangles.len() as f64 / 63_228.0 - 1.0).abs() < 0.03, "{} triangles", mesh.triangles.len());
    assert_eq!(mesh.colours.len(), mesh.vertices.len());
    let found = Inspection::of(&mesh);
    assert_eq!((found.crowded_edges.count, found.opposed_edges.count, found.pinched_vertices.count), (0, 0, 0));
    assert!(found.open_area().unwrap().1.z > 0.0);
}
