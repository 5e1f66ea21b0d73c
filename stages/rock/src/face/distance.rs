//! Exact distances of cells to the nearest marked cell.

use rayon::prelude::*;

/// Squared distance of each cell's centre to that of the nearest marked cell, in square cells, by row; `None` where no cell
/// is marked.
///
/// Two passes over the columns and one over each row, all in whole numbers (Meijster, Roerdink and Hesselink 2000), so the
/// result is exact. Rows and columns together must be fewer than 2^31.
pub fn squared(marked: &[bool], columns: usize) -> Option<Vec<u64>> {
    if !marked.contains(&true) {
        return None;
    }
    let mut squared = along_columns(marked, columns);
    squared.par_chunks_mut(columns).for_each(along_row);
    Some(squared)
}

/// Distance to the nearest marked cell of the same column, in cells; farther than any cell where there is none.
fn along_columns(marked: &[bool], columns: usize) -> Vec<u64> {
    let rows = marked.len() / columns;
    let far = (rows + columns) as u64;
    let mut gaps: Vec<u64> = marked.iter().map(|marked| if *marked { 0 } else { far }).collect();
    for cell in columns..gaps.len() {
        gaps[cell] = gaps[cell].min(gaps[cell - columns] + 1);
    }
    for cell in (0..gaps.len() - columns).rev() {
        gaps[cell] = gaps[cell].min(gaps[cell + columns] + 1);
    }
    gaps
}

/// Replaces the gaps of a row by squared distances: the lower envelope of the parabolas over its cells.
fn along_row(row: &mut [u64]) {
    let gaps: Vec<i64> = row.iter().map(|gap| *gap as i64).collect();
    let value = |x: i64, at: i64| (x - at) * (x - at) + gaps[at as usize] * gaps[at as usize];
    // From which cell on the parabola of `u` lies below that of `i < u`.
    let crossing = |i: i64, u: i64| {
        let (gi, gu) = (gaps[i as usize], gaps[u as usize]);
        (u * u - i * i + gu * gu - gi * gi).div_euclid(2 * (u - i)) + 1
    };
    let last = gaps.len() as i64 - 1;
    let mut envelope: Vec<(i64, i64)> = vec![(0, 0)];
    for u in 1..=last {
        while envelope.last().is_some_and(|(at, from)| value(*from, *at) > value(*from, u)) {
            envelope.pop();
        }
        let from = envelope.last().map_or(0, |(at, _)| crossing(*at, u));
        if from <= last {
            envelope.push((u, from));
        }
    }
    let mut end = last;
    for (at, from) in envelope.into_iter().rev() {
        for x in from..=end {
            row[x as usize] = value(x, at) as u64;
        }
        end = from - 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_are_those_of_looking_at_every_cell(
            columns in 1usize..24,
            cells in prop::collection::vec(prop::bool::weighted(0.04), 1..400)
        ) {
            let rows = cells.len().div_ceil(columns);
            let mut marked = cells.clone();
            marked.resize(rows * columns, false);
            let place = |cell: usize| ((cell / columns) as i64, (cell % columns) as i64);
            let all: Vec<_> = (0..marked.len()).filter(|cell| marked[*cell]).map(place).collect();
            let nearest = |cell: usize| {
                let (row, column) = place(cell);
                all.iter().map(|(r, c)| ((r - row) * (r - row) + (c - column) * (c - column)) as u64).min()
            };
            let expected: Option<Vec<u64>> = (0..marked.len()).map(nearest).collect();
            prop_assert_eq!(squared(&marked, columns), expected);
        }
    }
}
