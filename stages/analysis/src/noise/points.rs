//! Points of a parameter space: where simulated rasters were made, and where to look next.

use std::collections::BTreeMap;

use rockface_core::artefact::{Cell, Table};
use rockface_core::numerics::portable_math;
use rockface_core::{StageError, choice};

choice! {
    /// How parameters are measured when points are compared, spread or moved.
    pub enum Scale {
        /// As they are.
        Linear = "linear",
        /// By their logarithm: they must be above 0.
        Log = "log",
    }
}

impl Scale {
    /// A parameter on this scale; `None` where it has no logarithm.
    pub fn from_value(self, value: f64) -> Option<f64> {
        match self {
            Self::Linear => Some(value),
            Self::Log => (value > 0.0).then(|| portable_math::log(value)),
        }
    }

    /// The parameter of a position on this scale.
    pub fn to_value(self, position: f64) -> f64 {
        match self {
            Self::Linear => position,
            Self::Log => portable_math::exp(position),
        }
    }
}

/// The values of named parameters on a scale.
///
/// # Errors
/// A value that has no logarithm.
pub fn positions(scale: Scale, names: &[String], values: &[f64]) -> Result<Vec<f64>, StageError> {
    let position = |(name, value): (&String, &f64)| {
        scale.from_value(*value).ok_or_else(|| {
            StageError::new(format!("parameter `{name}` is {value}, which has no logarithm"))
                .hint("use `scale: linear`")
        })
    };
    names.iter().zip(values).map(position).collect()
}

/// The column that names the points of a table; without it they are numbered from 0.
pub const ITEM: &str = "item";

/// The values of `parameters` at a row of a gathered table: its own column, or the item of an axis of that name, or the column of
/// the table of points at the row which an item names.
///
/// # Errors
/// A parameter that has no number in any of these.
pub fn coordinates(
    parameters: &[String],
    items: &BTreeMap<String, String>,
    table: &Table,
    row: &[Cell],
    points: Option<&Table>,
) -> Result<Vec<f64>, StageError> {
    let of_row = |name: &str| table.column(name).and_then(|at| row[at].number());
    let of_axis = |name: &str| items.get(name).and_then(|item| item.parse::<f64>().ok());
    let of_points = |name: &str| points.and_then(|points| point_value(points, name, items, row));
    let value = |name: &String| {
        of_row(name).or_else(|| of_axis(name)).or_else(|| of_points(name)).filter(|x| x.is_finite()).ok_or_else(|| {
            let place: Vec<String> = items.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
            if let Some(at) = table.column(name) {
                let cells: Vec<String> = row.iter().map(ToString::to_string).collect();
                let (found, row) = (row[at].to_string(), cells.join(","));
                return StageError::new(format!("column `{name}` holds no number but `{found}` in the row `{row}`"));
            }
            StageError::new(format!(
                "`{name}` has no number at `{}`: it is neither a column, nor an axis of numbers, nor a column of `points`",
                place.join(" ")
            ))
        })
    };
    parameters.iter().map(value).collect()
}

/// The number in column `name` of the point that one of the items names, or a cell of the row, where its axis was tabulated.
fn point_value(points: &Table, name: &str, items: &BTreeMap<String, String>, row: &[Cell]) -> Option<f64> {
    let column = points.column(name)?;
    let naming = points.column(ITEM);
    let called = |row: usize| naming.map_or_else(|| row.to_string(), |at| points.rows[row][at].to_string());
    let texts = || items.values().map(String::as_str).chain(row.iter().filter_map(Cell::text));
    let found = (0..points.rows.len()).find(|row| texts().any(|item| item == called(*row)))?;
    points.rows[found][column].number()
}

/// Prime bases of the Halton sequence, one a dimension.
const BASES: [u64; 12] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37];

/// The most dimensions [`halton`] has.
pub const MOST_DIMENSIONS: usize = BASES.len();

/// Coordinate `dimension` of point `index` (from 1) of the Halton sequence, between 0 and 1 (Halton 1960).
pub fn halton(mut index: u64, dimension: usize) -> f64 {
    let base = BASES[dimension];
    let (mut value, mut place) = (0.0, 1.0);
    while index > 0 {
        place /= base as f64;
        value += place * (index % base) as f64;
        index /= base;
    }
    value
}

/// Distances from a value to the next smaller and the next larger of a set; at an end both are that of the other side, and 0 if
/// there is no other value.
pub fn spacing(values: &[f64], at: f64) -> [f64; 2] {
    let near = 1e-9 * values.iter().map(|v| v.abs()).fold(1e-300, f64::max);
    let nearest = |side: f64| {
        let distances = values.iter().map(|v| side * (v - at)).filter(|d| *d > near);
        distances.min_by(f64::total_cmp)
    };
    match [nearest(-1.0), nearest(1.0)] {
        [Some(below), Some(above)] => [below, above],
        [Some(only), None] | [None, Some(only)] => [only, only],
        [None, None] => [0.0, 0.0],
    }
}

/// Six significant digits: nobody needs more to name a point.
pub fn rounded(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use super::*;

    #[test]
    fn halton_and_spacing_by_hand() {
        assert_eq!([1, 2, 3, 4].map(|i| halton(i, 0)), [0.5, 0.25, 0.75, 0.125]);
        assert!((halton(4, 1) - 4.0 / 9.0).abs() < 1e-15);
        let values = [1.0, 2.0, 4.0];
        assert_eq!([1.0, 2.0, 4.0, 3.0].map(|at| spacing(&values, at)), [[1.0; 2], [1.0, 2.0], [2.0; 2], [1.0; 2]]);
        assert_eq!(spacing(&[5.0, 5.0], 5.0), [0.0; 2]);
        assert_eq!(rounded(0.123_456_789), 0.123_457);
    }

    #[test]
    fn coordinates_come_from_columns_axes_and_points() {
        let items = BTreeMap::from([("a".to_owned(), "0.5".to_owned()), ("point".to_owned(), "p1".to_owned())]);
        let mut table = Table::new(["d2", "b"]);
        table.push(vec![3.0.into(), 7.0.into()]);
        let mut points = Table::new([ITEM, "c"]);
        points.push(vec!["p0".into(), 1.0.into()]);
        points.push(vec!["p1".into(), 2.0.into()]);
        let found = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|n| (*n).to_owned()).collect();
            coordinates(&names, &items, &table, &table.rows[0], Some(&points))
        };
        assert_eq!(found(&["a", "b", "c"]).unwrap(), [0.5, 7.0, 2.0]);
        assert!(found(&["e"]).unwrap_err().message.contains("`e` has no number at `a=0.5 point=p1`"));
        let mut tabulated = Table::new(["fine", "d2"]);
        tabulated.push(vec!["p0".into(), 3.0.into()]);
        let row = coordinates(&["c".to_owned()], &BTreeMap::new(), &tabulated, &tabulated.rows[0], Some(&points));
        assert_eq!(row.unwrap(), [1.0]);
    }
}
