//! `draw-scores`: how near simulated rasters come to the real ones: scores by group, distances, and what makes them.

use std::collections::BTreeMap;

use crate::figure::chart::{Axes, Axis, Ink, Layer, Mark, Panel, Radar, Sheet, density, draw};
use crate::noise::descriptors::GROUPS;
use crate::noise::perfect_score::median_of_a_perfect_simulator;
use rockface_core::artefact::{Acceptance, Kind, Table};
use rockface_core::numerics::quantile::quantile;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `draw-scores`.
    pub struct DrawScoresParams {
        /// Title; left out, what is compared.
        title: Option<String> = None,
    }
}

/// The score of the threshold: one at the 95th percentile of the references leaves a twentieth of them beyond.
const LIMIT: f64 = 0.05;
/// A radar with fewer has no area.
const LEAST_SPOKES: usize = 3;
/// The group of all features.
const JOINT: &str = "all";

/// Draws the verdicts of `test-acceptance`.
pub struct DrawScores;

impl Stage for DrawScores {
    type Params = DrawScoresParams;
    const NAME: &'static str = "draw-scores";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("draw_scores.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("model", &[Kind::Acceptance], "The reference, from `fit-acceptance`."),
        Port::many("verdicts", &[Kind::Table], "Verdicts on simulated rasters, from `test-acceptance`."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("figure", &[Kind::Figure], "SVG.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let model = inputs.one::<Acceptance>("model")?;
        let columns = columns(&inputs.many::<Table>("verdicts")?.into_iter().map(|(_, t)| t).collect::<Vec<_>>());
        let d2 = of(&columns, "d2")?;
        if d2.len() < 2 {
            fail!("{} simulated rasters can be drawn, 2 are needed", d2.len());
        }
        let panels = [scores(model, &columns)?, distances(model, &columns, d2)?, contributions(&columns)];
        let title = params.title.clone().unwrap_or_else(|| "Simulated rasters against real ones".to_owned());
        let counts = format!("{} real rasters, {} simulated", model.references, d2.len());
        let sheet = Sheet::of(panels).title(title).subtitle(counts).columns(2).size(720, 330);
        let figure = draw(&sheet).map_err(|e| StageError::new(e.to_string()))?;
        Ok(Outputs::of("figure", figure))
    }
}

/// The numbers of every column of all tables.
fn columns(tables: &[&Table]) -> BTreeMap<String, Vec<f64>> {
    let mut all: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for table in tables {
        for (j, name) in table.columns.iter().enumerate() {
            all.entry(name.clone()).or_default().extend(table.rows.iter().filter_map(|row| row[j].number()));
        }
    }
    all
}

fn of<'a>(columns: &'a BTreeMap<String, Vec<f64>>, name: &str) -> Result<&'a [f64], StageError> {
    columns.get(name).filter(|values| !values.is_empty()).map(Vec::as_slice).ok_or_else(|| {
        StageError::new(format!("the verdicts have no numbers in a column `{name}`"))
            .hint("give the port `verdicts` of `test-acceptance`")
    })
}

/// The scores jointly and by group, on the spokes of a radar; as bars of their medians where they are too few for one.
fn scores(model: &Acceptance, columns: &BTreeMap<String, Vec<f64>>) -> Result<Panel, StageError> {
    let mut spokes = vec![("jointly".to_owned(), of(columns, "score")?)];
    let mut groups = vec![JOINT];
    for (group, _) in GROUPS {
        if let Some(scores) = columns.get(&format!("score_{group}")) {
            spokes.push((group.to_owned(), scores));
            groups.push(group);
        }
    }
    let at = |scores: &[f64], level: f64| quantile(scores, level).unwrap_or(f64::NAN);
    if spokes.len() < LEAST_SPOKES {
        let medians = spokes.into_iter().map(|(name, scores)| (name, at(scores, 0.5)));
        return Ok(Panel::new("Compatibility scores", Axes::bars("median score", medians)));
    }
    let band = |name: &str, opacity: f64, share: f64| {
        let ends = [0.5 - 0.5 * share, 0.5 + 0.5 * share];
        let ends = spokes.iter().map(|(_, scores)| ends.map(|level| at(scores, level))).collect();
        (name.to_owned(), Ink::Series(0), opacity, ends)
    };
    let perfect = |group: &&str| {
        let model_of = model.groups.get(*group);
        let median = model_of.and_then(|of| median_of_a_perfect_simulator(model.references as f64, of.features.len()));
        median.unwrap_or(f64::NAN)
    };
    let outlines = vec![
        ("median".to_owned(), Ink::Series(0), spokes.iter().map(|(_, scores)| at(scores, 0.5)).collect()),
        ("median of a perfect simulator".to_owned(), Ink::Text, groups.iter().map(perfect).collect()),
        (format!("S = {LIMIT}"), Ink::Series(1), vec![LIMIT; spokes.len()]),
    ];
    let bands = vec![band("95 %", 0.15, 0.95), band("75 %", 0.3, 0.75)];
    let spokes = spokes.iter().map(|(name, _)| name.clone()).collect();
    Ok(Panel::new("Compatibility scores", Radar { spokes, range: [0.0, 1.0], outlines, bands }))
}

fn distances(model: &Acceptance, columns: &BTreeMap<String, Vec<f64>>, d2: &[f64]) -> Result<Panel, StageError> {
    let log = |values: &[f64]| -> Vec<f64> {
        let positive = values.iter().filter(|d2| **d2 > 0.0 && **d2 < 1e12);
        positive.map(|d2| rockface_core::numerics::portable_math::log10(*d2)).collect()
    };
    let Some(all) = model.groups.get(JOINT) else { fail!("the acceptance model has no group `all`") };
    let threshold = of(columns, "threshold")?[0];
    let axes = Axes::new(Axis::linear("log10 of D²"), Axis::linear("density"))
        .with(density("real, leave-one-out", &log(&all.leave_one_out_d2)).ink(Ink::Text))
        .with(density("simulated", &log(d2)).ink(Ink::Series(0)))
        .with(Layer::new("threshold", Mark::AtX(rockface_core::numerics::portable_math::log10(threshold))));
    Ok(Panel::new("Distances", axes))
}

fn contributions(columns: &BTreeMap<String, Vec<f64>>) -> Panel {
    let known = GROUPS.iter().flat_map(|(_, features)| features.iter().copied());
    let others = columns.keys().filter_map(|name| name.strip_prefix("contribution_"));
    let mut names: Vec<&str> = known.filter(|name| columns.contains_key(&format!("contribution_{name}"))).collect();
    let further: Vec<&str> = others.filter(|name| !names.contains(name)).collect();
    names.extend(further);
    let mean = |name: &&str| {
        let values = &columns[&format!("contribution_{name}")];
        (plain(name), values.iter().sum::<f64>() / values.len() as f64)
    };
    Panel::new("What makes them", Axes::bars("mean contribution to D²", names.iter().map(mean)))
}

/// A feature without its unit: contributions to a distance have none.
fn plain(feature: &str) -> String {
    let stem = ["_m2", "_m"].iter().find_map(|unit| feature.strip_suffix(unit));
    stem.unwrap_or(feature).replace('_', " ")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::noise::mahalanobis::fit;
    use rockface_core::artefact::Artefact;
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{TestHost, run_stage};

    #[test]
    fn scores_distances_and_contributions_are_drawn() {
        let field = Key([4; 32]).field();
        let rows: Vec<Vec<f64>> = (0..30).map(|i| (0..2).map(|j| field.normal(i, j)).collect()).collect();
        let names = vec!["std_m".to_owned(), "sill_m2".to_owned()];
        let groups = BTreeMap::from([("all".to_owned(), fit(&names, &rows, 1e-3).unwrap())]);
        let model = Acceptance { references: 30, ridge: 1e-3, labels: vec![String::new(); 30], groups };
        let mut verdicts =
            Table::new(["d2", "threshold", "score", "score_marginal", "score_variogram", "contribution_sill_m2"]);
        for i in 0..8 {
            let x = f64::from(i);
            verdicts.push([1.0 + x, 6.0, 0.1 * x, 0.5, 0.2, x - 3.0].map(rockface_core::artefact::Cell::from).to_vec());
        }
        let draw = |verdicts: Table| {
            let inputs: [(&str, Artefact); 2] = [("model", model.clone().into()), ("verdicts", verdicts.into())];
            run_stage::<DrawScores>(&TestHost::default(), &json!({}), &inputs)
        };
        let outputs = draw(verdicts).unwrap().into_inner();
        let Artefact::Figure(figure) = &outputs["figure"] else { panic!("a figure comes out") };
        for text in [
            "jointly",
            "variogram",
            "30 real rasters, 8 simulated",
            "sill",
            "threshold",
            "S = 0.05",
            "perfect simulator",
        ] {
            assert!(figure.svg.contains(text), "{text}");
        }
        let mut few = Table::new(["d2", "threshold", "score", "contribution_sill_m2"]);
        for i in 0..8 {
            few.push([1.0 + f64::from(i), 6.0, 0.1, 1.0].map(rockface_core::artefact::Cell::from).to_vec());
        }
        let outputs = draw(few).unwrap().into_inner();
        let Artefact::Figure(bars) = &outputs["figure"] else { panic!("a figure comes out") };
        assert!(bars.svg.contains("median score") && bars.svg.contains("jointly"));
        assert_eq!([plain("sill_m2"), plain("spectral_slope")], ["sill", "spectral slope"]);
        assert!(draw(Table::new(["d2"])).err().unwrap().message.contains("`d2`"));
    }
}
