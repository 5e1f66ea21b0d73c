//! `fit-acceptance`: learns from real noise rasters how far a compatible raster may lie from them.

use std::collections::BTreeMap;

use crate::noise::acceptance_rate::{perfect_acceptance, share_below};
use crate::noise::chain;
use crate::noise::descriptors::{GROUPS, feature_names, in_group, taken};
use crate::noise::mahalanobis::{bound, fit_labelled, leave_one_out_quantile};
use crate::noise::tested;
use crate::noise::tested::Role;
use rockface_core::artefact::{Acceptance, Cell, GroupModel, Kind, Table};
use rockface_core::names::twice;
use rockface_core::numerics::beta;
use rockface_core::numerics::held_out::in_view;
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_raster::feature_rows::{FeatureRow, feature_rows};

params! {
    /// Parameters of `fit-acceptance`.
    pub struct FitAcceptanceParams {
        /// Columns that make the feature vector. Without `mean_m` an offset left by registration does not count.
        features: Vec<String> = feature_names().into_iter().map(str::to_owned).collect(),
        /// With too few references for all features (two more are needed), take one feature for two references, those that say most first
        /// (`std_m`, `roughness_b`, `skewness`, `range95_m`, `spectral_slope`), and warn. `false`: refuse.
        fewer: bool = false,
        /// Ridge factor lambda, added to the diagonal of the covariance of the standardised features.
        ridge: f64 = 1e-3; Range::NonNegative,
        /// Quantile of the reference distances that is reported as threshold.
        quantile: f64 = 0.95; Range::Between(0.5, 1.0),
        /// Share of the rasters, the last ones, that is not looked at: a calibration by this model can be judged by them.
        held_out: f64 = 0.0; Range::Between(0.0, 0.9),
    }
}

/// Fits the Mahalanobis model of the reference rasters, for all features together and for each descriptor group.
pub struct FitAcceptance;

impl Stage for FitAcceptance {
    type Params = FitAcceptanceParams;
    const NAME: &'static str = "fit-acceptance";
    const VERSION: u32 = 5;
    const PAGE: Page = Page::new(include_str!("fit_acceptance.md"));
    const INPUTS: &'static [Port] =
        &[Port::many("features", &[Kind::Table], "Features of real rasters, as `describe-noise` makes them.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one("model", &[Kind::Acceptance], "Mean, spread, inverse covariance and distances of the reference."),
        Port::one("summary", &[Kind::Table], "One row a group: thresholds, bound, leave-one-out, eigenvalues."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let twin = twice(params.features.iter().collect()).map(|name| format!("`{name}` is listed twice"));
        let message = if params.features.is_empty() { Some("at least one feature is needed".to_owned()) } else { twin };
        let at_features = |message| Fault { path: vec!["features".to_owned()], ..Fault::new(message) };
        message.map(at_features).into_iter().collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let tables = inputs.many::<Table>("features")?;
        let count = tables.iter().map(|(_, table)| table.rows.len()).sum();
        let kept = in_view(count, params.held_out);
        let (features, warning) = taken(&params.features, kept, params.fewer);
        if let Some(text) = warning {
            context.warn(text);
        }
        let params = &FitAcceptanceParams { features, ..params.clone() };
        let mut rows = feature_rows(&tables, &params.features)?;
        rows.truncate(kept);
        if let Some(text) = tested::copies(&rows, Role::Reference) {
            context.warn(text);
        }
        let mut groups = BTreeMap::from([("all".to_owned(), fit_columns(&params.features, params, &rows)?)]);
        for (group, _) in GROUPS {
            let chosen: Vec<String> = params.features.iter().filter(|name| in_group(group, name)).cloned().collect();
            let varies = chosen.iter().any(|name| groups["all"].features.contains(name));
            if varies {
                groups.insert(group.to_owned(), fit_columns(&chosen, params, &rows)?);
            }
        }
        let labels = rows.iter().map(FeatureRow::label).collect();
        let model = Acceptance { references: rows.len(), ridge: params.ridge, labels, groups };
        log(&model, params.quantile, context);
        let summary = summary(&model, params.quantile);
        Ok(Outputs::of("model", model).and("summary", summary))
    }
}

fn fit_columns(names: &[String], params: &FitAcceptanceParams, rows: &[FeatureRow]) -> Result<GroupModel, StageError> {
    let columns: Vec<usize> =
        params.features.iter().enumerate().filter(|(_, f)| names.contains(f)).map(|(j, _)| j).collect();
    let values: Vec<Vec<f64>> = rows.iter().map(|row| columns.iter().map(|j| row.values[*j]).collect()).collect();
    let labels: Vec<String> = rows.iter().map(FeatureRow::label).collect();
    fit_labelled(names, &labels, &values, params.ridge)
        .map_err(|e| e.within("cannot fit the reference").hint("add real rasters, or shorten the list `features`"))
}

fn log(model: &Acceptance, level: f64, context: &Context) {
    let all = &model.groups["all"];
    if !all.constant.is_empty() {
        context.warn(format!(
            "the same in all references: {}; a raster that departs from that value is punished for it",
            all.constant.join(", ")
        ));
    }
    warn_of_lone_references(model, all, context);
    if let Some(text) = chain::warning(&model.labels) {
        context.note(text);
    }
    let threshold = quantile(&all.reference_d2, level).unwrap_or(f64::NAN);
    let share = share_below(&all.leave_one_out_d2, threshold);
    context.metric("threshold", threshold, "1");
    context.metric("perfect_acceptance_leave_one_out", share, "1");
    context.note(format!(
        "{} features of {} rasters; D2 <= {threshold:.1} at the {} % quantile; fitted without itself, a reference raster \
         is accepted in {:.0} % of cases",
        all.features.len(),
        model.references,
        100.0 * level,
        100.0 * share
    ));
}

/// Share of models of normal features in which a reference would be said to stand alone.
const FALSE_ALARMS: f64 = 0.05;
/// Share of the largest possible D2 above which a reference is close to it.
const CLOSE: f64 = 0.9;

/// Names the references whose D2 is beyond that of any normal one; when many are close to the bound, none stands alone and there are too few of them.
fn warn_of_lone_references(model: &Acceptance, all: &GroupModel, context: &Context) {
    let limit = bound(model.references);
    let close = all.reference_d2.iter().filter(|d2| **d2 > CLOSE * limit).count();
    if 4 * close > model.references {
        context.warn(format!(
            "{} references are too few for {} features: {close} of them have a D2 close to the largest possible {limit:.1}; \
             shorten `features` or add rasters",
            model.references,
            all.features.len(),
        ));
        return;
    }
    let alone = limit * largest_usual_share(model.references, all.features.len());
    let lone = model.labels.iter().zip(&all.reference_d2).filter(|(_, d2)| **d2 > alone.max(CLOSE * limit));
    for (label, d2) in lone {
        context.warn(format!(
            "`{label}` has D2 = {d2:.1}, close to the largest possible {limit:.1}: it stands alone and stretches the \
             acceptance region by itself; look at it, and fit once without it"
        ));
    }
}

/// The largest D2 of `n` normal references with `p` features as a share of the bound, exceeded by chance in one model of twenty: D2 over its bound has a beta
/// distribution (Gnanadesikan and Kettenring 1972).
fn largest_usual_share(n: usize, p: usize) -> f64 {
    if p == 0 || n < p + 2 {
        return 1.0;
    }
    beta::quantile(0.5 * p as f64, 0.5 * (n - p - 1) as f64, 1.0 - FALSE_ALARMS / n as f64)
}

fn summary(model: &Acceptance, level: f64) -> Table {
    let mut table = Table::new([
        "group",
        "n",
        "p",
        "quantile",
        "threshold",
        "d2_q50",
        "d2_q90",
        "d2_q95",
        "d2_q99",
        "d2_bound",
        "leave_one_out_threshold",
        "leave_one_out_q95",
        "leave_one_out_below_q95",
        "perfect_acceptance_normal",
        "perfect_acceptance_leave_one_out",
        "eigenvalue_largest",
        "eigenvalue_smallest",
        "constant",
    ]);
    let first = std::iter::once("all").chain(GROUPS.map(|(group, _)| group));
    for (name, group) in first.filter_map(|name| Some((name, model.groups.get(name)?))) {
        table.push(summary_row(name, group, model.references, level));
    }
    table
}

fn summary_row(name: &str, group: &GroupModel, n: usize, level: f64) -> Vec<Cell> {
    let p = group.features.len();
    let inside = |q: f64| quantile(&group.reference_d2, q).unwrap_or(f64::NAN);
    let number = |x: f64| Cell::from(x);
    let mut row = vec![name.into(), number(n as f64), number(p as f64), number(level), number(inside(level))];
    row.extend([0.50, 0.90, 0.95, 0.99].map(|q| number(inside(q))));
    row.push(number(bound(n)));
    row.extend([level, 0.95].map(|q| number(leave_one_out_quantile(group, q).unwrap_or(f64::NAN))));
    row.push(number(share_below(&group.leave_one_out_d2, inside(0.95))));
    row.push(number(perfect_acceptance(n, p, level).unwrap_or(f64::NAN)));
    row.push(number(share_below(&group.leave_one_out_d2, inside(level))));
    row.push(number(group.eigenvalues.first().copied().unwrap_or(f64::NAN)));
    row.push(number(group.eigenvalues.last().copied().unwrap_or(f64::NAN)));
    row.push(group.constant.join(" ").into());
    row
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::{Artefact, Noun};
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{TestHost, run_stage};

    /// Features of 30 made-up rasters.
    fn features() -> Table {
        let mut table = Table::new(std::iter::once("raster").chain(feature_names()));
        let field = Key([9; 32]).field();
        for i in 0..30 {
            let values = (0..10).map(|j| Cell::from(2.0 + field.normal(i, j)));
            table.push(std::iter::once(Cell::from(format!("r{i}"))).chain(values).collect());
        }
        table
    }

    fn fitted(table: Table, with: &Value) -> Result<(Acceptance, Table, TestHost), StageError> {
        let host = TestHost::default();
        let outputs = run_stage::<FitAcceptance>(&host, with, &[("features", table.into())])?.into_inner();
        let [Artefact::Acceptance(model), Artefact::Table(summary)] = [&outputs["model"], &outputs["summary"]] else {
            panic!("a model and a table come out");
        };
        Ok((model.clone(), summary.clone(), host))
    }

    fn at(summary: &Table, row: usize, column: &str) -> f64 {
        summary.rows[row][summary.column(column).unwrap()].number().unwrap()
    }

    #[test]
    fn rasters_that_are_there_twice_are_told() {
        let mut table = features();
        for (copy, original) in [(7, 2), (20, 2), (21, 13)] {
            let values = table.rows[original][1..].to_vec();
            table.rows[copy].splice(1.., values);
        }
        let (_, _, host) = fitted(table, &json!({})).unwrap();
        let told = |text: &String| text.contains("3 of 30") && text.contains("`r7` those of `r2`");
        assert!(host.warnings().iter().any(told), "{:?}", host.warnings());
        let (_, _, host) = fitted(features(), &json!({})).unwrap();
        assert!(!host.warnings().iter().any(|text| text.contains("those of")));
    }

    #[test]
    fn one_or_two_equal_features_are_no_copy() {
        let mut table = features();
        let nugget = table.column("nugget_m2").unwrap();
        table.rows.iter_mut().take(8).for_each(|row| row[nugget] = 0.0.into());
        let (_, _, host) = fitted(table, &json!({"features": ["nugget_m2"]})).unwrap();
        assert!(!host.warnings().iter().any(|text| text.contains("those of")), "{:?}", host.warnings());
    }

    #[test]
    fn each_group_has_a_model_and_a_row_and_the_model_comes_back() {
        let (model, summary, _) = fitted(features(), &json!({})).unwrap();
        assert_eq!(model.groups.keys().collect::<Vec<_>>(), ["all", "marginal", "roughness", "spectrum", "variogram"]);
        let names: Vec<_> = summary.rows.iter().map(|row| row[0].text().unwrap()).collect();
        assert_eq!(names, ["all", "marginal", "variogram", "spectrum", "roughness"]);
        assert_eq!((at(&summary, 0, "p"), at(&summary, 2, "p"), at(&summary, 3, "n")), (10.0, 3.0, 30.0));
        assert_eq!(Acceptance::decode(&model.encode().unwrap()).unwrap(), model);
    }

    #[test]
    fn a_constant_feature_is_set_aside_and_named() {
        let mut table = features();
        let nugget = table.column("nugget_m2").unwrap();
        table.rows.iter_mut().for_each(|row| row[nugget] = 0.0.into());
        let (model, _, host) = fitted(table, &json!({})).unwrap();
        assert_eq!(model.groups["all"].constant, ["nugget_m2"]);
        assert_eq!(model.groups["variogram"].features, ["sill_m2", "range95_m"]);
        assert!(host.warnings()[0].contains("nugget_m2"));
    }

    #[test]
    fn a_raster_far_from_the_others_is_warned_of_by_name() {
        let mut table = features();
        table.rows[4][2] = 1e4.into();
        let (_, _, host) = fitted(table, &json!({})).unwrap();
        assert!(host.warnings().iter().any(|warning| warning.contains("`r4`")), "{:?}", host.warnings());
    }

    #[test]
    fn what_chance_makes_the_most_extreme_does_not_stand_alone() {
        let mut table = features();
        let alarms = (0..10).filter(|_| {
            table.rows.rotate_left(2);
            let mut some = table.clone();
            some.rows.truncate(18);
            !fitted(some, &json!({})).unwrap().2.warnings().is_empty()
        });
        assert!(alarms.count() <= 2);
        assert!((largest_usual_share(40, 1) - 0.2424).abs() < 1e-4 && largest_usual_share(13, 9) > 0.99);
    }

    #[test]
    fn too_few_references_are_warned_of_once() {
        let mut table = features();
        table.rows.truncate(12);
        let (model, _, host) = fitted(table, &json!({})).unwrap();
        assert!(model.groups["all"].reference_d2.iter().filter(|d2| **d2 > 0.9 * bound(12)).count() > 3);
        let warnings = host.warnings();
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("12 references are too few for 10 features"), "{warnings:?}");
    }

    #[test]
    fn what_is_missing_is_named() {
        let mut gap = features();
        gap.rows[7][3] = f64::NAN.into();
        let error = fitted(gap, &json!({})).err().unwrap();
        assert!(error.message.contains("`r7`") && error.message.contains("`skewness`"), "{error}");
        assert!(
            fitted(features(), &json!({"features": ["std_m", "height"]})).err().unwrap().message.contains("`height`")
        );
        let mut few = features();
        few.rows.truncate(11);
        assert!(fitted(few.clone(), &json!({})).err().unwrap().message.contains("at least 12"));
        // Or fewer features are taken, with a warning.
        let (model, _, host) = fitted(few, &json!({"fewer": true})).unwrap();
        assert_eq!(model.groups["all"].features.len(), 5);
        assert!(host.warnings()[0].contains("only std_m, skewness, range95_m"), "{:?}", host.warnings());
    }

    #[test]
    fn a_list_without_features_or_with_twins_is_refused() {
        use rockface_core::AnyStage;
        let row = rockface_core::Row::<FitAcceptance>::new();
        assert!(row.check(&json!({"features": []})).unwrap_err()[0].message.contains("at least one"));
        assert!(row.check(&json!({"features": ["a", "b", "a"]})).unwrap_err()[0].message.contains("`a`"));
    }

    /// Features of 39 real rasters by an independent implementation.
    fn real_features() -> Option<Table> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/outcrop-survey/features.csv");
        let Ok(csv) = std::fs::read(path) else {
            eprintln!("skipped: {path} is not there");
            return None;
        };
        let mut reader = csv::Reader::from_reader(csv.as_slice());
        let mut table = Table::new(std::iter::once("raster").chain(feature_names()));
        for record in reader.records().map(Result::unwrap) {
            let numbers = record.iter().skip(1).take(10).map(|text| Cell::from(text.parse::<f64>().unwrap()));
            table.push(std::iter::once(Cell::from(&record[0])).chain(numbers).collect());
        }
        Some(table)
    }

    #[test]
    fn distances_of_39_real_rasters_are_the_published_ones() {
        let Some(table) = real_features() else { return };
        let nugget = table.column("nugget_m2").unwrap();
        assert_eq!(table.rows.iter().filter(|row| row[nugget].number() == Some(0.0)).count(), 24);
        let (_, summary, _) = fitted(table, &json!({"ridge": 0.0})).unwrap();
        for (column, expected) in
            [("d2_q50", 8.3), ("d2_q90", 17.3), ("d2_q95", 19.2), ("d2_q99", 31.8), ("d2_bound", 37.0)]
        {
            assert!((at(&summary, 0, column) - expected).abs() < 0.06, "{column} {}", at(&summary, 0, column));
        }
        assert!((at(&summary, 0, "leave_one_out_below_q95") - 0.77).abs() < 0.005);
        assert!((at(&summary, 0, "perfect_acceptance_normal") - 0.67).abs() < 0.01);
    }
}
