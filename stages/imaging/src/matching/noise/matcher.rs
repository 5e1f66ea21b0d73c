//! The parameters of the terms that a real matcher's noise has beyond the paper's, and the fields of these terms for one pair.

use crate::camera::model::{Camera, full_pixel};
use crate::matching::noise::correlated::CorrelatedNoise;
use crate::matching::noise::model::Scaled;
use crate::matching::noise::modulation::{Blunders, Modulation, Patches, smooth_field};
use crate::matching::noise::paper::{Distribution, FieldRecipe, LocalNoise, SmoothNoise};
use crate::matching::noise::sharing::{Owner, shared};
use crate::matching::noise::strength::Strength;
use crate::matching::noise::terms::{Address, Ledges, Part, Relief, Terms, UnitField};
use crate::matching::noise::window::{WindowEffects, relief, seen_depth};
use crate::matching::pair_geometry::PairGeometry;
use crate::matching::side::Side;
use rockface_core::StageError;
use rockface_core::artefact::{Depth, Frame, Raster};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;
use rockface_core::params;
use rockface_core::params::Range;

params! {
    /// How acquisitions differ from each other: light, haze, focus.
    pub struct Acquisition {
        /// Standard deviation of the logarithm of a factor on all noise of the acquisition; its median is 1.
        log_sd: f64 = 0.15; Range::Between(0.0, 2.0),
        /// The same for a factor on `local_length_px`: a blurred image has a longer one.
        length_log_sd: f64 = 0.0; Range::Between(0.0, 2.0),
        /// Power of the factor on the noise that multiplies `local_length_px` too: haze and blur make noise stronger and longer.
        length_power: f64 = 0.0; Range::Between(0.0, 2.0),
        /// Share of bad acquisitions.
        bad_share: f64 = 0.0; Range::Between(0.0, 1.0),
        /// Further factor on the noise of bad ones.
        bad_factor: f64 = 2.5; Range::AtLeast(1.0),
    }
}

params! {
    /// How the texture of the face, and with it the noise, varies from place to place; it stays the same over acquisitions.
    pub struct Texture {
        /// Standard deviation of the logarithm of a factor on the noise; its mean square is 1.
        log_sd: f64 = 0.3; Range::Between(0.0, 2.0),
        /// Length of its (Gaussian) correlation on the face, metres.
        length_m: f64 = 0.15; Range::Positive,
        /// Number of the texture: another face has another.
        seed: u32 = 0,
    }
}

params! {
    /// How shadow and moisture vary the noise from place to place, anew in every acquisition.
    pub struct Conditions {
        /// Standard deviation of the logarithm of a factor on the noise; its mean square is 1.
        log_sd: f64 = 0.2; Range::Between(0.0, 2.0),
        /// Length of its (Gaussian) correlation, pixels of the depth map.
        length_px: f64 = 40.0; Range::AtLeast(1.0),
    }
}

params! {
    /// Noise that grows where the disparity varies within the matcher's window: on slopes and at ledges.
    pub struct ReliefNoise {
        /// Standard deviation of the noise where the disparity within the window has a deviation of one pixel, pixels of the
        /// depth map; it adds to `sigma_local_px` in squares.
        gain: f64 = 0.25; Range::NonNegative,
        /// How it grows with that deviation: as its square by default.
        power: f64 = 2.0; Range::Between(0.25, 4.0),
        /// Half width of the window, pixels of the depth map.
        window_px: u32 = 4; Range::Between(1.0, 50.0),
        /// Largest deviation within the window that counts, pixels of the depth map.
        limit_px: f64 = 5.0; Range::Positive,
    }
}

params! {
    /// What the noise at ledges (from `relief`, or from the map at port `strength`) has of its own.
    pub struct LedgeNoise {
        /// Factor of the map from which on its noise is that of ledges.
        from: f64 = 1.6; Range::AtLeast(0.0),
        /// Deviation of what all ledges have in common in an acquisition, as a share of the deviation of their noise: how far
        /// the foreground grows depends on light and blur. It makes rasters skewed, to either side.
        common: f64 = 0.12; Range::Between(0.0, 1.0),
        /// Share of the variance whose correlation is longer along the rows of the first image, as a matcher that follows its
        /// scan lines has it.
        along_share: f64 = 0.3; Range::Between(0.0, 1.0),
        /// How many times longer.
        along: f64 = 4.0; Range::AtLeast(1.0),
    }
}

params! {
    /// What the window does to the surface itself.
    pub struct Window {
        /// Half width over which disparity is averaged, pixels of the depth map; 0: none.
        smoothing_px: u32 = 1; Range::Between(0.0, 50.0),
        /// How far the near side of a depth step grows over the far one, pixels of the depth map.
        fattening_px: u32 = 1; Range::Between(0.0, 50.0),
        /// Smallest step that grows, metres.
        step_m: f64 = 0.1; Range::Positive,
    }
}

params! {
    /// Neighbourhoods matched to the wrong place.
    pub struct BlunderPatches {
        /// Share of the image they cover.
        share: f64 = 0.01; Range::Between(0.0, 1.0),
        /// Length of the (Gaussian) correlation that shapes them, pixels of the depth map.
        length_px: f64 = 6.0; Range::AtLeast(1.0),
        /// Standard deviation of the disparity error inside, pixels of the depth map.
        sigma_px: f64 = 2.0; Range::NonNegative,
    }
}

params! {
    /// Neighbourhoods without a match.
    pub struct HolePatches {
        /// Share of the image they cover.
        share: f64 = 0.01; Range::Between(0.0, 1.0),
        /// Length of the (Gaussian) correlation that shapes them, pixels of the depth map.
        length_px: f64 = 6.0; Range::AtLeast(1.0),
    }
}

params! {
    /// What a real matcher's noise has beyond the paper's two fields; every term is off unless it is given.
    pub struct MatcherTerms {
        /// Length of the correlation of the local noise, pixels of the depth map; 0: white.
        local_length_px: f64 = 0.0; Range::NonNegative,
        /// Smoothness of its Matern correlation: 0.5 is exponential.
        local_smoothness: f64 = 0.5; Range::Between(0.1, 5.0),
        /// How many times longer it is along the rows of the image than down the columns, which `local_length_px` is for.
        local_stretch: f64 = 1.0; Range::Between(0.2, 20.0),
        /// Share of the noise variance that belongs to the two images, half each: errors of positions in an image, of which every
        /// pair of the image has what is along its baseline. The rest is the pair's own. The steps that are to share it need one stream that does not depend on the pair.
        image_share: f64 = 0.0; Range::Between(0.0, 1.0),
        /// How acquisitions differ.
        acquisition: Option<Acquisition> = None,
        /// Noise by texture of the face.
        texture: Option<Texture> = None,
        /// Noise by shadow and moisture.
        conditions: Option<Conditions> = None,
        /// Noise by relief.
        relief: Option<ReliefNoise> = None,
        /// What the noise at ledges has of its own; left out: nothing.
        ledges: Option<LedgeNoise> = None,
        /// The surface as the window sees it.
        window: Option<Window> = None,
        /// Neighbourhoods matched to the wrong place.
        blunders: Option<BlunderPatches> = None,
        /// Neighbourhoods without a match.
        holes: Option<HolePatches> = None,
        /// Largest pull of disparities towards whole numbers, pixels of the depth map.
        pixel_locking_px: f64 = 0.0; Range::Between(0.0, 0.15),
        /// Step disparities are rounded to, pixels of the depth map; 0: none.
        disparity_step_px: f64 = 0.0; Range::NonNegative,
    }
}

/// The paper's noise, to which the terms are added.
#[derive(Debug, Clone, Copy)]
pub struct PaperNoise {
    /// Standard deviation of the local noise, pixels.
    pub sigma_local_px: f64,
    /// Its distribution where it is white.
    pub local_distribution: Distribution,
    /// Standard deviation of the smooth noise, pixels.
    pub sigma_regular_px: f64,
    /// How the smooth noise is made.
    pub recipe: FieldRecipe,
}

/// The pair whose noise is set up.
pub struct PairScene<'a> {
    /// Name of the pair.
    pub name: &'a str,
    /// Its depth maps and cameras.
    pub geometry: &'a PairGeometry<'a>,
    /// The image whose depth map is made.
    pub side: Side,
    /// Factor on the local noise by place; `None`: 1 everywhere.
    pub strength: Option<&'a Raster>,
}

impl PairScene<'_> {
    /// Ideal depth map of the image whose depth map is made.
    fn depth(&self) -> &Depth {
        self.geometry.ideal[self.side]
    }

    /// Columns and rows of an image, pixels of the depth map.
    fn extent(&self, side: Side) -> [f64; 2] {
        let depth = self.geometry.ideal[side];
        [depth.width as f64, depth.height as f64]
    }
}

/// Keys of random streams by purpose and item.
pub type Keys<'a> = &'a dyn Fn(&str, &str) -> Key;

impl MatcherTerms {
    /// The same terms with all lengths and disparities multiplied.
    ///
    /// # Errors
    /// Terms with a window of whole pixels, which cannot be multiplied.
    pub fn scaled(&self, scale: f64) -> Result<Self, StageError> {
        if self.relief.is_some() || self.window.is_some() {
            return Err(StageError::new("`relief` and `window` of `matcher` have whole pixels of the depth map")
                .hint("leave them out, or set `pixels: depth_map`"));
        }
        let mut terms = self.clone();
        terms.local_length_px *= scale;
        terms.pixel_locking_px *= scale;
        terms.disparity_step_px *= scale;
        if let Some(conditions) = &mut terms.conditions {
            conditions.length_px = (conditions.length_px * scale).max(1.0);
        }
        if let Some(blunders) = &mut terms.blunders {
            blunders.length_px = (blunders.length_px * scale).max(1.0);
            blunders.sigma_px *= scale;
        }
        if let Some(holes) = &mut terms.holes {
            holes.length_px = (holes.length_px * scale).max(1.0);
        }
        Ok(terms)
    }

    /// Terms that are all off: only the paper's noise is left.
    pub fn none() -> Self {
        Self {
            local_length_px: 0.0,
            local_smoothness: 0.5,
            local_stretch: 1.0,
            image_share: 0.0,
            acquisition: None,
            texture: None,
            conditions: None,
            relief: None,
            ledges: None,
            window: None,
            blunders: None,
            holes: None,
            pixel_locking_px: 0.0,
            disparity_step_px: 0.0,
        }
    }

    /// The depth map with the effects of the window; `None` without this term.
    pub fn windowed(&self, depth: &Depth) -> Option<Depth> {
        let Window { smoothing_px, fattening_px, step_m } = self.window.clone()?;
        let effects =
            WindowEffects { smoothing_px: smoothing_px as usize, fattening_px: fattening_px as usize, step_m };
        Some(Depth { z: seen_depth(depth, &effects), ..depth.clone() })
    }

    /// The fields of a pair.
    ///
    /// # Errors
    /// A texture or a map of strength over a depth map in another frame; a first image that cannot be rectified.
    pub fn fields(&self, noise: &PaperNoise, scene: &PairScene, keys: Keys) -> Result<Terms, StageError> {
        let (depth, camera) = (scene.depth(), &scene.geometry.cameras[scene.side]);
        let image = scene.extent(Side::First);
        let key = |purpose: &str| keys(purpose, scene.name);
        let field = |purpose: &str, length: f64| smooth_field(&key(purpose), length, [0.0; 2], image);
        let acquisition = self.acquisition_factors(&keys("match-acquisition", ""));
        let patches = |purpose: &str, share: f64, length_px: f64| Patches::new(share, field(purpose, length_px));
        Ok(Terms {
            local: Scaled {
                sigma_px: noise.sigma_local_px,
                field: self.local_parts(noise, scene, keys, acquisition[1]),
            },
            regular: Scaled { sigma_px: noise.sigma_regular_px, field: self.regular_parts(noise, scene, keys)? },
            acquisition: acquisition[0],
            texture: self.texture.as_ref().map(|texture| texture.modulation(depth, camera)).transpose()?,
            conditions: self
                .conditions
                .as_ref()
                .map(|c| Modulation { log_sd: c.log_sd, field: field("match-conditions", c.length_px) }),
            relief: self.relief.as_ref().map(|term| term.over(depth)),
            map: self.map(scene)?,
            ledges: self.ledges.as_ref().map(|ledges| {
                let length_px = self.local_length_px * acquisition[1];
                ledges.drawn(length_px, self.local_smoothness, scene, keys)
            }),
            stretch: if self.local_length_px > 0.0 { self.local_stretch } else { 1.0 },
            blunders: self.blunders.as_ref().map(|b| Blunders {
                patches: patches("match-blunders", b.share, b.length_px),
                sigma_px: b.sigma_px,
                error: field("match-blunder-error", b.length_px),
            }),
            holes: self.holes.as_ref().map(|h| patches("match-holes", h.share, h.length_px)),
            locking_px: self.pixel_locking_px,
            step_px: self.disparity_step_px,
        })
    }

    /// Factors of this acquisition on the noise and on its local length.
    fn acquisition_factors(&self, key: &Key) -> [f64; 2] {
        let Some(a) = &self.acquisition else { return [1.0; 2] };
        let field = key.field();
        let [strength, length] = field.normals(0, 0);
        let bad = f64::from(field.words(1, 0)[0]) < a.bad_share * 4_294_967_296.0;
        let strength = portable_math::exp(a.log_sd * strength) * if bad { a.bad_factor } else { 1.0 };
        let length = portable_math::exp(a.length_log_sd * length) * portable_math::pow(strength, a.length_power);
        [strength, length]
    }

    /// The strength of the noise by place; without `ledges` all of it counts as texture.
    fn map(&self, scene: &PairScene) -> Result<Option<Strength>, StageError> {
        let (Some(raster), depth) = (scene.strength, scene.depth()) else { return Ok(None) };
        if raster.frame != depth.frame {
            let text = format!(
                "the map of strength is in the {} frame, the depth maps in the {} frame",
                raster.frame, depth.frame
            );
            return Err(StageError::new(text).hint("make the map from rasters in the frame of the survey"));
        }
        Ok(Some(Strength::new(raster, self.ledges.as_ref().map_or(f64::INFINITY, |ledges| ledges.from))))
    }

    fn local_parts(&self, noise: &PaperNoise, scene: &PairScene, keys: Keys, length_factor: f64) -> Vec<Part> {
        let part = |owner: Owner| {
            let (item, side) = (owner.item(scene), owner.side().unwrap_or(Side::First));
            let purpose = owner.purpose("match-local");
            let field = if self.local_length_px > 0.0 {
                let key = |level: usize| keys(&format!("{purpose}-{level}"), item);
                let (low, high) = ([0.0; 2], scene.extent(side));
                let length_px = self.local_length_px * length_factor;
                UnitField::Correlated(CorrelatedNoise::new(length_px, self.local_smoothness, key, low, high))
            } else {
                UnitField::White(LocalNoise::new(&keys(&purpose, item), noise.local_distribution))
            };
            Ok::<_, std::convert::Infallible>(Part { weight: 1.0, address: Address::pixel(side), field })
        };
        let Ok(parts) = shared(self.image_share, scene, part);
        parts
    }

    fn regular_parts(&self, noise: &PaperNoise, scene: &PairScene, keys: Keys) -> Result<Vec<Part>, StageError> {
        if noise.sigma_regular_px <= 0.0 {
            return Ok(Vec::new());
        }
        shared(self.image_share, scene, |owner| {
            let key = keys(&owner.purpose("match-regular"), owner.item(scene));
            let (address, field) = match owner.side() {
                None => (Address::Rectified, scene.geometry.smooth_noise(&key, noise.recipe)?),
                Some(side) => {
                    let field = SmoothNoise::new(&key, noise.recipe, [0.0; 2], scene.extent(side));
                    (Address::pixel(side), field)
                }
            };
            Ok(Part { weight: 1.0, address, field: UnitField::Smooth(field) })
        })
    }
}

impl LedgeNoise {
    /// The ledges of one acquisition of a pair; `length_px` and `smoothness` are those of its local noise.
    fn drawn(&self, length_px: f64, smoothness: f64, scene: &PairScene, keys: Keys) -> Ledges {
        let key = |level: usize| keys(&format!("match-ledges-{level}"), scene.name);
        let high = scene.extent(Side::First);
        let along =
            CorrelatedNoise::new(length_px.max(0.5), smoothness, key, [0.0; 2], [high[0] / self.along, high[1]]);
        let common = self.common * keys("match-ledge-growth", scene.name).field().normal(0, 0);
        Ledges { along_share: self.along_share, along, along_rows: self.along, common }
    }
}

impl ReliefNoise {
    fn over(&self, depth: &Depth) -> Relief {
        let inverse_depth = relief(depth, self.window_px as usize);
        Relief { gain: self.gain, power: self.power, limit_px: self.limit_px, inverse_depth }
    }
}

/// Step between the pixels that are probed for the extent of the face, along rows and columns.
const PROBE_PX: usize = 16;

impl Texture {
    /// The modulation over the part of the face that a depth map shows.
    fn modulation(&self, depth: &Depth, camera: &Camera) -> Result<Modulation, StageError> {
        if depth.frame != Frame::Wall {
            let text = format!("the texture lies on the face, but the depth maps are in the {} frame", depth.frame);
            return Err(StageError::new(text).hint("bring mesh and cameras into the wall frame with `transform-crs`"));
        }
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for row in (0..depth.height).step_by(PROBE_PX) {
            for column in (0..depth.width).step_by(PROBE_PX) {
                let z = depth.z[row * depth.width + column];
                let Some(ray) = camera.normalised(full_pixel(column, row, depth.downscale)) else { continue };
                if z.is_finite() {
                    let point = camera.unproject(ray, f64::from(z));
                    low = [low[0].min(point.x), low[1].min(point.y)];
                    high = [high[0].max(point.x), high[1].max(point.y)];
                }
            }
        }
        let empty = low[0] > high[0];
        let (low, high) = if empty { ([0.0; 2], [0.0; 2]) } else { (low, high) };
        Ok(Modulation { log_sd: self.log_sd, field: smooth_field(&self.key(), self.length_m, low, high) })
    }

    /// The random stream of the texture. It depends on the seed alone, so every acquisition has the same texture.
    fn key(&self) -> Key {
        let mut bytes = *b"....    texture of the face     ";
        bytes[..4].copy_from_slice(&self.seed.to_le_bytes());
        Key(bytes)
    }
}
