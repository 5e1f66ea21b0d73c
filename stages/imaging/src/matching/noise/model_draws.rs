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

/// What a draw follows from: numbers, stream, and where noise follows the face, the face.
type Asked = (Numbers, Key, Option<Arc<Face>>);

/// Draws made lately: images of a survey see the same noise of the face.
static DRAWS: Lately<Asked, Drawn> = Lately::new(1 << 23);
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

    /// As [`draw`], on a face.
    pub fn draw(self, face: &Arc<Face>, numbers: Numbers, keys: Keys) -> Arc<Drawn> {
        // All streams of a step follow from what one of them follows from.
        let stream = keys("noise-acquisition", "");
        let place = face.ground.as_ref().map(|_| face);
        let same = |(held_numbers, held_stream, held_face): &Asked| {
            (*held_numbers, *held_stream) == (numbers, stream)
                && held_face.as_ref().map(Arc::as_ptr) == place.map(Arc::as_ptr)
        };
        let make = || ((numbers, stream, place.cloned()), draw(self.noise, face.ground.as_ref(), numbers, keys));
        DRAWS.get(self.artefact, same, self.noise.grid.cells(), make)
    }

    /// The face that a depth map shows, as [`seen`].
    pub fn face(self, depth: &Depth) -> Arc<Face> {
        let make = || {
            let shown = Depth { channels: BTreeMap::new(), ..depth.clone() };
            (shown, seen(self.noise, depth, &Camera::of_depth(depth)))
        };
        let numbers = depth.z.len() + 6 * self.noise.grid.cells();
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
        let face = Arc::new(Face { strength: Vec::new(), slopes: Vec::new(), ground: None });
        let first = one.draw(&face, numbers[0], &keys(1));
        assert!(Arc::ptr_eq(&first, &one.draw(&face, numbers[0], &keys(1))));
        assert_eq!(first.field, draw(one.noise, None, numbers[0], &keys(1)).field);
        let others = [(numbers[1], 1), (replicate, 1), (numbers[0], 2)];
        let others = others.map(|(numbers, seed)| one.draw(&face, numbers, &keys(seed)));
        for again in others.into_iter().chain([other.draw(&face, numbers[0], &keys(1))]) {
            assert!(!Arc::ptr_eq(&first, &again));
        }
    }
}
