//! `import-mask`: burns the polygons of a GeoJSON inventory into a label raster.

use serde_json::Value;

use crate::artefact::{Kind, Raster, Sample};
use crate::kernel::noise::polygons::{Polygon, burn, read};
use crate::params::FileRef;
use crate::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `import-mask`.
    pub struct ImportMaskParams {
        /// A GeoJSON file of polygons and multipolygons.
        path: FileRef,
        /// Property whose whole number is the label of a feature; left out: features are numbered from 1.
        label: Option<String> = None,
    }
}

/// The stage.
pub struct ImportMask;

impl Stage for ImportMask {
    type Params = ImportMaskParams;
    const NAME: &'static str = "import-mask";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Reads the outlines of an inventory, such as known rockfalls, into a label raster on the grid of another raster: 0 outside \
               every polygon, the label of the feature inside. `apply-mask` with `keep: zero` then leaves the events out.",
        method: "GeoJSON (RFC 7946) feature collections, features or bare geometries; holes by the even-odd rule. A cell belongs to a \
                 polygon where its centre does; a later feature covers an earlier one.",
        frames: "Coordinates are X and Y of the grid's frame in metres: along the face and up it in the wall frame. They are not \
                 geographic, whatever the standard says of longitude and latitude.",
        fails: "A file that is no GeoJSON; geometries other than polygons; rings of fewer than four positions or coordinates that \
                are no numbers; a label that is missing, or no whole number from 1 to 16777216; polygons that all miss the grid.",
        example: "rockface: 1\nname: leave-events-out\nsteps:\n  real: {stage: import-rasters, with: {path: real}}\n  \
                  events: {stage: import-mask, in: {grid: real.raster}, with: {path: events.geojson}}\n  \
                  clean: {stage: apply-mask, in: {raster: real.raster, mask: events.raster}, with: {keep: zero, grow_cells: 2}}\n",
    };
    const INPUTS: &'static [Port] = &[Port::one("grid", &[Kind::Raster], "Any raster on the grid wanted.")];
    const OUTPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "One band `labels`.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let model = inputs.one::<Raster>("grid")?;
        let bytes = context.read(&params.path)?;
        let whole: Value = serde_json::from_slice(&bytes)
            .map_err(|e| StageError::new(format!("`{}` is no JSON: {e}", params.path.0)))?;
        let polygons = read(&whole, params.label.as_deref())
            .map_err(|why| StageError::new(format!("`{}`: {why}", params.path.0)))?;
        let values = burn(&polygons, &model.grid);
        let covered = values.iter().filter(|value| **value > 0.0).count();
        if covered == 0 {
            let count = polygons.len();
            fail!(
                "none of the {count} polygons of `{}` covers the centre of a cell: is it in the frame of the grid?",
                params.path.0
            );
        }
        let mut raster = Raster::single(model.grid, model.frame, "mask", "labels", values);
        if polygons.iter().all(|Polygon { label, .. }| *label <= 255) {
            raster.sample = Sample::Byte;
        }
        context.metric("covered_share", covered as f64 / model.grid.cells() as f64, "1");
        context.note(format!("{} polygons cover {covered} cells", polygons.len()));
        Ok(Outputs::of("raster", raster))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::artefact::{Artefact, Frame, Grid};
    use crate::testing::{TestHost, run_stage};

    fn imported(text: &str) -> Result<Raster, StageError> {
        let grid = Grid { columns: 4, rows: 3, cell_m: 1.0, left_m: 10.0, top_m: 3.0 };
        let raster = Raster::single(grid, Frame::Wall, "difference", "d", vec![0.5; 12]);
        let host = TestHost::default().with("e.geojson", &[("e.geojson", text.as_bytes())]);
        let outputs = run_stage::<ImportMask>(&host, &json!({"path": "e.geojson"}), &[("grid", raster.into())])?;
        let Artefact::Raster(found) = &outputs.into_inner()["raster"] else { panic!("a raster comes out") };
        Ok(found.clone())
    }

    #[test]
    fn a_polygon_labels_the_cells_whose_centres_it_holds() {
        let square = r#"{"type": "Polygon", "coordinates": [[[11, 1], [13, 1], [13, 3], [11, 3], [11, 1]]]}"#;
        let found = imported(square).unwrap();
        assert_eq!((found.sample, found.bands[0].name.as_str()), (Sample::Byte, "labels"));
        let labelled: Vec<usize> = (0..12).filter(|i| found.bands[0].values[*i] > 0.0).collect();
        assert_eq!(labelled, [1, 2, 5, 6]);
    }

    #[test]
    fn what_is_no_inventory_is_refused() {
        let error = |text: &str| imported(text).unwrap_err().message;
        assert!(error("{").contains("no JSON"));
        assert!(error(r#"{"type": "Point", "coordinates": [1, 2]}"#).contains("Point"));
        let far = r#"{"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 0]]]}"#;
        assert!(error(far).contains("frame of the grid"));
    }
}
