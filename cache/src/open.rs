//! Opening: the folders of a store, its format version, and the litter of processes that died.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::blobs::Blobs;
use crate::error::{At, StoreError};
use crate::locks::sweep;
use crate::machine::Machine;
use crate::memory::{ANSWERS, TREES};
use crate::plain;
use crate::sharing::{NEW, Sharing};

/// What the format file says.
pub(crate) const FORMAT: &str = "rockface store 1";
/// So much of the format file is read: a message shows the first 80 characters.
const FORMAT_BYTES: u64 = 320;
/// See <https://bford.info/cachedir/>; the first line is prescribed.
const CACHE_TAG: &str = "Signature: 8a477f597d28d172789f06886806bc55\n\
    # Everything in this folder can be computed again; backup programs may pass it by.\n";
/// Starts the names of half-written files in the root of a store.
const HALF_WRITTEN: &str = ".new-";
/// Starts the names of half-written trees.
const HALF_WRITTEN_TREE: &str = ".tmp";
/// Nobody takes longer to write a file of the store that is not locked meanwhile.
const LONGEST_WRITING: Duration = Duration::from_hours(1);
/// Starts the names of half-written blobs.
pub(crate) const TEMPORARY_BLOB: &str = "blob-";

/// The folder of large blobs.
pub(crate) const BLOBS: &str = "blobs";
/// The folder of segments.
pub(crate) const SEGMENTS: &str = "segments";
/// The file whose bytes are locked for the keys being computed.
pub(crate) const LOCKS: &str = "keys.lock";
/// The folder of damaged blobs.
pub(crate) const QUARANTINE: &str = "quarantine";
/// The folder of half-written blobs.
pub(crate) const TMP: &str = "tmp";

/// The folder of folders in which programs work.
pub(crate) const SCRATCH: &str = "scratch";

/// The folder of what live processes reference.
pub(crate) const LIVE: &str = "live";

/// The folder of the processes that run something.
pub(crate) const WORKERS: &str = "workers";

/// The folder of the leases between machines.
pub(crate) const LEASES: &str = "leases";

/// The folders that every store has.
const FOLDERS: [&str; 8] = [BLOBS, SEGMENTS, QUARANTINE, TMP, SCRATCH, LIVE, TREES, ANSWERS];
/// The file that backup programs ask for.
const TAG: &str = "CACHEDIR.TAG";

/// Whether the root of a store has something of this name.
pub(crate) fn is_own(name: &OsStr) -> bool {
    let others = [WORKERS, LEASES, LOCKS, TAG, "format"];
    FOLDERS.iter().chain(&others).any(|own| name == *own)
}

/// Whether `dir` is a store of this format.
pub(crate) fn is_current(dir: &Path) -> bool {
    format_of(&dir.join("format")).is_ok_and(|found| found.trim_end() == FORMAT)
}

/// Whether `dir` is a store of this format to which opening adds nothing.
pub(crate) fn is_whole(dir: &Path) -> bool {
    is_current(dir) && FOLDERS.iter().all(|folder| plain::is_folder(&dir.join(folder))) && dir.join(TAG).exists()
}

/// The beginning of what the file of the format says.
fn format_of(path: &Path) -> io::Result<String> {
    Ok(String::from_utf8_lossy(&plain::read_start(path, FORMAT_BYTES)?).into_owned())
}

/// Makes `dir` a store, or makes sure that it is one of this format.
pub(crate) fn prepare(dir: &Path, machine: &Machine) -> Result<(), StoreError> {
    let outside = nearest_that_is_there(dir)?;
    fs::create_dir_all(dir).at("make the folder", dir)?;
    let sharing = Sharing::of(dir);
    // Listed before the format is read: another process may be making the store now, and writes its format first.
    let foreign = foreign_entry(dir)?;
    let format = dir.join("format");
    let read = format_of(&format);
    let is_new = read.is_err();
    match read {
        Ok(found) if found.trim_end() == FORMAT => {}
        Ok(found) => return Err(wrong_format(dir, &found)),
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => match foreign {
            Some(entry) => {
                let was_store = FOLDERS.iter().all(|folder| dir.join(folder).is_dir());
                return Err(StoreError::NotAStore { dir: dir.to_owned(), entry, was_store });
            }
            None => write_whole(dir, "format", &format!("{FORMAT}\n"))?,
        },
        Err(fault) if plain::is_foreign(&fault) => return Err(StoreError::Foreign { path: format }),
        Err(fault) => return Err(StoreError::io("read", &format, fault)),
    }
    for folder in FOLDERS {
        // Files there may be removed or overwritten, so it must not be another folder.
        plain::folder(&dir.join(folder), sharing)?;
    }
    if machine.is_shared {
        plain::folder(&dir.join(LEASES), sharing)?;
        [TMP, SCRATCH, LIVE].iter().try_for_each(|folder| plain::folder(&machine.folder(folder), sharing))?;
    }
    if !dir.join(TAG).exists() {
        write_whole(dir, TAG, CACHE_TAG)?;
    }
    if is_new {
        sync_names(dir, &outside)?;
    }
    // Before the sweep, which would remove them.
    Blobs::new(dir, &machine.folder(TMP)).take_back()?;
    sweep(&machine.folder(TMP), TEMPORARY_BLOB)?;
    crate::scratch::sweep(&machine.folder(SCRATCH))?;
    sweep_aged(dir, HALF_WRITTEN)?;
    sweep_aged(&dir.join(BLOBS), NEW)?;
    sweep_aged(&dir.join(TREES), HALF_WRITTEN_TREE)?;
    crate::workers::sweep(dir, machine.name(), machine.is_shared);
    if machine.is_shared {
        crate::leases::sweep(dir, machine.name());
    }
    sweep(&machine.folder(LIVE), "")
}

/// Removes the files in `dir` that start with `prefix` and are so old that whoever was writing them has died.
fn sweep_aged(dir: &Path, prefix: &str) -> Result<(), StoreError> {
    for entry in fs::read_dir(dir).at("list", dir)? {
        let entry = entry.at("list", dir)?;
        let ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(prefix));
        let age = || entry.metadata().ok()?.modified().ok()?.elapsed().ok();
        if ours && age().is_some_and(|age| age > LONGEST_WRITING) {
            // What cannot be removed now is left for another time.
            let _ = fs::remove_file(entry.path()).or_else(|_| fs::remove_dir(entry.path()));
        }
    }
    Ok(())
}

/// The nearest folder around `dir`, or `dir` itself, that is there.
fn nearest_that_is_there(dir: &Path) -> Result<PathBuf, StoreError> {
    let dir = std::path::absolute(dir).at("find", dir)?;
    Ok(dir.ancestors().find(|folder| folder.exists()).unwrap_or(&dir).to_owned())
}

/// Makes the names in a new store durable, and its own in the folders around it up to `outside`: what is synced inside
/// is lost with any of them.
fn sync_names(dir: &Path, outside: &Path) -> Result<(), StoreError> {
    let dir = std::path::absolute(dir).at("find", dir)?;
    for folder in dir.ancestors().take_while(|folder| folder.starts_with(outside)) {
        match fs::File::open(folder).and_then(|folder| folder.sync_all()) {
            // A folder that may be entered and not listed cannot be synced by this user.
            Err(fault) if fault.kind() == io::ErrorKind::PermissionDenied && folder != dir => {}
            synced => synced.at("sync", folder)?,
        }
    }
    Ok(())
}

fn wrong_format(dir: &Path, found: &str) -> StoreError {
    let found = found.trim_end().chars().take(80).collect();
    StoreError::Format { dir: dir.to_owned(), found, expected: FORMAT.to_owned() }
}

/// Something in `dir` that no opening of a store would have put there.
fn foreign_entry(dir: &Path) -> Result<Option<String>, StoreError> {
    for entry in fs::read_dir(dir).at("list", dir)? {
        let name = entry.at("list", dir)?.file_name().to_string_lossy().into_owned();
        if name != "format" && !name.starts_with(HALF_WRITTEN) {
            return Ok(Some(name));
        }
    }
    Ok(None)
}

/// Writes a file that is there in full or not at all.
fn write_whole(dir: &Path, name: &str, text: &str) -> Result<(), StoreError> {
    let path = dir.join(name);
    let mut file = tempfile::Builder::new().prefix(HALF_WRITTEN).tempfile_in(dir).at("write into", dir)?;
    file.write_all(text.as_bytes()).at("write", &path)?;
    Sharing::of(dir).give(file.as_file(), 0o644).at("set the mode of", &path)?;
    file.as_file().sync_all().at("sync", &path)?;
    file.persist(&path).map_err(|fault| fault.error).at("write", &path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prepare(dir: &Path) -> Result<(), StoreError> {
        super::prepare(dir, &Machine::on(dir))
    }

    #[test]
    fn a_store_is_made_once_and_found_again() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("a/new/store");
        prepare(&dir).unwrap();
        prepare(&dir).unwrap();
        assert_eq!(fs::read_to_string(dir.join("format")).unwrap(), "rockface store 1\n");
        assert!(fs::read_to_string(dir.join("CACHEDIR.TAG")).unwrap().starts_with("Signature: 8a477f597d28d172789f0"));
    }

    #[test]
    fn another_format_is_refused_with_both_versions() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("format"), "rockface store 99\n").unwrap();
        let message = prepare(folder.path()).unwrap_err().to_string();
        assert!(message.contains("`rockface store 99`") && message.contains("`rockface store 1`"), "{message}");
        assert!(!folder.path().join(SEGMENTS).exists(), "a refused folder is left alone");
    }

    #[test]
    fn a_folder_of_other_things_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("tmp")).unwrap();
        fs::write(folder.path().join("tmp/blob-mine"), "mine").unwrap();
        let message = prepare(folder.path()).unwrap_err().to_string();
        assert!(message.contains("`tmp`") && !message.contains(FORMAT), "{message}");
        assert!(folder.path().join("tmp/blob-mine").exists());
    }

    #[test]
    fn a_store_without_its_format_file_says_how_it_is_one_again() {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path()).unwrap();
        fs::remove_file(folder.path().join("format")).unwrap();
        assert!(prepare(folder.path()).unwrap_err().to_string().contains(FORMAT));
        fs::write(folder.path().join("format"), FORMAT).unwrap();
        prepare(folder.path()).unwrap();
    }

    #[test]
    fn half_written_blobs_of_the_dead_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path()).unwrap();
        let left = folder.path().join("tmp/blob-left");
        let held = fs::File::create(folder.path().join("tmp/blob-held")).unwrap();
        held.lock().unwrap();
        fs::write(&left, "half").unwrap();
        prepare(folder.path()).unwrap();
        assert!(!left.exists());
        assert!(folder.path().join("tmp/blob-held").exists());
    }

    #[test]
    fn half_written_files_that_nobody_locks_go_when_they_are_old() {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path()).unwrap();
        for (name, age_s, stays) in
            [(".new-a", 7200, false), (".new-b", 60, true), ("trees/.tmpa", 7200, false), ("trees/.tmpb", 60, true)]
        {
            let path = folder.path().join(name);
            let file = fs::File::create(&path).unwrap();
            file.set_modified(std::time::SystemTime::now() - Duration::from_secs(age_s)).unwrap();
            prepare(folder.path()).unwrap();
            assert_eq!(path.exists(), stays, "{name}");
        }
    }

    #[test]
    fn half_made_folders_go_when_they_are_old() {
        let folder = tempfile::tempdir().unwrap();
        prepare(folder.path()).unwrap();
        for (name, age_s, stays) in [(".new-a", 7200, false), ("blobs/.new-a", 7200, false), ("blobs/.new-b", 60, true)]
        {
            let path = folder.path().join(name);
            fs::create_dir(&path).unwrap();
            let then = std::time::SystemTime::now() - Duration::from_secs(age_s);
            fs::File::open(&path).unwrap().set_modified(then).unwrap();
            prepare(folder.path()).unwrap();
            assert_eq!(path.exists(), stays, "{name}");
        }
    }

    #[test]
    fn a_link_in_the_place_of_a_folder_is_refused_and_nothing_behind_it_is_touched() {
        for name in [BLOBS, SEGMENTS, QUARANTINE, TMP, SCRATCH, LIVE, TREES, ANSWERS] {
            let place = tempfile::tempdir().unwrap();
            let (dir, home) = (place.path().join("store"), place.path().join("home"));
            prepare(&dir).unwrap();
            fs::create_dir_all(home.join("work")).unwrap();
            fs::write(home.join("work.lock"), "mine").unwrap();
            fs::remove_dir(dir.join(name)).unwrap();
            std::os::unix::fs::symlink(&home, dir.join(name)).unwrap();
            let fault = prepare(&dir).unwrap_err();
            assert!(matches!(&fault, StoreError::Foreign { path } if *path == dir.join(name)), "{fault}");
            assert!(home.join("work.lock").exists() && home.join("work").exists(), "{name}");
        }
    }
}
