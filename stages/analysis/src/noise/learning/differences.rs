//! Differences as errors of disparity on the grid of a model: of rasters, and of acquisitions drawn from it.

use rayon::prelude::*;

use crate::noise::learning::whitening::{BANDS, CLASSES};
use rockface_core::artefact::{Band, Cameras, Noise, Raster};
use rockface_core::numerics::random::Key;
use rockface_core::{StageError, fail};
use rockface_imaging::matching::noise::ensemble::draw;
use rockface_raster::grid;

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

/// Differences as errors of disparity, pixels of the full image, each without its mean.
///
/// # Errors
/// A raster with too few values, or with one value everywhere.
pub fn disparities(bands: &[&Band], step_m: &[f32]) -> Result<Vec<Vec<f32>>, StageError> {
    let one = |band: &&Band| {
        let values: Vec<f32> = band.values.iter().zip(step_m).map(|(value, step)| value / step).collect();
        let known = values.iter().filter(|value| !value.is_nan()).map(|value| f64::from(*value));
        let (sum, count) = known.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
        if count < values.len() / 10 {
            let text =
                format!("raster `{}` has values on {count} of {} cells that a pair shows", band.name, values.len());
            return Err(StageError::new(text)
                .hint("a tenth is needed: check window, frame and cameras, or leave the raster out"));
        }
        let mean = sum / count as f64;
        if values.iter().all(|value| value.is_nan() || (f64::from(*value) - mean).abs() < 1e-12) {
            fail!("raster `{}` has one value everywhere: there is no noise to learn", band.name);
        }
        Ok(values.iter().map(|value| (f64::from(*value) - mean) as f32).collect())
    };
    bands.iter().map(one).collect()
}

/// Differences of two acquisitions each, an even and an odd one, drawn from a model without a survey, pixels of the full image; a value for
/// which `keeps` (cell, pixels) says no is left out.
pub fn differences(
    noise: &Noise,
    count: usize,
    keeps: impl Fn(usize, f32) -> bool + Sync,
    stream: &(impl Fn(&str, &str) -> Key + Sync),
) -> Vec<Vec<f32>> {
    let epoch = |number: u32| {
        let keys = |purpose: &str, item: &str| stream(purpose, &format!("{number}/{item}"));
        draw(noise, Some(number), &keys).errors_px(noise, &noise.strength)
    };
    let difference = |number: u32| {
        let (pre, post) = (epoch(2 * number), epoch(2 * number + 1));
        let values = pre.iter().zip(post).map(|(pre, post)| post - pre).enumerate();
        values.map(|(cell, px)| if keeps(cell, px) { px } else { f32::NAN }).collect()
    };
    (0..count as u32).into_par_iter().map(difference).collect()
}
