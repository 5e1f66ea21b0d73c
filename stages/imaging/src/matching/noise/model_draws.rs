//! A noise model at a port, with what was drawn from it and which faces it was laid on lately.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::camera::model::Camera;
use crate::matching::noise::changed_face::{Face, seen};
use crate::matching::noise::ensemble::{Drawn, Numbers, draw};
use crate::matching::noise::lately::Lately;
use crate::matching::noise::matcher::Keys;
use rockface_core::artefact::{Artefact, Depth, Noise, Noun};
use rockface_core::numerics::random::Key;

/// Draws made lately, by numbers and stream: images of a survey see the same noise of the face.
static DRAWS: Lately<(Numbers, Key), Drawn> = Lately::new(1 << 23);
/// Faces seen lately, by the depth map that shows them: surveys of an unchanged face see the same one.
static FACES: Lately<Depth, Face> = Lately::new(1 << 24);

/// A noise model at a port.
#[derive(Debug, Clone, Copy)]
pub struct Model<'a> {
    /// The model.
    pub noise: &'a Noise,
    artefact: &'a Arc<Artefact>,
}

impl<'a> Model<'a> {
    /// The model that an artefact is.
    pub fn of(artefact: &'a Arc<Artefact>) -> Option<Self> {
        Noise::of(artefact).map(|noise| Self { noise, artefact })
    }

    /// As [`draw`].
    pub fn draw(self, numbers: Numbers, keys: Keys) -> Arc<Drawn> {
        // All streams of a step follow from what one of them follows from.
        let of = (numbers, keys("noise-acquisition", ""));
        let make = || (of, draw(self.noise, numbers, keys));
        DRAWS.get(self.artefact, |held| *held == of, self.noise.grid.cells(), make)
    }

    /// The face that a depth map shows, as [`seen`].
    pub fn face(self, depth: &Depth) -> Arc<Face> {
        let make = || {
            let shown = Depth { channels: BTreeMap::new(), ..depth.clone() };
            (shown, seen(self.noise, depth, &Camera::of_depth(depth)))
        };
        let numbers = depth.z.len() + 3 * self.noise.grid.cells();
        FACES.get(self.artefact, |held| shows_same(held, depth), numbers, make)
    }
}

/// Whether two depth maps have the same camera and the same depths, to the bit.
fn shows_same(one: &Depth, other: &Depth) -> bool {
    (one.frame, &one.sensor, &one.image, one.downscale, one.width)
        == (other.frame, &other.sensor, &other.image, other.downscale, other.width)
        && bytemuck::cast_slice::<f32, u8>(&one.z) == bytemuck::cast_slice::<f32, u8>(&other.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::match_pair::learnt_tests::model;

    fn keys(seed: u8) -> impl Fn(&str, &str) -> Key + Sync {
        move |purpose, item| {
            let mut key = [seed; 32];
            [key[0], key[1]] = [purpose, item].map(|text| text.len() as u8);
            Key(key)
        }
    }

    #[test]
    fn a_draw_is_made_once_for_one_model_its_numbers_and_stream() {
        let artefacts = [model(), Noise { bad_share: 0.5, ..model() }].map(|noise| Arc::new(Artefact::from(noise)));
        let [one, other] = artefacts.each_ref().map(|artefact| Model::of(artefact).unwrap());
        let numbers = [0, 1].map(|number| Numbers { acquisition: Some(number), replicate: None });
        let replicate = Numbers { replicate: Some(0), ..numbers[0] };
        let first = one.draw(numbers[0], &keys(1));
        assert!(Arc::ptr_eq(&first, &one.draw(numbers[0], &keys(1))));
        assert_eq!(first.field, draw(one.noise, numbers[0], &keys(1)).field);
        let others = [one.draw(numbers[1], &keys(1)), one.draw(replicate, &keys(1)), one.draw(numbers[0], &keys(2))];
        for again in others.into_iter().chain([other.draw(numbers[0], &keys(1))]) {
            assert!(!Arc::ptr_eq(&first, &again));
        }
    }
}
