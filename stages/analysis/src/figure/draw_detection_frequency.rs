//! `draw-detection-frequency`: magnitude and frequency of truth and detections, and the shapes found and missed.

use crate::figure::chart::{Axes, Axis, Ink, Layer, Panel, Sheet, Ternary, draw};
use rockface_core::artefact::{Inventory, Kind};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::columns;
use rockface_rock::rockfall::power_law;

params! {
    /// Parameters of `draw-detection-frequency`.
    pub struct DrawDetectionFrequencyParams {
        /// Title.
        title: String = "Magnitude, frequency and shape".to_owned(),
        /// Column of the truth with its volumes, cubic metres.
        truth_column: String = "removed_m3".to_owned(),
        /// Column of the detections with their volumes, cubic metres.
        column: String = "volume_m3".to_owned(),
        /// Volumes the power law needs at least.
        least_count: u32 = 10; Range::AtLeast(2.0),
    }
}

/// Draws the cumulative frequency of true, found and detected volumes with their power laws.
pub struct DrawDetectionFrequency;

impl Stage for DrawDetectionFrequency {
    type Params = DrawDetectionFrequencyParams;
    const NAME: &'static str = "draw-detection-frequency";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("draw_detection_frequency.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("truth", &[Kind::Inventory], "The `truth` of `score-detections`, or many joined."),
        Port::one("detections", &[Kind::Inventory], "The `detections` of `score-detections`, or many joined."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("figure", &[Kind::Figure], "Three charts.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let (truth, detections) = (inputs.one::<Inventory>("truth")?, inputs.one::<Inventory>("detections")?);
        let counted = volumes(truth, &params.truth_column, &["found", "missed"])?;
        let series = [
            ("true", counted),
            ("true and found", volumes(truth, &params.truth_column, &["found"])?),
            ("detected, true positives", volumes(detections, &params.column, &["true_positive"])?),
        ];
        if series[0].1.is_empty() {
            fail!("no change is `found` or `missed` with a positive `{}`", params.truth_column);
        }
        let mut axes = Axes::new(Axis::log("volume V, m\u{b3}"), Axis::log("number of volumes \u{2265} V"));
        for (number, (name, volumes)) in series.iter().enumerate() {
            let points: Vec<[f64; 2]> = power_law::curve(volumes).iter().map(|(v, n)| [*v, *n as f64]).collect();
            let law = power_law::fit(volumes, None, None, params.least_count as usize);
            let told =
                law.map_or(String::new(), |law| format!(", b = {:.2} \u{b1} {:.2}", law.exponent, law.standard_error));
            axes =
                axes.with(Layer::points(format!("{name} ({}){told}", volumes.len()), points).ink(Ink::Series(number)));
            if let Some((law, last)) = law.zip(volumes.last()) {
                let line = vec![[law.minimum, law.count as f64], [*last, law.number_from(*last).max(0.5)]];
                axes = axes.with(Layer::line("", line).ink(Ink::Series(number)));
            }
        }
        let shapes = |word: &str, ink: Ink| Ternary { sides_m: sides(truth, word), ink: Some(ink), values: None };
        let panels = [
            Panel::new("Magnitude and frequency", axes),
            Panel::new("Shapes found", shapes("found", Ink::Series(0))),
            Panel::new("Shapes missed", shapes("missed", Ink::Series(1))),
        ];
        let sheet = Sheet::of(panels).title(params.title.clone()).columns(2).size(720, 360);
        Ok(Outputs::of("figure", draw(&sheet).map_err(|e| StageError::new(e.to_string()))?))
    }
}

/// The positive volumes with one of these outcomes, ascending.
fn volumes(inventory: &Inventory, column: &str, outcomes: &[&str]) -> Result<Vec<f64>, StageError> {
    if inventory.features.is_empty() {
        return Ok(Vec::new());
    }
    let hinted = |missing: StageError| missing.hint("connect what `score-detections` made");
    let numbers = columns::numbers_of(inventory, column).map_err(hinted)?;
    let at = columns::place(&inventory.columns, "outcome").map_err(hinted)?;
    let rows = numbers.into_iter().zip(&inventory.features);
    let kept = rows.filter(|(_, f)| outcomes.contains(&f.values[at].text().unwrap_or_default()));
    let mut volumes: Vec<f64> = kept.filter_map(|(volume, _)| volume.filter(|v| *v > 0.0)).collect();
    volumes.sort_by(f64::total_cmp);
    Ok(volumes)
}

/// The axes of the changes with an outcome.
fn sides(truth: &Inventory, word: &str) -> Vec<[f64; 3]> {
    let axes = ["long_m", "intermediate_m", "short_m"].map(|name| truth.numbers(name));
    let ([Some(long), Some(intermediate), Some(short)], Some(at)) = (axes, truth.column("outcome")) else {
        return Vec::new();
    };
    let is = |place: &usize| truth.features[*place].values[at].text() == Some(word);
    let three = |place: usize| Some([long[place]?, intermediate[place]?, short[place]?]);
    (0..long.len()).filter(is).filter_map(three).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Feature, Frame};
    use rockface_core::testing::{TestHost, run_stage};

    fn inventory(column: &str, words: [&str; 2]) -> Inventory {
        let columns = [column, "outcome", "long_m", "intermediate_m", "short_m"].map(str::to_owned).to_vec();
        let feature = |i: u32| {
            let word = words[usize::from(i.is_multiple_of(3))];
            let volume = 1.0 / f64::from(i + 1);
            let values = vec![volume.into(), word.into(), 1.0.into(), 0.6.into(), (0.1 + 0.01 * f64::from(i)).into()];
            Feature { outline: Vec::new(), values }
        };
        Inventory { frame: Frame::Wall, columns, features: (0..40).map(feature).collect() }
    }

    #[test]
    fn three_charts_with_and_without_detections() {
        let run = |detections: Inventory| {
            let truth = inventory("removed_m3", ["found", "missed"]);
            let inputs = [("truth", truth.into()), ("detections", detections.into())];
            run_stage::<DrawDetectionFrequency>(&TestHost::default(), &json!({}), &inputs)
        };
        let made = run(inventory("volume_m3", ["true_positive", "false_positive"])).unwrap().into_inner();
        let Artefact::Figure(figure) = &made["figure"] else { panic!("no figure") };
        assert!(figure.svg.contains("true (40), b =") && figure.svg.contains("true and found (26)"));
        let none = Inventory { frame: Frame::Wall, columns: Vec::new(), features: Vec::new() };
        assert!(run(none).is_ok());
        assert!(run(inventory("v", ["true_positive", "false_positive"])).unwrap_err().message.contains("`volume_m3`"));
    }
}
