//! Large blobs: one read-only file each, named by its digest, written beside its place and renamed into it.

use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::Digest;
use crate::error::{At, StoreError};
use crate::open::{BLOBS, QUARANTINE, TEMPORARY_BLOB, TMP, set_mode};

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
        let path = self.path(digest);
        let meta = fs::metadata(&path).map_err(|fault| unreadable(digest, &path, fault))?;
        if meta.mtime_nsec() != i64::from(seal_ns(digest)) {
            self.verify(digest, &path).inspect_err(|fault| self.note(fault))?;
        }
        Ok(meta.len())
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
        let file = File::open(path).at("open", path)?;
        let (found, _) = Digest::of_reader(&file).at("read", path)?;
        if found != *digest {
            return Err(self.quarantine(digest));
        }
        // Only the owner may seal; unsealed, the blob is merely verified every time.
        let _ = seal(&file, digest);
        Ok(())
    }

    /// Moves a damaged blob out of the way and says where to.
    pub(crate) fn quarantine(&self, digest: &Digest) -> StoreError {
        let (path, moved_to) = (self.path(digest), self.quarantine_path(digest));
        match fs::rename(&path, &moved_to) {
            Ok(()) => StoreError::Damaged { digest: *digest, moved_to },
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
        file.persist(&path).map_err(|fault| fault.error).at("write", &path)?;
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
        let sizes: Vec<u64> = self.list()?.iter().filter_map(|blob| Some(self.written(blob)?.1)).collect();
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

    /// A blob with its size and when it was written or last verified, seconds since 1970; `None` if it is not there.
    pub(crate) fn written(&self, digest: &Digest) -> Option<(Digest, u64, u64)> {
        let meta = fs::metadata(self.path(digest)).ok()?;
        Some((*digest, meta.len(), meta.mtime().max(0) as u64))
    }

    /// Removes a blob, if it is there.
    pub(crate) fn remove(&self, digest: &Digest) -> Result<(), StoreError> {
        let path = self.path(digest);
        match fs::remove_file(&path) {
            Err(fault) if fault.kind() != std::io::ErrorKind::NotFound => Err(StoreError::io("remove", &path, fault)),
            _ => Ok(()),
        }
    }
}

fn unreadable(digest: &Digest, path: &Path, fault: std::io::Error) -> StoreError {
    match fault.kind() {
        std::io::ErrorKind::NotFound => StoreError::Missing { digest: *digest },
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
