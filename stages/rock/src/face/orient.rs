//! Turns triangles over so that neighbours agree which side is outside.

use nalgebra::Vector3;

use super::half_edges::{HalfEdges, next};
use rockface_core::artefact::Mesh;

/// A surface with one side only, such as a Moebius strip: an edge where its two sides meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OneSided {
    /// A place on that edge, metres.
    pub place: [f64; 3],
}

/// Turns over as little area as makes the triangles of each piece agree; returns how many triangles were turned.
///
/// # Errors
/// A piece that has only one side.
pub fn make_coherent(mesh: &mut Mesh) -> Result<usize, OneSided> {
    let edges = HalfEdges::new(mesh);
    if !edges.all().any(|half| edges.is_opposed(half)) {
        return Ok(0);
    }
    let mut turned: Vec<Option<bool>> = vec![None; mesh.triangles.len()];
    let mut piece = Vec::new();
    for first in 0..mesh.triangles.len() {
        if turned[first].is_none() {
            spread(first, &edges, &mut turned, &mut piece)
                .map_err(|half| OneSided { place: mesh.vertices[edges.origin(half) as usize] })?;
            keep_the_larger_area(mesh, &piece, &mut turned);
        }
    }
    drop(edges);
    let mut count = 0;
    for (triangle, turned) in mesh.triangles.iter_mut().zip(turned) {
        if turned == Some(true) {
            triangle.swap(1, 2);
            count += 1;
        }
    }
    Ok(count)
}

/// Goes through the piece of a triangle; `Err` is a half-edge whose triangles cannot agree.
fn spread(first: usize, edges: &HalfEdges, turned: &mut [Option<bool>], piece: &mut Vec<u32>) -> Result<(), u32> {
    piece.clear();
    piece.push(first as u32);
    turned[first] = Some(false);
    let mut done = 0;
    while let Some(triangle) = piece.get(done).copied() {
        done += 1;
        let own = turned[triangle as usize] == Some(true);
        for half in 3 * triangle..3 * triangle + 3 {
            let Some(twin) = edges.twin(half) else { continue };
            let other = own != edges.is_opposed(half);
            match &mut turned[twin as usize / 3] {
                Some(known) if *known != other => return Err(half),
                Some(_) => {}
                unknown => {
                    *unknown = Some(other);
                    piece.push(twin / 3);
                }
            }
        }
    }
    Ok(())
}

fn keep_the_larger_area(mesh: &Mesh, piece: &[u32], turned: &mut [Option<bool>]) {
    let mut areas = [0.0; 2];
    for triangle in piece {
        let [a, b, c] = mesh.triangles[*triangle as usize].map(|i| Vector3::from(mesh.vertices[i as usize]));
        areas[usize::from(turned[*triangle as usize] == Some(true))] += (b - a).cross(&(c - a)).norm();
    }
    if areas[1] > areas[0] {
        piece.iter().for_each(|triangle| turned[*triangle as usize] = turned[*triangle as usize].map(|t| !t));
    }
}

/// Turns over the closed pieces of a mesh, or the open ones.
pub fn turn_over(mesh: &mut Mesh, closed: bool) {
    let edges = HalfEdges::new(mesh);
    let (piece_of, count) = edges.pieces();
    let mut is_closed = vec![true; count];
    let open = edges.all().filter(|half| edges.twin(*half).is_none());
    open.for_each(|half| is_closed[piece_of[half as usize / 3] as usize] = false);
    drop(edges);
    let turned = mesh.triangles.iter_mut().zip(piece_of).filter(|(_, piece)| is_closed[*piece as usize] == closed);
    turned.for_each(|(triangle, _)| triangle.swap(1, 2));
}

/// Drops, at vertices where pieces of surface meet in a point only, all of them but the largest; returns how many
/// triangles went.
pub fn drop_pinches(mesh: &mut Mesh) -> usize {
    let before = mesh.triangles.len();
    loop {
        let keep = unpinched(mesh);
        let mut flags = keep.iter();
        let count = mesh.triangles.len();
        mesh.triangles.retain(|_| flags.next().is_some_and(|keep| *keep));
        if mesh.triangles.len() == count {
            return before - count;
        }
    }
}

/// Which triangles lie in the largest fan (the first of several) of each of their corners.
fn unpinched(mesh: &Mesh) -> Vec<bool> {
    let edges = HalfEdges::new(mesh);
    let (fan_of, fans) = edges.fans();
    let mut sizes = vec![0u32; fans];
    fan_of.iter().for_each(|fan| sizes[*fan as usize] += 1);
    let mut largest: Vec<Option<u32>> = vec![None; mesh.vertices.len()];
    for half in edges.all() {
        let (fan, best) = (fan_of[half as usize], &mut largest[edges.origin(half) as usize]);
        if best.is_none_or(|other| sizes[other as usize] < sizes[fan as usize]) {
            *best = Some(fan);
        }
    }
    let is_main = |half: u32| largest[edges.origin(half) as usize] == Some(fan_of[half as usize]);
    let corners = |t: usize| [3 * t as u32, next(3 * t as u32), next(next(3 * t as u32))];
    (0..mesh.triangles.len()).map(|t| corners(t).into_iter().all(is_main)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::inspection::Inspection;
    use proptest::prelude::*;
    use rockface_core::artefact::Frame;
    use rockface_core::testing::height_mesh;

    proptest! {
        #[test]
        fn any_turned_triangles_are_turned_back_where_they_are_the_smaller_part(
            turned in prop::collection::vec(prop::bool::weighted(0.3), 128)
        ) {
            prop_assume!(turned.iter().filter(|t| **t).count() < 64);
            let whole = height_mesh(8, [0.0, 1.0, 0.0, 1.0], |_, _| 0.0);
            let mut mesh = whole.clone();
            mesh.triangles.iter_mut().zip(&turned).filter(|(_, t)| **t).for_each(|(triangle, _)| triangle.swap(1, 2));
            let count = make_coherent(&mut mesh).unwrap();
            prop_assert_eq!(count, turned.iter().filter(|t| **t).count());
            prop_assert_eq!(mesh, whole);
        }
    }

    #[test]
    fn a_moebius_strip_has_one_side() {
        let place = |k: u32| {
            let (k, side) = (f64::from(k / 2), if k.is_multiple_of(2) { -1.0 } else { 1.0 });
            let (sin, cos) = libm::sincos(k * std::f64::consts::TAU / 9.0);
            let (half_sin, half_cos) = libm::sincos(k * std::f64::consts::PI / 9.0);
            [(3.0 + side * half_cos) * cos, (3.0 + side * half_cos) * sin, side * half_sin]
        };
        let mut triangles: Vec<[u32; 3]> =
            (0..16).map(|k| if k & 1 == 0 { [k, k + 1, k + 2] } else { [k + 1, k, k + 2] }).collect();
        // The last square meets the first upside down.
        triangles.extend([[16, 17, 1], [17, 0, 1]]);
        let mut mesh =
            Mesh { frame: Frame::World, vertices: (0..18).map(place).collect(), triangles, colours: Vec::new() };
        assert!(make_coherent(&mut mesh).is_err());
    }

    #[test]
    fn pinches_go_with_the_smaller_part() {
        let mut mesh = height_mesh(4, [0.0, 1.0, 0.0, 1.0], |_, _| 0.0);
        // Without squares 1 and 4 the corner square 0 hangs on a vertex.
        let mut number = 0;
        mesh.triangles.retain(|_| {
            number += 1;
            ![1, 4].contains(&((number - 1) / 2))
        });
        assert_eq!(Inspection::of(&mesh).pinched_vertices.count, 1);
        assert_eq!(drop_pinches(&mut mesh), 2);
        assert_eq!(Inspection::of(&mesh).pinched_vertices.count, 0);
        assert_eq!(mesh.triangles.len(), 26);
    }
}
