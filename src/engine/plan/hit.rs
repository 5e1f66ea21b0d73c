//! Whether a step is on record.

use rockface_cache::{Digest, Outcome, Store};

/// What is recorded under a key, if every blob it promises is there, all outputs are where they are to be kept, and it
/// `fits` the step: a store may have been written to by anybody, and a record that names other ports is none.
pub fn hit(store: &Store, key: &Digest, keep: bool, fits: impl FnOnce(&Outcome) -> bool) -> Option<Outcome> {
    store.hit_outcome(key).filter(|outcome| (!keep || outcome.is_kept()) && fits(outcome))
}
