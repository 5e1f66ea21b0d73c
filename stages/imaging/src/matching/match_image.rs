//! `match-image`: the depth map of an image fused from all of its stereo pairs, of which none is ever stored.

use std::collections::BTreeMap;

use crate::matching::image::{Fusion, ImageTally, match_image};
use crate::matching::noise::matcher::MatcherTerms;
use crate::matching::noise::model_draws::Model;
use crate::matching::pair::{Matcher, Sampling};
use crate::matching::params::{Matching, NoisePorts, NoiseSource, Pixels};
use crate::matching::setup::{Setup, check_size, noisy_image};
use crate::matching::side::Side;
use rockface_core::artefact::{Cameras, Depth, Image, Kind, Noise, Pair, Pairs, Raster};
use rockface_core::params::{Fault, Range};
use rockface_core::{
    Context, Element, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params, union,
};
use rockface_raster::robust_mean::{Averaging, Fused, Rule};

params! {
    /// Nothing to say.
    pub struct Whole {}
}

params! {
    /// How much of the noise belongs to the images.
    pub struct Mix {
        /// Share of the noise variance that belongs to the two images of a pair, half each.
        image_share: f64 = 0.5; Range::Between(0.0, 1.0),
    }
}

union! {
    /// What the errors of the pairs of an image have in common.
    pub enum NoiseSharing {
        /// Nothing: every pair has errors of its own (the paper), which average away over the pairs.
        Pair(Whole) = "pair",
        /// Everything: half of a pair's noise variance is each image's, errors of its positions, of which each of its pairs has what is along
        /// its baseline.
        Image(Whole) = "image",
        /// Something of both.
        Mix(Mix) = "mix",
    }
}

choice! {
    /// What is kept of a fused pixel beside its depth.
    pub enum Channel {
        /// Its expected standard deviation, metres.
        Sigma = "sigma",
        /// How many pairs it stands on.
        Pairs = "pairs",
    }
}

params! {
    /// Parameters of `match-image`.
    pub struct MatchImageParams {
        ..matching: Matching,
        /// Name of the image.
        image: String,
        /// What the errors of the pairs of an image have in common.
        noise_sharing: NoiseSharing = NoiseSharing::Pair(Whole {}),
        /// How the depths of the pairs that agree become one.
        averaging: Averaging = Averaging::Mean,
        /// A depth is rejected beyond so many robust deviations from the weighted median of the pairs (1.4826 times the median
        /// absolute deviation), or so many of its own expected deviations where that is more.
        rejection: f64 = 3.0; Range::Positive,
        /// Fewest pairs that must agree on a pixel.
        min_pairs: u32 = 1; Range::AtLeast(1.0),
        /// Channels kept beside the depth.
        channels: Vec<Channel> = vec![Channel::Sigma],
    }
}

/// Pairs an image may have.
const MAXIMUM_PAIRS: usize = 255;

/// Makes the depth map of an image as dense matching with all of its partners would.
pub struct MatchImage;

impl Stage for MatchImage {
    type Params = MatchImageParams;
    const NAME: &'static str = "match-image";
    const VERSION: u32 = 12;
    const PAGE: Page = Page::new(include_str!("match_image.md"));
    const INPUTS: &'static [Port] = &[
        Port::many(
            "depths",
            &[Kind::Depth],
            "Ideal depth maps with their true cameras: of the image, of its partners, of any other.",
        ),
        Port::one("noisy", &[Kind::Cameras], "The cameras as the bundle adjustment believes them to be."),
        Port::one("pairs", &[Kind::Pairs], "The pairs of the block."),
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
        &[Port::one("depth", &[Kind::Depth], "The fused noisy depth map, with its noisy camera.")];

    fn draws(params: &Self::Params) -> bool {
        params.matching.draws()
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // The ideal maps that are held; the map and its channels, with two copies while they are written; terms of the noise.
        let maps = 1 + params.channels.len() as u64;
        let terms = if params.matching.matcher.is_some() { 3 } else { 0 };
        inputs.total() + (33 * maps / 10 + terms) * inputs.largest("depths")
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = params.matching.faults();
        if params.matching.noise == NoiseSource::Learnt && !matches!(params.noise_sharing, NoiseSharing::Pair(_)) {
            let fault =
                Fault::new("a learnt model is the same for all pairs of an acquisition: leave `noise_sharing` out");
            faults.push(Fault { path: vec!["noise_sharing".into()], ..fault });
            return faults;
        }
        let shared = params.matching.matcher.as_ref().is_some_and(|matcher| matcher.image_share > 0.0);
        if !shared || matches!(params.noise_sharing, NoiseSharing::Pair(_)) {
            return faults;
        }
        let fault = Fault::new("`matcher` has an `image_share` already: give one of the two");
        faults.push(Fault { path: vec!["noise_sharing".into()], ..fault });
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (noisy, pairs) = (inputs.one::<Cameras>("noisy")?, inputs.one::<Pairs>("pairs")?);
        let ideal = depth_of(inputs, &params.image, None)?;
        let chosen = pairs_of(pairs, &params.image)?;
        let image = noisy_image(noisy, ideal)?;
        let setup = setup(params, ports(inputs)?)?;
        let windowed = setup.terms.as_ref().and_then(|terms| terms.windowed(ideal));
        let depth = windowed.as_ref().unwrap_or(ideal);
        let keys = |purpose: &str, item: &str| context.stream(purpose, item);
        let acquisition = setup.acquisition(depth, noisy, pairs, &keys)?;
        let mut matchers = Vec::with_capacity(chosen.len());
        for pair in &chosen {
            context.check_cancelled()?;
            let (side, partner) = side_and_partner(pair, &params.image);
            let partner = depth_of(inputs, partner, Some(pair))?;
            check_scale(ideal, partner)?;
            let depths = side.array(depth, partner);
            matchers.push(setup.matcher(&pair.name, depths, side, noisy, acquisition.as_ref(), &keys)?);
        }
        let (map, tally) = fused_map(params, depth, &matchers, noisy, image);
        report(params, context, &chosen, &map, &tally)?;
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

/// The side of a pair on which an image is, and the name of the other image.
fn side_and_partner<'a>(pair: &'a Pair, image: &str) -> (Side, &'a str) {
    if pair.second == image { (Side::Second, &pair.first) } else { (Side::First, &pair.second) }
}

/// The one depth map of an image; `pair` is the pair that needs it, for the message.
fn depth_of<'a>(inputs: &'a Inputs, image: &str, pair: Option<&Pair>) -> Result<&'a Depth, StageError> {
    let depths = candidates(inputs, image)?;
    let mut of_image = depths.iter().filter(|depth| depth.image.name == image);
    let needed = pair.map_or(String::new(), |pair| format!(", which pair `{}` needs", pair.name));
    let (Some(depth), None) = (of_image.next(), of_image.next()) else {
        let count = depths.iter().filter(|depth| depth.image.name == image).count();
        let error = StageError::new(format!("`depths` holds {count} depth maps of image `{image}`{needed}, not one"));
        return Err(error.hint("gather them over the axis of images: {each: depth.depth, over: [image]}"));
    };
    check_size(&format!("the depth map of image `{image}`"), depth)?;
    Ok(depth)
}

/// The depth maps to search for that of an image: those gathered under its name, so that few of a large block are read;
/// all of them where no map is gathered under its name.
fn candidates<'a>(inputs: &'a Inputs, image: &str) -> Result<Vec<&'a Depth>, StageError> {
    let named = |(_, element): &(usize, &Element)| element.point.values().any(|item| item == image);
    let elements = inputs.elements("depths").iter().enumerate().filter(named);
    let depths: Vec<&Depth> = elements.map(|(index, _)| inputs.nth("depths", index)).collect::<Result<_, _>>()?;
    if depths.iter().any(|depth| depth.image.name == image) {
        return Ok(depths);
    }
    Ok(inputs.many::<Depth>("depths")?.into_iter().map(|(_, depth)| depth).collect())
}

fn pairs_of<'a>(pairs: &'a Pairs, image: &str) -> Result<Vec<&'a Pair>, StageError> {
    let chosen: Vec<&Pair> = pairs.pairs.iter().filter(|pair| pair.first == image || pair.second == image).collect();
    match chosen.len() {
        0 => Err(StageError::new(format!("image `{image}` is in none of the {} pairs", pairs.pairs.len())).hint(
            "take the images from `cameras` of `select-pairs`, which has only those in a pair, or widen its limits",
        )),
        n if n > MAXIMUM_PAIRS => fail!("image `{image}` has {n} pairs, {MAXIMUM_PAIRS} at most can be fused"),
        _ => Ok(chosen),
    }
}

fn check_scale(ideal: &Depth, other: &Depth) -> Result<(), StageError> {
    if ideal.downscale == other.downscale {
        return Ok(());
    }
    let (name, partner) = (&ideal.image.name, &other.image.name);
    let text = format!("image `{name}` has downscale {}, its partner `{partner}` {}", ideal.downscale, other.downscale);
    Err(StageError::new(text).hint("project all depth maps with one `downscale`"))
}

fn setup<'a>(params: &MatchImageParams, ports: NoisePorts<'a>) -> Result<Setup<'a>, StageError> {
    let mut setup = params.matching.setup(Sampling::Image, ports)?;
    let share = match &params.noise_sharing {
        NoiseSharing::Pair(_) => 0.0,
        NoiseSharing::Image(_) => 1.0,
        NoiseSharing::Mix(mix) => mix.image_share,
    };
    if share > 0.0 {
        setup.terms.get_or_insert_with(MatcherTerms::none).image_share = share;
    }
    Ok(setup)
}

fn fusion(params: &MatchImageParams, downscale: u32) -> Fusion {
    let (local, regular) = (params.matching.sigma_local_px, params.matching.sigma_regular_px);
    let paper = params.matching.noise == NoiseSource::Paper;
    let scale = if params.matching.pixels == Pixels::Image { f64::from(downscale).recip() } else { 1.0 };
    let sigma_px = scale * (local * local + regular * regular).sqrt();
    let rule = Rule {
        averaging: params.averaging,
        rejection: params.rejection,
        tolerance_m: 0.0,
        minimum: params.min_pairs as usize,
    };
    // Without noise, or with that of a model, a deviation of one pixel weights the depths.
    Fusion { rule, sigma_px: if paper && sigma_px > 0.0 { sigma_px } else { 1.0 } }
}

/// One row of the map and of its channels.
struct Row<'a> {
    z: &'a mut [f32],
    channels: Vec<(Channel, &'a mut [f32])>,
}

impl Row<'_> {
    fn keep(&mut self, column: usize, fused: &Fused) {
        self.z[column] = fused.value.value_m as f32;
        for (channel, values) in &mut self.channels {
            values[column] = match channel {
                Channel::Sigma => fused.value.sigma_m as f32,
                Channel::Pairs => fused.count as f32,
            };
        }
    }
}

impl Channel {
    fn name(self) -> String {
        let name = match self {
            Self::Sigma => "sigma",
            Self::Pairs => "pairs",
        };
        name.to_owned()
    }
}

fn fused_map(
    params: &MatchImageParams,
    ideal: &Depth,
    matchers: &[Matcher],
    noisy: &Cameras,
    image: &Image,
) -> (Depth, ImageTally) {
    let empty = || vec![f32::NAN; ideal.z.len()];
    let mut z = empty();
    let mut channels: Vec<(Channel, Vec<f32>)> = params.channels.iter().map(|channel| (*channel, empty())).collect();
    let mut rows: Vec<Row> = z.chunks_mut(ideal.width).map(|z| Row { z, channels: Vec::new() }).collect();
    for (channel, values) in &mut channels {
        let lines = rows.iter_mut().zip(values.chunks_mut(ideal.width));
        lines.for_each(|(row, line)| row.channels.push((*channel, line)));
    }
    let tally = match_image(matchers, ideal.width, &fusion(params, ideal.downscale), &mut rows, Row::keep);
    let map = Depth {
        frame: noisy.frame,
        sensor: noisy.sensor(image).clone(),
        image: Image { sensor: 0, ..image.clone() },
        downscale: ideal.downscale,
        width: ideal.width,
        height: ideal.height,
        z,
        channels: channels.into_iter().map(|(channel, values)| (channel.name(), values)).collect::<BTreeMap<_, _>>(),
    };
    (map, tally)
}

fn report(
    params: &MatchImageParams,
    context: &Context,
    pairs: &[&Pair],
    map: &Depth,
    tally: &ImageTally,
) -> Result<(), StageError> {
    if tally.fused == 0 {
        let (n, name) = (pairs.len(), &params.image);
        let text = format!("image `{name}`: none of its {n} pairs gives it a depth ({} pixels matched)", tally.matched);
        return Err(StageError::new(text)
            .hint("its pairs do not overlap, every point is hidden from the partners (see `occlusion`), or `min_pairs` is too high"));
    }
    let mut worst_px = 0.0f64;
    for (pair, matched) in pairs.iter().zip(&tally.pairs) {
        if matched.count == 0 {
            context.warn(format!("pair `{}`: the two images have no point in common", pair.name));
            continue;
        }
        // Of the images, not of a coarser depth map.
        let rms_px = f64::from(map.downscale) * (matched.y_parallax2_px2 / matched.count as f64).sqrt();
        if let Some(warning) = params.matching.judge_y_parallax(&pair.name, rms_px)? {
            context.warn(warning);
        }
        worst_px = worst_px.max(rms_px);
    }
    let fused = tally.fused as f64;
    context.metric("pairs", pairs.len() as f64, "1");
    context.metric("valid_share", fused / map.z.len() as f64, "1");
    context.metric("pairs_per_pixel", tally.kept as f64 / fused, "1");
    context.metric("rejected_share", 1.0 - tally.kept as f64 / tally.given as f64, "1");
    context.metric("expected_sigma", tally.sigma_m / fused, "m");
    context.metric("y_parallax_rms_largest", worst_px, "px");
    Ok(())
}

#[cfg(test)]
mod tests;
