//! Tests of `remove-blocks`: on known shapes, on real faces, and with many random candidates.

use serde_json::{Value, json};

use super::*;
use crate::face::inspection::Inspection;
use crate::face::tetrahedra::volume_m3;
use crate::rockfall::block::hull::hull;
use crate::rockfall::generate_blocks::GenerateBlocks;
use rockface_core::Entry;
use rockface_core::artefact::Table;
use rockface_core::artefact::{Cell, Inventory, Part};
use rockface_core::format::ply;
use rockface_core::testing::{TestHost, height_mesh, run_stage, shared};

fn rough(x: f64, y: f64) -> f64 {
    let wave = |t: f64| 1.0 - 2.0 * ((t - t.floor()) - 0.5).abs();
    0.3 * wave(0.37 * x + 0.2 * y) + 0.1 * wave(1.3 * y - 0.7 * x) + 0.02 * wave(4.1 * x + 5.3 * y)
}

fn candidates(with: &Value, seed: u64) -> Artefact {
    let outputs = run_stage::<GenerateBlocks>(&TestHost::seeded(seed), with, &[]).unwrap();
    outputs.into_inner().remove("blocks").unwrap()
}

fn cube(side_m: f64, centre: [f64; 3]) -> Part {
    let corner = |i: u32| [0, 1, 2].map(|k| centre[k] + side_m * (f64::from(i >> k & 1) - 0.5));
    let solid = hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap();
    Part { name: "cube".into(), class: "cube".into(), vertices: solid.vertices, triangles: solid.triangles }
}

/// The face after, the ground truth, and the table of attempts.
#[derive(Debug)]
struct Removed {
    mesh: Mesh,
    truth: Inventory,
    pieces: Meshes,
    attempts: Table,
    metrics: Vec<(String, f64)>,
    warnings: Vec<String>,
}

impl Removed {
    fn metric(&self, wanted: &str) -> Option<f64> {
        self.metrics.iter().find(|(name, _)| name == wanted).map(|(_, value)| *value)
    }
}

fn remove(mesh: &Mesh, blocks: &Artefact, more: &[(&str, Artefact)], with: &Value) -> Result<Removed, StageError> {
    let host = TestHost::default();
    let mut inputs = vec![("mesh", Artefact::Mesh(mesh.clone())), ("blocks", blocks.clone())];
    inputs.extend(more.iter().cloned());
    let mut outputs = run_stage::<RemoveBlocks>(&host, with, &inputs)?.into_inner();
    let mut get = |port: &str| outputs.remove(port).unwrap();
    let (Artefact::Mesh(mesh), Artefact::Inventory(truth)) = (get("mesh"), get("truth")) else { panic!() };
    let (Artefact::Meshes(pieces), Artefact::Table(attempts)) = (get("pieces"), get("attempts")) else { panic!() };
    let metric = |entry: &Entry| match entry {
        Entry::Metric { name, value, .. } => Some((name.clone(), *value)),
        _ => None,
    };
    let metrics = host.entries.lock().unwrap().iter().filter_map(metric).collect();
    Ok(Removed { mesh, truth, pieces, attempts, metrics, warnings: host.warnings() })
}

/// What must hold whatever was removed: connections, border, untouched parts, volume.
fn check_sound(before: &Mesh, removed: &Removed) {
    let after = &removed.mesh;
    assert_eq!(&after.vertices[..before.vertices.len()], &before.vertices[..]);
    let mut old = before.triangles.iter();
    let kept = after.triangles.iter().take_while(|t| old.any(|o| o == *t)).count();
    let base = before.vertices.len() as u32;
    assert!(kept > 0 && after.triangles[kept..].iter().flatten().any(|v| *v >= base));
    assert_eq!(edges(after), [edges(before)[0], 0, 0]);
    let about = before.vertices[0];
    let between =
        volume_m3(&before.vertices, &before.triangles, about) - volume_m3(&after.vertices, &after.triangles, about);
    let sum: f64 = removed.pieces.parts.iter().map(|p| volume_m3(&p.vertices, &p.triangles, p.vertices[0])).sum();
    assert!((between - sum).abs() <= 1e-8 * sum, "between the surfaces {between}, removed {sum}");
    for part in &removed.pieces.parts {
        let mesh = Mesh { triangles: part.triangles.clone(), ..before.clone() };
        assert_eq!(edges(&mesh), [0; 3], "piece {}", part.name);
    }
}

/// Edges of one triangle, of more than two, and of two that are oriented against each other.
fn edges(mesh: &Mesh) -> [usize; 3] {
    let found = Inspection::of(mesh);
    [found.border_edges, found.crowded_edges.count, found.opposed_edges.count]
}

#[test]
fn candidates_leave_a_sound_face_and_exact_volumes() {
    let face = height_mesh(160, [0.0, 8.0, 0.0, 8.0], rough);
    let blocks = candidates(&json!({}), 5);
    let with = json!({"count": 8, "min_depth_m": 0.05, "min_volume_m3": 0.002, "spacing_m": 0.5});
    let removed = remove(&face, &blocks, &[], &with).unwrap();
    check_sound(&face, &removed);
    assert!(removed.truth.features.len() >= 8);
    assert_eq!(removed.metric("pieces"), Some(removed.truth.features.len() as f64));
    let rejected = removed.attempts.rows.iter().filter(|row| row[6] == Cell::Flag(false)).count();
    let counted: f64 =
        ["border", "overlap", "depth", "size", "spacing", "empty", "non_manifold", "isolated", "boolean"]
            .iter()
            .filter_map(|word| removed.metric(&format!("rejected_{word}")))
            .sum();
    assert!((counted - rejected as f64).abs() < 0.5, "{rejected} {counted}");
}

#[test]
fn the_result_is_that_of_one_candidate_at_a_time_at_any_number_of_threads() {
    let face = height_mesh(60, [0.0, 3.0, 0.0, 3.0], rough);
    let blocks = candidates(&json!({}), 6);
    let with = json!({"count": 6, "max_failed_attempts": 60, "min_volume_m3": 0.001});
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| remove(&face, &blocks, &[], &with).unwrap())
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.mesh, three.mesh);
    assert_eq!((one.attempts, one.truth), (three.attempts, three.truth));
}

#[test]
fn the_trier_block_is_removed_where_it_is() {
    for name in ["cliff_trier_wall_pre", "cliff_trier_pre"] {
        let (Some(face), Some(block)) = (shared(&format!("faces/{name}.ply")), shared("faces/cliff_trier_block.ply"))
        else {
            return;
        };
        let face = Mesh { frame: Frame::Wall, ..ply::read_mesh(&face).unwrap() };
        let block = ply::read_mesh(&block).unwrap();
        let part = Part { name: "b".into(), class: "b".into(), vertices: block.vertices, triangles: block.triangles };
        let blocks = Artefact::Meshes(Meshes { frame: Frame::Wall, parts: vec![part] });
        let removed = remove(&face, &blocks, &[], &json!({"cell_m": 0.5})).unwrap();
        let volume = removed.metric("removed_volume").unwrap();
        assert!((volume / 14.9032 - 1.0).abs() < 1e-4, "{volume}");
        assert!(removed.warnings.is_empty());
    }
}

#[test]
fn each_check_rejects_what_it_is_for() {
    let face = height_mesh(40, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
    let own = |centres: &[[f64; 3]]| {
        let parts = centres.iter().map(|centre| cube(0.5, *centre)).collect();
        Artefact::Meshes(Meshes { frame: Frame::Wall, parts })
    };
    let reasons = |blocks: &Artefact, more: &[(&str, Artefact)], with: &Value| -> Vec<String> {
        let table = remove(&face, blocks, more, with).unwrap().attempts;
        table.rows.iter().map(|row| row[7].to_string()).collect()
    };
    let good = [1.03, 1.04, 0.0];
    let blocks = own(&[good, [3.9, 2.0, 0.0], [1.5, 1.2, 0.0], [2.0, 3.0, 0.24], [3.0, 3.0, 2.0], [3.0, 3.0, -2.0]]);
    let strict = json!({"min_depth_m": 0.1});
    assert_eq!(reasons(&blocks, &[], &strict), ["", "border", "overlap", "depth", "empty", "buried"]);
    let loose = json!({"min_depth_m": 0.1, "checks": {"depth": false, "overlap": false, "border": false}});
    let loosely = reasons(&blocks, &[], &loose);
    // The third has its floor in the plane of the first one's, which the Boolean may refuse for its own reasons.
    assert!(loosely[2] != "overlap");
    assert_eq!((loosely[1].as_str(), loosely[3].as_str()), ("", ""));
    let sizes = json!({"min_size_m": 0.6, "small_pieces": "reject"});
    assert!(remove(&face, &own(&[good]), &[], &sizes).unwrap_err().message.contains("size 1"));
    let near = own(&[good, [1.03, 2.3, 0.0]]);
    assert_eq!(reasons(&near, &[], &json!({"spacing_m": 1.3})), ["", "spacing"]);
    assert_eq!(reasons(&near, &[], &json!({"overlap_buffer_m": 1.0})), ["", "overlap"]);
    let grid = rockface_core::artefact::Grid { columns: 2, rows: 1, cell_m: 2.0, left_m: 0.0, top_m: 2.0 };
    let zone = Raster::single(grid, Frame::Wall, "mask", "zone", vec![1.0, 0.0]);
    let zone = [("zone", Artefact::Raster(zone))];
    assert_eq!(reasons(&own(&[good, [3.0, 1.0, 0.0]]), &zone, &json!({})), ["", "zone"]);
    let nothing = remove(&face, &own(&[[2.0, 2.0, 9.0]]), &[], &json!({})).unwrap_err();
    assert!(nothing.message.contains("0 of 1 pieces") && nothing.message.contains("empty 1"), "{nothing}");
    // What was tried is not lost with the failure.
    let evidence = nothing.evidence.unwrap().into_inner();
    let Artefact::Table(attempts) = &evidence["attempts"] else { panic!("no table") };
    assert_eq!((attempts.rows.len(), attempts.rows[0][7].to_string().as_str()), (1, "empty"));
}

#[test]
fn topology_checks_reject_what_they_are_for() {
    let face = height_mesh(40, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
    let joined = |solids: &[Part]| {
        let mut all = Part { name: "a".into(), class: "a".into(), vertices: Vec::new(), triangles: Vec::new() };
        for solid in solids {
            let base = all.vertices.len() as u32;
            all.vertices.extend(&solid.vertices);
            all.triangles.extend(solid.triangles.iter().map(|t| t.map(|v| v + base)));
        }
        all
    };
    let outcome = |face: &Mesh, block: Part, checks: Value| {
        let good = cube(0.3, [3.47, 3.51, 0.01]);
        let blocks = Artefact::Meshes(Meshes { frame: Frame::Wall, parts: vec![good, block] });
        remove(face, &blocks, &[], &json!({"checks": checks})).unwrap().attempts.rows[1][7].to_string()
    };
    // Two blocks that touch in a corner below the face leave a surface that touches itself there.
    let corner = [2.01, 2.02, -0.11];
    let tetrahedron = |side: f64| {
        let base = [[0.5, -0.3, 0.3], [0.5, 0.3, 0.3], [0.6, 0.02, -0.2]];
        let points = base.map(|p| [corner[0] + side * p[0], corner[1] + p[1], corner[2] + p[2]]);
        let solid = hull(&[&points[..], &[corner]].concat()).unwrap();
        Part { name: "t".into(), class: "t".into(), vertices: solid.vertices, triangles: solid.triangles }
    };
    let pinched = joined(&[tetrahedron(1.0), tetrahedron(-1.0)]);
    assert_eq!(outcome(&face, pinched.clone(), json!({})), "non_manifold");
    assert_eq!(outcome(&face, pinched, json!({"non_manifold": false})), "");
    // Two blocks in one mesh that run through each other.
    let through = joined(&[cube(0.5, [2.0, 2.0, 0.03]), cube(0.5, [2.21, 2.17, 0.05])]);
    assert_eq!(outcome(&face, through, json!({})), "self_intersection");
    // A block that widens inward reaches out of the side of the rock, below the border of the face: its niche has a hole there.
    let ring = |z: f64, half: f64| {
        [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]].map(|[x, y]| [0.41 + half * x, 2.02 + half * y, z])
    };
    let solid = hull(&[ring(0.2, 0.1), ring(-0.4, 0.5)].concat()).unwrap();
    let wide = Part { name: "w".into(), class: "w".into(), vertices: solid.vertices, triangles: solid.triangles };
    assert_eq!(outcome(&face, wide.clone(), json!({})), "border");
    assert_eq!(outcome(&face, wide.clone(), json!({"border": false})), "holes");
    assert_eq!(outcome(&face, wide, json!({"border": false, "holes": false})), "");
}

#[test]
fn candidates_that_are_no_block_count_with_their_size() {
    let face = height_mesh(40, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
    let rough = json!({"classes": [{"name": "slab", "shape": "prism", "size": {"volume": {"volume_m3": 0.002}},
        "modifiers": [{"roughness": {"sigma_m": 0.01, "edge_m": 0.04}}]}]});
    let removed = remove(&face, &candidates(&rough, 3), &[], &json!({"count": 4, "max_failed_attempts": 100})).unwrap();
    let failed: Vec<_> = removed.attempts.rows.iter().filter(|row| row[7].to_string() == "no_block").collect();
    assert!(!failed.is_empty() && failed.len() < removed.attempts.rows.len(), "{:?}", removed.metrics);
    // The volume before the roughness, to its class of a factor of three.
    let sized = |row: &&Vec<Cell>| row[1].to_string() == "slab" && (row[5].number().unwrap() - 0.002).abs() < 1e-9;
    assert!(failed.iter().all(sized), "{failed:?}");
}

#[test]
fn a_zone_that_cannot_be_that_of_the_face_is_warned_of() {
    let face = height_mesh(40, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
    let block = Artefact::Meshes(Meshes { frame: Frame::Wall, parts: vec![cube(0.5, [1.03, 1.04, 0.0])] });
    let warned = |columns: usize| {
        let grid = rockface_core::artefact::Grid { columns, rows: 42, cell_m: 0.1, left_m: -0.1, top_m: 4.1 };
        let zone = Raster::single(grid, Frame::Wall, "mask", "zone", vec![1.0; columns * 42]);
        remove(&face, &block, &[("zone", Artefact::Raster(zone))], &json!({})).unwrap().warnings
    };
    assert_eq!(warned(42), Vec::<String>::new());
    assert!(warned(50)[0].contains("0.90 m beyond the face"), "{:?}", warned(50));
}

#[test]
fn positions_of_a_table_are_taken_in_order() {
    let face = height_mesh(40, [0.0, 4.0, 0.0, 4.0], |x, _| 0.5 * x);
    let blocks = Artefact::Meshes(Meshes { frame: Frame::Wall, parts: vec![cube(0.4, [7.0; 3])] });
    let mut table = Table::new(["x_m", "y_m", "z_m", "spin_deg"]);
    table.push(vec![1.0.into(), 1.0.into(), Cell::Empty(()), 30.0.into()]);
    table.push(vec![3.0.into(), 2.0.into(), 1.5.into(), 0.0.into()]);
    let placement = [("placement", Artefact::Table(table))];
    let removed = remove(&face, &blocks, &placement, &json!({"refine_edge_m": 0.05})).unwrap();
    let row = |n: usize| removed.attempts.rows[n].iter().map(|cell| cell.number().unwrap_or(0.0)).collect::<Vec<_>>();
    // The first sits at its best depth along the normal, the second where it was put.
    let normal = [-0.5 / 1.25f64.sqrt(), 0.0, 1.0 / 1.25f64.sqrt()];
    let offset = (row(0)[2] - 1.0) / normal[0];
    assert!((row(0)[4] - 0.5 - offset * normal[2]).abs() < 1e-9 && (row(0)[3] - 1.0).abs() < 1e-12);
    assert!((row(1)[2] - 3.0).abs() < 1e-12 && (row(1)[4] - 1.5).abs() < 1e-12);
    assert!((row(0)[5] - 0.064).abs() < 1e-12 && row(0)[10] > 0.0 && row(0)[10] < 0.064);
    check_sound(&face, &removed);
}

#[test]
fn random_placements_never_panic_nor_leave_an_unsound_face() {
    let slow = std::env::var_os("ROCKFACE_SLOW").is_some();
    let wanted = if slow { 1000 } else { 60 };
    // A staircase with overhangs: coplanar treads, vertices on a lattice, risers that lean forward.
    let mut face = height_mesh(60, [0.0, 6.0, 0.0, 6.0], |_, y| (2.0 * y).floor() * 0.3);
    face.vertices.iter_mut().for_each(|v| v[1] += 0.35 * v[2]);
    // Cubes along the lattice: flush faces, touching vertices, edges in the plane.
    let shapes = json!({"classes": [
        {"shape": "prism", "size": {"axes": {"length_m": 0.4, "height_m": 0.4, "depth_m": 0.4}}},
        {"shape": "pyramid", "size": {"axes": {"length_m": 0.5, "height_m": 0.5, "depth_m": 0.3}}},
        {"shape": "ellipsoid", "modifiers": ["tumble"], "size": {"axes": {"length_m": 0.3, "height_m": 0.6, "depth_m": 0.4}}},
    ]});
    let blocks = candidates(&shapes, 9);
    let mut table = Table::new(["x_m", "y_m", "z_m"]);
    for n in 0..wanted {
        let lattice = |k: u32, step: f64| f64::from((n * 7919 + k * 104_729) % 53) * step;
        let (x, y) = (0.4 + 0.1 * lattice(1, 1.0).floor().min(52.0), 0.8 + lattice(2, 0.1));
        let z = if n % 3 == 0 { Cell::Empty(()) } else { (0.1 * lattice(3, 1.0) - 0.4).into() };
        table.push(vec![x.into(), y.into(), z]);
    }
    let placement = [("placement", Artefact::Table(table))];
    let with = json!({"max_failed_attempts": 1000, "direction": if slow { "local_normal" } else { "z" },
        "checks": {"overlap": false}});
    let removed = remove(&face, &blocks, &placement, &with).unwrap();
    assert_eq!(removed.attempts.rows.len(), wanted as usize);
    check_sound(&face, &removed);
    let accepted = removed.attempts.rows.iter().filter(|row| row[6] == Cell::Flag(true)).count();
    println!("{accepted} of {wanted} accepted; {:?}", removed.metrics);
    assert!(accepted * 10 > wanted as usize, "{accepted} of {wanted} accepted");
}

#[test]
fn real_faces_stay_sound() {
    let slow = std::env::var_os("ROCKFACE_SLOW").is_some();
    for (path, longest_m) in [("outcrop-survey/face.ply", 0.5), ("faces/cliff_trier_wall_pre.ply", 3.0)] {
        let Some(bytes) = shared(path) else { return };
        let face = Mesh { frame: Frame::Wall, ..ply::read_mesh(&bytes).unwrap() };
        let side = json!({"uniform": {"min": 0.2 * longest_m, "max": longest_m}});
        let size = json!({"axes": {"length_m": side, "height_m": side, "depth_m": side}});
        let class = |shape: &str| json!({"shape": shape, "size": size, "modifiers": ["tumble"]});
        let classes = json!({"classes": [class("prism"), class("ellipsoid"), class("pyramid"), class("trapezoid")]});
        let wanted = if slow { 100 } else { 4 };
        let with = json!({"count": wanted, "min_depth_m": 0.05 * longest_m, "cell_m": 0.1, "spacing_m": 0.1,
            "min_volume_m3": 1e-4 * longest_m * longest_m * longest_m});
        let removed = remove(&face, &candidates(&classes, 3), &[], &with).unwrap();
        println!("{path}: {:?}", removed.metrics);
        check_sound(&face, &removed);
        assert!(removed.metric("pieces").unwrap() >= f64::from(wanted) || slow, "{:?}", removed.warnings);
    }
}
