//! `rasterise-inventory`: burns the outlines of an inventory into a label raster.

use crate::rockfall::inventory_labels::burn;
use rockface_core::artefact::Sample;
use rockface_core::artefact::{Feature, Inventory, Kind, Raster};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::columns;

params! {
    /// Parameters of `rasterise-inventory`.
    pub struct RasteriseInventoryParams {
        /// Column whose whole number is the label of a feature; left out: features are numbered from 1.
        label: Option<String> = None,
    }
}

/// Draws the outlines of an inventory into a label raster on the grid of another raster.
pub struct RasteriseInventory;

impl Stage for RasteriseInventory {
    type Params = RasteriseInventoryParams;
    const NAME: &'static str = "rasterise-inventory";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("rasterise_inventory.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("grid", &[Kind::Raster], "Any raster on the grid wanted."),
        Port::one("inventory", &[Kind::Inventory], "The outlines."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "One band `labels`.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let model = inputs.one::<Raster>("grid")?;
        let inventory = inputs.one::<Inventory>("inventory")?;
        if model.frame != inventory.frame {
            fail!("the grid is in the {} frame, the inventory in the {} frame", model.frame, inventory.frame);
        }
        let features = labelled(inventory, params.label.as_deref())?;
        let values = burn(&features, &model.grid);
        let covered = values.iter().filter(|value| **value > 0.0).count();
        // The truth of a survey in which nothing happened has no features.
        if covered == 0 && !features.is_empty() {
            let count = features.len();
            fail!(
                "none of the {count} features covers the centre of a cell: is the inventory in the frame of the grid?"
            );
        }
        let without = features.iter().filter(|(_, feature)| feature.outline.is_empty()).count();
        if without > 0 {
            context.warn(format!("{without} features have no outline"));
        }
        let mut raster = Raster::single(model.grid, model.frame, "mask", "labels", values);
        raster.sample = Sample::Word;
        context.metric("covered_share", covered as f64 / model.grid.cells() as f64, "1");
        context.note(format!("{} features cover {covered} cells", features.len()));
        Ok(Outputs::of("raster", raster))
    }
}

/// Each feature with its label.
fn labelled<'a>(inventory: &'a Inventory, column: Option<&str>) -> Result<Vec<(u32, &'a Feature)>, StageError> {
    let place = column.map(|name| columns::place(&inventory.columns, name)).transpose()?;
    let label = |(number, feature): (usize, &'a Feature)| {
        let label = place.map_or(Some(number as f64 + 1.0), |place| feature.values[place].number());
        let whole = label.filter(|l| l.fract() == 0.0 && (1.0..=f64::from(u16::MAX)).contains(l));
        let named = column.unwrap_or("number");
        let error = || format!("feature {}: `{named}` is no whole number from 1 to {}", number + 1, u16::MAX);
        whole.map(|label| (label as u32, feature)).ok_or_else(|| StageError::new(error()))
    };
    inventory.features.iter().enumerate().map(label).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid, Polygon};
    use rockface_core::testing::{TestHost, run_stage};

    fn drawn(exterior: &[[f64; 2]], frame: Frame, with: &Value) -> Result<Raster, StageError> {
        let grid = Grid { columns: 4, rows: 3, cell_m: 1.0, left_m: 10.0, top_m: 3.0 };
        let raster = Raster::single(grid, Frame::Wall, "difference", "d", vec![0.5; 12]);
        let outline = vec![Polygon { exterior: exterior.to_vec(), holes: Vec::new() }];
        let features = vec![Feature { outline, values: vec![300.0.into(), 0.5.into()] }];
        let inventory = Inventory { frame, columns: vec!["id".into(), "volume".into()], features };
        let inputs = [("grid", raster.into()), ("inventory", inventory.into())];
        let outputs = run_stage::<RasteriseInventory>(&TestHost::default(), with, &inputs)?;
        let Artefact::Raster(found) = &outputs.into_inner()["raster"] else { panic!("a raster comes out") };
        Ok(found.clone())
    }

    const SQUARE: [[f64; 2]; 4] = [[11.0, 1.0], [13.0, 1.0], [13.0, 3.0], [11.0, 3.0]];

    #[test]
    fn a_polygon_labels_the_cells_whose_centres_it_holds() {
        let found = drawn(&SQUARE, Frame::Wall, &json!({"label": "id"})).unwrap();
        assert_eq!((found.sample, found.bands[0].name.as_str()), (Sample::Word, "labels"));
        let labelled: Vec<usize> = (0..12).filter(|i| found.bands[0].values[*i] > 299.0).collect();
        assert_eq!(labelled, [1, 2, 5, 6]);
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        let error = |exterior: &[[f64; 2]], frame, with: Value| drawn(exterior, frame, &with).unwrap_err().message;
        assert!(error(&SQUARE, Frame::World, json!({})).contains("world frame"));
        assert!(error(&SQUARE, Frame::Wall, json!({"label": "nr"})).contains("there are id, volume"));
        assert!(error(&SQUARE, Frame::Wall, json!({"label": "volume"})).contains("feature 1: `volume`"));
        let far = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]];
        assert!(error(&far, Frame::Wall, json!({})).contains("frame of the grid"));
    }

    #[test]
    fn an_inventory_without_features_is_a_raster_of_zeros() {
        let grid = Grid { columns: 4, rows: 3, cell_m: 1.0, left_m: 10.0, top_m: 3.0 };
        let raster = Raster::single(grid, Frame::Wall, "difference", "d", vec![0.5; 12]);
        let inventory = Inventory { frame: Frame::Wall, columns: vec!["id".into()], features: Vec::new() };
        let inputs = [("grid", raster.into()), ("inventory", inventory.into())];
        let outputs = run_stage::<RasteriseInventory>(&TestHost::default(), &json!({}), &inputs).unwrap();
        let Artefact::Raster(found) = &outputs.into_inner()["raster"] else { panic!("a raster comes out") };
        assert_eq!(found.bands[0].values, [0.0; 12]);
    }
}
