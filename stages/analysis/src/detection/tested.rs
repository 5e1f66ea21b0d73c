//! How much of the face a detector could test: where little was seen, nothing found does not mean that nothing fell.

use std::collections::BTreeSet;

use rockface_core::artefact::{Grid, Table};
use rockface_core::table_row;

use super::change::Change;
use super::found::Found;

/// The share that was tested from which on a headline does not mention it.
const MENTIONED_BELOW: f64 = 0.98;
/// The share of the face of the reference that was tested below which a survey clearly saw less than the reference.
const WARNED_BELOW: f64 = 0.9;

/// What a share that was tested is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Whole {
    /// The face as the reference has it.
    Reference,
    /// All cells of the grid, also those beside the face: the face is not known.
    Grid,
}

/// How much a detector could test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tested {
    /// Tested share of the whole, 0 to 1; NaN where it is not known.
    pub share: f64,
    /// What the share is of.
    pub whole: Whole,
    /// Area in plan that was tested, square metres; NaN where it is not known.
    pub area_m2: f64,
}

impl Tested {
    /// What a headline says behind the changes; nothing where all, or nearly all, was tested.
    pub fn words(&self) -> String {
        let of = match self.whole {
            Whole::Reference => "the face of the reference",
            Whole::Grid => "the grid",
        };
        if self.share < MENTIONED_BELOW { format!(", on {} of {of}", percent(self.share)) } else { String::new() }
    }

    /// The warning where clearly less was seen than the reference has.
    pub fn warning(&self) -> Option<String> {
        let is_little = self.whole == Whole::Reference && self.share < WARNED_BELOW;
        is_little.then(|| {
            format!(
                "changes are known on {} of the face of the reference only: what fell elsewhere is not found, and that few or no changes are found says \
                 nothing about it; see what both surveys saw, or crop or mask the reference too where the rest does not matter",
                percent(self.share)
            )
        })
    }
}

/// A share for people: whole percent, or with a digit more where these would hide it.
fn percent(share: f64) -> String {
    if share > 0.0 && share < 0.01 { format!("{:.1} %", 100.0 * share) } else { format!("{:.0} %", 100.0 * share) }
}

table_row! {
    /// What a detector found, in one row: also where that is nothing, so that a list over epochs has each of them.
    struct Summary<'a> {
        method: &'a str,
        change: &'a str,
        detections: usize,
        volume_m3: f64,
        lod95_median_m: Option<f64>,
        tested_share: f64,
        tested_m2: f64,
    }
}

/// The table of one row about what a detector found; the limit of detection is `None` where it knows none.
pub fn summary(method: &str, change: Change, found: &[Found], lod95_median_m: Option<f64>, tested: &Tested) -> Table {
    let volume_m3 = found.iter().fold(0.0, |sum, found| sum + found.volume_m3);
    let row = Summary {
        method,
        change: change.word(),
        detections: found.len(),
        volume_m3,
        lod95_median_m,
        tested_share: tested.share,
        tested_m2: tested.area_m2,
    };
    std::iter::once(row).collect()
}

/// The share of cells that were not tested at the rims of what was found, of all its cells, that is worth a warning, and how many at least.
const UNTESTED_SHARE: f64 = 0.15;
const UNTESTED_CELLS: usize = 10;

/// How many cells that were not tested touch what was found, and how many cells that has, where these are so many that volumes are too small.
pub fn beside(found: &[Found], grid: &Grid, is_untested: impl Fn(usize) -> bool) -> Option<[usize; 2]> {
    let mut untested = BTreeSet::new();
    for (row, column) in found.iter().flat_map(|found| &found.cells) {
        let rows = row.saturating_sub(1)..=(row + 1).min(grid.rows - 1);
        let columns = column.saturating_sub(1)..=(column + 1).min(grid.columns - 1);
        let around = rows.flat_map(|row| columns.clone().map(move |column| row * grid.columns + column));
        untested.extend(around.filter(|cell| is_untested(*cell)));
    }
    let cells: usize = found.iter().map(|found| found.cells.len()).sum();
    let are_many = untested.len() >= UNTESTED_CELLS && untested.len() as f64 > UNTESTED_SHARE * cells as f64;
    are_many.then_some([untested.len(), cells])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_told_where_they_matter() {
        let words = |share: f64, whole| Tested { share, whole, area_m2: 1.0 }.words();
        assert_eq!(words(0.985, Whole::Reference), "");
        assert_eq!(words(0.468, Whole::Reference), ", on 47 % of the face of the reference");
        assert_eq!(words(0.004, Whole::Grid), ", on 0.4 % of the grid");
        assert_eq!(words(f64::NAN, Whole::Grid), "");
    }
}
