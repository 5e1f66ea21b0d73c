//! Locks on keys: no two processes of one host do the same step at once.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use crate::Digest;
use crate::error::{At, StoreError};
use crate::segment::is_at;

/// The right to compute one key. Released when dropped, or by the kernel when the process ends in any way.
#[derive(Debug)]
#[must_use = "the lock is released when this is dropped"]
pub struct KeyLock {
    file: File,
    path: PathBuf,
}

impl Drop for KeyLock {
    fn drop(&mut self) {
        // Removed while still held: whoever waits on this file finds that it has lost its name, and takes the new one.
        // A file that cannot be removed is only litter, swept up when the store is next opened.
        let _ = std::fs::remove_file(&self.path);
        let _ = self.file.unlock();
    }
}

/// Takes the lock of `key`, calling `on_wait` once before waiting if it is held elsewhere.
pub(crate) fn lock(dir: &Path, key: &Digest, on_wait: impl FnOnce()) -> Result<KeyLock, StoreError> {
    if let Some(lock) = try_lock(dir, key)? {
        return Ok(lock);
    }
    on_wait();
    loop {
        let (file, path) = open(dir, key)?;
        match file.lock() {
            Ok(()) if is_at(&file, &path) => return Ok(KeyLock { file, path }),
            Ok(()) => {}
            Err(fault) if fault.kind() == io::ErrorKind::Interrupted => {}
            Err(fault) => return Err(StoreError::io("lock", &path, fault)),
        }
    }
}

/// Takes the lock of `key` unless it is held elsewhere.
pub(crate) fn try_lock(dir: &Path, key: &Digest) -> Result<Option<KeyLock>, StoreError> {
    loop {
        let (file, path) = open(dir, key)?;
        match file.try_lock() {
            Ok(()) if is_at(&file, &path) => return Ok(Some(KeyLock { file, path })),
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Ok(None),
            Err(TryLockError::Error(fault)) => return Err(StoreError::io("lock", &path, fault)),
        }
    }
}

fn open(dir: &Path, key: &Digest) -> Result<(File, PathBuf), StoreError> {
    let path = dir.join(key.to_string());
    let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
    Ok((file.at("open", &path)?, path))
}

/// Removes the files in `dir` that start with `prefix` and whose owner is gone.
///
/// Owners hold a lock on their file and check, once they have it, that the file still has its name, so none is removed
/// from under them. A file that cannot be removed now is left for another time.
pub(crate) fn sweep(dir: &Path, prefix: &str) -> Result<(), StoreError> {
    for entry in std::fs::read_dir(dir).at("list", dir)? {
        let entry = entry.at("list", dir)?;
        let ours = entry.file_name().to_str().is_some_and(|name| name.starts_with(prefix));
        if ours {
            remove_abandoned(&entry.path());
        }
    }
    Ok(())
}

fn remove_abandoned(path: &Path) {
    // The lock is held until the file is gone.
    let held = File::open(path).ok().filter(|file| is_abandoned(file, path));
    if held.is_some() {
        let _ = std::fs::remove_file(path);
    }
}

/// Whether nobody holds the lock of this file, which is still at `path`. The lock is held from now on.
pub(crate) fn is_abandoned(file: &File, path: &Path) -> bool {
    file.try_lock().is_ok() && is_at(file, path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[test]
    fn a_held_key_is_refused_then_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let (dir, key) = (folder.path(), Digest::of(b"key"));
        let held = try_lock(dir, &key).unwrap().unwrap();
        assert!(try_lock(dir, &key).unwrap().is_none());
        assert!(try_lock(dir, &Digest::of(b"other")).unwrap().is_some());
        let (waiting, waits) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            let waiter = scope.spawn(|| drop(lock(dir, &key, || waiting.send(()).unwrap()).unwrap()));
            waits.recv().unwrap();
            assert!(!waiter.is_finished());
            drop(held);
        });
        assert_eq!(std::fs::read_dir(dir).unwrap().count(), 0, "released locks leave no file");
    }

    #[test]
    fn one_holder_at_a_time_however_many_contend() {
        let folder = tempfile::tempdir().unwrap();
        let (inside, entered) = (AtomicU32::new(0), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        let _held = lock(folder.path(), &Digest::of(b"key"), || ()).unwrap();
                        assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0);
                        entered.fetch_add(1, Ordering::SeqCst);
                        inside.fetch_sub(1, Ordering::SeqCst);
                    }
                });
            }
        });
        assert_eq!(entered.into_inner(), 400);
    }

    #[test]
    fn sweeping_spares_what_is_held() {
        let folder = tempfile::tempdir().unwrap();
        let held = try_lock(folder.path(), &Digest::of(b"held")).unwrap().unwrap();
        std::fs::write(folder.path().join(Digest::of(b"left").to_string()), b"").unwrap();
        sweep(folder.path(), "").unwrap();
        let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert!(left.len() == 1 && left[0] == held.path, "{left:?}");
    }
}
