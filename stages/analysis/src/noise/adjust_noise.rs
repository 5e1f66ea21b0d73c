//! `adjust-noise`: makes up for what a survey loses of the noise of a model, by comparing surveys simulated with it to draws of it.

use crate::noise::learning::departure::{Departure, Mean, figures};
use crate::noise::learning::differences::{check, check_model, gaps, level, per_step, seen, skewnesses};
use crate::noise::learning::whitening::{Places, whiten};
use crate::noise::learning::{bends, by_place, contrast};
use crate::noise::structure;
use rockface_core::artefact::{
    Band, Cameras, Kind, LevelContrast, LevelFigures, MOST_GAP_GAIN, MOST_SKEWNESS_GAIN, Noise, Pairs, Raster,
    UNEVENNESS,
};
use rockface_core::numerics::portable_math::{exp, log};
use rockface_core::numerics::trend::Trend;
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_imaging::matching::elevation_step::elevation_step_m;

params! {
    /// Parameters of `adjust-noise`.
    pub struct AdjustNoiseParams {
        /// Factor by which more is added to the gains of the bands than is lost of them (over-relaxation). Of what
        /// is added to the finest band about half is lost again, so that rounds which follow others need more than 1.
        relaxation: f64 = 1.0; Range::Between(0.5, 1.9),
    }
}

/// Makes up for what a survey loses of the noise of a model.
pub struct AdjustNoise;

/// Standard errors within which a difference counts as chance: what one round adds by chance the next one takes off.
const CHANCE_ERRORS: f64 = 1.0;
/// The same for gaps and skewness, of which a raster says little.
const MARK_ERRORS: f64 = 2.0;
/// Figures of a level of details: its unevenness, and the logarithms of its rms.
const OF_LEVEL: usize = UNEVENNESS + 3;
/// Fewest simulated rasters from which chance can be told.
const LEAST: usize = 2;
/// Most of what a draw loses that a usual raster loses.
const MOST_SHARE: f64 = 2.0;
/// Least and largest logarithm of the gain of a band. With a quarter of its amplitude a band adds next to nothing to the noise that a survey makes of its own there:
/// less would change nothing.
const LOG_GAINS: [f64; 2] = [-1.4, 3.0];

impl Stage for AdjustNoise {
    type Params = AdjustNoiseParams;
    const NAME: &'static str = "adjust-noise";
    const VERSION: u32 = 21;
    const PAGE: Page = Page::new(include_str!("adjust_noise.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("noise", &[Kind::Noise], "The model."),
        Port::many("simulated", &[Kind::Raster], "Differences of surveys simulated with it, metres, on its grid."),
        Port::many(
            "drawn",
            &[Kind::Raster],
            "Differences of `draw-noise` with the random numbers of the simulated ones, in their order.",
        ),
        Port::one("dem", &[Kind::Raster], "Elevation of the face on the same grid, metres."),
        Port::one("cameras", &[Kind::Cameras], "Cameras of the survey."),
        Port::one("pairs", &[Kind::Pairs], "Its pairs."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("noise", &[Kind::Noise], "The model, adjusted.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        3 * (inputs.of("simulated") + inputs.of("drawn")) + inputs.of("noise") + 60 * inputs.of("dem")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let noise = inputs.one::<Noise>("noise")?;
        let (dem, block, pairs) =
            (inputs.one::<Raster>("dem")?, inputs.one::<Cameras>("cameras")?, inputs.one::<Pairs>("pairs")?);
        check_model(noise, dem)?;
        let step_m = elevation_step_m(dem, block, pairs)?;
        let places = Places::of(noise.strength.clone());
        let columns = noise.grid.columns;
        let read = |port: &str| -> Result<(Vec<Vec<f32>>, Vec<Trend>), StageError> {
            let rasters: Vec<&Raster> = inputs.many::<Raster>(port)?.into_iter().map(|(_, raster)| raster).collect();
            check(&rasters, dem, block)?;
            let bands: Vec<&Band> = rasters.iter().flat_map(|raster| &raster.bands).collect();
            level(&bands, columns, &step_m, &noise.trend_weights)
        };
        let ((mut left, trends), (whole, _)) = (read("simulated")?, read("drawn")?);
        // Surveys are bent, as by `draw-registration`, and draws are not.
        bends::take_off(&mut left, &trends, &noise.bend_shapes);
        let (mut left, whole) = (per_step(left, &step_m), per_step(whole, &step_m));
        if left.len() != whole.len() {
            let text = format!("{} simulated rasters and {} drawn ones", left.len(), whole.len());
            return Err(StageError::new(text).hint("gather both over the same axes"));
        }
        if left.len() < LEAST {
            let text = format!("{} simulated raster, {LEAST} are needed to know what is chance", left.len());
            return Err(StageError::new(text).hint("simulate more surveys with the model"));
        }
        let (gap_factor, skewness_factor) = (gap_factor(&left, &whole), skewness_factor(&left, &whole));
        // What is lost by place is no loss of a class any more.
        let by_place = by_place::lost(&whole, &left, columns);
        left.iter_mut().for_each(|raster| by_place::times(raster, &by_place));
        let described = |disparities: &[Vec<f32>]| -> Result<Vec<Vec<f64>>, StageError> {
            let whitened = whiten(disparities, columns, &places);
            context.check_cancelled()?;
            let details = |raster: &Vec<f32>| {
                let levels = structure::levels(raster, columns, noise.contrast.levels.len());
                levels.into_iter().flat_map(|level| level.all().collect::<Vec<f64>>())
            };
            let row = |(w, raster)| figures(w).into_iter().chain(details(raster)).collect();
            Ok(whitened.iter().zip(disparities).map(row).collect())
        };
        let (simulated, drawn) = (described(&left)?, described(&whole)?);
        let losses = losses(&simulated, &drawn, &noise.contrast.levels);
        report(&losses, noise, [gap_factor, skewness_factor], context);
        let mut adjusted = adjusted(noise, &losses, params.relaxation);
        by_place::strengthen(&mut adjusted, &by_place);
        warn_of_bounds(&adjusted, &losses, context);
        adjusted.gap_gain = (adjusted.gap_gain * gap_factor).min(MOST_GAP_GAIN);
        adjusted.skewness_gain = (adjusted.skewness_gain * skewness_factor).min(MOST_SKEWNESS_GAIN);
        Ok(Outputs::of("noise", adjusted))
    }
}

/// The share of gaps of draws by that of surveys, which widen gaps, and have others where nothing is seen.
fn gap_factor(simulated: &[Vec<f32>], drawn: &[Vec<f32>]) -> f64 {
    let seen = seen(simulated.iter().chain(drawn).map(Vec::as_slice));
    let [simulated, drawn] = [simulated, drawn].map(|rasters| gaps(rasters, &seen));
    let more: Vec<[f64; 1]> = simulated.iter().zip(&drawn).map(|(survey, draw)| [survey[0] - draw[0]]).collect();
    let none = Mean { value: 0.0, squared_error: 0.0 };
    let more = Departure::of(Mean::of(&more, 0), none).certain(MARK_ERRORS);
    let wanted = Mean::of(&drawn, 0).value;
    if wanted > 0.0 { (wanted / (wanted + more)).clamp(0.5, 2.0) } else { 1.0 }
}

/// The skewness of draws by that of surveys with the same random numbers: the inverse slope of the line through 0.
fn skewness_factor(simulated: &[Vec<f32>], drawn: &[Vec<f32>]) -> f64 {
    let pairs: Vec<(f64, f64)> = skewnesses(drawn).into_iter().zip(skewnesses(simulated)).collect();
    let sum = |of: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|(drawn, left)| of(*drawn, *left)).sum::<f64>();
    let squares = sum(&|drawn, _| drawn * drawn);
    let slope = sum(&|drawn, left| drawn * left) / squares;
    let rest = sum(&|drawn, left| (left - slope * drawn) * (left - slope * drawn));
    let error = (rest / (pairs.len() as f64 - 1.0) / squares).sqrt();
    let more = Departure { difference: slope - 1.0, error }.certain(MARK_ERRORS);
    if more.is_finite() { 1.0 / (1.0 + more).clamp(0.5, 2.0) } else { 1.0 }
}

/// What simulated rasters lose of the figures of the draws beside them, and for details what usual ones lack of those of the rasters.
fn losses(simulated: &[Vec<f64>], drawn: &[Vec<f64>], levels: &[LevelContrast]) -> Vec<Departure> {
    // Acquisitions differ far more than what a survey loses, but both rasters of a pair have the same one.
    // Nothing is lost of levels that have no details.
    let lost = |(simulated, drawn): (&Vec<f64>, &Vec<f64>)| -> Vec<f64> {
        let differences = simulated.iter().zip(drawn).map(|(simulated, drawn)| simulated - drawn);
        differences.map(|lost| if lost.is_nan() { 0.0 } else { lost }).collect()
    };
    let mut lost: Vec<Vec<f64>> = simulated.iter().zip(drawn).map(lost).collect();
    let details = lost[0].len() - OF_LEVEL * levels.len();
    for (lost, drawn) in lost.iter_mut().zip(drawn) {
        let figures = lost[details..].chunks_exact_mut(OF_LEVEL).zip(drawn[details..].chunks_exact(OF_LEVEL));
        figures.zip(levels).for_each(|((lost, drawn), level)| to_usual(lost, drawn, level));
    }
    // Draws of the model may themselves depart from the rasters: that is made up for too.
    let lacking = |level: &LevelContrast| {
        let mut lacking: Vec<f64> = contrast::lacking(&level.drawn, &level.usual).all().collect();
        without_mean(&mut lacking[UNEVENNESS..]);
        lacking
    };
    let wanted = vec![0.0; details].into_iter().chain(levels.iter().flat_map(lacking));
    let loss = |(k, value)| Departure::of(Mean::of(&lost, k), Mean { value, squared_error: 0.0 });
    wanted.enumerate().map(loss).collect()
}

/// Brings what is lost of the details of a level to what a usual raster loses. Smoothing takes from strong places what it gives to weak ones: noise
/// as even as normal noise loses no unevenness, and noise that is more uneven loses more. Of the strength only what differs by orientation is left:
/// the rest is in the bands of frequency.
fn to_usual(lost: &mut [f64], drawn: &[f64], level: &LevelContrast) {
    let (unevenness, log_rms) = lost.split_at_mut(UNEVENNESS);
    let share = |k: usize| {
        let [usual, drawn] = [level.usual.unevenness[k], drawn[k]].map(|log_flatness| log_flatness - log(3.0));
        if usual > 0.0 && drawn > 0.0 { (usual / drawn).min(MOST_SHARE) } else { 1.0 }
    };
    let flatness = [share(0), share(1), share(2)];
    let cascade = flatness.iter().sum::<f64>() / 3.0;
    let shares = flatness.into_iter().chain(std::iter::repeat(cascade));
    unevenness.iter_mut().zip(shares).for_each(|(lost, share)| *lost *= share);
    without_mean(log_rms);
}

fn without_mean(values: &mut [f64]) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter_mut().for_each(|value| *value -= mean);
}

/// The model with what is lost added: first the classes of place, then the bands, `relaxation` times what they lose, then the details by level.
fn adjusted(noise: &Noise, losses: &[Departure], relaxation: f64) -> Noise {
    let (classes, bands, details) = parts(losses, noise);
    let mut adjusted = noise.clone();
    for member in &mut adjusted.members {
        member.log_strength.iter_mut().zip(classes).for_each(|(value, loss)| *value -= loss.certain(CHANCE_ERRORS));
    }
    let [least, most] = LOG_GAINS;
    for (gain, loss) in adjusted.log_gain.iter_mut().zip(bands) {
        *gain = (*gain - relaxation * loss.certain(CHANCE_ERRORS)).clamp(least, most);
    }
    let certain = |k: usize| -details[k].certain(CHANCE_ERRORS);
    contrast::make_up(&mut adjusted.contrast, |level| {
        let first = OF_LEVEL * level;
        LevelFigures {
            unevenness: std::array::from_fn(|k| certain(first + k)),
            log_rms: std::array::from_fn(|k| certain(first + UNEVENNESS + k)),
        }
    });
    adjusted
}

/// Says which bands have as much gain, or as little, as helps, and miss what they should have all the same.
fn warn_of_bounds(adjusted: &Noise, losses: &[Departure], context: &Context) {
    let bands = parts(losses, adjusted).1;
    let [least, most] = LOG_GAINS;
    let found = |is_at: &dyn Fn(f64, f64) -> bool| -> Option<(f64, f64)> {
        let all = adjusted.log_gain.iter().zip(bands).map(|(gain, loss)| (*gain, loss.certain(CHANCE_ERRORS)));
        let at: Vec<(usize, f64)> =
            all.enumerate().filter(|(_, (gain, loss))| is_at(*gain, *loss)).map(|(k, (_, loss))| (k, loss)).collect();
        let largest = at.iter().map(|(_, loss)| loss.abs()).fold(0.0, f64::max);
        Some((wavelength_cells(adjusted, at.first()?.0), exp(largest)))
    };
    if let Some((cells, times)) = found(&|gain, loss| gain <= least && loss > 0.0) {
        context.warn(format!(
            "surveys of this face make up to {times:.1} times as much noise of {cells:.0} and fewer cells as the model has, by themselves: simulated rasters \
             are rougher than the real ones there; were these filtered or resampled, or made of finer images than the cameras say?"
        ));
    }
    if let Some((cells, times)) = found(&|gain, loss| gain >= most && loss < 0.0) {
        context.warn(format!(
            "surveys of this face lose nearly all noise of {cells:.0} and fewer cells ({times:.1} times more is wanted): are the pixels of the cameras \
             larger than the cells of the rasters?"
        ));
    }
}

/// Wavelength in the middle of a band, cells.
fn wavelength_cells(noise: &Noise, band: usize) -> f64 {
    let side = noise.grid.columns.min(noise.grid.rows) as f64;
    let share = (band as f64 + 0.5) / (noise.bands() as f64 - 1.0);
    side * exp(-share * log(0.5 * side))
}

/// Losses of classes of place, of bands, and of details.
fn parts<'a>(losses: &'a [Departure], noise: &Noise) -> (&'a [Departure], &'a [Departure], &'a [Departure]) {
    let (classes, rest) = losses.split_at(noise.class_log_strength.len());
    let (bands, details) = rest.split_at(noise.bands());
    (classes, bands, details)
}

/// Losses, and the factors that the gains of gaps and of skewness get for them.
fn report(losses: &[Departure], noise: &Noise, [gap_factor, skewness_factor]: [f64; 2], context: &Context) {
    let (classes, bands, details) = parts(losses, noise);
    let percent = |losses: &[Departure]| {
        let one = |loss: &Departure| format!("{:+.0}", 100.0 * (exp(loss.certain(CHANCE_ERRORS)) - 1.0));
        losses.iter().map(one).collect::<Vec<_>>().join(" ")
    };
    context.metric("finest_band", bands.last().map_or(0.0, |loss| loss.difference), "1");
    context.metric("strongest_class", classes.last().map_or(0.0, |loss| loss.difference), "1");
    context.metric("gap_factor", gap_factor, "1");
    context.metric("skewness_factor", skewness_factor, "1");
    context.note(format!(
        "amplitudes of the simulated rasters beside those of the model, per cent: {} by class of place, {} by band, coarsest first; \
         details of usual ones beside those of the rasters: {} by level, finest first, each flatness along x, along y and diagonal, cascade to \
         two levels, and amplitude along x, along y and diagonal; the model now has {gap_factor:.2} times the gaps and {skewness_factor:.2} times the \
         skewness",
        percent(classes),
        percent(bands),
        percent(details)
    ));
}

#[cfg(test)]
mod tests;
