//! `propose-parameters`: the simulation parameters whose noise should be nearest to the real one in mean and spread, how sure that is,
//! and whether the model can reach the site at all.

use crate::noise::mahalanobis::distance;
use crate::noise::match_moments::{Found, Match};
use crate::noise::perfect_simulator::{Setting, effective_references};
use crate::noise::points::{ITEM, MOST_DIMENSIONS, Scale, coordinates, halton, positions, rounded};
use crate::noise::surrogate::Surrogate;
use reach::Reach;
use rockface_core::artefact::{Acceptance, Cell, GroupModel, Kind, Table};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params, table_row};
use rockface_raster::feature_rows::feature_rows;

mod reach;

choice! {
    /// What to do where the model cannot reach the reference within the range searched.
    pub enum Unreachable {
        /// Propose the nearest and say so.
        Warn = "warn",
        /// Fail.
        Fail = "fail",
    }
}

params! {
    /// Parameters of `propose-parameters`.
    pub struct ProposeParametersParams {
        /// Names of the searched parameters: columns of `features`, axes they were gathered over, or columns of `points`.
        parameters: Vec<String>,
        /// The group of features that is matched: `all`, or `variogram` for nugget, sill and range alone.
        group: String = "all".to_owned(),
        /// Whether features are polynomials of the parameters or of their logarithms. The prior is flat on this scale.
        scale: Scale = Scale::Log,
        /// How far outside the range of the simulations the proposal may lie: a share of its width on either side.
        trust: f64 = 0.25; Range::NonNegative,
        /// How many points are proposed: the nearest, and others around it for the next round to learn from.
        count: usize = 1; Range::Between(1.0, 1e6),
        /// Reach of the others, as a share of the range of the simulations to either side.
        reach: f64 = 0.2; Range::Positive,
        /// Whether a model that cannot reach the reference is warned of, or is an error.
        unreachable: Unreachable = Unreachable::Warn,
    }
}

/// Proposes the parameters at which simulated features have the mean and the spread of those of the reference, says
/// how sure that is, and says in words where the model cannot reach the reference at all, which features show it,
/// and what to widen.
pub struct ProposeParameters;

/// The quantile at which acceptance is predicted.
const LEVEL: f64 = 0.95;

impl Stage for ProposeParameters {
    type Params = ProposeParametersParams;
    const NAME: &'static str = "propose-parameters";
    const VERSION: u32 = 5;
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
            "The proposal, and others around it: `item`, parameters, predicted D2, log-determinant ratio and acceptance, whether the \
             proposal is at the edge.",
        ),
        Port::one(
            "posterior",
            &[Kind::Table],
            "One row a parameter: proposal, median and 90 % interval, range searched.",
        ),
        Port::one("reach", &[Kind::Table], "One row a feature: predicted offset and spread, what moves them."),
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
        let Some(surrogate) = Surrogate::fit(&sample.scaled(), &sample.standardised, &sample.weights()) else {
            return Err(StageError::new(
                "the simulations do not vary in every parameter, or only in proportion to each other",
            )
            .hint("simulate at points that differ in each of `parameters` by itself"));
        };
        let chained = model.groups.get("all").unwrap_or(group);
        let references = effective_references(chained);
        let matching = Match::new(&surrogate, group, model.ridge, references, 1.0 + 2.0 * params.trust);
        let found = matching.as_ref().and_then(|matching| matching.search(params.parameters.len()));
        let (Some(matching), Some(found)) = (matching, found) else {
            return Err(StageError::new(format!("{} simulations are too few to learn from", sample.d2.len()))
                .hint("simulate at more points, or search fewer `parameters`"));
        };
        let posterior = Posterior::of(params, &sample, &found);
        let predicted = matching.predict(&found.best);
        let setting = Setting::of(group, chained, model.ridge, model.references);
        let reach = Reach::of(group, &setting, &surrogate, &found.best, predicted, sample.departing());
        report(params, context, &sample, &posterior, &reach);
        if !reach.is_reached() {
            let text = reach.words(sample.d2.len(), &params.parameters, &posterior);
            match params.unreachable {
                Unreachable::Warn => context.warn(text),
                Unreachable::Fail => {
                    return Err(StageError::new(text).hint("widen the ranges, add a term, or set `unreachable: warn`"));
                }
            }
        }
        let places: Vec<Vec<f64>> = std::iter::once(found.best.clone()).chain(around(params, &found.best)).collect();
        let points = proposal(params, &sample, &places, &matching, group, posterior.at_edge());
        Ok(Outputs::of("points", points)
            .and("posterior", posterior.table())
            .and("reach", reach.table(&params.parameters))
            .and("sensitivities", sensitivities(params, &sample, group, &surrogate, &found.best)))
    }
}

/// Simulations: where they were made, on the scale of the search, and what came out.
struct Sample {
    positions: Vec<Vec<f64>>,
    standardised: Vec<Vec<f64>>,
    d2: Vec<f64>,
    /// Whether one departs from a feature that is the same in all references.
    departs: Vec<bool>,
}

/// What a departure adds to D2 from which on it counts as one.
const DEPARTS: f64 = 4.0;

impl Sample {
    fn gather(params: &ProposeParametersParams, inputs: &Inputs, group: &GroupModel) -> Result<Self, StageError> {
        let points = inputs.optional::<Table>("points")?;
        let (positions_, standardised) = (Vec::new(), Vec::new());
        let mut sample = Self { positions: positions_, standardised, d2: Vec::new(), departs: Vec::new() };
        let p = group.features.len();
        for (items, table) in inputs.many::<Table>("features")? {
            let rows = feature_rows(&[(items, table)], &group.judged())?;
            for (row, cells) in rows.iter().zip(&table.rows) {
                let values = coordinates(&params.parameters, items, table, cells, points)?;
                sample.positions.push(positions(params.scale, &params.parameters, &values)?);
                let z = |j: usize| (row.values[j] - group.mean[j]) / group.deviation[j];
                sample.standardised.push((0..p).map(z).collect());
                let found = distance(group, &row.values);
                let added: f64 = found.contributions[p..].iter().sum();
                sample.d2.push(found.d2 - added);
                sample.departs.push(added > DEPARTS);
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

    /// Simulations near the reference count more: those well beyond the nearest third, or the few nearest, hardly at all, since
    /// features are no polynomials over the whole range.
    fn weights(&self) -> Vec<f64> {
        let few = (2 * (self.positions[0].len() + 1)).max(self.d2.len() / 3);
        let mut sorted = self.d2.clone();
        sorted.sort_by(f64::total_cmp);
        let near = sorted[(few - 1).min(sorted.len() - 1)].max(f64::MIN_POSITIVE);
        self.d2.iter().map(|d2| 1.0 / ((1.0 + d2 / near) * (1.0 + d2 / near))).collect()
    }

    /// The weighted share of simulations that depart from a feature that is the same in all references.
    fn departing(&self) -> f64 {
        let weights = self.weights();
        let departing = self.departs.iter().zip(&weights).filter(|(departs, _)| **departs).map(|(_, w)| w);
        departing.sum::<f64>() / weights.iter().sum::<f64>()
    }

    /// Ends of the simulations along a parameter.
    fn range(&self, j: usize) -> (f64, f64) {
        let all = self.positions.iter().map(|x| x[j]);
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)))
    }

    /// Positions of which -1 and 1 are the ends.
    fn scaled(&self) -> Vec<Vec<f64>> {
        let ranges: Vec<(f64, f64)> = (0..self.positions[0].len()).map(|j| self.range(j)).collect();
        let scaled = |(x, (low, high)): (&f64, &(f64, f64))| {
            if high > low { (2.0 * x - low - high) / (high - low) } else { 0.0 }
        };
        self.positions.iter().map(|x| x.iter().zip(&ranges).map(scaled).collect()).collect()
    }

    /// The value of a parameter at a scaled position.
    fn value(&self, scale: Scale, j: usize, scaled: f64) -> f64 {
        let (low, high) = self.range(j);
        rounded(scale.to_value(0.5 * (low + high) + 0.5 * (high - low) * scaled))
    }
}

table_row! {
    /// What is known of one parameter.
    struct Known {
        parameter: String,
        proposal: f64,
        low90: f64,
        median: f64,
        high90: f64,
        searched_from: f64,
        searched_to: f64,
        share_at_low_end: f64,
        share_at_high_end: f64,
    }
}

/// What is known of the parameters.
struct Posterior(Vec<Known>);

/// The outermost share of a range at either end, and the share of the posterior in it from which on a parameter is at the edge.
const END: f64 = 0.05;
const AT_END: f64 = 0.2;

impl Posterior {
    fn of(params: &ProposeParametersParams, sample: &Sample, found: &Found) -> Self {
        let reach = 1.0 + 2.0 * params.trust;
        let known = |(j, parameter): (usize, &String)| {
            let chain: Vec<f64> = found.chain.iter().map(|x| x[j]).collect();
            let at = |scaled: f64| sample.value(params.scale, j, scaled);
            let level = |level: f64| at(quantile(&chain, level).unwrap_or(f64::NAN));
            let share =
                |inside: &dyn Fn(f64) -> bool| chain.iter().filter(|x| inside(**x)).count() as f64 / chain.len() as f64;
            let end = reach * (1.0 - 2.0 * END);
            Known {
                parameter: parameter.clone(),
                proposal: at(found.best[j]),
                low90: level(0.05),
                median: level(0.5),
                high90: level(0.95),
                searched_from: at(-reach),
                searched_to: at(reach),
                share_at_low_end: share(&|x| x < -end),
                share_at_high_end: share(&|x| x > end),
            }
        };
        Self(params.parameters.iter().enumerate().map(known).collect())
    }

    fn at_edge(&self) -> bool {
        self.0.iter().any(|known| known.share_at_low_end.max(known.share_at_high_end) > AT_END)
    }

    /// What to do about parameters at the edge.
    fn widen(&self) -> Vec<String> {
        let one = |known: &Known| {
            let name = &known.parameter;
            if known.share_at_low_end > AT_END {
                return Some(format!("search `{name}` below {}", known.searched_from));
            }
            (known.share_at_high_end > AT_END).then(|| format!("search `{name}` above {}", known.searched_to))
        };
        self.0.iter().filter_map(one).collect()
    }

    fn table(self) -> Table {
        self.0.into_iter().collect()
    }
}

fn report(params: &ProposeParametersParams, context: &Context, sample: &Sample, posterior: &Posterior, reach: &Reach) {
    let named = |known: &Known| format!("{} {} ({} to {})", known.parameter, known.proposal, known.low90, known.high90);
    let named: Vec<String> = posterior.0.iter().map(named).collect();
    let nearest = sample.d2.iter().copied().fold(f64::INFINITY, f64::min);
    context.metric("predicted_d2", reach.predicted.d2, "1");
    context.metric("predicted_log_determinant_ratio", reach.predicted.log_determinant_ratio, "1");
    context.metric("predicted_acceptance", reach.share, "1");
    context.metric("nearest_d2", nearest, "1");
    let widen = posterior.widen();
    if reach.is_reached() && !widen.is_empty() {
        context.warn(format!("the proposal lies at the edge of what was searched: {}", widen.join("; ")));
    }
    context.headline(format!(
        "proposal from {} simulations, 90 % intervals of group `{}`: {}; {}",
        sample.d2.len(),
        params.group,
        named.join(", "),
        reach.summary()
    ));
}

/// Further points around one, within the trusted range.
fn around(params: &ProposeParametersParams, at: &[f64]) -> Vec<Vec<f64>> {
    let end = 1.0 + 2.0 * params.trust;
    // The range of the simulations is 2 wide.
    let coordinate =
        |k: usize, j: usize| (at[j] + 2.0 * params.reach * (2.0 * halton(k as u64, j) - 1.0)).clamp(-end, end);
    (1..params.count).map(|k| (0..at.len()).map(|j| coordinate(k, j)).collect()).collect()
}

fn proposal(
    params: &ProposeParametersParams,
    sample: &Sample,
    places: &[Vec<f64>],
    matching: &Match,
    group: &GroupModel,
    at_edge: bool,
) -> Table {
    let further =
        ["predicted_d2", "predicted_log_determinant_ratio", "predicted_acceptance", "at_edge"].map(str::to_owned);
    let mut table =
        Table::new(std::iter::once(ITEM.to_owned()).chain(params.parameters.iter().cloned()).chain(further));
    for (k, at) in places.iter().enumerate() {
        let mut row = vec![if k == 0 { Cell::from("proposal") } else { Cell::from(format!("p{k}")) }];
        row.extend(at.iter().enumerate().map(|(j, x)| Cell::from(sample.value(params.scale, j, *x))));
        let predicted = matching.predict(at);
        let share = reach::accepted_share(group, &predicted.rasters);
        row.extend([predicted.d2.into(), predicted.log_determinant_ratio.into(), share.into(), at_edge.into()]);
        table.push(row);
    }
    table
}

fn sensitivities(
    params: &ProposeParametersParams,
    sample: &Sample,
    group: &GroupModel,
    surrogate: &Surrogate,
    at: &[f64],
) -> Table {
    let mut table = Table::new(["parameter", "feature", "change", "standard_error"]);
    let step = if params.scale == Scale::Log { portable_math::log(2.0) } else { 1.0 };
    for (a, parameter) in params.parameters.iter().enumerate() {
        let (low, high) = sample.range(a);
        for (j, feature) in group.features.iter().enumerate() {
            let (slope, error) = surrogate.slope(at, a, j);
            let [change, error] = [slope, error].map(|x| Cell::from(2.0 * step * x / (high - low)));
            table.push(vec![parameter.as_str().into(), feature.as_str().into(), change, error]);
        }
    }
    table
}

#[cfg(test)]
mod tests;
