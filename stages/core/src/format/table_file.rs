//! Tables in CSV files: a header line, then numbers and words.

use std::collections::BTreeSet;

use crate::artefact::{Cell, CodecError, Table};
use crate::format::utf8;
use crate::limits;

/// Characters that separate cells, the likeliest first.
const SEPARATORS: [char; 3] = [',', ';', '\t'];
/// Columns a table may have, as many as a sheet of a spreadsheet: more are a file of another layout.
pub const MOST_COLUMNS: usize = 16_384;
/// Names of columns that a message lists.
const LISTED: usize = 20;

/// Reads a CSV file with a header line; cells are separated by the comma, semicolon or tab the header has most of.
///
/// Cells that are numbers become numbers, `true` and `false` flags, empty ones and NaN empty, all others text; text, too, stay
/// infinite numbers and whole numbers of more digits than a double holds, such as long identifiers. Where cells
/// are not separated by commas, a column all of whose numbers have decimal commas or none is one of numbers, too. Spaces
/// around cells, a byte-order mark and a `//` or `#` before the header are dropped.
///
/// # Errors
/// The line at fault: no header, two columns of one name, a row of another length, text that is not UTF-8, more than 16384
/// columns, more cells than the limit of memory allows; `cancelled` became true.
pub fn read(bytes: &[u8], cancelled: &dyn Fn() -> bool) -> Result<Table, CodecError> {
    let text = utf8(bytes)?;
    let text = text.trim_start_matches('\u{feff}').trim_start_matches("//").trim_start_matches('#');
    let header = text.lines().next().unwrap_or_default();
    let separator =
        SEPARATORS.iter().rev().max_by_key(|mark| header.matches(**mark).count()).map_or(b',', |c| *c as u8);
    let mut reader = csv::ReaderBuilder::new().delimiter(separator).trim(csv::Trim::All).from_reader(text.as_bytes());
    let failed = |e: csv::Error| CodecError::new(format!("it is no CSV table: {e}"));
    let columns: Vec<String> = reader.headers().map_err(failed)?.iter().map(ToOwned::to_owned).collect();
    check_header(&columns)?;
    // A row has at least a separator or the end of its line for each column.
    let rows = text.lines().count().min(text.len() / columns.len().max(1));
    let bytes = (rows as u64).checked_mul((columns.len() * size_of::<Cell>()) as u64);
    limits::affordable(&format!("a table of {rows} rows of {} columns", columns.len()), bytes)?;
    let mut table = Table::new(columns);
    let mut stop = limits::Stop::when(cancelled);
    for record in reader.records() {
        stop.check()?;
        table.push(record.map_err(failed)?.iter().map(cell).collect());
    }
    if separator != b',' {
        (0..table.columns.len()).for_each(|column| take_decimal_commas(&mut table, column));
    }
    Ok(table)
}

/// Makes numbers of the texts of a column if all of them are numbers with a decimal comma, and no number has a point.
fn take_decimal_commas(table: &mut Table, column: usize) {
    let taken = |cell: &Cell| match cell {
        Cell::Text(text) => with_decimal_comma(text).map(Cell::from),
        Cell::Number(value) if value.fract() == 0.0 => Some(cell.clone()),
        Cell::Empty(()) => Some(cell.clone()),
        _ => None,
    };
    if let Some(cells) = table.rows.iter().map(|row| taken(&row[column])).collect::<Option<Vec<Cell>>>() {
        table.rows.iter_mut().zip(cells).for_each(|(row, cell)| row[column] = cell);
    }
}

/// The number that a text with one decimal comma and no point writes.
pub fn with_decimal_comma(text: &str) -> Option<f64> {
    let (whole, fraction) = text.split_once(',')?;
    let digits = |text: &str| text.ends_with(|last: char| last.is_ascii_digit());
    let is_one = digits(whole) && fraction.starts_with(|first: char| first.is_ascii_digit()) && !whole.contains('.');
    if !is_one {
        return None;
    }
    format!("{whole}.{fraction}").parse().ok().filter(|number: &f64| number.is_finite())
}

fn check_header(columns: &[String]) -> Result<(), CodecError> {
    if columns.iter().all(String::is_empty) {
        return Err(CodecError::new("its first line names no column"));
    }
    if columns.len() > MOST_COLUMNS {
        let count = columns.len();
        let message =
            format!("its header names {count} columns, {MOST_COLUMNS} is the most; is a row meant to be a column?");
        return Err(CodecError::new(message));
    }
    let mut known = BTreeSet::new();
    let twin = columns.iter().find(|name| !known.insert(name.as_str()));
    twin.map_or(Ok(()), |name| Err(CodecError::new(format!("two columns are called `{name}`"))))
}

/// The names of a table's columns for a message, the first ones where there are many.
pub fn listed(table: &Table) -> String {
    let names = table.columns.iter().take(LISTED).map(String::as_str).collect::<Vec<_>>().join(", ");
    let beyond = table.columns.len().saturating_sub(LISTED);
    if beyond == 0 { names } else { format!("{names} and {beyond} more") }
}

fn cell(text: &str) -> Cell {
    match (text, text.parse::<f64>()) {
        ("", _) => Cell::Empty(()),
        ("true", _) => Cell::Flag(true),
        ("false", _) => Cell::Flag(false),
        (_, Ok(number)) if number.is_nan() || number.is_finite() && holds_whole(number, text) => number.into(),
        (text, _) => text.into(),
    }
}

/// Digits that every double holds.
const HELD_DIGITS: usize = 15;

/// Whether a number is the very one of its text, where the text is a whole number.
fn holds_whole(number: f64, text: &str) -> bool {
    let digits = text.trim_start_matches(['+', '-']).trim_start_matches('0');
    digits.len() <= HELD_DIGITS
        || !digits.bytes().all(|digit| digit.is_ascii_digit())
        || format!("{:.0}", number.abs()) == digits
}

/// The numbers of a column, empty cells left out.
///
/// # Errors
/// No such column (the message lists those there are), a cell that is no number, no number at all.
pub fn numbers(table: &Table, column: &str) -> Result<Vec<f64>, CodecError> {
    let missing = || CodecError::new(format!("it has no column `{column}`, only {}", listed(table)));
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

    fn read(bytes: &[u8]) -> Result<Table, CodecError> {
        super::read(bytes, &|| false)
    }

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
    fn a_column_with_decimal_commas_is_one_of_numbers() {
        let table =
            read("x_m;both;list;id\n1,5;1,5;1,2,3;12\n-2,25e1;1.5;1,2;7\n4;2;3;0,5 m\n;;;\n".as_bytes()).unwrap();
        assert_eq!(numbers(&table, "x_m").unwrap(), [1.5, -22.5, 4.0]);
        for (column, text) in ["both", "list", "id"].into_iter().zip(["1,5", "1,2,3", "0,5 m"]) {
            let at = table.column(column).unwrap();
            assert!(table.rows.iter().any(|row| row[at] == text.into()), "{column}");
        }
        // Commas that separate cells group digits where they stand in quotes.
        assert_eq!(read(b"a,b\n\"1,234\",2\n").unwrap().rows[0][0], "1,234".into());
    }

    #[test]
    fn numbers_that_a_double_does_not_hold_stay_text() {
        let cells = |column: &str| -> Vec<Cell> {
            let table = read(format!("a\n{column}\n").as_bytes()).unwrap();
            table.rows.into_iter().flatten().collect()
        };
        for text in ["inf", "-inf", "Infinity", "1e400", "-1e400", "12345678901234567", "-9007199254740993"] {
            assert_eq!(cells(text), [Cell::from(text)], "{text}");
        }
        for (text, number) in [
            ("9007199254740992", 9_007_199_254_740_992.0),
            ("12345678901234568", 12_345_678_901_234_568.0),
            ("-123456789012345", -123_456_789_012_345.0),
            ("1e22", 1e22),
            ("0.1234567890123456", 0.123_456_789_012_345_6),
            ("007", 7.0),
        ] {
            assert_eq!(cells(text), [Cell::Number(number)], "{text}");
        }
        assert_eq!(cells("NaN"), [Cell::Empty(())]);
        // A column with decimal commas that overflow is none of numbers.
        assert_eq!(read(b"a;b\n1,5e400;1\n").unwrap().rows[0][0], "1,5e400".into());
    }

    #[test]
    fn faults_name_their_place() {
        let message = |text: &str| read(text.as_bytes()).unwrap_err().0;
        assert!(message("").contains("names no column"));
        assert!(message("a,b,a\n").contains("two columns are called `a`"));
        assert!(message("a,b\n1,2\n3\n").contains("line: 3"));
        assert_eq!(super::read(b"a\n1\n", &|| true).unwrap_err().0, "interrupted");
        assert!(read(&[0xff, 0xfe]).unwrap_err().0.contains("UTF-8"));
        let table = read(b"a,b\n1,x\n").unwrap();
        assert!(numbers(&table, "c").unwrap_err().0.contains("only a, b"));
        let wide = |count: usize| (0..count).map(|i| format!("c{i}")).collect::<Vec<_>>().join(",");
        assert!(message(&wide(300_000)).contains("its header names 300000 columns, 16384 is the most"));
        let most = read(wide(16_384).as_bytes()).unwrap();
        assert!(numbers(&most, "x").unwrap_err().0.ends_with("c19 and 16364 more"));
        assert!(numbers(&table, "b").unwrap_err().0.contains("row 1 of column `b` holds `x`"));
    }
}
