//! What a step leaves in the store, with one write: its small blobs, and behind them its record.

use crate::store::LARGE_BYTES;
use crate::{Digest, Record, Store, StoreError};

/// Blobs that go into the store with the record that names them.
///
/// To write each by itself takes longer than short steps do. Large ones have files of their own and are put at once; of the others
/// nothing is seen, and nothing survives the process, before the record is committed.
#[derive(Debug)]
#[must_use = "small blobs are stored by the commit"]
pub struct Parcel<'s> {
    store: &'s Store,
    blobs: Vec<(Digest, Vec<u8>)>,
}

impl Store {
    /// A parcel for the blobs of one record.
    pub fn parcel(&self) -> Parcel<'_> {
        Parcel { store: self, blobs: Vec::new() }
    }
}

impl Parcel<'_> {
    /// Adds a blob and returns its digest.
    pub fn put(&mut self, bytes: Vec<u8>) -> Result<Digest, StoreError> {
        if bytes.len() >= LARGE_BYTES {
            return self.store.put(&bytes);
        }
        let digest = Digest::of(&bytes);
        self.blobs.push((digest, bytes));
        Ok(digest)
    }

    /// [`Store::commit`] of a record that names blobs of this parcel and of the store. Should one of the store have left again since
    /// it was put, `put_again` is called, which puts them all.
    pub fn commit_or<E: From<StoreError>>(
        &self,
        record: &Record,
        put_again: impl FnOnce() -> Result<(), E>,
    ) -> Result<Digest, E> {
        self.store.commit_with(record, &self.blobs, put_again)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cost, OutputRecord, Outputs, Recipe, SafeName};

    #[test]
    fn what_is_in_a_parcel_is_there_with_its_record_and_not_before() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Store::open(&folder.path().join("store")).unwrap();
        let (store, bytes) = (open(), b"ten cubic metres".to_vec());
        let mut parcel = store.parcel();
        let (digest, length) = (Digest::of(&bytes), bytes.len() as u64);
        assert_eq!(parcel.put(bytes).unwrap(), digest);
        assert!(!store.contains(&digest));
        let output =
            OutputRecord { kind: "table".into(), digest, bytes: length, kept: true, memory_bytes: None, items: None };
        let recipe = Recipe {
            stage: "sum".into(),
            version: 1,
            params: std::sync::Arc::default(),
            inputs: [].into(),
            seed: None,
        };
        let outputs = Outputs::from_iter([(SafeName::new("table").unwrap(), output)]);
        let record = Record { recipe, outputs, log: None, sketches: None, cost: Cost::default() };
        assert!(store.commit(&record).is_err(), "the blob is in the parcel only");
        let never = || -> Result<(), StoreError> { panic!("all is there") };
        let key = parcel.commit_or(&record, never).unwrap();
        assert!(open().is_hit(&key).is_some(), "another process has it whole");
        // Once more: neither the blob nor the record is written again.
        let before = store.stat().unwrap().segment_bytes;
        parcel.commit_or(&record, never).unwrap();
        assert_eq!(store.stat().unwrap().segment_bytes, before);
    }
}
