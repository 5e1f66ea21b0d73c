//! Columns of numbers out of what has rows: inventories and tables.

use rockface_core::StageError;
use rockface_core::artefact::{Artefact, Cell, Inventory};

/// The names of the columns and the cells of each row; `None` for artefacts without rows.
pub fn rows(artefact: &Artefact) -> Option<(&[String], Vec<&[Cell]>)> {
    match artefact {
        Artefact::Inventory(inventory) => {
            Some((&inventory.columns, inventory.features.iter().map(|feature| feature.values.as_slice()).collect()))
        }
        Artefact::Table(table) => Some((&table.columns, table.rows.iter().map(Vec::as_slice).collect())),
        _ => None,
    }
}

/// The place of a column.
///
/// # Errors
/// There is none of that name: the message names those there are.
pub fn place(columns: &[String], name: &str) -> Result<usize, StageError> {
    let place = columns.iter().position(|column| column == name);
    place.ok_or_else(|| StageError::new(format!("there is no column `{name}`; there are {}", columns.join(", "))))
}

/// The numbers of an inventory's column, `None` where a feature has none there.
///
/// # Errors
/// As [`place`].
pub fn numbers_of(inventory: &Inventory, name: &str) -> Result<Vec<Option<f64>>, StageError> {
    let place = place(&inventory.columns, name)?;
    Ok(inventory.features.iter().map(|feature| feature.values[place].number()).collect())
}

/// The numbers of a column, `None` where a row has none there.
///
/// # Errors
/// An artefact without rows, or without such a column: the message names those there are.
pub fn numbers(artefact: &Artefact, column: &str) -> Result<Vec<Option<f64>>, StageError> {
    let (columns, rows) = rows(artefact).ok_or_else(|| format!("a {} has no columns", artefact.kind()))?;
    let place = place(columns, column)?;
    Ok(rows.iter().map(|row| row.get(place).and_then(Cell::number)).collect())
}

/// The positive numbers of a column in ascending order, and how many rows have none.
///
/// # Errors
/// As [`numbers`].
pub fn magnitudes(artefact: &Artefact, column: &str) -> Result<(Vec<f64>, usize), StageError> {
    let numbers = numbers(artefact, column)?;
    let mut positive: Vec<f64> = numbers.iter().flatten().copied().filter(|number| *number > 0.0).collect();
    positive.sort_by(f64::total_cmp);
    let without = numbers.len() - positive.len();
    Ok((positive, without))
}

/// The sentence about the rows that hold text in a column of numbers; `None` where no row does.
pub fn text_among_numbers<'a>(column: &str, cells: impl IntoIterator<Item = &'a Cell>) -> Option<String> {
    let (mut rows, mut texts, mut example) = (0, 0, None);
    for cell in cells {
        rows += 1;
        if let Some(text) = cell.text() {
            texts += 1;
            example.get_or_insert(text);
        }
    }
    let example = example?;
    Some(format!(
        "{texts} of {rows} rows hold text in `{column}`, such as `{example}`, which counts as no number: write numbers with a \
         decimal point and without quotes or units"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Picture, Table};

    #[test]
    fn what_is_positive_is_sorted_and_the_rest_counted() {
        let mut table = Table::new(["v", "w"]);
        for value in [Cell::from(3.0), Cell::from(-1.0), Cell::from(f64::NAN), Cell::from(0.5), Cell::from("x")] {
            table.push(vec![value, Cell::from(1.0)]);
        }
        let sentence = text_among_numbers("v", table.rows.iter().map(|row| &row[0])).unwrap();
        assert!(sentence.contains("1 of 5 rows hold text in `v`, such as `x`"), "{sentence}");
        assert_eq!(text_among_numbers("w", table.rows.iter().map(|row| &row[1])), None);
        let table = Artefact::from(table);
        assert_eq!(magnitudes(&table, "v").unwrap(), (vec![0.5, 3.0], 3));
        assert!(magnitudes(&table, "u").unwrap_err().message.contains("there are v, w"));
        assert!(numbers(&Artefact::from(Picture { png: Vec::new() }), "v").unwrap_err().message.contains("picture"));
    }
}
