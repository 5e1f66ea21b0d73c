//! The triangles of a cube of eight signed distances, for each of the 256 ways its corners can be inside.
//!
//! Corner c stands at (c & 1, c >> 1 & 1, c >> 2 & 1). The table is derived, not typed: on every face the inside corners that
//! follow each other are cut off by one segment, which both cubes of a face see alike, so surfaces close; the segments of a cube
//! join to loops, and loops are cut into fans.

use std::sync::LazyLock;

/// An edge by its axis and its corner nearer to the origin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Edge {
    /// 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// Its first corner; the second is one further along the axis.
    pub corner: usize,
}

impl Edge {
    fn between(a: usize, b: usize) -> Self {
        Self { axis: (a ^ b).trailing_zeros() as usize, corner: a.min(b) }
    }
}

static TABLE: LazyLock<Vec<Vec<[Edge; 3]>>> = LazyLock::new(|| (0..256).map(triangles_of).collect());

/// The triangles of a cube whose corner c is inside where bit c is set; counter-clockwise seen from outside.
pub fn triangles(inside: u8) -> &'static [[Edge; 3]] {
    &TABLE[usize::from(inside)]
}

fn triangles_of(inside: usize) -> Vec<[Edge; 3]> {
    let mut segments: Vec<(Edge, Edge)> = (0..6).flat_map(|face| face_segments(face, inside)).collect();
    let mut triangles = Vec::new();
    while let Some((start, mut end)) = segments.pop() {
        let mut path = vec![start];
        while end != start {
            path.push(end);
            let Some(next) = segments.iter().position(|(from, _)| *from == end) else { break };
            end = segments.swap_remove(next).1;
        }
        triangles.extend((1..path.len() - 1).map(|i| [path[0], path[i], path[i + 1]]));
    }
    triangles
}

/// Segments on a face from the edge where its boundary, counter-clockwise from outside, enters the inside to where it leaves it.
fn face_segments(face: usize, inside: usize) -> Vec<(Edge, Edge)> {
    let corners = face_corners(face);
    let is_in = |i: usize| inside >> corners[i % 4] & 1 == 1;
    let crossing = |i: usize| Edge::between(corners[i % 4], corners[(i + 1) % 4]);
    let entering = (0..4).filter(|i| !is_in(*i) && is_in(i + 1));
    entering
        .map(|i| {
            let leaves = (i + 1..i + 4).find(|j| is_in(*j) && !is_in(j + 1)).unwrap_or(i + 3);
            (crossing(i), crossing(leaves))
        })
        .collect()
}

/// The corners of a face, counter-clockwise from outside: faces 0, 1, 2 at the origin across x, y, z; 3, 4, 5 opposite.
fn face_corners(face: usize) -> [usize; 4] {
    let (axis, far) = (face % 3, face / 3);
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let base = far << axis;
    if far == 1 { [base, base | u, base | u | v, base | v] } else { [base, base | v, base | u | v, base | u] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn one_corner_is_cut_off_and_the_triangle_looks_away_from_it() {
        assert!(triangles(0).is_empty() && triangles(255).is_empty());
        let found = triangles(1);
        assert_eq!(found.len(), 1);
        let at = |edge: Edge| [0, 1, 2].map(|axis| if edge.axis == axis { 0.5 } else { 0.0 });
        let [a, b, c] = found[0].map(|edge| nalgebra::Vector3::from(at(edge)));
        assert!((b - a).cross(&(c - a)).dot(&nalgebra::Vector3::new(1.0, 1.0, 1.0)) > 0.0);
    }

    #[test]
    fn every_edge_that_crosses_is_used_and_no_other() {
        for inside in 0..=255u8 {
            let mut used = BTreeMap::new();
            for edge in triangles(inside).iter().flatten() {
                *used.entry((edge.axis, edge.corner)).or_insert(0) += 1;
            }
            for axis in 0..3 {
                for corner in (0..8).filter(|corner| corner >> axis & 1 == 0) {
                    let crosses = (inside >> corner ^ inside >> (corner | 1 << axis)) & 1 == 1;
                    assert_eq!(used.contains_key(&(axis, corner)), crosses, "{inside:08b}");
                }
            }
        }
    }

    #[test]
    fn inner_edges_of_a_cube_are_met_from_both_sides() {
        let name = |edge: Edge| edge.axis * 8 + edge.corner;
        for inside in 0..=255u8 {
            let mut directed = BTreeMap::new();
            for [a, b, c] in triangles(inside) {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *directed.entry((name(*from), name(*to))).or_insert(0) += 1;
                }
            }
            assert!(directed.values().all(|count| *count == 1), "{inside:08b}");
        }
    }
}
