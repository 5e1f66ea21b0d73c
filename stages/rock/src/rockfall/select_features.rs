//! `select-features`: keeps the rockfalls of an inventory whose properties say so.

use rockface_core::artefact::{Cell, Feature, Inventory, Kind, Raster};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};
use rockface_raster::columns;

choice! {
    /// Where the survey ends.
    pub enum Border {
        /// At the edge of the raster, and at cells without a value that are connected to it.
        Outer = "outer",
        /// At every cell without a value: gaps inside the survey too.
        Gaps = "gaps",
    }
}

params! {
    /// What a property must be.
    pub struct Condition {
        /// Column.
        column: String,
        /// Texts or numbers it may be, as they are written; null: any.
        is: Option<Vec<String>> = None,
        /// Least number; null: any.
        min: Option<f64> = None,
        /// Greatest number; null: any.
        max: Option<f64> = None,
    }
}

params! {
    /// Parameters of `select-features`.
    pub struct SelectFeaturesParams {
        /// What must hold of a rockfall, all of it.
        keep: Vec<Condition> = Vec::new(),
        /// Rockfalls nearer than this to the border of the survey at `inside` are dropped, metres.
        margin_m: f64 = 0.0; Range::NonNegative,
        /// Where the survey at `inside` ends.
        border: Border = Border::Outer,
        /// How many at most, in their order; null: all; 0: an empty inventory, the truth of a survey in which nothing happened.
        count: Option<u32> = None,
    }
}

/// Keeps the rockfalls of an inventory whose properties lie in ranges or are among given words.
pub struct SelectFeatures;

impl Stage for SelectFeatures {
    type Params = SelectFeaturesParams;
    const NAME: &'static str = "select-features";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("select_features.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("inventory", &[Kind::Inventory], "The rockfalls."),
        Port::optional("inside", &[Kind::Raster], "The survey whose border counts; its first band."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("inventory", &[Kind::Inventory], "Those that are kept.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let inventory = inputs.one::<Inventory>("inventory")?;
        let inside = inputs.optional::<Raster>("inside")?;
        if let Some(raster) = inside.filter(|raster| raster.frame != inventory.frame) {
            fail!("the inventory is in the {} frame, the raster in the {} frame", inventory.frame, raster.frame);
        }
        let mut places = Vec::new();
        for condition in &params.keep {
            // An inventory without features may have no columns either.
            let is_empty = inventory.features.is_empty();
            places.push(if is_empty { 0 } else { columns::place(&inventory.columns, &condition.column)? });
        }
        let fitting = |feature: &&Feature| {
            params.keep.iter().zip(&places).all(|(condition, at)| fits(&feature.values[*at], condition))
        };
        let survey = inside.map(|raster| Survey::new(raster, params.border));
        let (mut features, mut at_border) = (Vec::new(), 0);
        for feature in inventory.features.iter().filter(fitting) {
            match &survey {
                Some(survey) if !survey.holds(feature, params.margin_m) => at_border += 1,
                _ => features.push(feature.clone()),
            }
        }
        features.truncate(params.count.map_or(usize::MAX, |count| count as usize));
        context.metric("kept", features.len() as f64, "1");
        if survey.is_some() {
            context.metric("at_border", f64::from(at_border), "1");
        }
        context.headline(format!("{} of {} rockfalls kept", features.len(), inventory.features.len()));
        Ok(Outputs::of("inventory", Inventory { features, ..inventory.clone() }))
    }
}

fn fits(cell: &Cell, condition: &Condition) -> bool {
    let Condition { is, min, max, .. } = condition;
    let among = is.as_ref().is_none_or(|words| words.contains(&cell.to_string()));
    let number = cell.number();
    let from = min.is_none_or(|least| number.is_some_and(|x| x >= least));
    among && from && max.is_none_or(|most| number.is_some_and(|x| x <= most))
}

/// The cells of a raster that lie inside a survey.
struct Survey<'a> {
    raster: &'a Raster,
    inside: Vec<bool>,
}

impl<'a> Survey<'a> {
    fn new(raster: &'a Raster, border: Border) -> Self {
        let has_value = raster.bands[0].values.iter().map(|value| !value.is_nan());
        let inside = match border {
            Border::Gaps => has_value.collect(),
            Border::Outer => enclosed(&has_value.collect::<Vec<_>>(), raster.grid.columns),
        };
        Self { raster, inside }
    }

    /// Whether every corner of an outline lies inside, and all cells within a distance in rows and columns of it.
    fn holds(&self, feature: &Feature, margin_m: f64) -> bool {
        let grid = &self.raster.grid;
        // A corner lies between cells: without a margin, those around it count.
        let reach = ((margin_m / grid.cell_m).ceil() as i64).max(1);
        let is_inside = |row: i64, column: i64| {
            let within = (0..grid.rows as i64).contains(&row) && (0..grid.columns as i64).contains(&column);
            within && self.inside[row as usize * grid.columns + column as usize]
        };
        let mut corners = feature.outline.iter().flat_map(|polygon| &polygon.exterior);
        corners.all(|corner| {
            let [column, row] = grid.in_cells(*corner).map(|cells| cells.round() as i64);
            (row - reach..row + reach).all(|r| (column - reach..column + reach).all(|c| is_inside(r, c)))
        })
    }
}

/// All cells but those without a value that are connected to the edge of the grid, over edges or corners of cells.
fn enclosed(has_value: &[bool], columns: usize) -> Vec<bool> {
    let rows = has_value.len() / columns;
    let mut inside = vec![true; has_value.len()];
    let at_edge = |cell: &usize| {
        let (row, column) = (cell / columns, cell % columns);
        row == 0 || row + 1 == rows || column == 0 || column + 1 == columns
    };
    let mut open: Vec<usize> = (0..has_value.len()).filter(|cell| at_edge(cell) && !has_value[*cell]).collect();
    open.iter().for_each(|cell| inside[*cell] = false);
    while let Some(cell) = open.pop() {
        let (row, column) = (cell / columns, cell % columns);
        for r in row.saturating_sub(1)..(row + 2).min(rows) {
            for c in column.saturating_sub(1)..(column + 2).min(columns) {
                let next = r * columns + c;
                if inside[next] && !has_value[next] {
                    inside[next] = false;
                    open.push(next);
                }
            }
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid, Polygon};
    use rockface_core::testing::{TestHost, run_stage};

    fn kept(with: &Value, inside: Option<Raster>) -> Result<Vec<f64>, StageError> {
        let feature = |(left, volume, word): (f64, Cell, &str)| {
            let exterior = vec![[left, 0.4], [left + 0.2, 0.4], [left + 0.2, 0.6], [left, 0.6]];
            Feature {
                outline: vec![Polygon { exterior, holes: Vec::new() }],
                values: vec![left.into(), volume, word.into()],
            }
        };
        let rows = [(0.1, Cell::from(1.0), "a"), (0.4, 2.0.into(), "b"), (0.7, Cell::Empty(()), "a")];
        let columns = ["left", "volume", "word"].map(str::to_owned).to_vec();
        let inventory = Inventory { frame: Frame::Wall, columns, features: rows.map(feature).to_vec() };
        let mut inputs = vec![("inventory", inventory.into())];
        inputs.extend(inside.map(|raster| ("inside", raster.into())));
        let made = run_stage::<SelectFeatures>(&TestHost::default(), with, &inputs)?;
        let Artefact::Inventory(found) = made.into_inner().remove("inventory").unwrap() else { panic!("none") };
        Ok(found.numbers("left").unwrap().into_iter().flatten().collect())
    }

    #[test]
    fn words_and_ranges_select() {
        assert_eq!(kept(&json!({}), None).unwrap(), [0.1, 0.4, 0.7]);
        assert_eq!(kept(&json!({"keep": [{"column": "word", "is": ["a"]}]}), None).unwrap(), [0.1, 0.7]);
        assert_eq!(kept(&json!({"keep": [{"column": "volume", "min": 1.5}]}), None).unwrap(), [0.4]);
        let both = json!({"keep": [{"column": "volume", "max": 1.5}, {"column": "word", "is": ["b"]}]});
        assert!(kept(&both, None).unwrap().is_empty());
        assert_eq!(kept(&json!({"count": 1}), None).unwrap(), [0.1]);
        assert!(kept(&json!({"count": 0}), None).unwrap().is_empty());
        assert!(
            kept(&json!({"keep": [{"column": "v"}]}), None).unwrap_err().message.contains("there are left, volume")
        );
    }

    #[test]
    fn what_lies_at_the_border_is_left_out() {
        let grid = Grid { columns: 10, rows: 10, cell_m: 0.1, left_m: 0.0, top_m: 1.0 };
        let mut raster = Raster::single(grid, Frame::Wall, "difference", "d", vec![0.0; 100]);
        assert_eq!(kept(&json!({"margin_m": 0.1}), Some(raster.clone())).unwrap(), [0.1, 0.4, 0.7]);
        assert_eq!(kept(&json!({"margin_m": 0.2}), Some(raster.clone())).unwrap(), [0.4]);
        // A gap inside the survey is no border: the greatest detachments have gaps behind their ledges.
        raster.bands[0].values[55] = f32::NAN;
        assert_eq!(kept(&json!({}), Some(raster.clone())).unwrap(), [0.1, 0.4, 0.7]);
        assert_eq!(kept(&json!({"border": "gaps"}), Some(raster.clone())).unwrap(), [0.1, 0.7]);
        // One that is open to the edge is.
        for cell in [65, 75, 85, 95] {
            raster.bands[0].values[cell] = f32::NAN;
        }
        assert_eq!(kept(&json!({}), Some(raster)).unwrap(), [0.1, 0.7]);
    }
}
