//! A picture for people, kept as PNG.

use super::{Artefact, CodecError, Kind, Noun};

/// A finished PNG file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    /// The content of the PNG file.
    pub png: Vec<u8>,
}

impl Noun for Picture {
    const KIND: Kind = Kind::Picture;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Picture(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        Ok(self.png.clone())
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        if !bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
            return Err(CodecError::new("not a PNG file"));
        }
        Ok(Self { png: bytes.to_vec() })
    }
    fn memory_bytes(&self) -> usize {
        self.png.len()
    }
}
