//! The parameter `window_m` that many stages have: a rectangle in the plane of the wall, and what of a raster lies in it.

use crate::grid;
use rockface_core::StageError;
use rockface_core::artefact::{Band, Raster};
use rockface_core::params::Fault;

/// How far a cell may reach beyond a window and still count as inside, in cells.
const TOLERANCE_CELLS: f64 = 1e-6;

/// What is wrong with a window (left, right, bottom, top), metres, as the fault of a parameter `window_m`.
pub fn faults(window_m: Option<[f64; 4]>) -> Vec<Fault> {
    match window_m {
        Some([left, right, bottom, top]) if !(left < right && bottom < top) => {
            let text = format!("[{left}, {right}, {bottom}, {top}] is empty; the order is left, right, bottom, top");
            vec![Fault { path: vec!["window_m".into()], ..Fault::new(text) }]
        }
        _ => Vec::new(),
    }
}

/// The part of an extent (left, right, bottom, top), metres, that lies in a window; all of it without one. Where they do not meet, an end is before
/// its beginning.
pub fn clipped([left, right, bottom, top]: [f64; 4], window_m: Option<[f64; 4]>) -> [f64; 4] {
    let within = |[a, b, c, d]: [f64; 4]| [left.max(a), right.min(b), bottom.max(c), top.min(d)];
    window_m.map_or([left, right, bottom, top], within)
}

/// About how many cells a window holds, for an estimate of memory; at most a number no memory has room for.
pub fn cells([left, right, bottom, top]: [f64; 4], cell_m: f64) -> u64 {
    const NO_ROOM: f64 = 1e15;
    ((right - left) / cell_m * ((top - bottom) / cell_m)).clamp(0.0, NO_ROOM) as u64
}

/// The part of a raster in a window (left, right, bottom, top), metres: the cells that lie in it whole, all bands in their order.
///
/// # Errors
/// No cell lies in the window.
pub fn cropped(raster: &Raster, window_m: [f64; 4]) -> Result<Raster, StageError> {
    let grid = raster.grid;
    let [left, right, bottom, top] = window_m;
    let columns = inside([left - grid.left_m, right - grid.left_m], grid.cell_m, grid.columns);
    let rows = inside([grid.top_m - top, grid.top_m - bottom], grid.cell_m, grid.rows);
    if columns.is_empty() || rows.is_empty() {
        let (has, window) = (grid::describe(&grid), format!("[{left}, {right}, {bottom}, {top}]"));
        return Err(StageError::new(format!("no whole cell lies in the window {window}: the raster has {has}"))
            .hint("give `window_m` as left, right, bottom, top in metres of the raster's own frame"));
    }
    let band = |band: &Band| {
        let row = |row: usize| &band.values[row * grid.columns + columns.start..row * grid.columns + columns.end];
        Band { name: band.name.clone(), values: rows.clone().flat_map(row).copied().collect() }
    };
    Ok(Raster {
        grid: grid.part(columns.clone(), rows.clone()),
        frame: raster.frame,
        quantity: raster.quantity.clone(),
        sample: raster.sample,
        bands: raster.bands.iter().map(band).collect(),
    })
}

/// The cells of one side of a grid that lie whole between two distances from where it begins, metres.
fn inside([from, to]: [f64; 2], cell_m: f64, cells: usize) -> std::ops::Range<usize> {
    let first = (from / cell_m - TOLERANCE_CELLS).ceil().clamp(0.0, cells as f64);
    let end = (to / cell_m + TOLERANCE_CELLS).floor().clamp(0.0, cells as f64);
    first as usize..end as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Grid};

    /// 5 x 4 cells of 0.1 m, two bands; each value says its column and row.
    fn raster() -> Raster {
        let grid = Grid { columns: 5, rows: 4, cell_m: 0.1, left_m: -0.2, top_m: 0.3 };
        let values: Vec<f32> = (0..20u8).map(|i| f32::from(10 * (i % 5) + i / 5)).collect();
        let mut raster = Raster::single(grid, Frame::Wall, "difference", "b", values.clone());
        raster.bands.push(Band { name: "a".into(), values: values.iter().map(|v| -v).collect() });
        raster
    }

    #[test]
    fn the_cells_that_lie_in_a_window_whole_are_kept_in_every_band() {
        let part = cropped(&raster(), [-0.11, 0.2, 0.0, 0.2]).unwrap();
        assert_eq!((part.grid.columns, part.grid.rows), (3, 2));
        assert!((part.grid.left_m + 0.1).abs() < 1e-12 && (part.grid.top_m - 0.2).abs() < 1e-12);
        assert_eq!(part.bands[0].values, [11.0, 21.0, 31.0, 12.0, 22.0, 32.0]);
        assert_eq!((part.bands[1].name.as_str(), part.bands[1].values[5]), ("a", -32.0));
    }

    #[test]
    fn two_windows_with_a_common_side_share_no_cell_and_a_wide_one_keeps_all() {
        let columns = |from: f64, to: f64| cropped(&raster(), [from, to, -1e6, 1e6]).unwrap().grid.columns;
        assert_eq!((columns(-1e6, 0.1), columns(0.1, 1e6)), (3, 2));
        assert_eq!((columns(-1e6, 0.06), columns(0.06, 1e6)), (2, 2));
        let all = cropped(&raster(), [-1e6, 1e6, -1e6, 1e6]).unwrap();
        assert_eq!((all.grid, &all.bands[1].values), (raster().grid, &raster().bands[1].values));
    }

    #[test]
    fn a_window_beside_the_raster_or_within_one_cell_is_refused() {
        for window_m in [[1.0, 2.0, 0.0, 0.2], [-0.18, -0.12, 0.0, 0.2], [-3.0, -2.0, 0.0, 0.2]] {
            let error = cropped(&raster(), window_m).unwrap_err();
            assert!(error.message.contains("5 x 4 cells") && error.hint.is_some(), "{error}");
        }
    }
}
