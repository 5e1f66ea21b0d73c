//! The BLAKE3 digest that names every blob and every recipe.

use std::fmt;
use std::io::{self, Read};
use std::str::FromStr;

use serde::de::{self, Deserialize, Deserializer, Visitor};
use serde::{Serialize, Serializer};

/// Bytes read at a time when a stream is hashed.
const CHUNK_BYTES: usize = 256 * 1024;
/// Pieces of fewer bytes are hashed by one thread.
const PARALLEL_BYTES: usize = 1 << 20;

/// A 256-bit BLAKE3 digest, written as 64 lower-case hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

/// Why a text is not a digest.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not a digest: expected 64 hexadecimal digits")]
pub struct DigestError {
    /// The text as given.
    pub text: String,
}

impl Digest {
    /// The digest of these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// The digest of the pieces that `give` hands over, and how many bytes they were; what `give` returns comes back. Large pieces are hashed by
    /// all threads of the pool it is called in.
    pub fn of_pieces<T>(give: impl FnOnce(&mut dyn FnMut(&[u8])) -> T) -> (Self, u64, T) {
        let mut hasher = blake3::Hasher::new();
        let given = give(&mut |piece| {
            if piece.len() < PARALLEL_BYTES {
                hasher.update(piece)
            } else {
                hasher.update_rayon(piece)
            };
        });
        (Self(*hasher.finalize().as_bytes()), hasher.count(), given)
    }

    /// The digest of everything `reader` yields, and how many bytes that was; memory stays bounded.
    pub fn of_reader(mut reader: impl Read) -> io::Result<(Self, u64)> {
        let mut hasher = blake3::Hasher::new();
        let mut chunk = vec![0; CHUNK_BYTES];
        loop {
            match reader.read(&mut chunk) {
                Ok(0) => return Ok((Self(*hasher.finalize().as_bytes()), hasher.count())),
                Ok(count) => hasher.update(&chunk[..count]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            };
        }
    }

    /// The digest of some pieces under a key, without which nobody can make it; the length of each is part of it.
    pub(crate) fn keyed(key: &[u8; 32], pieces: &[&[u8]]) -> Self {
        let mut hasher = blake3::Hasher::new_keyed(key);
        for piece in pieces {
            hasher.update(&(piece.len() as u64).to_le_bytes()).update(piece);
        }
        Self(*hasher.finalize().as_bytes())
    }

    /// A digest computed elsewhere.
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The 32 bytes of the hash, as BLAKE3 gives them.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// The first 12 hexadecimal digits, enough for people to tell digests apart.
    pub fn short(&self) -> String {
        self.hex(|text| text[..12].to_owned())
    }

    /// Hands the 64 hexadecimal digits to `use_text` without allocating.
    pub(crate) fn hex<T>(&self, use_text: impl FnOnce(&str) -> T) -> T {
        use_text(blake3::Hash::from_bytes(self.0).to_hex().as_str())
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.hex(|text| f.pad(text))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.hex(|text| write!(f, "Digest({text})"))
    }
}

impl FromStr for Digest {
    type Err = DigestError;

    fn from_str(text: &str) -> Result<Self, DigestError> {
        let wrong = || DigestError { text: text.to_owned() };
        let digits: &[u8; 64] = text.as_bytes().try_into().map_err(|_| wrong())?;
        let mut bytes = [0; 32];
        // Wrong digits have a bit that no digit has; it is looked for once, at the end.
        let mut seen = 0;
        for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
            let [high, low] = [VALUES[usize::from(pair[0])], VALUES[usize::from(pair[1])]];
            seen |= high | low;
            *byte = high << 4 | low;
        }
        if seen & NO_DIGIT == 0 { Ok(Self(bytes)) } else { Err(wrong()) }
    }
}

/// In place of the value of what is no hexadecimal digit.
const NO_DIGIT: u8 = 0x80;

/// The values of the hexadecimal digits.
const VALUES: [u8; 256] = {
    let mut values = [NO_DIGIT; 256];
    let mut value = 0;
    while value < 16 {
        values[b"0123456789abcdef"[value] as usize] = value as u8;
        values[b"0123456789ABCDEF"[value] as usize] = value as u8;
        value += 1;
    }
    values
};

impl Serialize for Digest {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.hex(|text| serializer.serialize_str(text))
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_str(HexVisitor)
    }
}

/// Reads a digest from a string of any lifetime without copying it.
struct HexVisitor;

impl Visitor<'_> for HexVisitor {
    type Value = Digest;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("64 hexadecimal digits")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Digest, E> {
        text.parse().map_err(E::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_empty_digest_is_the_published_one() {
        // First test vector of the BLAKE3 reference implementation.
        let expected = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
        assert_eq!(Digest::of(b"").to_string(), expected);
        assert_eq!(Digest::of(b"").short(), "af1349b9f5f9");
    }

    #[test]
    fn pieces_of_any_size_give_the_digest_of_the_whole() {
        let bytes: Vec<u8> = (0..3 * PARALLEL_BYTES + 7).map(|i| ((i * i) >> 8) as u8).collect();
        for at in [0, 1, PARALLEL_BYTES - 1, PARALLEL_BYTES, 2 * PARALLEL_BYTES + 3] {
            let (one, other) = bytes.split_at(at);
            let (digest, count, ()) = Digest::of_pieces(|take| [one, other].into_iter().for_each(take));
            assert_eq!((digest, count), (Digest::of(&bytes), bytes.len() as u64));
        }
    }

    #[test]
    fn what_is_not_a_digest_is_refused_with_its_text() {
        for text in ["", "af13", &"g".repeat(64), &"a".repeat(65)] {
            let error = text.parse::<Digest>().unwrap_err();
            assert!(error.to_string().contains(text), "{error}");
        }
        assert!(serde_json::from_str::<Digest>("12").is_err());
    }

    proptest! {
        #[test]
        fn text_and_json_give_the_digest_back(bytes: [u8; 32]) {
            let digest = Digest::from_bytes(bytes);
            prop_assert_eq!(digest.to_string().parse::<Digest>().unwrap(), digest);
            let json = serde_json::to_string(&digest).unwrap();
            prop_assert_eq!(serde_json::from_str::<Digest>(&json).unwrap(), digest);
        }

        #[test]
        fn a_stream_hashes_as_its_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..5000)) {
            let (digest, count) = Digest::of_reader(bytes.as_slice()).unwrap();
            prop_assert_eq!(digest, Digest::of(&bytes));
            prop_assert_eq!(count, bytes.len() as u64);
        }
    }
}
