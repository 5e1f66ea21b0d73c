//! Copies records and the blobs they name from one store to another.

use crate::error::StoreError;
use crate::{Digest, Store};

/// Number and size of what was copied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Handed {
    /// Records that the other store did not have.
    pub records: u64,
    /// Records it had already, whole.
    pub known: u64,
    /// Records that were asked for and are not whole here.
    pub missing: u64,
    /// Blobs that were written.
    pub blobs: u64,
    /// Size of these blobs in bytes.
    pub bytes: u64,
}

impl Store {
    /// Hands these records to another store, each after the blobs it names; what is there already is not written again.
    ///
    /// Every blob is verified on the way. A record whose blobs are damaged or gone here is counted as missing.
    pub fn hand_to(&self, other: &Store, keys: &[Digest]) -> Result<Handed, StoreError> {
        let mut handed = Handed::default();
        for key in keys {
            self.hand_one(other, key, &mut handed)?;
        }
        other.sync()?;
        Ok(handed)
    }

    fn hand_one(&self, other: &Store, key: &Digest, handed: &mut Handed) -> Result<(), StoreError> {
        let Some(record) = self.is_hit(key) else {
            handed.missing += 1;
            return Ok(());
        };
        // A record that says of more outputs that they are kept than the one that is there takes its place.
        if other.is_hit(key).is_some_and(|there| there.same_outcome(&record) || there.keeps_more_than(&record)) {
            handed.known += 1;
            return Ok(());
        }
        for (digest, _) in record.blobs().filter(|(digest, bytes)| !other.renew(digest, *bytes)) {
            let bytes = match self.get(&digest) {
                Ok(bytes) => bytes,
                Err(StoreError::Damaged { .. } | StoreError::Missing { .. }) => {
                    handed.missing += 1;
                    return Ok(());
                }
                Err(fault) => return Err(fault),
            };
            other.put(&bytes)?;
            handed.blobs += 1;
            handed.bytes += bytes.len() as u64;
        }
        other.commit(&record)?;
        handed.records += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cost, OutputRecord, Recipe, Record};

    fn record(store: &Store, stage: &str, bytes: &[u8], kept: bool) -> Digest {
        let digest = if kept { store.put(bytes).unwrap() } else { Digest::of(bytes) };
        let output = OutputRecord {
            kind: "table".into(),
            digest,
            bytes: bytes.len() as u64,
            kept,
            items: None,
            memory_bytes: None,
        };
        let recipe = Recipe {
            stage: stage.into(),
            version: 1,
            params: serde_json::json!({}).into(),
            inputs: std::collections::BTreeMap::new(),
            seed: None,
        };
        let outputs = [("out", output)].try_into().unwrap();
        store.commit(&Record { recipe, outputs, log: None, sketches: None, cost: Cost::default() }).unwrap()
    }

    #[test]
    fn what_the_other_lacks_is_handed_on_once() {
        let place = tempfile::tempdir().unwrap();
        let (one, other) =
            (Store::open(&place.path().join("a")).unwrap(), Store::open(&place.path().join("b")).unwrap());
        let keys = [record(&one, "small", b"small", true), record(&one, "large", &vec![7; 100_000], true)];
        let handed = one.hand_to(&other, &keys).unwrap();
        assert_eq!((handed.records, handed.known, handed.blobs, handed.bytes), (2, 0, 2, 100_005));
        assert!(keys.iter().all(|key| other.is_hit(key).is_some()));
        let again = one.hand_to(&other, &keys).unwrap();
        assert_eq!((again.records, again.known, again.blobs), (0, 2, 0));
        let unknown = one.hand_to(&other, &[Digest::of(b"nothing")]).unwrap();
        assert_eq!(unknown.missing, 1);
    }

    #[test]
    fn a_record_with_its_outputs_is_not_replaced_by_one_without() {
        let place = tempfile::tempdir().unwrap();
        let (one, other) =
            (Store::open(&place.path().join("a")).unwrap(), Store::open(&place.path().join("b")).unwrap());
        let key = record(&one, "s", b"value", false);
        assert_eq!(record(&other, "s", b"value", true), key);
        assert_eq!(one.hand_to(&other, &[key]).unwrap().known, 1);
        assert!(other.is_hit(&key).unwrap().outputs["out"].kept);
        assert_eq!(other.hand_to(&one, &[key]).unwrap().records, 1);
        assert!(one.is_hit(&key).unwrap().outputs["out"].kept);
    }
}
