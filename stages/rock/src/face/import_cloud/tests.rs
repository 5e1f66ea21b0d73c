//! Tests of `import-cloud`: real and made clouds, and the side the rock is on.

use serde_json::json;

use super::*;
use crate::face::inspection::Inspection;
use rockface_core::artefact::{Mesh, Noun};
use rockface_core::params::ParamType;
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

#[test]
fn the_frame_that_a_file_states_holds() {
    let vertices: Vec<[f64; 3]> =
        (0..400).map(|i| [0.1 * f64::from(i % 20), 0.1 * f64::from(i / 20), 5e-3 * f64::from(i * 7 % 11)]).collect();
    let triangles = (0..380).filter(|i| i % 20 < 19).map(|i| [i, i + 1, i + 20]).collect();
    let own = Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() };
    let file = rockface_core::format::ply::write_mesh(&own);
    let (mesh, host) = import(&file, &json!({}));
    assert_eq!((mesh.unwrap().frame, host.warnings().len()), (Frame::Wall, 0), "{:?}", host.warnings());
    let (mesh, host) = import(&file, &json!({"frame": "world"}));
    assert_eq!(mesh.unwrap().frame, Frame::World);
    assert!(host.warnings()[0].contains("states the wall frame"), "{:?}", host.warnings());
    assert!(import(&file, &json!({"crs": "EPSG:32633"})).0.unwrap_err().message.contains("states the wall frame"));
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

/// The wall as LAS, each point with a class and perhaps withheld, a noise point of class 7 far before it.
fn classified(mark: impl Fn(usize) -> (u8, bool)) -> Vec<u8> {
    let text = wall();
    let lines: Vec<&str> = text.lines().collect();
    // Points of 20 bytes after a header of 227, as format 0 of LAS 1.2 has them.
    let mut bytes = b"LASF".to_vec();
    bytes.resize(227, 0);
    (bytes[24], bytes[25], bytes[94], bytes[96], bytes[105]) = (1, 2, 227, 227, 20);
    bytes[107..111].copy_from_slice(&(lines.len() as u32 + 1).to_le_bytes());
    for (axis, offset) in [451_000.0f64, 0.0, 0.0].into_iter().enumerate() {
        bytes[131 + 8 * axis..][..8].copy_from_slice(&0.001f64.to_le_bytes());
        bytes[155 + 8 * axis..][..8].copy_from_slice(&offset.to_le_bytes());
    }
    let mut point = |place: [f64; 3], (class, is_withheld): (u8, bool)| {
        let of = |x: f64| ((x * 1000.0).round() as i32).to_le_bytes();
        let mut record = place.map(of).concat();
        record.resize(20, 0);
        record[15] = class | u8::from(is_withheld) << 7;
        bytes.extend(record);
    };
    for (i, line) in lines.iter().enumerate() {
        let words: Vec<f64> = line.split(' ').take(3).map(|word| word.parse().unwrap()).collect();
        point([words[0] - 451_000.0, words[1], words[2]], mark(i));
    }
    point([1.0, 3.0, 1.0], (7, false));
    bytes
}

#[test]
fn withheld_points_and_noise_are_no_rock() {
    let bytes = classified(|i| (2, i < 20));
    let (mesh, host) = import(&bytes, &json!({"outward": [0, 1, 0]}));
    assert_eq!(mesh.unwrap().vertices.len(), 380);
    let metric = |name| host.metric(name).unwrap() as usize;
    assert_eq!((metric("points"), metric("dropped_withheld_points"), metric("dropped_class_points")), (380, 20, 1));
    assert!(host.warnings().is_empty(), "{:?}", host.warnings());
    let all = import(&classified(|_| (2, true)), &json!({})).0.unwrap_err();
    assert!(all.message.contains("no point of `cloud` is of a class that is kept"), "{all}");
}

#[test]
fn classes_to_keep_are_listed_and_vegetation_is_warned_of() {
    let bytes = classified(|i| (if i < 40 { 4 } else { 2 }, false));
    let outward = json!([0, 1, 0]);
    let (mesh, host) = import(&bytes, &json!({"outward": outward}));
    assert_eq!(mesh.unwrap().vertices.len(), 400);
    assert!(host.warnings()[0].starts_with("40 of 401 points are classified as vegetation"), "{:?}", host.warnings());
    let (mesh, host) = import(&bytes, &json!({"outward": outward, "classes": [2]}));
    assert_eq!((mesh.unwrap().vertices.len(), host.metric("dropped_class_points")), (360, Some(41.0)));
    assert!(host.warnings().is_empty());
    let refused = |bytes: &[u8], classes| import(bytes, &json!({"classes": classes})).0.unwrap_err().message;
    assert!(refused(&bytes, json!([6])).contains("40 of class 4, medium vegetation: left out"));
    assert!(refused(wall().as_bytes(), json!([2])).contains("of another format, without classes"));
    let fault =
        |classes| ImportCloud::check(&ImportCloudParams::decode(&json!({"path": "a", "classes": classes})).unwrap());
    assert_eq!((fault(json!([])).len(), fault(json!([2, 256])).len(), fault(json!([0, 255])).len()), (0, 1, 0));
    // An empty list is as none.
    let (mesh, host) = import(&bytes, &json!({"outward": outward, "classes": []}));
    assert_eq!((mesh.unwrap().vertices.len(), host.warnings().len()), (400, 1));
}

#[test]
fn a_point_at_zero_does_not_tell_where_the_cloud_is() {
    let text: String = (0..400)
        .map(|i| {
            format!(
                "{:.3} {:.3} {:.3}\n",
                451_000.0 + 0.1 * f64::from(i % 20),
                5_512_000.0 + 0.1 * f64::from(i / 20),
                300.0
            )
        })
        .collect();
    let warnings = |text: &str| import(text.as_bytes(), &json!({"crs": "EPSG:32633"})).1.warnings();
    assert!(warnings(&format!("0 0 0\n{text}")).is_empty(), "{:?}", warnings(&format!("0 0 0\n{text}")));
    let moved = text.replace("451", "").replace("5512", "");
    assert!(warnings(&moved)[0].contains("have lost a shift"), "{:?}", warnings(&moved));
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

/// A plane that dips by these degrees to the south, with a little roughness.
fn slope(dip_deg: f64) -> String {
    let (sine, cosine) = rockface_core::numerics::portable_math::sincos(dip_deg.to_radians());
    let point = |i: u32| {
        let (x, along, out) = (0.1 * f64::from(i % 20), 0.1 * f64::from(i / 20), 0.003 * f64::from(i * 7 % 11));
        format!("{} {} {}\n", x, along * cosine - out * sine, along * sine + out * cosine)
    };
    (0..400).map(point).collect()
}

#[test]
fn what_tells_the_side_of_the_rock_too_faintly_does_not_tell_it() {
    // A face may overhang from 60 degrees of dip on.
    let warned = |dip_deg: f64| !import(slope(dip_deg).as_bytes(), &json!({})).1.warnings().is_empty();
    assert_eq!([55.0, 65.0].map(warned), [false, true]);
    // Six degrees off the plane.
    let along = |y: f64| import(wall().as_bytes(), &json!({"outward": [1, y, 0]})).0;
    assert!(along(0.08).unwrap_err().message.contains("`outward` lies within 6 degrees"));
    assert!(along(0.12).is_ok());
    // Normals that cancel but for 0.2 and 0.4 of them.
    let told_by_normals = |turned: usize| {
        let rows = overhang(" 0 0.98 -0.2").replacen("0.98 -0.2", "-0.98 0.2", turned);
        import(format!("x y z nx ny nz\n{rows}").as_bytes(), &json!({})).1.warnings().is_empty()
    };
    assert_eq!([160, 120].map(told_by_normals), [false, true]);
}
