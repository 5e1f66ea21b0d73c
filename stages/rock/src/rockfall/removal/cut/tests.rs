//! Tests of the removal of one block: known shapes, the real cliff, and what cannot be taken.

use super::*;
use crate::rockfall::removal::face::{Face, Rect};
use crate::rockfall::removal::patch::open_edges;
use rockface_core::artefact::Mesh;
use rockface_core::format::ply;
use rockface_core::testing::{height_mesh, shared};

const MANNER: Manner =
    Manner { least: Least { volume_m3: 0.0, size_m: 0.0, depth_m: 0.0, whole_block: false }, look_for_crossings: true };

fn part(mesh: Mesh) -> Facets {
    Facets { vertices: mesh.vertices, triangles: mesh.triangles }
}

fn take(face: &Face, block: &Facets, manner: &Manner) -> Result<(Patch, Cut), Failure> {
    let patch = Patch::around(face, &Rect::around(&block.vertices), block.vertices[0]);
    let cut = cut(&patch, block, &Matrix3::identity(), manner)?;
    Ok((patch, cut))
}

/// A box between two corners.
fn cuboid(low: [f64; 3], high: [f64; 3]) -> Facets {
    let corner = |i: u32| [0, 1, 2].map(|k| if i >> k & 1 == 1 { high[k] } else { low[k] });
    let squares = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    Facets { vertices: (0..8).map(corner).collect(), triangles }
}

#[test]
fn the_trier_block_leaves_the_volume_its_authors_cut() {
    for name in ["cliff_trier_wall_pre", "cliff_trier_pre"] {
        let (Some(face), Some(block)) = (shared(&format!("faces/{name}.ply")), shared("faces/cliff_trier_block.ply"))
        else {
            return;
        };
        let (face, block) = (ply::read_mesh(&face).unwrap(), part(ply::read_mesh(&block).unwrap()));
        let (patch, cut) = take(&Face::new(face.vertices, face.triangles), &block, &MANNER).unwrap();
        assert_eq!((cut.pieces.len(), cut.spared, cut.crossed, cut.over_border), (1, 0, false, false));
        assert!((cut.pieces[0].volume_m3 / 14.9032 - 1.0).abs() < 1e-4, "{}", cut.pieces[0].volume_m3);
        // The authors' own mesh after it has 168 triangles more than that before.
        assert_eq!(cut.triangles.len() - cut.touched.len(), 168, "{}", patch.triangles.len());
    }
}

#[test]
fn a_box_in_a_plane_leaves_a_box() {
    let mesh = height_mesh(20, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
    let face = Face::new(mesh.vertices, mesh.triangles);
    // Beside the grid lines, along them, and flush with the plane.
    for (low, high) in [
        ([1.03, 1.07, -0.5], [2.01, 2.11, 0.25]),
        ([1.0, 1.0, -0.5], [2.0, 2.0, 0.25]),
        ([1.0, 1.0, -0.5], [2.0, 2.0, 0.0]),
    ] {
        let (patch, cut) = take(&face, &cuboid(low, high), &MANNER).unwrap();
        let piece = &cut.pieces[0];
        let area = (high[0] - low[0]) * (high[1] - low[1]);
        assert!((piece.volume_m3 - 0.5 * area).abs() < 1e-12, "{}", piece.volume_m3);
        assert!((piece.area_m2 - area).abs() < 1e-12 && (piece.depth_m - 0.5).abs() < 1e-12, "{piece:?}");
        let sides = 2.0 * ((high[0] - low[0]) + (high[1] - low[1]));
        let niche = measure::area_m2(&piece.niche.vertices, &piece.niche.triangles);
        assert!((niche - area - 0.5 * sides).abs() < 1e-12);
        assert_eq!(open_edges(&piece.removed.triangles), Ok(vec![]));
        let gone = |n: &usize| !cut.touched.contains(&(*n as u32));
        let kept = (0..patch.triangles.len()).filter(gone).map(|n| patch.triangles[n]);
        let after: Vec<[u32; 3]> = kept.chain(cut.triangles.iter().map(|(t, _)| *t)).collect();
        assert_eq!(open_edges(&after).unwrap(), patch.border().unwrap());
    }
}

#[test]
fn a_bar_through_two_ridges_takes_two_pieces_and_spares_the_smaller() {
    let ridges = |x: f64, _| if x < 2.0 { 1.0 - (x - 1.0).abs() } else { 0.8 - (x - 3.0).abs() };
    let mesh = height_mesh(80, [0.0, 4.0, 0.0, 4.0], ridges);
    let face = Face::new(mesh.vertices, mesh.triangles);
    let bar = cuboid([0.1, 1.5, 0.5], [3.9, 2.5, 3.0]);
    let (_, both) = take(&face, &bar, &MANNER).unwrap();
    let volumes: Vec<f64> = both.pieces.iter().map(|piece| piece.volume_m3).collect();
    assert_eq!(volumes.len(), 2);
    assert!((volumes[0] - 0.25).abs() < 1e-12 && (volumes[1] - 0.09).abs() < 1e-12, "{volumes:?}");
    let least = Least { volume_m3: 0.1, ..MANNER.least };
    let (patch, one) = take(&face, &bar, &Manner { least, ..MANNER }).unwrap();
    assert_eq!((one.pieces.len(), one.spared > 0), (1, true));
    let gone = |n: &usize| !one.touched.contains(&(*n as u32));
    let kept = (0..patch.triangles.len()).filter(gone).map(|n| patch.triangles[n]);
    let after: Vec<[u32; 3]> = kept.chain(one.triangles.iter().map(|(t, _)| *t)).collect();
    assert_eq!(open_edges(&after).unwrap(), patch.border().unwrap());
    let whole = Least { whole_block: true, ..least };
    let refused = take(&face, &bar, &Manner { least: whole, ..MANNER }).unwrap_err();
    assert_eq!(refused, Failure::Refused(Threshold::Size));
}

#[test]
fn what_cannot_be_taken_says_why() {
    let mesh = height_mesh(20, [0.0, 4.0, 0.0, 4.0], |x, _| 0.1 * x);
    let face = Face::new(mesh.vertices, mesh.triangles);
    let failure = |low, high| take(&face, &cuboid(low, high), &MANNER).unwrap_err();
    assert_eq!(failure([1.0, 1.0, 2.0], [2.0, 2.0, 3.0]), Failure::Empty);
    assert_eq!(failure([1.0, 1.0, -3.0], [2.0, 2.0, -2.0]), Failure::Buried);
    assert!(matches!(failure([2.0, 2.0, 1.0], [1.0, 1.0, -1.0]), Failure::Block(_)));
    let open = Facets { triangles: cuboid([1.0; 3], [2.0; 3]).triangles[2..].to_vec(), ..cuboid([1.0; 3], [2.0; 3]) };
    assert!(matches!(take(&face, &open, &MANNER), Err(Failure::Block(_))));
    let (_, over) = take(&face, &cuboid([3.5, 1.0, -1.0], [5.0, 2.0, 1.0]), &MANNER).unwrap();
    assert!(over.over_border);
}
