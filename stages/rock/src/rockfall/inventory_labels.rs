//! The cells of a grid that the outlines of an inventory hold.

use rockface_core::artefact::{Feature, Grid};

/// The label of the last feature that holds the centre of each cell, by row from the top; 0 where none does.
///
/// Holes stay open by the even-odd rule.
pub fn burn(features: &[(u32, &Feature)], grid: &Grid) -> Vec<f32> {
    let mut labels = vec![0.0; grid.cells()];
    for (label, polygon) in features.iter().flat_map(|(label, feature)| feature.outline.iter().map(move |p| (label, p)))
    {
        for (row, line) in labels.chunks_mut(grid.columns.max(1)).enumerate() {
            let y = grid.centre(row, 0).1;
            let rings = std::iter::once(&polygon.exterior).chain(&polygon.holes);
            let mut crossings: Vec<f64> = rings.flat_map(|ring| crossings(ring, y)).collect();
            crossings.sort_by(f64::total_cmp);
            for pair in crossings.chunks_exact(2) {
                let column =
                    |x: f64| ((x - grid.left_m) / grid.cell_m - 0.5).ceil().clamp(0.0, grid.columns as f64) as usize;
                line[column(pair[0])..column(pair[1]).max(column(pair[0]))].fill(*label as f32);
            }
        }
    }
    labels
}

/// Where a ring crosses a horizontal line; an edge holds its lower end and not its upper one.
fn crossings(ring: &[[f64; 2]], y: f64) -> impl Iterator<Item = f64> {
    let edges = ring.iter().zip(ring.iter().cycle().skip(1));
    let crossed = edges.filter(move |(a, b)| (a[1] <= y) != (b[1] <= y));
    crossed.map(move |(a, b)| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Polygon;

    const GRID: Grid = Grid { columns: 8, rows: 8, cell_m: 0.5, left_m: 0.0, top_m: 4.0 };

    fn square(a: f64, b: f64) -> Vec<[f64; 2]> {
        vec![[a, a], [b, a], [b, b], [a, b]]
    }

    fn feature(outline: Vec<Polygon>) -> Feature {
        Feature { outline, values: Vec::new() }
    }

    #[test]
    fn holes_stay_open_and_later_features_cover_earlier_ones() {
        let first = feature(vec![Polygon { exterior: square(0.0, 4.0), holes: vec![square(1.0, 3.0)] }]);
        let plain = |exterior| Polygon { exterior, holes: Vec::new() };
        let second = feature(vec![plain(square(0.0, 0.5)), plain(square(1.5, 2.0))]);
        let labels = burn(&[(7, &first), (9, &second)], &GRID);
        let count = |label: u8| labels.iter().filter(|l| **l as u8 == label).count();
        assert_eq!([0, 7, 9].map(count), [15, 47, 2]);
    }

    #[test]
    fn a_triangle_has_half_the_cells_of_its_square() {
        let exterior = vec![[0.0, 0.0], [4.0, 0.0], [0.0, 4.001]];
        let labels = burn(&[(1, &feature(vec![Polygon { exterior, holes: Vec::new() }]))], &GRID);
        assert_eq!(labels.iter().filter(|l| **l > 0.0).count(), 36);
    }
}
