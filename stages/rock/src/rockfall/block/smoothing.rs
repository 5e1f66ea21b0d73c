//! Untangling scanned blocks: vertices where the surface passes through itself are drawn towards their neighbours.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::crossing;
use super::{Solid, squared_distance};

/// Rounds after which it is given up.
const ROUNDS: usize = 50;

/// How far the vertices of a block were moved, and what is still tangled.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Untangled {
    /// Vertices that were moved.
    pub vertices: usize,
    /// How far the farthest was moved, metres.
    pub farthest_m: f64,
    /// Pairs of triangles that still pass through each other.
    pub left: usize,
}

/// Moves the corners of triangles that pass through each other half way to the mean of their neighbours, until none does.
///
/// A surface folded over itself by a hair, as scanning programs leave it, comes free within a few rounds.
pub fn untangle(solid: &mut Solid) -> Untangled {
    let before = solid.vertices.clone();
    let mut left = crossing::all(solid);
    for _ in 0..ROUNDS {
        if left.is_empty() {
            break;
        }
        let corners: BTreeSet<u32> = left.iter().flat_map(|(a, b)| [*a, *b]).flat_map(|t| solid.triangles[t]).collect();
        relax(solid, &corners);
        left = crossing::all(solid);
    }
    let moves = before.iter().zip(&solid.vertices).map(|(a, b)| squared_distance(*a, *b));
    let (vertices, farthest) =
        moves.fold((0, 0.0f64), |(count, far), moved| (count + usize::from(moved > 0.0), far.max(moved)));
    Untangled { vertices, farthest_m: farthest.sqrt(), left: left.len() }
}

fn relax(solid: &mut Solid, which: &BTreeSet<u32>) {
    let mut sums = vec![(Vector3::zeros(), 0.0); solid.vertices.len()];
    for t in &solid.triangles {
        for i in (0..3).filter(|i| which.contains(&t[*i])) {
            let (sum, count) = &mut sums[t[i] as usize];
            // Around a closed fan each neighbour follows exactly one other.
            *sum += Vector3::from(solid.vertices[t[(i + 1) % 3] as usize]);
            *count += 1.0;
        }
    }
    for vertex in which.iter().map(|v| *v as usize) {
        let (sum, count) = sums[vertex];
        let mean = sum * (1.0 / count);
        solid.vertices[vertex] = ((Vector3::from(solid.vertices[vertex]) + mean) * 0.5).into();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::block::hull::hull;
    use crate::rockfall::block::subdivide;

    #[test]
    fn a_vertex_pushed_through_the_far_side_comes_back() {
        let cube: Vec<[f64; 3]> = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from)).collect();
        let mut solid = hull(&cube).unwrap();
        subdivide::to_edge(&mut solid, 0.2);
        assert_eq!(untangle(&mut solid.clone()), Untangled::default());
        let inner = solid.vertices.iter().position(|v| v[2] > 0.999 && (v[0] - 0.5).abs() + (v[1] - 0.5).abs() < 0.1);
        solid.vertices[inner.unwrap()][2] = -0.3;
        assert!(solid.check().is_err());
        let done = untangle(&mut solid);
        assert_eq!((done.left, solid.check()), (0, Ok(())));
        assert!(done.vertices > 0 && done.farthest_m > 0.1);
    }
}
