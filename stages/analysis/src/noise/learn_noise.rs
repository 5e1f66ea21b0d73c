//! `learn-noise`: a model of the matching noise of a site, from differences without change and the geometry of the survey.

use std::borrow::Cow;

use rand::seq::SliceRandom;
use rayon::prelude::*;

use crate::noise::detrend::asymmetry;
use crate::noise::learning::acquisitions::{Acquisitions, Shares, Source, Variety, acquisitions};
use crate::noise::learning::bad::parted;
use crate::noise::learning::by_place::{self, Strengths};
use crate::noise::learning::common_share::common_share;
use crate::noise::learning::contrast::{self, Figures, Nearest};
use crate::noise::learning::correction::{Correction, Known};
use crate::noise::learning::differences::{check, check_filtered, differences, per_step, seen, skewnesses};
use crate::noise::learning::gains::{Gains, Marks};
use crate::noise::learning::trend_weights::{Level, weighed};
use crate::noise::learning::whitening::{
    BANDS, LEAST_SIDE_CELLS, Places, Prior, Stack, Whitened, range_cells, restore_outliers, whiten,
};
use crate::noise::learning::{bends, parametric, registration, relief_law, repeated};
use rockface_core::artefact::{
    Band, Cameras, Contrast, Kind, LateralShift, Noise, Pairs, Parametric, Raster, ReliefLaw,
};
use rockface_core::numerics::bands::Bands;
use rockface_core::numerics::held_out::in_view;
use rockface_core::numerics::marginal;
use rockface_core::numerics::quantile::quantile;
use rockface_core::numerics::trend::{Trend, bent};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};
use rockface_imaging::matching::elevation_step::elevation_step_m;
use rockface_imaging::matching::noise::changed_face::{Window, law};
use rockface_raster::window;

params! {
    /// Parameters of `learn-noise`.
    pub struct LearnNoiseParams {
        /// Share of the rasters, the last ones, that is left out of the model, so that they can judge it.
        held_out: f64 = 0.0; Range::Between(0.0, 0.9),
        /// Rasters from which on the model keeps whitened fields; with fewer it is parametric: strength by place and relief, spectra by strength of place, and
        /// the noise of a lateral shift at edges.
        fewest_fields: usize = 12; Range::AtLeast(3.0),
        /// Deviation of the Gaussian that smooths the map of strength, cells. Few rasters want more.
        smoothing_cells: f64 = 1.5; Range::Between(0.0, 100.0),
        /// Rasters that the strength expected of the relief is worth in the map of strength of a parametric model.
        prior_rasters: f64 = 4.0; Range::NonNegative,
        /// Robust deviations by which a bad acquisition is stronger than the others, or stronger and of another spectrum.
        bad_cut: f64 = 3.0; Range::Positive,
        /// Whitened fields mixed in one acquisition, of the rasters most like the one whose strength it has: fewer copy them, with many all
        /// acquisitions have the same structure. Left out: the square root of half the number of rasters.
        donors: Option<usize> = None; Range::AtLeast(1.0),
        /// Power of the weights of the donors: 1 mixes all of them everywhere, which makes noise even; with more each place has the structure of
        /// fewer of them.
        sharpness: u32 = 6; Range::Between(1.0, 16.0),
        /// Power of their own strength that the details of a mixture are multiplied by, at all levels; left out: for each level what makes the
        /// details of draws as uneven as those of the rasters.
        contrast: Option<f64> = None; Range::Between(0.0, 2.0),
        /// Correlation length of the weights of the mixture, cells; left out: the geometric mean of the range of the noise and
        /// the shorter side of the rasters.
        length_cells: Option<f64> = None; Range::AtLeast(1.0),
        /// Share of the variance of a weight that is constant over the face.
        common_share: f64 = 0.0; Range::Between(0.0, 1.0),
        /// Deviation of the jitter of strengths and amplitudes, as a share of their deviation over rasters.
        jitter: f64 = 0.2; Range::NonNegative,
        /// Differences drawn from the model to find how much of the variety of the rasters is chance of single fields, which every draw has
        /// anew, and by how much the mean of the draws is off; 0: none of it.
        draws: usize = 64; Range::Between(0.0, 1000.0),
        /// Larger differences were filtered out of the rasters, metres; left out: none were. Rasters that have larger ones are refused.
        outlier_m: Option<f64> = None; Range::Positive,
        /// Half width of the window in which the deviation of elevations is the relief, cells.
        relief_cells: usize = 4; Range::Between(1.0, 50.0),
        /// Window (left, right, bottom, top) in metres: only the cells that lie in it whole are learnt from, and the model is one of
        /// these cells. Left out: all.
        window_m: Option<[f64; 4]> = None,
    }
}

/// Learns a model of the matching noise of a site from rasters of difference without change, such as the
/// comparisons of quiet months.
pub struct LearnNoise;

impl Stage for LearnNoise {
    type Params = LearnNoiseParams;
    const NAME: &'static str = "learn-noise";
    const VERSION: u32 = 32;
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

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn draws(params: &Self::Params) -> bool {
        params.draws >= 2
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // The rasters in disparity, their whitened fields with weights, transforms of a few at a time, shapes of bends, and the strength by place of
        // rasters and draws.
        5 * inputs.of("raster") + (115 + 3 * params.draws as u64) * inputs.of("dem")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (dem, block, pairs) =
            (inputs.one::<Raster>("dem")?, inputs.one::<Cameras>("cameras")?, inputs.one::<Pairs>("pairs")?);
        let rasters: Vec<&Raster> = inputs.many::<Raster>("raster")?.into_iter().map(|(_, raster)| raster).collect();
        check(&rasters, dem, block)?;
        let (rasters, dem) = (in_window(rasters, params.window_m)?, one_in_window(dem, params.window_m)?);
        let dem = dem.as_ref();
        let all: Vec<&Band> = rasters.iter().flat_map(|raster| &raster.bands).collect();
        let kept = in_view(all.len(), params.held_out);
        if kept < 3 {
            let text = format!("{kept} of {} rasters are left to learn from, 3 are needed", all.len());
            return Err(StageError::new(text).hint("add rasters, or lower `held_out`"));
        }
        if let Some(limit_m) = params.outlier_m {
            check_filtered(&all[..kept], limit_m)?;
        }
        let step_m = elevation_step_m(dem, block, pairs)?;
        let columns = dem.grid.columns;
        let Level { rasters_m: mut level_m, trends_m: trends, weights } = weighed(&all[..kept], columns, &step_m)?;
        if let Some(share) = common_share(&level_m).filter(|share| *share > COMMON) {
            context.warn(format!(
                "the rasters have {:.0} % of their variance in common; differences from one and the same survey have half of it, and its errors are then taken for noise \
                 that is the same every time: subtract from each survey the one before it",
                100.0 * share
            ));
        }
        let names: Vec<&str> = all[..kept].iter().map(|band| band.name.as_str()).collect();
        if let Some(text) = repeated::warning(&level_m, &names) {
            context.warn(text);
        }
        let before = power(&level_m);
        let bend_shapes = bends::shapes(&level_m, &trends, columns, &weights);
        bends::take_off(&mut level_m, &trends, &bend_shapes);
        context.metric("bent_share", 1.0 - power(&level_m) / before, "1");
        let disparities = per_step(level_m, &step_m);
        let source = |((band, trend_m), skewness): ((&&Band, &Trend), f64)| {
            let asymmetry_m = asymmetry(&band.values, columns, trend_m).unwrap_or_default();
            Source { name: band.name.clone(), trend_m: *trend_m, asymmetry_m, skewness }
        };
        let sources: Vec<Source> = all[..kept].iter().zip(&trends).zip(skewnesses(&disparities)).map(source).collect();
        let limit_px =
            |cell: usize| params.outlier_m.map_or(f64::INFINITY, |limit| limit / f64::from(step_m[cell].abs()));
        let mut learnt = Learnt::new(params, &disparities, Bent { shapes: bend_shapes, weights }, dem, limit_px);
        if Self::draws(params) {
            learnt.shuffle_orders(context);
            learnt.find_places(dem, context);
        }
        context.check_cancelled()?;
        let noise = learnt.varied(params, sources, &disparities, dem, &step_m, context);
        report(&noise, &learnt, &step_m, context);
        let bands = vec![Band { name: "strength".to_owned(), values: noise.strength.clone() }];
        let strength = Raster { bands, quantity: "strength".to_owned(), ..dem.clone() };
        Ok(Outputs::of("noise", noise).and("strength", strength))
    }
}

/// Sum of the squares of all values.
fn power(rasters: &[Vec<f32>]) -> f64 {
    rasters.iter().flatten().filter(|value| !value.is_nan()).map(|value| f64::from(*value) * f64::from(*value)).sum()
}

/// Rasters in a window; all of them without one.
fn in_window(rasters: Vec<&Raster>, window_m: Option<[f64; 4]>) -> Result<Vec<Cow<'_, Raster>>, StageError> {
    rasters.into_iter().map(|raster| one_in_window(raster, window_m)).collect()
}

fn one_in_window(raster: &Raster, window_m: Option<[f64; 4]>) -> Result<Cow<'_, Raster>, StageError> {
    let Some(window_m) = window_m else { return Ok(Cow::Borrowed(raster)) };
    let part = window::cropped(raster, window_m)?;
    if part.grid.columns.min(part.grid.rows) < LEAST_SIDE_CELLS {
        let (columns, rows) = (part.grid.columns, part.grid.rows);
        let text = format!("`window_m` holds {columns} x {rows} cells, {LEAST_SIDE_CELLS} are needed on each side");
        return Err(StageError::new(text).hint("widen `window_m`; it is left, right, bottom, top in metres"));
    }
    Ok(Cow::Owned(part))
}

/// How surfaces are bent.
struct Bent {
    /// What comes with the bends of trends.
    shapes: Vec<Vec<f32>>,
    /// Weights of cells in trends.
    weights: Vec<f32>,
}

/// What the rasters say.
struct Learnt {
    columns: usize,
    places: Places,
    bent: Bent,
    shares: Shares,
    whitened: Vec<Whitened>,
    bad: Vec<bool>,
    relief: ReliefLaw,
    fields: bool,
    /// How noise without fields differs from place to place.
    parametric: Option<Box<Parametric>>,
    /// Orders in which replicates take the usual rasters.
    orders: [Vec<usize>; 2],
    /// Range of the correlation of the noise, cells.
    range_cells: usize,
}

impl Learnt {
    fn new(
        params: &LearnNoiseParams,
        disparities: &[Vec<f32>],
        bent: Bent,
        dem: &Raster,
        limit_px: impl Fn(usize) -> f64,
    ) -> Self {
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
        let range_cells = range_cells(&usual(&whitened, &bad), columns);
        whitened.iter_mut().for_each(|whitened| restore_outliers(whitened, &places, &limit_px));
        let first: Vec<usize> = (0..bad.len()).filter(|i| !bad[*i]).collect();
        let mut second = first.clone();
        second.rotate_left(first.len() / 2);
        let bands = Bands::new(columns, dem.grid.rows, BANDS).shares();
        let shares = Shares { classes: places.power_shares(), bands };
        Self {
            columns,
            places,
            bent,
            shares,
            whitened,
            bad,
            relief,
            fields,
            parametric: None,
            orders: [first, second],
            range_cells,
        }
    }

    fn shuffle_orders(&mut self, context: &Context) {
        for (order, survey) in self.orders.iter_mut().zip(["first", "second"]) {
            order.shuffle(&mut context.stream("noise-order", survey).generator());
        }
    }

    /// Learns how noise differs from place to place, where the model has no fields that say so.
    fn find_places(&mut self, dem: &Raster, context: &Context) {
        if !self.fields {
            let stream = |purpose: &str, item: &str| context.stream(purpose, item);
            let elevation = &dem.bands[0].values;
            let found = parametric::learnt(&self.usual(), &self.places, elevation, self.columns, &stream);
            self.parametric = Some(Box::new(found));
        }
    }

    /// The model, whose draws vary as the rasters do and have their mean figures.
    fn varied(
        &self,
        params: &LearnNoiseParams,
        mut sources: Vec<Source>,
        disparities: &[Vec<f32>],
        dem: &Raster,
        step_m: &[f32],
        context: &Context,
    ) -> Noise {
        let none = Correction::none(self.places.middles.len() + BANDS);
        let given = contrast::even(params.contrast.unwrap_or(0.0));
        if params.draws < 2 {
            let asymmetry_gain = registration::part(&mut sources, &self.bad, &[]);
            return Noise { asymmetry_gain, ..self.model(params, &sources, dem, &none, &given) };
        }
        // What draws of acquisitions differ by that are all alike is chance. They choose their donors by the little that is left.
        let alike = Correction { own: vec![ALIKE; none.own.len()], ..none };
        let mut usual = Noise { bad_share: 0.0, ..self.model(params, &sources, dem, &alike, &given) };
        let limit_m = params.outlier_m.map_or(f32::INFINITY, |limit| limit as f32);
        let drawn = |noise: &Noise, count: usize| {
            differences(noise, count, step_m, limit_m, &|purpose, item| context.stream(purpose, item))
        };
        let real: Vec<&[f32]> =
            disparities.iter().zip(&self.bad).filter(|(_, bad)| !**bad).map(|(raster, _)| raster.as_slice()).collect();
        let details =
            |trial: &[Vec<f32>]| Figures::of(&trial.iter().map(Vec::as_slice).collect::<Vec<_>>(), self.columns).mean;
        let wanted = params.contrast.is_none().then(|| Figures::of(&real, self.columns));
        usual.contrast = match &wanted {
            None => given,
            Some(wanted) => contrast::fitted(wanted, |contrast| {
                usual.contrast = contrast.clone();
                details(&drawn(&usual, params.draws.min(CONTRAST_DRAWS)))
            }),
        };
        let mut trial = drawn(&usual, params.draws);
        let strengths = Strengths::of(&real, self.columns);
        let mut factors = vec![1.0; dem.grid.cells()];
        let make_up = |trial: &mut [Vec<f32>], factors: &mut [f64]| {
            let more = strengths.factors(trial);
            trial.iter_mut().for_each(|raster| by_place::times(raster, &more));
            factors.iter_mut().zip(more).for_each(|(factor, more)| *factor *= more);
        };
        let seen = seen(real.iter().copied());
        let marks = Marks::of(&real, &seen).of_another(real.len());
        let refined = |gains: Gains, trial: &[Vec<f32>]| gains.refined(&marks, &Marks::of(trial, &seen));
        let mut gains = refined(Gains::default(), &trial);
        make_up(&mut trial, &mut factors);
        let mut correction = Correction::of(&self.usual(), &whiten(&trial, self.columns, &self.places));
        let mut contrast = usual.contrast.clone();
        drop(usual);
        let corrected =
            |sources: &[Source], correction: &Correction, contrast: &Contrast, factors: &[f64], gains: Gains| {
                let mut noise = self.model(params, sources, dem, correction, contrast);
                by_place::strengthen(&mut noise, factors);
                Noise { gap_gain: gains.gaps, gap_variety: gains.variety, skewness_gain: gains.skewness, ..noise }
            };
        // Now acquisitions differ, and mixtures of what differs are more uneven: what draws miss then comes off in rounds.
        // Of the rounds the one counts for each level of contrast that came nearest.
        let mut nearest = Nearest::default();
        for round in 0..=ROUNDS {
            let model = corrected(&sources, &correction, &contrast, &factors, gains);
            let known = Known::of(&model, &self.shares, params.draws);
            trial = drawn(&Noise { bad_share: 0.0, ..model }, params.draws);
            if let Some(wanted) = &wanted {
                let found = details(&trial);
                nearest.take(&contrast, wanted, &found);
                if round < ROUNDS {
                    contrast::refine(&mut contrast, wanted, &found);
                }
            }
            if round < ROUNDS {
                gains = refined(gains, &trial);
                make_up(&mut trial, &mut factors);
                correction.refine(&self.usual(), &whiten(&trial, self.columns, &self.places), &known);
            }
        }
        if wanted.is_some() {
            contrast = nearest.contrast();
        }
        // The bend of a raster adds to its asymmetry.
        let bends: Vec<Trend> = self.orders[0].iter().map(|source| sources[*source].trend_m).collect();
        let asymmetries = |(draw, raster): (usize, &Vec<f32>)| {
            let change: Vec<f32> = raster.iter().zip(step_m).map(|(px, step_m)| px * step_m).collect();
            let bend = &bends[draw % bends.len()];
            // Draws have no trend of their own.
            asymmetry(&bent(&change, self.columns, bend, &self.bent.shapes), self.columns, bend)
        };
        let asymmetries: Vec<[f64; 3]> = trial.par_iter().enumerate().filter_map(asymmetries).collect();
        let asymmetry_gain = registration::part(&mut sources, &self.bad, &asymmetries);
        Noise { asymmetry_gain, ..corrected(&sources, &correction, &contrast, &factors, gains) }
    }

    fn usual(&self) -> Vec<&Whitened> {
        usual(&self.whitened, &self.bad)
    }

    /// The model with a correction of its draws.
    fn model(
        &self,
        params: &LearnNoiseParams,
        sources: &[Source],
        dem: &Raster,
        correction: &Correction,
        contrast: &Contrast,
    ) -> Noise {
        let variety = Variety { jitter: params.jitter, own: &correction.own, excess: &correction.excess };
        let Acquisitions { mut members, bad_share } =
            acquisitions(sources, &self.whitened, &self.bad, &self.shares, variety);
        if !self.fields {
            members.iter_mut().for_each(|member| member.field_log_amplitude.fill(0.0));
        }
        let fields = if self.fields {
            self.whitened.iter().map(|whitened| whitened.field.clone()).collect()
        } else {
            Vec::new()
        };
        Noise {
            frame: dem.frame,
            grid: dem.grid,
            donors: params.donors.unwrap_or_else(|| usual_donors(self.whitened.len())),
            length_cells: params.length_cells.unwrap_or_else(|| self.length_cells(dem)),
            common_share: params.common_share,
            bad_share,
            class_log_strength: self.places.middles.clone(),
            jitter: params.jitter,
            sharpness: params.sharpness,
            contrast: contrast.clone(),
            log_gain: vec![0.0; BANDS],
            relief: self.relief,
            asymmetry_gain: [0.0; 3],
            gap_gain: Gains::default().gaps,
            gap_variety: Gains::default().variety,
            skewness_gain: Gains::default().skewness,
            bend_shapes: self.bent.shapes.clone(),
            trend_weights: self.bent.weights.clone(),
            parametric: self.parametric.clone(),
            members,
            orders: self.orders.clone(),
            strength: self.places.strength.clone(),
            elevation: dem.bands[0].values.clone(),
            fields,
            weights: self.whitened.iter().map(|whitened| whitened.weights.clone()).collect(),
        }
    }

    /// Geometric mean of the range of the noise and the shorter side of the rasters: much longer than the noise, so that
    /// a mixture keeps its correlation, and much shorter than the face, so that it is no copy.
    fn length_cells(&self, dem: &Raster) -> f64 {
        let side = self.columns.min(dem.grid.rows);
        ((self.range_cells * side) as f64).sqrt()
    }
}

/// Donors of an acquisition for a number of rasters, half of which it may take them from.
fn usual_donors(rasters: usize) -> usize {
    ((0.5 * rasters as f64).sqrt().round() as usize).max(2)
}

/// The rasters that are not bad.
fn usual<'a>(whitened: &'a [Whitened], bad: &[bool]) -> Vec<&'a Whitened> {
    whitened.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(w, _)| w).collect()
}

/// Rasters of surveys have less of their variance in common: those of three real faces have none.
const COMMON: f64 = 0.25;
/// Rounds in which what draws still miss is taken off.
const ROUNDS: usize = 2;
/// Differences drawn for each trial of contrast.
const CONTRAST_DRAWS: usize = 12;
/// Part of the deviation of figures that acquisitions have which are all alike.
const ALIKE: f64 = 1e-6;
fn report(noise: &Noise, learnt: &Learnt, step_m: &[f32], context: &Context) {
    let known = marginal::known(step_m);
    let strengths: Vec<f64> = noise.strength.iter().map(|s| f64::from(*s)).collect();
    let middle = |values: &[f64]| quantile(values, 0.5).unwrap_or(f64::NAN);
    let bad: Vec<&str> = noise.members.iter().filter(|member| member.bad).map(|member| member.name.as_str()).collect();
    let (step, strength) = (middle(&known), middle(&strengths));
    context.metric("elevation_step", step, "m/px");
    context.metric("strength_median", strength, "px");
    context.metric("bad_rasters", bad.len() as f64, "1");
    context.metric("length", noise.length_cells, "cells");
    let contrast = noise.contrast.levels.first().map_or(0.0, |level| level.local_power[0]);
    context.metric("local_contrast", contrast, "1");
    context.note(format!(
        "from {} rasters; a pixel of disparity is worth {:.1} mm, a difference has {strength:.2} px of noise at the median place; \
         strength over relief: {:.2} px on flat rock, {:.1} px for a metre; of its asymmetry registration leaves {:.1} times the offset, {:.1} and \
         {:.1} times the tilts",
        noise.members.len(),
        1e3 * step,
        noise.relief.flat_px,
        noise.relief.gain_px_m,
        noise.asymmetry_gain[0],
        noise.asymmetry_gain[1],
        noise.asymmetry_gain[2]
    ));
    if !bad.is_empty() {
        context.warn(format!(
            "stronger than the other rasters or of another structure, as by motion blur or haze: {}; they count as bad acquisitions, a class of their own",
            bad.join(", ")
        ));
    }
    if 3 * bad.len() >= noise.members.len() {
        context.warn(format!(
            "{} of {} rasters count as bad acquisitions: a third or more is no exception, and what all others are judged by is little. Look at them; \
             where they are as good as the others, raise `bad_cut`",
            bad.len(),
            noise.members.len()
        ));
    }
    if !learnt.fields {
        let shift = noise.parametric.as_ref().and_then(|parametric| parametric.shift);
        let (spectra, edges) = match (&noise.parametric, shift) {
            (None, _) => ("one spectrum", "no noise of its own at edges".to_owned()),
            (Some(_), None) => ("spectra by strength of place", "no noise of its own at edges".to_owned()),
            (Some(_), Some(LateralShift { length_cells, across_cells, share, .. })) => (
                "spectra by strength of place",
                format!(
                    "up to {:.0} % of its variance at edges by a lateral shift that goes on for {length_cells} cells along them and {across_cells} across",
                    100.0 * share
                ),
            ),
        };
        let rasters = noise.members.len();
        context.note(format!(
            "{rasters} rasters are too few to keep their fields: the model is parametric, with {spectra} and {edges}"
        ));
    }
}

#[cfg(test)]
pub(super) mod tests;
