//! A table of numbers and words: descriptors, verdicts, curves.

use super::{CodecError, Export};

/// One cell of a table.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// A finite number. What is not finite is [`Cell::Empty`].
    Number(f64),
    /// Text.
    Text(String),
    /// `true` or `false`.
    Flag(bool),
    /// No value.
    Empty(()),
}

impl Cell {
    /// The number, if it is one.
    pub fn number(&self) -> Option<f64> {
        if let Self::Number(x) = self { Some(*x) } else { None }
    }

    /// The text, if it is text.
    pub fn text(&self) -> Option<&str> {
        if let Self::Text(x) = self { Some(x) } else { None }
    }
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        if value.is_finite() { Self::Number(value + 0.0) } else { Self::Empty(()) }
    }
}

impl From<&str> for Cell {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl From<String> for Cell {
    fn from(value: String) -> Self {
        Self::Text(value)
    }
}

impl From<bool> for Cell {
    fn from(value: bool) -> Self {
        Self::Flag(value)
    }
}

impl std::fmt::Display for Cell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(x) => write!(f, "{x}"),
            Self::Text(x) => f.write_str(x),
            Self::Flag(x) => write!(f, "{x}"),
            Self::Empty(()) => Ok(()),
        }
    }
}

/// Rows of cells under named columns; every row has one cell a column.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct Table {
    /// Column names, unit in the name where there is one.
    pub columns: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<Cell>>,
}

/// A table as a file holds it.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Unchecked {
    columns: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

impl TryFrom<Unchecked> for Table {
    type Error = String;
    fn try_from(Unchecked { columns, rows }: Unchecked) -> Result<Self, String> {
        match rows.iter().position(|row| row.len() != columns.len()) {
            Some(at) => {
                Err(format!("row {at} (counted from 0) has {} cells for {} columns", rows[at].len(), columns.len()))
            }
            None => Ok(Self { columns, rows }),
        }
    }
}

impl Table {
    /// An empty table with these columns.
    pub fn new<S: Into<String>>(columns: impl IntoIterator<Item = S>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row; it must have one cell a column.
    pub fn push(&mut self, row: Vec<Cell>) {
        debug_assert_eq!(row.len(), self.columns.len());
        self.rows.push(row);
    }

    /// Position of a column.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// The table as CSV with a header line.
    pub fn to_csv(&self) -> Result<Vec<u8>, CodecError> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed = |e: csv::Error| CodecError(format!("cannot write CSV: {e}"));
        writer.write_record(&self.columns).map_err(failed)?;
        for row in &self.rows {
            writer.write_record(row.iter().map(ToString::to_string)).map_err(failed)?;
        }
        writer.into_inner().map_err(|e| CodecError(format!("cannot write CSV: {e}")))
    }
}

super::json_noun!(
    Table,
    fn has_exports() -> bool {
        true
    },
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        Ok(vec![Export { path: format!("{stem}.csv"), bytes: self.to_csv()? }])
    }
);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Noun;

    #[test]
    fn every_kind_of_cell_comes_back() {
        let mut table = Table::new(["a", "b"]);
        table.push(vec![1.0.into(), "1".into()]);
        table.push(vec![f64::NAN.into(), true.into()]);
        table.push(vec![1e-300.into(), "".into()]);
        let bytes = table.encode().unwrap();
        assert_eq!(Table::decode(&bytes).unwrap(), table);
        let ragged = Table::decode(br#"{"columns": ["a", "b"], "rows": [[1, 2], [3]]}"#);
        assert!(ragged.unwrap_err().0.contains("row 1 (counted from 0) has 1 cells for 2 columns"));
        assert_eq!(String::from_utf8(table.to_csv().unwrap()).unwrap().lines().nth(1), Some("1,1"));
    }
}
