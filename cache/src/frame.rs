//! The frame: one checksummed entry of a segment.
//!
//! ```text
//! offset  bytes  content (integers little-endian)
//!  0       4     "RFS1"
//!  4       1     kind
//!  5       3     zero
//!  8       4     length of the payload
//! 12       4     zero
//! 16       8     stamp: nanoseconds since 1970, strictly growing; of two frames with one name the later counts
//! 24      32     name: digest of a blob, key of anything else
//! 56      16     start of the payload's BLAKE3
//! 72       8     start of the BLAKE3 of the 72 bytes before
//! 80             payload
//! ```

use crate::Digest;

/// Bytes before the payload.
pub(crate) const HEADER_BYTES: usize = 80;
/// Every frame starts with these.
pub(crate) const MAGIC: [u8; 4] = *b"RFS1";
/// The largest payload; a length beyond it is damage.
pub(crate) const PAYLOAD_LIMIT: u64 = 1 << 29;

/// Later stamps are damage (this is the year 2116): every stamp is later than those before it, so that behind one at the
/// end of all numbers nothing could be written any more.
pub(crate) const STAMP_LIMIT: u64 = 1 << 62;

/// What a frame holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A small blob, named by its digest.
    Blob,
    /// A record, named by the key of its recipe.
    Record,
    /// A note on a former run, named by the key of its plan.
    Note,
    /// What a file outside the store contained, named by the digest of its path.
    File,
    /// Everything before the offset in `stamp` is known to be on disk.
    Mark,
    /// The blob of this name was found damaged: frames that hold it and were written before do not count.
    Gone,
    /// Something a later version of this format knows.
    Unknown,
}

/// The header of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Header {
    /// What the payload is.
    pub kind: Kind,
    /// Bytes of the payload.
    pub length: u32,
    /// When it was written, or the offset of a mark.
    pub stamp: u64,
    /// What it is filed under.
    pub name: Digest,
    /// The first 16 bytes of the payload's BLAKE3.
    pub check: [u8; 16],
}

impl Kind {
    const NUMBERED: [Kind; 6] = [Kind::Blob, Kind::Record, Kind::Note, Kind::File, Kind::Mark, Kind::Gone];

    fn number(self) -> u8 {
        Self::NUMBERED.iter().position(|kind| *kind == self).map_or(0, |place| place as u8 + 1)
    }

    fn from_number(number: u8) -> Kind {
        let place = usize::from(number).checked_sub(1);
        place.and_then(|place| Self::NUMBERED.get(place).copied()).unwrap_or(Kind::Unknown)
    }
}

impl Header {
    /// The header of this payload, which must be no longer than [`PAYLOAD_LIMIT`].
    pub(crate) fn of(kind: Kind, name: Digest, stamp: u64, payload: &[u8]) -> Self {
        Self { kind, length: payload.len() as u32, stamp, name, check: payload_check(payload) }
    }

    /// Whether these are the bytes the header was made for.
    pub(crate) fn fits(&self, payload: &[u8]) -> bool {
        payload.len() == self.length as usize && payload_check(payload) == self.check
    }

    /// Bytes of the whole frame.
    pub(crate) fn frame_bytes(&self) -> u64 {
        HEADER_BYTES as u64 + u64::from(self.length)
    }

    /// Appends the header followed by its payload.
    pub(crate) fn encode_to(&self, payload: &[u8], out: &mut Vec<u8>) {
        let start = out.len();
        out.extend(MAGIC);
        out.extend([self.kind.number(), 0, 0, 0]);
        out.extend(self.length.to_le_bytes());
        out.extend([0; 4]);
        out.extend(self.stamp.to_le_bytes());
        out.extend(self.name.as_bytes());
        out.extend(self.check);
        let check = blake3::hash(&out[start..]);
        out.extend(&check.as_bytes()[..8]);
        out.extend(payload);
    }

    /// The header followed by its payload.
    pub(crate) fn encode(&self, payload: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER_BYTES + payload.len());
        self.encode_to(payload, &mut out);
        out
    }

    /// The header these bytes start with, if they do and it is whole.
    pub(crate) fn decode(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; HEADER_BYTES] = bytes.first_chunk()?;
        let (body, check) = bytes.split_at(72);
        if !body.starts_with(&MAGIC) || blake3::hash(body).as_bytes()[..8] != *check {
            return None;
        }
        let (length, stamp) = (u32::from_le_bytes(array(body, 8)), u64::from_le_bytes(array(body, 16)));
        (u64::from(length) <= PAYLOAD_LIMIT && stamp < STAMP_LIMIT).then(|| Self {
            kind: Kind::from_number(body[4]),
            length,
            stamp,
            name: Digest::from_bytes(array(body, 24)),
            check: array(body, 56),
        })
    }
}

/// The first 16 bytes of the BLAKE3 of a payload.
pub(crate) fn payload_check(payload: &[u8]) -> [u8; 16] {
    array(blake3::hash(payload).as_bytes(), 0)
}

/// `N` bytes of `bytes` from `start`; the caller knows they are there.
fn array<const N: usize>(bytes: &[u8], start: usize) -> [u8; N] {
    std::array::from_fn(|offset| bytes[start + offset])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_stamp_after_which_none_can_follow_is_damage() {
        let frame = |stamp| Header::of(Kind::Gone, Digest::of(b"key"), stamp, b"").encode(b"");
        assert!(Header::decode(&frame(STAMP_LIMIT - 1)).is_some());
        assert!(Header::decode(&frame(STAMP_LIMIT)).is_none() && Header::decode(&frame(u64::MAX)).is_none());
    }

    proptest! {
        #[test]
        fn decoding_gives_the_header_back(number in 1u8..=6, name: [u8; 32], stamp in 0..STAMP_LIMIT, payload: Vec<u8>) {
            let header = Header::of(Kind::from_number(number), Digest::from_bytes(name), stamp, &payload);
            let frame = header.encode(&payload);
            prop_assert_eq!(Header::decode(&frame), Some(header));
            prop_assert_eq!(frame.len() as u64, header.frame_bytes());
            prop_assert!(header.fits(&frame[HEADER_BYTES..]));
        }

        #[test]
        fn one_flipped_bit_is_noticed(bit in 0usize..(HEADER_BYTES + 9) * 8) {
            let mut frame = Header::of(Kind::Record, Digest::of(b"key"), 7, b"a payload").encode(b"a payload");
            frame[bit / 8] ^= 1 << (bit % 8);
            let accepted = Header::decode(&frame).is_some_and(|header| header.fits(&frame[HEADER_BYTES..]));
            prop_assert!(!accepted);
        }
    }
}
