//! M3C2 of two clouds of 2.1 million points at 262,000 core points; py4dgeo with the same radii.

use rockface_analysis::detection::cloud::Cloud;
use rockface_analysis::detection::m3c2::{Scales, cores, distances};
use rockface_core::artefact::{self, Frame, Grid};
use rockface_raster::shape::Shape;

use crate::peer::{Peer, check};
use crate::row::Row;
use crate::{measure, relief};

/// Points along each side of a cloud.
const SIDE: usize = 1449;
/// Distance between points, metres.
const SPACING_M: f64 = 0.02;
/// Core points along each side.
const CORES: usize = 512;

/// Measures and prints the row.
pub fn measure() {
    let clouds = [1, 2].map(|seed| artefact::Cloud::new(Frame::Wall, relief::scattered(SIDE, SPACING_M, 0.005, seed)));
    let scales = Scales {
        normal_radii_m: vec![0.25],
        projection_radius_m: 0.05,
        depth_m: 1.0,
        registration_m: 0.005,
        least_points: 5,
    };
    let sorted = |cloud| Cloud::new(Shape::Cloud(cloud), None, scales.projection_radius_m).expect("points");
    let extent_m = SPACING_M * SIDE as f64;
    let grid = Grid { columns: CORES, rows: CORES, cell_m: extent_m / CORES as f64, left_m: 0.0, top_m: extent_m };
    let cores: Vec<_> = cores(&sorted(&clouds[0]), &grid).into_iter().flatten().map(Some).collect();
    let (found, cost) = measure::measure(|| {
        let sorted = [&clouds[0], &clouds[1]].map(sorted);
        distances([&sorted[0], &sorted[1]], &cores, &scales)
    });

    let peer = Peer::new();
    peer.give("reference.f8", &clouds[0].points);
    peer.give("comparison.f8", &clouds[1].points);
    peer.give("cores.f8", &cores.iter().flatten().copied().collect::<Vec<_>>());
    let reach = [scales.normal_radii_m[0], scales.projection_radius_m, scales.depth_m, scales.registration_m];
    peer.give("scales.f8", &reach);
    let answer = peer.work("m3c2", &[]);
    let check = check(&answer, |_| {
        let ours = found.iter().map(|found| found.map_or(f64::NAN, |found| found.distance_m));
        let theirs = peer.take::<f64>("distances.f8");
        let apart = ours.zip(&theirs).map(|(a, b)| (a - b).abs()).filter(|apart| !apart.is_nan());
        let (count, greatest_m) = apart.fold((0, 0.0f64), |(count, most), apart| (count + 1, most.max(apart)));
        format!("{count} distances, greatest difference {greatest_m:.0e} m")
    });
    let millions = clouds[0].points.len() as f64 / 1e6;
    let what = format!("M3C2, {} core points, two clouds of {millions:.1} M points", cores.len());
    Row { what: &what, cost, peer: Some(&answer), check: &check }.print();
}
