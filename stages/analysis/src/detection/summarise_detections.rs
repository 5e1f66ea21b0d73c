//! `summarise-detections`: rates of a detector over many epochs, with intervals, one row a setting.

use crate::detection::rates;
use crate::detection::rates::Interval;
use crate::detection::score::Counts;
use rockface_core::artefact::{Kind, Table};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::feature_rows;
use rockface_raster::feature_rows::{Items, item_cell};

params! {
    /// Parameters of `summarise-detections`.
    pub struct SummariseDetectionsParams {
        /// Axes whose items are epochs: rates are pooled and averaged over them. Every other gathered axis is a setting with a
        /// row of its own, so a swept threshold gives a precision-recall curve.
        epochs: Vec<String> = vec!["epoch".to_owned()],
        /// Draws of epochs with replacement for the 95 % intervals.
        resamples: u32 = 2000; Range::Between(0.0, 1e6),
    }
}

/// Pools the scores of many epochs into rates with 95 % intervals.
pub struct SummariseDetections;

impl Stage for SummariseDetections {
    type Params = SummariseDetectionsParams;
    const NAME: &'static str = "summarise-detections";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("summarise_detections.md"));
    const INPUTS: &'static [Port] = &[Port::many(
        "scores",
        &[Kind::Table],
        "The `summary` of `score-detections`, gathered over epochs and settings.",
    )];
    const OUTPUTS: &'static [Port] = &[Port::one("rates", &[Kind::Table], "One row a setting.")];

    fn draws(params: &Self::Params) -> bool {
        params.resamples > 0
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let tables = inputs.many::<Table>("scores")?;
        let axes = feature_rows::axes(tables.iter().map(|(items, _)| *items));
        if let Some(lacking) = params.epochs.iter().find(|axis| !axes.contains(axis)) {
            fail!("nothing is gathered over the axis `{lacking}` of `epochs`; there are {}", axes.join(", "));
        }
        let settings: Vec<&String> = axes.iter().filter(|axis| !params.epochs.contains(axis)).collect();
        let mut groups: Vec<(Items, Vec<Epoch>)> = Vec::new();
        for (items, table) in &tables {
            let setting: Items = items.iter().filter(|(axis, _)| settings.contains(axis)).map(owned).collect();
            let epochs = (0..table.rows.len()).map(|row| Epoch::read(table, row)).collect::<Result<Vec<_>, _>>()?;
            match groups.iter_mut().find(|(known, _)| *known == setting) {
                Some((_, known)) => known.extend(epochs),
                None => groups.push((setting, epochs)),
            }
        }
        let mut rows: Option<Table> = None;
        for (setting, epochs) in &groups {
            let key =
                if params.resamples > 0 { Some(context.stream("epochs", &epochs.len().to_string())) } else { None };
            let draws = key.map_or_else(Vec::new, |key| rates::draws(key, epochs.len(), params.resamples as usize));
            let row = row(epochs, &draws);
            let names = settings.iter().map(|axis| (*axis).clone()).chain(row.iter().map(|(name, _)| name.clone()));
            let table = rows.get_or_insert_with(|| Table::new(names));
            let cells =
                settings.iter().map(|axis| item_cell(setting, axis)).chain(row.iter().map(|(_, x)| (*x).into()));
            table.push(cells.collect());
            context.check_cancelled()?;
        }
        let table = rows.ok_or_else(|| StageError::new("nothing is gathered"))?;
        report(&table, groups.len(), params.resamples > 0, context);
        Ok(Outputs::of("rates", table))
    }
}

fn owned((axis, item): (&String, &String)) -> (String, String) {
    (axis.clone(), item.clone())
}

/// Of fewer epochs, percentile intervals are clearly too narrow.
const FEW_EPOCHS: f64 = 10.0;

/// What one epoch contributes.
#[derive(Debug, Clone)]
struct Epoch {
    /// By any overlap, one to one, and by cell.
    counts: [Counts; 3],
    /// Numbers that are averaged, in the order of [`MEANS`].
    means: Vec<Option<f64>>,
    truths: f64,
    hidden: f64,
    /// Detections where the grid has no value.
    outside: f64,
    truth_m3: f64,
    detected_m3: f64,
}

const MEANS: [&str; 5] =
    ["volume_error_mean", "volume_error_mean_abs", "volume_error_median", "log_volume_ratio_median", "iou_mean"];

impl Epoch {
    fn read(table: &Table, row: usize) -> Result<Self, StageError> {
        let optional = |name: &str| -> Result<Option<f64>, StageError> {
            let at = table.column(name).ok_or_else(|| {
                let columns = table.columns.join(", ");
                StageError::new(format!("a gathered table has no column `{name}`; it has {columns}"))
                    .hint("gather the port `summary` of `score-detections`")
            })?;
            Ok(table.rows[row][at].number())
        };
        let number = |name: &str| Ok::<f64, StageError>(optional(name)?.unwrap_or(0.0));
        let counts = |names: [&str; 4]| -> Result<Counts, StageError> {
            let [a, b, c, d] = names;
            let whole = |name| Ok::<usize, StageError>(number(name)? as usize);
            Ok(Counts { true_positives: whole(a)?, false_positives: whole(b)?, found: whole(c)?, missed: whole(d)? })
        };
        Ok(Self {
            counts: [
                counts(["true_positives", "false_positives", "found", "missed"])?,
                counts(["true_positives_1to1", "false_positives_1to1", "found_1to1", "missed_1to1"])?,
                counts(["cells_true_positive", "cells_false_positive", "cells_true_positive", "cells_false_negative"])?,
            ],
            means: MEANS.iter().map(|name| optional(name)).collect::<Result<_, _>>()?,
            truths: number("truths")?,
            hidden: number("hidden")?,
            // A table of one's own may have none.
            outside: if table.column("outside").is_some() { number("outside")? } else { 0.0 },
            truth_m3: number("truth_m3")?,
            detected_m3: number("detected_m3")?,
        })
    }
}

/// Names and values of one row.
fn row(epochs: &[Epoch], draws: &[Vec<usize>]) -> Vec<(String, f64)> {
    let sum = |of: fn(&Epoch) -> f64| epochs.iter().fold(0.0, |sum, epoch| sum + of(epoch));
    let mut row: Vec<(String, f64)> = vec![
        ("epochs".into(), epochs.len() as f64),
        ("truths".into(), sum(|epoch| epoch.truths)),
        ("hidden".into(), sum(|epoch| epoch.hidden)),
        ("outside".into(), sum(|epoch| epoch.outside)),
        ("true_positives".into(), sum(|epoch| epoch.counts[0].true_positives as f64)),
        ("false_positives".into(), sum(|epoch| epoch.counts[0].false_positives as f64)),
        ("found".into(), sum(|epoch| epoch.counts[0].found as f64)),
        ("missed".into(), sum(|epoch| epoch.counts[0].missed as f64)),
        ("truth_m3".into(), sum(|epoch| epoch.truth_m3)),
        ("detected_m3".into(), sum(|epoch| epoch.detected_m3)),
    ];
    let mut push = |name: String, found: Interval| {
        row.push((name.clone(), found.value));
        row.push((format!("{name}_low"), found.ends[0]));
        row.push((format!("{name}_high"), found.ends[1]));
    };
    for (kind, suffix) in ["", "_1to1", "_by_cell"].into_iter().enumerate() {
        let counts: Vec<Counts> = epochs.iter().map(|epoch| epoch.counts[kind]).collect();
        for (place, name) in ["precision", "recall", "f1"].into_iter().enumerate() {
            push(
                format!("pooled_{name}{suffix}"),
                rates::rate_interval(&counts, draws, place, |c| rates::pooled(c)[place]),
            );
            push(
                format!("macro_{name}{suffix}"),
                rates::rate_interval(&counts, draws, place, |c| rates::averaged(c)[place]),
            );
        }
        push(format!("mean_f1{suffix}"), rates::rate_interval(&counts, draws, 2, rates::mean_f1));
    }
    for (place, name) in MEANS.into_iter().enumerate() {
        let values: Vec<Option<f64>> = epochs.iter().map(|epoch| epoch.means[place]).collect();
        push(name.to_owned(), rates::interval(&values, draws, |v| rates::mean(v.iter().copied().flatten())));
    }
    row
}

fn report(table: &Table, settings: usize, has_intervals: bool, context: &Context) {
    let value = |row: usize, name: &str| table.column(name).and_then(|at| table.rows[row][at].number());
    let f1 = |row: &usize| value(*row, "pooled_f1").unwrap_or(-1.0);
    let Some(best) = (0..table.rows.len()).max_by(|a, b| f1(a).total_cmp(&f1(b))) else { return };
    let percent =
        |name: &str| value(best, name).map_or("undefined".to_owned(), |share| format!("{:.1} %", 100.0 * share));
    let known = table.columns.iter().position(|name| name == "epochs").unwrap_or(0);
    let setting: Vec<String> = (0..known).map(|at| format!("{}={}", table.columns[at], table.rows[best][at])).collect();
    for name in ["pooled_precision", "pooled_recall", "pooled_f1", "macro_f1"] {
        if let Some(value) = value(best, name) {
            context.metric(name, value, "1");
        }
    }
    let which =
        if settings > 1 { format!("best of {settings} settings: {}: ", setting.join(" ")) } else { String::new() };
    let count = |name: &str| value(best, name).unwrap_or(0.0);
    let hidden = match count("hidden") {
        0.0 => String::new(),
        hidden => format!("; {hidden} of {} true changes cannot be seen and are in no rate", count("truths")),
    };
    let outside = match count("outside") {
        0.0 => String::new(),
        outside => format!("; {outside} more detections lie where the grid has no value and are in no rate"),
    };
    let fewest = (0..table.rows.len()).filter_map(|row| value(row, "epochs")).fold(f64::INFINITY, f64::min);
    if fewest < 2.0 && has_intervals {
        context.warn("a rate of one epoch has no interval: take 20 epochs or more");
    } else if fewest < FEW_EPOCHS && has_intervals {
        context.warn(format!(
            "intervals over {fewest} epochs are too narrow: of 2, 5, 10 and 20 epochs, intervals of 95 % hold the true rate in about 50, 80, 90 and 94 % of cases; take 20 or more"
        ));
    }
    context.headline(format!(
        "{which}precision {}, recall {}, F1 {} over {} epochs{hidden}{outside}",
        percent("pooled_precision"),
        percent("pooled_recall"),
        percent("pooled_f1"),
        value(best, "epochs").unwrap_or(0.0)
    ));
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use rockface_core::artefact::{Artefact, Cell};
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;

    /// A summary in which every count but these four is empty.
    fn summary([tp, fp, found, missed]: [f64; 4]) -> Table {
        let mut row = vec![("true_positives", tp), ("false_positives", fp), ("found", found), ("missed", missed)];
        row.extend([("true_positives_1to1", tp), ("false_positives_1to1", fp), ("found_1to1", found)]);
        row.extend([("missed_1to1", missed), ("cells_true_positive", 5.0), ("cells_false_positive", 5.0)]);
        row.extend([("cells_false_negative", 15.0), ("truths", found + missed), ("hidden", 0.0)]);
        row.extend([("truth_m3", 1.0), ("detected_m3", 0.5)]);
        row.extend(MEANS.map(|name| (name, -0.25)));
        let mut table = Table::new(row.iter().map(|(name, _)| *name));
        table.push(row.iter().map(|(_, value)| Cell::from(*value)).collect());
        table
    }

    fn run(tables: Vec<(&[(&str, &str)], Table)>, resamples: u32) -> Result<Table, StageError> {
        let mut inputs = Inputs::default();
        for (items, table) in tables {
            let point = items.iter().map(|(axis, item)| ((*axis).to_owned(), (*item).to_owned())).collect();
            inputs.push("scores", point, Arc::new(table.into()));
        }
        let params = SummariseDetectionsParams::decode(&serde_json::json!({"resamples": resamples})).unwrap();
        let made = SummariseDetections::run(&params, &inputs, &Context::new(&TestHost::default()))?.into_inner();
        let Artefact::Table(table) = &made["rates"] else { panic!("no rates") };
        Ok(table.clone())
    }

    #[test]
    fn a_sweep_gives_a_row_a_threshold_and_the_paper_its_f1() {
        let tables = vec![
            (&[("epoch", "0"), ("lod_m", "0.02")][..], summary([56.7, 43.3, 24.4, 75.6].map(|x: f64| x * 10.0))),
            (&[("epoch", "0"), ("lod_m", "0.05")][..], summary([3.0, 0.0, 2.0, 2.0])),
            (&[("epoch", "1"), ("lod_m", "0.05")][..], summary([1.0, 1.0, 1.0, 3.0])),
        ];
        let found = run(tables, 500).unwrap();
        let value = |row: usize, name: &str| found.rows[row][found.column(name).unwrap()].number().unwrap();
        assert_eq!((found.rows.len(), value(0, "lod_m"), value(1, "epochs")), (2, 0.02, 2.0));
        assert!((value(0, "macro_f1") - 0.341).abs() < 5e-4);
        assert!(
            (value(1, "pooled_precision") - 0.8).abs() < 1e-12 && (value(1, "pooled_recall") - 0.375).abs() < 1e-12
        );
        assert!((value(1, "macro_precision") - 0.75).abs() < 1e-12);
        assert!(
            (value(1, "macro_precision_low") - 0.5).abs() < 1e-12
                && (value(1, "macro_precision_high") - 1.0).abs() < 1e-12
        );
        assert!((value(1, "pooled_recall_by_cell") - 0.25).abs() < 1e-12);
        assert!((value(1, "volume_error_median") + 0.25).abs() < 1e-12);
    }

    #[test]
    fn other_axes_and_tables_are_refused() {
        let error = run(vec![(&[("lod_m", "1")], summary([1.0; 4]))], 0).unwrap_err();
        assert!(error.message.contains("axis `epoch`") && error.message.contains("lod_m"));
        let error = run(
            vec![(&[("epoch", "1")], {
                let mut t = Table::new(["a"]);
                t.push(vec![1.0.into()]);
                t
            })],
            0,
        );
        assert!(error.unwrap_err().message.contains("no column `true_positives`"));
    }
}
