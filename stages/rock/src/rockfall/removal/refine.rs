//! Cuts the triangles under a block smaller before it is taken out, without moving the surface or opening it.

use std::collections::BTreeMap;

use super::face::Rect;
use super::patch::Patch;
use crate::rockfall::block::subdivide::{pieces, runs};

/// Rounds of halving after which even the longest edge is short.
const MOST_ROUNDS: usize = 24;
/// Triangles a patch may come to.
const MOST_TRIANGLES: usize = 1_000_000;

/// Halves edges longer than `edge_m` that reach into `rect` until there is none; border edges stay as they are.
///
/// An edge that reaches into the rectangle of the block has both its triangles in the patch, so that what lies outside keeps
/// its edges. Returns whether the patch stayed below a million triangles.
pub fn refine(patch: &mut Patch, rect: &Rect, edge_m: f64) -> bool {
    let local = Rect {
        low: [rect.low[0] - patch.origin[0], rect.low[1] - patch.origin[1]],
        high: [rect.high[0] - patch.origin[0], rect.high[1] - patch.origin[1]],
    };
    let Ok(mut border) = patch.border() else { return true };
    border.iter_mut().for_each(|edge| edge.sort_unstable());
    border.sort_unstable();
    for _ in 0..MOST_ROUNDS {
        if patch.triangles.len() > MOST_TRIANGLES {
            return false;
        }
        let picked = |patch: &Patch, a: u32, b: u32| {
            let ends = [patch.places[a as usize], patch.places[b as usize]];
            let square = (0..3).fold(0.0, |sum, k| sum + (ends[0][k] - ends[1][k]) * (ends[0][k] - ends[1][k]));
            square > edge_m * edge_m
                && Rect::around(&ends).overlaps(&local)
                && border.binary_search(&[a.min(b), a.max(b)]).is_err()
        };
        if !halve(patch, picked) {
            break;
        }
    }
    true
}

fn halve(patch: &mut Patch, pick: impl Fn(&Patch, u32, u32) -> bool) -> bool {
    let mut middles: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for triangle in 0..patch.triangles.len() {
        for (a, b) in runs(patch.triangles[triangle]) {
            let key = (a.min(b), a.max(b));
            if !middles.contains_key(&key) && pick(patch, a, b) {
                middles.insert(key, patch.places.len() as u32);
                let (p, q) = (patch.places[key.0 as usize], patch.places[key.1 as usize]);
                patch.places.push([0, 1, 2].map(|k| 0.5 * (p[k] + q[k])));
                patch.vertices.push(None);
            }
        }
    }
    let middle = |a: u32, b: u32| middles.get(&(a.min(b), a.max(b))).copied();
    let before = std::mem::take(&mut patch.triangles);
    let sources = std::mem::take(&mut patch.sources);
    for (triangle, source) in before.into_iter().zip(sources) {
        let parts = pieces(triangle, &patch.places, &middle);
        if parts.len() == 1 {
            patch.sources.push(source);
        } else {
            patch.consumed.extend(source);
            patch.sources.extend(parts.iter().map(|_| None));
        }
        patch.triangles.extend(parts);
    }
    !middles.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face::tetrahedra::volume_m3;
    use crate::rockfall::removal::face::Face;
    use crate::rockfall::removal::measure;
    use rockface_core::testing::height_mesh;

    #[test]
    fn a_refined_patch_is_the_same_surface_with_short_edges_and_its_old_border() {
        let mesh = height_mesh(8, [0.0, 4.0, 0.0, 4.0], |x, y| 0.3 * x * y);
        let face = Face::new(mesh.vertices, mesh.triangles);
        let rect = Rect { low: [1.2, 1.3], high: [2.1, 2.6] };
        let whole = Patch::around(&face, &rect, [1.0; 3]);
        let mut fine = whole.clone();
        assert!(refine(&mut fine, &rect, 0.1));
        assert_eq!(fine.border(), whole.border());
        let area = |patch: &Patch| measure::area_m2(&patch.places, &patch.triangles);
        let volume = |patch: &Patch| volume_m3(&patch.places, &patch.triangles, [0.0; 3]);
        assert!((area(&fine) - area(&whole)).abs() < 1e-12 && (volume(&fine) - volume(&whole)).abs() < 1e-12);
        assert!(fine.triangles.len() > 10 * whole.triangles.len());
        let kept = fine.sources.iter().flatten().count();
        assert_eq!(kept + fine.consumed.len(), whole.triangles.len());
    }
}
