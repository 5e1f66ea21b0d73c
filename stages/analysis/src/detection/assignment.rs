//! The assignment problem: pairs between two sets, each element in one pair at most, of the greatest total weight.

/// For each of `rows`, the column it is paired with; `weights` are (row, column, weight) of the pairs there may be, with
/// positive weights, every other pair being impossible.
///
/// The Hungarian method with shortest augmenting paths and potentials, on the columns that have a weight; a row may stay
/// alone at weight 0.
///
/// # References
/// Kuhn, H. W. (1955), The Hungarian method for the assignment problem, Naval Research Logistics Quarterly 2, 83-97.
/// Jonker, R., Volgenant, A. (1987), A shortest augmenting path algorithm for dense and sparse linear assignment problems,
/// Computing 38, 325-340.
pub fn heaviest(rows: usize, weights: &[(usize, usize, f64)]) -> Vec<Option<usize>> {
    let mut columns: Vec<usize> = weights.iter().map(|(_, column, _)| *column).collect();
    columns.sort_unstable();
    columns.dedup();
    // A column of its own for each row: to stay alone.
    let count = columns.len() + rows;
    let mut costs = vec![vec![1.0; count]; rows];
    for (row, costs) in costs.iter_mut().enumerate() {
        costs[columns.len() + row] = 0.0;
    }
    for (row, column, weight) in weights {
        let place = columns.partition_point(|c| c < column);
        costs[*row][place] = -weight;
    }
    let owner = cheapest(&costs, count);
    let mut found = vec![None; rows];
    for (place, row) in owner.iter().enumerate().take(columns.len()) {
        if let Some(row) = row.filter(|row| costs[*row][place] < 0.0) {
            found[row] = Some(columns[place]);
        }
    }
    found
}

/// The row of each column in the cheapest assignment of all rows; there are at least as many columns as rows.
fn cheapest(costs: &[Vec<f64>], columns: usize) -> Vec<Option<usize>> {
    let (mut of_row, mut of_column) = (vec![0.0; costs.len()], vec![0.0; columns]);
    let mut owner: Vec<Option<usize>> = vec![None; columns];
    for start in 0..costs.len() {
        let (mut least, mut from) = (vec![f64::INFINITY; columns], vec![None; columns]);
        let mut done = vec![false; columns];
        let (mut row, mut last) = (start, None);
        let end = loop {
            let (mut step, mut next) = (f64::INFINITY, 0);
            for column in (0..columns).filter(|column| !done[*column]) {
                let reduced = costs[row][column] - of_row[row] - of_column[column];
                if reduced < least[column] {
                    (least[column], from[column]) = (reduced, last);
                }
                if least[column] < step {
                    (step, next) = (least[column], column);
                }
            }
            of_row[start] += step;
            for column in 0..columns {
                match owner[column].filter(|_| done[column]) {
                    Some(row) => (of_row[row], of_column[column]) = (of_row[row] + step, of_column[column] - step),
                    None => least[column] -= step,
                }
            }
            done[next] = true;
            last = Some(next);
            match owner[next] {
                Some(taken) => row = taken,
                None => break next,
            }
        };
        // Along the path every column takes the row of the one before; the first takes the new row.
        let mut column = end;
        while let Some(before) = from[column] {
            owner[column] = owner[before];
            column = before;
        }
        owner[column] = Some(start);
    }
    owner
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_greedy_choice_is_left_where_the_whole_gains() {
        let found = heaviest(3, &[(0, 7, 0.9), (0, 9, 0.8), (1, 7, 0.85), (2, 4, 0.1)]);
        assert_eq!(found, [Some(9), Some(7), Some(4)]);
        assert_eq!(heaviest(2, &[]), [None, None]);
        assert_eq!(heaviest(2, &[(0, 3, 0.5), (1, 3, 0.6)]), [None, Some(3)]);
        assert!(heaviest(0, &[]).is_empty());
    }

    /// The greatest sum by trying everything.
    fn best(rows: &[Vec<f64>], row: usize, taken: u32) -> f64 {
        let Some(weights) = rows.get(row) else { return 0.0 };
        let free = (0..weights.len()).filter(|c| taken & (1 << c) == 0 && weights[*c] > 0.0);
        free.map(|c| weights[c] + best(rows, row + 1, taken | 1 << c)).fold(best(rows, row + 1, taken), f64::max)
    }

    proptest! {
        #[test]
        fn no_other_assignment_is_heavier(rows in prop::collection::vec(prop::collection::vec(-0.5f64..1.0, 5), 1..6)) {
            let pairs = rows.iter().enumerate().flat_map(|(r, w)| w.iter().enumerate().map(move |(c, w)| (r, c, *w)));
            let weights: Vec<_> = pairs.filter(|(.., weight)| *weight > 0.0).collect();
            let found = heaviest(rows.len(), &weights);
            let sum: f64 = found.iter().enumerate().filter_map(|(r, c)| c.map(|c| rows[r][c])).sum();
            prop_assert!((sum - best(&rows, 0, 0)).abs() < 1e-9);
            let mut used: Vec<usize> = found.into_iter().flatten().collect();
            used.sort_unstable();
            prop_assert!(used.windows(2).all(|pair| pair[0] != pair[1]));
        }
    }
}
