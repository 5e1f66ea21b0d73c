//! Comparing the grids of rasters: cells must lie on each other before they are subtracted or masked.

use rockface_core::artefact::Grid;

/// How far two grids may be apart and still count as one, in cells.
const TOLERANCE_CELLS: f64 = 1e-6;

/// Whether the cells of two grids lie on each other to a millionth of a cell, at every corner.
pub fn same(a: &Grid, b: &Grid) -> bool {
    let tolerance_m = TOLERANCE_CELLS * a.cell_m;
    let near = |(a, b): (f64, f64)| (a - b).abs() <= tolerance_m;
    (a.columns, a.rows) == (b.columns, b.rows) && a.extent_m().into_iter().zip(b.extent_m()).all(near)
}

/// A grid in words, for messages.
pub fn describe(grid: &Grid) -> String {
    let Grid { columns, rows, cell_m, left_m, top_m } = grid;
    format!("{columns} x {rows} cells of {cell_m} m from left {left_m} m, top {top_m} m")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_size_that_drifts_over_the_width_is_another_grid() {
        let grid = Grid { columns: 1000, rows: 10, cell_m: 0.01, left_m: 1.0, top_m: 2.0 };
        assert!(same(&grid, &Grid { left_m: 1.0 + 5e-9, ..grid }));
        assert!(!same(&grid, &Grid { left_m: 1.0 + 5e-8, ..grid }));
        assert!(!same(&grid, &Grid { cell_m: 0.01 + 1e-10, ..grid }));
        assert!(!same(&grid, &Grid { rows: 11, ..grid }));
        assert!(describe(&grid).contains("1000 x 10"));
    }
}
