//! `compare-samples`: whether a classifier can tell simulated rasters from real ones by their features.

use crate::noise::chain;
use crate::noise::classifier::{Auc, Logistic, area, cross_validated};
use crate::noise::descriptors::feature_names;
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_raster::feature_rows::{FeatureRow, feature_rows};

params! {
    /// Parameters of `compare-samples`.
    pub struct CompareSamplesParams {
        /// Columns the classifier sees.
        features: Vec<String> = feature_names().into_iter().map(str::to_owned).collect(),
        /// Ridge on the weights of the standardised features.
        ridge: f64 = 1.0; Range::Positive,
        /// Folds of the cross-validation.
        folds: usize = 5; Range::Between(2.0, 1000.0),
    }
}

/// The stage.
pub struct CompareSamples;

impl Stage for CompareSamples {
    type Params = CompareSamplesParams;
    const NAME: &'static str = "compare-samples";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("compare_samples.md"));
    const INPUTS: &'static [Port] = &[
        Port::many("reference", &[Kind::Table], "Features of real rasters, from `describe-noise`."),
        Port::many("simulated", &[Kind::Table], "Features of simulated rasters, from `describe-noise`."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("areas", &[Kind::Table], "Area with interval: `linear`, `squares`, and each feature by itself."),
        Port::one("scores", &[Kind::Table], "One row a raster: class, cross-validated scores."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut fault = Fault::new("at least one feature is needed");
        fault.path = vec!["features".to_owned()];
        if params.features.is_empty() { vec![fault] } else { Vec::new() }
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut classes = [Vec::new(), Vec::new()];
        for (class, port) in classes.iter_mut().zip(["reference", "simulated"]) {
            *class = feature_rows(&inputs.many::<Table>(port)?, &params.features).map_err(StageError::new)?;
            let least = params.folds.max(4);
            if class.len() < least {
                let text =
                    format!("`{port}` has {} rasters, {least} are needed for {} folds", class.len(), params.folds);
                return Err(StageError::new(text).hint("add rasters, or lower `folds`"));
            }
        }
        let labels: Vec<String> = classes[0].iter().map(FeatureRow::label).collect();
        if let Some(text) = chain::warning(&labels) {
            context.warn(text);
        }
        let values = classes.each_ref().map(|rows| rows.iter().map(|row| row.values.clone()).collect::<Vec<_>>());
        let linear = cross_validated([&values[0], &values[1]], params.folds, params.ridge);
        let squared = with_squares(&values);
        let squares = cross_validated([&squared[0], &squared[1]], params.folds, params.ridge);
        let table = areas(params, &values, [&linear, &squares]);
        log(&area(&linear[0], &linear[1]), &area(&squares[0], &squares[1]), context);
        Ok(Outputs::of("areas", table).and("scores", scores(&classes, [&linear, &squares])))
    }
}

/// The features and the squares of their distances from the mean of all, which the classifier standardises again.
fn with_squares(classes: &[Vec<Vec<f64>>; 2]) -> [Vec<Vec<f64>>; 2] {
    let all = || classes.iter().flatten();
    let n = all().count() as f64;
    let p = classes[0][0].len();
    let mean: Vec<f64> = (0..p).map(|j| all().map(|row| row[j]).sum::<f64>() / n).collect();
    let extended = |row: &Vec<f64>| {
        let squares = row.iter().zip(&mean).map(|(x, m)| (x - m) * (x - m));
        row.iter().copied().chain(squares).collect()
    };
    classes.each_ref().map(|rows| rows.iter().map(extended).collect())
}

fn areas(params: &CompareSamplesParams, values: &[Vec<Vec<f64>>; 2], scores: [&[Vec<f64>; 2]; 2]) -> Table {
    let mut table = Table::new(["seen", "auc", "low95", "high95", "weight"]);
    let row = |name: &str, found: &Auc, weight: Cell| {
        let (low, high) = found.interval();
        vec![name.into(), found.auc.into(), low.into(), high.into(), weight]
    };
    for (name, [real, simulated]) in ["linear", "squares"].into_iter().zip(scores) {
        table.push(row(name, &area(real, simulated), Cell::Empty(())));
    }
    let rows = values.each_ref().map(|class| class.iter().map(Vec::as_slice).collect::<Vec<_>>());
    let whole = Logistic::fit([&rows[0], &rows[1]], params.ridge);
    for (j, feature) in params.features.iter().enumerate() {
        let [real, simulated] = values.each_ref().map(|class| class.iter().map(|row| row[j]).collect::<Vec<f64>>());
        table.push(row(feature, &area(&real, &simulated), whole.weights[j].into()));
    }
    table
}

fn scores(classes: &[Vec<FeatureRow>; 2], [linear, squares]: [&[Vec<f64>; 2]; 2]) -> Table {
    let mut table = Table::new(["raster", "class", "score_linear", "score_squares"]);
    for (class, name) in ["real", "simulated"].into_iter().enumerate() {
        for (i, row) in classes[class].iter().enumerate() {
            table.push(vec![row.label().into(), name.into(), linear[class][i].into(), squares[class][i].into()]);
        }
    }
    table
}

fn log(linear: &Auc, squares: &Auc, context: &Context) {
    context.metric("auc", linear.auc, "1");
    context.metric("auc_squares", squares.auc, "1");
    let text = |found: &Auc| {
        let (low, high) = found.interval();
        format!("{:.2} ({low:.2} to {high:.2})", found.auc)
    };
    context.headline(format!(
        "a classifier tells simulated from real with an area of {}, and with squares {}; 0.5 is indistinguishable",
        text(linear),
        text(squares)
    ));
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{TestHost, run_stage};

    fn features(n: i32, seed: u8, spread: f64, shift: f64) -> Table {
        let mut table = Table::new(["raster", "std_m", "nugget_m2", "skewness"]);
        let field = Key([seed; 32]).field();
        for i in 0..n {
            let value = |j: i32| Cell::from(spread * field.normal(i, j) + if j == 0 { shift } else { 0.0 });
            table.push(vec![format!("r{i}").into(), value(0), 0.0.into(), value(2)]);
        }
        table
    }

    fn compared(simulated: Table, with: &Value) -> Result<(Table, TestHost), StageError> {
        let host = TestHost::default();
        let inputs: [(&str, Artefact); 2] =
            [("reference", features(60, 1, 1.0, 0.0).into()), ("simulated", simulated.into())];
        let outputs = run_stage::<CompareSamples>(&host, with, &inputs)?.into_inner();
        let Artefact::Table(table) = &outputs["areas"] else { panic!("a table comes out") };
        Ok((table.clone(), host))
    }

    #[test]
    fn shifts_are_seen_linearly_and_spreads_by_squares() {
        let with = json!({"features": ["std_m", "nugget_m2", "skewness"]});
        let (same, _) = compared(features(60, 2, 1.0, 0.0), &with).unwrap();
        let at = |table: &Table, row: usize, column: usize| table.rows[row][column].number().unwrap();
        assert!(at(&same, 0, 2) < 0.5 && at(&same, 0, 1) < 0.65);
        let (shifted, host) = compared(features(60, 2, 1.0, 3.0), &with).unwrap();
        assert!(at(&shifted, 0, 1) > 0.95 && at(&shifted, 2, 1) > 0.95 && host.metric("auc").unwrap() > 0.95);
        assert!((at(&shifted, 3, 1) - 0.5).abs() < 1e-12 && at(&shifted, 3, 4).abs() < 1e-12);
        let (narrow, _) = compared(features(60, 2, 0.1, 0.0), &with).unwrap();
        assert!(at(&narrow, 0, 1) < 0.75 && at(&narrow, 1, 1) > 0.8, "{:?}", narrow.rows);
    }

    #[test]
    fn too_few_rasters_are_refused() {
        let error = compared(features(3, 2, 1.0, 0.0), &json!({"features": ["std_m"]})).err().unwrap();
        assert!(error.message.contains("`simulated` has 3 rasters"), "{error}");
    }
}
