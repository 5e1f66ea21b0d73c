//! A table of numbers and words: descriptors, verdicts, curves.

use super::{CodecError, Export};

/// One cell of a table.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// A finite number. What is not finite is [`Cell::Empty`].
    Number(f64),
    /// A word or any other text.
    Text(String),
    /// A yes or no: `true` or `false`.
    Flag(bool),
    /// No value: `null` in JSON, nothing between the commas of CSV.
    Empty(()),
}

impl Cell {
    /// The number, if the cell holds one.
    pub fn number(&self) -> Option<f64> {
        if let Self::Number(x) = self { Some(*x) } else { None }
    }

    /// The text, if the cell holds one.
    pub fn text(&self) -> Option<&str> {
        if let Self::Text(x) = self { Some(x) } else { None }
    }
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        if value.is_finite() { Self::Number(value + 0.0) } else { Self::Empty(()) }
    }
}

impl From<usize> for Cell {
    fn from(value: usize) -> Self {
        Self::from(value as f64)
    }
}

impl<T: Into<Self>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Empty(()), Into::into)
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
    /// The rows, with one cell for each column.
    pub rows: Vec<Vec<Cell>>,
}

/// A row whose columns are the fields of a struct; declared with [`crate::table_row!`].
pub trait TableRow {
    /// Names of the columns, in order.
    const COLUMNS: &'static [&'static str];

    /// The names of the columns as a [`Table`] or an [`crate::artefact::Inventory`] holds them.
    fn columns() -> Vec<String> {
        Self::COLUMNS.iter().map(ToString::to_string).collect()
    }

    /// One cell a column.
    fn cells(self) -> Vec<Cell>;
}

/// Declares the rows of a table as a struct: each field names a column and holds its cell, so names and cells cannot be
/// listed in different orders. The type of a field is any that becomes a [`Cell`](crate::artefact::Cell); `None` and numbers
/// that are not finite become empty cells.
///
/// ```
/// use rockface_core::artefact::Table;
/// use rockface_core::table_row;
///
/// table_row! {
///     /// What is known of one block.
///     struct BlockRow<'a> {
///         name: &'a str,
///         faces: usize,
///         volume_m3: Option<f64>,
///     }
/// }
///
/// let rows = [
///     BlockRow { name: "wedge", faces: 4, volume_m3: Some(0.5) },
///     BlockRow { name: "open", faces: 3, volume_m3: None },
/// ];
/// let table: Table = rows.into_iter().collect();
/// assert_eq!(table.columns, ["name", "faces", "volume_m3"]);
/// assert_eq!(table.to_csv().unwrap(), b"name,faces,volume_m3\nwedge,4,0.5\nopen,3,\n");
/// ```
#[macro_export]
macro_rules! table_row {
    (
        $(#[doc = $about:literal])+
        $seen:vis struct $Name:ident $(<$life:lifetime>)? { $( $field:ident : $ty:ty ),* $(,)? }
    ) => {
        $(#[doc = $about])+
        #[derive(Debug)]
        #[allow(clippy::struct_field_names)] // columns have their unit in the name
        $seen struct $Name $(<$life>)? { $( $field: $ty ),* }

        impl $(<$life>)? $crate::artefact::TableRow for $Name $(<$life>)? {
            const COLUMNS: &'static [&'static str] = &[$( stringify!($field) ),*];

            fn cells(self) -> Vec<$crate::artefact::Cell> {
                vec![$( self.$field.into() ),*]
            }
        }
    };
}

impl<R: TableRow> FromIterator<R> for Table {
    fn from_iter<I: IntoIterator<Item = R>>(rows: I) -> Self {
        Self { columns: R::columns(), rows: rows.into_iter().map(R::cells).collect() }
    }
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

    /// Adds a row; it must have one cell a column. Rows of known columns are safer as a [`crate::table_row!`].
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

    crate::table_row! {
        /// A row of every type that becomes a cell.
        struct Every {
            number: f64,
            count: usize,
            word: String,
            flag: bool,
            missing: Option<f64>,
        }
    }

    #[test]
    fn a_row_puts_each_value_under_its_name() {
        let none: Table = std::iter::empty::<Every>().collect();
        assert_eq!(none.columns, ["number", "count", "word", "flag", "missing"]);
        let row = |missing| Every { number: f64::NAN, count: 3, word: "a".to_owned(), flag: true, missing };
        let table: Table = [row(None), row(Some(0.5))].into_iter().collect();
        assert_eq!(table.to_csv().unwrap(), b"number,count,word,flag,missing\n,3,a,true,\n,3,a,true,0.5\n");
    }

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
