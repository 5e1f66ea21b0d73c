//! The parameters that all stages which match pairs have in common.

use crate::matching::noise::ensemble::Numbers;
use crate::matching::noise::matcher::{MatcherTerms, PaperNoise};
use crate::matching::noise::model_draws::Model;
use crate::matching::noise::paper::{Distribution, FieldRecipe, Interpolation, Variance};
use crate::matching::pair::Sampling;
use crate::matching::setup::Setup;
use rockface_core::artefact::{Depth, Raster};
use rockface_core::params::{Fault, Range};
use rockface_core::{StageError, choice, params};

choice! {
    /// Where the noise of disparities comes from.
    pub enum NoiseSource {
        /// The paper's two components, with the further terms of `matcher`.
        Paper = "paper",
        /// The model at port `noise`, which holds all of it: the parameters of the paper's components have no effect.
        Learnt = "learnt",
    }
}

choice! {
    /// What the pixels of `sigma_local_px`, `sigma_regular_px`, `spacing_px` and `matcher` are.
    pub enum Pixels {
        /// Those of the depth map: a coarser one has more noise on the face, as that of a real matcher has.
        DepthMap = "depth_map",
        /// Those of the images: the noise on the face is the same at any downscale.
        Image = "image",
    }
}

/// What the ports of a matching stage add to its noise.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoisePorts<'a> {
    /// Factor on the local noise by place.
    pub strength: Option<&'a Raster>,
    /// Learnt model that all noise is drawn from, in place of the paper's.
    pub noise: Option<Model<'a>>,
    /// Errors of the user's own.
    pub errors: Option<&'a Depth>,
}

params! {
    /// How pairs are matched, and with what noise.
    pub struct Matching {
        /// Where the noise comes from.
        noise: NoiseSource = NoiseSource::Paper,
        /// Number of the acquisition in the order of surveys, such as 0 before and 1 after: those with an even number draw from the fields of the first half
        /// of the rasters that a learnt model was made of, those with an odd one from the second half. Two that are compared should have an even
        /// and an odd one: where both had the same field, their noise would cancel or double. Left out: all fields.
        acquisition: Option<u32> = None,
        /// Number among the replicates of a survey that is simulated many times with a learnt model, from 0 on: they take the strengths and amplitudes of its
        /// rasters in turn, so that a few replicates differ from each other as much as many. Left out: those of a raster at random.
        replicate: Option<u32> = None,
        /// What the pixels of the parameters of the noise are.
        pixels: Pixels = Pixels::DepthMap,
        /// Standard deviation of the white disparity noise, pixels of the depth map.
        sigma_local_px: f64 = 0.7; Range::NonNegative,
        /// Standard deviation of the smooth disparity noise, pixels of the depth map; in Table 1 0.7 (Hunter Valley) and 0.65 (Nobbys Head).
        sigma_regular_px: f64 = 0.6; Range::NonNegative,
        /// Distance of the nodes of the smooth noise, pixels of the depth map.
        spacing_px: f64 = 50.0; Range::AtLeast(2.0),
        /// How the smooth noise is interpolated between its nodes.
        kernel: Interpolation = Interpolation::CatmullRom,
        /// What the standard deviation of the smooth noise refers to.
        variance: Variance = Variance::Nodes,
        /// Distribution of the white noise; noise with a `local_length_px` of `matcher` is Gaussian. With an `image_share` of `matcher` it is that of each part,
        /// and their sum is nearer to a Gaussian.
        local_distribution: Distribution = Distribution::Gaussian,
        /// Distribution of the nodes of the smooth noise.
        regular_distribution: Distribution = Distribution::Gaussian,
        /// What a real matcher's noise has beyond these two; left out: nothing, the paper's noise.
        matcher: Option<MatcherTerms> = None,
        /// Whether a pixel counts only where the other image sees the same point.
        occlusion: bool = true,
        /// Share of the depth by which a point may lie behind what the other image sees and still be seen.
        occlusion_tolerance: f64 = 0.001; Range::NonNegative,
        /// Largest rms y-parallax between rectified images, pixels of the images at any downscale; beyond it matching would fail.
        max_y_parallax_px: f64 = 2.0; Range::Positive,
    }
}

/// Y-parallax above which a warning is due, pixels.
const DOUBTFUL_Y_PARALLAX_PX: f64 = 0.5;

impl Matching {
    /// Whether matching draws random numbers. The terms of `matcher` draw their fields without the paper's noise too.
    pub fn draws(&self) -> bool {
        let has_paper_noise = self.sigma_local_px > 0.0 || self.sigma_regular_px > 0.0;
        self.noise == NoiseSource::Learnt || has_paper_noise || self.matcher.is_some()
    }

    /// What of the parameters has no effect beside others.
    pub fn faults(&self) -> Vec<Fault> {
        let is_correlated = self.matcher.as_ref().is_some_and(|terms| terms.local_length_px > 0.0);
        if self.noise == NoiseSource::Learnt || !is_correlated || self.local_distribution == Distribution::Gaussian {
            return Vec::new();
        }
        let fault = Fault::new(
            "`local_distribution` is that of white noise, and with `local_length_px` of `matcher` the local noise is a Gaussian \
             field: leave one of the two out",
        );
        vec![Fault { path: vec!["local_distribution".into()], ..fault }]
    }

    /// How pairs are matched, with a map of the strength of the noise or a learnt model where one is given.
    pub fn setup<'a>(&self, sampling: Sampling, ports: NoisePorts<'a>) -> Result<Setup<'a>, StageError> {
        self.check_ports(ports)?;
        let strength = ports.strength;
        let recipe = FieldRecipe {
            spacing_px: self.spacing_px,
            distribution: self.regular_distribution,
            interpolation: self.kernel,
            variance: self.variance,
        };
        let noise = PaperNoise {
            sigma_local_px: self.sigma_local_px,
            local_distribution: self.local_distribution,
            sigma_regular_px: self.sigma_regular_px,
            recipe,
        };
        let occlusion_tolerance = self.occlusion.then_some(self.occlusion_tolerance);
        if ports.errors.is_some() && sampling == Sampling::Rectified {
            let error = StageError::new(
                "`errors` are of the pixels of an image, and disparities are sampled at rectified ones",
            );
            return Err(error.hint("leave `sampling: rectified` out, or the input"));
        }
        let image_pixels = self.pixels == Pixels::Image;
        let (terms, learnt, errors) = (self.matcher.clone(), ports.noise, ports.errors);
        let numbers = Numbers { acquisition: self.acquisition, replicate: self.replicate };
        Ok(Setup { sampling, image_pixels, noise, terms, occlusion_tolerance, strength, learnt, numbers, errors })
    }

    fn check_ports(&self, ports: NoisePorts) -> Result<(), StageError> {
        let refuse = |error: &str, hint: &str| Err(StageError::new(error).hint(hint));
        let terms = ports.strength.is_some() || self.matcher.is_some();
        let numbered = [("acquisition", self.acquisition), ("replicate", self.replicate)];
        if let Some((name, _)) = numbered.into_iter().find(|(_, number)| number.is_some())
            && self.noise == NoiseSource::Paper
        {
            let error = format!("`{name}` numbers the draws of a learnt model, but the paper's noise is asked for");
            return refuse(&error, &format!("set `noise: learnt`, or leave `{name}` out"));
        }
        match (self.noise, ports.noise) {
            (NoiseSource::Learnt, None) => {
                let error = "`noise: learnt` needs a model at port `noise`";
                refuse(error, "make one from rasters without change with `learn-noise`, or leave `noise` out")
            }
            (NoiseSource::Paper, Some(_)) => {
                let error = "a noise model is given at port `noise`, but the paper's noise is asked for";
                refuse(error, "set `noise: learnt`, or leave the input out")
            }
            (NoiseSource::Learnt, Some(_)) if terms => {
                let error = "a learnt model holds all noise; `matcher` and `strength` are terms of the paper's";
                refuse(error, "leave out `matcher` and the input `strength`, or the model")
            }
            (NoiseSource::Paper, None) if ports.strength.is_some() && self.matcher.is_none() => {
                let error = "the paper's noise is equally strong everywhere and has no use for `strength`";
                refuse(error, "add `matcher: {}` to the parameters, or leave the input out")
            }
            _ => Ok(()),
        }
    }

    /// Judges the rms y-parallax of a pair in pixels of its images: a warning where it is doubtful, an error where no matcher would
    /// succeed. What orientation tears apart does not shrink because a depth map is coarser.
    pub fn judge_y_parallax(&self, pair: &str, rms_px: f64) -> Result<Option<String>, StageError> {
        let limit = self.max_y_parallax_px;
        let finding = format!("pair `{pair}`: the rms y-parallax is {rms_px:.2} px");
        if rms_px > limit {
            let text = format!("{finding}, {limit} px are allowed: these images could not be matched");
            let hint = "perturb the cameras with the full joint covariance, or less; or raise `max_y_parallax_px`";
            return Err(StageError::new(text).hint(hint));
        }
        Ok((rms_px > DOUBTFUL_Y_PARALLAX_PX).then(|| format!("{finding}; a real matcher would lose precision")))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::params::ParamType;

    #[test]
    fn y_parallax_is_doubtful_beyond_half_a_pixel_and_refused_beyond_what_is_allowed() {
        let matching = Matching::decode(&json!({"max_y_parallax_px": 3.0})).unwrap();
        let judge = |rms_px: f64| matching.judge_y_parallax("a+b", rms_px);
        assert_eq!(judge(0.49).unwrap(), None);
        assert!(judge(0.51).unwrap().unwrap().contains("pair `a+b`: the rms y-parallax is 0.51 px"));
        assert!(judge(2.99).unwrap().is_some());
        let refused = judge(3.01).unwrap_err();
        assert!(refused.message.contains("3 px are allowed") && refused.hint.unwrap().contains("max_y_parallax_px"));
    }
}
