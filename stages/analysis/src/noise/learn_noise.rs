//! `learn-noise`: a model of the matching noise of a site, from differences without change and the geometry of the survey.

use crate::noise::learning::acquisitions::{Acquisitions, acquisitions};
use crate::noise::learning::bad::parted;
use crate::noise::learning::relief_law;
use crate::noise::learning::whitening::{BANDS, Places, Prior, Stack, Whitened, range_cells};
use rockface_core::artefact::{Band, Cameras, Kind, Noise, Pairs, Raster, ReliefLaw};
use rockface_core::numerics::bands::Bands;
use rockface_core::numerics::quantile::quantile;
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_imaging::matching::elevation_step::elevation_step_m;
use rockface_imaging::matching::noise::changed_face::{Window, law};
use rockface_raster::grid;

params! {
    /// Parameters of `learn-noise`.
    pub struct LearnNoiseParams {
        /// Share of the rasters, the last ones, that is left out of the model, so that they can judge it.
        held_out: f64 = 0.0; Range::Between(0.0, 0.9),
        /// Rasters from which on the model keeps whitened fields; with fewer it is parametric: strength by place and relief, and spectrum.
        fewest_fields: usize = 12; Range::AtLeast(3.0),
        /// Deviation of the Gaussian that smooths the map of strength, cells. Few rasters want more.
        smoothing_cells: f64 = 1.5; Range::Between(0.0, 100.0),
        /// Rasters that the strength expected of the relief is worth in the map of strength of a parametric model.
        prior_rasters: f64 = 4.0; Range::NonNegative,
        /// Robust deviations by which a bad acquisition is stronger than the others, or stronger and of another spectrum.
        bad_cut: f64 = 3.0; Range::Positive,
        /// Whitened fields mixed in one acquisition: fewer copy them, many make the noise too regular.
        donors: usize = 8; Range::AtLeast(1.0),
        /// Correlation length of the weights of the mixture, cells; left out: the geometric mean of the range of the noise and
        /// the shorter side of the rasters.
        length_cells: Option<f64> = None; Range::AtLeast(1.0),
        /// Share of the variance of a weight that is constant over the face.
        common_share: f64 = 0.3; Range::Between(0.0, 1.0),
        /// Deviation of the jitter of strengths and amplitudes, as a share of their robust deviation over rasters.
        jitter: f64 = 0.4; Range::NonNegative,
        /// Half width of the window in which the deviation of elevations is the relief, cells.
        relief_cells: usize = 4; Range::Between(1.0, 50.0),
    }
}

/// The stage.
pub struct LearnNoise;

impl Stage for LearnNoise {
    type Params = LearnNoiseParams;
    const NAME: &'static str = "learn-noise";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("learn_noise.md"));
    const INPUTS: &'static [Port] = &[
        Port::many(
            "raster",
            &[Kind::Raster],
            "Differences without rockfall, metres: a stack of bands, or gathered; a chain in its order.",
        ),
        Port::one("dem", &[Kind::Raster], "Elevation of the face on the same grid, metres."),
        Port::one("cameras", &[Kind::Cameras], "Cameras of the survey."),
        Port::one("pairs", &[Kind::Pairs], "Its pairs."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("noise", &[Kind::Noise], "The model."),
        Port::one(
            "strength",
            &[Kind::Raster],
            "Strength of the noise of a difference by place, pixels of the full image.",
        ),
    ];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The rasters in disparity, their whitened fields with weights, and transforms of a few at a time.
        4 * inputs.of("raster") + 40 * inputs.of("dem")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (dem, block, pairs) =
            (inputs.one::<Raster>("dem")?, inputs.one::<Cameras>("cameras")?, inputs.one::<Pairs>("pairs")?);
        let rasters = inputs.many::<Raster>("raster")?;
        check(&rasters.iter().map(|(_, raster)| *raster).collect::<Vec<_>>(), dem, block)?;
        let all: Vec<&Band> = rasters.iter().flat_map(|(_, raster)| &raster.bands).collect();
        let kept = all.len() - (all.len() as f64 * params.held_out).round() as usize;
        if kept < 3 {
            let text = format!("{kept} of {} rasters are left to learn from, 3 are needed", all.len());
            return Err(StageError::new(text).hint("add rasters, or lower `held_out`"));
        }
        let step_m = elevation_step_m(dem, block, pairs)?;
        let disparities = disparities(&all[..kept], &step_m)?;
        let names: Vec<String> = all[..kept].iter().map(|band| band.name.clone()).collect();
        let learnt = Learnt::new(params, &disparities, dem);
        let noise = learnt.model(params, &names, dem);
        report(&noise, &learnt, &step_m, context);
        let bands = vec![Band { name: "strength".to_owned(), values: noise.strength.clone() }];
        let strength = Raster { bands, quantity: "strength".to_owned(), ..dem.clone() };
        Ok(Outputs::of("noise", noise).and("strength", strength))
    }
}

fn check(rasters: &[&Raster], dem: &Raster, block: &Cameras) -> Result<(), StageError> {
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

/// Differences as errors of disparity, pixels of the full image, each without its mean.
fn disparities(bands: &[&Band], step_m: &[f32]) -> Result<Vec<Vec<f32>>, StageError> {
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

/// What the rasters say.
struct Learnt {
    columns: usize,
    places: Places,
    whitened: Vec<Whitened>,
    bad: Vec<bool>,
    relief: ReliefLaw,
    fields: bool,
}

impl Learnt {
    fn new(params: &LearnNoiseParams, disparities: &[Vec<f32>], dem: &Raster) -> Self {
        let columns = dem.grid.columns;
        let stack = Stack { rasters: disparities, columns, smoothing_cells: params.smoothing_cells, prior: None };
        let (mut places, mut whitened, mut bad) = parted(&stack, params.bad_cut);
        let window = Window { columns, rows: dem.grid.rows, half: params.relief_cells };
        let reliefs_m = relief_law::reliefs_m(&dem.bands[0].values, &window);
        let relief = relief_law::fit(&places.strength, &reliefs_m, params.relief_cells);
        let fields = disparities.len() >= params.fewest_fields;
        if !fields {
            let expected: Vec<f32> = reliefs_m.iter().map(|m| law(&relief, *m) as f32).collect();
            let prior = Some(Prior { strength: &expected, rasters: params.prior_rasters });
            (places, whitened, bad) = parted(&Stack { prior, ..stack }, params.bad_cut);
        }
        Self { columns, places, whitened, bad, relief, fields }
    }

    fn model(&self, params: &LearnNoiseParams, names: &[String], dem: &Raster) -> Noise {
        let shares = Bands::new(self.columns, dem.grid.rows, BANDS).shares();
        let Acquisitions { mut members, jitter, bad_share } =
            acquisitions(names, &self.whitened, &self.bad, &shares, params.jitter);
        if !self.fields {
            members.iter_mut().for_each(|member| member.field_log_amplitude.fill(0.0));
        }
        let kept = |whitened: &Whitened| (whitened.field.clone(), whitened.weights.clone());
        let (fields, weights) =
            if self.fields { self.whitened.iter().map(kept).unzip() } else { (Vec::new(), Vec::new()) };
        Noise {
            frame: dem.frame,
            grid: dem.grid,
            donors: params.donors,
            length_cells: params.length_cells.unwrap_or_else(|| self.length_cells(dem)),
            common_share: params.common_share,
            bad_share,
            class_log_strength: self.places.middles.clone(),
            jitter,
            relief: self.relief,
            members,
            strength: self.places.strength.clone(),
            elevation: dem.bands[0].values.clone(),
            fields,
            weights,
        }
    }

    /// Geometric mean of the range of the noise and the shorter side of the rasters: much longer than the noise, so that
    /// a mixture keeps its correlation, and much shorter than the face, so that it is no copy.
    fn length_cells(&self, dem: &Raster) -> f64 {
        let usual: Vec<&Whitened> =
            self.whitened.iter().zip(&self.bad).filter(|(_, bad)| !**bad).map(|(w, _)| w).collect();
        let side = self.columns.min(dem.grid.rows);
        ((range_cells(&usual, self.columns) * side) as f64).sqrt()
    }
}

fn report(noise: &Noise, learnt: &Learnt, step_m: &[f32], context: &Context) {
    let known: Vec<f64> = step_m.iter().filter(|step| !step.is_nan()).map(|step| f64::from(*step)).collect();
    let strengths: Vec<f64> = noise.strength.iter().map(|s| f64::from(*s)).collect();
    let middle = |values: &[f64]| quantile(values, 0.5).unwrap_or(f64::NAN);
    let bad: Vec<&str> = noise.members.iter().filter(|member| member.bad).map(|member| member.name.as_str()).collect();
    let (step, strength) = (middle(&known), middle(&strengths));
    context.metric("elevation_step", step, "m/px");
    context.metric("strength_median", strength, "px");
    context.metric("bad_rasters", bad.len() as f64, "1");
    context.metric("length", noise.length_cells, "cells");
    context.note(format!(
        "from {} rasters; a pixel of disparity is worth {:.1} mm, a difference has {strength:.2} px of noise at the median place; \
         strength over relief: {:.2} px on flat rock, {:.1} px for a metre",
        noise.members.len(),
        1e3 * step,
        noise.relief.flat_px,
        noise.relief.gain_px_m
    ));
    if !bad.is_empty() {
        context.note(format!("bad acquisitions, a class of their own: {}", bad.join(", ")));
    }
    if !learnt.fields {
        context.note(format!(
            "{} rasters are too few to keep their fields: the model is parametric, its noise has one spectrum everywhere",
            noise.members.len()
        ));
    }
}

#[cfg(test)]
mod tests;
