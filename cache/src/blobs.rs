//! Large blobs: one read-only file each, named by its digest, written beside its place and renamed into it.

use std::fs::{self, Metadata};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::{At, StoreError};
use crate::locks::{Locked, abandoned};
use crate::open::{BLOBS, TEMPORARY_BLOB};
use crate::seal::{Knowledge, seal};
use crate::sharing::Sharing;
use crate::{Digest, plain};

/// What was put less long ago is not put again, seconds: much less than the hour a collection spares.
const RECENT_S: u64 = 900;

/// The folder of large blobs and the two it works with.
///
/// A blob may have other names: outputs are hard links to it, and root ignores read-only bits. So every blob carries a
/// **seal**: the fraction of a second of its modification time is derived from its digest. Whoever writes into the file
/// breaks the seal, and a blob whose seal is broken is verified before it is believed. Bit rot breaks no seal: what is
/// handed on is read first.
#[derive(Debug)]
pub(crate) struct Blobs {
    pub(crate) root: PathBuf,
    /// Where blobs are written before they get their names.
    tmp: PathBuf,
    pub(crate) known: Knowledge,
}

impl Blobs {
    /// The large blobs of the store at `root`.
    pub(crate) fn new(root: &Path, tmp: &Path) -> Self {
        Self { root: root.to_owned(), tmp: tmp.to_owned(), known: Knowledge::default() }
    }

    /// The folder under which all large blobs are.
    pub(crate) fn folder(&self) -> PathBuf {
        self.root.join(BLOBS)
    }

    /// Where this blob is, or would be.
    pub(crate) fn path(&self, digest: &Digest) -> PathBuf {
        digest.hex(|text| self.root.join(BLOBS).join(&text[..2]).join(text))
    }

    /// Whether a blob is there and no collection can take it for one that nobody has put lately: one put long ago has its
    /// time set anew. One that has not the size it should have is set aside.
    ///
    /// That it still has its name is looked at after that: a collection moves a blob away and then looks at its time.
    pub(crate) fn renew(&self, digest: &Digest, bytes: Option<u64>) -> bool {
        let path = self.path(digest);
        // Nothing behind a link in the place of a folder is touched.
        if !plain::is_in_folder(&path) {
            return false;
        }
        let Ok(meta) = self.look(digest, bytes) else { return false };
        let touched = || plain::open(&path).and_then(|file| seal(&file, digest)).is_ok() && path.exists();
        is_recent(put_s(&meta)) || touched()
    }

    /// Stores a blob that is not there yet.
    pub(crate) fn put(&self, digest: &Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let path = self.path(digest);
        // A link to another folder would have the blob written there.
        let sharing = Sharing::of(&self.root);
        plain::folder(path.parent().unwrap_or(&self.root), sharing)?;
        let mut file = self.temporary()?;
        file.write_all(bytes).at("write", &path)?;
        sharing.give(file.as_file(), 0o444).at("set the mode of", &path)?;
        seal(file.as_file(), digest).at("set the time of", &path)?;
        file.as_file().sync_all().at("sync", &path)?;
        let file = file.persist(&path).map_err(|fault| fault.error).at("write", &path)?;
        self.remember(digest, &file);
        // Before it is closed: a program that is being started may have a copy of it.
        let _ = file.unlock();
        Ok(())
    }

    /// A new file in `tmp/`, locked so that nobody takes it for one whose writer died.
    pub(crate) fn temporary(&self) -> Result<tempfile::NamedTempFile, StoreError> {
        let tmp = &self.tmp;
        loop {
            let file = tempfile::Builder::new().prefix(TEMPORARY_BLOB).tempfile_in(tmp).at("write into", tmp)?;
            file.as_file().lock().at("lock a file in", tmp)?;
            // Swept up between its making and its locking? Then make another.
            if file.as_file().metadata().at("look at a file in", tmp)?.nlink() > 0 {
                return Ok(file);
            }
        }
    }

    /// The bytes of a blob, verified.
    pub(crate) fn get(&self, digest: &Digest) -> Result<Vec<u8>, StoreError> {
        let (path, mut file) = (self.path(digest), self.open(digest)?);
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).at("read", &path)?;
        if Digest::of(&bytes) != *digest {
            return Err(self.quarantine(digest));
        }
        self.remember(digest, &file);
        Ok(bytes)
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
            // Taken for none, a folder that cannot be looked at would have its blobs go unread.
            let meta = match fs::symlink_metadata(&folder) {
                Err(fault) if fault.kind() == ErrorKind::NotFound => continue,
                meta => meta.at("look at", &folder)?,
            };
            // One that is being made has another name, and may be open to its maker only.
            if !meta.is_dir() || !is_folder_name(&folder) {
                continue;
            }
            let blobs = match fs::read_dir(&folder) {
                Err(fault) if fault.kind() == ErrorKind::NotFound => continue,
                blobs => blobs.at("list", &folder)?,
            };
            for blob in blobs {
                let name = blob.at("list", &folder)?.file_name();
                found.extend(name.to_str().and_then(|name| name.parse::<Digest>().ok()));
            }
        }
        found.sort_unstable();
        Ok(found)
    }

    /// The size of a blob and when it was last put or verified, seconds since 1970; `None` if it is not there.
    pub(crate) fn written(&self, digest: &Digest) -> Option<(u64, u64)> {
        let meta = fs::symlink_metadata(self.path(digest)).ok().filter(Metadata::is_file)?;
        Some((meta.len(), put_s(&meta)))
    }

    /// Removes a blob that was not put after `since_s`, seconds since 1970; says whether it did.
    ///
    /// It is moved away before its time is looked at for the last time: whoever puts it meanwhile has set the time, and
    /// it is moved back, or finds it gone, and writes it anew.
    pub(crate) fn remove(&self, digest: &Digest, since_s: u64) -> Result<bool, StoreError> {
        let path = self.path(digest);
        if !plain::is_in_folder(&path) {
            return Ok(false);
        }
        let Ok(file) = plain::open(&path) else { return Ok(false) };
        // Locked, it is not swept up as the half-written blob of a process that died.
        let locked = Locked::try_new(file).ok().flatten();
        if self.written(digest).is_none_or(|(_, put_s)| put_s > since_s) || locked.is_none() {
            return Ok(false);
        }
        let away = self.tmp.join(format!("{TEMPORARY_BLOB}{digest}"));
        match fs::rename(&path, &away) {
            Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(false),
            moved => moved.at("remove", &path)?,
        }
        let was_put = fs::metadata(&away).is_ok_and(|meta| put_s(&meta) > since_s);
        let done = if was_put { fs::rename(&away, &path) } else { fs::remove_file(&away) };
        done.at("remove", &path)?;
        Ok(!was_put)
    }

    /// Moves blobs back that a collection which died had moved away: it may have been about to do so itself. The next
    /// collection removes the others.
    pub(crate) fn take_back(&self) -> Result<(), StoreError> {
        let tmp = &self.tmp;
        for entry in fs::read_dir(tmp).at("list", tmp)? {
            let away = entry.at("list", tmp)?.path();
            let name = away.file_name().and_then(|name| name.to_str()?.strip_prefix(TEMPORARY_BLOB));
            let Some(digest) = name.and_then(|name| name.parse::<Digest>().ok()) else { continue };
            let path = self.path(&digest);
            // Never through a link, which could lead out of the store.
            if !plain::is_in_folder(&path) {
                continue;
            }
            // The lock is held until it is back. What cannot be moved now is left for another time.
            let held = plain::open(&away).ok().and_then(|file| abandoned(file, &away));
            if held.is_some() {
                let _ = fs::rename(&away, path);
            }
        }
        Ok(())
    }
}

/// Whether the blobs with the same first two digits are in a folder of this name.
fn is_folder_name(folder: &Path) -> bool {
    let name = folder.file_name().unwrap_or_default().as_encoded_bytes();
    name.len() == 2 && name.iter().all(u8::is_ascii_hexdigit)
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

pub(crate) fn unreadable(digest: &Digest, path: &Path, fault: std::io::Error) -> StoreError {
    match fault.kind() {
        ErrorKind::NotFound => StoreError::Missing { digest: *digest },
        _ => StoreError::io("read", path, fault),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::open::{QUARANTINE, TMP};
    use crate::seal::seal_ns;
    use std::time::Duration;

    const HOUR_S: u64 = 3600;

    /// A large blob put two hours ago.
    fn aged() -> (tempfile::TempDir, Blobs, Digest) {
        let folder = tempfile::tempdir().unwrap();
        [BLOBS, TMP, QUARANTINE].iter().for_each(|name| fs::create_dir(folder.path().join(name)).unwrap());
        let (blobs, digest) = (Blobs::new(folder.path(), &folder.path().join(TMP)), Digest::of(b"blob"));
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
        assert!(blobs.renew(&digest, None));
        assert!(!blobs.remove(&digest, an_hour_ago()).unwrap());
        assert_eq!(blobs.get(&digest).unwrap(), b"blob");
        assert!(blobs.remove(&digest, an_hour_ago() + 2 * HOUR_S).unwrap());
        assert!(!blobs.renew(&digest, None) && !blobs.remove(&digest, an_hour_ago()).unwrap());
        assert_eq!(fs::read_dir(folder.path().join(TMP)).unwrap().count(), 0);
    }

    #[test]
    fn a_blob_that_a_collection_moved_away_before_it_died_is_taken_back() {
        let (folder, blobs, digest) = aged();
        let away = folder.path().join(TMP).join(format!("{TEMPORARY_BLOB}{digest}"));
        fs::rename(blobs.path(&digest), &away).unwrap();
        let held = fs::File::open(&away).unwrap();
        held.lock().unwrap();
        blobs.take_back().unwrap();
        assert!(away.exists(), "the collection is at it");
        drop(held);
        blobs.take_back().unwrap();
        assert_eq!(blobs.get(&digest).unwrap(), b"blob");
        assert!(!away.exists());
    }

    #[test]
    fn folders_that_are_being_made_are_passed_over() {
        let (folder, blobs, digest) = aged();
        let new = folder.path().join(BLOBS).join(".new-a1b2c3");
        fs::create_dir(&new).unwrap();
        fs::write(new.join(Digest::of(b"other").to_string()), "").unwrap();
        assert_eq!(blobs.list().unwrap(), [digest]);
    }

    #[test]
    fn nothing_is_taken_back_through_a_link() {
        let (folder, blobs, digest) = aged();
        let (inside, outside) = (blobs.path(&digest), folder.path().join("outside"));
        let around = inside.parent().unwrap();
        fs::rename(around, &outside).unwrap();
        let precious = outside.join(digest.to_string());
        std::os::unix::fs::symlink(&outside, around).unwrap();
        fs::write(folder.path().join(TMP).join(format!("{TEMPORARY_BLOB}{digest}")), "of somebody else").unwrap();
        blobs.take_back().unwrap();
        assert_eq!(fs::read(&precious).unwrap(), b"blob");
    }

    #[test]
    fn the_seal_outlasts_being_put_again() {
        let (_folder, blobs, digest) = aged();
        assert!(blobs.renew(&digest, None));
        let meta = fs::metadata(blobs.path(&digest)).unwrap();
        assert_eq!(meta.mtime_nsec(), i64::from(seal_ns(&digest)));
        assert!(is_recent(put_s(&meta)) && !is_recent(an_hour_ago()));
    }
}
