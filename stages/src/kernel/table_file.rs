//! Tables in CSV files: a header line, then numbers and words.

use crate::artefact::{Cell, CodecError, Table};

/// Characters that separate cells, the likeliest first.
const SEPARATORS: [char; 3] = [',', ';', '\t'];

/// Reads a CSV file with a header line; cells are separated by the comma, semicolon or tab the header has most of.
///
/// Cells that are numbers become numbers, `true` and `false` flags, empty ones and NaN empty, all others text. Spaces
/// around cells, a byte-order mark and a `//` or `#` before the header are dropped.
///
/// # Errors
/// The line at fault: no header, two columns of one name, a row of another length, text that is not UTF-8.
pub fn read(bytes: &[u8]) -> Result<Table, CodecError> {
    let text = std::str::from_utf8(bytes).map_err(|e| CodecError::new(format!("it is no UTF-8 text: {e}")))?;
    let text = text.trim_start_matches('\u{feff}').trim_start_matches("//").trim_start_matches('#');
    let header = text.lines().next().unwrap_or_default();
    let separator =
        SEPARATORS.iter().rev().max_by_key(|mark| header.matches(**mark).count()).map_or(b',', |c| *c as u8);
    let mut reader = csv::ReaderBuilder::new().delimiter(separator).trim(csv::Trim::All).from_reader(text.as_bytes());
    let failed = |e: csv::Error| CodecError::new(format!("it is no CSV table: {e}"));
    let columns: Vec<String> = reader.headers().map_err(failed)?.iter().map(ToOwned::to_owned).collect();
    check_header(&columns)?;
    let mut table = Table::new(columns);
    for record in reader.records() {
        table.push(record.map_err(failed)?.iter().map(cell).collect());
    }
    Ok(table)
}

fn check_header(columns: &[String]) -> Result<(), CodecError> {
    if columns.iter().all(String::is_empty) {
        return Err(CodecError::new("its first line names no column"));
    }
    let twin = columns.iter().enumerate().find(|(i, name)| columns[..*i].contains(name));
    twin.map_or(Ok(()), |(_, name)| Err(CodecError::new(format!("two columns are called `{name}`"))))
}

fn cell(text: &str) -> Cell {
    match (text, text.parse::<f64>()) {
        ("", _) => Cell::Empty(()),
        ("true", _) => Cell::Flag(true),
        ("false", _) => Cell::Flag(false),
        (_, Ok(number)) => number.into(),
        (text, Err(_)) => text.into(),
    }
}

/// The numbers of a column, empty cells left out.
///
/// # Errors
/// No such column (the message lists those there are), a cell that is no number, no number at all.
pub fn numbers(table: &Table, column: &str) -> Result<Vec<f64>, CodecError> {
    let missing = || CodecError::new(format!("it has no column `{column}`, only {}", table.columns.join(", ")));
    let at = table.column(column).ok_or_else(missing)?;
    let mut values = Vec::with_capacity(table.rows.len());
    for (row, cells) in table.rows.iter().enumerate() {
        match &cells[at] {
            Cell::Number(value) => values.push(*value),
            Cell::Empty(()) => {}
            other => {
                let message = format!("row {} of column `{column}` holds `{other}`, which is no number", row + 1);
                return Err(CodecError::new(message));
            }
        }
    }
    if values.is_empty() { Err(CodecError::new(format!("column `{column}` holds no number"))) } else { Ok(values) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_told_apart_whatever_separates_them() {
        for separator in SEPARATORS {
            let text = "//x_m, name ,ok\n1.5,slab,true\n , 2b ,false\n-3e2,,nan\n".replace(',', &separator.to_string());
            let table = read(text.as_bytes()).unwrap();
            assert_eq!(table.columns, ["x_m", "name", "ok"]);
            assert_eq!(table.rows[0], [Cell::Number(1.5), "slab".into(), true.into()]);
            assert_eq!(table.rows[1], [Cell::Empty(()), "2b".into(), false.into()]);
            assert_eq!(table.rows[2], [Cell::Number(-300.0), Cell::Empty(()), Cell::Empty(())]);
            assert_eq!(numbers(&table, "x_m").unwrap(), [1.5, -300.0]);
        }
    }

    #[test]
    fn faults_name_their_place() {
        let message = |text: &str| read(text.as_bytes()).unwrap_err().0;
        assert!(message("").contains("names no column"));
        assert!(message("a,b,a\n").contains("two columns are called `a`"));
        assert!(message("a,b\n1,2\n3\n").contains("line: 3"));
        assert!(read(&[0xff, 0xfe]).unwrap_err().0.contains("UTF-8"));
        let table = read(b"a,b\n1,x\n").unwrap();
        assert!(numbers(&table, "c").unwrap_err().0.contains("only a, b"));
        assert!(numbers(&table, "b").unwrap_err().0.contains("row 1 of column `b` holds `x`"));
    }
}
