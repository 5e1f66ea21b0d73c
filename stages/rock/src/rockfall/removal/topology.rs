//! What a removal would do to the connections of the mesh: edges, fans around vertices, borders, islands.

use super::patch::open_edges;
use rockface_core::numerics::union_find::UnionFind;

/// The faults of a patch after a removal that it did not have before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Faults {
    /// An edge of three or more triangles, or of two oriented against each other, or a vertex where the surface touches
    /// itself.
    pub non_manifold: bool,
    /// The border is not the one it was: a hole, or a bitten border.
    pub border_changed: bool,
    /// The border falls into more loops than before: a hole, or a border that was cut through.
    pub more_loops: bool,
    /// A part of the surface hangs on nothing.
    pub isolated: bool,
}

impl Faults {
    /// Whether there is a hole that was not there. Where the block may bite the border, only a new loop counts.
    pub fn holes(self, at_border: bool) -> bool {
        if at_border { self.more_loops } else { self.border_changed }
    }
}

/// A patch before and after, in one numbering of vertices.
pub struct Change<'a> {
    /// How many vertices the numbering has.
    pub vertices: usize,
    /// Triangles of the patch before the removal.
    pub before: &'a [[u32; 3]],
    /// Those of them that stay.
    pub kept: &'a [[u32; 3]],
    /// Triangles that take the place of the others.
    pub new: &'a [[u32; 3]],
    /// The border before, ascending.
    pub border: &'a [[u32; 2]],
}

impl Change<'_> {
    /// What is wrong with the patch after the removal and was not before.
    pub fn faults(&self) -> Faults {
        let after = [self.kept, self.new].concat();
        let border = open_edges(&after);
        Faults {
            non_manifold: border.is_err() || self.pinches(&after),
            more_loops: border.as_ref().is_ok_and(|border| self.loops(border) > self.loops(self.border)),
            border_changed: border.is_ok_and(|border| border != self.border),
            isolated: self.islands(&after, self.new) > self.islands(self.before, &self.gone()),
        }
    }

    /// Loops of border edges; those that touch in a vertex are one.
    fn loops(&self, border: &[[u32; 2]]) -> usize {
        let mut groups = UnionFind::new(self.vertices);
        for [a, b] in border {
            groups.join(*a as usize, *b as usize);
        }
        let mut roots: Vec<usize> = border.iter().map(|edge| groups.root(edge[0] as usize)).collect();
        roots.sort_unstable();
        roots.dedup();
        roots.len()
    }

    /// Triangles that went; `kept` is in the order of `before`.
    fn gone(&self) -> Vec<[u32; 3]> {
        let mut kept = self.kept.iter().peekable();
        self.before.iter().filter(|t| kept.next_if_eq(t).is_none()).copied().collect()
    }

    /// Whether some vertex has more fans of triangles than before; a new one may have one.
    fn pinches(&self, after: &[[u32; 3]]) -> bool {
        let mut watched = vec![false; self.vertices];
        self.new.iter().chain(&self.gone()).flatten().for_each(|v| watched[*v as usize] = true);
        let before = fans(self.before, &watched);
        let after = fans(after, &watched);
        after.iter().zip(before).any(|(after, before)| *after > before.max(1))
    }

    /// Groups of the surface that hold some of these triangles and no vertex of the border.
    fn islands(&self, surface: &[[u32; 3]], touched: &[[u32; 3]]) -> usize {
        let mut groups = UnionFind::of_triangles(self.vertices, surface);
        let mut anchored = vec![false; self.vertices];
        for edge in self.border {
            anchored[groups.root(edge[0] as usize)] = true;
        }
        let mut islands: Vec<usize> = touched.iter().map(|t| groups.root(t[0] as usize)).collect();
        islands.retain(|group| !anchored[*group]);
        islands.sort_unstable();
        islands.dedup();
        islands.len()
    }
}

/// Number of fans of triangles around each watched vertex.
fn fans(triangles: &[[u32; 3]], watched: &[bool]) -> Vec<u32> {
    let mut spokes: Vec<[u32; 3]> = triangles
        .iter()
        .flat_map(|t| [[t[0], t[1], t[2]], [t[1], t[2], t[0]], [t[2], t[0], t[1]]])
        .filter(|corner| watched[corner[0] as usize])
        .collect();
    spokes.sort_unstable();
    let mut counts = vec![0; watched.len()];
    for corners in spokes.chunk_by(|a, b| a[0] == b[0]) {
        counts[corners[0][0] as usize] = fans_of(corners);
    }
    counts
}

/// Corners of one vertex, linked where they share a spoke.
fn fans_of(corners: &[[u32; 3]]) -> u32 {
    let mut ends: Vec<u32> = corners.iter().flat_map(|c| [c[1], c[2]]).collect();
    ends.sort_unstable();
    ends.dedup();
    let number = |v: u32| ends.partition_point(|end| *end < v);
    let mut groups = UnionFind::new(ends.len());
    for corner in corners {
        groups.join(number(corner[1]), number(corner[2]));
    }
    (0..ends.len()).filter(|n| groups.root(*n) == *n).count() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of four triangles around vertex 4.
    const SQUARE: [[u32; 3]; 4] = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];
    const BORDER: [[u32; 2]; 4] = [[0, 1], [1, 2], [2, 3], [3, 0]];

    fn faults(kept: &[[u32; 3]], new: &[[u32; 3]]) -> Faults {
        Change { vertices: 12, before: &SQUARE, kept, new, border: &BORDER }.faults()
    }

    #[test]
    fn a_dent_is_sound_and_every_fault_is_seen() {
        let dent = [[1, 2, 5], [2, 3, 5], [3, 0, 5], [0, 1, 5]];
        assert_eq!(faults(&[], &dent), Faults::default());
        let hole = faults(&SQUARE[..2], &[]);
        assert_eq!(hole, Faults { border_changed: true, ..Faults::default() });
        assert!(faults(&SQUARE, &[[0, 4, 6]]).non_manifold);
        let island = [[6, 7, 8], [6, 8, 9], [6, 9, 7], [7, 9, 8]];
        let floating = faults(&SQUARE[..3], &[&SQUARE[3..], &island].concat());
        assert_eq!(floating, Faults { isolated: true, ..Faults::default() });
        let touching = island.map(|t| t.map(|v| if v == 6 { 4 } else { v }));
        let pinched = faults(&SQUARE[..3], &[&SQUARE[3..], &touching].concat());
        assert_eq!(pinched, Faults { non_manifold: true, ..Faults::default() });
    }
}
