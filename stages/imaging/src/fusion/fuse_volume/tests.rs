//! `fuse-volume` on a sphere, a plane and a ledge that hangs over, against 2.5D fusion, and its refusals.

use super::*;
use crate::camera::model::Camera;
use crate::depth::depth_buffer::{Drawing, draw, rounded};
use nalgebra::Vector3;
use rockface_core::Point;
use rockface_core::artefact::{Artefact, Frame, Image, Mesh, Noun, Raster, Sensor};
use rockface_core::testing::stage;
use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::Arc;

fn sensor() -> Sensor {
    Sensor { width_px: 240, height_px: 200, f: 400.0, cx: 119.5, cy: 99.5, ..small_sensor() }
}

/// Depth map by a function of the ray: centre and direction (z component of length 1 along the axis).
fn depth_of(image: Image, z: impl Fn(Vector3<f64>, Vector3<f64>) -> Option<f64>) -> Depth {
    let camera = Camera::new(&sensor(), &image);
    let at = |i: usize| {
        let ray = camera.normalised([(i % 240) as f64, (i / 240) as f64]).unwrap();
        z(camera.centre(), camera.direction(ray)).map_or(f32::NAN, |z| z as f32)
    };
    let z = (0..240 * 200).map(at).collect();
    let (sensor, width, height) = (sensor(), 240, 200);
    Depth { frame: Frame::Wall, sensor, image, downscale: 1, width, height, z, channels: [].into() }
}

fn sphere(centre: Vector3<f64>, direction: Vector3<f64>) -> Option<f64> {
    let (a, b, c) = (direction.norm_squared(), centre.dot(&direction), centre.norm_squared() - 1.0);
    let inside = b * b - a * c;
    (inside > 0.0).then(|| (-b - inside.sqrt()) / a)
}

fn stations() -> [Image; 4] {
    let place = |x: f64, y: f64| (Vector3::new(x, y, 0.0), 0.25);
    let image = |(name, (at, tilt)): (&str, (Vector3<f64>, f64))| {
        let z = 4.0;
        image_at(name, [at.x, at.y, z], [tilt * at.y, tilt * at.x, 0.0])
    };
    [("a", place(-1.0, 0.0)), ("b", place(1.0, 0.0)), ("c", place(0.0, 1.0)), ("d", place(0.0, -1.0))].map(image)
}

fn fuse(depths: &[Depth], with: &Value) -> Result<Mesh, StageError> {
    let inputs: Vec<_> = depths.iter().map(|depth| ("depths", Artefact::Depth(depth.clone()))).collect();
    let outputs = run_stage::<FuseVolume>(&TestHost::default(), with, &inputs)?.into_inner();
    Ok(Mesh::of(&outputs["mesh"]).unwrap().clone())
}

/// Edges that only one triangle has.
fn open_edges(mesh: &Mesh) -> Vec<(u32, u32)> {
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    for [a, b, c] in &mesh.triangles {
        for (from, to) in [(*a, *b), (*b, *c), (*c, *a)] {
            *edges.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
    }
    edges.into_iter().filter(|(_, count)| *count != 0).map(|(edge, _)| edge).collect()
}

#[test]
fn a_sphere_comes_back_within_a_tenth_of_a_voxel_and_faces_the_cameras() {
    let depths = stations().map(|image| depth_of(image, sphere));
    let mesh = fuse(&depths, &json!({"voxel_m": 0.03})).unwrap();
    let mut worst = 0.0f64;
    for vertex in mesh.vertices.iter().filter(|v| v[2] > 0.75) {
        worst = worst.max((Vector3::from(*vertex).norm() - 1.0).abs());
    }
    assert!(worst < 0.003, "{worst}");
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| Vector3::from(mesh.vertices[i as usize]));
        let normal = (b - a).cross(&(c - a));
        assert!(a.z < 0.75 || normal.dot(&a) > 0.0);
    }
    // Seen from above: closed but for its lower rim.
    let open = open_edges(&mesh);
    assert!(open.iter().all(|(a, _)| mesh.vertices[*a as usize][2] < 0.75), "{}", open.len());
}

#[test]
fn a_plane_agrees_with_the_grids_of_its_images() {
    let plane = |centre: Vector3<f64>, direction: Vector3<f64>| {
        Some((0.1 * centre.x + 0.3 - centre.z) / (direction.z - 0.1 * direction.x))
    };
    let depths = stations().map(|image| depth_of(image, plane));
    let window = [-0.8, 0.8, -0.6, 0.6];
    let mesh = fuse(&depths, &json!({"voxel_m": 0.02, "window_m": window})).unwrap();
    let worst = mesh.vertices.iter().map(|v| (v[2] - 0.3 - 0.1 * v[0]).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-3, "{worst}");
    let mut grids = Inputs::default();
    for depth in &depths {
        let mut inputs = Inputs::default();
        inputs.push("depth", Point::new(), Arc::new(depth.clone().into()));
        let with = json!({"cell_m": 0.02, "sigma_m": 0.01, "window_m": window});
        let outputs =
            stage(crate::depth::STAGES, "grid-depth").run(&with, &inputs, &Context::new(&TestHost::default())).unwrap();
        let grid = outputs.into_inner().remove("grid").unwrap();
        grids.push("grids", Point::new(), Arc::new(grid));
    }
    let fused = stage(crate::fusion::STAGES, "fuse-grids")
        .run(&json!({}), &grids, &Context::new(&TestHost::default()))
        .unwrap();
    let raster = fused.into_inner().remove("raster").unwrap();
    let raster = Raster::of(&raster).unwrap();
    let mut compared = 0;
    for vertex in mesh.vertices.iter().filter(|v| v[0].abs() < 0.7 && v[1].abs() < 0.5) {
        let column = ((vertex[0] - raster.grid.left_m) / 0.02) as usize;
        let row = ((raster.grid.top_m - vertex[1]) / 0.02) as usize;
        let (x, _) = raster.grid.centre(row, column);
        let z = f64::from(raster.bands[0].values[row * raster.grid.columns + column]) + 0.1 * (vertex[0] - x);
        // The pixels of a cell are not spread evenly in it: a slope of 10 % over half a cell at most.
        assert!((z - vertex[2]).abs() < 2e-3, "{z} {vertex:?}");
        compared += 1;
    }
    assert!(compared > 1000);
}

/// A wall at Z = 0 with a slab standing out to Z = 0.5 above Y = 0, whose underside cameras below see.
fn ledge() -> Mesh {
    let mut mesh = height_mesh(2, [-3.0, 3.0, -3.0, 0.0], |_, _| 0.0);
    let add = |mesh: &mut Mesh, corners: [[f64; 3]; 4]| {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(corners);
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    };
    add(&mut mesh, [[-3.0, 0.0, 0.5], [3.0, 0.0, 0.5], [3.0, 3.0, 0.5], [-3.0, 3.0, 0.5]]);
    add(&mut mesh, [[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.0, 0.5], [-3.0, 0.0, 0.5]]);
    mesh
}

#[test]
fn the_underside_of_a_ledge_is_kept() {
    let mesh = ledge();
    let look = |name: &str, x: f64, y: f64, up: f64| {
        let image = image_at(name, [x, y, 3.0], [-up, 0.0, 0.0]);
        let camera = Camera::new(&sensor(), &image);
        let buffer =
            draw(&mesh, &camera, &Drawing { downscale: 1, safe_border_px: 0.0, front_only: false, window_m: None });
        let z = buffer.z_m.iter().map(|z| rounded(*z)).collect();
        let (sensor, width, height) = (sensor(), 240, 200);
        Depth { frame: Frame::Wall, sensor, image, downscale: 1, width, height, z, channels: [].into() }
    };
    let tilt = |sign: f64| [look("a", -0.3, -2.0, 0.6 * sign), look("b", 0.3, -2.0, 0.6 * sign)];
    let seen = |depths: &[Depth; 2]| depths[0].z.iter().filter(|z| z.is_finite()).count();
    // Whichever sign looks up sees the ledge.
    let (up, down) = (tilt(1.0), tilt(-1.0));
    let depths = if seen(&up) > seen(&down) { up } else { down };
    let fused = fuse(&depths, &json!({"voxel_m": 0.03, "window_m": [-0.6, 0.6, -1.0, 1.0]})).unwrap();
    let under: Vec<_> = fused.vertices.iter().filter(|v| v[2] > 0.1 && v[2] < 0.4).collect();
    assert!(under.len() > 200, "{}", under.len());
    assert!(under.iter().all(|v| v[1].abs() < 0.02), "underside at Y = 0");
}

#[test]
fn threads_change_nothing_and_pieces_go() {
    let depths = stations().map(|image| depth_of(image, sphere));
    let with = json!({"voxel_m": 0.06});
    let bytes = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fuse(&depths, &with).unwrap().encode().unwrap())
    };
    assert_eq!(bytes(1), bytes(3));
    let error = fuse(&depths, &json!({"voxel_m": 0.06, "min_component_triangles": 100_000})).unwrap_err();
    assert!(error.message.contains("no surface"), "{error}");
}

#[test]
fn it_says_what_does_not_fit() {
    let [a, b, ..] = stations().map(|image| depth_of(image, sphere));
    let with = json!({"voxel_m": 0.06});
    let error = |depths: &[Depth], with: &Value| fuse(depths, with).unwrap_err().message;
    let other = Depth { frame: Frame::World, ..b.clone() };
    assert!(error(&[a.clone(), other], &with).contains("world frame"));
    let mut weighed = b.clone();
    weighed.channels.insert("sigma".into(), vec![0.01; b.z.len()]);
    assert!(error(&[a.clone(), weighed], &with).contains("1 of 2 depth maps have a channel"));
    let empty = Depth { z: vec![f32::NAN; b.z.len()], ..b.clone() };
    assert!(error(&[empty], &with).contains("none of 1 depth maps"));
    assert!(error(std::slice::from_ref(&a), &with).contains("no surface that 2"));
    let with = json!({"voxel_m": 0.0001, "truncation_m": 0.05});
    let faults = rockface_core::AnyStage::check(&rockface_core::Row::<FuseVolume>::new(), &with).unwrap_err();
    assert_eq!(faults[0].path, ["truncation_m"]);
}
