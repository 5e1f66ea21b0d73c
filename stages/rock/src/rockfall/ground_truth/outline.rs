//! Polygons around the marked cells of a grid: edges of cells, holes kept, every ring simple.

use std::collections::BTreeMap;

use rockface_core::artefact::{Grid, Polygon};

/// A corner of cells: column and row of the cell to its lower right.
type Corner = [i64; 2];

/// The polygons around the marked cells, one for each group of cells that share edges, by row and column of the first
/// cell of each. Cells that only touch at a corner are apart.
///
/// `cells` are (row, column) pairs of the grid; rings run along cell edges, in metres.
pub fn polygons(grid: &Grid, cells: &[(usize, usize)]) -> Vec<Polygon> {
    let mut left: std::collections::BTreeSet<(i64, i64)> =
        cells.iter().map(|(row, column)| (*row as i64, *column as i64)).collect();
    let mut polygons = Vec::new();
    while let Some(first) = left.pop_first() {
        let group = group(first, &mut left);
        polygons.push(polygon(grid, &rings(&group)));
    }
    polygons
}

/// The cells that hang together with the first by their edges; they are taken out of `left`.
fn group(first: (i64, i64), left: &mut std::collections::BTreeSet<(i64, i64)>) -> Vec<(i64, i64)> {
    let mut found = vec![first];
    let mut next = 0;
    while let Some((row, column)) = found.get(next).copied() {
        next += 1;
        let around = [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)];
        found.extend(around.into_iter().filter(|cell| left.remove(cell)));
    }
    found
}

/// Closed simple rings of corners with the cells on their left; the first corner is not repeated.
fn rings(cells: &[(i64, i64)]) -> Vec<Vec<Corner>> {
    let mut edges = edges(cells);
    let mut rings = Vec::new();
    while let Some(start) = edges.first_key_value().map(|(start, _)| *start) {
        simple(&walk(&mut edges, start), &mut rings);
    }
    rings
}

/// Edges between a marked and an unmarked cell by the corner they start from, the marked cell on their left.
fn edges(cells: &[(i64, i64)]) -> BTreeMap<Corner, Vec<Corner>> {
    let marked: std::collections::BTreeSet<(i64, i64)> = cells.iter().copied().collect();
    let mut edges: BTreeMap<Corner, Vec<Corner>> = BTreeMap::new();
    for (r, c) in &marked {
        let (r, c) = (*r, *c);
        let sides = [
            ((r + 1, c), [c, r + 1], [c + 1, r + 1]),
            ((r, c + 1), [c + 1, r + 1], [c + 1, r]),
            ((r - 1, c), [c + 1, r], [c, r]),
            ((r, c - 1), [c, r], [c, r + 1]),
        ];
        for (_, from, to) in sides.into_iter().filter(|(beyond, ..)| !marked.contains(beyond)) {
            edges.entry(from).or_default().push(to);
        }
    }
    edges
}

/// Follows edges from a corner until it comes back to it, turning left where it may choose, and takes them away.
fn walk(edges: &mut BTreeMap<Corner, Vec<Corner>>, start: Corner) -> Vec<Corner> {
    let mut path = vec![start];
    let mut at = start;
    let mut heading = [0, 0];
    while let Some(ends) = edges.get_mut(&at) {
        let left = [at[0] + heading[1], at[1] - heading[0]];
        let next = ends.swap_remove(ends.iter().position(|end| *end == left).unwrap_or(0));
        if ends.is_empty() {
            edges.remove(&at);
        }
        if next == start {
            break;
        }
        heading = [next[0] - at[0], next[1] - at[1]];
        path.push(next);
        at = next;
    }
    path
}

/// Cuts a closed path into rings that meet no corner twice.
fn simple(path: &[Corner], rings: &mut Vec<Vec<Corner>>) {
    let mut open: Vec<Corner> = Vec::new();
    let mut places: BTreeMap<Corner, usize> = BTreeMap::new();
    for corner in path {
        if let Some(place) = places.get(corner).copied() {
            let ring = open.split_off(place);
            for corner in &ring {
                places.remove(corner);
            }
            rings.push(ring);
        }
        places.insert(*corner, open.len());
        open.push(*corner);
    }
    rings.push(open);
}

/// Twice the area of a ring in cells; positive when counter-clockwise with Y up.
fn doubled_area(ring: &[Corner]) -> i64 {
    let next = ring.iter().cycle().skip(1);
    ring.iter().zip(next).map(|(a, b)| a[1] * b[0] - a[0] * b[1]).sum()
}

/// One group of cells: the ring that turns left is its outside, the others are its holes.
fn polygon(grid: &Grid, rings: &[Vec<Corner>]) -> Polygon {
    let mut polygon = Polygon::default();
    for ring in rings {
        let points = corners(grid, ring);
        if doubled_area(ring) > 0 { polygon.exterior = points } else { polygon.holes.push(points) }
    }
    polygon
}

/// The corners at which a ring turns, metres.
fn corners(grid: &Grid, ring: &[Corner]) -> Vec<[f64; 2]> {
    let count = ring.len();
    let turns = (0..count).filter(|i| {
        let (before, at, after) = (ring[(i + count - 1) % count], ring[*i], ring[(i + 1) % count]);
        [at[0] - before[0], at[1] - before[1]] != [after[0] - at[0], after[1] - at[1]]
    });
    let metres =
        |i: usize| [grid.left_m + ring[i][0] as f64 * grid.cell_m, grid.top_m - ring[i][1] as f64 * grid.cell_m];
    turns.map(metres).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const GRID: Grid = Grid { columns: 8, rows: 8, cell_m: 1.0, left_m: 10.0, top_m: 8.0 };

    fn drawn(rows: &[&str]) -> Vec<(usize, usize)> {
        let marked = |(row, line): (usize, &&str)| -> Vec<(usize, usize)> {
            line.char_indices().filter(|(_, c)| *c == '#').map(|(column, _)| (row, column)).collect()
        };
        rows.iter().enumerate().flat_map(marked).collect()
    }

    fn area(ring: &[[f64; 2]]) -> f64 {
        let next = ring.iter().cycle().skip(1);
        ring.iter().zip(next).map(|(a, b)| 0.5 * (a[0] * b[1] - b[0] * a[1])).sum()
    }

    #[test]
    fn a_ring_of_cells_has_a_hole() {
        let found = polygons(&GRID, &drawn(&["###", "# #", "###"]));
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].exterior.len(), 4);
        assert!((area(&found[0].exterior) - 9.0).abs() < 1e-12 && (area(&found[0].holes[0]) + 1.0).abs() < 1e-12);
        assert!(found[0].exterior.contains(&[10.0, 8.0]) && found[0].exterior.contains(&[13.0, 5.0]));
    }

    #[test]
    fn cells_that_touch_at_a_corner_are_apart() {
        let found = polygons(&GRID, &drawn(&["# ", " #"]));
        assert_eq!(found.len(), 2);
        assert!(found.iter().all(|polygon| polygon.exterior.len() == 4 && polygon.holes.is_empty()));
    }

    #[test]
    fn holes_that_touch_at_a_corner_are_two() {
        let [found] = polygons(&GRID, &drawn(&["### ", "# # ", "## #", "#  #", "####"])).try_into().unwrap();
        assert_eq!(found.holes.len(), 2);
        let holes: f64 = found.holes.iter().map(|hole| area(hole)).sum();
        assert!((area(&found.exterior) + holes - 14.0).abs() < 1e-12, "{found:?}");
    }

    proptest! {
        #[test]
        fn rings_are_simple_and_hold_the_area_of_their_cells(marks in prop::collection::vec(any::<bool>(), 64)) {
            let cells: Vec<_> = (0..64).filter(|i| marks[*i]).map(|i| (i / 8, i % 8)).collect();
            let found = polygons(&GRID, &cells);
            let mut sum = 0.0;
            for polygon in &found {
                prop_assert!(area(&polygon.exterior) > 0.0);
                for ring in std::iter::once(&polygon.exterior).chain(&polygon.holes) {
                    let mut corners: Vec<_> = ring.iter().map(|p| p.map(f64::to_bits)).collect();
                    corners.sort_unstable();
                    corners.dedup();
                    prop_assert_eq!(corners.len(), ring.len());
                    sum += area(ring);
                }
                prop_assert!(polygon.holes.iter().all(|hole| area(hole) < 0.0));
            }
            prop_assert!((sum - cells.len() as f64).abs() < 1e-9);
        }
    }
}
