//! Opens the files of a store: regular files and real folders only, no links.
//!
//! Whoever may write to a shared store may put a link to somebody else's file in the place of a segment, or a pipe that
//! nobody ever writes to. Neither is followed or waited for.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Duration;

use rustix::fs::OFlags;
use rustix::io::Errno;

use crate::error::StoreError;
use crate::sharing::Sharing;

/// How often a file that may not be opened is tried again.
const ATTEMPTS: usize = 3;
/// How long it takes at most until a file that is being made can be opened.
const MOMENT: Duration = Duration::from_millis(10);

/// Opens a plain file to read from.
pub(crate) fn open(path: &Path) -> io::Result<File> {
    open_with(OpenOptions::new().read(true), path)
}

/// The first bytes of a plain file.
pub(crate) fn read_start(path: &Path, bytes: u64) -> io::Result<Vec<u8>> {
    let mut start = Vec::new();
    open(path)?.take(bytes).read_to_end(&mut start)?;
    Ok(start)
}

/// Opens a plain file in a way of its own: no link is followed, and no pipe waited for.
///
/// # Errors
///
/// Those of the system; a link, a folder, a pipe or a device in its place.
pub fn open_with(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = options.custom_flags(flags.bits() as i32).open(path).map_err(|fault| {
        // A link, or a pipe without a reader.
        let is_foreign =
            [Errno::LOOP, Errno::NXIO].iter().any(|errno| fault.raw_os_error() == Some(errno.raw_os_error()));
        if is_foreign { not_plain() } else { fault }
    })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(not_plain()) }
}

fn not_plain() -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, "it is a link or no plain file, which no store has there")
}

/// Whether a file could not be opened because it is not one.
pub(crate) fn is_foreign(fault: &io::Error) -> bool {
    fault.kind() == ErrorKind::InvalidInput
}

/// Does something with a file that another process may be making: for a moment that is open to nobody else.
pub(crate) fn settled<T>(attempt: impl Fn() -> io::Result<T>) -> io::Result<T> {
    for _ in 0..ATTEMPTS {
        match attempt() {
            Err(fault) if fault.kind() == ErrorKind::PermissionDenied => std::thread::sleep(MOMENT),
            done => return done,
        }
    }
    attempt()
}

/// Whether this user may not write there.
pub(crate) fn is_refused(fault: &io::Error) -> bool {
    matches!(fault.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem)
}

/// Makes sure that there is a folder of a store at `path`, and not a link to one.
pub(crate) fn folder(path: &Path, sharing: Sharing) -> Result<(), StoreError> {
    match sharing.folder(path) {
        Ok(()) => Ok(()),
        Err(fault) if fault.kind() == ErrorKind::AlreadyExists => Err(StoreError::Foreign { path: path.to_owned() }),
        Err(fault) => Err(StoreError::io("make the folder", path, fault)),
    }
}

/// Whether there is a folder at `path`, and not a link to one.
pub(crate) fn is_folder(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|meta| meta.is_dir())
}

/// Whether what is at `path` is in a folder, and not behind a link to one.
pub(crate) fn is_in_folder(path: &Path) -> bool {
    path.parent().is_some_and(is_folder)
}

/// Whether nothing is at `path`; false where that cannot be found out.
pub(crate) fn is_absent(path: &Path) -> bool {
    fs::symlink_metadata(path).is_err_and(|fault| fault.kind() == ErrorKind::NotFound)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn links_pipes_and_folders_are_no_files() {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name);
        fs::write(path("file"), "bytes").unwrap();
        symlink(path("file"), path("link")).unwrap();
        symlink(path("nothing"), path("dangling")).unwrap();
        fs::create_dir(path("folder")).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, path("pipe"), rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(open(&path("file")).is_ok());
        for name in ["link", "dangling", "folder", "pipe"] {
            assert!(is_foreign(&open(&path(name)).unwrap_err()), "{name}");
        }
        let mut append = OpenOptions::new();
        append.append(true).create(true);
        assert!(open_with(&mut append, &path("dangling")).is_err() && !path("nothing").exists());
        assert!(open_with(&mut append, &path("pipe")).is_err());
        assert_eq!(open(&path("none")).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[test]
    fn a_link_to_a_folder_is_none() {
        let place = tempfile::tempdir().unwrap();
        let (real, link) = (place.path().join("real"), place.path().join("link"));
        let sharing = Sharing::of(place.path());
        folder(&real, sharing).unwrap();
        folder(&real, sharing).unwrap();
        symlink(&real, &link).unwrap();
        assert!(matches!(folder(&link, sharing), Err(StoreError::Foreign { path }) if path == link));
        assert!(is_folder(&real) && !is_folder(&link));
    }
}
