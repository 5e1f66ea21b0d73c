//! `median-rasters`: the median of several rasters at each cell, such as the DEMs of the pairs of a block.

use rayon::prelude::*;

use crate::grid;
use rockface_core::artefact::{Band, Kind, Raster, Sample};
use rockface_core::numerics::quantile::median;
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `median-rasters`.
    pub struct MedianRastersParams {
        /// Fewest values a cell needs; with fewer it has none.
        least: usize = 1; Range::AtLeast(1.0),
    }
}

/// Takes the median of several rasters at each cell: the fusion of a block that rasterises every pair by itself, or
/// the quiet background of a series.
pub struct MedianRasters;

impl Stage for MedianRasters {
    type Params = MedianRastersParams;
    const NAME: &'static str = "median-rasters";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("median_rasters.md"));
    const INPUTS: &'static [Port] =
        &[Port::many("raster", &[Kind::Raster], "Rasters on one grid: a stack of bands, or gathered.")];
    const OUTPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "Median of each cell over all bands of all rasters, one band.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.total() + 2 * inputs.largest("raster")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let rasters = inputs.many::<Raster>("raster")?;
        let (_, first) = rasters[0];
        for (_, other) in &rasters {
            if !grid::same(&first.grid, &other.grid) {
                let (a, b) = (grid::describe(&first.grid), grid::describe(&other.grid));
                return Err(StageError::new(format!("one raster has {a}, another {b}"))
                    .hint("rasterise all on one grid: port `grid` of `rasterise-dem`"));
            }
            if first.frame != other.frame || first.quantity != other.quantity {
                let (a, b) = (&first.quantity, &other.quantity);
                fail!(
                    "one raster holds `{a}` in the {} frame, another `{b}` in the {} frame",
                    first.frame,
                    other.frame
                );
            }
        }
        let bands: Vec<&[f32]> =
            rasters.iter().flat_map(|(_, raster)| &raster.bands).map(|band| band.values.as_slice()).collect();
        if params.least > bands.len() {
            fail!("`least` asks for {} values a cell, there are {} bands", params.least, bands.len());
        }
        let at = |cell: usize| {
            let mut values: Vec<f64> = bands.iter().map(|band| f64::from(band[cell])).filter(|v| !v.is_nan()).collect();
            let enough = values.len() >= params.least;
            median(&mut values).filter(|_| enough).map_or(f32::NAN, |middle| middle as f32)
        };
        let values: Vec<f32> = (0..first.grid.cells()).into_par_iter().map(at).collect();
        let known = values.iter().filter(|value| !value.is_nan()).count();
        context.metric("valid_share", known as f64 / values.len() as f64, "1");
        let bands = vec![Band { name: "median".to_owned(), values }];
        Ok(Outputs::of("raster", Raster { bands, sample: Sample::Float, ..first.clone() }))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

    fn stack(values: &[[f32; 2]]) -> Raster {
        let grid = Grid { columns: 2, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        let band = |v: &[f32; 2]| Band { name: "dem".into(), values: v.to_vec() };
        Raster {
            bands: values.iter().map(band).collect(),
            ..Raster::single(grid, Frame::Wall, "elevation", "", vec![])
        }
    }

    fn medians(rasters: &[Raster], with: &serde_json::Value) -> Result<Vec<f32>, StageError> {
        let inputs: Vec<(&str, Artefact)> = rasters.iter().map(|raster| ("raster", raster.clone().into())).collect();
        let outputs = run_stage::<MedianRasters>(&TestHost::default(), with, &inputs)?.into_inner();
        let Artefact::Raster(raster) = &outputs["raster"] else { panic!("a raster comes out") };
        Ok(raster.bands[0].values.clone())
    }

    #[test]
    fn gaps_do_not_count_and_too_few_values_make_one() {
        let nan = f32::NAN;
        let rasters = [stack(&[[1.0, nan], [5.0, 2.0]]), stack(&[[2.0, nan]])];
        assert_eq!(medians(&rasters, &json!({})).unwrap(), [2.0, 2.0]);
        let found = medians(&rasters, &json!({"least": 2})).unwrap();
        assert!((found[0] - 2.0).abs() < 1e-6 && found[1].is_nan());
        assert!(medians(&rasters, &json!({"least": 4})).unwrap_err().message.contains("4 values a cell, there are 3"));
    }

    #[test]
    fn another_grid_is_refused() {
        let mut moved = stack(&[[1.0, 2.0]]);
        moved.grid.left_m = 0.3;
        assert!(medians(&[stack(&[[1.0, 2.0]]), moved], &json!({})).is_err());
    }

    #[test]
    fn different_quantities_or_frames_are_refused() {
        let elevation = stack(&[[1.0, 2.0]]);
        let difference = Raster { quantity: "difference".to_owned(), ..elevation.clone() };
        let told = medians(&[elevation.clone(), difference], &json!({})).unwrap_err().message;
        assert!(told.contains("`elevation`") && told.contains("`difference`"), "{told}");
        let world = Raster { frame: Frame::World, ..elevation.clone() };
        let told = medians(&[elevation, world], &json!({})).unwrap_err().message;
        assert!(told.contains("wall frame") && told.contains("world frame"), "{told}");
    }
}
