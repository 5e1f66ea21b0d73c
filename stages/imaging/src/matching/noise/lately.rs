//! What was made lately of noise models: images of a survey are matched in steps of their own, and surveys in rows of them, which share it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use rockface_core::artefact::Artefact;

/// Values that were made of a model and something else, the latest last.
pub struct Lately<K, T> {
    made: Mutex<Vec<Made<K, T>>>,
    /// Numbers of all values that are held.
    most_numbers: usize,
}

/// A value, and what it was made of.
struct Made<K, T> {
    model: Weak<Artefact>,
    of: K,
    numbers: usize,
    value: Arc<T>,
}

impl<K, T> Lately<K, T> {
    /// Room for values with so many numbers.
    pub const fn new(most_numbers: usize) -> Self {
        Self { made: Mutex::new(Vec::new()), most_numbers }
    }

    /// The value of a model and something else, which has so many numbers and is not made anew while it is held; `is` knows the other thing, `make`
    /// hands it over with the value.
    pub fn get(
        &self,
        model: &Arc<Artefact>,
        is: impl Fn(&K) -> bool,
        numbers: usize,
        make: impl FnOnce() -> (K, T),
    ) -> Arc<T> {
        let model = Arc::downgrade(model);
        let same = |made: &&Made<K, T>| made.model.ptr_eq(&model) && is(&made.of);
        if let Some(made) = self.made().iter().find(same).map(|made| made.value.clone()) {
            return made;
        }
        // Nobody waits for a value: a thread that has to could be the one that makes it.
        let (of, value) = make();
        let value = Arc::new(value);
        self.hold(Made { model, of, numbers, value: value.clone() });
        value
    }

    /// Holds a value, and releases those whose model is gone and the oldest beyond the room there is.
    fn hold(&self, new: Made<K, T>) {
        let mut all = self.made();
        all.retain(|made| made.model.strong_count() > 0);
        all.push(new);
        let mut numbers = 0;
        let first = all.iter().rposition(|made| {
            numbers += made.numbers;
            numbers > self.most_numbers
        });
        all.drain(..first.map_or(0, |last_too_many| last_too_many + 1));
    }

    fn made(&self) -> MutexGuard<'_, Vec<Made<K, T>>> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Picture;

    fn artefact() -> Arc<Artefact> {
        Arc::new(Picture { png: Vec::new() }.into())
    }

    #[test]
    fn a_value_is_made_once_for_one_model_and_one_other_thing() {
        let (lately, model, other) = (Lately::new(100), artefact(), artefact());
        let get = |model: &Arc<Artefact>, of: u8, value: u8| lately.get(model, |held| *held == of, 10, || (of, value));
        let first = get(&model, 1, 7);
        assert!(Arc::ptr_eq(&first, &get(&model, 1, 8)));
        assert_eq!((*get(&model, 2, 9), *get(&other, 1, 10), *get(&model, 2, 11)), (9, 10, 9));
    }

    #[test]
    fn values_of_models_that_are_gone_and_the_oldest_are_released() {
        let (lately, model) = (Lately::new(100), artefact());
        let get = |model: &Arc<Artefact>, of: u8, numbers: usize| {
            lately.get(model, |held| *held == of, numbers, || (of, of));
        };
        get(&artefact(), 0, 10);
        (1..4).for_each(|of| get(&model, of, 50));
        let held = || lately.made().iter().map(|made| made.of).collect::<Vec<u8>>();
        assert_eq!(held(), [2, 3]);
        // One that is too large by itself is not held.
        get(&model, 4, 101);
        assert!(held().is_empty());
    }
}
