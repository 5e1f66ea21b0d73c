//! `draw-detection-volumes`: charts of detected against true volumes, overlaps, and what is found by volume.

use crate::detection::detectability;
use crate::figure::chart::{Axes, Axis, Ink, Layer, Mark, Panel, Sheet, draw};
use rockface_core::artefact::{Inventory, Kind};
use rockface_core::numerics::proportion::wilson_interval;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::columns;

/// Ratios of volumes are drawn beyond this one.
const LARGE_RATIO: f64 = 4.0;

params! {
    /// Parameters of `draw-detection-volumes`.
    pub struct DrawDetectionVolumesParams {
        /// Title.
        title: String = "Detected against true volumes".to_owned(),
        /// Column with the true volumes, cubic metres.
        column: String = "removed_m3".to_owned(),
        /// Classes of volume of the share found.
        classes: u32 = 10; Range::Between(2.0, 100.0),
    }
}

/// Draws detected against true volumes.
pub struct DrawDetectionVolumes;

impl Stage for DrawDetectionVolumes {
    type Params = DrawDetectionVolumesParams;
    const NAME: &'static str = "draw-detection-volumes";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("draw_detection_volumes.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("truth", &[Kind::Inventory], "The `truth` of `score-detections`, or many joined.")];
    const OUTPUTS: &'static [Port] = &[Port::one("figure", &[Kind::Figure], "Four charts.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let truth = inputs.one::<Inventory>("truth")?;
        let changes = changes(truth, &params.column)?;
        if changes.is_empty() {
            fail!("no change is `found` or `missed` with a positive `{}`", params.column);
        }
        let points = |of: fn(&Change) -> Option<f64>| -> Vec<[f64; 2]> {
            changes.iter().filter_map(|change| Some([change.volume_m3, of(change)?])).collect()
        };
        let volumes = Axes::new(Axis::log("true volume, m\u{b3}"), Axis::log("detected volume, m\u{b3}"))
            .with(Layer::new("equal", Mark::Diagonal))
            .with(Layer::points("", points(|change| change.detected_m3)));
        let ratios = points(|change| change.detected_m3.map(|detected| detected / change.volume_m3));
        let errors = errors(ratios);
        let overlaps =
            Axes::new(Axis::log("true volume, m\u{b3}"), Axis::linear("intersection over union").between(0.0, 1.0))
                .with(Layer::points("", points(|change| change.iou)));
        let panels = [
            Panel::new("Volumes", volumes),
            Panel::new("Volume error", errors),
            Panel::new("Overlap in plan", overlaps),
            Panel::new("Share found", share_found(&changes, params.classes as usize)),
        ];
        let found = changes.iter().filter(|change| change.found).count();
        let subtitle = format!("{found} of {} changes found", changes.len());
        let sheet = Sheet::of(panels).title(params.title.clone()).subtitle(subtitle);
        Ok(Outputs::of("figure", draw(&sheet).map_err(|e| StageError::new(e.to_string()))?))
    }
}

/// Detected by true volume: as an error in per cent, or as the ratio where one is so large that the others would lie on a line.
fn errors(ratios: Vec<[f64; 2]>) -> Axes {
    let x = Axis::log("true volume, m\u{b3}");
    if ratios.iter().any(|[_, ratio]| *ratio > LARGE_RATIO) {
        return Axes::new(x, Axis::log("detected / true volume"))
            .with(Layer::new("", Mark::AtY(1.0)).ink(Ink::Rule))
            .with(Layer::points("", ratios));
    }
    let per_cent = ratios.into_iter().map(|[volume, ratio]| [volume, 100.0 * (ratio - 1.0)]).collect();
    Axes::new(x, Axis::linear("volume error, %"))
        .with(Layer::new("", Mark::AtY(0.0)).ink(Ink::Rule))
        .with(Layer::points("", per_cent))
}

/// A true change that counts.
struct Change {
    volume_m3: f64,
    found: bool,
    detected_m3: Option<f64>,
    iou: Option<f64>,
}

fn changes(truth: &Inventory, column: &str) -> Result<Vec<Change>, StageError> {
    let hinted = |missing: StageError| missing.hint("connect the port `truth` of `score-detections`");
    let numbers = |name: &str| columns::numbers_of(truth, name).map_err(hinted);
    let (volumes, detected, ious) = (numbers(column)?, numbers("detected_m3")?, numbers("iou")?);
    let outcome = columns::place(&truth.columns, "outcome").map_err(hinted)?;
    let change = |place: usize| {
        let word = truth.features[place].values[outcome].text()?;
        let volume_m3 = volumes[place].filter(|volume| *volume > 0.0)?;
        let counts = ["found", "missed"].contains(&word);
        counts.then_some(Change { volume_m3, found: word == "found", detected_m3: detected[place], iou: ious[place] })
    };
    Ok((0..volumes.len()).filter_map(change).collect())
}

fn share_found(changes: &[Change], classes: usize) -> Axes {
    let volumes: Vec<Option<f64>> = changes.iter().map(|change| Some(change.volume_m3)).collect();
    let mut points = Vec::new();
    let mut intervals = Vec::new();
    for class in detectability::classes(&volumes, classes).into_iter().filter(|class| !class.rows.is_empty()) {
        let found = class.rows.iter().filter(|row| changes[**row].found).count();
        let (low, high) = wilson_interval(found, class.rows.len());
        let middle = (class.from * class.to).sqrt();
        points.push([middle, found as f64 / class.rows.len() as f64]);
        intervals.push([middle, low, high]);
    }
    Axes::new(Axis::log("true volume, m\u{b3}"), Axis::linear("share found").between(0.0, 1.0))
        .with(Layer::new("95 % interval", Mark::Intervals(intervals)).ink(Ink::Muted))
        .with(Layer::line("", points.clone()).ink(Ink::Series(0)))
        .with(Layer::points("", points).ink(Ink::Series(0)))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Cell, Feature, Frame};
    use rockface_core::testing::{TestHost, run_stage};

    #[test]
    fn four_charts_are_drawn_and_an_unscored_truth_is_refused() {
        let columns = ["removed_m3", "outcome", "detected_m3", "iou"].map(str::to_owned).to_vec();
        let feature = |i: u32| {
            let volume = 0.001 * f64::from(i * i + 1);
            let found = i > 8;
            let detected = if found { Cell::from(volume * 0.8) } else { Cell::Empty(()) };
            let iou = if found { Cell::from(0.7) } else { Cell::Empty(()) };
            let outcome = if found { "found" } else { "missed" };
            Feature { outline: Vec::new(), values: vec![volume.into(), outcome.into(), detected, iou] }
        };
        let truth = Inventory { frame: Frame::Wall, columns, features: (0..30).map(feature).collect() };
        let made =
            run_stage::<DrawDetectionVolumes>(&TestHost::default(), &json!({}), &[("truth", truth.clone().into())]);
        let Some(Artefact::Figure(figure)) = made.unwrap().into_inner().remove("figure") else { panic!("no figure") };
        assert!(figure.svg.contains("21 of 30 changes found") && figure.inside_page().is_some());
        let bare = Inventory { columns: vec!["removed_m3".into()], features: Vec::new(), ..truth };
        let error = run_stage::<DrawDetectionVolumes>(&TestHost::default(), &json!({}), &[("truth", bare.into())]);
        assert!(error.unwrap_err().hint.unwrap().contains("score-detections"));
    }
}
