//! Cutting triangles smaller without opening the mesh: every edge is cut for both its triangles at once.

use std::collections::BTreeMap;

use super::{Solid, squared_distance};

/// Triangles a block may have.
pub const MOST_TRIANGLES: usize = 1_000_000;

/// Cuts every edge longer than `edge_m` in halves until there is none; the surface stays where it is. `false` where that
/// would need more than a million triangles; the mesh is then as fine as it got.
pub fn to_edge(solid: &mut Solid, edge_m: f64) -> bool {
    let limit = edge_m * edge_m;
    while solid.triangles.len() <= MOST_TRIANGLES {
        let long = |solid: &Solid, a: u32, b: u32| solid.squared_distance(a, b) > limit;
        if !cut(solid, long) {
            return true;
        }
    }
    false
}

/// Cuts every triangle into four.
pub fn quarter(solid: &mut Solid) {
    cut(solid, |_, _, _| true);
}

/// Cuts the edges a rule picks (it must not depend on the direction) and the triangles with them; whether any was.
fn cut(solid: &mut Solid, pick: impl Fn(&Solid, u32, u32) -> bool) -> bool {
    let mut middles: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let before = solid.vertices.len() as u32;
    for triangle in 0..solid.triangles.len() {
        for (a, b) in runs(solid.triangles[triangle]) {
            if a < b && pick(solid, a, b) {
                middles.insert((a, b), before + middles.len() as u32);
                let (from, to) = (solid.vertices[a as usize], solid.vertices[b as usize]);
                solid.vertices.push([0, 1, 2].map(|axis| (from[axis] + to[axis]) * 0.5));
            }
        }
    }
    if middles.is_empty() {
        return false;
    }
    let middle = |a: u32, b: u32| middles.get(&(a.min(b), a.max(b))).copied();
    solid.triangles = solid.triangles.iter().flat_map(|t| pieces(*t, &solid.vertices, &middle)).collect();
    true
}

/// The three edges of a triangle, in its direction.
pub fn runs([a, b, c]: [u32; 3]) -> [(u32, u32); 3] {
    [(a, b), (b, c), (c, a)]
}

/// The one to four pieces of a triangle whose edges have these middles.
pub fn pieces(t: [u32; 3], vertices: &[[f64; 3]], middle: &impl Fn(u32, u32) -> Option<u32>) -> Vec<[u32; 3]> {
    let middles = runs(t).map(|(a, b)| middle(a, b));
    let turned = |by: usize| [0, 1, 2].map(|i| t[(i + by) % 3]);
    match middles {
        [None, None, None] => vec![t],
        [Some(p), Some(q), Some(r)] => vec![[t[0], p, r], [p, t[1], q], [r, q, t[2]], [p, q, r]],
        [Some(p), None, None] => halves(turned(0), p),
        [None, Some(p), None] => halves(turned(1), p),
        [None, None, Some(p)] => halves(turned(2), p),
        [Some(p), Some(q), None] => thirds(turned(0), p, q, vertices),
        [None, Some(p), Some(q)] => thirds(turned(1), p, q, vertices),
        [Some(q), None, Some(p)] => thirds(turned(2), p, q, vertices),
    }
}

fn halves([a, b, c]: [u32; 3], middle: u32) -> Vec<[u32; 3]> {
    vec![[a, middle, c], [middle, b, c]]
}

/// The corner between two cut edges, and the quadrilateral left over along its shorter diagonal.
fn thirds([a, b, c]: [u32; 3], p: u32, q: u32, vertices: &[[f64; 3]]) -> Vec<[u32; 3]> {
    let length = |i: u32, j: u32| squared_distance(vertices[i as usize], vertices[j as usize]);
    let rest = if length(a, q) <= length(p, c) { [[a, p, q], [a, q, c]] } else { [[a, p, c], [p, q, c]] };
    vec![[p, b, q], rest[0], rest[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::block::hull::hull;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_cut_mesh_stays_closed_and_keeps_its_volume(
            points in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 6..12),
            edge_m in 0.15f64..1.0,
        ) {
            let whole = hull(&points).unwrap();
            let mut cut = whole.clone();
            prop_assert!(to_edge(&mut cut, edge_m));
            prop_assert_eq!(cut.check_closed(), Ok(()));
            prop_assert!((cut.volume() - whole.volume()).abs() < 1e-12);
            let longest = cut.triangles.iter().flat_map(|t| runs(*t));
            let longest = longest.map(|(a, b)| cut.squared_distance(a, b));
            prop_assert!(longest.fold(0.0, f64::max) <= edge_m * edge_m);
        }
    }

    #[test]
    fn too_fine_an_edge_is_told() {
        let cube: Vec<[f64; 3]> = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from)).collect();
        assert!(!to_edge(&mut hull(&cube).unwrap(), 1e-4));
    }
}
