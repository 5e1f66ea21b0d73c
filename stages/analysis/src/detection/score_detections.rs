//! `score-detections`: labels what was found against the ground truth, and counts.

use crate::detection::clusters;
use crate::detection::compared;
use crate::detection::compared::Side;
use crate::detection::found;
use crate::detection::score;
use crate::detection::score::{Counts, Object, Score};
use rockface_core::artefact::{Artefact, Band, Cell, Feature, Grid, Inventory, Kind, Raster, Sample, Table};
use rockface_core::numerics::quantile::median;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::{columns, grid};
use rockface_rock::rockfall::ground_truth::outline;

/// So many labels at most may be classes instead, and so many places at least are more than one loss leaves.
const CLASSES: usize = 2;
const SCATTERED: usize = 4;

params! {
    /// Parameters of `score-detections`.
    pub struct ScoreDetectionsParams {
        /// Least intersection over union of a match, in plan; 0: a shared cell is enough.
        least_iou: f64 = 0.0; Range::Between(0.0, 1.0),
        /// A true change of which a smaller share can be seen along Z (column `visible_fraction`) is `hidden` and in no rate.
        least_visible_fraction: f64 = 0.0; Range::Between(0.0, 1.0),
        /// Column of the truth with its volumes, cubic metres.
        truth_column: String = "removed_m3".to_owned(),
        /// Column of the detections with their volumes, cubic metres.
        column: String = "volume_m3".to_owned(),
    }
}

/// Compares detections with the ground truth.
pub struct ScoreDetections;

impl Stage for ScoreDetections {
    type Params = ScoreDetectionsParams;
    const NAME: &'static str = "score-detections";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("score_detections.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("truth", &[Kind::Inventory], "What is true, such as the ground truth of `remove-blocks`."),
        Port::one(
            "detections",
            &[Kind::Inventory, Kind::Raster],
            "What was found: outlines and volumes, or labels (0 for none) on the grid of the comparison.",
        ),
        Port::one("grid", &[Kind::Raster], "The difference that was searched: its grid, and where it has values."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("summary", &[Kind::Table], "Counts, rates and errors, one row."),
        Port::one("truth", &[Kind::Inventory], "The truth with outcome, partner, intersection over union and errors."),
        Port::one("detections", &[Kind::Inventory], "The detections with the same."),
        Port::one("confusion", &[Kind::Raster], "Right and wrong cells."),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (truth, searched) = (inputs.one::<Inventory>("truth")?, inputs.one::<Raster>("grid")?);
        let [band] = searched.bands.as_slice() else {
            fail!("the raster at `grid` has {} bands, one is needed", searched.bands.len())
        };
        let seen: Vec<bool> = band.values.iter().map(|value| !value.is_nan()).collect();
        let detections = detections(inputs.artefact("detections")?, searched, &seen, context)?;
        for (name, frame) in [("truth", truth.frame), ("detections", detections.frame)] {
            if frame != searched.frame {
                fail!("the {name} are in the {frame} frame, the grid in the {} frame", searched.frame);
            }
        }
        for (whose, inventory, column) in
            [("truth", truth, &params.truth_column), ("detections", &detections, &params.column)]
        {
            let cells = inventory.column(column).map(|at| inventory.features.iter().map(move |f| &f.values[at]));
            if let Some(text) = columns::text_among_numbers(column, cells.into_iter().flatten()) {
                context.warn(format!("{whose}: {text}"));
            }
        }
        let true_objects = truths(truth, params, &searched.grid, &seen)?;
        let found_objects = founds(&detections, params, &searched.grid, &seen)?;
        let score = Score::of(&true_objects, &found_objects, params.least_iou);
        let codes = score::confusion(&true_objects, &found_objects, seen.len());
        let sides = [
            &Side { inventory: truth, objects: &true_objects },
            &Side { inventory: &detections, objects: &found_objects },
        ];
        let judged = [true, false].map(|truths| compared::judged(&score, sides, truths));
        let summary = summary(&score, &true_objects, &found_objects, &judged[0], &codes, &seen);
        report(&summary, context);
        let [truth, detections] = judged;
        Ok(Outputs::of("summary", summary)
            .and("truth", truth)
            .and("detections", detections)
            .and("confusion", confusion(searched, &codes, &seen)))
    }
}

/// The detections as an inventory; labels get outlines, and volumes from the difference they lie on.
fn detections(given: &Artefact, searched: &Raster, seen: &[bool], context: &Context) -> Result<Inventory, StageError> {
    let labels = match given {
        Artefact::Inventory(inventory) => return Ok(inventory.clone()),
        Artefact::Raster(labels) => labels,
        other => fail!("port `detections` needs an inventory or a raster, found a {}", other.kind()),
    };
    if !grid::same(&labels.grid, &searched.grid) || labels.bands.len() != 1 {
        let (a, b) = (grid::describe(&labels.grid), grid::describe(&searched.grid));
        fail!(
            "the labels have {a} in {} bands; they must have one band and the grid searched: {b}",
            labels.bands.len()
        );
    }
    let (grid, difference) = (&searched.grid, &searched.bands[0].values);
    let feature = |(label, cells): (u32, Vec<usize>)| {
        let places: Vec<(usize, usize)> = cells.iter().map(|c| (c / grid.columns, c % grid.columns)).collect();
        let lost = cells.iter().fold(0.0, |sum, cell| sum + f64::from(difference[*cell]).abs());
        let volume = if searched.quantity == "difference" { lost * grid.cell_m * grid.cell_m } else { f64::NAN };
        let values = [f64::from(label), volume, cells.len() as f64].map(Cell::from).to_vec();
        Feature { outline: outline::polygons(grid, &places), values }
    };
    let labelled = compared::labelled(labels, seen)?;
    warn_of_classes(&labelled, grid.columns, seen.len(), context);
    let features = labelled.into_iter().map(feature).collect();
    let columns = ["id", "volume_m3", "cells"].map(str::to_owned).to_vec();
    Ok(Inventory { frame: labels.frame, columns, features })
}

/// Says where one or two labels lie in many places: a map of classes in the place of labels makes one detection of all that was found.
fn warn_of_classes(labelled: &[(u32, Vec<usize>)], columns: usize, cells: usize, context: &Context) {
    for (label, own) in labelled.iter().filter(|_| labelled.len() <= CLASSES) {
        let mut mask = vec![false; cells];
        own.iter().for_each(|cell| mask[*cell] = true);
        let parts = clusters::groups(&mask, columns).len();
        if parts >= SCATTERED {
            context.warn(format!(
                "label {label} lies in {parts} places that do not touch, and counts as one detection: give each of them a number of its own, as `scipy.ndimage.label` does"
            ));
        }
    }
}

fn column(inventory: &Inventory, name: &str, whose: &str) -> Result<Vec<Option<f64>>, StageError> {
    if inventory.features.is_empty() {
        return Ok(Vec::new());
    }
    inventory.numbers(name).ok_or_else(|| {
        StageError::new(format!(
            "there is no column `{name}` in the {whose}; there are {}",
            inventory.columns.join(", ")
        ))
    })
}

fn truths(
    truth: &Inventory,
    params: &ScoreDetectionsParams,
    grid: &Grid,
    seen: &[bool],
) -> Result<Vec<Object>, StageError> {
    let volumes = column(truth, &params.truth_column, "truth")?;
    let visible = truth.numbers("visible_fraction").unwrap_or_else(|| vec![None; volumes.len()]);
    let cells = compared::cells(truth, grid, seen);
    let object = |((cells, volume_m3), visible): ((Vec<usize>, Option<f64>), Option<f64>)| {
        let counts = !cells.is_empty() && visible.is_none_or(|share| share >= params.least_visible_fraction);
        Object { cells, volume_m3, counts }
    };
    Ok(cells.into_iter().zip(volumes).zip(visible).map(object).collect())
}

fn founds(
    detections: &Inventory,
    params: &ScoreDetectionsParams,
    grid: &Grid,
    seen: &[bool],
) -> Result<Vec<Object>, StageError> {
    let volumes = column(detections, &params.column, "detections")?;
    let cells = compared::cells(detections, grid, seen);
    let object = |(cells, volume_m3): (Vec<usize>, Option<f64>)| Object { counts: !cells.is_empty(), cells, volume_m3 };
    Ok(cells.into_iter().zip(volumes).map(object).collect())
}

/// Names and values of the row of `summary`.
fn summary(
    score: &Score,
    truth: &[Object],
    detections: &[Object],
    judged: &Inventory,
    codes: &[u8],
    seen: &[bool],
) -> Table {
    let [any, strict] = [score::permissive(score, truth, detections), score::one_to_one(score, truth, detections)];
    let number = |value: usize| Some(value as f64);
    let of_code = |code: u8| codes.iter().zip(seen).filter(|(c, seen)| **seen && **c == code).count();
    let [none, both, found, missed] = [0, 1, 2, 3].map(of_code);
    let by_cell = Counts { true_positives: both, false_positives: found, found: both, missed };
    let cell_iou = (both + found + missed > 0).then(|| both as f64 / (both + found + missed) as f64);
    let volume = |objects: &[Object], matched: &dyn Fn(usize) -> bool| {
        let kept = objects.iter().enumerate().filter(|(number, object)| object.counts && matched(*number));
        kept.fold(0.0, |sum, (_, object)| sum + object.volume_m3.unwrap_or(0.0))
    };
    let outside = detections.iter().filter(|object| !object.counts);
    let outside_m3 = outside.fold(0.0, |sum, object| sum + object.volume_m3.unwrap_or(0.0));
    let values = |name: &str| -> Vec<f64> { judged.numbers(name).unwrap_or_default().into_iter().flatten().collect() };
    let (errors, mut ratios, ious) = (values("volume_error"), values("log_volume_ratio"), values("iou"));
    let mean = |values: &[f64]| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let absolute: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
    let row = [
        ("truths", number(truth.len())),
        ("hidden", number(truth.iter().filter(|object| !object.counts).count())),
        ("detections", number(any.true_positives + any.false_positives)),
        ("true_positives", number(any.true_positives)),
        ("false_positives", number(any.false_positives)),
        ("found", number(any.found)),
        ("missed", number(any.missed)),
        ("precision", any.precision()),
        ("recall", any.recall()),
        ("f1", any.f1()),
        ("accuracy", any.accuracy(0)),
        ("pairs", number(score.pairs.len())),
        ("true_positives_1to1", number(strict.true_positives)),
        ("false_positives_1to1", number(strict.false_positives)),
        ("found_1to1", number(strict.found)),
        ("missed_1to1", number(strict.missed)),
        ("precision_1to1", strict.precision()),
        ("recall_1to1", strict.recall()),
        ("f1_1to1", strict.f1()),
        ("accuracy_1to1", strict.accuracy(0)),
        ("cells_true_positive", number(both)),
        ("cells_false_positive", number(found)),
        ("cells_false_negative", number(missed)),
        ("cells_true_negative", number(none)),
        ("cell_precision", by_cell.precision()),
        ("cell_recall", by_cell.recall()),
        ("cell_f1", by_cell.f1()),
        ("cell_accuracy", by_cell.accuracy(none)),
        ("cell_iou", cell_iou),
        ("truth_m3", Some(volume(truth, &|_| true))),
        ("found_truth_m3", Some(volume(truth, &|number| score.of_truth(number) > 0))),
        ("detected_m3", Some(volume(detections, &|_| true))),
        ("true_detected_m3", Some(volume(detections, &|number| score.of_detection(number) > 0))),
        ("volume_error_mean", mean(&errors)),
        ("volume_error_mean_abs", mean(&absolute)),
        ("volume_error_median", median(&mut errors.clone())),
        ("log_volume_ratio_median", median(&mut ratios)),
        ("iou_mean", mean(&ious)),
        ("outside", number(detections.iter().filter(|object| !object.counts).count())),
        ("outside_m3", Some(outside_m3)),
    ];
    let mut table = Table::new(row.map(|(name, _)| name));
    table.push(row.map(|(_, value)| value.map_or(Cell::Empty(()), Cell::from)).to_vec());
    table
}

fn report(summary: &Table, context: &Context) {
    let value = |name: &str| summary.column(name).and_then(|at| summary.rows[0][at].number());
    for name in ["precision", "recall", "f1", "precision_1to1", "recall_1to1", "f1_1to1", "volume_error_median"] {
        if let Some(value) = value(name) {
            context.metric(name, value, "1");
        }
    }
    let count = |name: &str| value(name).unwrap_or(0.0);
    let percent = |name: &str| value(name).map_or("undefined".to_owned(), |share| format!("{:.1} %", 100.0 * share));
    let hidden = match count("hidden") {
        0.0 => String::new(),
        hidden => format!("; {hidden} more cannot be seen on this grid and are in no rate"),
    };
    let outside = match count("outside") {
        0.0 => String::new(),
        outside => format!(
            "; {outside} more detections of {} m3 lie where the grid has no value and are in no rate",
            found::volume_text(count("outside_m3"))
        ),
    };
    if count("outside") > count("true_positives") + count("false_positives") {
        context.warn(
            "most of the detections lie where the difference has no value, such as what a detector makes of places that one survey did not see: they count neither as true nor as false",
        );
    }
    if count("hidden") > count("found") + count("missed") {
        context.warn(
            "most of the true changes lie where the difference has no value: let blocks fall where the survey looks, such as in a zone that `crop-raster` cuts to a window (port `zone` of `remove-blocks`)",
        );
    }
    context.headline(format!(
        "{} of {} changes found, {} false {}: precision {}, recall {}, F1 {}{hidden}{outside}",
        count("found"),
        count("found") + count("missed"),
        count("false_positives"),
        if (count("false_positives") - 1.0).abs() < 0.5 { "alarm" } else { "alarms" },
        percent("precision"),
        percent("recall"),
        percent("f1")
    ));
}

fn confusion(searched: &Raster, codes: &[u8], seen: &[bool]) -> Raster {
    let value = |(code, seen): (&u8, &bool)| if *seen { f32::from(*code) } else { 255.0 };
    let values = codes.iter().zip(seen).map(value).collect();
    let bands = vec![Band { name: "confusion".to_owned(), values }];
    Raster { quantity: "confusion".to_owned(), sample: Sample::Byte, bands, ..searched.clone() }
}

#[cfg(test)]
mod tests;
