//! ICP of two surfaces of 211,600 points each, to planes, paired in plan and in space; the peer pairs in space.

use nalgebra::{Matrix4, Point3, Rotation3, Vector3};
use rockface_core::artefact::{Surface, Transform};
use rockface_imaging::fusion::icp::{Method, Pairing, Settings, register};

use crate::peer::{Peer, check};
use crate::row::Row;
use crate::{measure, relief};

/// Points along each side of a surface.
const SIDE: usize = 460;
/// Distance between points, metres.
const SPACING_M: f64 = 0.02;
/// Noise along Z, metres.
const NOISE_M: f64 = 0.002;
/// Points farther apart are no pair, metres.
const REACH_M: f64 = 0.1;

/// Measures and prints both rows.
pub fn measure() {
    let target = relief::surface(&relief::scattered(SIDE, SPACING_M, NOISE_M, 1), SIDE, [0.0; 3]);
    let turn = Rotation3::new(Vector3::new(0.001, -0.0015, 0.002));
    let shift = Vector3::new(0.01, -0.008, 0.015);
    let truth = |point: [f64; 3]| turn * Point3::from(point) + shift;
    let back = |point: &[f64; 3]| (turn.inverse() * (Point3::from(*point) - shift)).into();
    let moved: Vec<[f64; 3]> = relief::scattered(SIDE, SPACING_M, NOISE_M, 2).iter().map(back).collect();
    let source = relief::surface(&moved, SIDE, [0.0; 3]);
    let points = |surface: &Surface| (0..SIDE * SIDE).filter_map(|i| surface.point(i / SIDE, i % SIDE)).collect();
    let (source_points, target_points): (Vec<[f64; 3]>, Vec<[f64; 3]>) = (points(&source), points(&target));
    let peer = Peer::new();
    peer.give("source.f8", &source_points);
    peer.give("target.f8", &target_points);
    peer.give("reach.f8", &[REACH_M]);
    let answer = peer.work("icp", &[]);
    let apart_mm = |a: &dyn Fn([f64; 3]) -> Point3<f64>, b: &dyn Fn([f64; 3]) -> Point3<f64>| {
        let squares: f64 = source_points.iter().map(|p| (a(*p) - b(*p)).norm_squared()).sum();
        1e3 * (squares / source_points.len() as f64).sqrt()
    };
    for (pairing, words) in [(Pairing::InPlan, "in plan"), (Pairing::InSpace, "in space")] {
        let (found, cost) =
            measure::measure(|| register(&source, &target, &settings(pairing)).expect("both surfaces meet"));
        let transform: &Transform = &found.transform;
        let ours = |point: [f64; 3]| transform.apply(&Point3::from(point));
        let check = check(&answer, |_| {
            let matrix = Matrix4::from_row_slice(&peer.take::<f64>("transform.f8"));
            let theirs = |point: [f64; 3]| matrix.transform_point(&Point3::from(point));
            format!(
                "off the true motion: ours {:.3} mm, peer {:.3} mm; apart {:.3} mm",
                apart_mm(&ours, &truth),
                apart_mm(&theirs, &truth),
                apart_mm(&ours, &theirs)
            )
        });
        let what = format!("ICP to planes, pairs {words}: {} pairs, {} iterations", found.pairs, found.iterations);
        Row { what: &what, cost, peer: Some(&answer), check: &check }.print();
    }
}

fn settings(pairing: Pairing) -> Settings {
    Settings {
        method: Method::PointToPlane,
        pairing,
        trim: 1.0,
        max_distance_m: Some(REACH_M),
        points: SIDE * SIDE,
        max_iterations: 50,
        weak_eigenvalue: 0.0,
        between_points: pairing == Pairing::InPlan,
    }
}
