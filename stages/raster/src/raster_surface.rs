//! The surface an elevation raster stands for: a point at every cell centre, triangles between neighbours; and gaps that are bridged.

use rockface_core::artefact::{Grid, Raster, Surface};
use rockface_core::{StageError, fail};

/// The triangles between the cell centres of an elevation raster of one band; cells without a value have no point.
///
/// # Errors
/// The raster has several bands: which of them is the elevation?
pub fn between_cells(raster: &Raster) -> Result<Surface, StageError> {
    let [band] = raster.bands.as_slice() else {
        fail!("it has {} bands, one is needed", raster.bands.len());
    };
    let Grid { columns: width, rows: height, left_m, top_m, .. } = raster.grid;
    let z_m = band.values.iter().find(|z| !z.is_nan()).map_or(0.0, |z| f64::from(*z));
    let point = |(cell, z): (usize, &f32)| {
        let (x, y) = raster.grid.centre(cell / width, cell % width);
        let local = [x - left_m, y - top_m, f64::from(*z) - z_m].map(|value| value as f32);
        if z.is_nan() { [f32::NAN; 3] } else { local }
    };
    let points: Vec<[f32; 3]> = band.values.iter().enumerate().map(point).collect();
    let square = |place: usize| {
        let (row, column) = (place / (width - 1), place % (width - 1));
        let whole = |other: u8| {
            let corners = Surface::corners(width, row, column, other);
            corners.map(|triangle| triangle.iter().all(|corner| !points[*corner][0].is_nan()))
        };
        let byte = |[first, second]: [bool; 2]| u8::from(first) * Surface::FIRST + u8::from(second) * Surface::SECOND;
        // With one corner missing, the diagonal between its neighbours leaves a triangle.
        let (plain, other) = (byte(whole(0)), byte(whole(Surface::OTHER_DIAGONAL)));
        if plain == 0 && other != 0 { other | Surface::OTHER_DIAGONAL } else { plain }
    };
    let squares = (0..width.saturating_sub(1) * height.saturating_sub(1)).map(square).collect();
    Ok(Surface { frame: raster.frame, width, height, origin_m: [left_m, top_m, z_m], points, squares })
}

/// Elevations by row with their narrow gaps bridged: a cell without a value (NaN) between two with one in its row or in its column, with at
/// most `most` cells without a value between them, lies on the straight line from the one to the other; where both do, on the mean of
/// both lines, the shorter one with more weight. Then the same once more, for corners of gaps, which lie on no such line. All other cells stay
/// as they are.
pub fn bridged(values: &[f32], columns: usize, most: usize) -> Vec<f32> {
    bridged_once(&bridged_once(values, columns, most), columns, most)
}

fn bridged_once(values: &[f32], columns: usize, most: usize) -> Vec<f32> {
    let mut sums = vec![[0.0f64; 2]; if most == 0 { 0 } else { values.len() }];
    if sums.is_empty() || values.iter().all(|z| !z.is_nan()) {
        return values.to_vec();
    }
    let rows = values.len() / columns;
    (0..rows).for_each(|row| add_lines(values, row * columns, 1, columns, most, &mut sums));
    (0..columns).for_each(|column| add_lines(values, column, columns, rows, most, &mut sums));
    let bridge = |(z, [sum, weight]): (&f32, &[f64; 2])| {
        if z.is_nan() && *weight > 0.0 { (sum / weight) as f32 } else { *z }
    };
    values.iter().zip(&sums).map(bridge).collect()
}

/// Adds what lies on lines over the gaps of one row or column of `count` cells, to the sum of heights times weights and that of weights.
fn add_lines(values: &[f32], first: usize, step: usize, count: usize, most: usize, sums: &mut [[f64; 2]]) {
    let mut last = None;
    for at in (0..count).filter(|at| !values[first + at * step].is_nan()) {
        let height = |at: usize| f64::from(values[first + at * step]);
        if let Some(last) = last.replace(at).filter(|last| (2..=most.saturating_add(1)).contains(&(at - last))) {
            let apart = (at - last) as f64;
            for between in last + 1..at {
                let share = (between - last) as f64 / apart;
                let [sum, weight] = &mut sums[first + between * step];
                *sum += (height(last) * (1.0 - share) + height(at) * share) / apart;
                *weight += 1.0 / apart;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_gaps_are_bridged_along_rows_and_columns() {
        let gap = f32::NAN;
        let shown = |values: Vec<f32>| format!("{values:?}");
        // Two cells in a row: on the line. At the border there is no other side.
        assert_eq!(shown(bridged(&[1.0, gap, gap, 4.0, gap], 5, 2)), "[1.0, 2.0, 3.0, 4.0, NaN]");
        assert_eq!(shown(bridged(&[1.0, gap, gap, 4.0], 4, 1)), "[1.0, NaN, NaN, 4.0]");
        assert_eq!(shown(bridged(&[1.0, gap, 3.0], 1, 0)), "[1.0, NaN, 3.0]");
        // A ring of two cells around a niche: its corners lie on lines of bridged cells only.
        let is_ring = |at: usize| (2..10).contains(&at);
        let is_niche = |at: usize| (4..8).contains(&at);
        let ring: Vec<f32> = (0..144)
            .map(|cell| (cell % 12, cell / 12))
            .map(|(x, y)| match (is_ring(x) && is_ring(y), is_niche(x) && is_niche(y)) {
                (true, false) => gap,
                (_, is_niche) => f32::from(u8::from(is_niche)),
            })
            .collect();
        assert_eq!(bridged(&ring, 12, 2).iter().filter(|z| z.is_nan()).count(), 0);
        // One cell apart in the column, three in the row: weights of a half and a quarter.
        let mut cross = vec![gap; 15];
        (cross[5], cross[9], cross[2], cross[12]) = (0.0, 8.0, 1.0, 1.0);
        assert_eq!(shown(bridged(&cross, 5, 3)[7..8].to_vec()), "[2.0]");
    }
}
