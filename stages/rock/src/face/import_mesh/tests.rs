//! Tests of `import-mesh`: formats, repairs, refusals and real faces.

use serde_json::{Value, json};

use super::*;
use rockface_core::artefact::{Artefact, Georeference, Noun, Transform};
use rockface_core::format::ply;
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, height_mesh, run_stage};

fn run(bytes: &[u8], offset_m: [f64; 3], defects: Defects) -> (Result<Mesh, StageError>, TestHost) {
    let host = TestHost::default().with("face.ply", &[("face.ply", bytes)]);
    let word = if defects == Defects::Keep { "keep" } else { "refuse" };
    let with = json!({"path": "face.ply", "offset_m": offset_m, "defects": word});
    let outputs = run_stage::<ImportMesh>(&host, &with, &[]);
    let mesh = outputs.map(|outputs| match outputs.into_inner().remove("mesh") {
        Some(Artefact::Mesh(mesh)) => mesh,
        other => panic!("no mesh but {other:?}"),
    });
    (mesh, host)
}

fn square(triangles: &[[u32; 3]]) -> Vec<u8> {
    let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [7.0, 7.0, 7.0]];
    let colours = Vec::new();
    ply::write_mesh(&Mesh { frame: Frame::World, vertices, triangles: triangles.to_vec(), colours })
}

#[test]
#[allow(clippy::float_cmp)] // to the bit
fn a_mesh_is_tidied_shifted_and_counted() {
    let (mesh, host) = run(&square(&[[0, 1, 2], [0, 2, 3], [1, 1, 2]]), [451_000.125, 0.0, 0.0], Defects::Refuse);
    let mesh = mesh.unwrap();
    assert_eq!((mesh.frame, mesh.vertices.len(), mesh.triangles.len()), (Frame::World, 4, 2));
    assert_eq!(mesh.vertices[1], [451_001.125, 0.0, 0.0]);
    assert_eq!(host.metric("dropped_degenerate_triangles"), Some(1.0));
    assert_eq!(host.metric("dropped_unreferenced_vertices"), Some(1.0));
    assert_eq!(host.metric("boundary_edges"), Some(4.0));
}

#[test]
fn coordinates_in_single_precision_are_warned_of_with_their_step() {
    let at = |x: f64, y: f64| {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let vertices = corners.iter().map(|[a, b]| [x + 8.0 * a, y + 8.0 * b, 0.0]).collect();
        let triangles = vec![[0, 1, 2], [0, 2, 3]];
        ply::write_mesh(&Mesh { frame: Frame::World, vertices, triangles, colours: Vec::new() })
    };
    let warnings = |bytes: &[u8]| run(bytes, [0.0; 3], Defects::Refuse).1.warnings();
    let found = warnings(&at(451_000.0, 5_512_342.0));
    assert!(found.iter().any(|text| text.contains("5512350 m") && text.contains("steps are 0.500 m")), "{found:?}");
    let found = warnings(&at(451_000.1, 5_512_342.0));
    assert!(!found.iter().any(|text| text.contains("single precision")), "double precision: {found:?}");
}

#[test]
#[allow(clippy::float_cmp)] // to the bit
fn millimetres_become_metres_where_the_file_states_no_system() {
    let (mesh, _) = with(&square(&[[0, 1, 2], [0, 2, 3]]), &json!({"unit_m": 0.001, "offset_m": [0, 0, 5]}));
    assert_eq!(mesh.unwrap().vertices[1], [0.001, 0.0, 5.0]);
    let system = json!({"unit_m": 0.001, "offset_m": [451_236, 5_512_346, 612], "crs": "EPSG:32633"});
    let (mesh, host) = with(&square(&[[0, 1, 2], [0, 2, 3]]), &system);
    let mesh = mesh.unwrap();
    assert_eq!(mesh.vertices[1], [451_236.001, 5_512_346.0, 612.0]);
    assert_eq!(mesh.frame.crs().unwrap().epsg(), Some(32633));
    assert!(host.warnings().is_empty(), "{:?}", host.warnings());
    let params = |with| ImportMeshParams::decode(&with).unwrap();
    let faults = ImportMesh::check(&params(json!({"path": "face", "unit_m": 0.001, "crs": "EPSG:2229"})));
    assert!(faults.len() == 1 && faults[0].message.contains("`EPSG:2229` is a system in another unit"), "{faults:?}");
    let frame = Frame::World.at(Some(Georeference::world("EPSG:32633".parse().unwrap())));
    let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let bytes = ply::write_mesh(&Mesh { frame, vertices, triangles: vec![[0, 1, 2]], colours: Vec::new() });
    let error = with(&bytes, &json!({"unit_m": 0.001})).0.unwrap_err();
    assert!(error.message.contains("states the system and the unit"), "{error}");
    let error = with(&bytes, &json!({"unit_m": 0.001, "crs": "EPSG:32633"})).0.unwrap_err();
    assert!(error.message.contains("states the system and the unit"), "{error}");
}

#[test]
fn neither_a_vertex_without_triangle_nor_a_piece_far_away_tells_where_the_face_is() {
    let mesh = height_mesh(20, [0.0, 20.0, 0.0, 10.0], |x, y| 0.1 * x * y);
    let vertices = mesh.vertices.iter().map(|[x, y, z]| format!("v {} {} {z}\n", x + 451_000.125, y + 5_512_000.125));
    let faces = mesh.triangles.iter().map(|t| format!("f {} {} {}\n", t[0] + 2, t[1] + 2, t[2] + 2));
    let text: String = ["v 0 0 0\n".to_owned()].into_iter().chain(vertices).chain(faces).collect();
    let system = json!({"crs": "EPSG:32633"});
    let warnings = |text: &str| with(text.as_bytes(), &system).1.warnings();
    assert!(warnings(&text).is_empty(), "{:?}", warnings(&text));
    let far = warnings(&(text + "v 1 0 0\nv 0 1 0\nf 1 443 444\n"));
    assert!(
        far.len() == 1 && far[0].starts_with("1 triangles lie far from all others, the farthest corner at ("),
        "{far:?}"
    );
    assert!(far[0].contains("`min_piece_triangles`") && far[0].contains("`plane: robust`"));
}

#[test]
fn a_mesh_that_rounding_has_flattened_is_warned_of() {
    let vertex = |i: u32| {
        let x = 412_345.0 + 0.05 * f64::from(i % 15);
        format!(
            "v {x:.6e} {:.6e} {:.6e}\n",
            5_567_890.0 + 0.03 * f64::from(i % 3),
            1_800.0 + 0.0713 * f64::from(i / 15)
        )
    };
    let square = |i: u32| format!("f {a} {} {}\nf {a} {} {}\n", i + 2, i + 17, i + 17, i + 16, a = i + 1);
    let text: String = (0..225).map(vertex).chain((0..210).filter(|i| i % 15 < 14).map(square)).collect();
    let (_, host) = with(text.as_bytes(), &json!({}));
    let warnings = host.warnings().join("\n");
    assert!(warnings.contains("written with 7 digits, whose steps are 1.000 m"), "{warnings}");
    assert!(warnings.contains("triangles had no area and are dropped"), "{warnings}");
}

fn with(bytes: &[u8], extra: &Value) -> (Result<Mesh, StageError>, TestHost) {
    let host = TestHost::default().with("face", &[("face", bytes)]);
    let mut with = json!({"path": "face"});
    with.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
    let outputs = run_stage::<ImportMesh>(&host, &with, &[]);
    let mesh = outputs.map(|outputs| Mesh::of(&outputs.into_inner()["mesh"]).unwrap().clone());
    (mesh, host)
}

/// A PLY of ours in this frame.
fn stating(frame: Frame) -> Vec<u8> {
    let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    ply::write_mesh(&Mesh { frame, vertices, triangles: vec![[0, 1, 2]], colours: Vec::new() })
}

#[test]
fn the_frame_that_a_file_states_holds_with_its_place_in_the_world() {
    let way = Transform { origin: [385_012.0, 6_355_040.0, 12.0], ..Transform::identity("world", "wall") };
    let crs = "EPSG:32633".parse().ok();
    let placed = Frame::Wall.at(Some(Georeference { crs, wall_from_world: Some(way) }));
    for (frame, given) in [(placed, None), (placed, Some("wall")), (Frame::World, None), (Frame::World, Some("world"))]
    {
        let given = given.map_or_else(|| json!({}), |name| json!({"frame": name}));
        let (mesh, host) = with(&stating(frame), &given);
        let read = mesh.unwrap().frame;
        assert_eq!((read, read.georeference()), (frame, frame.georeference()));
        assert!(host.warnings().is_empty(), "{:?}", host.warnings());
    }
    // What is given holds against it, with a warning.
    for (frame, given) in [(placed, "world"), (Frame::World, "wall")] {
        let (mesh, host) = with(&stating(frame), &json!({"frame": given}));
        assert_eq!(mesh.unwrap().frame.name(), given);
        let text = format!(
            "taken to be in the {given} frame, as `frame: {given}` says; `frame: {}` goes by the file",
            frame.name()
        );
        assert!(host.warnings().iter().any(|warning| warning.contains(&text)), "{:?}", host.warnings());
    }
    let error = with(&stating(placed), &json!({"crs": "EPSG:32633"})).0.unwrap_err();
    assert!(error.message.contains("states the wall frame") && error.hint.unwrap().contains("frame: world"));
    // A wall frame whose place in the world is known is not moved; without a place it may be.
    for moved in [json!({"unit_m": 0.001}), json!({"offset_m": [0.0, 2.0, 0.0]})] {
        let error = with(&stating(placed), &moved).0.unwrap_err();
        assert!(error.message.contains("would make untrue"), "{error}");
        assert_eq!(with(&stating(Frame::Wall), &moved).0.unwrap().frame, Frame::Wall);
    }
    // Files of other programs state none.
    let (mesh, host) = with(tilted(0.1, 1.0).as_bytes(), &json!({"frame": "wall"}));
    assert_eq!((mesh.unwrap().frame, host.warnings().len()), (Frame::Wall, 0), "{:?}", host.warnings());
}

#[test]
fn a_surface_is_cut_open_where_three_triangles_share_an_edge() {
    let crowded = square(&[[0, 1, 2], [0, 2, 3], [2, 0, 4]]);
    let refused = with(&crowded, &json!({})).0.unwrap_err();
    assert!(refused.message.contains("1 edges of three or more triangles"), "{}", refused.message);
    assert!(refused.hint.unwrap().starts_with("`defects: repair`"));
    let (mesh, host) = with(&crowded, &json!({"defects": "repair"}));
    let mesh = mesh.unwrap();
    assert_eq!((mesh.triangles.len(), mesh.vertices.len()), (3, 9));
    assert_eq!((host.metric("cut_edges"), host.metric("non_manifold_edges")), (Some(1.0), Some(0.0)));
    // Two triangles that share an edge stay together; nothing else is touched.
    let (mesh, host) = with(&square(&[[0, 1, 2], [0, 2, 3]]), &json!({"defects": "repair"}));
    assert_eq!((mesh.unwrap().vertices.len(), host.metric("cut_edges")), (4, Some(0.0)));
}

/// A face of 6 x 6 squares in the XY plane, turned to face `-Y` (a cliff), as OBJ text.
fn cliff_obj() -> String {
    let mesh = height_mesh(6, [0.0, 6.0, 0.0, 6.0], |x, y| 0.1 * x * y);
    let vertices = mesh.vertices.iter().map(|[x, y, z]| format!("v {x} {} {y}\n", -z));
    let faces = mesh.triangles.iter().map(|t| format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    vertices.chain(faces).collect()
}

#[test]
fn formats_are_told_by_their_content() {
    let (obj, _) = with(cliff_obj().as_bytes(), &json!({}));
    let obj = obj.unwrap();
    assert_eq!((obj.vertices.len(), obj.triangles.len()), (49, 72));
    let mut stl = "solid\n".to_owned();
    for triangle in &obj.triangles {
        let corner = |i: u32| obj.vertices[i as usize].map(|x| x.to_string()).join(" ");
        stl += &format!(
            "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n",
            triangle.map(|i| format!("vertex {}\n", corner(i))).concat()
        );
    }
    let (read, host) = with((stl + "endsolid\n").as_bytes(), &json!({}));
    let read = read.unwrap();
    assert_eq!((read.vertices.len(), host.metric("boundary_edges")), (49, Some(24.0)));
    let refused = |bytes: &[u8]| with(bytes, &json!({})).0.unwrap_err().message;
    assert!(refused(b"1 2 3\n4 5 6\n").contains("not PLY, OBJ or STL"));
    assert!(refused(b"LASF\0\0").contains("import-cloud"));
}

#[test]
fn what_cannot_be_repaired_safely_is_refused() {
    let refused = |bytes: Vec<u8>| run(&bytes, [0.0; 3], Defects::Refuse).0.unwrap_err();
    assert!(refused(square(&[[0, 1, 2], [0, 2, 3], [2, 0, 4]])).message.contains("1 edges of three or more"));
    assert!(refused(square(&[])).hint.unwrap().contains("import-cloud"));
    assert!(refused(square(&[[1, 1, 2]])).message.contains("none of the 1 triangles"));
}

#[test]
fn without_repair_every_fault_is_named_and_nothing_moves() {
    let flipped = square(&[[0, 1, 2], [0, 3, 2], [1, 1, 2]]);
    let error = with(&flipped, &json!({"repair": "none"})).0.unwrap_err().message;
    assert!(error.contains("has 1 triangles without area and "), "{error}");
    let (kept, host) = with(&flipped, &json!({"repair": "none", "defects": "keep"}));
    let kept = kept.unwrap();
    assert_eq!((kept.vertices.len(), kept.triangles.len()), (5, 3));
    assert!(host.warnings()[0].contains("oriented against each other, the first near ("), "{:?}", host.warnings());
    let (repaired, host) = with(&flipped, &json!({}));
    assert_eq!(repaired.unwrap().triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(host.metric("turned_triangles"), Some(1.0));
}

#[test]
fn a_face_inside_out_is_turned_where_that_can_be_told() {
    let inside_out = cliff_obj()
        .replace("f ", "f 1 ")
        .lines()
        .filter(|l| !l.starts_with('f'))
        .map(|l| format!("{l}\n"))
        .collect::<String>()
        + &cliff_obj()
            .lines()
            .filter(|l| l.starts_with('f'))
            .map(|l| {
                let corners: Vec<&str> = l.split(' ').collect();
                format!("f {} {} {}\n", corners[1], corners[3], corners[2])
            })
            .collect::<String>();
    let right = with(cliff_obj().as_bytes(), &json!({"outward": [0, -1, 0]})).0.unwrap();
    let (turned, host) = with(inside_out.as_bytes(), &json!({"outward": [0, -1, 0]}));
    let normal = |mesh: &Mesh| Inspection::of(mesh).open_area().unwrap().1;
    assert!((normal(&turned.unwrap()) - normal(&right)).norm() < 1e-9);
    assert_eq!(host.metric("turned_triangles"), Some(72.0));
    assert!(host.warnings()[0].contains("inside out and has been turned"));
    let refused = with(inside_out.as_bytes(), &json!({"outward": [0, -1, 0], "repair": "none"})).0.unwrap_err();
    assert!(refused.message.contains("face into the rock"), "{refused}");
    let unknown = with(inside_out.as_bytes(), &json!({})).0.unwrap();
    assert!(normal(&unknown).dot(&normal(&right)) < 0.0, "without `outward` nobody knows");
    let closed = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 2 4 3\nf 1 3 4\n";
    let (closed, host) = with(closed.as_bytes(), &json!({}));
    assert!(Inspection::of(&closed.unwrap()).closed_volume_m3().unwrap() > 0.16);
    assert_eq!((host.metric("closed_pieces"), host.metric("turned_triangles")), (Some(1.0), Some(4.0)));
}

#[test]
fn holes_pieces_and_pinches_are_reported_with_their_place() {
    let gone = ["f 17 18 25\n", "f 17 25 24\n"];
    let holed = gone.iter().fold(cliff_obj(), |text, face| {
        assert!(text.contains(face));
        text.replace(face, "")
    });
    let (mesh, host) = with(holed.as_bytes(), &json!({}));
    assert_eq!((mesh.unwrap().triangles.len(), host.metric("holes")), (70, Some(1.0)));
    assert!(host.warnings()[0].starts_with("1 holes, the largest of 4."), "{:?}", host.warnings());
    let strip = holed
        .lines()
        .filter(|line| !["f 10 11 18", "f 10 18 17", "f 3 4 11", "f 3 11 10"].contains(line))
        .collect::<Vec<_>>()
        .join("\n");
    let (_, host) = with((strip + "\nv 50 0 0\nv 51 0 0\nv 50 0 1\nf 50 51 52\n").as_bytes(), &json!({}));
    assert_eq!((host.metric("pieces"), host.metric("holes")), (Some(2.0), Some(0.0)));
    let (small, _) =
        with((holed + "v 50 0 0\nv 51 0 0\nv 50 0 1\nf 50 51 52\n").as_bytes(), &json!({"min_piece_triangles": 2}));
    assert_eq!(small.unwrap().vertices.len(), 49);
}

#[test]
fn damaged_files_are_named_with_their_place() {
    let refused = |bytes: &[u8]| with(bytes, &json!({})).0.unwrap_err().message;
    let ply = square(&[[0, 1, 2], [0, 2, 3]]);
    assert!(refused(&ply[..ply.len() - 5]).contains("face 1 (counted from 0): the file ends here"));
    let nan = cliff_obj().replacen("v 0 -0 0", "v 0 nan 0", 1);
    assert!(refused(nan.as_bytes()).contains("line 1: the coordinate NaN is not finite"));
    assert!(
        refused(cliff_obj().split_inclusive('\n').take(20).collect::<String>().as_bytes()).contains("no triangles")
    );
}

#[test]
fn real_faces_of_other_programs_are_read() {
    let shared = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data"));
    let Ok(folder) = std::fs::read_dir(shared.join("faces")) else {
        println!("skipped: the folder of real faces is absent");
        return;
    };
    let mut paths: Vec<_> = folder.filter_map(|entry| entry.ok().map(|e| e.path())).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "ply"));
    paths.push(shared.join("outcrop-survey/face.ply"));
    paths.sort();
    let mut refused = Vec::new();
    for path in paths {
        let bytes = std::fs::read(&path).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if run(&bytes, [0.0; 3], Defects::Refuse).0.is_err() {
            refused.push(name.clone());
        }
        let (mesh, host) = run(&bytes, [0.0; 3], Defects::Keep);
        assert!(mesh.unwrap().triangles.len() > 1000, "{name}");
        assert_eq!(host.warnings().join("\n").contains("three or more"), refused.contains(&name), "{name}");
    }
    // The two whole scenes have two edges of three triangles each.
    assert_eq!(refused, ["cliff_trier_post.ply", "cliff_trier_pre.ply"]);
}

/// One square that is tilted so that its normal has these components along X and Z.
fn tilted(x: f64, z: f64) -> String {
    // Up its slope it goes by (-z, 0, x), across it along Y.
    let [up, across] = [[-z, 0.0, x], [0.0, 1.0, 0.0]];
    let corner = |[a, b]: [f64; 2]| {
        let [px, py, pz] = [0, 1, 2].map(|axis| a * up[axis] + b * across[axis]);
        format!("v {px} {py} {pz}\n")
    };
    let corners: String = [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]].map(corner).concat();
    format!("{corners}f 1 2 3\nf 1 3 4\n")
}

#[test]
fn faces_that_look_down_or_along_what_is_given_as_outward_are_warned_of() {
    let warnings = |text: &str, extra: &Value| {
        let (mesh, host) = with(text.as_bytes(), extra);
        mesh.unwrap();
        host.warnings()
    };
    // 29 and 31 degrees below the horizontal.
    assert_eq!(warnings(&tilted(0.875, -0.485), &json!({})), Vec::<String>::new());
    let down = warnings(&tilted(0.857, -0.515), &json!({}));
    assert!(down.len() == 1 && down[0].contains("face downwards"), "{down:?}");
    let upright = tilted(1.0, 0.0);
    let along = warnings(&upright, &json!({"outward": [0.01, 1, 0]}));
    assert!(along.len() == 1 && along[0].contains("in equal parts"), "{along:?}");
    assert_eq!(warnings(&upright, &json!({"outward": [0.03, 1, 0]})), Vec::<String>::new());
}

#[test]
fn a_file_that_is_too_long_for_a_system_is_not_read() {
    let obj = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let read = |system: &[u8]| {
        let host = TestHost::default().with("m.obj", &[("m.obj", obj), ("m.prj", system)]);
        run_stage::<ImportMesh>(&host, &json!({"path": "m.obj", "min_piece_triangles": 1}), &[]).map(drop)
    };
    let message = read(&vec![b' '; (1 << 16) + 1]).unwrap_err().message;
    assert!(message.contains("the `.prj` beside `m.obj` has more than 64 KiB, and is not read"), "{message}");
    let message = read(b"hidden words").unwrap_err().message;
    assert!(message.contains("cannot be read: it is not well-known text") && !message.contains("hidden"), "{message}");
}
