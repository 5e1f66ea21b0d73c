//! `propose-parameters`: the simulation parameters whose noise should be nearest to the real one, from a few simulations.

use crate::noise::mahalanobis::distance;
use crate::noise::moments::Surrogate;
use crate::noise::points::{ITEM, MOST_DIMENSIONS, Scale, coordinates, halton, positions, rounded};
use rockface_core::artefact::{Acceptance, Cell, GroupModel, Kind, Table};
use rockface_core::numerics::portable_math;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::feature_rows::feature_rows;

params! {
    /// Parameters of `propose-parameters`.
    pub struct ProposeParametersParams {
        /// Names of the searched parameters: columns of `features`, axes they were gathered over, or columns of `points`.
        parameters: Vec<String>,
        /// The group of features that is matched: `all`, or `variogram` for nugget, sill and range alone.
        group: String = "all".to_owned(),
        /// Whether features are linear in the parameters or in their logarithms.
        scale: Scale = Scale::Log,
        /// How far outside the range of the simulations the proposal may lie: a share of its width on either side.
        trust: f64 = 0.25; Range::NonNegative,
        /// How many points are proposed: the nearest, and others around it for the next round to learn from.
        count: usize = 1; Range::Between(1.0, 1e6),
        /// Reach of the others, as a share of the range of the simulations to either side.
        reach: f64 = 0.2; Range::Positive,
    }
}

/// The stage.
pub struct ProposeParameters;

impl Stage for ProposeParameters {
    type Params = ProposeParametersParams;
    const NAME: &'static str = "propose-parameters";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("propose_parameters.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("model", &[Kind::Acceptance], "The reference, from `fit-acceptance`."),
        Port::many(
            "features",
            &[Kind::Table],
            "Features of simulated rasters, gathered over the points of the search.",
        ),
        Port::optional("points", &[Kind::Table], "Where an axis of table rows was searched: that table."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one(
            "points",
            &[Kind::Table],
            "The proposal, and others around it: `item`, parameters, predicted D2, whether the proposal is at the edge.",
        ),
        Port::one("sensitivities", &[Kind::Table], "How each feature follows each parameter, with its standard error."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut fault = Fault::new(format!("name at least one parameter and at most {MOST_DIMENSIONS}"));
        fault.path = vec!["parameters".to_owned()];
        if (1..=MOST_DIMENSIONS).contains(&params.parameters.len()) { Vec::new() } else { vec![fault] }
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let model = inputs.one::<Acceptance>("model")?;
        let Some(group) = model.groups.get(&params.group) else {
            let known: Vec<&str> = model.groups.keys().map(String::as_str).collect();
            fail!("the model has no group `{}`; it has {}", params.group, known.join(", "));
        };
        let sample = Sample::gather(params, inputs, group)?;
        let Some(surrogate) = Surrogate::fit(&sample.positions, &sample.standardised, &sample.weights()) else {
            return Err(StageError::new(
                "the simulations do not vary in every parameter, or only in proportion to each other",
            )
            .hint("simulate at points that differ in each of `parameters` by itself"));
        };
        let (low, high) = sample.box_around(params.trust);
        let at = surrogate.nearest(&group.inverse, &low, &high);
        let edge = at.iter().zip(low.iter().zip(&high)).any(|(x, (l, h))| (x - l).abs().min((h - x).abs()) < 1e-9);
        let values: Vec<f64> = at.iter().map(|x| rounded(params.scale.to_value(*x))).collect();
        let predicted = quadratic(&group.inverse, &surrogate.features(&at));
        report(params, context, &sample, &values, predicted, edge);
        let sensitivities = sensitivities(params, group, &surrogate);
        let predict = |at: &[f64]| quadratic(&group.inverse, &surrogate.features(at));
        let points = proposal(
            params,
            &[at.clone()].into_iter().chain(around(params, &at, &low, &high)).collect::<Vec<_>>(),
            predict,
            edge,
        );
        Ok(Outputs::of("points", points).and("sensitivities", sensitivities))
    }
}

fn quadratic(inverse: &[Vec<f64>], z: &[f64]) -> f64 {
    let along = |row: &Vec<f64>| row.iter().zip(z).map(|(p, z)| p * z).sum::<f64>();
    inverse.iter().zip(z).map(|(row, z)| z * along(row)).sum()
}

/// Simulations: where they were made, on the scale of the search, and what came out.
struct Sample {
    positions: Vec<Vec<f64>>,
    standardised: Vec<Vec<f64>>,
    d2: Vec<f64>,
}

impl Sample {
    fn gather(params: &ProposeParametersParams, inputs: &Inputs, group: &GroupModel) -> Result<Self, StageError> {
        let points = inputs.optional::<Table>("points")?;
        let mut sample = Self { positions: Vec::new(), standardised: Vec::new(), d2: Vec::new() };
        for (items, table) in inputs.many::<Table>("features")? {
            let rows = feature_rows(&[(items, table)], &group.features).map_err(StageError::new)?;
            for (row, cells) in rows.iter().zip(&table.rows) {
                let values = coordinates(&params.parameters, items, table, cells, points).map_err(StageError::new)?;
                sample.positions.push(positions(params.scale, &params.parameters, &values)?);
                let z = |j: usize| (row.values[j] - group.mean[j]) / group.deviation[j];
                sample.standardised.push((0..row.values.len()).map(z).collect());
                sample.d2.push(distance(group, &row.values).d2);
            }
        }
        let least = params.parameters.len() + 2;
        if sample.d2.len() < least {
            fail!(
                "{} simulations are too few for {} parameters: {least} are needed",
                sample.d2.len(),
                params.parameters.len()
            );
        }
        Ok(sample)
    }

    /// Simulations near the reference count more: those well beyond the few nearest hardly at all, since features are not
    /// linear over the whole range.
    fn weights(&self) -> Vec<f64> {
        let few = 2 * (self.positions[0].len() + 1);
        let mut sorted = self.d2.clone();
        sorted.sort_by(f64::total_cmp);
        let near = sorted[(few - 1).min(sorted.len() - 1)].max(f64::MIN_POSITIVE);
        self.d2.iter().map(|d2| 1.0 / ((1.0 + d2 / near) * (1.0 + d2 / near))).collect()
    }

    /// The range of the simulations, widened on either side by a share of its width.
    fn box_around(&self, trust: f64) -> (Vec<f64>, Vec<f64>) {
        let range = |j: usize| {
            let all = self.positions.iter().map(|x| x[j]);
            let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
            (low - trust * (high - low), high + trust * (high - low))
        };
        (0..self.positions[0].len()).map(range).unzip()
    }
}

fn report(
    params: &ProposeParametersParams,
    context: &Context,
    sample: &Sample,
    values: &[f64],
    predicted: f64,
    edge: bool,
) {
    let named: Vec<String> =
        params.parameters.iter().zip(values).map(|(name, value)| format!("{name} {value}")).collect();
    let nearest = sample.d2.iter().copied().fold(f64::INFINITY, f64::min);
    context.metric("predicted_d2", predicted, "1");
    context.metric("nearest_d2", nearest, "1");
    if edge {
        context.warn("the proposal lies at the edge of the trusted range: simulate there and propose again");
    }
    context.headline(format!(
        "proposal from {} simulations: {}; mean features at D2 {predicted:.1}",
        sample.d2.len(),
        named.join(", ")
    ));
}

/// Further points around one, within the trusted range.
fn around(params: &ProposeParametersParams, at: &[f64], low: &[f64], high: &[f64]) -> Vec<Vec<f64>> {
    let coordinate = |k: usize, j: usize| {
        let width = (high[j] - low[j]) / (1.0 + 2.0 * params.trust);
        (at[j] + params.reach * width * (2.0 * halton(k as u64, j) - 1.0)).clamp(low[j], high[j])
    };
    (1..params.count).map(|k| (0..at.len()).map(|j| coordinate(k, j)).collect()).collect()
}

fn proposal(
    params: &ProposeParametersParams,
    points: &[Vec<f64>],
    predict: impl Fn(&[f64]) -> f64,
    edge: bool,
) -> Table {
    let own = ["predicted_d2", "at_edge"].map(str::to_owned);
    let mut table = Table::new(std::iter::once(ITEM.to_owned()).chain(params.parameters.iter().cloned()).chain(own));
    for (k, at) in points.iter().enumerate() {
        let mut row = vec![if k == 0 { Cell::from("proposal") } else { Cell::from(format!("p{k}")) }];
        row.extend(at.iter().map(|x| Cell::from(rounded(params.scale.to_value(*x)))));
        row.extend([predict(at).into(), edge.into()]);
        table.push(row);
    }
    table
}

fn sensitivities(params: &ProposeParametersParams, group: &GroupModel, surrogate: &Surrogate) -> Table {
    let mut table = Table::new(["parameter", "feature", "change", "standard_error"]);
    let step = if params.scale == Scale::Log { portable_math::log(2.0) } else { 1.0 };
    for (a, parameter) in params.parameters.iter().enumerate() {
        for (j, feature) in group.features.iter().enumerate() {
            let numbers = [surrogate.slopes[(j, a)], surrogate.errors[(j, a)]].map(|x| Cell::from(step * x));
            let [change, error] = numbers;
            table.push(vec![parameter.as_str().into(), feature.as_str().into(), change, error]);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use serde_json::{Value, json};

    use super::*;
    use crate::noise::mahalanobis::fit;
    use rockface_core::artefact::Artefact;
    use rockface_core::numerics::random::Key;
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;

    const FEATURES: [&str; 3] = ["nugget_m2", "sill_m2", "range95_m"];

    /// What a made-up simulator yields: each parameter has its own feature, with a little noise.
    fn world(sigma: f64, length: f64, i: i32, seed: u8) -> [f64; 3] {
        let noise = |j: i32| 0.05 * Key([seed; 32]).field().normal(i, j);
        let (sigma, length) = (portable_math::log(sigma), portable_math::log(length));
        [sigma + noise(0), 2.0 * sigma + 0.1 * length + noise(1), length + noise(2)]
    }

    fn table(rows: &[[f64; 3]]) -> Table {
        let mut table = Table::new(std::iter::once("raster").chain(FEATURES));
        for row in rows {
            table.push(std::iter::once(Cell::from("x")).chain(row.map(Cell::from)).collect());
        }
        table
    }

    fn proposed(with: &Value) -> Result<(Table, Table), StageError> {
        let names: Vec<String> = FEATURES.map(str::to_owned).to_vec();
        let reference: Vec<Vec<f64>> = (0..30).map(|i| world(0.2, 30.0, i, 1).to_vec()).collect();
        let groups = BTreeMap::from([("all".to_owned(), fit(&names, &reference, 1e-3).unwrap())]);
        let model = Acceptance { references: 30, ridge: 1e-3, labels: vec![String::new(); 30], groups };
        let mut inputs = Inputs::default();
        inputs.push("model", BTreeMap::new(), Arc::new(model.into()));
        for (k, (sigma, length)) in [(0.1, 20.0), (0.4, 20.0), (0.1, 60.0), (0.4, 60.0)].into_iter().enumerate() {
            let point = [("sigma".to_owned(), sigma.to_string()), ("length".to_owned(), length.to_string())].into();
            let k = k as i32 * 2;
            let rows = [world(sigma, length, k, 9), world(sigma, length, k + 1, 9)];
            inputs.push("features", point, Arc::new(table(&rows).into()));
        }
        let params = ProposeParametersParams::decode(with).unwrap();
        let outputs = ProposeParameters::run(&params, &inputs, &Context::new(&TestHost::default()))?.into_inner();
        let [Artefact::Table(points), Artefact::Table(found)] = [&outputs["points"], &outputs["sensitivities"]] else {
            panic!("two tables come out");
        };
        Ok((points.clone(), found.clone()))
    }

    #[test]
    fn the_parameters_of_the_reference_are_found_in_one_step() {
        let (points, sensitivities) = proposed(&json!({"parameters": ["sigma", "length"]})).unwrap();
        let at = |column: &str| points.rows[0][points.column(column).unwrap()].number().unwrap();
        assert!((at("sigma") / 0.2 - 1.0).abs() < 0.05 && (at("length") / 30.0 - 1.0).abs() < 0.15, "{points:?}");
        assert!(at("predicted_d2") < 1.0);
        let change = |row: usize| sensitivities.rows[row][2].number().unwrap();
        // sigma moves nugget and sill and leaves the range alone.
        assert!(change(0) > 5.0 && change(1) > 10.0 && change(2).abs() < 2.0, "{sensitivities:?}");
    }

    #[test]
    fn further_points_lie_around_the_proposal_and_a_larger_count_keeps_them() {
        let points = |count: usize| proposed(&json!({"parameters": ["sigma", "length"], "count": count})).unwrap().0;
        let (few, many) = (points(4), points(9));
        assert_eq!((few.rows.len(), &few.rows[..]), (4, &many.rows[..4]));
        let sigma = |row: usize| many.rows[row][1].number().unwrap();
        // A fifth of the range from 0.1 to 0.4, in logarithms, to either side.
        let reach = portable_math::pow(4.0, 0.2) * (1.0 + 1e-4);
        assert!((1..9).all(|k| sigma(k) <= sigma(0) * reach && sigma(k) >= sigma(0) / reach), "{many:?}");
    }

    #[test]
    fn what_cannot_be_proposed_is_refused() {
        let error = |with: Value| proposed(&with).unwrap_err().message;
        assert!(error(json!({"parameters": ["sigma"], "group": "spectrum"})).contains("it has all"));
        assert!(error(json!({"parameters": ["focus"]})).contains("`focus` has no number"));
    }
}
