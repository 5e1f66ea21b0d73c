//! Bodies between two elevation rasters: the rock that a cluster of cells lost, as a closed mesh.

use std::collections::BTreeMap;

use rockface_core::artefact::Grid;
use rockface_rock::rockfall::ground_truth::Facets;

/// Shift of all bodies in X and Y, metres: walls along the edges of a face that was meshed on the same grid would cut it exactly through
/// its vertices, where what is left is not one surface any more.
const BESIDE_M: [f64; 2] = [3.1e-6, 2.3e-6];

/// A cell as (row, column).
type Place = (i64, i64);
/// Elevations of the upper and the lower side, metres.
type Heights = [f64; 2];

/// The body over some cells, closed and outward: vertical walls around them, on top the elevation before, raised by
/// `proud_m`, below the elevation after, both interpolated between cells.
///
/// Cells that meet at a corner only are joined, and holes closed, by cells with the mean heights of those around them, so
/// that the body is one manifold piece. `heights` gives elevations before and after; cells without either, or where the
/// face did not retreat, take those of their neighbours. `None` where no cell has both.
pub fn between(
    grid: &Grid,
    cells: &[(usize, usize)],
    heights: impl Fn(usize, usize) -> Heights,
    proud_m: f64,
) -> Option<Facets> {
    let mut body: BTreeMap<Place, Option<Heights>> = BTreeMap::new();
    for (row, column) in cells {
        let [top, bottom] = heights(*row, *column);
        let known = (top > bottom).then_some([top, bottom]);
        body.insert((*row as i64, *column as i64), known);
    }
    while let Some(extra) = closing(&body) {
        body.extend(extra.into_iter().map(|place| (place, None)));
    }
    let body = filled(body)?;
    Some(mesh(grid, &body, proud_m))
}

/// The cells that join corners or close holes; `None` where nothing is to be done.
fn closing(body: &BTreeMap<Place, Option<Heights>>) -> Option<Vec<Place>> {
    let has = |place: &Place| body.contains_key(place);
    let pinched = body.keys().flat_map(|(r, c)| [(1, 1), (1, -1)].map(|(dr, dc)| [(*r, *c), (r + dr, c + dc)]));
    let pinched = pinched.filter(|[a, b]| has(b) && !has(&(a.0, b.1)) && !has(&(b.0, a.1)));
    let mut extra: Vec<Place> = pinched.map(|[a, b]| (a.0, b.1)).collect();
    extra.extend(holes(body));
    extra.sort_unstable();
    extra.dedup();
    (!extra.is_empty()).then_some(extra)
}

/// Cells inside the box of the body that cannot be reached from its border over edges.
fn holes(body: &BTreeMap<Place, Option<Heights>>) -> Vec<Place> {
    let rows = || body.keys().map(|place| place.0);
    let columns = || body.keys().map(|place| place.1);
    let (Some(top), Some(bottom), Some(left), Some(right)) =
        (rows().min(), rows().max(), columns().min(), columns().max())
    else {
        return Vec::new();
    };
    let mut free: std::collections::BTreeSet<Place> =
        (top - 1..=bottom + 1).flat_map(|r| (left - 1..=right + 1).map(move |c| (r, c))).collect();
    free.retain(|place| !body.contains_key(place));
    let mut open: Vec<Place> = free.take(&(top - 1, left - 1)).into_iter().collect();
    while let Some((r, c)) = open.pop() {
        open.extend([(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)].into_iter().filter_map(|near| free.take(&near)));
    }
    free.into_iter().collect()
}

/// Gives cells without heights the mean of those around them, ring by ring.
fn filled(mut body: BTreeMap<Place, Option<Heights>>) -> Option<BTreeMap<Place, Heights>> {
    while body.values().any(Option::is_none) {
        let mean = |(r, c): &Place| {
            let near = (-1..=1).flat_map(|dr| (-1..=1).map(move |dc| (r + dr, c + dc)));
            average(near.filter_map(|place| body.get(&place).copied().flatten()))
        };
        let empty = body.iter().filter(|(_, heights)| heights.is_none());
        let new: Vec<(Place, Heights)> = empty.filter_map(|(place, _)| Some((*place, mean(place)?))).collect();
        if new.is_empty() {
            return None;
        }
        body.extend(new.into_iter().map(|(place, heights)| (place, Some(heights))));
    }
    body.into_iter().map(|(place, heights)| Some((place, heights?))).collect()
}

fn average(heights: impl Iterator<Item = Heights>) -> Option<Heights> {
    let (count, sum) = heights.fold((0.0, [0.0; 2]), |(n, s), h| (n + 1.0, [s[0] + h[0], s[1] + h[1]]));
    (count > 0.0).then(|| sum.map(|s| s / count))
}

fn mesh(grid: &Grid, body: &BTreeMap<Place, Heights>, proud_m: f64) -> Facets {
    let mut facets = Facets::default();
    let mut corners: BTreeMap<Place, u32> = BTreeMap::new();
    // The upper vertex of a corner; the lower one follows it.
    let mut corner = |(r, c): Place, facets: &mut Facets| {
        *corners.entry((r, c)).or_insert_with(|| {
            let around = [(r - 1, c - 1), (r - 1, c), (r, c - 1), (r, c)];
            let [top, bottom] = average(around.iter().filter_map(|place| body.get(place).copied())).unwrap_or_default();
            let x = grid.left_m + c as f64 * grid.cell_m + BESIDE_M[0];
            let y = grid.top_m - r as f64 * grid.cell_m + BESIDE_M[1];
            facets.vertices.extend([[x, y, top + proud_m], [x, y, bottom]]);
            facets.vertices.len() as u32 - 2
        })
    };
    for (r, c) in body.keys() {
        // Counter-clockwise seen from above, and the cell beyond the side that starts there.
        let ring = [
            ((r + 1, *c), (r + 1, *c)),
            ((r + 1, c + 1), (*r, c + 1)),
            ((*r, c + 1), (r - 1, *c)),
            ((*r, *c), (*r, c - 1)),
        ];
        let tops = ring.map(|(place, _)| corner(place, &mut facets));
        let [a, b, c, d] = tops;
        facets.triangles.extend([[a, b, c], [a, c, d], [a + 1, c + 1, b + 1], [a + 1, d + 1, c + 1]]);
        for side in (0..4).filter(|side| !body.contains_key(&ring[*side].1)) {
            let (p, q) = (tops[side], tops[(side + 1) % 4]);
            facets.triangles.extend([[p, p + 1, q + 1], [p, q + 1, q]]);
        }
    }
    facets
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_rock::rockfall::block::Solid;

    const GRID: Grid = Grid { columns: 10, rows: 10, cell_m: 0.1, left_m: 5.0, top_m: 2.0 };

    fn solid(cells: &[(usize, usize)], heights: impl Fn(usize, usize) -> Heights, proud_m: f64) -> Solid {
        let Facets { vertices, triangles } = between(&GRID, cells, heights, proud_m).unwrap();
        let solid = Solid { vertices, triangles };
        assert!(solid.check().is_ok(), "{:?}", solid.check());
        solid
    }

    #[test]
    fn a_block_of_cells_has_its_volume() {
        let cells: Vec<(usize, usize)> = (0..6).map(|i| (3 + i / 3, 4 + i % 3)).collect();
        let body = solid(&cells, |_, _| [1.0, 0.8], 0.05);
        assert!((body.volume() - 0.06 * 0.25).abs() < 1e-12, "{}", body.volume());
        let [low, high] = body.bounds();
        assert!((low[0] - 5.4).abs() < 1e-5 && (high[1] - 1.7).abs() < 1e-5 && (high[2] - 1.05).abs() < 1e-12);
    }

    #[test]
    fn corners_are_joined_and_holes_closed() {
        let body = solid(&[(2, 2), (3, 3)], |_, _| [0.1, 0.0], 0.0);
        assert!((body.volume() - 3.0 * 0.001).abs() < 1e-12);
        let ring: Vec<(usize, usize)> = (0..9).filter(|i| *i != 4).map(|i| (2 + i / 3, 2 + i % 3)).collect();
        let body = solid(&ring, |r, c| if (r, c) == (2, 2) { [f64::NAN; 2] } else { [0.1, 0.0] }, 0.0);
        assert!((body.volume() - 9.0 * 0.001).abs() < 1e-12);
        assert!(between(&GRID, &[(1, 1)], |_, _| [0.0, 0.1], 0.0).is_none());
    }
}
