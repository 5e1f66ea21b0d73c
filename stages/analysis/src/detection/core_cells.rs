//! Which core point each cell of a grid in plan counts to: points farther apart than the cells leave some cells between them without one.

use rockface_core::artefact::Grid;

/// Gaps that are wider than core points reach are told where they are at most so many times as wide.
const WIDER: usize = 2;

/// The cells of a grid by the core points they count to.
pub struct CoreCells {
    /// By cell, the cell of its core point: its own where it holds one, or the nearest across a narrow gap.
    owners: Vec<Option<u32>>,
    /// Cells between core points that are too far from any to count to it.
    pub gaps: usize,
    /// The most cells between a cell and that of its core point.
    reach: usize,
    columns: usize,
}

impl CoreCells {
    /// Cells without a core point count to the nearest, in plan, where they are in a gap that squares of `reach_m` around the core points close.
    pub fn new(cores: &[Option<[f64; 3]>], grid: &Grid, reach_m: f64) -> Self {
        let reach = ((reach_m / grid.cell_m * (1.0 + 1e-9)) as usize).min(grid.columns.max(grid.rows));
        let held: Vec<bool> = cores.iter().map(Option::is_some).collect();
        let owners = |(cell, is_inside): (usize, bool)| match cores[cell] {
            Some(_) => Some(cell as u32),
            None if is_inside => nearest(cores, grid, cell, reach),
            None => None,
        };
        let owners: Vec<Option<u32>> = closed(&held, grid.columns, reach).into_iter().enumerate().map(owners).collect();
        let wide = closed(&held, grid.columns, WIDER * reach.max(1));
        let gaps = wide.iter().zip(&owners).filter(|(is_between, owner)| **is_between && owner.is_none()).count();
        Self { owners, gaps, reach, columns: grid.columns }
    }

    /// The cell of the core point that a cell counts to.
    pub fn owner(&self, cell: usize) -> Option<usize> {
        self.owners.get(cell).copied().flatten().map(|owner| owner as usize)
    }

    /// Whether a cell holds a core point.
    pub fn is_core(&self, cell: usize) -> bool {
        self.owner(cell) == Some(cell)
    }

    /// The cells of the core points to the left of, to the right of, above and below a core point: those of the next cells that count to another one.
    pub fn around(&self, cell: usize) -> [Option<usize>; 4] {
        let (row, column, rows) = (cell / self.columns, cell % self.columns, self.owners.len() / self.columns);
        let next = |count: usize, step: isize| {
            (1..=count.min(2 * self.reach + 1))
                .map(|far| self.owner(cell.saturating_add_signed(step * far as isize)))
                .find(|owner| *owner != Some(cell))
                .flatten()
        };
        let along = self.columns as isize;
        [next(column, -1), next(self.columns - 1 - column, 1), next(row, -along), next(rows - 1 - row, along)]
    }
}

/// The cell whose core point is nearest to the centre of a cell, in plan, of those within a square; of equal ones the first.
fn nearest(cores: &[Option<[f64; 3]>], grid: &Grid, cell: usize, reach: usize) -> Option<u32> {
    let (row, column) = (cell / grid.columns, cell % grid.columns);
    let (x, y) = grid.centre(row, column);
    let mut best: Option<(f64, usize)> = None;
    for ring in 1..=reach {
        let (top, bottom) = (row.saturating_sub(ring), (row + ring).min(grid.rows - 1));
        let (left, right) = (column.saturating_sub(ring), (column + ring).min(grid.columns - 1));
        for r in top..=bottom {
            // Whole rows at the ends of the ring, two cells in the others.
            let step = if r + ring == row || r == row + ring { 1 } else { 2 * ring };
            let first = if step == 1 || left + ring == column { left } else { column + ring };
            for at in (first..=right).step_by(step).map(|c| r * grid.columns + c) {
                if let Some([cx, cy, _]) = cores[at] {
                    let square = (cx - x) * (cx - x) + (cy - y) * (cy - y);
                    best = if best.is_none_or(|(least, _)| square < least) { Some((square, at)) } else { best };
                }
            }
        }
        let beyond_m = (ring as f64 + 0.5) * grid.cell_m;
        if best.is_some_and(|(square, _)| square <= beyond_m * beyond_m) {
            break;
        }
    }
    best.map(|(_, at)| at as u32)
}

/// The morphological closing of a mask with a square that reaches so many cells to each side; what is beyond the grid is taken as set.
fn closed(mask: &[bool], columns: usize, reach: usize) -> Vec<bool> {
    let grown = grown(mask, columns, reach);
    let outside: Vec<bool> = grown.iter().map(|cell| !cell).collect();
    self::grown(&outside, columns, reach).into_iter().map(|cell| !cell).collect()
}

/// The cells within so many rows and columns of a cell of the mask.
fn grown(mask: &[bool], columns: usize, reach: usize) -> Vec<bool> {
    let mut cells = mask.to_vec();
    for row in cells.chunks_mut(columns.max(1)) {
        let line: Vec<bool> = row.to_vec();
        spread(&line, reach).into_iter().zip(row).for_each(|(set, cell)| *cell = set);
    }
    for column in 0..columns {
        let line: Vec<bool> = cells.iter().skip(column).step_by(columns).copied().collect();
        let down = cells.iter_mut().skip(column).step_by(columns);
        spread(&line, reach).into_iter().zip(down).for_each(|(set, cell)| *cell = set);
    }
    cells
}

/// The places of a line within so many places of one that is set.
fn spread(line: &[bool], reach: usize) -> Vec<bool> {
    let mut out = vec![false; line.len()];
    let mut end = 0;
    for (place, _) in line.iter().enumerate().filter(|(_, set)| **set) {
        let from = place.saturating_sub(reach).max(end);
        end = (place + reach + 1).min(line.len());
        out[from..end].fill(true);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Core points at the centres of the cells marked `#`.
    fn cells(text: &str, reach_m: f64) -> CoreCells {
        let rows: Vec<&[u8]> = text.split_whitespace().map(str::as_bytes).collect();
        let grid = Grid { columns: rows[0].len(), rows: rows.len(), cell_m: 0.1, left_m: 5.0, top_m: 9.0 };
        let core = |cell: usize| {
            let (row, column) = (cell / grid.columns, cell % grid.columns);
            let (x, y) = grid.centre(row, column);
            (rows[row][column] == b'#').then_some([x, y, 0.0])
        };
        CoreCells::new(&(0..grid.cells()).map(core).collect::<Vec<_>>(), &grid, reach_m)
    }

    #[test]
    fn cells_of_narrow_gaps_count_to_the_nearest_core_point_and_those_of_wide_ones_to_none() {
        let found = cells("##..## ##..## ##..##", 0.1);
        assert_eq!([8, 9].map(|cell| found.owner(cell)), [Some(7), Some(10)]);
        assert!(found.is_core(7) && !found.is_core(8) && found.gaps == 0);
        assert_eq!(found.around(7), [Some(6), Some(10), Some(1), Some(13)]);
        let wide = cells("##....## ##....## ##....##", 0.1);
        assert!((2..6).all(|column| wide.owner(8 + column).is_none()));
        assert_eq!((wide.gaps, wide.around(9)), (12, [Some(8), None, Some(1), Some(17)]));
        // What is beside the core points is no gap, and with cells as large as the reach and larger nothing is bridged.
        let beside = cells("##.... ##.... ##....", 0.1);
        assert!((2..6).all(|column| beside.owner(6 + column).is_none()) && beside.gaps == 0);
        assert!(cells("##.## ##.## ##.##", 0.09).owner(7).is_none());
    }

    #[test]
    fn every_cell_between_scattered_core_points_counts_to_the_nearest_of_all() {
        let text = "#..#.... ..#....# #....#.. ...#...# .#...#.. ...#...#";
        let found = cells(text, 0.3);
        let held: Vec<usize> = (0..48).filter(|cell| found.is_core(*cell)).collect();
        let square = |a: usize, b: usize| (a / 8).abs_diff(b / 8).pow(2) + (a % 8).abs_diff(b % 8).pow(2);
        for cell in 0..48 {
            let least = held.iter().map(|core| square(cell, *core)).min();
            assert_eq!(found.owner(cell).map(|owner| square(cell, owner)), least, "cell {cell}");
        }
    }
}
