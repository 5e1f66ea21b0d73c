//! Digests of files outside the store, remembered so that an untouched file is not read again.
//!
//! They decide which results a run takes, so each bears the [`mark`] of this user and is kept under a name of this user: what another
//! user of a shared store says of a file is not believed, and neither is what came with a store.

use std::fs::{self, File, Metadata};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

use crate::error::{At, StoreError};
use crate::frame::Kind;
use crate::memory::mark;
use crate::{Digest, Store, plain};

/// Tells marks on the digests of files from those on anything else.
const MARKED: &[u8] = b"file digest";
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
    /// it had when this user last had it read, or if it had been modified less than two seconds before that.
    pub fn hash_file(&self, path: &Path) -> Result<FileDigest, StoreError> {
        let canonical = fs::canonicalize(path).at("find", path)?;
        let now = Fingerprint::of(&fs::metadata(&canonical).at("look at", path)?);
        match self.remembered_at(&canonical) {
            Some((then, digest)) if then == now => Ok(FileDigest { digest, bytes: now.bytes }),
            _ => self.hash_anew(&canonical),
        }
    }

    /// The digest of a file, read anew whatever is remembered of it.
    pub fn rehash_file(&self, path: &Path) -> Result<FileDigest, StoreError> {
        self.hash_anew(&fs::canonicalize(path).at("find", path)?)
    }

    /// The state and the digest that a file had when it was last read, if that is remembered.
    pub(crate) fn remembered_file(&self, path: &Path) -> Option<(Fingerprint, Digest)> {
        self.remembered_at(&fs::canonicalize(path).ok()?)
    }

    fn remembered_at(&self, canonical: &Path) -> Option<(Fingerprint, Digest)> {
        self.remembered(&name_of(canonical)?)
    }

    /// [`Store::remembered_file`] by the name it is kept under.
    pub(crate) fn remembered(&self, name: &Digest) -> Option<(Fingerprint, Digest)> {
        let read = |payload: &[u8]| serde_json::from_slice::<(Fingerprint, Digest, Digest)>(payload).ok();
        let (state, digest, told) =
            self.journal().with_index(|index| index.payload(Kind::File, name).and_then(read))?;
        (mark_on(name, &state, &digest)? == told).then_some((state, digest))
    }

    fn hash_anew(&self, path: &Path) -> Result<FileDigest, StoreError> {
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
            if is_settled(&before, started)
                && let Some(name) = name_of(path)
                && let Some(mark) = mark_on(&name, &fingerprint, &digest)
            {
                let payload = serde_json::to_vec(&(fingerprint, digest, mark));
                let payload = payload.map_err(std::io::Error::from).at("remember", path)?;
                match self.append(Kind::File, name, &payload) {
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

/// Under which name the digest of the file at this path is kept: no two users of a store have the same.
fn name_of(canonical: &Path) -> Option<Digest> {
    mark(&[MARKED, canonical.as_os_str().as_bytes()])
}

fn mark_on(name: &Digest, state: &Fingerprint, digest: &Digest) -> Option<Digest> {
    mark(&[MARKED, name.as_bytes(), &state.bytes(), digest.as_bytes()])
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
    fn what_others_say_of_a_file_is_not_believed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("face.ply");
        fs::write(&path, b"ply").unwrap();
        set_age(&path, 60);
        let store = Store::open(&folder.path().join("store")).unwrap();
        let (name, state) = (name_of(&path).unwrap(), Fingerprint::of(&fs::metadata(&path).unwrap()));
        let other = Digest::of(b"another file");
        let foreign = Digest::keyed(&[7; 32], &[MARKED, name.as_bytes(), &state.bytes(), other.as_bytes()]);
        let plain = Digest::of(path.as_os_str().as_bytes());
        for (name, payload) in [
            (name, serde_json::to_vec(&(state, other)).unwrap()),
            (name, serde_json::to_vec(&(state, other, foreign)).unwrap()),
            (plain, serde_json::to_vec(&(state, other)).unwrap()),
        ] {
            store.append(Kind::File, name, &payload).unwrap();
            assert_eq!(store.remembered_file(&path), None);
        }
        assert_eq!(store.hash_file(&path).unwrap().digest, Digest::of(b"ply"));
        assert_eq!(store.remembered_file(&path), Some((state, Digest::of(b"ply"))));
        // A mark on what this user read of another file is none for this one.
        let aside = folder.path().join("aside.ply");
        fs::write(&aside, b"aside").unwrap();
        set_age(&aside, 60);
        store.hash_file(&aside).unwrap();
        let payload = store
            .journal()
            .with_index(|index| index.payload(Kind::File, &name_of(&aside).unwrap()).map(<[u8]>::to_vec));
        store.append(Kind::File, name, &payload.unwrap()).unwrap();
        assert_eq!(store.remembered_file(&path), None);
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
