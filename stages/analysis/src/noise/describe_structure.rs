//! `describe-structure`: turns difference rasters into figures of their fine structure, which `compare-samples` looks at.

use rayon::prelude::*;

use crate::noise::structure::{Settings, names, structure};
use rockface_core::artefact::{Band, Cell, Kind, Raster, Table};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `describe-structure`.
    pub struct DescribeStructureParams {
        /// Lags of the increments, cells along each axis.
        lags_cells: Vec<u32> = vec![1, 2, 4, 8]; Range::Between(1.0, 1000.0),
        /// Levels of the Haar pyramid; the coarsest takes blocks of 2 to this power cells a side. Left out: 5, or as many as fit into small rasters.
        levels: Option<u32> = None; Range::Between(1.0, 12.0),
        /// Columns of blocks whose strength is compared.
        block_columns: u32 = 6; Range::Between(1.0, 64.0),
        /// Rows of blocks.
        block_rows: u32 = 5; Range::Between(1.0, 64.0),
    }
}

/// Turns difference rasters into about a hundred figures of their fine structure: increments in four directions,
/// details of a Haar pyramid, how they alternate between strong and weak, tails, and where on the face the noise is
/// strong.
pub struct DescribeStructure;

impl Stage for DescribeStructure {
    type Params = DescribeStructureParams;
    const NAME: &'static str = "describe-structure";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("describe_structure.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "Differences without rockfall, metres, any number of bands.")];
    const OUTPUTS: &'static [Port] =
        &[Port::one("features", &[Kind::Table], "One row a band: `raster`, then the figures, natural logarithms.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // A copy in double precision and one pyramid with its moduli.
        8 * inputs.of("raster")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let raster = inputs.one::<Raster>("raster")?;
        let settings = Settings {
            lags_cells: params.lags_cells.iter().map(|lag| *lag as usize).collect(),
            levels: params.levels.unwrap_or_else(|| usual_levels(raster)) as usize,
            blocks: [params.block_columns as usize, params.block_rows as usize],
        };
        check_size(&settings, raster)?;
        let one = |band: &Band| -> Result<Vec<f64>, StageError> {
            context.check_cancelled()?;
            structure(&band.values, raster.grid.columns, &settings).map_err(|e| {
                e.within(format!("band `{}` cannot be described", band.name)).hint(
                    "look at it with `draw-picture`; leave it out, or ask for fewer `levels` or shorter `lags_cells`",
                )
            })
        };
        let found: Vec<Result<Vec<f64>, StageError>> = raster.bands.par_iter().map(one).collect();
        let mut table = Table::new(std::iter::once("raster".to_owned()).chain(names(&settings)));
        for (band, figures) in raster.bands.iter().zip(found) {
            let figures = figures?.into_iter().map(Cell::from);
            table.push(std::iter::once(Cell::from(band.name.as_str())).chain(figures).collect());
        }
        context.note(format!("{} figures of {} rasters", table.columns.len() - 1, table.rows.len()));
        Ok(Outputs::of("features", table))
    }
}

/// Levels that rasters have which are large enough.
const USUAL_LEVELS: u32 = 5;

/// The usual levels, or as many as have two blocks on each side.
fn usual_levels(raster: &Raster) -> u32 {
    let side = raster.grid.columns.min(raster.grid.rows).max(4);
    (side.ilog2() - 1).min(USUAL_LEVELS)
}

/// Every lag and every level needs two of its steps or blocks at least.
fn check_size(settings: &Settings, raster: &Raster) -> Result<(), StageError> {
    let side = raster.grid.columns.min(raster.grid.rows);
    let size = format!("a raster of {} x {} cells", raster.grid.columns, raster.grid.rows);
    let refuse = |what: String, hint: &str| Err(StageError::new(format!("{what} is too much for {size}")).hint(hint));
    if let Some(lag) = settings.lags_cells.iter().find(|lag| 2 * **lag > side) {
        return refuse(format!("a lag of {lag} cells"), "list shorter `lags_cells`, the same for all rasters compared");
    }
    if (2usize << settings.levels) > side {
        return refuse(format!("a pyramid of {} levels", settings.levels), "lower `levels` for all rasters compared");
    }
    let blocks = settings.blocks[0].max(settings.blocks[1]);
    if 2 * blocks > side {
        return refuse(format!("a row of {blocks} blocks"), "lower `block_columns` and `block_rows`");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid, Noun};
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::{TestHost, run_stage};

    fn described(side: usize, with: &Value) -> Result<Table, StageError> {
        let grid = Grid { columns: side, rows: side, cell_m: 0.01, left_m: 0.0, top_m: 0.0 };
        let mut raster = Raster::single(grid, Frame::Wall, "difference", "", Vec::new());
        let band = |b: u8| {
            let field = Key([b; 32]).field();
            let value = |i: usize| field.normal((i % side) as i32, (i / side) as i32) as f32;
            Band { name: format!("n{b}"), values: (0..side * side).map(value).collect() }
        };
        raster.bands = (0..3).map(band).collect();
        let outputs = run_stage::<DescribeStructure>(&TestHost::default(), with, &[("raster", raster.into())])?;
        let Artefact::Table(table) = &outputs.into_inner()["features"] else { panic!("a table comes out") };
        Ok(table.clone())
    }

    #[test]
    fn one_row_a_band_with_a_hundred_figures() {
        let table = described(80, &json!({})).unwrap();
        assert_eq!((table.rows.len(), table.columns.len()), (3, 1 + 32 + 30 + 10 + 4 + 30));
        assert!(table.rows.iter().all(|row| row[1..].iter().all(|cell| cell.number().is_some_and(f64::is_finite))));
    }

    #[test]
    fn small_rasters_have_fewer_levels() {
        let levels = |side: usize| {
            let with = json!({"lags_cells": [1, 2], "block_columns": 2, "block_rows": 2});
            let table = described(side, &with).unwrap();
            table.columns.iter().filter(|name| name.starts_with("haar_diagonal_") && name.ends_with("_rms")).count()
        };
        assert_eq!([8, 16, 32, 63, 64, 128].map(levels), [2, 3, 4, 4, 5, 5]);
    }

    #[test]
    fn the_thread_count_does_not_change_a_bit() {
        let bytes = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| described(70, &json!({"levels": 4})).unwrap().encode().unwrap())
        };
        assert_eq!(bytes(1), bytes(3));
    }

    #[test]
    fn what_is_too_large_for_the_raster_is_refused() {
        for (with, what) in [
            (json!({"levels": 5}), "a pyramid of 5 levels"),
            (json!({"lags_cells": [1, 17]}), "a lag of 17 cells"),
            (json!({"levels": 2, "block_rows": 20}), "a row of 20 blocks"),
        ] {
            let error = described(32, &with).unwrap_err();
            assert!(error.message.contains(what) && error.message.contains("32 x 32"), "{error}");
        }
    }
}
