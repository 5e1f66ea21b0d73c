//! Connected pieces of an organised surface, followed by runs of squares instead of point by point.

use rockface_core::artefact::Surface;
use rockface_core::numerics::union_find::UnionFind;

/// Corners of a square as bits.
pub(super) const A: u8 = 1;
pub(super) const B: u8 = 2;
pub(super) const C: u8 = 4;
pub(super) const D: u8 = 8;

/// Both triangles of a square.
const BOTH: u8 = Surface::FIRST | Surface::SECOND;

/// Corners that the triangles of each byte use.
const USED: [u8; 8] = [0, A | D | C, A | C | B, A | B | C | D, 0, A | D | B, B | D | C, A | B | C | D];

/// The corners of a square that its triangles use.
#[inline]
pub(super) fn used(byte: u8) -> u8 {
    USED[usize::from(byte & 7)]
}

/// Whether a square has both triangles.
fn is_whole(byte: u8) -> bool {
    byte & BOTH == BOTH
}

/// Whether all of some squares have.
pub(super) fn all_whole(squares: &[u8]) -> bool {
    is_whole(squares.iter().fold(BOTH, |common, byte| common & byte))
}

/// Squares of one row that hang together.
struct Run {
    row: u32,
    columns: std::ops::Range<u32>,
    triangles: u32,
}

/// Stands for the number of a run where there is none.
const NONE: u32 = u32::MAX;

/// Takes away the pieces of fewer triangles than some; pieces connect through points. Returns how many triangles went.
pub(super) fn remove_small(surface: &mut Surface, min_triangles: usize) -> usize {
    if min_triangles <= 1 {
        return 0;
    }
    let (runs, roots) = runs(surface);
    let mut sizes = vec![0usize; runs.len()];
    runs.iter().zip(&roots).for_each(|(run, root)| sizes[*root as usize] += run.triangles as usize);
    let mut removed = 0;
    for (run, _) in runs.iter().zip(&roots).filter(|(_, root)| sizes[**root as usize] < min_triangles) {
        let start = run.row as usize * (surface.width - 1);
        let squares = &mut surface.squares[start + run.columns.start as usize..start + run.columns.end as usize];
        squares.iter_mut().for_each(|byte| *byte &= !BOTH);
        removed += run.triangles as usize;
    }
    removed
}

/// All runs, and of each the first run of its piece.
fn runs(surface: &Surface) -> (Vec<Run>, Vec<u32>) {
    let mut runs: Vec<Run> = Vec::new();
    let mut joins = Vec::new();
    // The run that uses each point of the row of points between two rows of squares.
    let (mut above, mut below) = (vec![NONE; surface.width], vec![NONE; surface.width]);
    for (row, squares) in surface.squares.chunks((surface.width - 1).max(1)).enumerate() {
        let (mut before, mut joined) = (0, [NONE; 2]);
        let mut column = 0;
        while column < squares.len() {
            let uses = used(squares[column]);
            // Whole squares side by side are taken together; others one by one.
            let whole = squares[column..].iter().take_while(|byte| is_whole(**byte)).count();
            let end = column + whole.max(1);
            if uses != 0 {
                // Corners b and c of the square before are a and d of this one.
                let is_linked = (before & B != 0 && uses & A != 0) || (before & C != 0 && uses & D != 0);
                if !is_linked {
                    runs.push(Run { row: row as u32, columns: column as u32..column as u32, triangles: 0 });
                }
                let number = runs.len() as u32 - 1;
                let run = &mut runs[number as usize];
                run.columns.end = end as u32;
                run.triangles += if whole > 0 { 2 * whole as u32 } else { (squares[column] & BOTH).count_ones() };
                // The points of its upper and of its lower edge.
                let points =
                    |left: u8, right: u8| column + usize::from(uses & left == 0)..end + usize::from(uses & right != 0);
                for upper in &above[points(A, B)] {
                    if *upper != NONE && joined != [number, *upper] {
                        joined = [number, *upper];
                        joins.push(joined);
                    }
                }
                below[points(D, C)].fill(number);
            }
            before = uses;
            column = end;
        }
        std::mem::swap(&mut above, &mut below);
        below.fill(NONE);
    }
    let mut pieces = UnionFind::new(runs.len());
    joins.iter().for_each(|[a, b]| _ = pieces.join(*a as usize, *b as usize));
    (runs, pieces.into_roots())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rockface_core::artefact::Frame;

    /// The same by joining points one by one.
    fn plainly(surface: &mut Surface, min_triangles: usize) -> usize {
        let (rows, columns) = (surface.height - 1, surface.width - 1);
        let all: Vec<_> = (0..rows * columns).flat_map(|i| surface.triangles(i / columns, i % columns)).collect();
        let mut pieces = UnionFind::new(surface.points.len());
        for [a, b, c] in &all {
            let root = pieces.join(*a, *b);
            pieces.join(root, *c);
        }
        let roots = pieces.into_roots();
        let size = |root: u32| all.iter().filter(|[a, ..]| roots[*a] == root).count();
        let mut removed = 0;
        for i in 0..rows * columns {
            let byte = surface.squares[i];
            let corners = Surface::corners(surface.width, i / columns, i % columns, byte);
            for (corners, bit) in corners.iter().zip([Surface::FIRST, Surface::SECOND]) {
                if byte & bit != 0 && size(roots[corners[0]]) < min_triangles {
                    surface.squares[i] &= !bit;
                    removed += 1;
                }
            }
        }
        removed
    }

    proptest! {
        #[test]
        fn runs_find_the_pieces_that_points_find(
            width in 2usize..9, bytes in prop::collection::vec(prop_oneof![Just(0u8), Just(3u8), 0u8..8], 8..80), least in 2usize..9) {
            let height = bytes.len() / (width - 1) + 1;
            let squares = bytes[..(width - 1) * (height - 1)].to_vec();
            let points = vec![[0.0; 3]; width * height];
            let mut surface = Surface { frame: Frame::Wall, width, height, origin_m: [0.0; 3], points, squares };
            let mut expected = surface.clone();
            prop_assume!(height > 1);
            prop_assert_eq!(remove_small(&mut surface, least), plainly(&mut expected, least));
            prop_assert_eq!(surface.squares, expected.squares);
        }
    }
}
