//! `draw-descriptors`: variogram, roughness and spectrum of simulated rasters over the envelopes of the real ones.

use crate::figure::chart::{Axes, Axis, Ink, Layer, Panel, Sheet, draw};
use crate::noise::envelope::{Step, curves_of, envelope, rasters};
use rockface_core::artefact::{Kind, Table};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `draw-descriptors`.
    pub struct DrawDescriptorsParams {
        /// Title; left out, what is compared.
        title: Option<String> = None,
        /// The curves that are drawn, a panel each.
        curves: Vec<String> = vec!["variogram".to_owned(), "roughness".to_owned(), "spectrum".to_owned()],
        /// How many real rasters are drawn with a line each, the first ones.
        examples: usize = 0; Range::Between(0.0, 6.0),
    }
}

/// Draws the curves of `describe-noise` for real and simulated rasters, one over the other.
pub struct DrawDescriptors;

impl Stage for DrawDescriptors {
    type Params = DrawDescriptorsParams;
    const NAME: &'static str = "draw-descriptors";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("draw_descriptors.md"));
    const INPUTS: &'static [Port] = &[
        Port::many("reference", &[Kind::Table], "Curves of real rasters, from `describe-noise`."),
        Port::many("simulated", &[Kind::Table], "Curves of simulated rasters, from `describe-noise`."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("figure", &[Kind::Figure], "SVG.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let tables = |port: &str| -> Result<Vec<&Table>, StageError> {
            Ok(inputs.many::<Table>(port)?.into_iter().map(|(_, table)| table).collect())
        };
        let (real, simulated) = (tables("reference")?, tables("simulated")?);
        let panels =
            params.curves.iter().map(|curve| panel(params, curve, &real, &simulated)).collect::<Result<Vec<_>, _>>()?;
        let counts =
            format!("{} real rasters, {} simulated; bands of 90 and 50 %", rasters(&real), rasters(&simulated));
        let title = params.title.clone().unwrap_or_else(|| "Descriptors of real and simulated noise".to_owned());
        let columns = panels.len().min(2);
        let sheet = Sheet::of(panels).title(title).subtitle(counts).columns(columns).size(340 * columns as u32, 320);
        let figure = draw(&sheet).map_err(|e| StageError::new(e.to_string()))?;
        Ok(Outputs::of("figure", figure))
    }
}

/// Labels of the axes, and the factor on the ordinate.
fn axes_of(curve: &str) -> (&'static str, &'static str, f64) {
    match curve {
        "roughness" => ("smoothing scale, m", "roughness, mm", 1e3),
        "spectrum" => ("frequency, 1/m", "power, mm²", 1e6),
        _ => ("lag, m", "semivariance, mm²", 1e6),
    }
}

fn panel(
    params: &DrawDescriptorsParams,
    curve: &str,
    real: &[&Table],
    simulated: &[&Table],
) -> Result<Panel, StageError> {
    let (x, y, factor) = axes_of(curve);
    let mut axes = Axes::new(Axis::log(x), Axis::log(y));
    for (name, tables, ink) in [("real", real, Ink::Muted), ("simulated", simulated, Ink::Series(0))] {
        let found = envelope(tables, curve).ok_or_else(|| {
            StageError::new(format!("a table of {name} curves lacks one of the columns raster, curve, x and y"))
                .hint("give the port `curves` of `describe-noise`")
        })?;
        if found.is_empty() {
            fail!("no {name} raster has a curve `{curve}`");
        }
        let scaled = |step: &Step| step.y.map(|y| y * factor);
        let band = |low: usize, high: usize| {
            Layer::band("", found.iter().map(|step| [step.x, scaled(step)[low], scaled(step)[high]]).collect()).ink(ink)
        };
        let line = found.iter().map(|step| [step.x, scaled(step)[2]]).collect();
        let line_ink = if ink == Ink::Muted { Ink::Text } else { ink };
        axes = axes.with(band(0, 4)).with(band(1, 3)).with(Layer::line(name, line).ink(line_ink));
    }
    let examples = curves_of(real, curve).unwrap_or_default().into_iter().take(params.examples);
    for (number, (name, points)) in examples.enumerate() {
        let scaled = points.into_iter().map(|[x, y]| [x, y * factor]).collect();
        axes = axes.with(Layer::line(name, scaled).ink(Ink::Series(1 + number)));
    }
    let mut letters = curve.chars();
    let heading = letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect());
    Ok(Panel::new(heading, axes))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, run_stage};

    fn curves(level: f64) -> Table {
        let mut table = Table::new(["raster", "curve", "x", "y", "n"]);
        for k in 0..5 {
            for curve in ["variogram", "roughness", "spectrum"] {
                for i in 1..9 {
                    let (x, y) = (0.01 * f64::from(i), level * (1.0 + 0.1 * f64::from(k)) * f64::from(i));
                    table.push(vec![format!("r{k}").into(), curve.into(), x.into(), y.into(), 9.0.into()]);
                }
            }
        }
        table
    }

    fn drawn(with: &serde_json::Value) -> Result<String, StageError> {
        let inputs: [(&str, Artefact); 2] = [("reference", curves(1e-6).into()), ("simulated", curves(2e-6).into())];
        let outputs = run_stage::<DrawDescriptors>(&TestHost::default(), with, &inputs)?.into_inner();
        let Artefact::Figure(figure) = &outputs["figure"] else { panic!("a figure comes out") };
        Ok(figure.svg.clone())
    }

    #[test]
    fn every_curve_has_its_panel_and_says_how_many_rasters_it_is_from() {
        let svg = drawn(&json!({})).unwrap();
        for text in ["Variogram", "Roughness", "Spectrum", "5 real rasters, 5 simulated"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("r0") && drawn(&json!({"examples": 1})).unwrap().contains("r0"));
        assert!(!drawn(&json!({"curves": ["roughness"]})).unwrap().contains("Variogram"));
        assert!(drawn(&json!({"curves": ["variogram_45"]})).unwrap_err().message.contains("`variogram_45`"));
    }
}
