//! `transfer-noise`: brings a noise model to another face, or to a part of its own that it was not learnt on.

use crate::noise::learning::differences::{check, check_parts};
use crate::noise::learning::whitening::LEAST_SIDE_CELLS;
use crate::noise::transfer::{Setting, Transferred, transferred};
use rockface_core::artefact::{Cameras, Kind, Noise, Pairs, Raster};
use rockface_core::numerics::quantile::median;
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_imaging::matching::elevation_step::elevation_step_m;

params! {
    /// Parameters of `transfer-noise`.
    pub struct TransferNoiseParams {
        /// Whether the model has the coordinates of this face, so that its strength and fields hold where elevations agree. `false` for the
        /// model of another site: nothing is at the same place.
        same_site: bool = true,
        /// Cells of the new grid that a cell of the model's fields is worth. 1 where a cell covers as many pixels of the images as where
        /// the model was learnt; 2 where it covers half as many.
        field_scale: f64 = 1.0; Range::Between(0.1, 10.0),
    }
}

/// Brings a noise model to the grid and the geometry of another face.
pub struct TransferNoise;

impl Stage for TransferNoise {
    type Params = TransferNoiseParams;
    const NAME: &'static str = "transfer-noise";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("transfer_noise.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("noise", &[Kind::Noise], "The model."),
        Port::one("dem", &[Kind::Raster], "Elevation of the new face on the grid wanted, metres."),
        Port::one("cameras", &[Kind::Cameras], "Cameras of the new survey."),
        Port::one("pairs", &[Kind::Pairs], "Its pairs."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("noise", &[Kind::Noise], "The model on the grid of `dem`.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // Fields and weights of some forty members on the new cells.
        2 * inputs.of("noise") + 80 * inputs.of("dem")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let noise = inputs.one::<Noise>("noise")?;
        let (dem, block, pairs) =
            (inputs.one::<Raster>("dem")?, inputs.one::<Cameras>("cameras")?, inputs.one::<Pairs>("pairs")?);
        check(&[dem], dem, block)?;
        check_parts(noise)?;
        check_face(noise, dem)?;
        let step_m = elevation_step_m(dem, block, pairs)?;
        if step_m.iter().all(|step| step.is_nan()) {
            return Err(StageError::new("no pair shows a cell of `dem` that has an elevation")
                .hint("give cameras, pairs and DEM of one site in one frame"));
        }
        let setting = Setting { same_site: params.same_site, field_scale: params.field_scale };
        let found = transferred(noise, dem, setting);
        report(&found, dem, &step_m, params, context);
        Ok(Outputs::of("noise", found.noise))
    }
}

fn check_face(noise: &Noise, dem: &Raster) -> Result<(), StageError> {
    if noise.frame != dem.frame {
        let text = format!("the model is in the {} frame, `dem` in the {} frame", noise.frame, dem.frame);
        return Err(
            StageError::new(text).hint("bring mesh and cameras into the frame of the model with `transform-crs`")
        );
    }
    if dem.grid.columns.min(dem.grid.rows) < LEAST_SIDE_CELLS {
        let text = format!(
            "`dem` has {} x {} cells, {LEAST_SIDE_CELLS} are needed on each side",
            dem.grid.columns, dem.grid.rows
        );
        return Err(StageError::new(text).hint("rasterise a larger part of the face"));
    }
    Ok(())
}

fn report(found: &Transferred, dem: &Raster, step_m: &[f32], params: &TransferNoiseParams, context: &Context) {
    let cells = || (0..found.known.len()).filter(|i| !dem.bands[0].values[*i].is_nan());
    let strength = |known: bool| {
        let cells = cells().filter(|i| found.known[*i] == known);
        median(&mut cells.map(|i| f64::from(found.noise.strength[i])).collect::<Vec<_>>())
    };
    let share = cells().filter(|i| found.known[*i]).count() as f64 / cells().count() as f64;
    let shown = cells().filter(|i| !step_m[*i].is_nan());
    let noise_m = median(&mut shown.map(|i| f64::from(found.noise.strength[i] * step_m[i])).collect::<Vec<_>>());
    context.metric("known_share", share, "1");
    let mut notes = vec![format!("{:.1} % of the face is the one the model knows", 100.0 * share)];
    for (name, known, what) in
        [("strength_known_median", true, "learnt there"), ("strength_law_median", false, "by relief elsewhere")]
    {
        if let Some(px) = strength(known) {
            context.metric(name, px, "px");
            notes.push(format!("{px:.2} px of noise {what}"));
        }
    }
    if let Some(metres) = noise_m {
        context.metric("difference_median", metres, "m");
        notes.push(format!("a difference has {:.1} mm of noise at the median place", 1e3 * metres));
    }
    context.note(notes.join("; "));
    if params.same_site && share <= 0.0 {
        context.warn(
            "no cell of `dem` has the place and the elevation of one of the model: all strength is by relief; say `same_site: false` \
             if the model is of another site",
        );
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // values that are exact
mod tests;
