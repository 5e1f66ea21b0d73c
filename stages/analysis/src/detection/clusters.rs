//! Masks on a grid: opening with a square, groups of cells that touch, how elongated a group is.

/// The cells that a square of `side` x `side` cells reaches while it stays inside the mask: the morphological opening.
///
/// `mask` is by row. Opening n times with a square of k cells (n erosions, then n dilations) is one opening with a square
/// of n (k - 1) + 1 cells. A side of 0 or 1 changes nothing.
///
/// # References
/// Serra, J. (1982), Image Analysis and Mathematical Morphology.
pub fn opened(mask: &[bool], columns: usize, side: usize) -> Vec<bool> {
    if side < 2 || columns == 0 {
        return mask.to_vec();
    }
    let rows = mask.len() / columns;
    // Cells from which `side` cells to the right, then `side` rows down, are all in the mask: upper left corners of squares.
    let mut corners = vec![false; mask.len()];
    for row in 0..rows {
        let line = row * columns..(row + 1) * columns;
        runs(mask[line.clone()].iter().rev(), side, corners[line].iter_mut().rev());
    }
    for column in 0..columns {
        let down: Vec<bool> = (0..rows).map(|row| corners[row * columns + column]).collect();
        runs(down.iter().rev(), side, corners[column..].iter_mut().step_by(columns).rev());
    }
    // Every cell of such a square stays.
    let mut across = vec![false; mask.len()];
    for row in 0..rows {
        let line = row * columns..(row + 1) * columns;
        spread(corners[line.clone()].iter(), side, across[line].iter_mut());
    }
    let mut opened = vec![false; mask.len()];
    for column in 0..columns {
        let down = across[column..].iter().step_by(columns);
        spread(down, side, opened[column..].iter_mut().step_by(columns));
    }
    opened
}

/// Whether at least `side` cells in a row, this one last, are set.
fn runs<'a>(cells: impl Iterator<Item = &'a bool>, side: usize, out: impl Iterator<Item = &'a mut bool>) {
    let mut length = 0;
    for (cell, out) in cells.zip(out) {
        length = if *cell { length + 1 } else { 0 };
        *out = length >= side;
    }
}

/// Whether one of the last `side` cells, this one among them, is set.
fn spread<'a>(cells: impl Iterator<Item = &'a bool>, side: usize, out: impl Iterator<Item = &'a mut bool>) {
    let mut left = 0;
    for (cell, out) in cells.zip(out) {
        left = if *cell { side } else { left.saturating_sub(1) };
        *out = left > 0;
    }
}

/// Groups of cells that touch along edges or at corners (8-connected), each in ascending order, by their first cells.
pub fn groups(mask: &[bool], columns: usize) -> Vec<Vec<usize>> {
    let mut free = mask.to_vec();
    let mut groups = Vec::new();
    for first in 0..free.len() {
        if std::mem::take(&mut free[first]) {
            let mut group = vec![first];
            let mut next = 0;
            while let Some(cell) = group.get(next).copied() {
                next += 1;
                for near in around(cell, columns, free.len()) {
                    if std::mem::take(&mut free[near]) {
                        group.push(near);
                    }
                }
            }
            group.sort_unstable();
            groups.push(group);
        }
    }
    groups
}

/// The cells of a grid of `count` cells around one, and that cell.
fn around(cell: usize, columns: usize, count: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (cell / columns, cell % columns);
    let rows = row.saturating_sub(1)..=(row + 1).min(count / columns - 1);
    rows.flat_map(move |r| (column.saturating_sub(1)..=(column + 1).min(columns - 1)).map(move |c| r * columns + c))
}

/// The groups of `mask` that hold at least one cell of `seeds`: opening by reconstruction.
pub fn reconstructed(mask: &[bool], seeds: &[bool], columns: usize) -> Vec<bool> {
    let mut kept = vec![false; mask.len()];
    for group in groups(mask, columns).into_iter().filter(|group| group.iter().any(|cell| seeds[*cell])) {
        group.into_iter().for_each(|cell| kept[cell] = true);
    }
    kept
}

/// Width over length of a group of cells: the square root of the ratio of its principal moments in plan, cells taken as
/// squares, not points; 1 for a square or a disc, 1/n for a line of n cells.
pub fn axis_ratio(cells: &[usize], columns: usize) -> f64 {
    let count = cells.len().max(1) as f64;
    let place = |cell: &usize| [(cell % columns) as f64, (cell / columns) as f64];
    let sum = cells.iter().map(place).fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
    let mean = sum.map(|s| s / count);
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for [x, y] in cells.iter().map(place) {
        let (dx, dy) = (x - mean[0], y - mean[1]);
        (xx, xy, yy) = (xx + dx * dx, xy + dx * dy, yy + dy * dy);
    }
    // The second moment of a square cell about its own centre is 1/12.
    let [xx, xy, yy] = [xx / count + 1.0 / 12.0, xy / count, yy / count + 1.0 / 12.0];
    let (middle, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let radius = (half * half + xy * xy).sqrt();
    ((middle - radius) / (middle + radius)).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn mask(text: &str) -> (Vec<bool>, usize) {
        let lines: Vec<&str> = text.split_whitespace().collect();
        (lines.iter().flat_map(|line| line.chars().map(|c| c == '#')).collect(), lines[0].len())
    }

    #[test]
    fn opening_removes_what_is_narrower_than_the_square() {
        let (cells, columns) = mask("#..... ##.### ##.### ...### ..#...");
        let (expected, _) = mask("...... ##.### ##.### ...### ......");
        assert_eq!(opened(&cells, columns, 2), expected);
        let (three, _) = mask("...... ...### ...### ...### ......");
        assert_eq!(opened(&cells, columns, 3), three);
        assert_eq!(opened(&cells, columns, 1), cells);
        assert!(opened(&cells, columns, 7).iter().all(|cell| !cell));
        let (restored, _) = mask("#..... ##.### ##.### ...### ..#...");
        assert_eq!(reconstructed(&cells, &expected, columns), restored);
    }

    #[test]
    fn cells_join_over_corners_and_not_over_the_border() {
        let (cells, columns) = mask("#....# .#...# ...... #....#");
        let found = groups(&cells, columns);
        assert_eq!(found, [vec![0, 7], vec![5, 11], vec![18], vec![23]]);
    }

    #[test]
    fn the_ratio_of_a_line_is_its_width_over_its_length() {
        assert!((axis_ratio(&[0, 1, 2, 3], 10) - 0.25).abs() < 1e-12);
        assert!((axis_ratio(&[0, 10, 20, 30, 1, 11, 21, 31], 10) - 0.5).abs() < 1e-12);
        assert!((axis_ratio(&[0, 1, 10, 11], 10) - 1.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn opening_is_the_union_of_the_squares_inside(cells in prop::collection::vec(any::<bool>(), 72), side in 2usize..4) {
            let columns = 9;
            let mut expected = vec![false; cells.len()];
            for row in 0..=8 - side {
                for column in 0..=columns - side {
                    let square: Vec<usize> = (0..side * side).map(|i| (row + i / side) * columns + column + i % side).collect();
                    if square.iter().all(|cell| cells[*cell]) {
                        square.into_iter().for_each(|cell| expected[cell] = true);
                    }
                }
            }
            prop_assert_eq!(opened(&cells, columns, side), expected);
        }
    }
}
