//! `compare-figures`: measured figures beside published ones, with the reason where they must differ.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::figure::chart::{Axes, Ink, Layer, Mark, Panel, Sheet, draw};
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::Fault;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params, table_row};

choice! {
    /// What is made of the numbers of the rows.
    pub enum Take {
        /// There is one row, and this is its number.
        Only = "only",
        /// Their mean.
        Mean = "mean",
        /// Their median.
        Median = "median",
        /// The least.
        Min = "min",
        /// The greatest.
        Max = "max",
        /// Their sum.
        Sum = "sum",
        /// How many rows there are.
        Count = "count",
    }
}

params! {
    /// One figure.
    pub struct Compared {
        /// What it is.
        figure: String,
        /// The column of the measured one.
        column: String,
        /// Row by row, its number is divided by that of this column; left out: it is not.
        divided_by: Option<String> = None,
        /// What other columns must hold in its rows, a value or a range: `{quantile: 0.95, removed_m3: {max: 0.001}}`.
        rows: BTreeMap<String, Value> = BTreeMap::new(),
        /// What is made of the numbers of these rows.
        take: Take = Take::Only,
        /// The measured figure is multiplied by this.
        times: f64 = 1.0,
        /// And divided by this.
        over: f64 = 1.0,
        /// The published figure; null: there is none.
        published: Option<f64> = None,
        /// Unit of both.
        unit: String = "1".to_owned(),
        /// Why they must differ, or what was done otherwise.
        reason: Option<String> = None,
    }
}

params! {
    /// Parameters of `compare-figures`.
    pub struct CompareFiguresParams {
        /// The figures, in their order.
        figures: Vec<Compared>,
        /// Title of the chart; left out, what is compared.
        title: Option<String> = None,
    }
}

table_row! {
    /// One figure beside the published one.
    struct Row {
        figure: String,
        ours: Option<f64>,
        published: Option<f64>,
        unit: String,
        difference: Option<f64>,
        ratio: Option<f64>,
        reason: Option<String>,
    }
}

/// Sets measured figures beside published ones.
pub struct CompareFigures;

impl Stage for CompareFigures {
    type Params = CompareFiguresParams;
    const NAME: &'static str = "compare-figures";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("compare_figures.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("measured", &[Kind::Table], "What was measured; `tabulate` puts several tables together.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one("table", &[Kind::Table], "One row a figure: ours, the published one, difference, ratio, reason."),
        Port::one("figure", &[Kind::Figure], "Ratios of ours to the published ones."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut fault = |at: usize, name: &str, text: &str| {
            faults.push(Fault::new(text).below(name).below(&at.to_string()).below("figures"));
        };
        if params.figures.is_empty() {
            return vec![Fault::new("one figure at least is needed").below("figures")];
        }
        for (at, figure) in params.figures.iter().enumerate() {
            if figure.over == 0.0 {
                fault(at, "over", "nothing can be divided by 0");
            }
            let is_range = |map: &serde_json::Map<String, Value>| {
                !map.is_empty()
                    && map.iter().all(|(key, bound)| ["min", "max"].contains(&key.as_str()) && bound.is_number())
            };
            let odd = |value: &Value| value.is_array() || value.as_object().is_some_and(|map| !is_range(map));
            if figure.rows.values().any(odd) {
                fault(at, "rows", "a cell is a number, a text or true/false, or in a range {min, max}");
            }
        }
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let measured = inputs.one::<Table>("measured")?;
        let rows = params.figures.iter().map(|figure| compare(figure, measured)).collect::<Result<Vec<_>, _>>()?;
        if rows.iter().all(|row| row.ours.is_none()) {
            fail!("none of the {} rows of the table is of a kind that `figures` names", measured.rows.len());
        }
        for row in &rows {
            let published = row.published.map_or_else(|| "none published".to_owned(), |x| format!("{x} published"));
            match row.ours {
                Some(ours) => context.note(format!("{}: {} {}, {published}", row.figure, significant(ours), row.unit)),
                None => {
                    context.warn(format!("{}: nothing measured, as no row of the table is of this kind", row.figure));
                }
            }
        }
        let ratios: Vec<(String, f64)> = rows.iter().filter_map(|row| Some((row.figure.clone(), row.ratio?))).collect();
        let near = ratios.iter().filter(|(_, ratio)| (0.8..=1.25).contains(ratio)).count();
        context.metric("figures", rows.len() as f64, "1");
        context.metric("within_a_quarter", near as f64, "1");
        context.headline(format!("{near} of {} published figures are met within a quarter", ratios.len()));
        let title = params.title.clone().unwrap_or_else(|| "Our figures over the published ones".to_owned());
        let height = 120 + 24 * ratios.len() as u32;
        let axes = Axes::bars("ours over published", ratios).with(Layer::new("equal", Mark::AtX(1.0)).ink(Ink::Text));
        let sheet = Sheet::of([Panel::new("", axes)]).title(title).size(860, height.max(240));
        let figure = draw(&sheet).map_err(|e| StageError::new(e.to_string()))?;
        Ok(Outputs::of("table", rows.into_iter().collect::<Table>()).and("figure", figure))
    }
}

fn compare(figure: &Compared, table: &Table) -> Result<Row, StageError> {
    let ours = measured(figure, table)?.map(|ours| ours * figure.times / figure.over);
    let published = figure.published.filter(|published| *published != 0.0);
    let ratio = ours.zip(published).map(|(ours, published)| ours / published);
    Ok(Row {
        figure: figure.figure.clone(),
        ours,
        published: figure.published,
        unit: figure.unit.clone(),
        difference: ours.zip(figure.published).map(|(ours, published)| ours - published),
        ratio: ratio.filter(|ratio| ratio.is_finite()),
        reason: figure.reason.clone(),
    })
}

/// What the table says; nothing where no row is of the kind, as when no block was found.
fn measured(figure: &Compared, table: &Table) -> Result<Option<f64>, StageError> {
    let name = &figure.figure;
    let place = |column: &String| {
        table.column(column).ok_or_else(|| {
            StageError::new(format!("figure `{name}`: the table has no column `{column}`"))
                .hint(format!("it has {}", table.columns.join(", ")))
        })
    };
    let column = place(&figure.column)?;
    let divisor = figure.divided_by.as_ref().map(place).transpose()?;
    let wanted = figure.rows.iter().map(|(name, value)| Ok((place(name)?, value)));
    let wanted = wanted.collect::<Result<Vec<_>, StageError>>()?;
    let rows: Vec<&Vec<Cell>> =
        table.rows.iter().filter(|row| wanted.iter().all(|(at, value)| holds(&row[*at], value))).collect();
    if figure.take == Take::Count {
        return Ok(Some(rows.len() as f64));
    }
    let of_row = |row: &&Vec<Cell>| {
        let divided = |at: usize| Some(number(&row[column])? / number(&row[at]).filter(|by| *by != 0.0)?);
        divisor.map_or_else(|| number(&row[column]), divided)
    };
    let numbers: Vec<f64> = rows.iter().filter_map(of_row).collect();
    let where_ = || serde_json::json!(figure.rows).to_string();
    if numbers.is_empty() {
        return Ok(None);
    }
    Ok(Some(match figure.take {
        Take::Only if numbers.len() > 1 => {
            fail!("figure `{name}`: {} rows hold where {}: say which, or `take` a mean", numbers.len(), where_());
        }
        Take::Only => numbers[0],
        Take::Mean => numbers.iter().sum::<f64>() / numbers.len() as f64,
        Take::Median => quantile(&numbers, 0.5).unwrap_or(f64::NAN),
        Take::Min => numbers.iter().copied().fold(f64::INFINITY, f64::min),
        Take::Max => numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        Take::Sum | Take::Count => numbers.iter().sum(),
    }))
}

/// A number, or 1 and 0 for true and false.
fn number(cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Flag(flag) => Some(f64::from(u8::from(*flag))),
        other => other.number(),
    }
}

fn holds(cell: &Cell, wanted: &Value) -> bool {
    match (cell, wanted) {
        (Cell::Flag(flag), Value::Bool(wanted)) => flag == wanted,
        (Cell::Empty(()), Value::Null) => true,
        (cell, Value::Number(wanted)) => {
            let wanted = wanted.as_f64().unwrap_or(f64::NAN);
            cell.number().is_some_and(|x| (x - wanted).abs() <= 1e-9 * wanted.abs())
        }
        (cell, Value::String(wanted)) => cell.to_string() == *wanted,
        (cell, Value::Object(range)) => {
            let bound = |key: &str, none: f64| range.get(key).and_then(Value::as_f64).unwrap_or(none);
            let within = |x: f64| (bound("min", f64::NEG_INFINITY)..=bound("max", f64::INFINITY)).contains(&x);
            cell.number().is_some_and(within)
        }
        _ => false,
    }
}

/// Four digits are enough for people.
fn significant(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return x.to_string();
    }
    let digits = (3.0 - rockface_core::numerics::portable_math::log10(x.abs()).floor()).clamp(0.0, 12.0);
    format!("{x:.*}", digits as usize)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::params::ParamType;
    use rockface_core::testing::{TestHost, run_stage};

    fn table() -> Table {
        let mut table = Table::new(["source", "quantile", "threshold", "accepted"]);
        table.push(vec!["rates".into(), 0.9.into(), 13.0.into(), true.into()]);
        table.push(vec!["rates".into(), 0.95.into(), 25.0.into(), false.into()]);
        table.push(vec!["other".into(), Cell::Empty(()), 7.0.into(), true.into()]);
        table
    }

    fn compared(figures: &Value) -> Result<(Table, String), StageError> {
        let inputs: [(&str, Artefact); 1] = [("measured", table().into())];
        let made = run_stage::<CompareFigures>(&TestHost::default(), &json!({"figures": figures}), &inputs)?;
        let mut made = made.into_inner();
        let (Some(Artefact::Table(table)), Some(Artefact::Figure(figure))) =
            (made.remove("table"), made.remove("figure"))
        else {
            panic!("a table and a figure come out")
        };
        Ok((table, figure.svg))
    }

    #[test]
    fn each_figure_is_found_and_stands_beside_the_published_one() {
        let one = |more: Value| {
            let mut figure = json!({"figure": "D2 threshold", "column": "threshold", "published": 24.9});
            figure.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            compared(&json!([figure]))
        };
        let number = |more: Value, column: usize| one(more).unwrap().0.rows[0][column].number();
        assert_eq!(number(json!({"rows": {"quantile": 0.95}}), 1), Some(25.0));
        assert!((number(json!({"rows": {"quantile": 0.95}}), 5).unwrap() - 25.0 / 24.9).abs() < 1e-12);
        assert_eq!(number(json!({"rows": {"source": "rates"}, "take": "mean", "times": 2, "over": 4}), 1), Some(9.5));
        assert_eq!(number(json!({"take": "count"}), 1), Some(3.0));
        assert_eq!(number(json!({"column": "accepted", "take": "sum"}), 1), Some(2.0));
        assert_eq!(number(json!({"take": "max", "rows": {"accepted": true}}), 1), Some(13.0));
        assert_eq!(number(json!({"take": "count", "rows": {"threshold": {"min": 10, "max": 20}}}), 1), Some(1.0));
        assert_eq!(number(json!({"take": "min", "published": null}), 5), None);
        let (table, svg) = one(json!({"take": "median", "reason": "another site"})).unwrap();
        assert_eq!(table.columns, ["figure", "ours", "published", "unit", "difference", "ratio", "reason"]);
        assert_eq!(table.rows[0][6].text(), Some("another site"));
        assert!(svg.contains("D2 threshold") && svg.contains("ours over published"));
    }

    #[test]
    fn what_is_not_there_or_not_one_is_refused() {
        let says = |figure: Value, text: &str| {
            let message = compared(&json!([figure])).unwrap_err().message;
            assert!(message.contains(text), "{message}");
        };
        says(json!({"figure": "a", "column": "d2"}), "no column `d2`");
        says(json!({"figure": "a", "column": "threshold"}), "3 rows hold");
        let none = json!({"figure": "a", "column": "threshold", "rows": {"quantile": 0.5}, "published": 1});
        says(none.clone(), "none of the 3 rows");
        let (table, _) = compared(&json!([none, {"figure": "b", "column": "threshold", "take": "sum"}])).unwrap();
        assert!([1, 4, 5].iter().all(|at| table.rows[0][*at] == Cell::Empty(())), "nothing was measured of it");
        assert_eq!(table.rows[1][1].number(), Some(45.0));
        let faults = |with: Value| CompareFigures::check(&CompareFiguresParams::decode(&with).unwrap()).len();
        assert_eq!(faults(json!({"figures": []})), 1);
        assert_eq!(faults(json!({"figures": [{"figure": "a", "column": "b", "over": 0, "rows": {"c": [1]}}]})), 2);
    }
}
