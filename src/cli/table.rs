//! Tables as people, spreadsheets and programs read them.

use clap::{Args, ValueEnum};
use serde_json::Value;

use super::CliError;

/// How a table is printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Columns for people.
    Table,
    /// Comma-separated values.
    Csv,
    /// JSON.
    Json,
}

/// What the commands that print tables take.
#[derive(Debug, Args)]
pub struct Printed {
    /// The output format.
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    /// The same as `--format json`.
    #[arg(long, conflicts_with = "format")]
    json: bool,
}

impl Printed {
    /// How the table is printed.
    pub fn format(&self) -> Format {
        if self.json { Format::Json } else { self.format }
    }
}

/// Prints rows under a head: as columns or CSV; as JSON, `json` instead.
pub fn print(format: Format, head: &[&str], rows: &[Vec<String>], json: &Value) -> Result<(), CliError> {
    match format {
        Format::Table => super::say(&columns(head, rows)),
        Format::Csv => super::say(csv_text(head, rows)?.trim_end()),
        Format::Json => super::say(&serde_json::to_string_pretty(json).unwrap_or_default()),
    }
    Ok(())
}

/// Columns as wide as their widest cell, two spaces between; those of numbers to the right.
fn columns(head: &[&str], rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
        cells.chain([head[column].chars().count()]).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let is_number = |cell: &String| cell.is_empty() || cell.parse::<f64>().is_ok();
    let numeric: Vec<bool> =
        (0..head.len()).map(|column| rows.iter().all(|row| row.get(column).is_none_or(is_number))).collect();
    let line = |cells: Vec<&str>| {
        let cells = cells.iter().zip(&widths).zip(&numeric).map(|((cell, width), numeric)| {
            if *numeric { format!("{cell:>width$}") } else { format!("{cell:width$}") }
        });
        cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
    };
    let lines = rows.iter().map(|row| line(row.iter().map(String::as_str).collect()));
    std::iter::once(line(head.to_vec())).chain(lines).collect::<Vec<_>>().join("\n")
}

fn csv_text(head: &[&str], rows: &[Vec<String>]) -> Result<String, CliError> {
    let failed = |error: String| CliError::Usage(format!("the table cannot be written: {error}"));
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(head).map_err(|error| failed(error.to_string()))?;
    for row in rows {
        writer.write_record(row).map_err(|error| failed(error.to_string()))?;
    }
    let bytes = writer.into_inner().map_err(|error| failed(error.to_string()))?;
    String::from_utf8(bytes).map_err(|error| failed(error.to_string()))
}

/// Bytes as people say them.
pub fn bytes(count: u64) -> String {
    const UNITS: [&str; 5] = ["B", "KiB", "MiB", "GiB", "TiB"];
    let (mut value, mut unit) = (count as f64, 0);
    while value >= 1024.0 && unit + 1 < UNITS.len() {
        (value, unit) = (value / 1024.0, unit + 1);
    }
    if unit == 0 { format!("{count} B") } else { format!("{value:.1} {}", UNITS[unit]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_line_up_and_numbers_stand_to_the_right() {
        let rows = [vec!["dem".to_owned(), "7".to_owned()], vec!["d".to_owned(), "12.5".to_owned()]];
        assert_eq!(columns(&["step", "n"], &rows), "step     n\ndem      7\nd     12.5");
        assert_eq!(csv_text(&["a", "b"], &[vec!["x,y".into(), "\"".into()]]).unwrap(), "a,b\n\"x,y\",\"\"\"\"\n");
    }

    #[test]
    fn bytes_read_well() {
        assert_eq!([0, 1023, 1024, 5 << 30].map(bytes), ["0 B", "1023 B", "1.0 KiB", "5.0 GiB"]);
    }
}
