//! What is odd about rasters that are tested: copies, references, other grids and gaps, and tests that say little.

use rockface_core::artefact::Table;
use rockface_core::numerics::quantile::quantile;
use rockface_raster::feature_rows::{FeatureRow, Items};

use super::perfect_simulator::Expectation;

/// Features at least by which a copy is known: single ones of different rasters are often equal, such as nuggets of 0.
const TELLING_FEATURES: usize = 3;

/// Features of copies differ by less, as a share of their size: by the rounding of a file at most.
const COPY: f64 = 1e-6;

/// Who rasters are, and what their copies do.
#[derive(Debug, Clone, Copy)]
pub enum Role {
    /// Real rasters.
    Reference,
    /// Rasters that are tested.
    Simulated,
}

/// A sentence where rasters have the features of an earlier one, as copied files have, or replicates with the same random numbers; `None` where none has.
pub fn copies(rows: &[FeatureRow], role: Role) -> Option<String> {
    let originals = originals(rows);
    let copied: Vec<(usize, usize)> = originals.into_iter().enumerate().filter(|(i, original)| i != original).collect();
    let (copy, original) = copied.first()?;
    let (who, advice) = match role {
        Role::Reference => ("reference", "are files copied? They narrow the acceptance region; leave them out"),
        Role::Simulated => (
            "simulated",
            "have replicates the same random numbers, or are files copied? Each is counted, but together they say no more than \
             one raster, and nothing of how simulations vary",
        ),
    };
    Some(format!(
        "{} of {} {who} rasters have the features of an earlier one, such as `{}` those of `{}`: {advice}",
        copied.len(),
        rows.len(),
        rows[*copy].label(),
        rows[*original].label(),
    ))
}

/// Of each raster the first one that has the same features: itself, where no earlier one has.
fn originals(rows: &[FeatureRow]) -> Vec<usize> {
    let mut originals: Vec<usize> = (0..rows.len()).collect();
    if rows.iter().any(|row| row.values.len() < TELLING_FEATURES) {
        return originals;
    }
    let same = |a: f64, b: f64| (a - b).abs() <= COPY * a.abs().max(b.abs());
    let first = |i: usize| rows[i].values[0];
    let mut order = originals.clone();
    order.sort_by(|a, b| first(*a).total_cmp(&first(*b)));
    for (place, i) in order.iter().enumerate() {
        let before = order[..place].iter().rev().take_while(|j| same(first(*i), first(**j)));
        let is_copy = |j: &&usize| rows[*i].values.iter().zip(&rows[**j].values).all(|(a, b)| same(*a, *b));
        if let Some(j) = before.into_iter().find(is_copy) {
            originals[*i] = originals[*j];
        }
    }
    // Sorted by a feature, the first of equal rasters need not be the earliest.
    let mut earliest: Vec<usize> = (0..rows.len()).collect();
    for (i, group) in originals.iter().enumerate().rev() {
        earliest[*group] = i;
    }
    originals.iter().map(|group| earliest[*group]).collect()
}

/// Distances of one raster from one model, as a share of each other: they differ by rounding at most.
const SAME: f64 = 1e-9;

/// A sentence where most of the rasters that are tested have the distance of a reference; `None` otherwise.
pub fn references(tested_d2: &[f64], reference_d2: &[f64]) -> Option<String> {
    let is_reference = |found: &&f64| reference_d2.iter().any(|d2| (d2 - **found).abs() <= SAME * d2);
    let (known, n) = (tested_d2.iter().filter(is_reference).count(), tested_d2.len());
    (2 * known > n).then(|| {
        format!(
            "{known} of {n} rasters are references of the model itself. The range is that of new rasters; of references more are accepted"
        )
    })
}

/// A test is weak where the range of a perfect simulator begins below this share of the rasters.
const WEAK: f64 = 0.125;

/// Of fewer rasters every range begins near 0.
const ENOUGH: usize = 8;

/// A sentence where a test of `n` rasters can hardly find that they are too far off, by the range of a perfect simulator; `None` where it can.
pub fn weak(band: &Expectation, n: usize, references: usize, features: usize) -> Option<String> {
    (n >= ENOUGH && (band.low as f64) < WEAK * n as f64).then(|| {
        format!(
            "this test can hardly reject: a perfect simulator may have as few as {} of {n} accepted, with {references} references for \
             {features} features; give it more references, or fewer features",
            band.low
        )
    })
}

/// The range of a perfect simulator as the end of a sentence; it says which counts this test of `n` rasters cannot find wrong.
pub fn range(band: &Expectation, n: usize) -> String {
    let silent = match (band.low == 0, band.high >= n) {
        (true, true) => ": every count is possible",
        (true, false) => ": no count is too low",
        (false, true) => ": no count is too high",
        (false, false) => "",
    };
    format!("a perfect simulator would have {} to {}{silent}", band.low, band.high)
}

/// A median D2 is warned of where it is beyond its band by more than this factor: the band holds some 90 % of perfect simulators.
const MARGIN: f64 = 1.25;

/// A sentence where as many of the rasters are accepted as of a perfect simulator, but the median of their D2 is not what it would be; `None` otherwise.
pub fn far_off(band: &Expectation, accepted: usize, d2: &[f64]) -> Option<String> {
    let median = quantile(d2, 0.5)?;
    let [low, high] = band.median_d2?;
    let enough = d2.len() >= ENOUGH && band.holds(accepted);
    let why = if median > high {
        "they lie farther from the references than others of the same kind would: the noise is another, though the count does not show it"
    } else {
        "they lie nearer to the references than others of the same kind would: their spread is narrower than the real one"
    };
    (enough && (median > MARGIN * high || MARGIN * median < low)).then(|| {
        format!("the median D2 of the rasters is {median:.1}, of a perfect simulator {low:.1} to {high:.1}; {why}")
    })
}

/// Columns that say how much of a raster there is.
const EXTENTS: [&str; 2] = ["valid_cells", "nan_share"];
/// Cells with a value, as a factor, from which on rasters differ in size or cell.
const OTHER_SIZE: f64 = 1.5;
/// Share of the cells without a value that others have more or less of.
const OTHER_GAPS: f64 = 0.1;

/// A sentence where the rasters that are tested have other numbers of cells, or other gaps, than the references; `None` where they have the same, or their
/// tables do not say.
pub fn other_extent(reference: &[(&Items, &Table)], tested: &[(&Items, &Table)]) -> Option<String> {
    let middle = |tables: &[(&Items, &Table)], name: &str| {
        let numbers = tables.iter().filter_map(|(_, table)| Some((table.column(name)?, *table)));
        let numbers = numbers.flat_map(|(at, table)| table.rows.iter().filter_map(move |row| row[at].number()));
        quantile(&numbers.collect::<Vec<f64>>(), 0.5)
    };
    let [cells, gaps] = EXTENTS.map(|name| Some([middle(reference, name)?, middle(tested, name)?]));
    let other_size = cells.filter(|[real, found]| found / real > OTHER_SIZE || real / found > OTHER_SIZE);
    let other_gaps = gaps.filter(|[real, found]| (found - real).abs() > OTHER_GAPS);
    let size = other_size.map(|[real, found]| format!("{found} cells with a value, the references {real}"));
    let gaps = other_gaps.map(|[real, found]| {
        format!("no value on {:.0} % of their cells, the references on {:.0} %", 100.0 * found, 100.0 * real)
    });
    let differs: Vec<String> = [size, gaps].into_iter().flatten().collect();
    (!differs.is_empty()).then(|| {
        format!(
            "the rasters that are tested have {} (medians): features depend on size, cell and gaps of a raster; give both one grid and one mask (`apply-mask`)",
            differs.join(", and ")
        )
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use rockface_core::artefact::Cell;

    fn row(name: usize, values: [f64; 3]) -> FeatureRow {
        FeatureRow { raster: format!("r{name}"), items: BTreeMap::default(), values: values.to_vec() }
    }

    #[test]
    fn copies_differ_by_rounding_at_most_and_the_earliest_is_named() {
        let rows: Vec<FeatureRow> = [[1.0, 5.0, 0.0], [2.0, 4.0, 1.0], [1.0 - 1e-8, 5.0, 0.0], [2.0, 4.0, 1.0 + 1e-7]]
            .into_iter()
            .enumerate()
            .map(|(i, values)| row(i, values))
            .collect();
        let told = copies(&rows, Role::Simulated).unwrap();
        assert!(told.starts_with("2 of 4 simulated rasters") && told.contains("`r2` those of `r0`"), "{told}");
        let apart = [row(0, [1.0, 5.0, 0.0]), row(1, [1.0, 5.0, 1e-9]), row(2, [1.0, 5.00001, 0.0])];
        assert_eq!(copies(&apart, Role::Reference), None);
        assert_eq!(originals(&vec![row(0, [0.0, 1.0, 2.0]); 5]), [0; 5]);
    }

    #[test]
    fn the_side_without_power_is_told() {
        let band = |low, high| Expectation { share: 0.5, low, high, median_d2: Some([5.0, 20.0]) };
        assert_eq!(range(&band(0, 30), 40), "a perfect simulator would have 0 to 30: no count is too low");
        assert!(range(&band(0, 40), 40).ends_with("every count is possible"));
        assert!(range(&band(12, 40), 40).ends_with("12 to 40: no count is too high"));
        assert!(range(&band(12, 39), 40).ends_with("12 to 39"));
        assert!(weak(&band(4, 30), 40, 12, 10).unwrap().contains("12 references for 10 features"));
        assert!(weak(&band(5, 30), 40, 12, 10).is_none() && weak(&band(0, 2), 4, 12, 10).is_none());
        let told = |accepted, d2: f64| far_off(&band(0, 12), accepted, &[d2; 40]);
        assert!(told(0, 7693.0).unwrap().contains("7693.0, of a perfect simulator 5.0 to 20.0; they lie farther"));
        assert!(told(9, 1.0).unwrap().contains("nearer") && told(9, 10.0).is_none() && told(13, 7693.0).is_none());
    }

    #[test]
    fn other_sizes_and_gaps_are_told() {
        let extents = |cells: f64, gaps: f64| {
            let mut table = Table::new(["raster", "valid_cells", "nan_share"]);
            table.push(vec!["r".into(), Cell::from(cells), gaps.into()]);
            table
        };
        let items = Items::default();
        let told = |cells: f64, gaps: f64| {
            other_extent(&[(&items, &extents(4000.0, 0.2))], &[(&items, &extents(cells, gaps))])
        };
        assert_eq!(told(3900.0, 0.22), None);
        assert!(told(16000.0, 0.2).unwrap().contains("have 16000 cells with a value, the references 4000 (medians)"));
        assert!(told(4800.0, 0.0).unwrap().contains("no value on 0 % of their cells, the references on 20 %"));
        let bare = Table::new(["raster"]);
        assert_eq!(other_extent(&[(&items, &bare)], &[(&items, &extents(1.0, 0.0))]), None);
    }
}
