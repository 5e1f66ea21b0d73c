//! The first rows of tables and inventories.

use rockface_cache::OutputRecord;
use rockface_core::artefact::{Artefact, Cell, Kind, Table};
use serde::Serialize;

use super::number::{Shown, cell};
use super::source::Source;
use super::steps::Linker;
use rockface_engine::history::StepDone;

/// Rows of a table that are shown.
const ROWS: usize = 12;
/// A table of so few rows and more columns than that is shown upright.
const UPRIGHT: (usize, usize) = (2, 7);
/// Tables larger than this are linked only: the page is for a look.
const BYTES: u64 = 20_000_000;

/// The head of a table.
#[derive(Debug, Clone, Serialize)]
pub struct TableView {
    /// The instance and output it comes from.
    pub from: String,
    /// The instance that made it, as `step[axis=item]`.
    pub instance: String,
    /// Whether that was computed in this run.
    pub ran: bool,
    /// How many instances are not shown before this one.
    pub gap: String,
    /// Names of the columns; those of an upright table are its first column.
    pub columns: Vec<String>,
    /// Which columns hold numbers and nothing else.
    pub numeric: Vec<bool>,
    /// The rows that are shown, a cell for each column.
    pub rows: Vec<Vec<Shown>>,
    /// Whether rows and columns are swapped.
    pub upright: bool,
    /// How many rows there are.
    pub row_count: usize,
    /// How many are not shown.
    pub hidden: usize,
    /// Whether its columns do not fit on paper beside each other: each row is a block there.
    pub broad: bool,
    /// The address of the whole table as CSV; `None` where the run folder has none.
    pub link: Option<String>,
}

/// Columns that fit on paper beside each other.
const ON_PAPER: usize = 10;

/// The tables one instance made.
pub fn of(source: &Source, done: &StepDone, linker: &Linker) -> Vec<TableView> {
    let outputs = done.outputs.iter().flatten();
    outputs.filter_map(|(port, output)| view(source, done, port, output, linker)).collect()
}

fn view(source: &Source, done: &StepDone, port: &str, output: &OutputRecord, linker: &Linker) -> Option<TableView> {
    let kind: Kind = output.kind.parse().ok()?;
    if !matches!(kind, Kind::Table | Kind::Inventory) || !output.kept || output.bytes > BYTES {
        return None;
    }
    let table = match Artefact::decode(kind, &source.output(done, port, output)?).ok()? {
        Artefact::Table(table) => table,
        Artefact::Inventory(inventory) => inventory.table(),
        _ => return None,
    };
    let mut view = head(&table);
    view.instance = done.label();
    view.ran = done.status == "executed";
    view.from = format!("{}.{port}", view.instance);
    view.link = linker.beside(done, port, "csv");
    Some(view)
}

/// The first rows of a table; a low wide one upright.
pub fn head(table: &Table) -> TableView {
    let upright = (1..=UPRIGHT.0).contains(&table.rows.len()) && table.columns.len() > UPRIGHT.1;
    let of_row = |row: &Vec<Cell>| {
        table.columns.iter().zip(row).map(|(column, value)| cell(column, &value.to_string())).collect()
    };
    let shown: Vec<Vec<Shown>> = table.rows.iter().take(ROWS).map(of_row).collect();
    let numeric = |column: usize| {
        let cells = || shown.iter().map(|row| &row[column]);
        cells().any(|cell| cell.exact.is_some()) && cells().all(|cell| cell.exact.is_some() || cell.text.is_empty())
    };
    let numeric = (0..table.columns.len()).map(numeric).collect();
    let rows = if upright {
        (0..table.columns.len()).map(|column| shown.iter().map(|row| row[column].clone()).collect()).collect()
    } else {
        shown
    };
    TableView {
        from: String::new(),
        instance: String::new(),
        ran: false,
        gap: String::new(),
        columns: table.columns.clone(),
        numeric,
        rows,
        upright,
        row_count: table.rows.len(),
        hidden: table.rows.len().saturating_sub(ROWS),
        broad: !upright && table.columns.len() > ON_PAPER,
        link: None,
    }
}
