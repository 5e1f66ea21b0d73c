//! Files that the user names for a command to write: what may be replaced, and writing whole or not at all.

use std::fs::File;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

use rockface_engine::history::HistoryError;
use rockface_engine::plan::kind_of;

use super::CliError;

/// Refuses a place where something other than a regular file is. Every writer puts a new file in the place of the old one,
/// so a device, a pipe or a link would be gone; a link is refused wherever it leads.
pub fn check_place(path: &Path) -> Result<(), CliError> {
    let metadata = match std::fs::symlink_metadata(path) {
        Ok(metadata) if metadata.is_file() => return Ok(()),
        Ok(metadata) => metadata,
        Err(error) if is_absent(&error) => return Ok(()),
        Err(error) => return Err(failed("look at", path)(error)),
    };
    let (path, kind) = (path.display(), kind_of(metadata.file_type()));
    Err(CliError::Usage(format!("{path} is {kind}, and only a regular file is replaced: name another file")))
}

/// Whether nothing is at a place; where a folder on the way to it is a file, that is found when the place is written to.
fn is_absent(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory)
}

/// Refuses to write where a file is that does not have, at byte `at`, what all files have that the command writes.
pub fn check_own(path: &Path, at: u64, has: &[u8], what: &str) -> Result<(), CliError> {
    check_place(path)?;
    let is_own = File::open(path).and_then(|file| {
        let mut found = vec![0; has.len()];
        let is_empty = file.metadata()?.len() == 0;
        match file.read_exact_at(&mut found, at) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(is_empty),
            read => read.map(|()| found == has),
        }
    });
    match is_own {
        Ok(true) => Ok(()),
        Ok(false) => Err(CliError::Usage(format!("{} is there and is no {what}; name another file", path.display()))),
        Err(error) if is_absent(&error) => Ok(()),
        Err(error) => Err(failed("read", path)(error)),
    }
}

/// Writes a file whole or not at all, in place of one that is there: half of one would never be completed.
pub fn write_own(file: &Path, bytes: &[u8]) -> std::io::Result<()> {
    written(folder_of(file), bytes)?.persist(file).map(drop).map_err(|error| error.error)
}

/// Writes a file whole or not at all, and the folders it is in. One that is there stays as it is.
pub fn write_new(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let folder = folder_of(path);
    std::fs::create_dir_all(folder).map_err(failed("make the folder", folder))?;
    let file = written(folder, bytes).map_err(failed("write", path))?;
    match file.persist_noclobber(path).map(drop).map_err(|error| error.error) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            Err(CliError::Usage(format!("{} is there already: give another folder", path.display())))
        }
        other => other.map_err(failed("write", path)),
    }
}

/// The folder a file is in.
pub fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The error of a file or folder that cannot be used.
pub fn failed(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> CliError + use<> {
    let path = path.to_owned();
    move |source| CliError::History(HistoryError::Io { action, path, source })
}

/// These bytes in a file that has no name of its own yet.
fn written(folder: &Path, bytes: &[u8]) -> std::io::Result<tempfile::NamedTempFile> {
    let mut file = rockface_cache::readable_file(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, FileType, mknodat};

    #[test]
    fn only_a_regular_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        std::fs::write(place("file"), "text").unwrap();
        std::fs::create_dir(place("folder")).unwrap();
        mknodat(CWD, place("pipe"), FileType::Fifo, 0o600.into(), 0).unwrap();
        for (name, leads) in [("link", "file"), ("dangling", "nowhere")] {
            std::os::unix::fs::symlink(place(leads), place(name)).unwrap();
        }
        assert!(check_place(&place("file")).is_ok() && check_place(&place("none")).is_ok());
        let refused = |path: &Path| check_place(path).unwrap_err().to_string();
        for (name, kind) in [("folder", "a folder"), ("pipe", "a pipe"), ("link", "a link"), ("dangling", "a link")] {
            let told = refused(&place(name));
            assert!(told.contains(&format!("{name} is {kind}, and only a regular file")), "{told}");
        }
        assert!(refused(Path::new("/dev/null")).contains("/dev/null is a device"));
    }

    #[test]
    fn a_file_is_its_own_by_what_it_has_at_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let check = || check_own(&path, 2, b"mark", "sheet");
        assert!(check().is_ok(), "there is none");
        for (text, is_own) in [("", true), ("..mark..", true), ("..mar", false), (".", false), ("..work..", false)] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(check().is_ok(), is_own, "{text:?}");
        }
        assert!(check().unwrap_err().to_string().contains("is there and is no sheet; name another file"));
    }

    #[test]
    fn a_new_file_takes_no_place_and_a_replaced_one_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/file");
        write_new(&path, b"first").unwrap();
        let again = write_new(&path, b"second").unwrap_err().to_string();
        assert!(again.contains("is there already") && std::fs::read(&path).unwrap() == b"first", "{again}");
        write_own(&path, b"third").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"third");
        assert_eq!(std::fs::read_dir(folder_of(&path)).unwrap().count(), 1);
        let missing = write_own(&folder.path().join("none").join("file"), b"").unwrap_err().to_string();
        assert!(!missing.contains(".rockface-"), "{missing}");
    }
}
