//! Values on disk that the store does not keep: those spilled for want of memory, and those brought by another process. Each
//! file is removed with its last user.

use std::io::Write;
use std::path::{Path, PathBuf};

use rockface_cache::Digest;
use rockface_core::artefact::{Artefact, Kind};

/// A value in a file, which is removed when this is dropped.
#[derive(Debug)]
pub struct Spilled {
    path: tempfile::TempPath,
    kind: Kind,
    digest: Digest,
}

impl Spilled {
    /// Writes a value into a folder; `None` if it cannot be written.
    pub fn write(value: &Artefact, folder: &Path) -> Option<Self> {
        let bytes = value.encode().ok()?;
        let mut file = tempfile::NamedTempFile::new_in(folder).ok()?;
        file.write_all(&bytes).ok()?;
        Some(Self { path: file.into_temp_path(), kind: value.kind(), digest: Digest::of(&bytes) })
    }

    /// A file that another process has written; `None` if its path cannot be used.
    pub fn brought(path: PathBuf, kind: Kind, digest: Digest) -> Option<Self> {
        Some(Self { path: tempfile::TempPath::try_from_path(path).ok()?, kind, digest })
    }

    /// Where the file is; it is gone once this is dropped.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the value, or says why that is impossible.
    pub fn read(&self) -> Result<Artefact, String> {
        let bytes = std::fs::read(&self.path).map_err(|error| format!("{}: {error}", self.path.display()))?;
        if Digest::of(&bytes) != self.digest {
            return Err(format!("{} was damaged on disk", self.path.display()));
        }
        Artefact::decode(self.kind, &bytes).map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Table;

    #[test]
    fn a_value_comes_back_and_its_file_goes_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut table = Table::new(["x"]);
        table.push(vec![0.5.into()]);
        let spilled = Spilled::write(&Artefact::from(table), folder.path()).unwrap();
        let Artefact::Table(read) = spilled.read().unwrap() else { panic!("it was a table") };
        assert_eq!(read.rows[0][0].number(), Some(0.5));
        std::fs::write(&spilled.path, "other").unwrap();
        assert!(spilled.read().unwrap_err().contains("damaged"));
        drop(spilled);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
