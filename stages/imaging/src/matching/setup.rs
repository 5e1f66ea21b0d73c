//! A pair made ready for matching: its depth maps and cameras checked, its noise fields set up.

use crate::camera::model::Camera;
use crate::matching::noise::matcher::{Keys, MatcherTerms, PairScene, PaperNoise};
use crate::matching::noise::paper::LocalNoise;
use crate::matching::noisy_rays::NoisyRays;
use crate::matching::pair::{Local, Matcher, Smooth, smooth_noise};
use crate::matching::rectification::Rectification;
use rockface_core::artefact::{Cameras, Depth, Image, Raster};
use rockface_core::{StageError, fail};

/// How pairs are matched; the same for all of them.
#[derive(Debug, Clone)]
pub struct Setup<'s> {
    /// The paper's noise.
    pub noise: PaperNoise,
    /// What a real matcher's noise has beyond it.
    pub terms: Option<MatcherTerms>,
    /// Share of the depth by which a point may lie behind what the other image sees; `None` lets it see through.
    pub occlusion_tolerance: Option<f64>,
    /// How strong the local noise is from place to place; `None`: equally.
    pub strength: Option<&'s Raster>,
}

impl Setup<'_> {
    /// The matcher of a pair from its ideal depth maps (first, second), for the depth map of image `own` (0 or 1).
    ///
    /// Keys are asked for the purposes `match-local` and `match-regular` under the name of the pair, and for those of
    /// [`MatcherTerms::fields`].
    pub fn matcher<'a>(
        &self,
        pair: &str,
        ideal: [&'a Depth; 2],
        own: usize,
        block: &Cameras,
        keys: Keys,
    ) -> Result<Matcher<'a>, StageError> {
        let images = [noisy_image(block, ideal[0])?, noisy_image(block, ideal[1])?];
        let noisy = images.map(|image| Camera::new(block.sensor(image), image));
        let rectification = Rectification::new([&noisy[0], &noisy[1]], ideal[0].downscale)
            .map_err(|e| StageError::new(format!("pair `{pair}`: {}", e.message)))?;
        let cameras = ideal.map(Camera::of_depth);
        let scene = PairScene {
            name: pair,
            depths: ideal,
            own,
            camera: &cameras[own],
            noisy: &noisy[0],
            rectification: &rectification,
            strength: self.strength,
        };
        let (local, smooth, terms) = match &self.terms {
            None => (self.local(&scene, keys), self.smooth(&scene, keys)?, None),
            Some(terms) => (None, None, Some(terms.fields(&self.noise, &scene, keys)?)),
        };
        let same_interior = [0, 1].map(|side| noisy[side].has_interior_of(&cameras[side]));
        let noisy_rays = [0, 1].map(|side| NoisyRays::new(&cameras[side], &noisy[side]));
        Ok(Matcher {
            ideal,
            cameras,
            noisy,
            same_interior,
            noisy_rays,
            rectification,
            local,
            smooth,
            terms,
            occlusion_tolerance: self.occlusion_tolerance,
            rectified: false,
        })
    }

    fn local(&self, scene: &PairScene, keys: Keys) -> Option<Local> {
        let sigma_px = self.noise.sigma_local_px;
        let noise = || LocalNoise::new(&keys("match-local", scene.name), self.noise.local_distribution);
        (sigma_px > 0.0).then(|| (sigma_px, noise()))
    }

    fn smooth(&self, scene: &PairScene, keys: Keys) -> Result<Option<Smooth>, StageError> {
        if self.noise.sigma_regular_px <= 0.0 {
            return Ok(None);
        }
        let key = keys("match-regular", scene.name);
        let field = smooth_noise(&key, self.noise.recipe, scene.depths[0], scene.noisy, scene.rectification)?;
        Ok(Some((self.noise.sigma_regular_px, field)))
    }
}

/// The noisy image a depth map belongs to.
pub fn noisy_image<'a>(noisy: &'a Cameras, depth: &Depth) -> Result<&'a Image, StageError> {
    let name = &depth.image.name;
    let Some(image) = noisy.image(name) else {
        fail!("`noisy` has no image `{name}`, which the pair needs");
    };
    if noisy.frame != depth.frame {
        fail!("`noisy` is in the {} frame, the depth map of image `{name}` in the {} frame", noisy.frame, depth.frame);
    }
    let sensor = noisy.sensor(image);
    if (sensor.width_px, sensor.height_px) != (depth.sensor.width_px, depth.sensor.height_px) {
        let (w, h) = (sensor.width_px, sensor.height_px);
        let (v, g) = (depth.sensor.width_px, depth.sensor.height_px);
        fail!("image `{name}` has {w} x {h} pixels in `noisy`, but {v} x {g} in its depth map");
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
