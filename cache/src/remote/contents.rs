//! What this process knows of a remote place: its records, and where their blobs are.

use std::collections::{BTreeSet, HashMap, HashSet};

use super::batch::{Batch, Place};
use crate::{Digest, Record};

/// Records and blobs of the batches that were read or written.
#[derive(Debug, Default)]
pub(crate) struct Contents {
    batches: BTreeSet<Digest>,
    records: HashMap<Digest, Box<[u8]>>,
    blobs: HashMap<Digest, Place>,
    /// Further places of blobs that several batches name, in packs of their own.
    elsewhere: HashMap<Digest, Vec<Place>>,
    /// Blobs that turned out to be gone or damaged there.
    lost: HashSet<Digest>,
}

impl Contents {
    /// Takes in what a batch says; of two records of a key the one that [`replaces`] the other stays.
    pub fn enter(&mut self, name: Digest, batch: Batch) {
        if !self.batches.insert(name) {
            return;
        }
        for (key, payload) in batch.records {
            if self.records.get(&key).is_none_or(|known| replaces(&payload, known)) {
                self.records.insert(key, payload);
            }
        }
        for (digest, place) in batch.blobs {
            let known = *self.blobs.entry(digest).or_insert(place);
            if known != place {
                self.elsewhere.entry(digest).or_default().push(place);
            }
        }
    }

    /// Enters a batch that this process has just written: its blobs are there again, should they have been lost.
    pub fn enter_own(&mut self, name: Digest, batch: Batch) {
        for (digest, place) in &batch.blobs {
            if self.lost.remove(digest) {
                self.blobs.insert(*digest, *place);
            }
        }
        self.enter(name, batch);
    }

    /// Whether this batch was read.
    pub fn has_batch(&self, name: &Digest) -> bool {
        self.batches.contains(name)
    }

    /// The batches that were read, sorted.
    pub fn batches(&self) -> impl Iterator<Item = &Digest> {
        self.batches.iter()
    }

    /// The bytes of the record under this key.
    pub fn record(&self, key: &Digest) -> Option<&[u8]> {
        self.records.get(key).map(AsRef::as_ref)
    }

    /// The keys of all records.
    pub fn keys(&self) -> impl Iterator<Item = &Digest> {
        self.records.keys()
    }

    /// Where a blob is, unless it turned out to be lost.
    pub fn place(&self, digest: &Digest) -> Option<Place> {
        self.blobs.get(digest).copied().filter(|_| !self.lost.contains(digest))
    }

    /// A blob is gone or damaged where it was looked for. Whether it is in another place too, which then is its place.
    pub fn lose(&mut self, digest: Digest) -> bool {
        let other = self.elsewhere.get_mut(&digest).and_then(Vec::pop);
        match other {
            Some(place) => _ = self.blobs.insert(digest, place),
            None => _ = self.lost.insert(digest),
        }
        other.is_some()
    }

    /// All blobs of a pack.
    pub fn in_pack(&self, pack: &Digest) -> Vec<(Digest, Place)> {
        self.blobs
            .iter()
            .filter(|(_, place)| place.pack == Some(*pack))
            .map(|(digest, place)| (*digest, *place))
            .collect()
    }
}

/// Whether of two records of one key the new one is better: it keeps more outputs. Otherwise the one that was finished first
/// holds, whatever the order in which they are read.
fn replaces(new: &[u8], known: &[u8]) -> bool {
    let (Some(new), Some(known)) = (Record::decode(new), Record::decode(known)) else { return false };
    if known.keeps_more_than(&new) {
        return false;
    }
    new.keeps_more_than(&known) || new.cost.finished_unix_s < known.cost.finished_unix_s
}
