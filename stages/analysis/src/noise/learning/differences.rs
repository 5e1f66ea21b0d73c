//! Differences as errors of disparity on the grid of a model: of rasters, and of acquisitions drawn from it.

use rayon::prelude::*;

use crate::noise::learning::whitening::{BANDS, CLASSES};
use rockface_core::artefact::{Band, Cameras, Noise, Raster};
use rockface_core::numerics::marginal::skewness;
use rockface_core::numerics::random::Key;
use rockface_core::numerics::trend::{Trend, trend, with_trend, without_trend};
use rockface_core::{StageError, fail};
use rockface_imaging::matching::noise::ensemble::{Numbers, draw};
use rockface_imaging::matching::noise::parametric::Ground;
use rockface_raster::grid;

/// Largest departure from its trend, as a share of its largest value, at which a raster counts as one.
const LEAST_NOISE: f64 = 1e-6;

/// Checks that rasters, DEM and cameras are of one grid and frame.
///
/// # Errors
/// What differs.
pub fn check(rasters: &[&Raster], dem: &Raster, block: &Cameras) -> Result<(), StageError> {
    if let Some(other) = rasters.iter().find(|other| !grid::same(&other.grid, &dem.grid)) {
        let (a, b) = (grid::describe(&dem.grid), grid::describe(&other.grid));
        return Err(StageError::new(format!("`dem` has {a}, a raster {b}"))
            .hint("rasterise the face on the grid of the rasters: port `grid` of `rasterise-dem`"));
    }
    if let Some(other) = rasters.iter().find(|other| other.frame != dem.frame) {
        fail!("`dem` is in the {} frame, a raster in the {} frame", dem.frame, other.frame);
    }
    if block.frame != dem.frame {
        let text = format!("`dem` is in the {} frame, the cameras in the {} frame", dem.frame, block.frame);
        return Err(StageError::new(text).hint("bring mesh and cameras into one frame with `transform-crs`"));
    }
    Ok(())
}

/// What counts as beyond a limit, since rasters have 32 bits.
const BEYOND: f64 = 1.0 + 1e-6;

/// Checks that rasters have nothing beyond the limit at which they are said to be filtered, metres: draws are, and a model of rasters that are not is too strong.
///
/// # Errors
/// The raster with most values beyond it.
pub fn check_filtered(bands: &[&Band], limit_m: f64) -> Result<(), StageError> {
    let beyond = |band: &&Band| band.values.iter().filter(|value| f64::from(value.abs()) > BEYOND * limit_m).count();
    let counts: Vec<usize> = bands.iter().map(beyond).collect();
    let worst = bands.iter().zip(&counts).max_by_key(|(_, count)| **count).filter(|(_, count)| **count > 0);
    let Some((band, count)) = worst else { return Ok(()) };
    let largest = band.values.iter().filter(|value| !value.is_nan()).fold(0.0f32, |most, value| most.max(value.abs()));
    let others = counts.iter().filter(|count| **count > 0).count() - 1;
    let others = match others {
        0 => String::new(),
        1 => "; one other has some too".to_owned(),
        n => format!("; {n} others have some too"),
    };
    let text = format!(
        "raster `{}` has {count} values beyond `outlier_m`, {limit_m} m, the largest {largest} m{others}: rasters must be filtered at that limit",
        band.name
    );
    Err(StageError::new(text)
        .hint("filter them with `filter-outliers` (`max_abs_m`) or `max_abs` of `import-rasters`, or leave `outlier_m` out where nothing was filtered"))
}

/// Checks that a model is of the grid and frame of a DEM, and made as [`whiten`](super::whitening::whiten) takes rasters apart.
///
/// # Errors
/// What differs.
pub fn check_model(noise: &Noise, dem: &Raster) -> Result<(), StageError> {
    if noise.grid != dem.grid || noise.frame != dem.frame {
        let text =
            format!("the model has {} x {} cells in the {} frame", noise.grid.columns, noise.grid.rows, noise.frame);
        return Err(StageError::new(format!("{text}, which are not those of `dem`"))
            .hint("give the DEM the model was learnt with, or bring the model to this one with `transfer-noise`"));
    }
    check_parts(noise)
}

/// Which cells have a value in at least one raster.
pub fn seen<'a>(rasters: impl IntoIterator<Item = &'a [f32]>) -> Vec<bool> {
    let mut seen = Vec::new();
    for raster in rasters {
        seen.resize(raster.len(), false);
        seen.iter_mut().zip(raster).for_each(|(seen, value)| *seen |= !value.is_nan());
    }
    seen
}

/// Share of the cells without a value in each raster, of those that are [`seen`] at all.
pub fn gaps(rasters: &[impl AsRef<[f32]>], seen: &[bool]) -> Vec<[f64; 1]> {
    let cells = seen.iter().filter(|seen| **seen).count().max(1) as f64;
    let gaps_of = |raster: &[f32]| raster.iter().zip(seen).filter(|(value, seen)| **seen && value.is_nan()).count();
    rasters.iter().map(|raster| [gaps_of(raster.as_ref()) as f64 / cells]).collect()
}

/// Skewness of each raster; 0 for one without.
pub fn skewnesses(rasters: &[impl AsRef<[f32]> + Sync]) -> Vec<f64> {
    let one = |raster: &[f32]| skewness(raster).filter(|found| found.is_finite()).unwrap_or(0.0);
    rasters.par_iter().map(|raster| one(raster.as_ref())).collect()
}

/// Checks that a model is made as [`whiten`](super::whitening::whiten) takes rasters apart.
///
/// # Errors
/// Another number of bands or classes.
pub fn check_parts(noise: &Noise) -> Result<(), StageError> {
    if noise.bands() != BANDS || noise.class_log_strength.len() != CLASSES {
        fail!(
            "the model has {} bands and {} classes of place, not {BANDS} and {CLASSES}",
            noise.bands(),
            noise.class_log_strength.len()
        );
    }
    Ok(())
}

/// Differences as errors of disparity, pixels of the full image.
pub fn per_step(rasters: Vec<Vec<f32>>, step_m: &[f32]) -> Vec<Vec<f32>> {
    let one = |raster: Vec<f32>| raster.iter().zip(step_m).map(|(metres, step_m)| metres / step_m).collect();
    rasters.into_iter().map(one).collect()
}

/// Differences without their trends, which are what registration left, and the trends, metres. `weights` are those of cells in the trends; none: all
/// count alike.
///
/// # Errors
/// A raster with too few values, with values on a line only, or that is all trend.
pub fn level(
    bands: &[&Band],
    columns: usize,
    step_m: &[f32],
    weights: &[f32],
) -> Result<(Vec<Vec<f32>>, Vec<Trend>), StageError> {
    let one = |band: &&Band| {
        let known = band.values.iter().zip(step_m).filter(|(value, step)| !(value.is_nan() || step.is_nan()));
        let known: Vec<f64> = known.map(|(value, _)| f64::from(*value)).collect();
        let count = known.len();
        if count < band.values.len() / 10 {
            let cells = band.values.len();
            let text = format!("raster `{}` has values on {count} of {cells} cells that a pair shows", band.name);
            return Err(StageError::new(text)
                .hint("a tenth is needed: check window, frame and cameras, or leave the raster out"));
        }
        let trend = trend(&band.values, columns, weights);
        let trend =
            trend.ok_or_else(|| StageError::new(format!("the values of raster `{}` lie on a line", band.name)))?;
        let flat = with_trend(&band.values, columns, &trend.map(|factor| -factor));
        // What rounding to 32 bits leaves of a trend is no noise.
        let largest = known.iter().map(|value| value.abs()).fold(0.0, f64::max);
        if flat.iter().all(|value| value.is_nan() || f64::from(value.abs()) <= LEAST_NOISE * largest) {
            fail!("raster `{}` is a plane or evenly bent: there is no noise to learn", band.name);
        }
        Ok((flat, trend))
    };
    let both: Result<Vec<(Vec<f32>, Trend)>, StageError> = bands.iter().map(one).collect();
    Ok(both?.into_iter().unzip())
}

/// Differences of two acquisitions each, an even and an odd one, drawn from a model without a survey: errors of disparity, pixels of the full image,
/// each without its trend. Cells whose difference is larger than `limit_m` or whose elevation step is unknown are left out. They are numbered
/// as replicates, so that the mean strength of a few is that of the model.
pub fn differences(
    noise: &Noise,
    count: usize,
    step_m: &[f32],
    limit_m: f32,
    stream: &(impl Fn(&str, &str) -> Key + Sync),
) -> Vec<Vec<f32>> {
    let ground = Ground::of(noise);
    let epoch = |replicate: u32, acquisition: u32| {
        let keys = |purpose: &str, item: &str| stream(purpose, &format!("{replicate}/{acquisition}/{item}"));
        let numbers = Numbers { acquisition: Some(acquisition), replicate: Some(replicate) };
        draw(noise, ground.as_ref(), numbers, &keys).errors_px(noise, &noise.strength)
    };
    let difference = |replicate: u32| {
        let (pre, post) = (epoch(replicate, 0), epoch(replicate, 1));
        let difference_m = pre.iter().zip(post).zip(step_m).map(|((pre, post), step_m)| (post - pre) * step_m);
        let kept: Vec<f32> = difference_m.map(|m| if m.abs() <= limit_m { m } else { f32::NAN }).collect();
        let level = without_trend(&kept, noise.grid.columns, &noise.trend_weights).unwrap_or(kept);
        level.iter().zip(step_m).map(|(m, step_m)| m / step_m).collect()
    };
    (0..count as u32).into_par_iter().map(difference).collect()
}
