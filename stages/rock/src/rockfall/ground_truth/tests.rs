//! Ground truth of scenes with known answers.

use nalgebra::{Rotation3, Vector3};

use super::scene::{Cap, faces};
use super::*;
use rockface_core::artefact::{Cell, Noun, Sample};

const CAP: Cap = Cap { rim_m: 0.8, depth_m: 0.3, centre: [0.25, -0.4] };

fn number(truth: &Truth, feature: usize, column: &str) -> f64 {
    truth.inventory.numbers(column).unwrap_or_else(|| panic!("no column {column}"))[feature].unwrap()
}

fn near(truth: &Truth, column: &str, expected: f64, tolerance: f64) {
    let found = number(truth, 0, column);
    assert!((found - expected).abs() <= tolerance * expected.abs().max(1e-3), "{column}: {found}, not {expected}");
}

#[test]
fn a_cap_out_of_a_plane_measures_what_geometry_says() {
    let (pre, post) = faces(&[CAP]);
    let truth = assemble(&pre, &post, &[CAP.piece(5)], 0.01, None).unwrap();
    near(&truth, "removed_m3", CAP.volume_m3(), 5e-4);
    near(&truth, "raster_m3", CAP.volume_m3(), 2e-3);
    near(&truth, "removed_share", 1.0, 1e-12);
    near(&truth, "depth_max_m", 0.3, 1e-3);
    near(&truth, "depth_mean_m", CAP.volume_m3() / (std::f64::consts::PI * 0.64), 5e-3);
    near(&truth, "niche_area_m2", CAP.sphere_area_m2(), 5e-4);
    near(&truth, "face_area_m2", std::f64::consts::PI * 0.64, 5e-4);
    near(&truth, "plan_area_m2", std::f64::consts::PI * 0.64, 5e-4);
    near(&truth, "cells", std::f64::consts::PI * 0.64 / 1e-4, 2e-3);
    near(&truth, "visible_fraction", 1.0, 1e-2);
    near(&truth, "short_m", 0.3, 1e-6);
    near(&truth, "long_m", 1.6, 1e-3);
    near(&truth, "centroid_x_m", 0.25, 1e-6);
    near(&truth, "p_radius_m", 0.8, 0.0);
    let class = truth.inventory.column("shape_class").unwrap();
    assert_eq!(truth.inventory.features[0].values[class], Cell::from("VP"));
}

#[test]
fn rasters_and_outline_agree_with_the_inventory() {
    let (pre, post) = faces(&[CAP]);
    let truth = assemble(&pre, &post, &[CAP.piece(5)], 0.02, None).unwrap();
    assert_eq!((truth.labels.sample, truth.labels.grid), (Sample::Word, truth.depth.grid));
    let labelled = truth.labels.bands[0].values.iter().filter(|v| v.to_bits() == 5f32.to_bits()).count();
    assert!((number(&truth, 0, "cells") - labelled as f64).abs() < 0.5);
    let deepest = truth.depth.bands[0].values.iter().copied().fold(0.0, f32::max);
    assert!((deepest - 0.3).abs() < 1e-3, "{deepest}");
    let [polygon] = truth.inventory.features[0].outline.as_slice() else { panic!("one polygon") };
    let ring = &polygon.exterior;
    let pairs = ring.iter().zip(ring.iter().cycle().skip(1));
    let area: f64 = pairs.map(|(a, b)| 0.5 * (a[0] * b[1] - b[0] * a[1])).sum();
    assert!((area - labelled as f64 * 4e-4).abs() < 1e-9 && polygon.holes.is_empty());
    assert!(truth.labels.encode().is_ok() && truth.inventory.encode().is_ok());
    let back = Meshes::decode(&truth.pieces.encode().unwrap()).unwrap();
    assert_eq!((back.parts[0].name.as_str(), back.parts[0].class.as_str()), ("5", "cap"));
}

#[test]
fn world_coordinates_follow_the_transform_either_way() {
    let turn = Rotation3::from_euler_angles(0.3, -0.2, 1.1).into_inner();
    let origin = Vector3::new(451_234.5, 5_512_345.25, 231.0);
    let wall_from_world = Transform::new("world", "wall", &turn, origin, Vector3::zeros());
    let (pre, post) = faces(&[CAP]);
    for transform in [wall_from_world.inverse(), wall_from_world.clone()] {
        let truth = assemble(&pre, &post, &[CAP.piece(1)], 0.1, Some(&transform)).unwrap();
        let world = ["x", "y", "z"].map(|axis| number(&truth, 0, &format!("position_world_{axis}_m")));
        let back = wall_from_world.apply(&world.into());
        assert!((back.coords - Vector3::new(0.25, -0.4, 0.0)).norm() < 3e-9);
    }
    let other = Transform::identity("comparison", "reference");
    let refused = assemble(&pre, &post, &[CAP.piece(1)], 0.1, Some(&other)).unwrap_err().message;
    assert!(refused.contains("from comparison to reference"));
}

#[test]
fn pieces_of_one_event_share_its_block_and_keep_their_own_parameters() {
    let (pre, post) = faces(&[CAP]);
    let (one, mut two) = (CAP.piece(1), CAP.piece(2));
    (two.event, two.parameters) = (1, vec![("depth_m".into(), 0.3)]);
    let truth = assemble(&pre, &post, &[one, two], 0.1, None).unwrap();
    assert_eq!((truth.blocks.parts.len(), truth.pieces.parts.len(), truth.niches.parts.len()), (1, 2, 2));
    let radii = truth.inventory.numbers("p_radius_m").unwrap();
    assert_eq!((radii[0].is_some(), radii[1].is_some()), (true, false));
    // The first of two pieces at one place has its cells.
    assert!(number(&truth, 1, "cells").abs() < 0.5);
    assert!(truth.inventory.features[1].outline.is_empty());
    let none = assemble(&pre, &pre, &[], 0.1, None).unwrap();
    assert!(none.inventory.features.is_empty() && none.inventory.encode().is_ok());
}

#[test]
fn faults_are_refused_by_piece() {
    let (pre, post) = faces(&[CAP]);
    let refused = |pieces: &[RemovedPiece]| assemble(&pre, &post, pieces, 0.1, None).unwrap_err().message;
    assert!(refused(&[CAP.piece(0)]).contains("piece 0"));
    assert!(refused(&[CAP.piece(70_000)]).contains("70000"));
    assert!(refused(&[CAP.piece(3), CAP.piece(3)]).contains("two pieces have the number 3"));
    let mut inside_out = CAP.piece(4);
    inside_out.removed.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    assert!(refused(&[inside_out]).contains("piece 4 of event 4: its rock has no positive volume"));
    let world = Mesh { frame: Frame::World, ..pre.clone() };
    assert!(assemble(&world, &post, &[], 0.1, None).unwrap_err().message.contains("before is in the world frame"));
}
