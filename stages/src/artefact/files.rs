//! Named files in another program's own format, made to be handed to that program.

use super::{Artefact, CodecError, Export, Kind, Noun};
use crate::kernel::tar_file;

/// Files by name, in the order they were made; kept as one archive, laid out beside it in a run's folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Files {
    /// Names, with `/` between folders, and contents.
    pub files: Vec<(String, Vec<u8>)>,
}

impl Noun for Files {
    const KIND: Kind = Kind::Files;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Files(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        tar_file::write(&self.files)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        tar_file::read(bytes).map(|files| Self { files })
    }
    fn memory_bytes(&self) -> usize {
        self.files.iter().map(|(name, bytes)| name.len() + bytes.len()).sum()
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let export =
            |(name, bytes): &(String, Vec<u8>)| Export { path: format!("{stem}/{name}"), bytes: bytes.clone() };
        Ok(self.files.iter().map(export).collect())
    }
}
