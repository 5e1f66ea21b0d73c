//! What became of the candidates, one by one and by the volume of their blocks: requested against realised volumes.

use super::attempts::Attempt;
use rockface_core::artefact::Table;
use rockface_core::numerics::{portable_math, quantile};
use rockface_core::table_row;

/// Classes of volume in a factor of ten.
const PER_DECADE: f64 = 2.0;

table_row! {
    /// What became of one candidate.
    struct Candidate {
        candidate: f64,
        class: String,
        x_m: Option<f64>,
        y_m: Option<f64>,
        z_m: Option<f64>,
        block_m3: Option<f64>,
        accepted: bool,
        reason: Option<&'static str>,
        detail: Option<String>,
        event: Option<f64>,
        removed_m3: Option<f64>,
        placement_shift_m: Option<f64>,
    }
}

/// One row a candidate: where it was tried, the volume of its block, what became of it.
pub fn candidates(attempts: &[Attempt]) -> Table {
    attempts.iter().map(candidate).collect()
}

fn candidate(attempt: &Attempt) -> Candidate {
    let place = |axis: usize| attempt.position.map(|position| position[axis]);
    let (taken, rejection) = (attempt.outcome.as_ref().ok(), attempt.outcome.as_ref().err());
    Candidate {
        candidate: attempt.candidate as f64,
        class: attempt.class.clone(),
        x_m: place(0),
        y_m: place(1),
        z_m: place(2),
        block_m3: attempt.block_m3,
        accepted: taken.is_some(),
        reason: rejection.map(|rejection| rejection.reason.word()),
        detail: rejection.map(|rejection| rejection.detail.clone()),
        event: taken.map(|taken| f64::from(taken.event)),
        removed_m3: taken.map(|taken| taken.removed_m3),
        placement_shift_m: taken.map(|taken| taken.shift_m),
    }
}

table_row! {
    /// The candidates of one class of block volume.
    struct VolumeClass {
        from_m3: Option<f64>,
        to_m3: Option<f64>,
        requested: usize,
        realised: usize,
        realised_share: f64,
        removed_over_block_q25: Option<f64>,
        removed_over_block_median: Option<f64>,
        removed_over_block_q75: Option<f64>,
        pushed_in: usize,
    }
}

/// One row a class of block volume that has candidates, from small to large: how many were requested (tried), how many realised
/// (taken out), quartiles of the volume removed over that of the block, how many were pushed in beyond their best place. Two
/// classes are a factor of ten. Candidates that gave no block count with the volume they were to
/// have; a last row without bounds counts those of which no shape came about.
pub fn by_volume(attempts: &[Attempt]) -> Table {
    let mut classed: Vec<(Option<i64>, &Attempt)> = attempts.iter().map(|a| (a.block_m3.map(class), a)).collect();
    classed.sort_by_key(|(class, _)| (class.is_none(), *class));
    classed.chunk_by(|a, b| a.0 == b.0).map(|members| volume_class(members[0].0, members)).collect()
}

/// The number of the class a volume falls into; class 0 begins at 1 cubic metre.
fn class(block_m3: f64) -> i64 {
    (PER_DECADE * portable_math::log10(block_m3)).floor() as i64
}

fn volume_class(class: Option<i64>, members: &[(Option<i64>, &Attempt)]) -> VolumeClass {
    let bound = |more: i64| class.map(|n| portable_math::pow(10.0, (n + more) as f64 / PER_DECADE));
    let taken: Vec<_> = members.iter().filter_map(|(_, a)| Some((a.block_m3?, a.outcome.as_ref().ok()?))).collect();
    let shares: Vec<f64> = taken.iter().map(|(block_m3, taken)| taken.removed_m3 / block_m3).collect();
    let share = |level: f64| quantile::quantile(&shares, level);
    VolumeClass {
        from_m3: bound(0),
        to_m3: bound(1),
        requested: members.len(),
        realised: taken.len(),
        realised_share: taken.len() as f64 / members.len() as f64,
        removed_over_block_q25: share(0.25),
        removed_over_block_median: share(0.5),
        removed_over_block_q75: share(0.75),
        pushed_in: taken.iter().filter(|(_, taken)| taken.shift_m > 0.0).count(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::removal::attempts::Taken;
    use crate::rockfall::removal::reason::Reason;
    use rockface_core::artefact::Cell;

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
