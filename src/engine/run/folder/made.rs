//! The files a run leaves in its folder, each with the state it is left in, and whether they are what they were.

use std::path::{Path, PathBuf};

use rockface_cache::{Digest, SafePath, State};
use serde::{Deserialize, Serialize};

use super::files::failed;
use super::lay_out::Laid;
use crate::history::REPORT_FILE;
use crate::run::RunError;

/// A file of a run folder: its path in it, the state it was left in, and for another name of a large blob the digest of
/// that, since the state of such a file changes with every name its blob is given or loses.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Made(SafePath, State, #[serde(default)] Option<Digest>);

impl Made {
    /// Its path relative to the run folder, and its state.
    pub fn state(&self) -> (PathBuf, State) {
        (self.0.to_path_buf(), self.1)
    }

    /// Whether it is what it was. The state of another name of a blob is brought up to date if only that has changed.
    fn holds(&mut self, folder: &Path) -> bool {
        let path = folder.join(&self.0);
        let Some(now) = State::of(&path) else { return false };
        if now != self.1 {
            let found = || std::fs::File::open(&path).and_then(Digest::of_reader).ok();
            if self.2.is_none() || self.2 != found().map(|(digest, _)| digest) {
                return false;
            }
            self.1 = now;
        }
        true
    }
}

/// What a run has left in its folder: some files of its own, and what was laid out. The page is none of them; it may be
/// written again later.
pub fn left(folder: &Path, own: &[&str], laid: &Laid) -> Result<Vec<Made>, RunError> {
    let own = own.iter().map(|name| Ok((SafePath::new(name).map_err(|error| failed(folder)(error.into()))?, None)));
    let outputs = laid.files.iter().map(|(path, blob)| Ok((path.clone(), *blob)));
    let made = |file: Result<(SafePath, Option<Digest>), RunError>| {
        let (file, blob) = file?;
        let path = folder.join(&file);
        let state = State::of(&path).ok_or_else(|| failed(&path)(std::io::ErrorKind::NotFound.into()))?;
        Ok(Made(file, state, blob))
    };
    own.chain(outputs).map(made).collect()
}

/// Whether a run folder is one of those in `runs` and has its page.
pub fn is_in(folder: &Path, runs: &Path) -> bool {
    // `runs/..` has the parent `runs`, and no name.
    folder.parent() == Some(runs) && folder.file_name().is_some() && folder.join(REPORT_FILE).is_file()
}

/// Whether every file that was left in a folder and is known here is unchanged.
pub fn is_whole(folder: &Path, made: &mut [Made]) -> bool {
    !made.is_empty() && made.iter_mut().all(|file| file.holds(folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_name_of_a_blob_is_judged_by_its_content_and_any_other_file_by_its_state() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["linked", "own"] {
            std::fs::write(place(name), "bytes").unwrap();
        }
        let laid =
            Laid { files: vec![(SafePath::new("linked").unwrap(), Some(Digest::of(b"bytes")))], ..Laid::default() };
        let mut made = left(folder.path(), &["own"], &laid).unwrap();
        let before = made.clone();
        assert!(is_whole(folder.path(), &mut made) && made == before);
        let wait = || std::thread::sleep(std::time::Duration::from_millis(25));
        wait();
        std::fs::hard_link(place("linked"), place("another")).unwrap();
        assert!(is_whole(folder.path(), &mut made) && made != before, "another name changes the state alone");
        let mtime = std::fs::metadata(place("linked")).unwrap().modified().unwrap();
        for name in ["linked", "own"] {
            let mut made = made.clone();
            wait();
            std::fs::write(place(name), "other").unwrap();
            std::fs::File::options().write(true).open(place(name)).unwrap().set_modified(mtime).unwrap();
            assert!(!is_whole(folder.path(), &mut made), "{name}");
        }
        assert!(!is_whole(folder.path(), &mut []), "of what nothing is known nothing is believed");
        assert!(left(folder.path(), &["nowhere"], &laid).is_err());
    }
}
