//! Fetching blobs: verified, several at a time, and a whole pack at once.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::PoisonError;
use std::sync::atomic::Ordering::Relaxed;

use super::backend::{Backend, BackendError};
use super::batch::Place;
use super::open::Shared;
use super::{AT_ONCE, OBJECT_LIMIT, blob_name, each_at_once, pack_name};
use crate::Digest;

/// Takes a blob that was fetched and verified.
pub(crate) type Take<'a> = &'a (dyn Fn(&[u8]) + Sync);

impl Shared {
    /// Fetches those of these blobs that the remote place has, and hands over each. A step that needs one of the others computes it.
    pub fn fetch(&self, wanted: impl IntoIterator<Item = Digest>, take: Take) {
        let place = |digest: &Digest| self.read(|contents| contents.place(digest));
        let mut tried: BTreeMap<Digest, Place> =
            wanted.into_iter().filter_map(|digest| Some((digest, place(&digest)?))).collect();
        while !tried.is_empty() {
            self.fetch_from(&tried, take);
            // Those that were lost where they were looked for, and are in another place too.
            tried = tried
                .into_iter()
                .filter_map(|(digest, before)| Some((digest, place(&digest).filter(|now| *now != before)?)))
                .collect();
        }
    }

    /// Fetches blobs from these places.
    fn fetch_from(&self, wanted: &BTreeMap<Digest, Place>, take: Take) {
        let mut packs: BTreeMap<Digest, BTreeSet<Digest>> = BTreeMap::new();
        let mut single = BTreeMap::new();
        for (digest, place) in wanted {
            match place.pack {
                Some(pack) => _ = packs.entry(pack).or_default().insert(*digest),
                None => _ = single.insert(*digest, *place),
            }
        }
        let packs = packs.into_iter().map(|(pack, wanted)| Object::Pack(pack, wanted));
        let objects = single.into_iter().map(|(digest, place)| Object::Single(digest, place)).chain(packs).collect();
        each_at_once(objects, AT_ONCE, |object| match object {
            Object::Single(digest, place) => self.fetch_single(&digest, place, take),
            Object::Pack(pack, wanted) => self.fetch_pack(&pack, &wanted, take),
        });
    }

    fn fetch_single(&self, digest: &Digest, place: Place, take: Take) {
        if place.bytes > self.largest.load(Relaxed) {
            return self.lose([*digest], "says that a blob is larger than the memory there is");
        }
        match self.breaker.attempt(|| self.backend.get(&blob_name(digest), place.bytes)) {
            Ok(bytes) if Digest::of(&bytes) == *digest => take(&bytes),
            Err(BackendError::Missing) => self.lose([*digest], "has lost a blob"),
            Ok(_) | Err(BackendError::TooLarge { .. }) => self.lose([*digest], "has a damaged blob"),
            // The breaker takes note of it; this blob is computed.
            Err(_) => _ = self.edit(|contents| contents.lose(*digest)),
        }
    }

    /// Fetches a pack and hands over all blobs in it: those of one run are mostly wanted together.
    fn fetch_pack(&self, pack: &Digest, wanted: &BTreeSet<Digest>, take: Take) {
        let found = self.breaker.attempt(|| self.backend.get(&pack_name(pack), OBJECT_LIMIT));
        let lost = |what| self.lose(wanted.iter().copied(), what);
        let bytes = match found {
            Ok(bytes) => bytes,
            Err(BackendError::Missing) => return lost("has lost a pack of blobs"),
            Err(BackendError::TooLarge { .. }) => return lost("has a damaged pack of blobs"),
            Err(_) => return self.edit(|contents| wanted.iter().for_each(|digest| _ = contents.lose(*digest))),
        };
        let mut damaged = Vec::new();
        for (digest, place) in self.read(|contents| contents.in_pack(pack)) {
            let end = place.at.checked_add(place.bytes).and_then(|end| usize::try_from(end).ok());
            let blob: Option<&[u8]> = end.and_then(|end| bytes.get(place.at as usize..end));
            match blob.filter(|blob| Digest::of(blob) == digest) {
                Some(blob) => take(blob),
                None => damaged.push(digest),
            }
        }
        if !damaged.is_empty() {
            self.lose(damaged, "has a damaged pack of blobs");
        }
    }

    /// Blobs are gone or damaged: they are computed when they are needed.
    fn lose(&self, digests: impl IntoIterator<Item = Digest>, what: &str) {
        let gone = self.edit(|contents| digests.into_iter().filter(|digest| !contents.lose(*digest)).count());
        if gone > 0 {
            self.breaker.warn_once(&format!("{what}; whatever is missing there is computed again when it is needed"));
        }
    }

    /// One pack at a time: see [`Shared::packs`].
    pub fn one_pack(&self) -> std::sync::MutexGuard<'_, ()> {
        self.packs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What is fetched with one request.
enum Object {
    Single(Digest, Place),
    Pack(Digest, BTreeSet<Digest>),
}
