//! `tabulate`: puts the rows of many gathered tables under each other, with the items they belong to.

use std::borrow::Cow;
use std::collections::BTreeMap;

use serde_json::Value;

use crate::columns;
use crate::feature_rows::{axes, item_cell};
use rockface_core::artefact::{Artefact, Cell, Kind, Table};
use rockface_core::params::Fault;
use rockface_core::{Context, Inputs, Outputs, Page, Point, Port, Stage, StageError, params};

params! {
    /// Parameters of `tabulate`.
    pub struct TabulateParams {
        /// Columns of one value each that every row gets, such as the parameters of a point of a search: `{sigma_px: "${fine.sigma_px}"}`.
        constants: BTreeMap<String, Value> = BTreeMap::new(),
    }
}

/// A plain value as a cell; `None` for lists and maps.
fn constant(value: &Value) -> Option<Cell> {
    match value {
        Value::Number(number) => number.as_f64().map(Cell::from),
        Value::String(text) => Some(text.as_str().into()),
        Value::Bool(flag) => Some((*flag).into()),
        Value::Null => Some(Cell::Empty(())),
        Value::Array(_) | Value::Object(_) => None,
    }
}

/// Concatenates tables into one; of an inventory, the properties of its features are the rows.
pub struct Tabulate;

impl Stage for Tabulate {
    type Params = TabulateParams;
    const NAME: &'static str = "tabulate";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("tabulate.md"));
    const INPUTS: &'static [Port] = &[Port::many(
        "rows",
        &[Kind::Table, Kind::Inventory],
        "Tables, or inventories for their properties, gathered over any axes.",
    )];
    const OUTPUTS: &'static [Port] = &[Port::one("table", &[Kind::Table], "All rows.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let fault = |name: &String| Fault {
            path: vec!["constants".to_owned(), name.clone()],
            ..Fault::new("a list or map cannot be a cell: give a number, a text or true/false")
        };
        params.constants.iter().filter(|(_, value)| constant(value).is_none()).map(|(name, _)| fault(name)).collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let elements = inputs.elements("rows").iter();
        let tables =
            elements.map(|e| Ok((&e.point, as_table(e.artefact()?)))).collect::<Result<Vec<_>, StageError>>()?;
        let tables: Vec<(&Point, &Table)> = tables.iter().map(|(items, table)| (*items, &**table)).collect();
        let axes = axes(tables.iter().map(|(items, _)| *items));
        let columns = united_columns(&tables, &axes)?;
        if let Some(name) = params.constants.keys().find(|name| axes.contains(name) || columns.contains(name)) {
            return Err(StageError::new(format!("constant `{name}` is called like an axis or a column of the table"))
                .hint("give the constant another name"));
        }
        let constants: Vec<Cell> = params.constants.values().filter_map(constant).collect();
        let mut all = Table::new(axes.iter().chain(params.constants.keys()).chain(&columns).cloned());
        for (items, table) in &tables {
            let from: Vec<Option<usize>> = columns.iter().map(|column| table.column(column)).collect();
            for row in &table.rows {
                let cells = from.iter().map(|at| at.map_or(Cell::Empty(()), |at| row[at].clone()));
                let known = axes.iter().map(|axis| item_cell(items, axis)).chain(constants.iter().cloned());
                all.push(known.chain(cells).collect());
            }
        }
        context.note(format!("{} rows of {} tables", all.rows.len(), tables.len()));
        Ok(Outputs::of("table", all))
    }
}

/// A table, or that of the properties of an inventory.
fn as_table(artefact: &Artefact) -> Cow<'_, Table> {
    match artefact {
        Artefact::Table(table) => Cow::Borrowed(table),
        other => {
            let (columns, rows) = columns::rows(other).unwrap_or_default();
            let mut table = Table::new(columns.iter().cloned());
            rows.into_iter().for_each(|row| table.push(row.to_vec()));
            Cow::Owned(table)
        }
    }
}

/// Columns of all tables in the order they are first met.
fn united_columns(tables: &[(&Point, &Table)], axes: &[String]) -> Result<Vec<String>, StageError> {
    let mut united: Vec<String> = Vec::new();
    for (items, table) in tables {
        for (index, column) in table.columns.iter().enumerate() {
            let place = items.iter().fold(String::new(), |place, (axis, item)| format!("{place} at {axis}={item}"));
            if axes.contains(column) {
                return Err(StageError::new(format!("axis `{column}` is called like a column of the table{place}"))
                    .hint("rename the axis"));
            }
            if table.columns[..index].contains(column) {
                return Err(StageError::new(format!("the table{place} has two columns called `{column}`"))
                    .hint("rename one where the table is made"));
            }
            if !united.contains(column) {
                united.push(column.clone());
            }
        }
    }
    Ok(united)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use rockface_core::testing::TestHost;

    fn table(columns: &[&str], row: Vec<Cell>) -> Table {
        let mut table = Table::new(columns.iter().copied());
        table.push(row);
        table
    }

    fn tabulate(tables: Vec<(&[(&str, &str)], Table)>) -> Result<Table, StageError> {
        with_constants(tables, BTreeMap::new())
    }

    fn with_constants(
        tables: Vec<(&[(&str, &str)], Table)>,
        constants: BTreeMap<String, Value>,
    ) -> Result<Table, StageError> {
        let mut inputs = Inputs::default();
        for (items, table) in tables {
            let point = items.iter().map(|(axis, item)| ((*axis).to_owned(), (*item).to_owned())).collect();
            inputs.push("rows", point, Arc::new(table.into()));
        }
        let outputs = Tabulate::run(&TabulateParams { constants }, &inputs, &Context::new(&TestHost::default()))?;
        let outputs = outputs.into_inner();
        let Artefact::Table(table) = &outputs["table"] else { panic!("a table comes out") };
        Ok(table.clone())
    }

    #[test]
    fn items_lead_and_columns_unite() {
        let found = tabulate(vec![
            (&[("sigma_px", "0.6"), ("epoch", "pre")], table(&["a", "b"], vec![1.0.into(), "x".into()])),
            (&[("sigma_px", "0.7"), ("epoch", "post")], table(&["c", "a"], vec![true.into(), 2.0.into()])),
        ])
        .unwrap();
        assert_eq!(found.columns, ["epoch", "sigma_px", "a", "b", "c"]);
        assert_eq!(found.rows[0], ["pre".into(), 0.6.into(), 1.0.into(), "x".into(), Cell::Empty(())]);
        assert_eq!(found.rows[1], ["post".into(), 0.7.into(), 2.0.into(), Cell::Empty(()), true.into()]);
    }

    #[test]
    fn constants_stand_between_items_and_columns() {
        let constants = || BTreeMap::from([("b".to_owned(), Value::from(0.5)), ("c".to_owned(), Value::from("x"))]);
        let rows = || vec![(&[("k", "1")][..], table(&["a"], vec![7.0.into()]))];
        let found = with_constants(rows(), constants()).unwrap();
        assert_eq!(found.columns, ["k", "b", "c", "a"]);
        assert_eq!(found.rows[0], [1.0.into(), 0.5.into(), "x".into(), 7.0.into()]);
        let clash = with_constants(vec![(&[], table(&["b"], vec![1.0.into()]))], constants()).unwrap_err();
        assert!(clash.message.contains("`b`"), "{clash}");
        let list = BTreeMap::from([("l".to_owned(), Value::from(vec![1]))]);
        assert_eq!(Tabulate::check(&TabulateParams { constants: list })[0].path, ["constants", "l"]);
    }

    #[test]
    fn names_that_clash_are_refused() {
        let clash = tabulate(vec![(&[("a", "1")], table(&["a"], vec![1.0.into()]))]).unwrap_err();
        assert!(clash.message.contains("axis `a`") && clash.message.contains("a=1"), "{clash}");
        let twins = tabulate(vec![(&[], table(&["a", "a"], vec![1.0.into(), 2.0.into()]))]).unwrap_err();
        assert!(twins.message.contains("two columns"));
    }
}
