//! `draw-search`: the landscape of a calibration: how the score depends on the parameters that were tried.

use crate::figure::chart::{Axes, Axis, ColourKey, Ink, Layer, Mark, Panel, Sheet, draw};
use crate::noise::points::Scale;
use rockface_core::artefact::{Kind, Table};
use rockface_core::params::Fault;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::columns;

params! {
    /// Parameters of `draw-search`.
    pub struct DrawSearchParams {
        /// Columns of the searched parameters, a panel each; the first two make the landscape.
        parameters: Vec<String>,
        /// Column of the score, the smaller the better.
        objective: String = "score".to_owned(),
        /// Title; left out, what is drawn.
        title: Option<String> = None,
        /// Whether the axes of parameters are logarithmic.
        scale: Scale = Scale::Log,
    }
}

/// Draws the score of a search over its parameters.
pub struct DrawSearch;

impl Stage for DrawSearch {
    type Params = DrawSearchParams;
    const NAME: &'static str = "draw-search";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("draw_search.md"));
    const INPUTS: &'static [Port] =
        &[Port::many("points", &[Kind::Table], "Rows with parameters and score, as `ranking` of `refine-search`.")];
    const OUTPUTS: &'static [Port] = &[Port::one("figure", &[Kind::Figure], "SVG.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut fault = Fault::new("name at least one parameter");
        fault.path = vec!["parameters".to_owned()];
        if params.parameters.is_empty() { vec![fault] } else { Vec::new() }
    }

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let mut points =
            gathered(params, &inputs.many::<Table>("points")?.into_iter().map(|(_, t)| t).collect::<Vec<_>>())?;
        if points.len() < 2 {
            fail!("{} points of the search can be drawn, 2 are needed", points.len());
        }
        points.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut panels: Vec<Panel> = (0..params.parameters.len()).map(|j| profile(params, &points, j)).collect();
        if params.parameters.len() > 1 {
            panels.push(landscape(params, &points));
        }
        let title = params.title.clone().unwrap_or_else(|| "Landscape of the search".to_owned());
        let best = &points[points.len() - 1];
        let named: Vec<String> = params.parameters.iter().zip(&best.0).map(|(name, x)| format!("{name} {x}")).collect();
        let subtitle = format!("{} points; best {:.3} at {}", points.len(), best.1, named.join(", "));
        let sheet = Sheet::of(panels).title(title).subtitle(subtitle).columns(2).size(700, 300);
        let figure = draw(&sheet).map_err(|e| StageError::new(e.to_string()))?;
        Ok(Outputs::of("figure", figure))
    }
}

/// Parameters and score of every point that its axes can show.
fn gathered(params: &DrawSearchParams, tables: &[&Table]) -> Result<Vec<(Vec<f64>, f64)>, StageError> {
    let mut points = Vec::new();
    for table in tables {
        let column = |name: &String| columns::place(&table.columns, name);
        let (score, places) =
            (column(&params.objective)?, params.parameters.iter().map(column).collect::<Result<Vec<_>, _>>()?);
        for row in &table.rows {
            let values: Option<Vec<f64>> = places.iter().map(|j| row[*j].number()).collect();
            let shown = |x: &f64| params.scale == Scale::Linear || *x > 0.0;
            if let (Some(values), Some(score)) = (values, row[score].number().filter(|score| *score > 0.0))
                && values.iter().all(shown)
            {
                points.push((values, score));
            }
        }
    }
    Ok(points)
}

fn axis(params: &DrawSearchParams, j: usize) -> Axis {
    let name = params.parameters[j].as_str();
    let label = name.rsplit_once('_').filter(|(_, unit)| ["px", "m", "deg"].contains(unit));
    let label = label.map_or_else(|| name.to_owned(), |(stem, unit)| format!("{}, {unit}", stem.replace('_', " ")));
    if params.scale == Scale::Log { Axis::log(label) } else { Axis::linear(label) }
}

fn profile(params: &DrawSearchParams, points: &[(Vec<f64>, f64)], j: usize) -> Panel {
    let all: Vec<[f64; 2]> = points.iter().map(|(values, score)| [values[j], *score]).collect();
    let mut values: Vec<f64> = all.iter().map(|point| point[0]).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let lowest = |x: f64| {
        let scores: Vec<f64> = all.iter().filter(|p| p[0].to_bits() == x.to_bits()).map(|p| p[1]).collect();
        (scores.len() > 2).then(|| [x, scores.iter().copied().fold(f64::INFINITY, f64::min)])
    };
    let floor: Vec<[f64; 2]> = values.into_iter().filter_map(lowest).collect();
    let axes = Axes::new(axis(params, j), Axis::log(params.objective.clone()))
        .with(Layer::points("tried", all.clone()).ink(Ink::Muted))
        .with(Layer::line("lowest at each value", floor).ink(Ink::Series(0)))
        .with(Layer::points("best", vec![all[all.len() - 1]]).ink(Ink::Series(1)));
    Panel::new("", axes)
}

fn landscape(params: &DrawSearchParams, points: &[(Vec<f64>, f64)]) -> Panel {
    let log = |score: f64| rockface_core::numerics::portable_math::log10(score);
    let cells: Vec<[f64; 3]> = points.iter().map(|(values, score)| [values[0], values[1], log(*score)]).collect();
    let key = ColourKey::over(format!("log10 of {}", params.objective), cells.iter().map(|cell| cell[2]));
    let best = cells[cells.len() - 1];
    let axes = Axes::new(axis(params, 0), axis(params, 1))
        .colours(key)
        .with(Layer::new("", Mark::Valued(cells)))
        .with(Layer::points("best", vec![[best[0], best[1]]]).ink(Ink::Series(1)));
    Panel::new("Over the first two", axes)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, run_stage};

    fn drawn(with: &serde_json::Value) -> Result<String, StageError> {
        let mut table = Table::new(["local_px", "spacing_px", "score"]);
        for i in 1..5 {
            for j in 1..5 {
                let score = f64::from((i - 2) * (i - 2) + (j - 3) * (j - 3)) + 1.0;
                table.push(vec![(0.1 * f64::from(i)).into(), (10.0 * f64::from(j)).into(), score.into()]);
            }
        }
        let outputs = run_stage::<DrawSearch>(&TestHost::default(), with, &[("points", table.into())])?.into_inner();
        let Artefact::Figure(figure) = &outputs["figure"] else { panic!("a figure comes out") };
        Ok(figure.svg.clone())
    }

    #[test]
    fn the_best_point_is_told_and_axes_have_units() {
        let svg = drawn(&json!({"parameters": ["local_px", "spacing_px"]})).unwrap();
        for text in ["16 points", "local_px 0.2, spacing_px 30", "local, px", "Over the first two"] {
            assert!(svg.contains(text), "{text}");
        }
        let error = drawn(&json!({"parameters": ["focus"]})).unwrap_err();
        assert!(error.message.contains("`focus`") && error.message.contains("spacing_px"), "{error}");
    }
}
