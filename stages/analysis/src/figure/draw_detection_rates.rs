//! `draw-detection-rates`: precision-recall curves of detectors over a swept threshold.

use crate::figure::chart::{Axes, Axis, Ink, Layer, Mark, Panel, Sheet, draw};
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};
use rockface_raster::columns;

choice! {
    /// Which rates are drawn.
    pub enum Rates {
        /// Of all epochs together.
        Pooled = "pooled",
        /// Averaged over epochs.
        Macro = "macro",
    }
}

params! {
    /// Parameters of `draw-detection-rates`.
    pub struct DrawDetectionRatesParams {
        /// Title.
        title: String = "Precision and recall".to_owned(),
        /// Column whose values are the curves; null: one curve.
        series: Option<String> = Some("detector".to_owned()),
        /// Column along which a curve runs.
        along: String = "threshold_m".to_owned(),
        /// Which rates are drawn.
        rates: Rates = Rates::Pooled,
    }
}

/// Draws precision against recall, and F1 and volume error against the threshold.
pub struct DrawDetectionRates;

impl Stage for DrawDetectionRates {
    type Params = DrawDetectionRatesParams;
    const NAME: &'static str = "draw-detection-rates";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("draw_detection_rates.md"));
    const INPUTS: &'static [Port] = &[Port::one("rates", &[Kind::Table], "The table of `summarise-detections`.")];
    const OUTPUTS: &'static [Port] = &[Port::one("figure", &[Kind::Figure], "Three charts.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let rates = inputs.one::<Table>("rates")?;
        if rates.rows.is_empty() {
            fail!("the table has no row");
        }
        let place = |name: &str| columns::place(&rates.columns, name);
        let series = params.series.as_deref().map(place).transpose()?;
        let kind = if params.rates == Rates::Pooled { "pooled" } else { "macro" };
        let column = |name: &str| place(&format!("{kind}_{name}"));
        let (precision, recall, f1) = (column("precision")?, column("recall")?, column("f1")?);
        let ends = ["precision", "f1"]
            .map(|name| Ok::<_, StageError>([column(&format!("{name}_low"))?, column(&format!("{name}_high"))?]));
        let [precision_ends, f1_ends] = ends;
        let (precision_ends, f1_ends): ([usize; 2], [usize; 2]) = (precision_ends?, f1_ends?);
        let (along, error) = (place(&params.along)?, place("volume_error_median")?);
        let share = |label: &str| Axis::linear(label).between(0.0, 1.0);
        let mut curve = Axes::new(share("recall"), share("precision"));
        let mut quality = Axes::new(Axis::log(params.along.clone()), share("F1"));
        let mut volume = Axes::new(Axis::log(params.along.clone()), Axis::linear("median volume error, %"));
        for (number, (name, rows)) in groups(rates, series).into_iter().enumerate() {
            let ink = Ink::Series(number);
            let points = |x: usize, y: usize, factor: f64| -> Vec<[f64; 2]> {
                rows.iter().filter_map(|row| Some([row[x].number()?, factor * row[y].number()?])).collect()
            };
            let spans = |x: usize, [low, high]: [usize; 2]| -> Vec<[f64; 3]> {
                rows.iter()
                    .filter_map(|row| Some([row[x].number()?, row[low].number()?, row[high].number()?]))
                    .collect()
            };
            let dots = |axes: Axes, points: Vec<[f64; 2]>, name: &str| {
                axes.with(Layer::line(name, points.clone()).ink(ink)).with(Layer::points("", points).ink(ink))
            };
            curve = curve.with(Layer::new("", Mark::Intervals(spans(recall, precision_ends))).ink(ink));
            curve = dots(curve, points(recall, precision, 1.0), &name);
            quality = quality.with(Layer::band("", spans(along, f1_ends)).ink(ink));
            quality = dots(quality, points(along, f1, 1.0), &name);
            volume = dots(volume, points(along, error, 100.0), &name);
        }
        let panels = [
            Panel::new("Precision and recall", curve),
            Panel::new("F1", quality),
            Panel::new("Volume error", volume.with(Layer::new("", Mark::AtY(0.0)).ink(Ink::Rule))),
        ];
        let sheet = Sheet::of(panels).title(params.title.clone()).columns(2).size(720, 340);
        Ok(Outputs::of("figure", draw(&sheet).map_err(|e| StageError::new(e.to_string()))?))
    }
}

/// The rows of each value of a column, in the order they are first met.
fn groups(table: &Table, series: Option<usize>) -> Vec<(String, Vec<&Vec<Cell>>)> {
    let mut groups: Vec<(String, Vec<&Vec<Cell>>)> = Vec::new();
    for row in &table.rows {
        let name = series.map_or(String::new(), |at| row[at].to_string());
        match groups.iter_mut().find(|(known, _)| *known == name) {
            Some((_, rows)) => rows.push(row),
            None => groups.push((name, vec![row])),
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, run_stage};

    #[test]
    fn a_curve_a_detector() {
        let columns = [
            "detector",
            "threshold_m",
            "pooled_precision",
            "pooled_precision_low",
            "pooled_precision_high",
            "pooled_recall",
            "pooled_f1",
            "pooled_f1_low",
            "pooled_f1_high",
            "volume_error_median",
        ];
        let mut table = Table::new(columns);
        for (name, offset) in [("raster", 0.0), ("voxels", 0.1)] {
            for step in 1..6 {
                let x = 0.1 * f64::from(step);
                let p = 0.4 + x + 0.5 * offset;
                let numbers = [0.2 * x, p, p - 0.05, p + 0.05, 0.9 - x, 0.6, 0.55, 0.65, -0.2];
                table.push(std::iter::once(Cell::from(name)).chain(numbers.map(Cell::from)).collect());
            }
        }
        let run =
            |with| run_stage::<DrawDetectionRates>(&TestHost::default(), &with, &[("rates", table.clone().into())]);
        let made = run(json!({})).unwrap().into_inner();
        let Artefact::Figure(figure) = &made["figure"] else { panic!("no figure") };
        assert!(figure.svg.contains("voxels") && figure.svg.contains("recall"));
        assert!(run(json!({"along": "lod_m"})).unwrap_err().message.contains("no column `lod_m`"));
    }
}
