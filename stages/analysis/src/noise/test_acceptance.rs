//! `test-acceptance`: says which rasters are compatible with the reference noise, and why the others are not.

use crate::noise::acceptance_rate::{perfect_acceptance, score, share_below};
use crate::noise::descriptors::GROUPS;
use crate::noise::mahalanobis::{Distance, distance, leave_one_out_quantile};
use crate::noise::perfect_simulator::{Expectation, Setting};
use crate::noise::tested;
use crate::noise::tested::Role;
use rockface_core::artefact::{Acceptance, Cell, GroupModel, Kind, Table, TableRow};
use rockface_core::numerics::proportion::wilson_interval;
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params, table_row};
use rockface_raster::feature_rows::{FeatureRow, axes, feature_rows, item_cell};

params! {
    /// Parameters of `test-acceptance`.
    pub struct TestAcceptanceParams {
        /// Quantile of the reference distances up to which a raster is accepted.
        quantile: f64 = 0.95; Range::Between(0.5, 1.0),
    }
}

/// Accepts or rejects each raster by its distance to the reference.
pub struct TestAcceptance;

/// Quantiles of the sensitivity table (paper, Table A1).
const LEVELS: [f64; 3] = [0.90, 0.95, 0.99];

impl Stage for TestAcceptance {
    type Params = TestAcceptanceParams;
    const NAME: &'static str = "test-acceptance";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("test_acceptance.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("model", &[Kind::Acceptance], "The reference, from `fit-acceptance`."),
        Port::many("features", &[Kind::Table], "Features of the rasters to test, from `describe-noise`."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("verdicts", &[Kind::Table], "One row a raster: items, D2, verdict, score, groups, contributions."),
        Port::one("summary", &[Kind::Table], "One row a quantile, as Table A1, with intervals and expectations."),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let model = inputs.one::<Acceptance>("model")?;
        let tables = inputs.many::<Table>("features")?;
        let tests = group_tests(model, params.quantile)?;
        let all = &tests[0];
        let rows = feature_rows(&tables, &all.judged)?;
        if rows.is_empty() {
            fail!("the feature tables have no rows: there is nothing to test");
        }
        if let Some(text) = tested::copies(&rows, Role::Simulated) {
            context.warn(text);
        }
        let distances: Vec<Vec<Distance>> = tests.iter().map(|test| test.distances(all, &rows)).collect();
        let verdicts = verdicts(&tests, &rows, &distances)?;
        let levels = levels(params.quantile);
        let expected = expectations(all.model, model.ridge, &levels, rows.len());
        log(all, &distances[0], params.quantile, &levels, &expected, context);
        Ok(Outputs::of("verdicts", verdicts).and("summary", summary(&tests, &distances, &levels, &expected)))
    }
}

/// One group with its threshold.
struct GroupTest<'a> {
    name: &'static str,
    model: &'a GroupModel,
    /// Features in the order of the contributions.
    judged: Vec<String>,
    threshold: f64,
}

impl GroupTest<'_> {
    /// Distances of all rows; their values are in the order of what `all` judges.
    fn distances(&self, all: &Self, rows: &[FeatureRow]) -> Vec<Distance> {
        let position = |name: &String| all.judged.iter().position(|feature| feature == name);
        let columns: Vec<usize> = self.judged.iter().filter_map(position).collect();
        let values = |row: &FeatureRow| columns.iter().map(|j| row.values[*j]).collect::<Vec<f64>>();
        rows.iter().map(|row| distance(self.model, &values(row))).collect()
    }

    fn accepted(&self, distances: &[Distance], level: f64) -> usize {
        let threshold = threshold(self.model, level);
        distances.iter().filter(|found| found.d2 <= threshold).count()
    }
}

fn threshold(model: &GroupModel, level: f64) -> f64 {
    quantile(&model.reference_d2, level).unwrap_or(f64::NAN)
}

/// The joint model first, then the groups in the order of the feature vector.
fn group_tests(model: &Acceptance, level: f64) -> Result<Vec<GroupTest<'_>>, StageError> {
    let names = std::iter::once("all").chain(GROUPS.map(|(group, _)| group));
    let tests: Vec<GroupTest> = names
        .filter_map(|name| model.groups.get(name).map(|group| (name, group)))
        .map(|(name, model)| GroupTest { name, model, judged: model.judged(), threshold: threshold(model, level) })
        .collect();
    match tests.first() {
        Some(first) if first.name == "all" => Ok(tests),
        _ => Err(StageError::new("the acceptance model has no group `all`").hint("make it with `fit-acceptance`")),
    }
}

fn verdicts(tests: &[GroupTest], rows: &[FeatureRow], distances: &[Vec<Distance>]) -> Result<Table, StageError> {
    let axes = axes(rows.iter().map(|row| &row.items));
    let own = own_columns(tests);
    if let Some(axis) = axes.iter().find(|axis| own.contains(axis)) {
        return Err(StageError::new(format!("an axis is called `{axis}` like a column of the verdicts"))
            .hint("give the axis another name"));
    }
    let mut table = Table::new(axes.iter().cloned().chain(own));
    for (index, row) in rows.iter().enumerate() {
        let found: Vec<&Distance> = distances.iter().map(|group| &group[index]).collect();
        let items = axes.iter().map(|axis| item_cell(&row.items, axis));
        table.push(items.chain(verdict(tests, row, &found)).collect());
    }
    Ok(table)
}

fn own_columns(tests: &[GroupTest]) -> Vec<String> {
    let mut columns = ["raster", "d2", "threshold", "accepted", "score", "top_feature"].map(str::to_owned).to_vec();
    for test in &tests[1..] {
        columns.extend(["d2", "accepted", "score"].map(|what| format!("{what}_{}", test.name)));
    }
    columns.extend(tests[0].judged.iter().map(|feature| format!("contribution_{feature}")));
    columns
}

fn verdict(tests: &[GroupTest], row: &FeatureRow, found: &[&Distance]) -> Vec<Cell> {
    let (all, d2) = (&tests[0], found[0].d2);
    let mut cells = vec![row.raster.as_str().into(), d2.into(), all.threshold.into(), (d2 <= all.threshold).into()];
    cells.push(score(&all.model.reference_d2, d2).into());
    cells.push(top_feature(&all.judged, found[0]).into());
    for (test, found) in tests.iter().zip(found).skip(1) {
        let score = score(&test.model.reference_d2, found.d2);
        cells.extend([found.d2.into(), (found.d2 <= test.threshold).into(), score.into()]);
    }
    cells.extend(found[0].contributions.iter().map(|c| Cell::from(*c)));
    cells
}

/// The feature with the largest contribution; the first of equal ones.
fn top_feature<'a>(judged: &'a [String], found: &Distance) -> &'a str {
    let mut top = 0;
    for (j, contribution) in found.contributions.iter().enumerate() {
        if *contribution > found.contributions[top] {
            top = j;
        }
    }
    &judged[top]
}

table_row! {
    /// The joint test at one quantile; the acceptance of each group follows.
    struct Summary {
        quantile: f64,
        threshold: f64,
        real_accepted: usize,
        real_n: usize,
        real_acceptance: f64,
        simulated_accepted: usize,
        simulated_n: usize,
        simulated_acceptance: f64,
        simulated_low95: f64,
        simulated_high95: f64,
        leave_one_out_threshold: Option<f64>,
        perfect_acceptance_normal: Option<f64>,
        perfect_acceptance_leave_one_out: f64,
        expected_low: usize,
        expected_high: usize,
        in_band: bool,
        simulated_median_d2: Option<f64>,
        expected_median_low: Option<f64>,
        expected_median_high: Option<f64>,
    }
}

/// The quantiles of the paper and the one asked for.
fn levels(level: f64) -> Vec<f64> {
    let mut levels = LEVELS.to_vec();
    if !levels.contains(&level) {
        levels.push(level);
        levels.sort_by(f64::total_cmp);
    }
    levels
}

/// What a perfect simulator would have at each quantile.
fn expectations(model: &GroupModel, ridge: f64, levels: &[f64], trials: usize) -> Vec<Expectation> {
    let simulated = Setting::of(model, model, ridge, trials).simulate(levels);
    let share = |level: f64| share_below(&model.leave_one_out_d2, threshold(model, level));
    let levels = levels.iter().enumerate();
    levels.map(|(at, level)| simulated.expectation(at, share(*level), &model.reference_d2)).collect()
}

fn summary(tests: &[GroupTest], distances: &[Vec<Distance>], levels: &[f64], expected: &[Expectation]) -> Table {
    let groups = tests[1..].iter().map(|test| format!("simulated_acceptance_{}", test.name));
    let mut table = Table::new(Summary::columns().into_iter().chain(groups));
    for (level, expected) in levels.iter().zip(expected) {
        let share =
            |(test, found): (&GroupTest, &Vec<Distance>)| test.accepted(found, *level) as f64 / found.len() as f64;
        let groups = tests.iter().zip(distances).skip(1).map(share).map(Cell::from);
        table
            .push(summary_row(&tests[0], &distances[0], *level, *expected).cells().into_iter().chain(groups).collect());
    }
    table
}

fn summary_row(all: &GroupTest, distances: &[Distance], level: f64, expected: Expectation) -> Summary {
    let (real, n) = (&all.model.reference_d2, distances.len());
    let threshold = threshold(all.model, level);
    let accepted = all.accepted(distances, level);
    let (low, high) = wilson_interval(accepted, n);
    Summary {
        quantile: level,
        threshold,
        real_accepted: real.iter().filter(|d2| **d2 <= threshold).count(),
        real_n: real.len(),
        real_acceptance: share_below(real, threshold),
        simulated_accepted: accepted,
        simulated_n: n,
        simulated_acceptance: accepted as f64 / n as f64,
        simulated_low95: low,
        simulated_high95: high,
        leave_one_out_threshold: leave_one_out_quantile(all.model, level),
        perfect_acceptance_normal: perfect_acceptance(real.len(), all.model.features.len(), level),
        perfect_acceptance_leave_one_out: share_below(&all.model.leave_one_out_d2, threshold),
        expected_low: expected.low,
        expected_high: expected.high,
        in_band: expected.holds(accepted),
        simulated_median_d2: quantile(&distances.iter().map(|found| found.d2).collect::<Vec<_>>(), 0.5),
        expected_median_low: expected.median_d2.map(|[low, _]| low),
        expected_median_high: expected.median_d2.map(|[_, high]| high),
    }
}

fn log(
    all: &GroupTest,
    distances: &[Distance],
    level: f64,
    levels: &[f64],
    expected: &[Expectation],
    context: &Context,
) {
    let (n, accepted) = (distances.len(), all.accepted(distances, level));
    let share = share_below(&all.model.leave_one_out_d2, all.threshold);
    context.metric("acceptance", accepted as f64 / n as f64, "1");
    context.metric("perfect_acceptance_leave_one_out", share, "1");
    let led = distances.iter().filter(|found| top_feature(&all.judged, found) == "mean_m").count();
    if led > 0 {
        context.warn(format!(
            "`mean_m` is the largest contribution of {led} of {n} rasters: an offset between the epochs, not their noise, \
             decides; check how the real and the simulated epochs are registered, or leave `mean_m` out of the features of `fit-acceptance`"
        ));
    }
    let band = levels.iter().zip(expected).find(|(of, _)| of.total_cmp(&level).is_eq()).map(|(_, band)| band);
    let (references, features) = (all.model.reference_d2.len(), all.judged.len());
    let d2: Vec<f64> = distances.iter().map(|found| found.d2).collect();
    let known = tested::references(&d2, &all.model.reference_d2);
    let weak = band.and_then(|band| tested::weak(band, n, references, features));
    let far_off = band.and_then(|band| tested::far_off(band, accepted, &d2));
    [known, weak, far_off].into_iter().flatten().for_each(|text| context.warn(text));
    let band = band.map_or_else(String::new, |band| format!("; {}", tested::range(band, n)));
    context.headline(format!(
        "accepted {accepted} of {n} at the {} % quantile (D2 <= {:.1}){band}",
        (level * 1000.0).round() / 10.0,
        all.threshold,
    ));
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is exact must be exact")]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use super::*;
    use crate::noise::mahalanobis::fit;
    use rockface_core::Entry;
    use rockface_core::artefact::Artefact;
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::TestHost;

    const FEATURES: [&str; 3] = ["mean_m", "std_m", "spectral_slope"];

    fn rows(n: i32, seed: u8, shift: f64) -> Vec<Vec<f64>> {
        let field = Key([seed; 32]).field();
        (0..n).map(|i| (0..3).map(|j| field.normal(i, j) + if j == 0 { shift } else { 0.0 }).collect()).collect()
    }

    fn model(references: i32) -> Acceptance {
        let all = rows(references, 1, 0.0);
        let names = |columns: &[usize]| columns.iter().map(|j| FEATURES[*j].to_owned()).collect::<Vec<_>>();
        let group = |columns: &[usize]| {
            let values: Vec<Vec<f64>> = all.iter().map(|row| columns.iter().map(|j| row[*j]).collect()).collect();
            fit(&names(columns), &values, 1e-3).unwrap()
        };
        let groups = [("all", group(&[0, 1, 2])), ("marginal", group(&[0, 1])), ("spectrum", group(&[2]))];
        Acceptance {
            references: all.len(),
            ridge: 1e-3,
            labels: (0..references).map(|i| i.to_string()).collect(),
            groups: groups.into_iter().map(|(name, group)| (name.to_owned(), group)).collect(),
        }
    }

    fn tested(axis: &str, rows: &[Vec<f64>]) -> Result<(Table, Table, TestHost), StageError> {
        tested_by(model(40), axis, rows)
    }

    fn tested_by(model: Acceptance, axis: &str, rows: &[Vec<f64>]) -> Result<(Table, Table, TestHost), StageError> {
        let mut inputs = Inputs::default();
        inputs.push("model", BTreeMap::new(), Arc::new(model.into()));
        for (index, row) in rows.iter().enumerate() {
            let mut table = Table::new(["raster"].into_iter().chain(FEATURES));
            table.push(std::iter::once("d".into()).chain(row.iter().map(|x| Cell::from(*x))).collect());
            let point = BTreeMap::from([(axis.to_owned(), index.to_string())]);
            inputs.push("features", point, Arc::new(table.into()));
        }
        let host = TestHost::default();
        let params = TestAcceptanceParams::default();
        let outputs = TestAcceptance::run(&params, &inputs, &Context::new(&host))?.into_inner();
        let [Artefact::Table(verdicts), Artefact::Table(summary)] = [&outputs["verdicts"], &outputs["summary"]] else {
            panic!("two tables come out");
        };
        Ok((verdicts.clone(), summary.clone(), host))
    }

    fn number(table: &Table, row: usize, column: &str) -> f64 {
        table.rows[row][table.column(column).unwrap()].number().unwrap()
    }

    #[test]
    fn the_reference_itself_reproduces_its_own_shares() {
        let (verdicts, summary, host) = tested("replicate", &rows(40, 1, 0.0)).unwrap();
        assert!(host.warnings().iter().any(|text| text.starts_with("40 of 40 rasters are references of the model")));
        for (row, expected) in [(0, 36.0), (1, 38.0), (2, 39.0)] {
            assert_eq!(number(&summary, row, "real_accepted"), expected);
            assert_eq!(number(&summary, row, "simulated_accepted"), expected);
        }
        assert_eq!(verdicts.columns[..3], ["replicate", "raster", "d2"]);
        assert_eq!(number(&verdicts, 11, "replicate"), 11.0);
        let contributions: f64 = FEATURES.iter().map(|f| number(&verdicts, 5, &format!("contribution_{f}"))).sum();
        assert!((contributions - number(&verdicts, 5, "d2")).abs() < 1e-12);
    }

    #[test]
    fn an_offset_is_refused_and_named() {
        let (verdicts, summary, host) = tested("replicate", &rows(10, 2, 50.0)).unwrap();
        assert_eq!(number(&summary, 1, "simulated_acceptance"), 0.0);
        assert_eq!(number(&summary, 1, "simulated_acceptance_marginal"), 0.0);
        assert!(number(&summary, 1, "simulated_acceptance_spectrum") > 0.5);
        let column = |name: &str| verdicts.column(name).unwrap();
        assert!(verdicts.rows.iter().all(|row| row[column("top_feature")].text() == Some("mean_m")));
        assert!(verdicts.rows.iter().all(|row| row[column("score")].number() == Some(0.0)));
        assert!(host.warnings()[0].contains("10 of 10"));
        let entries = host.entries.lock().unwrap();
        let Some(Entry::Headline { text }) = entries.last() else { panic!("the headline comes last") };
        assert!(text.starts_with("accepted 0 of 10 at the 95 % quantile (D2 <= "), "{text}");
    }

    #[test]
    fn a_test_that_can_hardly_reject_says_so() {
        let warned = |references: i32| {
            let (_, summary, host) = tested_by(model(references), "replicate", &rows(20, 2, 0.0)).unwrap();
            let weak = host.warnings().into_iter().find(|text| text.contains("can hardly reject"));
            (number(&summary, 1, "expected_low"), weak)
        };
        let (low, weak) = warned(6);
        assert!(low < 2.5 && weak.unwrap().contains("6 references for 3 features"), "{low}");
        let few = tested_by(model(40), "replicate", &rows(1, 2, 0.0)).unwrap().2.warnings();
        assert!(!few.iter().any(|text| text.contains("can hardly reject")), "{few:?}");
        let (low, weak) = warned(40);
        assert!(low > 2.5 && weak.is_none(), "{low}");
    }

    #[test]
    fn an_axis_called_like_a_column_is_refused() {
        assert!(tested("score", &rows(2, 3, 0.0)).err().unwrap().message.contains("`score`"));
    }
}
