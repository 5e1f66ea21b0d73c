//! `adjust-noise`: makes up for what a survey loses of the noise of a model, by comparing surveys simulated with it to draws of it.

use crate::noise::learning::departure::{Departure, Mean, figures};
use crate::noise::learning::differences::{check, differences, disparities};
use crate::noise::learning::whitening::{BANDS, Places, whiten};
use rockface_core::artefact::{Band, Cameras, Kind, Noise, Pairs, Raster};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_imaging::matching::elevation_step::elevation_step_m;

params! {
    /// Parameters of `adjust-noise`.
    pub struct AdjustNoiseParams {
        /// Differences drawn from the model without a survey, to compare the simulated ones with.
        draws: usize = 16; Range::Between(2.0, 1000.0),
        /// Larger differences were filtered out of the simulated rasters, metres; left out: none were.
        outlier_m: Option<f64> = None; Range::Positive,
    }
}

/// Makes up for what a survey loses of the noise of a model.
pub struct AdjustNoise;

/// Standard errors within which a difference counts as chance. Acquisitions differ from each other far more than what a survey loses: a few
/// simulated ones say little of the coarsest noise and of the level, but much of the finest.
const CHANCE_ERRORS: f64 = 2.0;
/// Fewest simulated rasters.
const LEAST: usize = 2;

impl Stage for AdjustNoise {
    type Params = AdjustNoiseParams;
    const NAME: &'static str = "adjust-noise";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("adjust_noise.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("noise", &[Kind::Noise], "The model."),
        Port::many("simulated", &[Kind::Raster], "Differences of surveys simulated with it, metres, on its grid."),
        Port::one("dem", &[Kind::Raster], "Elevation of the face on the same grid, metres."),
        Port::one("cameras", &[Kind::Cameras], "Cameras of the survey."),
        Port::one("pairs", &[Kind::Pairs], "Its pairs."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("noise", &[Kind::Noise], "The model, adjusted.")];

    fn draws(_: &Self::Params) -> bool {
        true
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        6 * inputs.of("simulated") + 2 * inputs.of("noise") + 80 * inputs.of("dem")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let noise = inputs.one::<Noise>("noise")?;
        let (dem, block, pairs) =
            (inputs.one::<Raster>("dem")?, inputs.one::<Cameras>("cameras")?, inputs.one::<Pairs>("pairs")?);
        let rasters: Vec<&Raster> = inputs.many::<Raster>("simulated")?.into_iter().map(|(_, raster)| raster).collect();
        check(&rasters, dem, block)?;
        check_model(noise, dem)?;
        let bands: Vec<&Band> = rasters.iter().flat_map(|raster| &raster.bands).collect();
        if bands.len() < LEAST {
            let text = format!("{} simulated raster, {LEAST} are needed to know its spread", bands.len());
            return Err(StageError::new(text).hint("simulate more surveys with the model"));
        }
        let step_m = elevation_step_m(dem, block, pairs)?;
        let places = Places::of(noise.strength.clone());
        let rows = |differences: &[Vec<f32>]| -> Vec<Vec<f64>> {
            let whitened = whiten(differences, noise.grid.columns, &places);
            whitened.iter().map(figures).collect()
        };
        let simulated = rows(&disparities(&bands, &step_m)?);
        context.check_cancelled()?;
        let limit_m = params.outlier_m.map_or(f32::INFINITY, |limit| limit as f32);
        let drawn = rows(&differences(
            noise,
            params.draws,
            |cell, px| (px * step_m[cell]).abs() <= limit_m,
            &|purpose, item| context.stream(purpose, item),
        ));
        let loss = |k: usize| Departure::of(Mean::of(&simulated, k), Mean::of(&drawn, k));
        let losses: Vec<Departure> = (0..simulated[0].len()).map(loss).collect();
        report(&losses, noise, context);
        Ok(Outputs::of("noise", adjusted(noise, &losses)))
    }
}

fn check_model(noise: &Noise, dem: &Raster) -> Result<(), StageError> {
    if noise.grid != dem.grid || noise.frame != dem.frame {
        let text =
            format!("the model has {} x {} cells in the {} frame", noise.grid.columns, noise.grid.rows, noise.frame);
        return Err(StageError::new(format!("{text}, which are not those of `dem`"))
            .hint("give the DEM the model was learnt with"));
    }
    let classes = Places::of(noise.strength.clone()).middles.len();
    if noise.bands() != BANDS || noise.class_log_strength.len() != classes {
        fail!(
            "the model has {} bands and {} classes of place, not {BANDS} and {classes}",
            noise.bands(),
            noise.class_log_strength.len()
        );
    }
    Ok(())
}

/// The model with what is lost added: first the classes of place, then the bands.
fn adjusted(noise: &Noise, losses: &[Departure]) -> Noise {
    let (classes, bands) = losses.split_at(noise.class_log_strength.len());
    let mut adjusted = noise.clone();
    for member in &mut adjusted.members {
        member.log_strength.iter_mut().zip(classes).for_each(|(value, loss)| *value -= loss.certain(CHANCE_ERRORS));
    }
    adjusted.log_gain.iter_mut().zip(bands).for_each(|(gain, loss)| *gain -= loss.certain(CHANCE_ERRORS));
    adjusted
}

fn report(losses: &[Departure], noise: &Noise, context: &Context) {
    let (classes, bands) = losses.split_at(noise.class_log_strength.len());
    let percent = |losses: &[Departure]| {
        let one = |loss: &Departure| {
            format!("{:+.0}", 100.0 * (rockface_core::numerics::portable_math::exp(loss.certain(CHANCE_ERRORS)) - 1.0))
        };
        losses.iter().map(one).collect::<Vec<_>>().join(" ")
    };
    context.metric("finest_band", bands.last().map_or(0.0, |loss| loss.difference), "1");
    context.metric("strongest_class", classes.last().map_or(0.0, |loss| loss.difference), "1");
    context.note(format!(
        "amplitudes of the simulated rasters beside those of the model, per cent: {} by class of place, {} by band, coarsest first",
        percent(classes),
        percent(bands)
    ));
}

#[cfg(test)]
mod tests;
