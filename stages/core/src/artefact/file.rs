//! A file that nobody here looks into, handed from one program to another.

use super::{Artefact, CodecError, Kind, Noun};

/// The bytes of a file; what they mean is between those who write and read it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct File {
    /// The content of the file, as it was read or as a program wrote it.
    pub bytes: Vec<u8>,
}

impl Noun for File {
    const KIND: Kind = Kind::File;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::File(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        Ok(self.bytes.clone())
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        Ok(Self { bytes: bytes.to_vec() })
    }
    fn memory_bytes(&self) -> usize {
        self.bytes.len()
    }
}
