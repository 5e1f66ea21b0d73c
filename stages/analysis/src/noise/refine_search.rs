//! `refine-search`: from the scores of a coarse search, the points of a finer one around its best.

use crate::noise::points::{ITEM, MOST_DIMENSIONS, Scale, coordinates, halton, positions, rounded, spacing};
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

choice! {
    /// How the scores of one point are put together.
    pub enum Statistic {
        /// Their median.
        Median = "median",
        /// Their mean.
        Mean = "mean",
    }
}

params! {
    /// Parameters of `refine-search`.
    pub struct RefineSearchParams {
        /// Names of the searched parameters: columns of `scores`, axes they were gathered over, or columns of `points`.
        parameters: Vec<String>,
        /// Column that is to become small.
        objective: String = "d2".to_owned(),
        /// How the scores of one point (of its replicates) are put together.
        statistic: Statistic = Statistic::Median,
        /// How many of the best points are refined around.
        best: usize = 8; Range::Between(1.0, 1e6),
        /// How many new points are made.
        count: usize = 200; Range::Between(1.0, 1e6),
        /// Reach of the new points, as a share of the distance to the neighbouring coarse value.
        reach: f64 = 0.75; Range::Positive,
        /// Whether distances are those of the values or of their logarithms.
        scale: Scale = Scale::Log,
        /// Whether new points may lie outside the range of the coarse ones.
        beyond: bool = false,
    }
}

/// Ranks the points of a search by a score, the smaller the better, and lays new points around the best.
pub struct RefineSearch;

impl Stage for RefineSearch {
    type Params = RefineSearchParams;
    const NAME: &'static str = "refine-search";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("refine_search.md"));
    const INPUTS: &'static [Port] = &[
        Port::many("scores", &[Kind::Table], "Rows with the score, gathered over the axes of the search or tabulated."),
        Port::optional("points", &[Kind::Table], "Where an axis of table rows was searched: that table."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("points", &[Kind::Table], "The new points: `item`, parameters, rank of the point they surround."),
        Port::one("ranking", &[Kind::Table], "The old points from the best on: parameters, count, score, quartiles."),
        Port::one("best", &[Kind::Table], "The best old point, one row called `best`: an axis for its replicates."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let n = params.parameters.len();
        let message = if n == 0 {
            Some("name at least one parameter".to_owned())
        } else if n > MOST_DIMENSIONS {
            Some(format!("{n} parameters are too many for one search: at most {MOST_DIMENSIONS}"))
        } else if params.parameters.iter().any(|name| name == ITEM || name == "rank") {
            Some(format!("`{ITEM}` and `rank` are columns of the points: call the parameter otherwise"))
        } else {
            None
        };
        let at = |message| Fault { path: vec!["parameters".to_owned()], ..Fault::new(message) };
        message.map(at).into_iter().collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut ranked = gathered_points(params, inputs)?;
        if ranked.len() < 2 {
            fail!("the search has {} point: there is no distance to refine", ranked.len());
        }
        ranked.sort_by(|a, b| a.score.total_cmp(&b.score));
        let best = &ranked[0];
        let named: Vec<String> =
            params.parameters.iter().zip(&best.values).map(|(name, value)| format!("{name} {value}")).collect();
        context.metric("best", best.score, "1");
        context.headline(format!(
            "best of {} points: {} with {} {:.4}",
            ranked.len(),
            named.join(", "),
            params.objective,
            best.score
        ));
        Ok(Outputs::of("points", new_points(params, &ranked))
            .and("ranking", ranking(params, &ranked))
            .and("best", best_point(params, &ranked[0])))
    }
}

/// A point of the search with its scores.
struct Scored {
    values: Vec<f64>,
    positions: Vec<f64>,
    scores: Vec<f64>,
    score: f64,
}

fn gathered_points(params: &RefineSearchParams, inputs: &Inputs) -> Result<Vec<Scored>, StageError> {
    let points = inputs.optional::<Table>("points")?;
    let mut found: Vec<Scored> = Vec::new();
    for (items, table) in inputs.many::<Table>("scores")? {
        let Some(objective) = table.column(&params.objective) else {
            let columns = table.columns.join(", ");
            fail!("`scores` has no column `{}`; it has {columns}", params.objective);
        };
        for row in &table.rows {
            let values = coordinates(&params.parameters, items, table, row, points)?;
            let Some(score) = row[objective].number() else {
                fail!("`{}` has no number at {}", params.objective, place(params, &values));
            };
            if let Some(known) = found.iter_mut().find(|point| same(&point.values, &values)) {
                known.scores.push(score);
            } else {
                let positions = positions(params.scale, &params.parameters, &values)?;
                found.push(Scored { values, positions, scores: vec![score], score: f64::NAN });
            }
        }
    }
    for point in &mut found {
        let mean = point.scores.iter().sum::<f64>() / point.scores.len() as f64;
        let median = quantile(&point.scores, 0.5).unwrap_or(f64::NAN);
        point.score = if params.statistic == Statistic::Mean { mean } else { median };
    }
    Ok(found)
}

fn same(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

fn place(params: &RefineSearchParams, values: &[f64]) -> String {
    let named: Vec<String> =
        params.parameters.iter().zip(values).map(|(name, value)| format!("{name}={value}")).collect();
    named.join(" ")
}

fn new_points(params: &RefineSearchParams, ranked: &[Scored]) -> Table {
    let columns = std::iter::once(ITEM.to_owned()).chain(params.parameters.iter().cloned());
    let mut table = Table::new(columns.chain(std::iter::once("rank".to_owned())));
    let best = params.best.min(ranked.len());
    for k in 0..params.count {
        let parent = k % best;
        let coordinate = |j: usize| {
            let all: Vec<f64> = ranked.iter().map(|point| point.positions[j]).collect();
            let at = ranked[parent].positions[j];
            let [below, above] = spacing(&all, at);
            let t = 2.0 * halton((k / best) as u64 + 1, j) - 1.0;
            let moved = at + params.reach * t * if t < 0.0 { below } else { above };
            let (low, high) = all.iter().fold((at, at), |(low, high), p| (low.min(*p), high.max(*p)));
            let kept = if params.beyond { moved } else { moved.clamp(low, high) };
            rounded(params.scale.to_value(kept))
        };
        let mut row = vec![Cell::from(format!("r{k}"))];
        row.extend((0..params.parameters.len()).map(|j| Cell::from(coordinate(j))));
        row.push(((parent + 1) as f64).into());
        table.push(row);
    }
    table
}

fn best_point(params: &RefineSearchParams, best: &Scored) -> Table {
    let columns = std::iter::once(ITEM.to_owned()).chain(params.parameters.iter().cloned());
    let mut table = Table::new(columns.chain(std::iter::once("score".to_owned())));
    let values = best.values.iter().copied().chain(std::iter::once(best.score)).map(Cell::from);
    table.push(std::iter::once(Cell::from("best")).chain(values).collect());
    table
}

fn ranking(params: &RefineSearchParams, ranked: &[Scored]) -> Table {
    let own = ["rank", "count", "score", "q25", "q75"].map(str::to_owned);
    let mut table = Table::new(params.parameters.iter().cloned().chain(own));
    for (rank, point) in ranked.iter().enumerate() {
        let mut row: Vec<Cell> = point.values.iter().map(|value| Cell::from(*value)).collect();
        let quartile = |q: f64| quantile(&point.scores, q).unwrap_or(f64::NAN);
        let numbers = [(rank + 1) as f64, point.scores.len() as f64, point.score, quartile(0.25), quartile(0.75)];
        row.extend(numbers.map(Cell::from));
        table.push(row);
    }
    table
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::numerics::portable_math;
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;

    /// A bowl with its bottom at a = 2, b = 30 on a grid, two replicates a point.
    fn refined(with: &Value) -> Result<(Table, Table), StageError> {
        let mut inputs = Inputs::default();
        for a in [1.0f64, 2.0, 4.0] {
            for b in [10.0f64, 30.0, 90.0] {
                let mut table = Table::new(["raster", "d2"]);
                let d2 = {
                    let (u, v) = (portable_math::log(a / 2.0), portable_math::log(b / 30.0));
                    u * u + v * v
                };
                table.push(vec!["x".into(), (d2 + 0.1).into()]);
                table.push(vec!["y".into(), (d2 + 0.3).into()]);
                let point = [("a".to_owned(), a.to_string()), ("b".to_owned(), b.to_string())].into();
                inputs.push("scores", point, Arc::new(table.into()));
            }
        }
        let params = RefineSearchParams::decode(with).unwrap();
        let outputs = RefineSearch::run(&params, &inputs, &Context::new(&TestHost::default()))?.into_inner();
        let [Artefact::Table(points), Artefact::Table(ranking)] = [&outputs["points"], &outputs["ranking"]] else {
            panic!("two tables come out");
        };
        Ok((points.clone(), ranking.clone()))
    }

    #[test]
    fn new_points_surround_the_best_and_stay_inside() {
        let (points, ranking) =
            refined(&json!({"parameters": ["a", "b"], "best": 2, "count": 40, "reach": 1})).unwrap();
        let numbers = |row: &[Cell]| row.iter().filter_map(Cell::number).collect::<Vec<_>>();
        assert_eq!(numbers(&ranking.rows[0])[..4], [2.0, 30.0, 1.0, 2.0]);
        assert!((numbers(&ranking.rows[0])[4] - 0.2).abs() < 1e-12);
        assert_eq!((points.rows.len(), points.columns[0].as_str(), &points.rows[3][0]), (40, ITEM, &"r3".into()));
        for row in points.rows.iter().step_by(2) {
            let [a, b, rank] = numbers(row)[..] else { panic!("three numbers") };
            assert!((1.0..=4.0).contains(&a) && (10.0..=90.0).contains(&b) && (rank - 1.0).abs() < 1e-9);
        }
        let (more, _) = refined(&json!({"parameters": ["a", "b"], "best": 2, "count": 60, "reach": 1})).unwrap();
        assert_eq!(more.rows[..40], points.rows);
    }

    #[test]
    fn what_cannot_be_searched_is_refused() {
        let error = |with: Value| refined(&with).unwrap_err().message;
        assert!(error(json!({"parameters": ["c"]})).contains("`c` has no number"));
        assert!(error(json!({"parameters": ["a"], "objective": "cost"})).contains("raster, d2"));
        let row = rockface_core::Row::<RefineSearch>::new();
        assert!(rockface_core::AnyStage::check(&row, &json!({"parameters": []})).is_err());
    }
}
