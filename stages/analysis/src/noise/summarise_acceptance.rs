//! `summarise-acceptance`: how many rasters pass the test at each quantile, with intervals and with what may be expected.

use crate::noise::acceptance_rate::{perfect_acceptance, share_below};
use crate::noise::chain;
use crate::noise::descriptors::{GROUPS, feature_names, in_group, taken};
use crate::noise::mahalanobis::{bound, distance, fit_labelled, leave_one_out_quantile};
use crate::noise::perfect_simulator::{Expectation, Setting, Simulated};
use crate::noise::tested;
use crate::noise::tested::Role;
use rockface_core::artefact::{Cell, GroupModel, Kind, Table};
use rockface_core::numerics::held_out::in_view;
use rockface_core::numerics::proportion::{exact_interval, wilson_interval};
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params, table_row};
use rockface_raster::feature_rows::{FeatureRow, feature_rows};

params! {
    /// Parameters of `summarise-acceptance`.
    pub struct SummariseAcceptanceParams {
        /// Columns that make the feature vector.
        features: Vec<String> = feature_names().into_iter().map(str::to_owned).collect(),
        /// With too few references for all features (two more are needed), take one feature for two references, those that say most first
        /// (`std_m`, `roughness_b`, `skewness`, `range95_m`, `spectral_slope`), and warn. `false`: refuse.
        fewer: bool = false,
        /// Ridge factor lambda, added to the diagonal of the covariance of the standardised features.
        ridge: f64 = 1e-3; Range::NonNegative,
        /// Quantiles of the reference distances.
        quantiles: Vec<f64> = vec![0.90, 0.95, 0.99]; Range::Between(0.5, 1.0),
        /// Share of the reference rasters, the last ones, that is held out: the model is fitted to the others and judges these
        /// too. 0.3333 with a calibration that saw the first two thirds only. Left out: none.
        held_out: Option<f64> = None; Range::Between(0.0, 0.9),
    }
}

/// Tests simulated rasters against real ones at several quantiles, jointly and by descriptor group.
pub struct SummariseAcceptance;

impl Stage for SummariseAcceptance {
    type Params = SummariseAcceptanceParams;
    const NAME: &'static str = "summarise-acceptance";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("summarise_acceptance.md"));
    const INPUTS: &'static [Port] = &[
        Port::many("reference", &[Kind::Table], "Features of real rasters, from `describe-noise`."),
        Port::many("simulated", &[Kind::Table], "Features of simulated rasters, from `describe-noise`."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("rates", &[Kind::Table], "One row a quantile and group: counts, shares, intervals, expectations."),
        Port::one("table_a1", &[Kind::Table], "One row a quantile, laid out as the paper's Table A1."),
        Port::one("leverage", &[Kind::Table], "One row a reference raster: distances, and the test without it."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let empty = |name: &str, is_empty: bool| {
            let mut fault = Fault::new("at least one is needed");
            fault.path = vec![name.to_owned()];
            is_empty.then_some(fault)
        };
        let faults = [empty("features", params.features.is_empty()), empty("quantiles", params.quantiles.is_empty())];
        faults.into_iter().flatten().collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let references = inputs.many::<Table>("reference")?.iter().map(|(_, table)| table.rows.len()).sum();
        let kept = in_view(references, params.held_out.unwrap_or(0.0));
        let (features, warning) = taken(&params.features, kept, params.fewer);
        if let Some(text) = warning {
            context.warn(text);
        }
        let params = &SummariseAcceptanceParams { features, ..params.clone() };
        let rows = |port: &str| -> Result<Vec<FeatureRow>, StageError> {
            feature_rows(&inputs.many::<Table>(port)?, &params.features)
        };
        let (mut reference, simulated) = (rows("reference")?, rows("simulated")?);
        if simulated.is_empty() {
            fail!("`simulated` has no rows: there is nothing to test");
        }
        let labels: Vec<String> = reference.iter().map(FeatureRow::label).collect();
        if let Some(text) = chain::warning(&labels) {
            context.warn(text);
        }
        let held_out = reference.split_off(kept);
        let other = tested::other_extent(&inputs.many::<Table>("reference")?, &inputs.many::<Table>("simulated")?);
        let copies = [tested::copies(&reference, Role::Reference), tested::copies(&simulated, Role::Simulated)];
        copies.into_iter().flatten().chain(other).for_each(|text| context.warn(text));
        let mut tests = group_tests(params, &reference, &simulated, &held_out)?;
        simulate_perfect(params, &mut tests);
        let leverage = leverage(params, &reference, &simulated, &tests[0])?;
        log(&tests[0], params, context);
        Ok(Outputs::of("rates", rates(&tests, &params.quantiles))
            .and("table_a1", table_a1(&tests, &params.quantiles))
            .and("leverage", leverage))
    }
}

/// One group of features: its model, and the distances of what is tested.
struct GroupTest {
    name: &'static str,
    model: GroupModel,
    simulated_d2: Vec<f64>,
    held_out_d2: Vec<f64>,
    /// Tests of a perfect simulator at the quantiles of the parameters; drawn for the groups of the rates only.
    perfect: Option<Simulated>,
}

/// Draws what a perfect simulator would have in every group.
fn simulate_perfect(params: &SummariseAcceptanceParams, tests: &mut [GroupTest]) {
    let all = tests[0].model.clone();
    for test in tests {
        let setting = Setting::of(&test.model, &all, params.ridge, test.simulated_d2.len());
        test.perfect = Some(setting.simulate(&params.quantiles));
    }
}

impl GroupTest {
    fn threshold(&self, level: f64) -> f64 {
        quantile(&self.model.reference_d2, level).unwrap_or(f64::NAN)
    }

    /// The share of references that a model of all others accepts.
    fn leave_one_out_share(&self, level: f64) -> f64 {
        share_below(&self.model.leave_one_out_d2, self.threshold(level))
    }

    /// What a perfect simulator would have at the quantile of number `at`.
    fn expected(&self, at: usize, level: f64) -> Option<Expectation> {
        let share = self.leave_one_out_share(level);
        self.perfect.as_ref().map(|perfect| perfect.expectation(at, share, &self.model.reference_d2))
    }
}

fn accepted(d2: &[f64], threshold: f64) -> usize {
    d2.iter().filter(|d2| **d2 <= threshold).count()
}

/// The joint test first, then the groups that have a feature which varies.
fn group_tests(
    params: &SummariseAcceptanceParams,
    reference: &[FeatureRow],
    simulated: &[FeatureRow],
    held_out: &[FeatureRow],
) -> Result<Vec<GroupTest>, StageError> {
    let every: Vec<usize> = (0..params.features.len()).collect();
    let mut tests = vec![group_test("all", &every, params, [reference, simulated, held_out])?];
    for (name, _) in GROUPS {
        let columns: Vec<usize> = every.iter().copied().filter(|j| in_group(name, &params.features[*j])).collect();
        let varies = columns.iter().any(|j| tests[0].model.features.contains(&params.features[*j]));
        if varies {
            tests.push(group_test(name, &columns, params, [reference, simulated, held_out])?);
        }
    }
    Ok(tests)
}

fn group_test(
    name: &'static str,
    columns: &[usize],
    params: &SummariseAcceptanceParams,
    [reference, simulated, held_out]: [&[FeatureRow]; 3],
) -> Result<GroupTest, StageError> {
    let names: Vec<String> = columns.iter().map(|j| params.features[*j].clone()).collect();
    let pick = |row: &FeatureRow| columns.iter().map(|j| row.values[*j]).collect::<Vec<f64>>();
    let rows: Vec<Vec<f64>> = reference.iter().map(pick).collect();
    let labels: Vec<String> = reference.iter().map(FeatureRow::label).collect();
    let model = fit_labelled(&names, &labels, &rows, params.ridge).map_err(|e| {
        e.within(format!("cannot fit group `{name}`"))
            .hint("add real rasters, hold fewer out, or shorten the list `features`")
    })?;
    let judged = model.judged();
    let place = |name: &String| columns.iter().copied().find(|j| params.features[*j] == *name);
    let judged: Vec<usize> = judged.iter().filter_map(place).collect();
    let d2 = |row: &FeatureRow| distance(&model, &judged.iter().map(|j| row.values[*j]).collect::<Vec<f64>>()).d2;
    let (simulated_d2, held_out_d2) = (simulated.iter().map(d2).collect(), held_out.iter().map(d2).collect());
    Ok(GroupTest { name, model, simulated_d2, held_out_d2, perfect: None })
}

table_row! {
    /// The acceptance of one group of features at one quantile.
    struct Rate {
        group: &'static str,
        p: usize,
        quantile: f64,
        threshold: f64,
        real_accepted: usize,
        real_n: usize,
        real_share: f64,
        simulated_accepted: usize,
        simulated_n: usize,
        simulated_share: f64,
        wilson_low: f64,
        wilson_high: f64,
        exact_low: f64,
        exact_high: f64,
        expected: Option<f64>,
        expected_leave_one_out: f64,
        expected_normal: Option<f64>,
        expected_low: Option<usize>,
        expected_high: Option<usize>,
        in_band: Option<bool>,
        leave_one_out_threshold: f64,
        simulated_leave_one_out: f64,
        simulated_median_d2: Option<f64>,
        expected_median_low: Option<f64>,
        expected_median_high: Option<f64>,
        held_out_accepted: Option<usize>,
        held_out_n: Option<usize>,
        held_out_exact_low: Option<f64>,
        held_out_exact_high: Option<f64>,
    }
}

fn rates(tests: &[GroupTest], levels: &[f64]) -> Table {
    let levels = levels.iter().enumerate();
    levels.flat_map(|(at, level)| tests.iter().map(move |test| rate(test, at, *level))).collect()
}

fn rate(test: &GroupTest, at: usize, level: f64) -> Rate {
    let (model, threshold) = (&test.model, test.threshold(level));
    let (n, p) = (model.reference_d2.len(), model.features.len());
    let real = accepted(&model.reference_d2, threshold);
    let (simulated, total) = (accepted(&test.simulated_d2, threshold), test.simulated_d2.len());
    let (wilson, exact) = (wilson_interval(simulated, total), exact_interval(simulated, total));
    let expected = test.expected(at, level);
    let leave_one_out = leave_one_out_quantile(model, level).unwrap_or(f64::NAN);
    let held_out =
        Some(test.held_out_d2.len()).filter(|of| *of > 0).map(|of| (accepted(&test.held_out_d2, threshold), of));
    let held_out_exact = held_out.map(|(held, of)| exact_interval(held, of));
    Rate {
        group: test.name,
        p,
        quantile: level,
        threshold,
        real_accepted: real,
        real_n: n,
        real_share: real as f64 / n as f64,
        simulated_accepted: simulated,
        simulated_n: total,
        simulated_share: simulated as f64 / total as f64,
        wilson_low: wilson.0,
        wilson_high: wilson.1,
        exact_low: exact.0,
        exact_high: exact.1,
        expected: expected.map(|of| of.share),
        expected_leave_one_out: test.leave_one_out_share(level),
        expected_normal: perfect_acceptance(n, p, level),
        expected_low: expected.map(|of| of.low),
        expected_high: expected.map(|of| of.high),
        in_band: expected.map(|of| of.holds(simulated)),
        leave_one_out_threshold: leave_one_out,
        simulated_leave_one_out: share_below(&test.simulated_d2, leave_one_out),
        simulated_median_d2: quantile(&test.simulated_d2, 0.5),
        expected_median_low: expected.and_then(|of| of.median_d2).map(|[low, _]| low),
        expected_median_high: expected.and_then(|of| of.median_d2).map(|[_, high]| high),
        held_out_accepted: held_out.map(|(held, _)| held),
        held_out_n: held_out.map(|(_, of)| of),
        held_out_exact_low: held_out_exact.map(|(low, _)| low),
        held_out_exact_high: held_out_exact.map(|(_, high)| high),
    }
}

/// `89.7% (35/39)`, as the paper prints it.
fn printed(accepted: usize, n: usize) -> Cell {
    let percent = (1000.0 * accepted as f64 / n as f64).round() / 10.0;
    Cell::from(format!("{percent}% ({accepted}/{n})"))
}

fn table_a1(tests: &[GroupTest], levels: &[f64]) -> Table {
    let groups = tests[1..].iter().map(|test| format!("{} (simulation)", test.name));
    let first = ["acceptance quantile", "D2 threshold", "real acceptance", "simulated acceptance"];
    let mut table = Table::new(first.map(str::to_owned).into_iter().chain(groups));
    for level in levels {
        let all = &tests[0];
        let threshold = all.threshold(*level);
        let simulated =
            |test: &GroupTest| printed(accepted(&test.simulated_d2, test.threshold(*level)), test.simulated_d2.len());
        let mut row = vec![
            Cell::from(format!("{}%", (level * 1000.0).round() / 10.0)),
            Cell::from((threshold * 10.0).round() / 10.0),
            printed(accepted(&all.model.reference_d2, threshold), all.model.reference_d2.len()),
        ];
        row.extend(tests.iter().map(simulated));
        table.push(row);
    }
    table
}

fn middle(levels: &[f64]) -> f64 {
    levels[levels.len() / 2]
}

table_row! {
    /// How much hangs on one reference raster.
    struct Leverage {
        raster: String,
        d2: f64,
        share_of_bound: f64,
        leave_one_out_d2: Option<f64>,
        threshold_without: Option<f64>,
        simulated_share_without: Option<f64>,
        shares_epoch_with: String,
    }
}

fn leverage(
    params: &SummariseAcceptanceParams,
    reference: &[FeatureRow],
    simulated: &[FeatureRow],
    all: &GroupTest,
) -> Result<Table, StageError> {
    let level = middle(&params.quantiles);
    let labels: Vec<String> = reference.iter().map(FeatureRow::label).collect();
    let neighbours = chain::neighbours(&labels);
    let every: Vec<usize> = (0..params.features.len()).collect();
    let enough = reference.len() > all.model.features.len() + 2;
    let row = |(i, label): (usize, &String)| -> Result<Leverage, StageError> {
        let d2 = all.model.reference_d2[i];
        let mut others = reference.to_vec();
        others.remove(i);
        let without = if enough { Some(group_test("all", &every, params, [&others, simulated, &[]])?) } else { None };
        let share = |test: &GroupTest| share_below(&test.simulated_d2, test.threshold(level));
        let near: Vec<&str> = neighbours[i].iter().map(|j| labels[*j].as_str()).collect();
        Ok(Leverage {
            raster: label.clone(),
            d2,
            share_of_bound: d2 / bound(reference.len()),
            leave_one_out_d2: Some(all.model.leave_one_out_d2[i]).filter(|d2| *d2 < 1e300),
            threshold_without: without.as_ref().map(|test| test.threshold(level)),
            simulated_share_without: without.as_ref().map(share),
            shares_epoch_with: near.join(" "),
        })
    };
    labels.iter().enumerate().map(row).collect()
}

fn log(all: &GroupTest, params: &SummariseAcceptanceParams, context: &Context) {
    if !all.model.constant.is_empty() {
        context.warn(format!(
            "the same in all references: {}; a raster that departs from that value is punished for it",
            all.model.constant.join(", ")
        ));
    }
    let (at, level) = (params.quantiles.len() / 2, middle(&params.quantiles));
    let (n, threshold) = (all.simulated_d2.len(), all.threshold(level));
    let found = accepted(&all.simulated_d2, threshold);
    let Some(expected) = all.expected(at, level) else { return };
    let (references, features) = (all.model.reference_d2.len(), all.model.judged().len());
    let known = tested::references(&all.simulated_d2, &all.model.reference_d2);
    let weak = tested::weak(&expected, n, references, features);
    let far_off = tested::far_off(&expected, found, &all.simulated_d2);
    [known, weak, far_off].into_iter().flatten().for_each(|text| context.warn(text));
    context.metric("acceptance", found as f64 / n as f64, "1");
    context.metric("median_d2", quantile(&all.simulated_d2, 0.5).unwrap_or(f64::NAN), "1");
    if !all.held_out_d2.is_empty() {
        let share = share_below(&all.held_out_d2, threshold);
        context.metric("held_out_acceptance", share, "1");
    }
    context.headline(format!(
        "accepted {found} of {n} at the {} % quantile (D2 <= {threshold:.1}); {}",
        (level * 1000.0).round() / 10.0,
        tested::range(&expected, n)
    ));
}

#[cfg(test)]
mod tests;
