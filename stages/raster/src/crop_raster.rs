//! `crop-raster`: the part of a raster within a window.

use crate::window;
use rockface_core::artefact::{Kind, Raster};
use rockface_core::params::Fault;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `crop-raster`.
    pub struct CropRasterParams {
        /// Window (left, right, bottom, top) in metres: the cells that lie in it whole are kept. It may reach beyond the raster.
        window_m: [f64; 4],
    }
}

/// Keeps the cells of a raster that lie in a window, in every band.
pub struct CropRaster;

impl Stage for CropRaster {
    type Params = CropRasterParams;
    const NAME: &'static str = "crop-raster";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("crop_raster.md"));
    const INPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "What is cropped, any number of bands.")];
    const OUTPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "The part in the window, with all bands in their order.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(Some(params.window_m))
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        2 * inputs.of("raster")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let whole = inputs.one::<Raster>("raster")?;
        let part = window::cropped(whole, params.window_m)?;
        if let Some(band) = part.bands.iter().find(|band| band.values.iter().all(|value| value.is_nan())) {
            return Err(StageError::new(format!("the window leaves no value of band `{}`", band.name))
                .hint("look at the raster with `draw-picture` and widen `window_m`"));
        }
        context.metric("columns", part.grid.columns as f64, "1");
        context.metric("rows", part.grid.rows as f64, "1");
        context.metric("kept_share", part.grid.cells() as f64 / whole.grid.cells() as f64, "1");
        Ok(Outputs::of("raster", part))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::{Artefact, Band, Frame, Grid, Noun};
    use rockface_core::params::ParamType;
    use rockface_core::testing::{TestHost, run_stage};

    fn crop(with: &Value) -> Result<Raster, StageError> {
        let grid = Grid { columns: 4, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
        let mut raster = Raster::single(grid, Frame::Wall, "difference", "z", vec![0.0, 1.0, 2.0, 3.0]);
        raster.bands.push(Band { name: "a".into(), values: vec![f32::NAN, f32::NAN, 5.0, 6.0] });
        let inputs: [(&str, Artefact); 1] = [("raster", raster.into())];
        let outputs = run_stage::<CropRaster>(&TestHost::default(), with, &inputs)?.into_inner();
        let Artefact::Raster(part) = &outputs["raster"] else { panic!("a raster comes out") };
        Ok(part.clone())
    }

    #[test]
    fn bands_keep_their_names_and_their_order() {
        let part = crop(&json!({"window_m": [1, 3, -5, 5]})).unwrap();
        assert_eq!(part.items().unwrap(), ["z", "a"]);
        assert_eq!(part.bands[0].values, [1.0, 2.0]);
        assert!(part.bands[1].values[0].is_nan() && part.quantity == "difference");
    }

    #[test]
    fn a_band_without_a_value_and_an_empty_window_are_refused() {
        assert!(crop(&json!({"window_m": [0, 2, 0, 1]})).unwrap_err().message.contains("`a`"));
        assert!(crop(&json!({"window_m": [7, 9, 0, 1]})).unwrap_err().message.contains("no whole cell"));
        let params = CropRasterParams::decode(&json!({"window_m": [2, 1, 0, 1]})).unwrap();
        assert_eq!(CropRaster::check(&params)[0].path, ["window_m"]);
    }
}
