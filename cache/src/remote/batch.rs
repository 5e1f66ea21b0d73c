//! Batches: many records in one object, and where the blobs are that they name.
//!
//! ```text
//! "rockface batch 1\n"
//! a frame of kind record for each record, as in a segment
//! a frame of kind note: the blobs, 80 bytes each
//!     32  digest of the blob
//!     32  digest of the pack that it is in; zeros for one with an object of its own
//!      8  where it starts in the pack, little-endian
//!      8  its size, bytes
//! ```
//!
//! A batch is named by the digest of its bytes, and so is a pack, which is blobs one after another.

use std::collections::{BTreeMap, HashMap};

use crate::frame::{HEADER_BYTES, Header, Kind};
use crate::{Digest, Record};

/// Starts every batch.
const MAGIC: &[u8] = b"rockface batch 1\n";
/// Bytes of the entry of a blob.
const ENTRY_BYTES: usize = 80;

/// Where a blob is in a remote place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// The pack it is in; `None` for an object of its own.
    pub pack: Option<Digest>,
    /// Where it starts in the pack.
    pub at: u64,
    /// Its size in bytes.
    pub bytes: u64,
}

/// The content of one batch, or of several put together.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(crate) struct Batch {
    /// The bytes of records by key.
    pub records: BTreeMap<Digest, Box<[u8]>>,
    /// The blobs they name.
    pub blobs: HashMap<Digest, Place>,
}

impl Batch {
    /// The bytes of the object, and its name.
    pub fn encode(&self) -> (Digest, Vec<u8>) {
        let mut out = MAGIC.to_vec();
        for (key, payload) in &self.records {
            out.extend(Header::of(Kind::Record, *key, 0, payload).encode(payload));
        }
        let mut blobs: Vec<_> = self.blobs.iter().collect();
        blobs.sort_unstable_by_key(|(digest, _)| **digest);
        let mut table = Vec::with_capacity(blobs.len() * ENTRY_BYTES);
        for (digest, place) in blobs {
            table.extend(digest.as_bytes());
            table.extend(place.pack.map_or([0; 32], |pack| *pack.as_bytes()));
            table.extend(place.at.to_le_bytes());
            table.extend(place.bytes.to_le_bytes());
        }
        out.extend(Header::of(Kind::Note, Digest::of(&table), 0, &table).encode(&table));
        (Digest::of(&out), out)
    }

    /// The content of the object of this name; `None` where the bytes are not those of a batch of this name.
    pub fn decode(name: &Digest, bytes: &[u8]) -> Option<Self> {
        if Digest::of(bytes) != *name {
            return None;
        }
        let mut rest = bytes.strip_prefix(MAGIC)?;
        let mut batch = Self::default();
        while !rest.is_empty() {
            let header = Header::decode(rest)?;
            let (payload, after) = rest[HEADER_BYTES..].split_at_checked(header.length as usize)?;
            if !header.fits(payload) {
                return None;
            }
            match header.kind {
                // One that belongs to another key, or is none, is left out: anybody may have written it.
                Kind::Record if is_record(&header.name, payload) => {
                    batch.records.insert(header.name, payload.into());
                }
                Kind::Note => batch.blobs.extend(payload.chunks_exact(ENTRY_BYTES).filter_map(entry)),
                _ => {}
            }
            rest = after;
        }
        Some(batch)
    }
}

/// Whether these bytes are a record of the recipe with this key.
fn is_record(key: &Digest, payload: &[u8]) -> bool {
    Record::recipe_text(payload).is_some_and(|text| Digest::of(text.as_bytes()) == *key)
        && Record::decode(payload).is_some()
}

fn entry(bytes: &[u8]) -> Option<(Digest, Place)> {
    let digest = |at: usize| Some(Digest::from_bytes(bytes.get(at..at + 32)?.try_into().ok()?));
    let number = |at: usize| Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?));
    let pack = digest(32)?;
    let pack = (pack != Digest::from_bytes([0; 32])).then_some(pack);
    Some((digest(0)?, Place { pack, at: number(64)?, bytes: number(72)? }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::tests::any_record;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        #[test]
        fn a_batch_comes_back_and_a_changed_byte_is_noticed(
            records in proptest::collection::vec(any_record(), 0..4), at in any::<prop::sample::Index>(), blob in any::<[u8; 32]>(),
        ) {
            let mut batch = Batch::default();
            for record in &records {
                let text = record.recipe.text();
                batch.records.insert(Digest::of(text.as_bytes()), record.encode(&text).unwrap().into());
            }
            batch.blobs.insert(Digest::from_bytes(blob), Place { pack: Some(Digest::of(b"pack")), at: 7, bytes: 9 });
            let (name, mut bytes) = batch.encode();
            prop_assert_eq!(Batch::decode(&name, &bytes), Some(batch));
            let at = at.index(bytes.len());
            bytes[at] ^= 1;
            prop_assert_eq!(Batch::decode(&name, &bytes), None);
            // Who writes the wrong bytes may write their digest too.
            let _ = Batch::decode(&Digest::of(&bytes), &bytes);
            let _ = Batch::decode(&Digest::of(&bytes[..at]), &bytes[..at]);
        }
    }

    #[test]
    fn a_record_under_the_key_of_another_is_left_out() {
        let mut batch = Batch::default();
        batch.records.insert(Digest::of(b"other"), b"\x02\0\0\0{}{}".as_slice().into());
        let (name, bytes) = batch.encode();
        assert_eq!(Batch::decode(&name, &bytes).unwrap(), Batch::default());
    }
}
