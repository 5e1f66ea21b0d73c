//! Run folders that are being written: hidden until they are marked, marked until they are whole, and removed when their
//! writer has died.

use std::fs::{File, Permissions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use super::files::failed;
use super::side_by_side::each;
use crate::run::RunError;

/// The file that marks a folder being written. Its writer holds a lock on it, which ends with the process.
const MARK: &str = ".unfinished";
/// What the mark says. A folder without it is none of a run, whatever else is in it: a file of that name may come with any archive.
const SAYS: &[u8] = b"rockface is writing this run folder\n";
/// Starts the names of folders that are not marked yet.
const BEGUN: &str = ".begun-";
/// Starts the names of links that are to become `latest`.
pub const STAGED: &str = ".latest-";

/// As many threads make a folder durable: file systems do together what several of them ask for.
const SYNCED_AT_ONCE: usize = 16;

/// The right to write a run folder.
pub struct Unfinished {
    folder: PathBuf,
    /// The mark, open: it holds the lock.
    file: File,
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        // A program that is being started has a copy of the file, which would hold the lock on.
        let _ = self.file.unlock();
    }
}

impl Unfinished {
    /// Begins a folder in `runs`, under a name that nobody takes for a run.
    pub fn begin(runs: &Path) -> Result<Self, RunError> {
        loop {
            let mut builder = tempfile::Builder::new();
            let folder = builder.prefix(BEGUN).permissions(Permissions::from_mode(0o777)).tempdir_in(runs);
            let folder = folder.map_err(failed(runs))?.keep();
            let path = folder.join(MARK);
            let marked = File::create(&path).and_then(|mut file| {
                file.lock()?;
                file.write_all(SAYS)?;
                file.sync_all().map(|()| file)
            });
            match marked {
                // Swept up before it was locked? Then begin another.
                Ok(file) if path.exists() => {
                    // No power cut leaves a folder of a run without it.
                    sync(&folder)?;
                    return Ok(Self { folder, file });
                }
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::NotFound => {}
                Err(error) => {
                    drop(std::fs::remove_dir_all(&folder));
                    return Err(failed(&path)(error));
                }
            }
        }
    }

    /// Gives the folder its name; false where there is something of that name.
    pub fn rename(&mut self, to: &Path) -> Result<bool, RunError> {
        match std::fs::rename(&self.folder, to) {
            Ok(()) => {
                to.clone_into(&mut self.folder);
                Ok(true)
            }
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::AlreadyExists | ErrorKind::DirectoryNotEmpty | ErrorKind::NotADirectory
                ) =>
            {
                Ok(false)
            }
            Err(error) => Err(failed(to)(error)),
        }
    }

    /// Where the folder is now: its hidden name at first, then the one it was given.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The folder is whole.
    pub fn finish(self) -> Result<(), RunError> {
        let path = self.folder.join(MARK);
        std::fs::remove_file(&path).map_err(failed(&path))
    }

    /// A folder that tells half of a run would only mislead.
    pub fn discard(self) {
        // What cannot be removed now is left for the next sweep, which finds its mark.
        let _ = remove_marked(&self.folder);
    }
}

/// Removes a folder, its mark last: one whose removal is interrupted keeps it, and is found again.
fn remove_marked(folder: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        match entry.file_type()? {
            _ if entry.file_name() == MARK => {}
            kind if kind.is_dir() => std::fs::remove_dir_all(entry.path())?,
            _ => std::fs::remove_file(entry.path())?,
        }
    }
    std::fs::remove_file(folder.join(MARK))?;
    std::fs::remove_dir(folder)
}

/// Removes the folders whose writers died before they were whole, and links that never became `latest`. A folder whose
/// manifest is there lacks nothing but the end of its mark. What cannot be removed now is left for another time. Only folders with
/// a name that runs have, or that begun ones have, are looked at, and of these only what the mark of a run is in.
pub fn sweep(runs: &Path) {
    for entry in std::fs::read_dir(runs).into_iter().flatten().flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        let starts_with = |prefix: &str| name.as_encoded_bytes().starts_with(prefix.as_bytes());
        let Ok(kind) = entry.file_type() else { continue };
        if kind.is_symlink() && starts_with(STAGED) {
            // A process that is about to rename it makes another.
            let _ = std::fs::remove_file(&path);
        } else if kind.is_dir() && (starts_with(BEGUN) || is_name_of_run(name.as_encoded_bytes())) {
            sweep_folder(&path, starts_with(BEGUN));
        }
    }
}

/// Whether a name begins as those of run folders do: `2026-01-31T235959Z-`.
fn is_name_of_run(name: &[u8]) -> bool {
    const FORM: &[u8] = b"0000-00-00T000000Z-";
    let fits = |(letter, form): (&u8, &u8)| if *form == b'0' { letter.is_ascii_digit() } else { letter == form };
    name.len() > FORM.len() && name.iter().zip(FORM).all(fits)
}

/// Whether a mark says what marks of run folders say; its process may have died before it said all of it, with nothing in the folder yet.
fn is_mark(file: &File, is_begun: bool) -> bool {
    let mut said = Vec::new();
    let read = file.take(SAYS.len() as u64 + 1).read_to_end(&mut said);
    read.is_ok() && (said == SAYS || is_begun && SAYS.starts_with(&said))
}

fn sweep_folder(folder: &Path, is_begun: bool) {
    let mark = folder.join(MARK);
    // Opened for writing: network file systems lock no other files. The lock is held until the folder is gone.
    let held = rockface_cache::open_plain(File::options().read(true).write(true), &mark);
    if held.as_ref().is_err_and(|error| is_begun && error.kind() == ErrorKind::NotFound) {
        // Only if it is still empty: its process may have marked it since. One that is about to mark it begins another.
        let _ = std::fs::remove_dir(folder);
    }
    if let Ok(file) = &held
        && file.try_lock().is_ok()
        && mark.exists()
        && is_mark(file, is_begun)
    {
        let _ = match std::fs::metadata(folder.join(crate::history::MANIFEST_FILE)) {
            Ok(_) => std::fs::remove_file(&mark),
            Err(error) if error.kind() == ErrorKind::NotFound => remove_marked(folder),
            Err(_) => Ok(()),
        };
    }
}

/// Makes a folder and all that is in it durable. Links are, with the folder they are in.
pub fn sync_all(folder: &Path) -> Result<(), RunError> {
    let mut paths = Vec::new();
    gather(folder, &mut paths)?;
    let threads = if paths.len() > SYNCED_AT_ONCE { SYNCED_AT_ONCE } else { 1 };
    each(threads, paths.len(), |path| sync(&paths[path])).map(drop)
}

/// All files and folders in a folder, itself last.
fn gather(folder: &Path, paths: &mut Vec<PathBuf>) -> Result<(), RunError> {
    for entry in std::fs::read_dir(folder).map_err(failed(folder))? {
        let entry = entry.map_err(failed(folder))?;
        let (path, kind) = (entry.path(), entry.file_type().map_err(failed(folder))?);
        if kind.is_dir() {
            gather(&path, paths)?;
        } else if kind.is_file() {
            paths.push(path);
        }
    }
    paths.push(folder.to_owned());
    Ok(())
}

/// Makes a file, or the names in a folder, durable.
pub fn sync(path: &Path) -> Result<(), RunError> {
    File::open(path).and_then(|file| file.sync_all()).map_err(failed(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_nobody_writes_any_more_is_removed() {
        let runs = tempfile::tempdir().unwrap();
        let path = |name: &str| runs.path().join(name);
        let begin = |name: &str| {
            let mut begun = Unfinished::begin(runs.path()).unwrap();
            assert!(begun.rename(&path(name)).unwrap());
            begun
        };
        let [held, left, whole, other] =
            ["held", "left", "whole", "other"].map(|name| format!("2026-01-31T235959Z-{name}"));
        let writing = begin(&held);
        drop((begin(&left), begin(&whole), Unfinished::begin(runs.path()).unwrap()));
        std::fs::write(path(&whole).join("run.json"), "{}").unwrap();
        for name in ["foreign", ".begun-and-died"] {
            std::fs::create_dir(path(name)).unwrap();
        }
        // Folders of other things, with a file that is called as marks are, or with a mark under a name that no run has.
        let others =
            [(other.as_str(), ""), (".begun-scans", "my list"), ("scans", "rockface is writing this run folder\n")];
        for (name, mark) in others {
            std::fs::create_dir(path(name)).unwrap();
            std::fs::write(path(name).join(MARK), mark).unwrap();
            std::fs::write(path(name).join("cliff.laz"), "the only one").unwrap();
        }
        std::os::unix::fs::symlink(&whole, path(".latest-1")).unwrap();
        sweep(runs.path());
        let mut left: Vec<_> =
            std::fs::read_dir(runs.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, [".begun-scans", &held, &other, &whole, "foreign", "scans"].map(std::ffi::OsString::from));
        assert!(others.iter().all(|(name, _)| path(name).join("cliff.laz").exists()));
        assert!(path(&held).join(MARK).exists() && !path(&whole).join(MARK).exists());
        writing.finish().unwrap();
        sweep(runs.path());
        assert!(path(&held).exists());
    }

    #[test]
    fn no_folder_of_a_run_takes_the_place_of_another() {
        let runs = tempfile::tempdir().unwrap();
        let (mut one, mut other) = (Unfinished::begin(runs.path()).unwrap(), Unfinished::begin(runs.path()).unwrap());
        assert!(one.rename(&runs.path().join("run")).unwrap());
        assert!(!other.rename(&runs.path().join("run")).unwrap());
        assert!(other.rename(&runs.path().join("run-1")).unwrap());
        other.discard();
        assert!(one.folder().join(MARK).exists() && !runs.path().join("run-1").exists());
    }

    #[test]
    fn folders_begun_while_others_sweep_are_there() {
        let runs = tempfile::tempdir().unwrap();
        std::thread::scope(|scope| {
            let sweeping = scope.spawn(|| (0..2000).for_each(|_| sweep(runs.path())));
            while !sweeping.is_finished() {
                let begun = Unfinished::begin(runs.path()).unwrap();
                assert!(begun.folder().join(MARK).exists());
                begun.discard();
            }
        });
    }
}
