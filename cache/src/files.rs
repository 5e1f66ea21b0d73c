//! Digests of files outside the store, remembered so that an untouched file is not read again.

use std::fs::{self, File, Metadata};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

use crate::error::{At, StoreError};
use crate::frame::Kind;
use crate::{Digest, Store, plain};

/// A file modified less than this before it was read may be modified again without its time changing.
const RACY: Duration = Duration::from_secs(2);
/// A file whose state changed (its times may have been set back since) less than this before may change again within the
/// same tick of the clock that file systems count by.
const TICK: Duration = Duration::from_millis(20);
/// How often a file that changes while it is read is read anew.
const ATTEMPTS: usize = 3;

/// The digest of a file outside the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileDigest {
    /// The digest of its bytes.
    pub digest: Digest,
    /// Its size in bytes.
    pub bytes: u64,
}

/// What tells an untouched file without reading it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Fingerprint {
    /// The size in bytes.
    pub bytes: u64,
    mtime_ns: i128,
    ctime_ns: i128,
    inode: u64,
    device: u64,
}

impl Fingerprint {
    /// The state a file or folder is in.
    pub(crate) fn of(meta: &Metadata) -> Self {
        let nanoseconds = |seconds: i64, rest: i64| i128::from(seconds) * 1_000_000_000 + i128::from(rest);
        Self {
            bytes: meta.len(),
            mtime_ns: nanoseconds(meta.mtime(), meta.mtime_nsec()),
            ctime_ns: nanoseconds(meta.ctime(), meta.ctime_nsec()),
            inode: meta.ino(),
            device: meta.dev(),
        }
    }

    /// The same, as the system call has it.
    pub(crate) fn of_stat(stat: &rustix::fs::Stat) -> Self {
        let nanoseconds = |seconds: i64, rest: u64| i128::from(seconds) * 1_000_000_000 + i128::from(rest);
        Self {
            bytes: stat.st_size as u64,
            mtime_ns: nanoseconds(stat.st_mtime, stat.st_mtime_nsec),
            ctime_ns: nanoseconds(stat.st_ctime, stat.st_ctime_nsec),
            inode: stat.st_ino,
            device: stat.st_dev,
        }
    }

    /// All of it, one after the other.
    pub(crate) fn bytes(&self) -> [u8; 56] {
        let mut all = [0; 56];
        let parts = [self.bytes.to_le_bytes(), self.inode.to_le_bytes(), self.device.to_le_bytes()];
        all[..24].copy_from_slice(parts.as_flattened());
        all[24..40].copy_from_slice(&self.mtime_ns.to_le_bytes());
        all[40..].copy_from_slice(&self.ctime_ns.to_le_bytes());
        all
    }
}

impl Store {
    /// The digest of a file. Read at a bounded memory, and only if its size, times, inode or device differ from those
    /// it had when it was last read, or if it had been modified less than two seconds before that.
    pub fn hash_file(&self, path: &Path) -> Result<FileDigest, StoreError> {
        let canonical = fs::canonicalize(path).at("find", path)?;
        let key = Digest::of(canonical.as_os_str().as_bytes());
        let now = Fingerprint::of(&fs::metadata(&canonical).at("look at", path)?);
        match self.remembered(&key) {
            Some((then, digest)) if then == now => Ok(FileDigest { digest, bytes: now.bytes }),
            _ => self.hash_anew(&canonical, &key),
        }
    }

    /// The digest of a file, read anew whatever is remembered of it.
    pub fn rehash_file(&self, path: &Path) -> Result<FileDigest, StoreError> {
        let canonical = fs::canonicalize(path).at("find", path)?;
        self.hash_anew(&canonical, &Digest::of(canonical.as_os_str().as_bytes()))
    }

    /// The state and the digest that a file had when it was last read, if that is remembered.
    pub(crate) fn remembered_file(&self, path: &Path) -> Option<(Fingerprint, Digest)> {
        let canonical = fs::canonicalize(path).ok()?;
        self.remembered(&Digest::of(canonical.as_os_str().as_bytes()))
    }

    /// [`Store::remembered_file`] by the digest of its path.
    pub(crate) fn remembered(&self, key: &Digest) -> Option<(Fingerprint, Digest)> {
        self.journal().with_index(|index| serde_json::from_slice(index.payload(Kind::File, key)?).ok())
    }

    fn hash_anew(&self, path: &Path, key: &Digest) -> Result<FileDigest, StoreError> {
        for _ in 0..ATTEMPTS {
            let started = SystemTime::now();
            let file = File::open(path).at("open", path)?;
            let before = file.metadata().at("look at", path)?;
            let (digest, bytes) = Digest::of_reader(&file).at("read", path)?;
            self.count_hashed();
            let fingerprint = Fingerprint::of(&before);
            if fingerprint != Fingerprint::of(&file.metadata().at("look at", path)?) || bytes != before.len() {
                continue;
            }
            if is_settled(&before, started) {
                let payload = serde_json::to_vec(&(fingerprint, digest));
                let payload = payload.map_err(std::io::Error::from).at("remember", path)?;
                match self.append(Kind::File, *key, &payload) {
                    // What may not be remembered, since the store can only be read, is hashed again next time.
                    Err(StoreError::Io { source, .. }) if plain::is_refused(&source) => {}
                    remembered => remembered?,
                }
            }
            return Ok(FileDigest { digest, bytes });
        }
        Err(StoreError::Changing { path: path.to_owned() })
    }
}

/// Whether the file had been left alone for long enough that another change would show in its times: the one of its
/// content, which anybody may set, and the one of its state, which only the system sets.
pub(crate) fn is_settled(meta: &Metadata, now: SystemTime) -> bool {
    let age = meta.modified().ok().and_then(|modified| now.duration_since(modified).ok());
    // A time without a fraction comes from a file system that counts in whole seconds.
    let tick = if meta.ctime_nsec() == 0 { RACY } else { TICK };
    let changed = Duration::new(meta.ctime().max(0) as u64, meta.ctime_nsec().max(0) as u32);
    let still = now.duration_since(SystemTime::UNIX_EPOCH + changed).ok();
    age.is_some_and(|age| age >= RACY) && still.is_some_and(|still| still >= tick)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set_age(path: &Path, age_s: u64) {
        let file = fs::OpenOptions::new().write(true).open(path).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(age_s)).unwrap();
        std::thread::sleep(TICK);
    }

    #[test]
    fn an_untouched_file_is_read_once_and_a_touched_one_once_more() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("store");
        let path = folder.path().join("face.ply");
        fs::write(&path, b"ply").unwrap();
        set_age(&path, 60);
        let store = Store::open(&dir).unwrap();
        let hashed = || store.stat().unwrap().files_hashed;
        for _ in 0..3 {
            let expected = FileDigest { digest: Digest::of(b"ply"), bytes: 3 };
            assert_eq!(store.hash_file(&path).unwrap(), expected);
            assert_eq!(hashed(), 1);
        }
        set_age(&path, 30);
        for _ in 0..3 {
            store.hash_file(&path).unwrap();
            assert_eq!(hashed(), 2);
        }
        let other = Store::open(&dir).unwrap();
        other.hash_file(&path).unwrap();
        assert_eq!(other.stat().unwrap().files_hashed, 0, "what one process read the next remembers");
    }

    #[test]
    fn a_file_just_modified_is_not_trusted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("face.ply");
        let store = Store::open(&folder.path().join("store")).unwrap();
        fs::write(&path, b"old").unwrap();
        store.hash_file(&path).unwrap();
        let modified = fs::metadata(&path).unwrap().modified().unwrap();
        // The same size and the same time: only the guard can tell.
        fs::write(&path, b"new").unwrap();
        fs::OpenOptions::new().write(true).open(&path).unwrap().set_modified(modified).unwrap();
        assert_eq!(store.hash_file(&path).unwrap().digest, Digest::of(b"new"));
    }

    #[test]
    fn a_file_whose_time_was_set_back_just_now_is_not_trusted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("face.ply");
        fs::write(&path, b"old").unwrap();
        set_age(&path, 60);
        let meta = fs::metadata(&path).unwrap();
        let changed = SystemTime::UNIX_EPOCH + Duration::new(meta.ctime() as u64, meta.ctime_nsec() as u32);
        assert!(!is_settled(&meta, changed + TICK / 2));
        assert!(is_settled(&meta, changed + 2 * RACY));
    }

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        let message = store.hash_file(&folder.path().join("nowhere.ply")).unwrap_err().to_string();
        assert!(message.contains("nowhere.ply"), "{message}");
    }
}
