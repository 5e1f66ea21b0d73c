//! One depth map of 20 megapixels from a face of 5.2 million triangles; rays of Embree through the same pixels.

use std::sync::Arc;

use rockface_core::artefact::{Artefact, Cameras, Frame, Sensor};
use rockface_core::testing::image_at;
use rockface_imaging::camera::model::Camera;
use rockface_imaging::camera::ray_row::RayRow;
use serde_json::json;

use crate::measure;
use crate::peer::{Peer, check};
use crate::row::Row;
use crate::stages;

/// Depths that differ by more are those of another triangle, beyond an edge that hides others, metres.
const ANOTHER_M: f32 = 1e-3;

/// Measures and prints the row.
pub fn measure() {
    let face = json!({"width_m": 35.6, "height_m": 29, "spacing_m": 0.02, "relief_m": 0.25, "roughness_m": 0.005,
        "joints": [{"dip_deg": 85, "direction_deg": 10, "spacing_m": 2.5, "step_m": 0.3, "persistence": 0.7},
                   {"dip_deg": 70, "direction_deg": 110, "spacing_m": 3.0, "step_m": 0.25, "persistence": 0.6}],
        "bedding": {"dip_deg": 6, "direction_deg": 90, "thickness_m": 1.5, "step_m": 0.3}});
    let face = stages::run("synthesise-face", &face, &[]);
    let cameras = cameras();
    let artefact = Arc::new(Artefact::Cameras(cameras.clone()));
    let given = [("mesh", &face), ("cameras", &artefact)];
    let with = json!({"image": "one"});
    let (map, cost) = measure::measure(|| stages::run("project-depth", &with, &given));
    let (Artefact::Mesh(mesh), Artefact::Depth(map)) = (&*face, &*map) else { panic!("a mesh and its depth map") };

    let peer = Peer::new();
    peer.give("vertices.f8", &mesh.vertices);
    peer.give("triangles.u4", &mesh.triangles);
    peer.give("rays.f4", &rays(&cameras));
    let answer = peer.work("depth", &[("standing_cpu_s", "with the scene built before, CPU")]);
    let check = check(&answer, |_| compare(&map.z, &peer.take::<f32>("depth.f4")));
    let pixels = map.z.len() as f64 / 1e6;
    let what = format!(
        "depth map of {pixels:.0} Mpx, {:.1} M triangles: {:.1} Mpx/s",
        mesh.triangles.len() as f64 / 1e6,
        pixels / cost.wall_s
    );
    Row { what: &what, cost, peer: Some(&answer), check: &check }.print();
}

/// A camera 40 m before the face whose image the face fills.
fn cameras() -> Cameras {
    let (width_px, height_px) = (5472, 3648);
    let sensor = Sensor {
        name: "one".to_owned(),
        width_px,
        height_px,
        f: 7817.0,
        cx: 0.5 * f64::from(width_px - 1),
        cy: 0.5 * f64::from(height_px - 1),
        b1: 0.0,
        b2: 0.0,
        k: [-0.05, 0.02, 0.0, 0.0],
        p: [0.0; 2],
    };
    let image = image_at("one", [3.0, 1.0, 40.0], [0.0; 3]);
    Cameras { frame: Frame::Wall, sensors: vec![sensor], images: vec![image] }
}

/// Origin and direction of the ray through every pixel; the direction is as long as one metre of depth.
fn rays(cameras: &Cameras) -> Vec<[f32; 6]> {
    let camera = Camera::new(&cameras.sensors[0], &cameras.images[0]);
    let origin = camera.centre();
    let (width, height) = (camera.sensor().width_px as usize, camera.sensor().height_px as usize);
    let mut rays = Vec::with_capacity(width * height);
    for row in 0..height {
        let mut of_row = RayRow::new(&camera, row, 1);
        for column in 0..width {
            let d = camera.direction(of_row.ray(column).unwrap_or([f64::NAN; 2]));
            rays.push([origin.x, origin.y, origin.z, d.x, d.y, d.z].map(|value| value as f32));
        }
    }
    rays
}

fn compare(ours: &[f32], theirs: &[f32]) -> String {
    assert_eq!(ours.len(), theirs.len());
    let both = ours.iter().zip(theirs).filter(|(a, b)| a.is_finite() || b.is_finite());
    // A depth that only one side has differs by more than any.
    let mut apart_m: Vec<f32> =
        both.map(|(a, b)| (a - b).abs()).map(|d| if d.is_nan() { f32::MAX } else { d }).collect();
    apart_m.sort_unstable_by(f32::total_cmp);
    let others = apart_m.len() - apart_m.partition_point(|apart_m| *apart_m <= ANOTHER_M);
    let usual_um = 1e6 * apart_m[(apart_m.len() - 1) / 10_000 * 9_999];
    format!("{others} pixels see another edge; 99.99 % of the depths within {usual_um:.0} µm (rays of 32 bits)")
}
