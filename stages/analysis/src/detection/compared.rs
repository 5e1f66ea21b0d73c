//! Inventories and label rasters as objects on the cells of one grid, and what a comparison adds to their columns.

use rockface_core::artefact::{Cell, Feature, Grid, Inventory, Raster};
use rockface_core::numerics::portable_math;
use rockface_core::{StageError, fail};
use rockface_rock::rockfall::inventory_labels;

use super::score::{Object, Score};

/// The cells of each feature whose centres its outlines hold, and `seen` says can be compared; ascending.
pub fn cells(inventory: &Inventory, grid: &Grid, seen: &[bool]) -> Vec<Vec<usize>> {
    let of = |feature: &Feature| {
        let Some((window, first)) = window(feature, grid) else { return Vec::new() };
        let burned = inventory_labels::burn(&[(1, feature)], &window);
        let place = |at: usize| first + at / window.columns * grid.columns + at % window.columns;
        let held = burned.iter().enumerate().filter(|(_, label)| **label > 0.0).map(|(at, _)| place(at));
        held.filter(|cell| seen[*cell]).collect()
    };
    inventory.features.iter().map(of).collect()
}

/// The part of the grid around a feature, and the number of its first cell.
fn window(feature: &Feature, grid: &Grid) -> Option<(Grid, usize)> {
    let points = || feature.outline.iter().flat_map(|polygon| &polygon.exterior);
    let fold = |axis: usize, pick: fn(f64, f64) -> f64| points().map(|p| p[axis]).reduce(pick);
    let cell = |[x, y]: [f64; 2]| {
        let [column, row] = grid.in_cells([x, y]);
        [column.clamp(-1.0, grid.columns as f64), row.clamp(-1.0, grid.rows as f64)].map(|at| at.floor() as i64)
    };
    let inside = |value: i64, last: usize| value.clamp(0, last as i64 - 1) as usize;
    let [left, top] = cell([fold(0, f64::min)?, fold(1, f64::max)?]);
    let [right, bottom] = cell([fold(0, f64::max)?, fold(1, f64::min)?]);
    if right < 0 || bottom < 0 || left >= grid.columns as i64 || top >= grid.rows as i64 {
        return None;
    }
    let (left, right) = (inside(left, grid.columns), inside(right, grid.columns));
    let (top, bottom) = (inside(top, grid.rows), inside(bottom, grid.rows));
    Some((grid.part(left..right + 1, top..bottom + 1), top * grid.columns + left))
}

/// The labels of a raster on the grid of the comparison, ascending, each with its cells that `seen` says can be compared.
///
/// # Errors
/// A label that is no whole number of 0 or more.
pub fn labelled(labels: &Raster, seen: &[bool]) -> Result<Vec<(u32, Vec<usize>)>, StageError> {
    let mut objects: std::collections::BTreeMap<u32, Vec<usize>> = std::collections::BTreeMap::new();
    for (cell, value) in labels.bands.first().map_or(&[][..], |band| &band.values).iter().enumerate() {
        if value.is_nan() || value.to_bits() == 0 {
            continue;
        }
        if value.fract() != 0.0 || *value < 0.0 {
            fail!("cell {cell} of the labels is {value}, which is no whole number");
        }
        let cells = objects.entry(*value as u32).or_default();
        if seen[cell] {
            cells.push(cell);
        }
    }
    Ok(objects.into_iter().filter(|(label, _)| *label > 0).collect())
}

/// The number of each feature: its `id` where there is one, otherwise counted from 1.
pub fn numbers(inventory: &Inventory) -> Vec<f64> {
    let given = inventory.numbers("id").unwrap_or_else(|| vec![None; inventory.features.len()]);
    given.into_iter().enumerate().map(|(place, id)| id.unwrap_or((place + 1) as f64)).collect()
}

/// Columns that [`judged`] gives to the true changes.
pub const TRUTH_COLUMNS: [&str; 7] =
    ["outcome", "detections", "detection", "iou", "detected_m3", "volume_error", "log_volume_ratio"];
/// Columns that [`judged`] gives to the detections.
pub const DETECTION_COLUMNS: [&str; 7] =
    ["outcome", "truths", "truth", "iou", "truth_m3", "volume_error", "log_volume_ratio"];

/// One side of a comparison.
pub struct Side<'a> {
    /// The true changes or the detections, with their properties.
    pub inventory: &'a Inventory,
    /// The cells of each of them on the common grid.
    pub objects: &'a [Object],
}

/// The inventory of the true changes, or of the detections, with the outcome of each.
///
/// Outcomes are `found`, `missed` and `hidden` for true changes, `true_positive`, `false_positive` and `outside` for
/// detections. Partner, intersection over union and volumes are those of the one-to-one pairs; the volume error is
/// (detected - true) / true, the log ratio ln(detected / true). Columns of the same names are replaced.
pub fn judged(score: &Score, sides: [&Side; 2], truths: bool) -> Inventory {
    let [own, other] = if truths { sides } else { [sides[1], sides[0]] };
    let (columns, words) = if truths {
        (TRUTH_COLUMNS, ["found", "missed", "hidden"])
    } else {
        (DETECTION_COLUMNS, ["true_positive", "false_positive", "outside"])
    };
    let partners = numbers(other.inventory);
    let mut inventory = own.inventory.clone();
    drop_columns(&mut inventory, &columns);
    inventory.columns.extend(columns.map(str::to_owned));
    for (number, (feature, object)) in inventory.features.iter_mut().zip(own.objects).enumerate() {
        let matches = if truths { score.of_truth(number) } else { score.of_detection(number) };
        let word = if object.counts { words[usize::from(matches == 0)] } else { words[2] };
        let pair = score.pairs.iter().find(|pair| number == if truths { pair.truth } else { pair.detection });
        let partner = pair.map(|pair| if truths { pair.detection } else { pair.truth });
        let volume = partner.and_then(|partner| other.objects[partner].volume_m3);
        let [truth, detected] = if truths { [object.volume_m3, volume] } else { [volume, object.volume_m3] };
        let ratio = truth.zip(detected).filter(|(t, d)| *t > 0.0 && *d > 0.0).map_or(f64::NAN, |(t, d)| d / t);
        feature.values.push(word.into());
        let numbers = [
            matches as f64,
            partner.map_or(f64::NAN, |partner| partners[partner]),
            pair.map_or(f64::NAN, |pair| pair.iou),
            volume.unwrap_or(f64::NAN),
            ratio - 1.0,
            if ratio > 0.0 { portable_math::log(ratio) } else { f64::NAN },
        ];
        feature.values.extend(numbers.map(Cell::from));
    }
    inventory
}

fn drop_columns(inventory: &mut Inventory, names: &[&str]) {
    let kept: Vec<usize> =
        (0..inventory.columns.len()).filter(|at| !names.contains(&inventory.columns[*at].as_str())).collect();
    inventory.columns = kept.iter().map(|at| inventory.columns[*at].clone()).collect();
    for feature in &mut inventory.features {
        feature.values = kept.iter().map(|at| feature.values[*at].clone()).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Polygon};

    const GRID: Grid = Grid { columns: 10, rows: 6, cell_m: 0.5, left_m: 1.0, top_m: 3.0 };

    fn square(left: f64, right: f64, bottom: f64, top: f64) -> Feature {
        let exterior = vec![[left, bottom], [right, bottom], [right, top], [left, top]];
        Feature { outline: vec![Polygon { exterior, holes: Vec::new() }], values: Vec::new() }
    }

    #[test]
    fn outlines_become_the_cells_they_hold_wherever_they_lie() {
        let outside = square(-9.0, -8.0, 0.0, 1.0);
        let features =
            vec![square(2.0, 3.0, 1.0, 2.0), square(0.0, 1.6, 2.6, 9.0), outside, square(-5.0, 50.0, -9.0, 9.0)];
        let inventory = Inventory { frame: Frame::Wall, columns: Vec::new(), features };
        let mut seen = vec![true; 60];
        seen[22] = false;
        let found = cells(&inventory, &GRID, &seen);
        assert_eq!(found[0], [23, 32, 33]);
        assert_eq!((found[1].as_slice(), found[2].len(), found[3].len()), (&[0][..], 0, 59));
        assert_eq!(numbers(&inventory), [1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn labels_are_objects_and_odd_ones_are_refused() {
        let grid = Grid { columns: 3, rows: 1, ..GRID };
        let labels = |values: Vec<f32>| Raster::single(grid, Frame::Wall, "label", "l", values);
        let found = labelled(&labels(vec![7.0, 0.0, 7.0]), &[true, true, false]).unwrap();
        assert_eq!(found, [(7, vec![0])]);
        assert!(labelled(&labels(vec![0.5, 0.0, f32::NAN]), &[true; 3]).unwrap_err().message.contains("cell 0"));
    }
}
