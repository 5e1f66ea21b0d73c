//! Giving a blob a name people can read: by reflink, hard link or copy, whichever is cheapest and safe.

use std::fs::{self, File, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

use serde::{Deserialize, Serialize};
use tempfile::NamedTempFile;

use crate::blobs::Blobs;
use crate::error::{At, StoreError};
use crate::{Digest, Store};

/// Blobs up to this size are copied rather than linked.
const COPY_BYTES: u64 = 1 << 20;
/// Starts the names of outputs being written.
const HALF_WRITTEN: &str = ".rockface-";

/// How a blob came under a name people can read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Materialised {
    /// A file of its own that shares the blob's extents until one is written to.
    Reflink,
    /// A file of its own.
    Copy,
    /// Another name of the read-only blob itself.
    HardLink,
}

impl Store {
    /// Puts the blob at `to`, making folders as needed and replacing a file there in one step; says how.
    ///
    /// A reflink where the file system can; else a copy up to 1 MiB; else a hard link, where the blob is a read-only file of this user; else a
    /// copy. What is there
    /// then has the digest: a blob that shares its bytes is read first, once a process, unless the store is trusted
    /// ([`Store::trust`]).
    pub fn materialise(&self, digest: &Digest, to: &Path) -> Result<Materialised, StoreError> {
        let folder = match to.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        at_target(fs::create_dir_all(folder), "make the folder", folder)?;
        self.bring([*digest])?;
        if self.is_small(digest) {
            return copy_bytes(&self.get(digest)?, folder, to);
        }
        let bytes = self.blobs().vouch(digest)?;
        let blob = self.blobs().path(digest);
        if reflink(&self.blobs().open(digest)?, folder, to)? {
            return Ok(Materialised::Reflink);
        }
        if bytes <= COPY_BYTES {
            return copy_bytes(&self.blobs().get(digest)?, folder, to);
        }
        if is_own_and_read_only(&blob) && hard_link(&blob, folder, to) {
            return Ok(Materialised::HardLink);
        }
        copy_file(self.blobs(), digest, folder, to)
    }

    /// Puts the blob at `to`, where nothing is yet, in a folder that is there: quicker than [`Store::materialise`], but a
    /// failure may leave half a file. For folders that count only once they are whole.
    pub fn materialise_new(&self, digest: &Digest, to: &Path) -> Result<Materialised, StoreError> {
        self.bring([*digest])?;
        if self.is_small(digest) {
            at_target(fs::write(to, self.get(digest)?), "write", to)?;
            return Ok(Materialised::Copy);
        }
        self.materialise(digest, to)
    }
}

/// Names the action and the path of a failed system call outside of the store.
fn at_target<T>(result: io::Result<T>, action: &'static str, path: &Path) -> Result<T, StoreError> {
    result.at(action, path).map_err(StoreError::outside_store)
}

/// A new file in a folder that is given its name once it is whole, with the permissions that any new file has by the umask: those of other
/// temporary files let only their owner read them.
///
/// # Errors
/// Those of the disk, without the name of the file, which nobody has asked for.
pub fn readable_file(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(HALF_WRITTEN).permissions(Permissions::from_mode(0o666));
    builder.tempfile_in(folder).map_err(|error| error.kind().into())
}

/// A new file beside `to`.
fn beside(folder: &Path) -> Result<NamedTempFile, StoreError> {
    at_target(readable_file(folder), "write into", folder)
}

fn persist(file: NamedTempFile, to: &Path) -> Result<(), StoreError> {
    at_target(file.persist(to).map(drop).map_err(|fault| fault.error), "write", to)
}

fn copy_bytes(bytes: &[u8], folder: &Path, to: &Path) -> Result<Materialised, StoreError> {
    let mut file = beside(folder)?;
    at_target(file.write_all(bytes), "write", to)?;
    persist(file, to)?;
    Ok(Materialised::Copy)
}

/// False where the file system cannot share extents, or not across these two places.
fn reflink(source: &File, folder: &Path, to: &Path) -> Result<bool, StoreError> {
    let file = beside(folder)?;
    if rustix::fs::ioctl_ficlone(&file, source).is_err() {
        return Ok(false);
    }
    persist(file, to)?;
    Ok(true)
}

/// Whether nobody else can change a blob under its other name: its owner could, and so could whoever may write to it.
fn is_own_and_read_only(blob: &Path) -> bool {
    let is_safe = |meta: fs::Metadata| meta.uid() == rustix::process::geteuid().as_raw() && meta.mode() & 0o222 == 0;
    fs::symlink_metadata(blob).is_ok_and(is_safe)
}

/// False where links are not available: another file system, too many links, or no permission.
fn hard_link(blob: &Path, folder: &Path, to: &Path) -> bool {
    // Renaming one name of a file over another of the same file does nothing, so that case is handled separately.
    if is_same_file(blob, to) {
        return true;
    }
    let mut builder = tempfile::Builder::new();
    let linked = builder.prefix(HALF_WRITTEN).make_in(folder, |path| fs::hard_link(blob, path));
    linked.is_ok_and(|linked| linked.persist(to).is_ok())
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    match (fs::metadata(a), fs::symlink_metadata(b)) {
        (Ok(a), Ok(b)) => (a.dev(), a.ino()) == (b.dev(), b.ino()),
        _ => false,
    }
}

fn copy_file(blobs: &Blobs, digest: &Digest, folder: &Path, to: &Path) -> Result<Materialised, StoreError> {
    let mut file = beside(folder)?;
    let mut tee = Tee { from: blobs.open(digest)?, to: &mut file };
    let (found, _) = at_target(Digest::of_reader(&mut tee), "copy the blob to", to)?;
    if found != *digest {
        return Err(blobs.quarantine(digest));
    }
    persist(file, to)?;
    Ok(Materialised::Copy)
}

/// Writes to `to` whatever is read from `from`.
struct Tee<'a> {
    from: File,
    to: &'a mut NamedTempFile,
}

impl Read for Tee<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.from.read(buffer)?;
        self.to.write_all(&buffer[..count])?;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        (folder, store)
    }

    #[test]
    fn each_size_has_its_way_and_every_way_the_same_bytes() {
        let (folder, store) = store();
        for (bytes, way) in [(10, Materialised::Copy), (100_000, Materialised::Copy), (2 << 20, Materialised::HardLink)]
        {
            let blob: Vec<u8> = (0..bytes).map(|at: usize| (at % 251) as u8).collect();
            let digest = store.put(&blob).unwrap();
            let to = folder.path().join("outputs/deep/a.bin");
            for _ in 0..2 {
                let took = store.materialise(&digest, &to).unwrap();
                assert!(took == way || took == Materialised::Reflink && bytes > 10, "{bytes} bytes: {took:?}");
                assert!(fs::read(&to).unwrap() == blob);
            }
            assert_eq!(fs::read_dir(to.parent().unwrap()).unwrap().count(), 1, "nothing is left beside it");
        }
    }

    #[test]
    fn the_last_resort_copies_and_verifies() {
        let (folder, store) = store();
        let digest = store.put(&vec![3; 3 << 20]).unwrap();
        let to = folder.path().join("copy.bin");
        assert_eq!(copy_file(store.blobs(), &digest, folder.path(), &to).unwrap(), Materialised::Copy);
        assert!(fs::read(&to).unwrap() == vec![3; 3 << 20]);
        assert!(!is_same_file(&store.blobs().path(&digest), &to));
    }

    #[test]
    fn a_blob_that_others_could_write_to_is_copied() {
        let (folder, store) = store();
        let digest = store.put(&vec![4; 2 << 20]).unwrap();
        fs::set_permissions(store.blobs().path(&digest), Permissions::from_mode(0o464)).unwrap();
        let to = folder.path().join("copy.bin");
        assert_ne!(store.materialise(&digest, &to).unwrap(), Materialised::HardLink);
        assert!(!is_same_file(&store.blobs().path(&digest), &to));
    }

    #[test]
    fn writing_through_a_hard_link_is_noticed() {
        let (folder, store) = store();
        let digest = store.put(&vec![5; 2 << 20]).unwrap();
        let to = folder.path().join("linked.bin");
        if store.materialise(&digest, &to).unwrap() != Materialised::HardLink {
            println!("skipped: this file system makes reflinks");
            return;
        }
        fs::set_permissions(&to, Permissions::from_mode(0o644)).unwrap();
        let file = fs::OpenOptions::new().write(true).open(&to).unwrap();
        std::os::unix::fs::FileExt::write_all_at(&file, b"edited", 1000).unwrap();
        assert!(!store.contains(&digest));
        assert_eq!(store.stat().unwrap().quarantined, 1);
        store.put(&vec![5; 2 << 20]).unwrap();
        assert!(store.contains(&digest));
    }

    #[test]
    fn a_blob_merely_touched_is_verified_and_sealed_again() {
        let (_folder, store) = store();
        let digest = store.put(&vec![6; 100_000]).unwrap();
        let path = store.blobs().path(&digest);
        let sealed = fs::metadata(&path).unwrap().mtime_nsec();
        File::open(&path).unwrap().set_modified(std::time::SystemTime::UNIX_EPOCH).unwrap();
        assert_eq!(store.size(&digest), Some(100_000));
        assert_eq!(fs::metadata(&path).unwrap().mtime_nsec(), sealed);
    }
}
