//! Run folders that are being written: marked until they are whole, and removed when their writer has died.

use std::fs::{self, File};
use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rockface_cache::SafeName;

use super::RunError;
use super::folder::failed;

/// The file that marks a folder being written. Its writer holds a lock on it, which ends with the process.
const MARK: &str = ".unfinished";
/// Starts the names of folders that have no mark or no name yet.
const BEGUN: &str = ".begun-";
/// Starts the names of links that are about to become `latest`.
pub(super) const NEXT_LATEST: &str = ".latest-";
/// Nobody takes longer from the making of such a thing to its name.
const LONGEST_BEGINNING: Duration = Duration::from_hours(1);

/// The right to write a run folder.
pub struct Unfinished {
    path: PathBuf,
    /// Holds the lock.
    _file: File,
}

impl Unfinished {
    /// Makes a folder under the first of these names that nothing has. It gets its name with its mark in it and locked, so
    /// that nobody ever finds it without.
    pub fn begin(runs: &Path, names: &[SafeName]) -> Result<(PathBuf, Self), RunError> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(BEGUN).permissions(fs::Permissions::from_mode(0o777));
        let begun = builder.tempdir_in(runs).map_err(failed(runs))?;
        let file = File::create_new(begun.path().join(MARK)).map_err(failed(begun.path()))?;
        file.lock().map_err(failed(begun.path()))?;
        for name in names {
            let folder = runs.join(name);
            match fs::rename(begun.path(), &folder) {
                Ok(()) => {
                    // Under its former name there is nothing to be removed any more.
                    let _ = begun.keep();
                    return Ok((folder.clone(), Self { path: folder.join(MARK), _file: file }));
                }
                Err(error) if is_taken(&error) => {}
                Err(error) => return Err(failed(&folder)(error)),
            }
        }
        Err(failed(runs)(ErrorKind::AlreadyExists.into()))
    }

    /// The folder is whole.
    pub fn finish(self) -> Result<(), RunError> {
        std::fs::remove_file(&self.path).map_err(failed(&self.path))
    }
}

/// Whether a folder cannot have a name because something else has it.
fn is_taken(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::AlreadyExists | ErrorKind::DirectoryNotEmpty | ErrorKind::NotADirectory)
}

/// Removes the folders whose writers died before they were whole. One whose manifest is there lacks nothing but the end of
/// its mark. What cannot be removed now is left for another time.
pub fn sweep(runs: &Path) {
    for entry in fs::read_dir(runs).into_iter().flatten().flatten() {
        let (name, Ok(kind)) = (entry.file_name(), entry.file_type()) else { continue };
        let name = name.to_string_lossy();
        if kind.is_dir() && name.starts_with(BEGUN) {
            // Its writer may be about to lock the mark.
            let _ = if is_old(&entry) { fs::remove_dir_all(entry.path()) } else { Ok(()) };
        } else if kind.is_symlink() && name.starts_with(NEXT_LATEST) {
            let _ = if is_old(&entry) { fs::remove_file(entry.path()) } else { Ok(()) };
        } else if kind.is_dir() {
            sweep_one(&entry.path());
        }
    }
}

fn is_old(entry: &fs::DirEntry) -> bool {
    let modified = entry.metadata().and_then(|meta| meta.modified()).ok();
    modified.and_then(|at| at.elapsed().ok()).is_some_and(|age| age > LONGEST_BEGINNING)
}

fn sweep_one(folder: &Path) {
    let mark = folder.join(MARK);
    if !fs::symlink_metadata(&mark).is_ok_and(|meta| meta.is_file()) {
        return;
    }
    // Opened for writing: network file systems lock no other files.
    let file = File::options().write(true).open(&mark).ok();
    if file.is_some_and(|file| file.try_lock().is_ok() && mark.exists()) {
        let whole = folder.join("run.json").is_file();
        let _ = if whole { fs::remove_file(&mark) } else { fs::remove_dir_all(folder) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_nobody_writes_any_more_is_removed() {
        let runs = tempfile::tempdir().unwrap();
        let begin = |name: &str| Unfinished::begin(runs.path(), &[SafeName::new(name).unwrap()]).unwrap();
        let ((held, writing), (left, _), (whole, _)) = (begin("held"), begin("left"), begin("whole"));
        let foreign = runs.path().join("foreign");
        fs::create_dir(&foreign).unwrap();
        fs::write(whole.join("run.json"), "{}").unwrap();
        sweep(runs.path());
        assert!(held.join(MARK).exists() && !left.exists() && foreign.exists());
        assert!(whole.join("run.json").exists() && !whole.join(MARK).exists());
        writing.finish().unwrap();
        sweep(runs.path());
        assert!(held.exists());
    }

    #[test]
    fn a_folder_has_its_mark_as_soon_as_its_name_and_takes_no_other_folders() {
        let runs = tempfile::tempdir().unwrap();
        let names = ["a", "b", "c"].map(|name| SafeName::new(name).unwrap());
        fs::create_dir_all(runs.path().join("a/full")).unwrap();
        fs::write(runs.path().join("b"), "a file").unwrap();
        let (folder, _held) = Unfinished::begin(runs.path(), &names).unwrap();
        assert_eq!(folder, runs.path().join("c"));
        assert!(folder.join(MARK).exists());
        assert!(Unfinished::begin(runs.path(), &names).is_err());
        assert_eq!(fs::read_dir(runs.path()).unwrap().count(), 3, "what had no name is gone");
    }

    #[test]
    fn what_was_left_before_it_had_a_name_goes_when_it_is_old() {
        let runs = tempfile::tempdir().unwrap();
        let [old, young, link] = [".begun-old", ".begun-young", ".latest-1"].map(|name| runs.path().join(name));
        fs::create_dir(&young).unwrap();
        fs::create_dir(&old).unwrap();
        std::os::unix::fs::symlink("gone", &link).unwrap();
        let then = std::time::SystemTime::now() - 2 * LONGEST_BEGINNING;
        File::open(&old).unwrap().set_modified(then).unwrap();
        sweep(runs.path());
        assert!(!old.exists() && young.exists() && fs::symlink_metadata(&link).is_ok());
    }
}
