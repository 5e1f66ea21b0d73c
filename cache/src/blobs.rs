//! Large blobs: one read-only file each, named by its digest, written beside its place and renamed into it.

use std::fs::{self, File, Metadata};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::Digest;
use crate::error::{At, StoreError};
use crate::locks::Locked;
use crate::open::{BLOBS, QUARANTINE, TEMPORARY_BLOB, TMP, set_mode};

/// What was put less long ago is not put again, seconds: much less than the hour a collection spares.
const RECENT_S: u64 = 900;

/// The folder of large blobs and the two it works with.
///
/// A blob may have other names: outputs are hard links to it, and root ignores read-only bits. So every blob carries a
/// **seal**: the fraction of a second of its modification time is derived from its digest. Whoever writes into the file
/// breaks the seal, and a blob whose seal is broken is verified before it is believed.
#[derive(Debug)]
pub(crate) struct Blobs {
    root: PathBuf,
    /// Damage found by [`Blobs::check`] that nobody has asked for yet.
    found: Mutex<Vec<Damage>>,
}

/// A damaged blob and where its bytes are now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// The digest it was stored under.
    pub digest: Digest,
    /// Where it was set aside.
    pub moved_to: PathBuf,
}

impl Blobs {
    /// The large blobs of the store at `root`.
    pub(crate) fn new(root: &Path) -> Self {
        Self { root: root.to_owned(), found: Mutex::default() }
    }

    /// The folder under which all large blobs are.
    pub(crate) fn folder(&self) -> PathBuf {
        self.root.join(BLOBS)
    }

    /// Where this blob is, or would be.
    pub(crate) fn path(&self, digest: &Digest) -> PathBuf {
        digest.hex(|text| self.root.join(BLOBS).join(&text[..2]).join(text))
    }

    /// The size of a blob, or why it is not to be had: missing, or damaged and now set aside.
    pub(crate) fn check(&self, digest: &Digest) -> Result<u64, StoreError> {
        self.look(digest).map(|meta| meta.len())
    }

    fn look(&self, digest: &Digest) -> Result<Metadata, StoreError> {
        let path = self.path(digest);
        let meta = fs::metadata(&path).map_err(|fault| unreadable(digest, &path, fault))?;
        if meta.mtime_nsec() != i64::from(seal_ns(digest)) {
            self.verify(digest, &path).inspect_err(|fault| self.note(fault))?;
        }
        Ok(meta)
    }

    /// Whether a blob is there and no collection can take it for one that nobody has put lately: one put long ago has its
    /// time set anew.
    ///
    /// That it still has its name is looked at after that: a collection moves a blob away and then looks at its time.
    pub(crate) fn renew(&self, digest: &Digest) -> bool {
        let Ok(meta) = self.look(digest) else { return false };
        let path = self.path(digest);
        let touched = || File::open(&path).and_then(|file| seal(&file, digest)).is_ok() && path.exists();
        is_recent(put_s(&meta)) || touched()
    }

    fn note(&self, fault: &StoreError) {
        if let StoreError::Damaged { digest, moved_to } = fault {
            let damage = Damage { digest: *digest, moved_to: moved_to.clone() };
            self.found.lock().unwrap_or_else(PoisonError::into_inner).push(damage);
        }
    }

    /// The damage found by looking, each told of once.
    pub(crate) fn take_damaged(&self) -> Vec<Damage> {
        std::mem::take(&mut self.found.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reads a blob whose seal is broken; seals it again or sets it aside.
    fn verify(&self, digest: &Digest, path: &Path) -> Result<(), StoreError> {
        let file = self.open(digest)?;
        let (found, _) = Digest::of_reader(&file).at("read", path)?;
        if found != *digest {
            return Err(self.quarantine(digest));
        }
        // Only the owner may seal; unsealed, the blob is merely verified every time.
        let _ = seal(&file, digest);
        Ok(())
    }

    /// A blob to read from, unverified.
    pub(crate) fn open(&self, digest: &Digest) -> Result<File, StoreError> {
        let path = self.path(digest);
        File::open(&path).map_err(|fault| unreadable(digest, &path, fault))
    }

    /// Moves a damaged blob out of the way and says where to.
    pub(crate) fn quarantine(&self, digest: &Digest) -> StoreError {
        let (path, moved_to) = (self.path(digest), self.quarantine_path(digest));
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

    /// Stores a blob that is not there yet.
    pub(crate) fn put(&self, digest: &Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let path = self.path(digest);
        let mut file = self.temporary()?;
        file.write_all(bytes).at("write", &path)?;
        set_mode(file.as_file(), 0o444).at("set the mode of", &path)?;
        seal(file.as_file(), digest).at("set the time of", &path)?;
        file.as_file().sync_all().at("sync", &path)?;
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).at("make the folder", folder)?;
        }
        let file = file.persist(&path).map_err(|fault| fault.error).at("write", &path)?;
        // Before it is closed: a program that is being started may have a copy of it.
        let _ = file.unlock();
        Ok(())
    }

    /// A new file in `tmp/`, locked so that nobody takes it for one whose writer died.
    fn temporary(&self) -> Result<tempfile::NamedTempFile, StoreError> {
        let tmp = self.root.join(TMP);
        loop {
            let file = tempfile::Builder::new().prefix(TEMPORARY_BLOB).tempfile_in(&tmp).at("write into", &tmp)?;
            file.as_file().lock().at("lock a file in", &tmp)?;
            // Swept up between its making and its locking? Then make another.
            if file.as_file().metadata().at("look at a file in", &tmp)?.nlink() > 0 {
                return Ok(file);
            }
        }
    }

    /// The bytes of a blob, verified.
    pub(crate) fn get(&self, digest: &Digest) -> Result<Vec<u8>, StoreError> {
        let path = self.path(digest);
        let bytes = fs::read(&path).map_err(|fault| unreadable(digest, &path, fault))?;
        if Digest::of(&bytes) == *digest { Ok(bytes) } else { Err(self.quarantine(digest)) }
    }

    /// The number of large blobs and their bytes.
    pub(crate) fn count(&self) -> Result<(u64, u64), StoreError> {
        let sizes: Vec<u64> = self.list()?.iter().filter_map(|blob| Some(self.written(blob)?.0)).collect();
        Ok((sizes.len() as u64, sizes.iter().sum()))
    }

    /// All large blobs, sorted.
    pub(crate) fn list(&self) -> Result<Vec<Digest>, StoreError> {
        let mut found = Vec::new();
        let all = self.folder();
        for folder in fs::read_dir(&all).at("list", &all)? {
            let folder = folder.at("list", &all)?.path();
            for blob in fs::read_dir(&folder).at("list", &folder)? {
                let name = blob.at("list", &folder)?.file_name();
                found.extend(name.to_str().and_then(|name| name.parse::<Digest>().ok()));
            }
        }
        found.sort_unstable();
        Ok(found)
    }

    /// The size of a blob and when it was last put or verified, seconds since 1970; `None` if it is not there.
    pub(crate) fn written(&self, digest: &Digest) -> Option<(u64, u64)> {
        let meta = fs::metadata(self.path(digest)).ok()?;
        Some((meta.len(), put_s(&meta)))
    }

    /// Removes a blob that was not put after `since_s`, seconds since 1970; says whether it did.
    ///
    /// It is moved away before its time is looked at for the last time: whoever puts it meanwhile has set the time, and
    /// it is moved back, or finds it gone, and writes it anew.
    pub(crate) fn remove(&self, digest: &Digest, since_s: u64) -> Result<bool, StoreError> {
        let path = self.path(digest);
        let Ok(file) = File::open(&path) else { return Ok(false) };
        // Locked, it is not swept up as the half-written blob of a process that died.
        let locked = Locked::try_new(file).ok().flatten();
        if self.written(digest).is_none_or(|(_, put_s)| put_s > since_s) || locked.is_none() {
            return Ok(false);
        }
        let away = self.root.join(TMP).join(format!("{TEMPORARY_BLOB}{digest}"));
        match fs::rename(&path, &away) {
            Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(false),
            moved => moved.at("remove", &path)?,
        }
        let was_put = fs::metadata(&away).is_ok_and(|meta| put_s(&meta) > since_s);
        let done = if was_put { fs::rename(&away, &path) } else { fs::remove_file(&away) };
        done.at("remove", &path)?;
        Ok(!was_put)
    }
}

/// When a blob was last put or verified, seconds since 1970.
fn put_s(meta: &Metadata) -> u64 {
    meta.mtime().max(0) as u64
}

/// Whether a blob put then need not be put again: a collection keeps what was put within a much longer time.
pub(crate) fn is_recent(put_s: u64) -> bool {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    now.as_secs() < put_s.saturating_add(RECENT_S)
}

fn unreadable(digest: &Digest, path: &Path, fault: std::io::Error) -> StoreError {
    match fault.kind() {
        ErrorKind::NotFound => StoreError::Missing { digest: *digest },
        _ => StoreError::io("read", path, fault),
    }
}

/// The fraction of a second, in nanoseconds, that the modification time of this blob must have: whole microseconds,
/// since some file systems keep no more, and never zero, which many tools write.
pub(crate) fn seal_ns(digest: &Digest) -> u32 {
    let bytes = digest.as_bytes();
    let drawn = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
    (1 + drawn % 999_999) * 1000
}

fn seal(file: &File, digest: &Digest) -> std::io::Result<()> {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    file.set_modified(UNIX_EPOCH + Duration::new(now.as_secs(), seal_ns(digest)))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR_S: u64 = 3600;

    /// A large blob put two hours ago.
    fn aged() -> (tempfile::TempDir, Blobs, Digest) {
        let folder = tempfile::tempdir().unwrap();
        [BLOBS, TMP, QUARANTINE].iter().for_each(|name| fs::create_dir(folder.path().join(name)).unwrap());
        let (blobs, digest) = (Blobs::new(folder.path()), Digest::of(b"blob"));
        blobs.put(&digest, b"blob").unwrap();
        let file = blobs.open(&digest).unwrap();
        let then = file.metadata().unwrap().modified().unwrap() - Duration::from_secs(2 * HOUR_S);
        file.set_modified(then).unwrap();
        (folder, blobs, digest)
    }

    fn an_hour_ago() -> u64 {
        UNIX_EPOCH.elapsed().unwrap().as_secs() - HOUR_S
    }

    #[test]
    fn a_blob_is_removed_unless_it_was_put_again() {
        let (folder, blobs, digest) = aged();
        assert!(blobs.renew(&digest));
        assert!(!blobs.remove(&digest, an_hour_ago()).unwrap());
        assert_eq!(blobs.get(&digest).unwrap(), b"blob");
        assert!(blobs.remove(&digest, an_hour_ago() + 2 * HOUR_S).unwrap());
        assert!(!blobs.renew(&digest) && !blobs.remove(&digest, an_hour_ago()).unwrap());
        assert_eq!(fs::read_dir(folder.path().join(TMP)).unwrap().count(), 0);
    }

    #[test]
    fn the_seal_outlasts_being_put_again() {
        let (_folder, blobs, digest) = aged();
        assert!(blobs.renew(&digest));
        let meta = fs::metadata(blobs.path(&digest)).unwrap();
        assert_eq!(meta.mtime_nsec(), i64::from(seal_ns(&digest)));
        assert!(is_recent(put_s(&meta)) && !is_recent(an_hour_ago()));
    }
}
