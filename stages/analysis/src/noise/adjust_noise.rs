//! `adjust-noise`: makes up for what a survey loses of the noise of a model, by comparing surveys simulated with it to draws of it.

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

/// The stage.
pub struct AdjustNoise;

/// Fewest simulated rasters.
const LEAST: usize = 2;

impl Stage for AdjustNoise {
    type Params = AdjustNoiseParams;
    const NAME: &'static str = "adjust-noise";
    const VERSION: u32 = 1;
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
            whitened.into_iter().map(|w| [w.log_strength, w.log_amplitude].concat()).collect()
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
        let losses: Vec<Loss> = (0..simulated[0].len()).map(|k| Loss::of(&simulated, &drawn, k)).collect();
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

/// What a survey does to one figure of the noise.
#[derive(Debug, Clone, Copy)]
struct Loss {
    /// Mean of the simulated rasters less that of the draws.
    difference: f64,
    /// Its standard error.
    error: f64,
}

impl Loss {
    fn of(simulated: &[Vec<f64>], drawn: &[Vec<f64>], figure: usize) -> Self {
        let moments = |rows: &[Vec<f64>]| {
            let n = rows.len() as f64;
            let mean = rows.iter().map(|row| row[figure]).sum::<f64>() / n;
            let squares = rows.iter().map(|row| (row[figure] - mean) * (row[figure] - mean)).sum::<f64>();
            [mean, squares / (n - 1.0) / n]
        };
        let ([a, of_a], [b, of_b]) = (moments(simulated), moments(drawn));
        Self { difference: a - b, error: (of_a + of_b).sqrt() }
    }

    /// The part of the difference that is not chance: it is shrunk by its variance (James and Stein 1961).
    fn certain(self) -> f64 {
        let squared = self.difference * self.difference;
        if squared > 0.0 { self.difference * (1.0 - self.error * self.error / squared).max(0.0) } else { 0.0 }
    }
}

/// The model with what is lost added: first the classes of place, then the bands.
fn adjusted(noise: &Noise, losses: &[Loss]) -> Noise {
    let (classes, bands) = losses.split_at(noise.class_log_strength.len());
    let mut adjusted = noise.clone();
    for member in &mut adjusted.members {
        member.log_strength.iter_mut().zip(classes).for_each(|(value, loss)| *value -= loss.certain());
    }
    adjusted.log_gain.iter_mut().zip(bands).for_each(|(gain, loss)| *gain -= loss.certain());
    adjusted
}

fn report(losses: &[Loss], noise: &Noise, context: &Context) {
    let (classes, bands) = losses.split_at(noise.class_log_strength.len());
    let percent = |losses: &[Loss]| {
        let one = |loss: &Loss| {
            format!("{:+.0}", 100.0 * (rockface_core::numerics::portable_math::exp(loss.certain()) - 1.0))
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
