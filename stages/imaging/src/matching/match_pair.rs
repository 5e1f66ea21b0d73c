//! `match-pair`: the noisy depth map that dense matching of one stereo pair yields for one of its images.

use std::collections::BTreeMap;

use crate::matching::matched::{Match, TakeMatches, Tally};
use crate::matching::noise::model_draws::Model;
use crate::matching::pair::{Matcher, Sampling};
use crate::matching::params::{Matching, NoisePorts};
use crate::matching::rectification::Rectification;
use crate::matching::rectified_row::rectified_camera;
use crate::matching::setup::{check_size, noisy_image};
use crate::matching::side::Side;
use rockface_core::artefact::{Cameras, Depth, Image, Kind, Noise, Pair, Pairs, Raster};
use rockface_core::numerics::simd::{LANES, Lanes};
use rockface_core::params::Fault;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `match-pair`.
    pub struct MatchPairParams {
        ..matching: Matching,
        /// Name of the pair; needed where there are several.
        pair: Option<String> = None,
        /// The image whose depth map is made.
        of: Side = Side::First,
        /// Where disparities are sampled.
        sampling: Sampling = Sampling::Image,
        /// Whether distance along the ray, disparities, every term of the noise, y-parallax and the mask of valid pixels are
        /// kept as further channels.
        channels: bool = false,
    }
}

/// Makes the depth map of one image of a stereo pair as dense matching would, with the errors of orientation and
/// matching in it.
pub struct MatchPair;

impl Stage for MatchPair {
    type Params = MatchPairParams;
    const NAME: &'static str = "match-pair";
    const VERSION: u32 = 15;
    const PAGE: Page = Page::new(include_str!("match_pair.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("first", &[Kind::Depth], "Ideal depth map of the pair's first image, with its true camera."),
        Port::one("second", &[Kind::Depth], "Ideal depth map of the pair's second image, with its true camera."),
        Port::one("noisy", &[Kind::Cameras], "The cameras as the bundle adjustment believes them to be."),
        Port::one("pairs", &[Kind::Pairs], "The pairs."),
        Port::optional(
            "strength",
            &[Kind::Raster],
            "Factor on the local noise by place, from `map-noise`; needs `matcher`.",
        ),
        Port::optional("noise", &[Kind::Noise], "Model of all noise, from `learn-noise`; needs `noise: learnt`."),
        Port::optional(
            "errors",
            &[Kind::Depth],
            "Errors of your own, added to all others: a map of the image with channel `error_px`.",
        ),
    ];
    const OUTPUTS: &'static [Port] =
        &[Port::one("depth", &[Kind::Depth], "The noisy depth map, with its noisy camera.")];

    fn draws(params: &Self::Params) -> bool {
        params.matching.draws()
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        params.matching.faults()
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // The noisy map, its file and its rows as they are made; further terms of the noise and channels are maps too.
        let map = inputs.of("first").max(inputs.of("second"));
        let terms = if params.matching.matcher.is_some() { 4 } else { 0 };
        let channels = if params.channels { 24 } else { 0 };
        inputs.total() + inputs.of("noise") + map * 33 / 10 + (terms + channels) * map
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let ideal = [inputs.one::<Depth>("first")?, inputs.one::<Depth>("second")?];
        let noisy = inputs.one::<Cameras>("noisy")?;
        let pairs = inputs.one::<Pairs>("pairs")?;
        let pair = choose_pair(params, pairs)?;
        check_depths(pair, ideal)?;
        let side = params.of;
        let windowed = params.matching.matcher.as_ref().and_then(|terms| terms.windowed(ideal[side]));
        let mut depths = ideal;
        if let Some(windowed) = &windowed {
            depths[side] = windowed;
        }
        let setup = params.matching.setup(params.sampling, ports(inputs)?)?;
        let keys = |purpose: &str, item: &str| context.stream(purpose, item);
        let acquisition = setup.acquisition(depths[side], noisy, pairs, &keys)?;
        let matcher = setup.matcher(&pair.name, depths, side, noisy, acquisition.as_ref(), &keys)?;
        let (map, tally) = matched_map(params, &matcher, noisy, noisy_image(noisy, ideal[side])?);
        report(params, context, pair, &map, &tally)?;
        if params.channels {
            report_geometry(&matcher.geometry().rectification, context);
        }
        Ok(Outputs::of("depth", map))
    }
}

fn ports<'a>(inputs: &'a Inputs) -> Result<NoisePorts<'a>, StageError> {
    let model = inputs.optional::<Noise>("noise")?.map(|_| inputs.shared("noise")).transpose()?;
    Ok(NoisePorts {
        strength: inputs.optional::<Raster>("strength")?,
        noise: model.and_then(Model::of),
        errors: inputs.optional::<Depth>("errors")?,
    })
}

fn choose_pair<'a>(params: &MatchPairParams, pairs: &'a Pairs) -> Result<&'a Pair, StageError> {
    let names = || pairs.pairs.iter().map(|pair| pair.name.as_str()).collect::<Vec<_>>().join(", ");
    match (&params.pair, pairs.pairs.as_slice()) {
        (None, [only]) => Ok(only),
        (None, all) => Err(StageError::new(format!("`pairs` holds {} pairs: which one is to be matched?", all.len()))
            .hint(format!("name it with `pair`: {}", names()))),
        (Some(name), all) => all.iter().find(|pair| pair.name == *name).ok_or_else(|| {
            StageError::new(format!("`pairs` has no pair `{name}`")).hint(format!("its pairs are: {}", names()))
        }),
    }
}

fn check_depths(pair: &Pair, [first, second]: [&Depth; 2]) -> Result<(), StageError> {
    let is_exchanged = first.image.name == pair.second && second.image.name == pair.first;
    for (port, depth, expected) in [("first", first, &pair.first), ("second", second, &pair.second)] {
        let name = &depth.image.name;
        if name != expected {
            let text =
                format!("`{port}` is the depth map of image `{name}`; pair `{}` needs that of `{expected}`", pair.name);
            return Err(StageError::new(text).hint(if is_exchanged {
                "exchange `first` and `second`: `select-pairs` gives the order"
            } else {
                "check the two inputs, or choose another `pair`"
            }));
        }
        check_size(&format!("`{port}`"), depth)?;
    }
    if first.downscale != second.downscale {
        let (a, b) = (first.downscale, second.downscale);
        return Err(StageError::new(format!("`first` has downscale {a}, `second` {b}"))
            .hint("project both depth maps with one `downscale`"));
    }
    Ok(())
}

/// The value of a match that a channel holds.
type Of = fn(&Match) -> f64;
/// Name of a channel, and its value.
type Channel = (&'static str, Of);

/// Channels: first those of the paper's noise, then those of further terms.
const CHANNELS: [Channel; 10] = [
    ("range", Match::range_m),
    ("disparity.ideal", |m| m.ideal_px),
    ("noise.local", |m| m.error.white_px),
    ("noise.regular", |m| m.error.regular_px),
    ("disparity", |m| m.disparity_px),
    ("y_parallax", |m| m.y_parallax_px),
    ("noise.blunder", |m| m.error.blunder_px),
    ("noise.sub_pixel", |m| m.sub_pixel_px),
    ("noise.strength", |m| m.error.strength),
    ("noise.relief", |m| m.error.relief_px),
];

/// How many of them the paper's noise has.
const PAPER_CHANNELS: usize = 6;

fn channels(params: &MatchPairParams) -> &'static [Channel] {
    match (params.channels, &params.matching.matcher) {
        (false, _) => &[],
        (true, None) => &CHANNELS[..PAPER_CHANNELS],
        (true, Some(_)) => &CHANNELS,
    }
}

fn matched_map(params: &MatchPairParams, matcher: &Matcher, noisy: &Cameras, image: &Image) -> (Depth, Tally) {
    let (geometry, side) = (matcher.geometry(), params.of);
    let ideal = geometry.ideal[side];
    let empty = || vec![f32::NAN; ideal.z.len()];
    let wanted = channels(params);
    let mut z = empty();
    let mut values: Vec<Vec<f32>> = wanted.iter().map(|_| empty()).collect();
    let mut rows: Vec<Row> = z.chunks_mut(ideal.width).map(|z| Row { z, channels: Vec::new() }).collect();
    for ((_, of), values) in wanted.iter().zip(&mut values) {
        rows.iter_mut().zip(values.chunks_mut(ideal.width)).for_each(|(row, values)| row.channels.push((*of, values)));
    }
    let tally = matcher.match_image(&mut rows);
    let mut channels: BTreeMap<String, Vec<f32>> =
        wanted.iter().map(|(name, _)| (*name).to_owned()).zip(values).collect();
    if params.channels {
        channels.insert("valid".to_owned(), z.iter().map(|z| f32::from(u8::from(z.is_finite()))).collect());
    }
    let (sensor, image) = match params.sampling {
        Sampling::Image => (noisy.sensor(image).clone(), Image { sensor: 0, ..image.clone() }),
        Sampling::Rectified => rectified_camera(geometry, side, image),
    };
    let map = Depth {
        frame: noisy.frame,
        sensor,
        image,
        downscale: ideal.downscale,
        width: ideal.width,
        height: ideal.height,
        z,
        channels,
    };
    (map, tally)
}

/// One row of a depth map and of its channels.
struct Row<'a> {
    z: &'a mut [f32],
    channels: Vec<(Of, &'a mut [f32])>,
}

impl TakeMatches for Row<'_> {
    fn take(&mut self, column: usize, m: &Match) {
        self.z[column] = m.depth_m as f32;
        for (of, channel) in &mut self.channels {
            channel[column] = of(m) as f32;
        }
    }

    #[inline(always)]
    fn take_depths(&mut self, first: usize, depth_m: Lanes, _: Lanes) -> bool {
        if !self.channels.is_empty() {
            return false;
        }
        self.z[first..first + LANES].copy_from_slice(&depth_m.narrowed());
        true
    }
}

fn report(
    params: &MatchPairParams,
    context: &Context,
    pair: &Pair,
    map: &Depth,
    tally: &Tally,
) -> Result<(), StageError> {
    if tally.count == 0 {
        return Err(StageError::new(format!("pair `{}`: the two images have no point in common", pair.name))
            .hint("its images do not overlap, or every point is hidden from the other (see `occlusion`)"));
    }
    let count = tally.count as f64;
    // Of the images, not of a coarser depth map.
    let rms_px = f64::from(map.downscale) * (tally.y_parallax2_px2 / count).sqrt();
    context.metric("valid_share", count / map.z.len() as f64, "1");
    context.metric("y_parallax_rms", rms_px, "px");
    context.metric("depth_per_disparity", tally.depth_per_px_m / count, "m/px");
    if let Some(warning) = params.matching.judge_y_parallax(&pair.name, rms_px)? {
        context.warn(warning);
    }
    Ok(())
}

/// Logs what turns disparities of the channels into depths.
fn report_geometry(rectification: &Rectification, context: &Context) {
    context.metric("rectified_focal", rectification.focal_px, "px");
    context.metric("baseline", rectification.baseline_m, "m");
    context.metric("disparity_at_infinity", rectification.shift_px(), "px");
}

#[cfg(test)]
pub(in crate::matching) mod learnt_tests;
#[cfg(test)]
mod own_errors_tests;
#[cfg(test)]
mod tests;
