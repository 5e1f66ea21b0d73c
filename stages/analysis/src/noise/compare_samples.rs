//! `compare-samples`: whether classifiers can tell simulated rasters from real ones by their features, and real from real.

use rayon::prelude::*;

use crate::noise::chain;
use crate::noise::classifier::{Auc, Logistic, area};
use crate::noise::descriptors::feature_names;
use crate::noise::mahalanobis::{Constant, constants};
use crate::noise::tested;
use crate::noise::tested::Role;
use crate::noise::two_samples::{Classifier, Control, Row, TwoSamples, control};
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::numerics::held_out::in_view;
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params, table_row};
use rockface_raster::feature_rows::{FeatureRow, feature_rows};

params! {
    /// Parameters of `compare-samples`.
    pub struct CompareSamplesParams {
        /// Columns the classifiers see. Left out: the ten descriptors where the first table has them all, as from `describe-noise`; otherwise
        /// every column of numbers, as from `describe-structure`.
        features: Vec<String> = Vec::new(),
        /// Share of the real rasters, the last ones, that is left out: a model that was learnt without them is compared with what it has seen.
        held_out: f64 = 0.0; Range::Between(0.0, 0.9),
        /// Ridge on the weights of the standardised features, for ten features; it grows with their number.
        ridge: f64 = 1.0; Range::Positive,
        /// Folds of the cross-validation, or as many as the smaller sample has rasters.
        folds: usize = 5; Range::Between(2.0, 1000.0),
        /// How many times the real rasters are split into halves that are told apart in the same way, as a control; 0: no control.
        control_splits: usize = 20; Range::Between(0.0, 1000.0),
    }
}

/// Trains classifiers to tell simulated rasters from real ones, and measures how well they do on rasters they have
/// not seen.
pub struct CompareSamples;

/// Features for which the ridge is given.
const RIDGE_FEATURES: f64 = 10.0;
/// How many of the features that tell the samples apart are named in the log.
const NAMED: usize = 6;

impl Stage for CompareSamples {
    type Params = CompareSamplesParams;
    const NAME: &'static str = "compare-samples";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("compare_samples.md"));
    const INPUTS: &'static [Port] = &[
        Port::many(
            "reference",
            &[Kind::Table],
            "Features of real rasters, from `describe-noise` or `describe-structure`.",
        ),
        Port::many("simulated", &[Kind::Table], "Features of simulated rasters, from the same stage."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one(
            "areas",
            &[Kind::Table],
            "Area with interval of each classifier and of each feature by itself, and the areas of real against real.",
        ),
        Port::one("scores", &[Kind::Table], "One row a raster: class, cross-validated scores."),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let tables = inputs.many::<Table>("reference")?;
        let features = features(params, tables.first().map(|(_, table)| *table));
        let mut classes = [Vec::new(), Vec::new()];
        for (class, port) in classes.iter_mut().zip(["reference", "simulated"]) {
            *class = feature_rows(&inputs.many::<Table>(port)?, &features)?;
            if port == "reference" {
                class.truncate(in_view(class.len(), params.held_out));
            }
            if class.len() < LEAST {
                let text = format!("`{port}` has {} rasters to compare, {LEAST} are needed", class.len());
                return Err(StageError::new(text).hint(if port == "simulated" {
                    "simulate more of them, such as by more `replicates`"
                } else {
                    "add rasters, or lower `held_out`"
                }));
            }
        }
        let copies = [tested::copies(&classes[0], Role::Reference), tested::copies(&classes[1], Role::Simulated)];
        let other = tested::other_extent(&tables, &inputs.many::<Table>("simulated")?);
        copies.into_iter().flatten().chain(other).for_each(|text| context.warn(text));
        level(&features, &mut classes);
        let folds = params.folds.min(classes[0].len()).min(classes[1].len());
        let params = &CompareSamplesParams { folds, ..params.clone() };
        let compared = Compared::of(params, &features, &classes, context);
        compared.report(&features, context);
        let areas = compared.areas(&features);
        Ok(Outputs::of("areas", areas).and("scores", scores(&classes, &compared.scores)))
    }
}

/// Makes features the same that differ by less than their resolution from one that does not vary over the real rasters: a classifier would tell rounding.
fn level(names: &[String], classes: &mut [Vec<FeatureRow>; 2]) {
    let real: Vec<Vec<f64>> = classes[0].iter().map(|row| row.values.clone()).collect();
    let constants = constants(names, &real);
    for row in classes.iter_mut().flatten() {
        for (value, constant) in row.values.iter_mut().zip(&constants) {
            if let Some(Constant { value: usual, resolution }) = constant
                && (*value - usual).abs() < *resolution
            {
                *value = *usual;
            }
        }
    }
}

/// Fewest rasters of a class.
const LEAST: usize = 4;

/// The columns asked for, or those a table has.
fn features(params: &CompareSamplesParams, table: Option<&Table>) -> Vec<String> {
    let descriptors: Vec<String> = feature_names().into_iter().map(str::to_owned).collect();
    let Some(table) = table.filter(|_| params.features.is_empty()) else { return params.features.clone() };
    if descriptors.iter().all(|name| table.column(name).is_some()) {
        return descriptors;
    }
    let numbers = |j: &usize| table.rows.iter().all(|row| row[*j].number().is_some());
    let named = (0..table.columns.len()).filter(|j| table.columns[*j] != "raster").filter(numbers);
    named.map(|j| table.columns[j].clone()).collect()
}

/// Everything that was found.
struct Compared {
    /// Area of each classifier.
    classifiers: Vec<Auc>,
    /// Scores of each classifier, by class.
    scores: Vec<[Vec<f64>; 2]>,
    /// Area of each feature by itself.
    features: Vec<Auc>,
    /// Its weight in the linear classifier of all rasters.
    weights: Vec<f64>,
    /// Areas of real against real.
    control: Vec<Control>,
}

impl Compared {
    fn of(params: &CompareSamplesParams, names: &[String], classes: &[Vec<FeatureRow>; 2], context: &Context) -> Self {
        let labels = classes.each_ref().map(|class| class.iter().map(FeatureRow::label).collect::<Vec<_>>());
        if let Some(text) = chain::warning(&labels[0]) {
            context.note(text);
        }
        let links = links(&labels);
        let row = |class: usize| {
            let first = class * classes[0].len();
            let rows = classes[class].iter().enumerate();
            rows.map(|(i, row)| Row { values: &row.values, number: first + i }).collect::<Vec<_>>()
        };
        let samples = TwoSamples { classes: [row(0), row(1)], links: &links };
        let ridge = params.ridge * names.len() as f64 / RIDGE_FEATURES;
        let scores: Vec<[Vec<f64>; 2]> = Classifier::ALL
            .par_iter()
            .map(|classifier| samples.cross_validated(*classifier, params.folds, ridge))
            .collect();
        let real: Vec<Vec<f64>> = classes[0].iter().map(|row| row.values.clone()).collect();
        // Halves differ in size by a run of three rasters at most.
        let splits = if real.len() >= 2 * params.folds.max(LEAST) + 3 { params.control_splits } else { 0 };
        if splits < params.control_splits {
            context.warn(format!(
                "{} real rasters are too few to split: there is no control of real against real",
                real.len()
            ));
        }
        let rows = samples.classes.each_ref().map(|class| class.iter().map(|row| row.values).collect::<Vec<_>>());
        let column = |class: usize, j: usize| rows[class].iter().map(|row| row[j]).collect::<Vec<f64>>();
        Self {
            classifiers: scores.iter().map(|[real, simulated]| area(real, simulated)).collect(),
            features: (0..names.len()).map(|j| area(&column(0, j), &column(1, j))).collect(),
            weights: Logistic::fit([&rows[0], &rows[1]], ridge).weights,
            control: control(&real, &links, splits, params.folds, ridge),
            scores,
        }
    }

    /// Quantiles 0.05, 0.5 and 0.95 of an area over the control splits; none without a control.
    fn control_of(&self, area: impl Fn(&Control) -> f64) -> [Option<f64>; 3] {
        let areas: Vec<f64> = self.control.iter().map(area).collect();
        [0.05, 0.5, 0.95].map(|level| quantile(&areas, level))
    }

    fn areas(&self, names: &[String]) -> Table {
        let classifiers = Classifier::ALL.iter().zip(&self.classifiers).enumerate();
        let of_classifiers = classifiers.map(|(k, (classifier, auc))| {
            Area::of(classifier.name(), auc, None, self.control_of(|c| c.classifiers[k]))
        });
        let features = names.iter().zip(&self.features).enumerate();
        let of_features = features
            .map(|(j, (name, auc))| Area::of(name, auc, Some(self.weights[j]), self.control_of(|c| c.features[j])));
        of_classifiers.chain(of_features).collect()
    }

    /// Features whose area is farther from 0.5 than the control's and than chance, the farthest first.
    fn telling<'a>(&self, names: &'a [String]) -> Vec<(&'a str, f64)> {
        let beyond = |j: &usize| {
            let (low, high) = self.features[*j].interval();
            let [below, _, above] = self.control_of(|control| control.features[*j]);
            let auc = self.features[*j].auc;
            (low > 0.5 && above.is_none_or(|above| auc > above))
                || (high < 0.5 && below.is_none_or(|below| auc < below))
        };
        let mut telling: Vec<usize> = (0..names.len()).filter(beyond).collect();
        telling.sort_by(|a, b| (self.features[*b].auc - 0.5).abs().total_cmp(&(self.features[*a].auc - 0.5).abs()));
        telling.into_iter().map(|j| (names[j].as_str(), self.features[j].auc)).collect()
    }

    fn report(&self, names: &[String], context: &Context) {
        let mut texts = Vec::new();
        for (k, (classifier, found)) in Classifier::ALL.iter().zip(&self.classifiers).enumerate() {
            let key = if k == 0 { "auc".to_owned() } else { format!("auc_{}", classifier.name()) };
            context.metric(&key, found.auc, "1");
            let control = self.control_of(|control| control.classifiers[k]);
            let beside = match control {
                [Some(low), Some(_), Some(high)] => {
                    context.metric(&format!("control_high_{}", classifier.name()), high, "1");
                    format!(" (real from real {low:.2} to {high:.2})")
                }
                _ => String::new(),
            };
            texts.push(format!("{} {:.2}{beside}", classifier.name(), found.auc));
        }
        let telling = self.telling(names);
        context.metric("telling_features", telling.len() as f64, "1");
        if !telling.is_empty() {
            let named: Vec<String> =
                telling.iter().take(NAMED).map(|(name, auc)| format!("`{name}` ({auc:.2})")).collect();
            context.note(format!(
                "{} of {} features tell simulated from real by themselves, most of all {}",
                telling.len(),
                names.len(),
                named.join(", ")
            ));
        }
        context.headline(format!(
            "area with which classifiers of {} features tell simulated from real, 0.5 is indistinguishable: {}",
            names.len(),
            texts.join(", ")
        ));
    }
}

/// Rasters that share an epoch with another of their class, by number; those of the first class come first.
fn links(labels: &[Vec<String>; 2]) -> Vec<Vec<usize>> {
    let of_class = |class: usize| {
        let first = class * labels[0].len();
        chain::neighbours(&labels[class]).into_iter().map(move |linked| linked.into_iter().map(|j| first + j).collect())
    };
    of_class(0).chain(of_class(1)).collect()
}

table_row! {
    /// The area of a classifier or of a feature.
    struct Area {
        seen: String,
        auc: f64,
        low95: f64,
        high95: f64,
        weight: Option<f64>,
        control_low: Option<f64>,
        control_median: Option<f64>,
        control_high: Option<f64>,
    }
}

impl Area {
    fn of(seen: &str, found: &Auc, weight: Option<f64>, control: [Option<f64>; 3]) -> Self {
        let (low95, high95) = found.interval();
        let [control_low, control_median, control_high] = control;
        Self { seen: seen.to_owned(), auc: found.auc, low95, high95, weight, control_low, control_median, control_high }
    }
}

fn scores(classes: &[Vec<FeatureRow>; 2], found: &[[Vec<f64>; 2]]) -> Table {
    let columns = Classifier::ALL.map(|classifier| format!("score_{}", classifier.name()));
    let mut table = Table::new(["raster", "class"].map(str::to_owned).into_iter().chain(columns));
    for (class, name) in ["real", "simulated"].into_iter().enumerate() {
        for (i, row) in classes[class].iter().enumerate() {
            let scores = found.iter().map(|scores| Cell::from(scores[class][i]));
            table.push([row.label().into(), name.into()].into_iter().chain(scores).collect());
        }
    }
    table
}

#[cfg(test)]
mod tests;
