//! Whether a large blob is what it is called: looked at by its size and its seal, read once a process before it is handed on.

use std::collections::HashMap;
use std::fs::{self, File, Metadata};
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::blobs::{Blobs, unreadable};
use crate::error::{At, StoreError};
use crate::open::QUARANTINE;
use crate::{Digest, Store, plain};

/// A damaged blob and where its bytes are now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// The digest it was stored under.
    pub digest: Digest,
    /// Where it was set aside.
    pub moved_to: PathBuf,
}

/// What this process knows of large blobs beyond what their files tell.
#[derive(Debug, Default)]
pub(crate) struct Knowledge {
    /// Damage found by looking that nobody has asked for yet.
    found: Mutex<Vec<Damage>>,
    /// Blobs this process has written or read, and the state of their files then.
    read: Mutex<HashMap<Digest, State>>,
    /// Whether blobs that look whole are handed on unread.
    trusting: AtomicBool,
}

/// What changes when other bytes take the place of those of a file: device, inode, size, time of modification. (The time of
/// its state changes with every new name it is given.)
type State = (u64, u64, u64, i64, i64);

fn state(meta: &Metadata) -> State {
    (meta.dev(), meta.ino(), meta.len(), meta.mtime(), meta.mtime_nsec())
}

impl Store {
    /// Hands on large blobs that look whole without reading them first: quicker, and bit rot stays unseen. What is read is
    /// verified all the same.
    pub fn trust(&self, trusting: bool) {
        self.blobs().known.trusting.store(trusting, Ordering::Relaxed);
    }

    /// Reads these blobs and sets aside those that are damaged; what this process has read or written is not read again.
    pub fn scrub(&self, blobs: impl IntoIterator<Item = Digest>) -> Result<Vec<Damage>, StoreError> {
        let mut damaged = Vec::new();
        for digest in blobs {
            let read = if self.is_small(&digest) { self.get(&digest).map(drop) } else { self.blobs().read(&digest) };
            match read {
                Err(StoreError::Damaged { digest, moved_to }) => damaged.push(Damage { digest, moved_to }),
                // What is not there cannot be damaged.
                Ok(()) | Err(StoreError::Missing { .. }) => {}
                Err(fault) => return Err(fault),
            }
        }
        Ok(damaged)
    }
}

impl Blobs {
    /// The size of a blob, or why it is not available: missing, or damaged and now set aside. Where its size should be
    /// `bytes` and is not, the blob is read to see whose fault that is.
    pub(crate) fn check(&self, digest: &Digest, bytes: Option<u64>) -> Result<u64, StoreError> {
        self.look(digest, bytes).map(|meta| meta.len())
    }

    pub(crate) fn look(&self, digest: &Digest, bytes: Option<u64>) -> Result<Metadata, StoreError> {
        let path = self.path(digest);
        let meta = fs::symlink_metadata(&path).map_err(|fault| unreadable(digest, &path, fault))?;
        let is_sealed = meta.is_file() && meta.mtime_nsec() == i64::from(seal_ns(digest));
        if !is_sealed || bytes.is_some_and(|bytes| bytes != meta.len()) {
            self.verify(digest, &path).inspect_err(|fault| self.note(fault))?;
        }
        Ok(meta)
    }

    /// Makes sure that a blob which is about to be handed on unread is whole, and returns its size: it is read, once a
    /// process, unless the store is trusted.
    pub(crate) fn vouch(&self, digest: &Digest) -> Result<u64, StoreError> {
        let bytes = self.check(digest, None)?;
        if !self.known.trusting.load(Ordering::Relaxed) {
            self.read(digest)?;
        }
        Ok(bytes)
    }

    /// Reads a blob and sets it aside if it is damaged; one that this process has read or written is not read again.
    fn read(&self, digest: &Digest) -> Result<(), StoreError> {
        let path = self.path(digest);
        let meta = fs::symlink_metadata(&path).map_err(|fault| unreadable(digest, &path, fault))?;
        let is_known = self.read_ones().get(digest) == Some(&state(&meta));
        if is_known { Ok(()) } else { self.verify(digest, &path) }
    }

    /// Refuses a link in the place of the folder of a blob: nothing of what is behind it is sealed or set aside.
    fn check_folder(path: &Path) -> Result<(), StoreError> {
        match path.parent() {
            Some(folder) if !plain::is_folder(folder) && !plain::is_absent(folder) => {
                Err(StoreError::Foreign { path: folder.to_owned() })
            }
            _ => Ok(()),
        }
    }

    /// Reads a blob; seals it again where its seal was broken, or sets it aside.
    fn verify(&self, digest: &Digest, path: &Path) -> Result<(), StoreError> {
        Self::check_folder(path)?;
        let file = self.open(digest)?;
        let meta = file.metadata().at("look at", path)?;
        let (found, _) = Digest::of_reader(&file).at("read", path)?;
        if found != *digest {
            return Err(self.quarantine(digest));
        }
        if meta.mtime_nsec() != i64::from(seal_ns(digest)) {
            // Only the owner may seal; unsealed, the blob is merely verified every time.
            let _ = seal(&file, digest);
        }
        self.remember(digest, &file);
        Ok(())
    }

    /// Keeps in mind that this file has the very bytes of the blob.
    pub(crate) fn remember(&self, digest: &Digest, file: &File) {
        if let Ok(meta) = file.metadata() {
            self.read_ones().insert(*digest, state(&meta));
        }
    }

    fn read_ones(&self) -> std::sync::MutexGuard<'_, HashMap<Digest, State>> {
        self.known.read.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, fault: &StoreError) {
        if let StoreError::Damaged { digest, moved_to } = fault {
            let damage = Damage { digest: *digest, moved_to: moved_to.clone() };
            self.known.found.lock().unwrap_or_else(PoisonError::into_inner).push(damage);
        }
    }

    /// The damage found so far, each reported once.
    pub(crate) fn take_damaged(&self) -> Vec<Damage> {
        std::mem::take(&mut self.known.found.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// A blob to read from, unverified. What is no plain file is set aside.
    pub(crate) fn open(&self, digest: &Digest) -> Result<File, StoreError> {
        let path = self.path(digest);
        plain::open(&path).map_err(|fault| {
            if plain::is_foreign(&fault) { self.quarantine(digest) } else { unreadable(digest, &path, fault) }
        })
    }

    /// Moves a damaged blob out of the way and says where to.
    pub(crate) fn quarantine(&self, digest: &Digest) -> StoreError {
        let (path, moved_to) = (self.path(digest), self.quarantine_path(digest));
        if let Err(fault) = Self::check_folder(&path) {
            return fault;
        }
        match fs::rename(&path, &moved_to) {
            Ok(()) => StoreError::Damaged { digest: *digest, moved_to },
            Err(fault) if fault.kind() == ErrorKind::NotFound => StoreError::Missing { digest: *digest },
            Err(fault) => StoreError::io("set aside the damaged blob", &path, fault),
        }
    }

    /// A name in the quarantine that nothing has yet.
    pub(crate) fn quarantine_path(&self, digest: &Digest) -> PathBuf {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.root.join(QUARANTINE).join(format!("{digest}-{}", now.as_nanos()))
    }
}

/// The fraction of a second, in nanoseconds, that the modification time of this blob must have: whole microseconds,
/// since some file systems keep no more, and never zero, which many tools write.
pub(crate) fn seal_ns(digest: &Digest) -> u32 {
    let bytes = digest.as_bytes();
    let drawn = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    (1 + drawn % 999_999) * 1000
}

pub(crate) fn seal(file: &File, digest: &Digest) -> std::io::Result<()> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    file.set_modified(UNIX_EPOCH + Duration::new(now.as_secs(), seal_ns(digest)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{FileExt, PermissionsExt, symlink};

    /// A store with a large blob written by a process that is gone.
    fn stored() -> (tempfile::TempDir, Store, Digest, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let digest = Store::open(folder.path()).unwrap().put(&vec![7; 2 << 20]).unwrap();
        let store = Store::open(folder.path()).unwrap();
        let path = store.blobs().path(&digest);
        (folder, store, digest, path)
    }

    /// As a disk does it: no time tells.
    fn flip_a_bit(path: &Path) {
        let modified = fs::metadata(path).unwrap().modified().unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(0o644)).unwrap();
        let file = fs::OpenOptions::new().write(true).open(path).unwrap();
        file.write_all_at(&[6], 1 << 20).unwrap();
        file.set_modified(modified).unwrap();
    }

    #[test]
    fn what_is_handed_on_has_been_read_once() {
        let (_folder, store, digest, path) = stored();
        assert_eq!(store.blobs().vouch(&digest).unwrap(), 2 << 20);
        flip_a_bit(&path);
        assert!(store.blobs().vouch(&digest).is_ok(), "it was read already");
        let other = Store::open(store.dir()).unwrap();
        other.trust(true);
        assert!(other.blobs().vouch(&digest).is_ok(), "whoever trusts the store does not look");
        other.trust(false);
        assert!(matches!(other.blobs().vouch(&digest), Err(StoreError::Damaged { .. })));
        assert!(!other.contains(&digest) && other.put(&vec![7; 2 << 20]).is_ok());
        assert!(other.blobs().vouch(&digest).is_ok());
    }

    #[test]
    fn a_blob_of_the_wrong_size_is_set_aside_by_whoever_knows_the_size() {
        let (_folder, store, digest, path) = stored();
        let sealed = fs::metadata(&path).unwrap().modified().unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
        let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(1000).unwrap();
        file.set_modified(sealed).unwrap();
        assert_eq!(store.size(&digest), Some(1000), "nothing else tells");
        store.put(&vec![7; 2 << 20]).unwrap();
        assert_eq!(store.size(&digest), Some(2 << 20));
        assert_eq!(store.take_damaged().iter().map(|one| one.digest).collect::<Vec<_>>(), [digest]);
        assert_eq!(store.stat().unwrap().quarantined, 1);
    }

    #[test]
    fn scrubbing_finds_what_looks_whole() {
        let (_folder, store, digest, path) = stored();
        let small = store.put(b"small").unwrap();
        let all = [digest, small, Digest::of(b"missing")];
        assert_eq!(store.scrub(all).unwrap(), []);
        flip_a_bit(&path);
        let damaged = Store::open(store.dir()).unwrap().scrub(all).unwrap();
        assert_eq!(damaged.iter().map(|one| one.digest).collect::<Vec<_>>(), [digest]);
        assert!(damaged[0].moved_to.exists() && !path.exists());
    }

    #[test]
    fn nothing_behind_a_link_in_the_place_of_a_folder_is_set_aside_or_sealed() {
        let (folder, store, digest, path) = stored();
        let (around, outside) = (path.parent().unwrap(), folder.path().join("outside"));
        fs::rename(around, &outside).unwrap();
        symlink(&outside, around).unwrap();
        let file = outside.join(path.file_name().unwrap());
        flip_a_bit(&file);
        fs::File::open(&file).unwrap().set_modified(UNIX_EPOCH).unwrap();
        assert!(matches!(store.blobs().check(&digest, None), Err(StoreError::Foreign { path }) if path == around));
        assert!(store.get(&digest).is_err() && file.exists());
        assert_eq!(fs::metadata(&file).unwrap().modified().unwrap(), UNIX_EPOCH);
    }

    #[test]
    fn a_link_in_the_place_of_a_blob_is_set_aside_unread() {
        let (folder, store, digest, path) = stored();
        let secret = folder.path().join("secret");
        fs::rename(&path, &secret).unwrap();
        symlink(&secret, &path).unwrap();
        assert!(!store.contains(&digest), "though it leads to the very bytes");
        assert!(matches!(store.get(&digest), Err(StoreError::Missing { .. })));
        assert!(secret.exists());
        store.put(&vec![7; 2 << 20]).unwrap();
        assert!(fs::symlink_metadata(&path).unwrap().is_file());
    }
}
