//! A noise model and what was drawn from it lately: images of a survey are matched in steps of their own and see the same noise of the face, which
//! is then drawn once.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use crate::matching::noise::ensemble::{Drawn, draw};
use crate::matching::noise::matcher::Keys;
use rockface_core::artefact::{Artefact, Noise, Noun};
use rockface_core::numerics::random::Key;

/// Values of all draws that are held.
const MOST_VALUES: usize = 1 << 23;

/// Draws made lately, the latest last.
static LATELY: Mutex<Vec<Made>> = Mutex::new(Vec::new());

/// A draw, and what it was made of.
struct Made {
    model: Weak<Artefact>,
    number: Option<u32>,
    stream: Key,
    drawn: Arc<Drawn>,
}

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

    /// As [`draw`]. A draw of the same artefact with the same number and streams is not recomputed while it is held.
    pub fn draw(self, number: Option<u32>, keys: Keys) -> Arc<Drawn> {
        // All streams of a step follow from what one of them follows from.
        let stream = keys("noise-acquisition", "");
        let model = Arc::downgrade(self.artefact);
        let same = |made: &&Made| made.model.ptr_eq(&model) && made.number == number && made.stream == stream;
        if let Some(made) = lately(|all| all.iter().find(same).map(|made| made.drawn.clone())) {
            return made;
        }
        // Nobody waits for a draw: a thread that has to could be the one that makes it.
        let drawn = Arc::new(draw(self.noise, number, keys));
        let made = Made { model, number, stream, drawn: drawn.clone() };
        lately(|all| hold(all, made));
        drawn
    }
}

fn lately<T>(look: impl FnOnce(&mut Vec<Made>) -> T) -> T {
    look(&mut LATELY.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Holds a draw, and releases those whose model is gone and the oldest beyond [`MOST_VALUES`].
fn hold(all: &mut Vec<Made>, made: Made) {
    all.retain(|made| made.model.strong_count() > 0);
    all.push(made);
    let mut values = 0;
    let first = all.iter().rposition(|made| {
        values += made.drawn.field.len();
        values > MOST_VALUES
    });
    all.drain(..first.map_or(0, |last_too_many| last_too_many + 1));
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
    fn a_draw_is_made_once_for_one_model_number_and_stream() {
        let artefacts = [model(), Noise { bad_share: 0.5, ..model() }].map(|noise| Arc::new(Artefact::from(noise)));
        let [one, other] = artefacts.each_ref().map(|artefact| Model::of(artefact).unwrap());
        let first = one.draw(Some(0), &keys(1));
        assert!(Arc::ptr_eq(&first, &one.draw(Some(0), &keys(1))));
        assert_eq!(first.field, draw(one.noise, Some(0), &keys(1)).field);
        for again in [one.draw(Some(1), &keys(1)), one.draw(Some(0), &keys(2)), other.draw(Some(0), &keys(1))] {
            assert!(!Arc::ptr_eq(&first, &again));
        }
    }

    #[test]
    fn draws_of_models_that_are_gone_and_the_oldest_are_released() {
        let model = Arc::new(Artefact::from(model()));
        let made = |cells: usize, number: u32, model: Weak<Artefact>| Made {
            model,
            number: Some(number),
            stream: Key([0; 32]),
            drawn: Arc::new(Drawn { field: vec![0.0; cells], log_strength: Vec::new(), bad: false }),
        };
        let mut all = Vec::new();
        hold(&mut all, made(10, 0, Weak::new()));
        for number in 1..4 {
            hold(&mut all, made(MOST_VALUES / 2, number, Arc::downgrade(&model)));
        }
        assert_eq!(all.iter().filter_map(|made| made.number).collect::<Vec<_>>(), [2, 3]);
        // One that is too large by itself is not held.
        hold(&mut all, made(MOST_VALUES + 1, 4, Arc::downgrade(&model)));
        assert!(all.is_empty());
    }
}
