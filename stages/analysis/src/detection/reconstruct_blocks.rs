//! `reconstruct-blocks`: makes blocks of what a comparison lost, to be taken out of a face again.

use crate::detection::{compared, solid};
use rockface_core::artefact::{Frame, Inventory, Kind, Meshes, Part, Raster};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::{columns, grid};
use rockface_rock::rockfall::block::Solid;

params! {
    /// Parameters of `reconstruct-blocks`.
    pub struct ReconstructBlocksParams {
        /// How far a block stands out of the face before, metres: enough to pass all of the true face over it.
        proud_m: f64 = 0.1; Range::Positive,
        /// Column whose words are the classes of the blocks; null: all are `observed`.
        class: Option<String> = None,
    }
}

/// Makes a closed block of each detection, between the elevations before and after, at its place.
pub struct ReconstructBlocks;

impl Stage for ReconstructBlocks {
    type Params = ReconstructBlocksParams;
    const NAME: &'static str = "reconstruct-blocks";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("reconstruct_blocks.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("detections", &[Kind::Inventory], "What was found, verified or not."),
        Port::one("reference", &[Kind::Raster], "Elevations before."),
        Port::one("comparison", &[Kind::Raster], "Elevations after, on the same grid."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("blocks", &[Kind::Meshes], "One closed mesh a detection.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let detections = inputs.one::<Inventory>("detections")?;
        let (before, after) = (inputs.one::<Raster>("reference")?, inputs.one::<Raster>("comparison")?);
        check(detections, before, after)?;
        let classes = params.class.as_ref().map(|name| columns::place(&detections.columns, name));
        let classes = classes.transpose()?;
        let grid = &before.grid;
        let (top, bottom) = (&before.bands[0].values, &after.bands[0].values);
        let heights = |row: usize, column: usize| {
            let cell = row * grid.columns + column;
            [f64::from(top[cell]), f64::from(bottom[cell])]
        };
        let cells = compared::cells(detections, grid, &vec![true; grid.cells()]);
        let mut parts = Vec::new();
        for ((cells, id), feature) in cells.iter().zip(compared::numbers(detections)).zip(&detections.features) {
            context.check_cancelled()?;
            let places: Vec<(usize, usize)> = cells.iter().map(|c| (c / grid.columns, c % grid.columns)).collect();
            let Some(facets) = solid::between(grid, &places, heights, params.proud_m) else {
                context.warn(format!("detection {id} covers no cell where the face retreated: no block"));
                continue;
            };
            let body = Solid { vertices: facets.vertices, triangles: facets.triangles };
            if let Err(flaw) = body.check() {
                context.warn(format!("detection {id} makes no solid: {flaw}"));
                continue;
            }
            let class = classes.map_or("observed".to_owned(), |at| feature.values[at].to_string());
            parts.push(Part { name: id.to_string(), class, vertices: body.vertices, triangles: body.triangles });
        }
        // Where nothing was found there is nothing to make.
        if parts.is_empty() && !detections.features.is_empty() {
            return Err(StageError::new(format!("none of the {} detections makes a block", detections.features.len()))
                .hint("are the rasters those the detections were found in?"));
        }
        context.metric("blocks", parts.len() as f64, "1");
        context.headline(format!("{} blocks of {} detections", parts.len(), detections.features.len()));
        Ok(Outputs::of("blocks", Meshes { frame: Frame::Wall, parts }))
    }
}

fn check(detections: &Inventory, before: &Raster, after: &Raster) -> Result<(), StageError> {
    if !grid::same(&before.grid, &after.grid) {
        let (a, b) = (grid::describe(&before.grid), grid::describe(&after.grid));
        fail!("the reference has {a}, the comparison {b}");
    }
    for (name, frame) in
        [("detections are", detections.frame), ("reference is", before.frame), ("comparison is", after.frame)]
    {
        if frame != Frame::Wall {
            fail!("the {name} in the {frame} frame; blocks are made in the wall frame");
        }
    }
    if before.bands.len() != 1 || after.bands.len() != 1 {
        fail!("elevations have one band, found {} and {}", before.bands.len(), after.bands.len());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Feature, Grid, Polygon};
    use rockface_core::testing::{TestHost, run_stage};

    const GRID: Grid = Grid { columns: 10, rows: 10, cell_m: 0.1, left_m: 0.0, top_m: 1.0 };

    fn elevation(z: f32) -> Raster {
        Raster::single(GRID, Frame::Wall, "elevation", "z", vec![z; 100])
    }

    fn found(lefts: &[f64]) -> Inventory {
        let feature = |left: &f64| {
            let exterior = vec![[*left, 0.2], [left + 0.3, 0.2], [left + 0.3, 0.4], [*left, 0.4]];
            Feature { outline: vec![Polygon { exterior, holes: Vec::new() }], values: vec![7.0.into()] }
        };
        Inventory { frame: Frame::Wall, columns: vec!["id".into()], features: lefts.iter().map(feature).collect() }
    }

    #[test]
    fn a_detection_becomes_a_block_of_its_volume() {
        let inputs = [
            ("detections", found(&[0.1]).into()),
            ("reference", elevation(0.5).into()),
            ("comparison", elevation(0.3).into()),
        ];
        let made = run_stage::<ReconstructBlocks>(&TestHost::default(), &json!({}), &inputs).unwrap().into_inner();
        let Artefact::Meshes(blocks) = &made["blocks"] else { panic!("no blocks") };
        let part = &blocks.parts[0];
        let body = Solid { vertices: part.vertices.clone(), triangles: part.triangles.clone() };
        assert_eq!((part.name.as_str(), part.class.as_str()), ("7", "observed"));
        assert!((body.volume() - 0.06 * 0.3).abs() < 1e-7, "{}", body.volume());
    }

    #[test]
    fn nothing_lost_or_another_grid_is_refused() {
        let run = |comparison: Raster| {
            let inputs = [
                ("detections", found(&[0.1]).into()),
                ("reference", elevation(0.5).into()),
                ("comparison", comparison.into()),
            ];
            run_stage::<ReconstructBlocks>(&TestHost::default(), &json!({}), &inputs).unwrap_err().message
        };
        assert!(run(elevation(0.6)).contains("none of the 1 detections"));
        let other = Raster { grid: Grid { left_m: 1.0, ..GRID }, ..elevation(0.3) };
        assert!(run(other).contains("the comparison 10 x 10"));
    }

    #[test]
    fn no_detections_make_no_blocks() {
        let inputs = [
            ("detections", found(&[]).into()),
            ("reference", elevation(0.5).into()),
            ("comparison", elevation(0.3).into()),
        ];
        let made = run_stage::<ReconstructBlocks>(&TestHost::default(), &json!({}), &inputs).unwrap().into_inner();
        assert!(matches!(&made["blocks"], Artefact::Meshes(blocks) if blocks.parts.is_empty()));
    }
}
