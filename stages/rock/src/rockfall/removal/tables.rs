//! What became of the candidates, one by one and by the volume of their blocks: requested against realised volumes.

use super::attempts::Attempt;
use rockface_core::artefact::{Cell, Table};
use rockface_core::numerics::{portable_math, quantile};

/// Classes of volume in a factor of ten.
const PER_DECADE: f64 = 2.0;

/// One row a candidate: where it was tried, the volume of its block, what became of it.
pub fn candidates(attempts: &[Attempt]) -> Table {
    let mut table = Table::new([
        "candidate",
        "class",
        "x_m",
        "y_m",
        "z_m",
        "block_m3",
        "accepted",
        "reason",
        "detail",
        "event",
        "removed_m3",
        "placement_shift_m",
    ]);
    for attempt in attempts {
        let place = |k: usize| attempt.position.map_or(Cell::Empty(()), |p| p[k].into());
        let mut row =
            vec![(attempt.candidate as f64).into(), attempt.class.as_str().into(), place(0), place(1), place(2)];
        row.push(attempt.block_m3.map_or(Cell::Empty(()), Cell::from));
        row.extend(match &attempt.outcome {
            Ok(taken) => [
                true.into(),
                Cell::Empty(()),
                Cell::Empty(()),
                f64::from(taken.event).into(),
                taken.removed_m3.into(),
                taken.shift_m.into(),
            ],
            Err(rejection) => [
                false.into(),
                rejection.reason.word().into(),
                rejection.detail.as_str().into(),
                Cell::Empty(()),
                Cell::Empty(()),
                Cell::Empty(()),
            ],
        });
        table.push(row);
    }
    table
}

/// One row a class of block volume that has candidates, from small to large: how many were requested (tried), how many realised
/// (taken out), quartiles of the volume removed over that of the block, how many were pushed in beyond their best place. Two
/// classes are a factor of ten. Candidates that gave no block have no volume; a last row without bounds counts them.
pub fn by_volume(attempts: &[Attempt]) -> Table {
    let mut table = Table::new([
        "from_m3",
        "to_m3",
        "requested",
        "realised",
        "realised_share",
        "removed_over_block_q25",
        "removed_over_block_median",
        "removed_over_block_q75",
        "pushed_in",
    ]);
    let mut classed: Vec<(Option<i64>, &Attempt)> = attempts.iter().map(|a| (a.block_m3.map(class), a)).collect();
    classed.sort_by_key(|(class, _)| (class.is_none(), *class));
    for members in classed.chunk_by(|a, b| a.0 == b.0) {
        table.push(row(members[0].0, members));
    }
    table
}

/// The number of the class a volume falls into; class 0 begins at 1 cubic metre.
fn class(block_m3: f64) -> i64 {
    (PER_DECADE * portable_math::log10(block_m3)).floor() as i64
}

fn row(class: Option<i64>, members: &[(Option<i64>, &Attempt)]) -> Vec<Cell> {
    let edge = |n: i64| Cell::from(portable_math::pow(10.0, n as f64 / PER_DECADE));
    let bound = |more: i64| class.map_or(Cell::Empty(()), |n| edge(n + more));
    let taken: Vec<_> = members.iter().filter_map(|(_, a)| Some((a.block_m3?, a.outcome.as_ref().ok()?))).collect();
    let shares: Vec<f64> = taken.iter().map(|(block_m3, taken)| taken.removed_m3 / block_m3).collect();
    let share = |level: f64| quantile::quantile(&shares, level).map_or(Cell::Empty(()), Cell::from);
    let pushed = taken.iter().filter(|(_, taken)| taken.shift_m > 0.0).count();
    let (requested, realised) = (members.len() as f64, taken.len() as f64);
    vec![
        bound(0),
        bound(1),
        requested.into(),
        realised.into(),
        (realised / requested).into(),
        share(0.25),
        share(0.5),
        share(0.75),
        (pushed as f64).into(),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::removal::attempts::Taken;
    use crate::rockfall::removal::reason::Reason;

    fn attempt(block_m3: Option<f64>, taken: Option<(f64, f64)>) -> Attempt {
        let outcome = match taken {
            Some((removed_m3, shift_m)) => Ok(Taken { event: 1, removed_m3, shift_m }),
            None => Err(Reason::NoBlock.into()),
        };
        Attempt { candidate: 0, class: String::new(), position: None, block_m3, outcome }
    }

    #[test]
    fn candidates_are_counted_by_the_volume_of_their_block() {
        let table = by_volume(&[
            attempt(Some(2.0), Some((1.0, 0.0))),
            attempt(None, None),
            attempt(Some(0.02), None),
            attempt(Some(1.0), Some((0.9, 0.1))),
            attempt(Some(3.1), None),
            attempt(Some(3.2), Some((3.2, 0.0))),
        ]);
        let numbers = |row: &Vec<Cell>| row.iter().map(|cell| cell.number().unwrap_or(-1.0)).collect::<Vec<_>>();
        let rows: Vec<Vec<f64>> = table.rows.iter().map(numbers).collect();
        assert_eq!(rows.len(), 4);
        let near = |row: &[f64], wanted: [f64; 9]| row.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(&rows[0], [0.01, 0.1_f64.sqrt() / 10.0, 1.0, 0.0, 0.0, -1.0, -1.0, -1.0, 0.0]), "{rows:?}");
        assert!(near(&rows[1], [1.0, 10.0_f64.sqrt(), 3.0, 2.0, 2.0 / 3.0, 0.6, 0.7, 0.8, 1.0]), "{rows:?}");
        assert!(near(&rows[2], [10.0_f64.sqrt(), 10.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]), "{rows:?}");
        assert!(near(&rows[3], [-1.0, -1.0, 1.0, 0.0, 0.0, -1.0, -1.0, -1.0, 0.0]), "{rows:?}");
    }
}
