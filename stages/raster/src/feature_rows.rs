//! Rows of many gathered tables as one: which items they belong to, and the features in them.

use std::collections::BTreeMap;

use super::columns;
use rockface_core::StageError;
use rockface_core::artefact::{Cell, Table};

/// Item of each axis that a table was gathered from.
pub type Items = BTreeMap<String, String>;

/// The features of one raster, and which raster it is.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureRow {
    /// Items of the gathered axes.
    pub items: Items,
    /// Name of the raster in its table.
    pub raster: String,
    /// Values in the order asked for, all finite.
    pub values: Vec<f64>,
}

impl FeatureRow {
    /// Raster and items as one text: `replicate=3 difference`.
    pub fn label(&self) -> String {
        let items = self.items.iter().map(|(axis, item)| format!("{axis}={item} "));
        items.chain(std::iter::once(self.raster.clone())).collect()
    }
}

/// The named features of every row of every table.
///
/// # Errors
/// A column that is missing, or a cell without a number, with the raster and the feature in the message.
pub fn feature_rows(tables: &[(&Items, &Table)], features: &[String]) -> Result<Vec<FeatureRow>, StageError> {
    let mut rows = Vec::new();
    for (items, table) in tables {
        let places: Vec<usize> =
            features.iter().map(|name| columns::place(&table.columns, name)).collect::<Result<_, _>>()?;
        let name = table.column("raster");
        for (index, cells) in table.rows.iter().enumerate() {
            let raster = name.map_or_else(|| format!("row {}", index + 1), |column| cells[column].to_string());
            let mut row = FeatureRow { items: (*items).clone(), raster, values: Vec::new() };
            for (feature, at) in features.iter().zip(&places) {
                let value = cells[*at].number().filter(|x| x.is_finite());
                row.values.push(value.ok_or_else(|| format!("`{}` has no number for `{feature}`", row.label()))?);
            }
            rows.push(row);
        }
    }
    Ok(rows)
}

/// The axes of all elements, in alphabetical order.
pub fn axes<'a>(items: impl IntoIterator<Item = &'a Items>) -> Vec<String> {
    let all: std::collections::BTreeSet<&String> = items.into_iter().flat_map(BTreeMap::keys).collect();
    all.into_iter().cloned().collect()
}

/// The item of an axis as a cell: a number where it is written as one (`0.7`, `-3`, `1e-3`, but not `007` or `nan`).
pub fn item_cell(items: &Items, axis: &str) -> Cell {
    let Some(item) = items.get(axis) else { return Cell::Empty(()) };
    let digits = item.strip_prefix('-').unwrap_or(item);
    let plain = digits.starts_with(|c: char| c.is_ascii_digit());
    let padded = digits.len() > 1 && digits.starts_with('0') && digits.as_bytes()[1].is_ascii_digit();
    match item.parse::<f64>() {
        Ok(number) if plain && !padded && number.is_finite() => Cell::from(number),
        _ => Cell::from(item.as_str()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn items(axis: &str, item: &str) -> Items {
        Items::from([(axis.to_owned(), item.to_owned())])
    }

    #[test]
    fn items_become_numbers_where_they_look_like_numbers() {
        for (item, number) in [("0.7", 0.7), ("-3", -3.0), ("1e-3", 1e-3), ("0", 0.0), ("12", 12.0)] {
            assert_eq!(item_cell(&items("a", item), "a"), Cell::from(number), "{item}");
        }
        for item in ["007", "nan", "inf", "pre", "1,5", "", "-", "+1"] {
            assert_eq!(item_cell(&items("a", item), "a"), Cell::from(item), "{item}");
        }
        assert_eq!(item_cell(&items("a", "1"), "b"), Cell::Empty(()));
    }

    #[test]
    fn rows_name_their_place() {
        let mut table = Table::new(["raster", "x"]);
        table.push(vec!["d".into(), 1.0.into()]);
        table.push(vec!["e".into(), f64::NAN.into()]);
        let point = items("replicate", "3");
        let error = feature_rows(&[(&point, &table)], &["x".into()]).unwrap_err().message;
        assert!(error.contains("`replicate=3 e`") && error.contains("`x`"), "{error}");
        table.rows.pop();
        let rows = feature_rows(&[(&point, &table)], &["x".into()]).unwrap();
        assert_eq!((rows[0].label().as_str(), rows[0].values.as_slice()), ("replicate=3 d", [1.0].as_slice()));
        assert!(feature_rows(&[(&point, &table)], &["y".into()]).unwrap_err().message.contains("raster, x"));
        assert_eq!(axes([&point, &items("epoch", "pre")]), ["epoch", "replicate"]);
    }
}
