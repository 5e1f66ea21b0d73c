//! Run folders that are being written: marked until they are whole, and removed when their writer has died.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::RunError;
use super::folder::failed;

/// The file that marks a folder being written. Its writer holds a lock on it, which ends with the process.
const MARK: &str = ".unfinished";

/// The right to write a run folder.
pub struct Unfinished {
    path: PathBuf,
    /// Holds the lock.
    file: File,
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // A program that is being started has a copy of the file, which would hold the lock on.
        let _ = self.file.unlock();
    }
}

impl Unfinished {
    /// Marks a new folder.
    pub fn mark(folder: &Path) -> Result<Self, RunError> {
        let (path, begun) = (folder.join(MARK), folder.join(format!("{MARK}-")));
        let file = File::create(&begun).map_err(failed(&begun))?;
        file.lock().map_err(failed(&begun))?;
        // It has its name only once it is locked, so that nobody finds it without.
        std::fs::rename(&begun, &path).map_err(failed(&path))?;
        Ok(Self { path, file })
    }

    /// The folder is whole.
    pub fn finish(self) -> Result<(), RunError> {
        std::fs::remove_file(&self.path).map_err(failed(&self.path))
    }
}

/// Removes the folders whose writers died before they were whole. One whose manifest is there lacks nothing but the end of
/// its mark. What cannot be removed now is left for another time.
pub fn sweep(runs: &Path) {
    for entry in std::fs::read_dir(runs).into_iter().flatten().flatten() {
        let (folder, mark) = (entry.path(), entry.path().join(MARK));
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        // Opened for writing: network file systems lock no other files.
        let abandoned = is_folder
            && File::options().write(true).open(&mark).is_ok_and(|file| file.try_lock().is_ok() && mark.exists());
        if abandoned {
            let whole = folder.join("run.json").is_file();
            let _ = if whole { std::fs::remove_file(&mark) } else { std::fs::remove_dir_all(&folder) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_nobody_writes_any_more_is_removed() {
        let runs = tempfile::tempdir().unwrap();
        let folder = |name: &str| {
            let folder = runs.path().join(name);
            std::fs::create_dir(&folder).unwrap();
            folder
        };
        let (held, left, whole, foreign) = (folder("held"), folder("left"), folder("whole"), folder("foreign"));
        let writing = Unfinished::mark(&held).unwrap();
        drop(Unfinished::mark(&left).unwrap());
        drop(Unfinished::mark(&whole).unwrap());
        std::fs::write(whole.join("run.json"), "{}").unwrap();
        sweep(runs.path());
        assert!(held.join(MARK).exists() && !left.exists() && foreign.exists());
        assert!(whole.join("run.json").exists() && !whole.join(MARK).exists());
        writing.finish().unwrap();
        sweep(runs.path());
        assert!(held.exists());
    }
}
