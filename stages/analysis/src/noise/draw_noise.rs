//! `draw-noise`: a DEM with the noise of one acquisition of a learnt model, without a survey.

use crate::noise::learning::differences::{check, check_model};
use rockface_core::artefact::{Band, Cameras, Kind, Noise, Pairs, Raster};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_imaging::matching::elevation_step::elevation_step_m;
use rockface_imaging::matching::noise::ensemble::{Numbers, draw};
use rockface_imaging::matching::noise::parametric::Ground;

params! {
    /// Parameters of `draw-noise`.
    pub struct DrawNoiseParams {
        /// Number of the acquisition in the order of surveys, such as 0 before and 1 after: those with an even number draw from the fields of the first half
        /// of the rasters that the model was made of, those with an odd one from the second half. Two that are compared should have an even
        /// and an odd one: where both had the same field, their noise would cancel or double. Left out: all fields.
        acquisition: Option<u32> = None,
    }
}

/// Adds the noise of one acquisition of a learnt model to a DEM.
pub struct DrawNoise;

impl Stage for DrawNoise {
    type Params = DrawNoiseParams;
    const NAME: &'static str = "draw-noise";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("draw_noise.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("noise", &[Kind::Noise], "The model."),
        Port::one("dem", &[Kind::Raster], "Elevation of the face on the grid of the model, metres."),
        Port::one("cameras", &[Kind::Cameras], "Cameras of the survey."),
        Port::one("pairs", &[Kind::Pairs], "Its pairs."),
    ];
    const OUTPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "The DEM with the noise, metres; NaN in gaps of the acquisition.")];

    fn draws(_: &Self::Params) -> bool {
        true
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.total() + 22 * inputs.of("dem")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let noise = inputs.one::<Noise>("noise")?;
        let (dem, block, pairs) =
            (inputs.one::<Raster>("dem")?, inputs.one::<Cameras>("cameras")?, inputs.one::<Pairs>("pairs")?);
        check(&[dem], dem, block)?;
        check_model(noise, dem)?;
        let step_m = elevation_step_m(dem, block, pairs)?;
        let numbers = Numbers { acquisition: params.acquisition, replicate: None };
        let keys = |purpose: &str, item: &str| context.stream(purpose, item);
        let drawn = draw(noise, Ground::of(noise).as_ref(), numbers, &keys);
        let errors_px = drawn.errors_px(noise, &noise.strength);
        let elevations = &dem.bands[0].values;
        let values = elevations.iter().zip(errors_px).zip(step_m).map(|((z, px), step)| z + px * step).collect();
        let bands = vec![Band { name: dem.bands[0].name.clone(), values }];
        Ok(Outputs::of("raster", Raster { bands, ..dem.clone() }))
    }
}

#[cfg(test)]
mod tests;
