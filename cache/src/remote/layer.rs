//! The local store over a remote place: what is not here is looked for there, and what is made here goes there.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, PoisonError};

use super::claims::{Claims, Times};
use super::open::Remote;
use super::upload::{Uploaded, Uploader};
use crate::error::StoreError;
use crate::frame::Kind;
use crate::{Digest, Record, Store};

impl Store {
    /// Puts this store over a remote place. What is committed from now on is uploaded in the background, unless the place is
    /// only read. There is one such place for a store; a second is refused, and given back.
    pub fn attach(&self, remote: Remote) -> Result<(), Box<Remote>> {
        if !remote.shared.is_read_only {
            let claims = Claims::new(Arc::clone(&remote.shared), self.machine().name(), Times::default());
            let claims = remote.claims.get_or_init(|| Arc::new(claims));
            *remote.uploader.lock().unwrap_or_else(PoisonError::into_inner) =
                Uploader::start(Arc::clone(&remote.shared), Arc::clone(claims), Box::new(self.reader()));
        }
        self.remote.set(Box::new(remote))
    }

    /// The remote place under this store.
    pub fn remote(&self) -> Option<&Remote> {
        self.remote.get().map(AsRef::as_ref)
    }

    /// What is in the remote place, unless it is left alone.
    fn below(&self) -> Option<&Remote> {
        self.remote().filter(|remote| !remote.is_off())
    }

    /// Who computes what among those that share the remote place.
    pub(crate) fn claims(&self) -> Option<&Arc<Claims>> {
        self.remote()?.claims.get()
    }

    /// How many of so many steps that are ready should be taken along with this one, which is to be locked next: a remote place
    /// under this store takes long to answer.
    pub fn worth_ahead(&self, key: &Digest, ready: usize) -> usize {
        self.claims().map_or(0, |claims| claims.worth_ahead(key, ready))
    }

    /// Whether a step could be taken along: no other process has it, and no record of it has come.
    pub fn is_open(&self, key: &Digest) -> bool {
        !self.has_record_below(key) && self.claims().is_none_or(|claims| claims.is_free(key))
    }

    /// Takes these steps along with the next that is locked.
    pub fn take_ahead(&self, keys: Vec<Digest>) {
        if let Some(claims) = self.claims() {
            claims.take_ahead(keys);
        }
    }

    /// Reads the bytes of blobs that are here.
    pub(super) fn reader(&self) -> impl Fn(&Digest) -> Option<Vec<u8>> + Send + Sync + use<> {
        let (journal, blobs) = (Arc::clone(self.shared_journal()), crate::blobs::Blobs::new(self.dir(), self.dir()));
        move |digest| {
            let bytes = match journal.with_index(|index| index.blob(digest)) {
                Some(place) => journal.read_if_there(place).ok().flatten()?,
                None => blobs.get(digest).ok()?,
            };
            (Digest::of(&bytes) == *digest).then_some(bytes)
        }
    }

    /// The bytes of the record that the remote place has under this key.
    pub(crate) fn record_below(&self, key: &Digest) -> Option<Box<[u8]>> {
        self.below()?.shared.read(|contents| contents.record(key).map(Into::into))
    }

    /// Whether the remote place has a record under this key.
    pub(crate) fn has_record_below(&self, key: &Digest) -> bool {
        self.below().is_some_and(|remote| remote.shared.read(|contents| contents.record(key).is_some()))
    }

    /// The size of a blob that the remote place has.
    pub(crate) fn size_below(&self, digest: &Digest) -> Option<u64> {
        self.below()?.shared.read(|contents| contents.place(digest)).map(|place| place.bytes)
    }

    /// Fetches blobs that are not here from the remote place, several at a time. One that is not available is missing from then
    /// on. Without a remote place this does nothing.
    pub fn bring(&self, blobs: impl IntoIterator<Item = Digest>) -> Result<(), StoreError> {
        let Some(remote) = self.below() else { return Ok(()) };
        let is_absent = |digest: &Digest| self.size_here(digest).is_none();
        let absent: BTreeSet<Digest> = blobs.into_iter().filter(is_absent).collect();
        if absent.is_empty() {
            return Ok(());
        }
        // Steps that ask for blobs of one pack at the same time fetch it once.
        let packed =
            |digest: &Digest| remote.shared.read(|contents| contents.place(digest).is_some_and(|at| at.pack.is_some()));
        let _one = absent.iter().any(packed).then(|| remote.shared.one_pack());
        let absent = absent.into_iter().filter(is_absent);
        let fault = std::sync::Mutex::new(None);
        remote.shared.fetch(absent, &|bytes| {
            if let Err(error) = self.put(bytes) {
                *fault.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            }
        });
        fault.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }

    /// Offers a record that is here to the remote place; where that is left alone by now, it counts as one that was not uploaded.
    pub(crate) fn offer(&self, key: &Digest, payload: &[u8]) {
        let Some(remote) = self.remote() else { return };
        let uploader = remote.uploader.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(uploader) = uploader.as_ref() else { return };
        let is_there = remote.shared.read(|contents| {
            let known = contents.record(key).and_then(Record::decode);
            known.is_some_and(|known| {
                Record::decode(payload).is_none_or(|own| !own.keeps_more_than(&known))
                    && known.blobs().all(|(digest, _)| contents.place(&digest).is_some())
            })
        });
        if !is_there && uploader.offer(*key, payload) {
            self.claims().iter().for_each(|claims| claims.uploads(key));
        }
    }

    /// Offers a record that was looked up; quick where the remote place has it.
    pub(crate) fn offer_again(&self, key: &Digest) {
        if self.remote.get().is_none() || self.has_record_below(key) {
            return;
        }
        let payload = self.journal().with_index(|index| index.payload(Kind::Record, key).map(Box::<[u8]>::from));
        if let Some(payload) = payload {
            self.offer(key, &payload);
        }
    }

    /// Keeps those records of the remote place under these keys whose blobs are all here by now.
    pub fn adopt(&self, keys: impl IntoIterator<Item = Digest>) -> Result<(), StoreError> {
        if self.remote.get().is_none() {
            return Ok(());
        }
        for key in keys {
            let known = self.journal().with_index(|index| index.payload(Kind::Record, &key).is_some());
            if let Some(payload) = self.record_below(&key).filter(|_| !known)
                && let Some(record) = Record::decode(&payload)
                && record.blobs().all(|(digest, bytes)| self.has_here(&digest, bytes))
            {
                self.append(Kind::Record, key, &payload)?;
            }
        }
        Ok(())
    }

    /// Gives back what this process has taken at the remote place, within a few seconds: so nobody waits for one that was interrupted.
    pub fn leave(&self) {
        self.claims().iter().for_each(|claims| claims.leave());
    }

    /// Waits until all is uploaded, or `stop` is set; nothing is uploaded any more after that, and no step is taken.
    pub fn finish_uploads(&self, stop: &AtomicBool) -> Uploaded {
        let Some(remote) = self.remote() else { return Uploaded::default() };
        let uploader = remote.uploader.lock().unwrap_or_else(PoisonError::into_inner).take();
        let done = uploader.map(|uploader| uploader.finish(stop)).unwrap_or_default();
        remote.claims.get().iter().for_each(|claims| claims.leave());
        if done.records > 0 && !remote.is_off() {
            // Only places that cannot be listed are read by it.
            drop(remote.shared.breaker.attempt(|| remote.shared.write_index()));
        }
        done
    }
}
