//! Prepares a pair for matching: checks depth maps and cameras, and sets up the noise.

use crate::camera::model::Camera;
use crate::matching::noise::ensemble::Numbers;
use crate::matching::noise::learnt::Acquisition;
use crate::matching::noise::matcher::{Keys, MatcherTerms, PairScene, PaperNoise};
use crate::matching::noise::model::{NoiseModel, Scaled};
use crate::matching::noise::model_draws::Model;
use crate::matching::noise::paper::{LocalNoise, SmoothNoise};
use crate::matching::own_errors::errors_of;
use crate::matching::pair::{Matcher, Sampling};
use crate::matching::pair_geometry::PairGeometry;
use crate::matching::side::Side;
use rockface_core::artefact::{Cameras, Depth, Image, Pairs, Raster};
use rockface_core::{StageError, fail};

/// Least distance of the nodes of the smooth noise, pixels of the depth map.
const LEAST_SPACING_PX: f64 = 1.0;

/// How pairs are matched; the same for all pairs.
#[derive(Debug, Clone)]
pub struct Setup<'s> {
    /// Where disparities are sampled.
    pub sampling: Sampling,
    /// Whether the pixels of the noise are those of the images, and not of the depth maps.
    pub image_pixels: bool,
    /// White and smooth noise as the paper has them.
    pub noise: PaperNoise,
    /// Further terms of a real matcher's noise.
    pub terms: Option<MatcherTerms>,
    /// Share of the depth by which a point may lie behind the surface that the other image sees; `None`: nothing hides a point.
    pub occlusion_tolerance: Option<f64>,
    /// Factor on the local noise by place; `None`: 1 everywhere.
    pub strength: Option<&'s Raster>,
    /// The learnt model all noise is drawn from; `None`: the paper's noise and its further terms.
    pub learnt: Option<Model<'s>>,
    /// Which acquisition is drawn from it.
    pub numbers: Numbers,
    /// Errors of the user's own, added to the others.
    pub errors: Option<&'s Depth>,
}

impl<'s> Setup<'s> {
    /// The noise that a learnt model gives to all pairs of an image; `None` without a model.
    ///
    /// # Errors
    /// A model or cameras that do not fit the depth map.
    pub fn acquisition(
        &self,
        ideal: &Depth,
        block: &Cameras,
        pairs: &Pairs,
        keys: Keys,
    ) -> Result<Option<Acquisition<'s>>, StageError> {
        self.learnt.map(|model| Acquisition::new(model, self.numbers, ideal, block, pairs, keys)).transpose()
    }

    /// The matcher of a pair from its ideal depth maps (first, second), for the depth map of image `side`.
    ///
    /// `acquisition` is that of the image, see [`Self::acquisition`]; `keys` gives the random streams `match-local` and `match-regular` of the pair, and those of [`MatcherTerms::fields`].
    pub fn matcher<'a>(
        &self,
        pair: &str,
        ideal: [&'a Depth; 2],
        side: Side,
        block: &Cameras,
        acquisition: Option<&Acquisition>,
        keys: Keys,
    ) -> Result<Matcher<'a>, StageError>
    where
        's: 'a,
    {
        let images = [noisy_image(block, ideal[0])?, noisy_image(block, ideal[1])?];
        let noisy = images.map(|image| Camera::new(block.sensor(image), image));
        let of_pair = |e: StageError| StageError { message: format!("pair `{pair}`: {}", e.message), ..e };
        let geometry = PairGeometry::new(ideal, noisy).map_err(of_pair)?;
        let scene = PairScene { name: pair, geometry: &geometry, side, strength: self.strength };
        let own =
            if self.image_pixels { self.in_image_pixels(ideal[0].downscale).map_err(of_pair)? } else { self.clone() };
        let noise = match acquisition {
            Some(acquisition) => NoiseModel::Learnt(acquisition.of_pair(pair, side)),
            None => own.noise_model(&scene, keys).map_err(of_pair)?,
        };
        let errors = self.errors.map(|map| errors_of(map, pair, ideal[side])).transpose()?;
        Ok(Matcher::new(geometry, side, self.sampling, noise, self.occlusion_tolerance).with_errors(errors))
    }

    /// The same noise on the face for depth maps that are coarser than the images.
    fn in_image_pixels(&self, downscale: u32) -> Result<Self, StageError> {
        let scale = f64::from(downscale).recip();
        let mut own = self.clone();
        own.noise.sigma_local_px *= scale;
        own.noise.sigma_regular_px *= scale;
        own.noise.recipe.spacing_px *= scale;
        if own.noise.recipe.spacing_px < LEAST_SPACING_PX {
            let spacing = self.noise.recipe.spacing_px;
            return Err(StageError::new(format!(
                "nodes {spacing} pixels of the images apart are nearer than pixels of the depth maps at downscale {downscale}"
            ))
            .hint("a smaller downscale, or a larger `spacing_px`"));
        }
        own.terms = self.terms.as_ref().map(|terms| terms.scaled(scale)).transpose()?;
        Ok(own)
    }

    fn noise_model(&self, scene: &PairScene, keys: Keys) -> Result<NoiseModel, StageError> {
        if let Some(terms) = &self.terms {
            return Ok(NoiseModel::Terms(Box::new(terms.fields(&self.noise, scene, keys)?)));
        }
        Ok(NoiseModel::Paper { local: self.local(scene, keys), smooth: self.smooth(scene, keys)? })
    }

    fn local(&self, scene: &PairScene, keys: Keys) -> Option<Scaled<LocalNoise>> {
        let sigma_px = self.noise.sigma_local_px;
        let field = || LocalNoise::new(&keys("match-local", scene.name), self.noise.local_distribution);
        (sigma_px > 0.0).then(|| Scaled { sigma_px, field: field() })
    }

    fn smooth(&self, scene: &PairScene, keys: Keys) -> Result<Option<Scaled<SmoothNoise>>, StageError> {
        let sigma_px = self.noise.sigma_regular_px;
        if sigma_px <= 0.0 {
            return Ok(None);
        }
        let field = scene.geometry.smooth_noise(&keys("match-regular", scene.name), self.noise.recipe)?;
        Ok(Some(Scaled { sigma_px, field }))
    }
}

/// The image of the noisy block to which a depth map belongs.
pub fn noisy_image<'a>(noisy: &'a Cameras, depth: &Depth) -> Result<&'a Image, StageError> {
    let name = &depth.image.name;
    let Some(image) = noisy.image(name) else {
        return Err(StageError::new(format!("`noisy` has no image `{name}`, of which there is a depth map"))
            .hint("make `noisy` from the cameras that the depth maps were projected with: `perturb-cameras`"));
    };
    if noisy.frame != depth.frame {
        let frames = format!("the {} frame, the depth map of image `{name}` in the {} frame", noisy.frame, depth.frame);
        return Err(
            StageError::new(format!("`noisy` is in {frames}")).hint("bring both into one frame with `transform-crs`")
        );
    }
    let sensor = noisy.sensor(image);
    if (sensor.width_px, sensor.height_px) != (depth.sensor.width_px, depth.sensor.height_px) {
        let (w, h) = (sensor.width_px, sensor.height_px);
        let (v, g) = (depth.sensor.width_px, depth.sensor.height_px);
        return Err(StageError::new(format!(
            "image `{name}` has {w} x {h} pixels in `noisy`, but {v} x {g} in its depth map"
        ))
        .hint("make `noisy` from the cameras that the depth maps were projected with: `perturb-cameras`"));
    }
    Ok(image)
}

/// Checks that a depth map has as many pixels as its camera says; `place` names it.
pub fn check_size(place: &str, depth: &Depth) -> Result<(), StageError> {
    let size = [depth.sensor.width_px, depth.sensor.height_px].map(|full| (full / depth.downscale) as usize);
    if size != [depth.width, depth.height] {
        let ([w, h], scale) = (size, depth.downscale);
        fail!("{place} has {} x {} pixels, its camera at downscale {scale} {w} x {h}", depth.width, depth.height);
    }
    Ok(())
}
