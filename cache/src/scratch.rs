//! Folders for programs to work in: gone when they are done, or when the store is next opened after the process died.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use crate::Store;
use crate::error::{At, StoreError};
use crate::locks::is_abandoned;
use crate::open::SCRATCH;

/// Ends the name of the file that is locked as long as the folder beside it is used.
const LOCK: &str = ".lock";

/// A folder of its own for one program, removed with all that is in it when this is dropped.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
    /// Removed after the folder.
    lock: Option<tempfile::NamedTempFile>,
}

impl Scratch {
    /// The folder, absolute.
    pub fn path(&self) -> &Path {
        &self.folder
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What cannot be removed now is swept up when the store is next opened.
        let _ = fs::remove_dir_all(&self.folder);
        drop(self.lock.take());
    }
}

impl Store {
    /// An empty folder in the store that nobody else uses.
    pub fn scratch(&self) -> Result<Scratch, StoreError> {
        let root = self.dir().join(SCRATCH);
        loop {
            let mut builder = tempfile::Builder::new();
            let lock = builder.prefix("run-").suffix(LOCK).tempfile_in(&root).at("write into", &root)?;
            lock.as_file().lock().at("lock a file in", &root)?;
            // Swept up between its making and its locking? Then make another.
            if crate::segment::is_at(lock.as_file(), lock.path()) {
                let folder = lock.path().with_extension("");
                fs::create_dir(&folder).at("make the folder", &folder)?;
                return Ok(Scratch { folder, lock: Some(lock) });
            }
        }
    }
}

/// Removes the folders in `root` whose process is gone.
pub(crate) fn sweep(root: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(root).at("list", root)? {
        let path = entry.at("list", root)?.path();
        let is_lock = path.to_str().is_some_and(|path| path.ends_with(LOCK));
        let Some(held) = File::open(&path).ok().filter(|_| is_lock) else { continue };
        if is_abandoned(&held, &path) {
            let _ = fs::remove_dir_all(path.with_extension(""));
            let _ = fs::remove_file(&path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_lives_as_long_as_its_owner_and_no_longer_than_the_next_opening() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let store = Store::open(&dir).unwrap();
        let scratch = store.scratch().unwrap();
        fs::write(scratch.path().join("half"), "half").unwrap();
        let dead = store.scratch().unwrap();
        let left = dead.path().to_owned();
        // As after a kill: nothing is removed, the lock ends.
        dead.lock.as_ref().unwrap().as_file().unlock().unwrap();
        let (folder, lock) = (left.clone(), left.with_extension(&LOCK[1..]));
        std::mem::forget(dead);
        drop(Store::open(&dir).unwrap());
        assert!(!folder.exists() && !lock.exists(), "what the dead left is swept up");
        assert!(scratch.path().join("half").exists(), "what is in use stays");
        let used = scratch.path().to_owned();
        drop(scratch);
        assert!(!used.exists());
        assert_eq!(fs::read_dir(dir.join(SCRATCH)).unwrap().count(), 0);
    }
}
