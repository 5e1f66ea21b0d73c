//! The surface an elevation raster stands for: a point at every cell centre, triangles between neighbours.

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
