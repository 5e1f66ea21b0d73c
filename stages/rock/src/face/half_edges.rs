//! Which triangles meet at the edges and vertices of a mesh, whatever is wrong with it.
//!
//! Half-edge `3 t + k` runs along triangle `t` from corner `k` to the next; a corner has the number of the half-edge that
//! leaves it.

use rayon::prelude::*;

use rockface_core::artefact::Mesh;
use rockface_core::numerics::union_find::UnionFind;

/// The other half-edge of a half-edge on the border.
pub const BORDER: u32 = u32::MAX;
/// The other half-edge where three or more triangles meet.
pub const CROWDED: u32 = u32::MAX - 1;

/// The half-edge after this one in its triangle.
#[inline]
pub fn next(half: u32) -> u32 {
    if half % 3 == 2 { half - 2 } else { half + 1 }
}

/// The edges of a mesh.
#[derive(Debug, Clone)]
pub struct HalfEdges<'a> {
    triangles: &'a [[u32; 3]],
    /// Of each half-edge the other one on its edge, in whichever direction that runs, or [`BORDER`] or [`CROWDED`].
    pub twins: Vec<u32>,
}

impl<'a> HalfEdges<'a> {
    /// Pairs the half-edges. Triangles must have three different corners.
    pub fn new(mesh: &'a Mesh) -> Self {
        let triangles = mesh.triangles.as_slice();
        let mut twins = vec![BORDER; 3 * triangles.len()];
        let edge = |half: u32| {
            let (a, b) = (
                triangles[half as usize / 3][half as usize % 3],
                triangles[half as usize / 3][next(half) as usize % 3],
            );
            (a.min(b), a.max(b), half)
        };
        let mut edges: Vec<(u32, u32, u32)> = (0..twins.len() as u32).into_par_iter().map(edge).collect();
        edges.par_sort_unstable();
        for group in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            match group {
                [_] => {}
                [one, other] => {
                    twins[one.2 as usize] = other.2;
                    twins[other.2 as usize] = one.2;
                }
                crowd => crowd.iter().for_each(|(_, _, half)| twins[*half as usize] = CROWDED),
            }
        }
        Self { triangles, twins }
    }

    /// The vertex a half-edge leaves.
    #[inline]
    pub fn origin(&self, half: u32) -> u32 {
        self.triangles[half as usize / 3][half as usize % 3]
    }

    /// The other half-edge, where exactly two triangles meet.
    #[inline]
    pub fn twin(&self, half: u32) -> Option<u32> {
        Some(self.twins[half as usize]).filter(|twin| *twin < CROWDED)
    }

    /// Whether two triangles meet here that run along the edge in the same direction: one of them is turned over.
    #[inline]
    pub fn is_opposed(&self, half: u32) -> bool {
        self.twin(half).is_some_and(|twin| self.origin(twin) == self.origin(half))
    }

    /// The numbers of all half-edges, three for each triangle.
    pub fn all(&self) -> std::ops::Range<u32> {
        0..self.twins.len() as u32
    }

    /// The piece of each triangle and the number of pieces; pieces connect through edges of exactly two triangles and are
    /// numbered in the order of their first triangle.
    pub fn pieces(&self) -> (Vec<u32>, usize) {
        let mut sets = UnionFind::new(self.triangles.len());
        for half in self.all() {
            if let Some(twin) = self.twin(half).filter(|twin| *twin > half) {
                sets.join(half as usize / 3, twin as usize / 3);
            }
        }
        number(&sets.into_roots())
    }

    /// The fan of each corner and the number of fans: triangles around a vertex that connect through edges there.
    ///
    /// A vertex of a manifold has one fan.
    pub fn fans(&self) -> (Vec<u32>, usize) {
        let mut sets = UnionFind::new(self.twins.len());
        for half in self.all() {
            if let Some(twin) = self.twin(half).filter(|twin| *twin > half) {
                let (here, there) = if self.is_opposed(half) { (twin, next(twin)) } else { (next(twin), twin) };
                sets.join(half as usize, here as usize);
                sets.join(next(half) as usize, there as usize);
            }
        }
        number(&sets.into_roots())
    }
}

/// Numbers sets, given by their first members, in order.
fn number(roots: &[u32]) -> (Vec<u32>, usize) {
    let mut numbers = vec![0; roots.len()];
    let mut count = 0;
    for (place, root) in roots.iter().enumerate() {
        if *root as usize == place {
            numbers[place] = count;
            count += 1;
        } else {
            numbers[place] = numbers[*root as usize];
        }
    }
    (numbers, count as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    #[test]
    fn a_sheet_is_one_piece_with_one_fan_a_vertex() {
        let mesh = height_mesh(6, [0.0, 1.0, 0.0, 1.0], |_, _| 0.0);
        let edges = HalfEdges::new(&mesh);
        assert_eq!(edges.pieces().1, 1);
        assert_eq!(edges.fans().1, mesh.vertices.len());
        assert_eq!(edges.twins.iter().filter(|twin| **twin == BORDER).count(), 24);
        assert!(edges.all().all(|half| !edges.is_opposed(half)));
        assert!(
            edges
                .all()
                .filter_map(|half| edges.twin(half).map(|twin| (half, twin)))
                .all(|(h, t)| edges.twin(t) == Some(h))
        );
    }

    #[test]
    fn pieces_that_touch_in_a_point_are_two_with_two_fans_there() {
        let mut mesh = height_mesh(2, [0.0, 1.0, 0.0, 1.0], |_, _| 0.0);
        // Of the four squares, the lower left and the upper right.
        mesh.triangles = [&mesh.triangles[..2], &mesh.triangles[6..]].concat();
        let edges = HalfEdges::new(&mesh);
        assert_eq!(edges.pieces(), (vec![0, 0, 1, 1], 2));
        assert_eq!(edges.fans().1, 8, "seven used vertices, the middle one twice");
    }
}
