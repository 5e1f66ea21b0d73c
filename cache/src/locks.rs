//! Locks: no two processes do the same step at once, and nothing is removed from under its owner.

use std::fs::{File, OpenOptions};
use std::path::Path;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

use crate::error::{At, StoreError};
use crate::segment::is_at;
use crate::{Digest, plain};

/// The right to compute one key. Released when dropped, or by the kernel when the process ends in any way.
///
/// The keys share one empty file, of which each locks the byte it is numbered by: a file of its own for every step would
/// be made and removed again, which some file systems take longer for than small steps do. Two keys of one number
/// (one chance in 2^62) would wait for each other, no more.
#[derive(Debug)]
#[must_use = "the lock is released when this is dropped"]
pub struct KeyLock {
    /// Opened for this lock alone: what is locked through one opening is locked against all others, also in this process.
    _file: File,
}

/// Takes the lock of `key` in the file `path`, calling `on_wait` once before waiting if it is held elsewhere.
pub(crate) fn lock(path: &Path, key: &Digest, on_wait: impl FnOnce()) -> Result<KeyLock, StoreError> {
    let file = open(path)?;
    if is_taken(&file, path, key)? {
        return Ok(KeyLock { _file: file });
    }
    on_wait();
    loop {
        match fcntl(&file, FcntlArg::F_OFD_SETLKW(&byte_of(key))) {
            Ok(_) => return Ok(KeyLock { _file: file }),
            Err(Errno::EINTR) => {}
            Err(fault) => return Err(StoreError::io("lock", path, fault.into())),
        }
    }
}

/// Takes the lock of `key` in the file `path` unless it is held elsewhere.
pub(crate) fn try_lock(path: &Path, key: &Digest) -> Result<Option<KeyLock>, StoreError> {
    let file = open(path)?;
    Ok(is_taken(&file, path, key)?.then_some(KeyLock { _file: file }))
}

/// Takes the lock of `key` through this opening of the file, unless another holds it.
fn is_taken(file: &File, path: &Path, key: &Digest) -> Result<bool, StoreError> {
    loop {
        match fcntl(file, FcntlArg::F_OFD_SETLK(&byte_of(key))) {
            Ok(_) => return Ok(true),
            Err(Errno::EAGAIN | Errno::EACCES) => return Ok(false),
            Err(Errno::EINTR) => {}
            Err(fault) => return Err(StoreError::io("lock", path, fault.into())),
        }
    }
}

fn open(path: &Path) -> Result<File, StoreError> {
    let mut options = OpenOptions::new();
    plain::open_with(options.read(true).write(true).create(true).truncate(false), path).at("open", path)
}

/// The byte that stands for `key`, to be locked for writing.
fn byte_of(key: &Digest) -> libc::flock {
    let [a, b, c, d, e, f, g, h, ..] = *key.as_bytes();
    let number = i64::from_le_bytes([a, b, c, d, e, f, g, h]);
    libc::flock {
        l_type: libc::F_WRLCK as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        // A file has 2^63 bytes at most.
        l_start: number & (i64::MAX >> 1),
        l_len: 1,
        l_pid: 0,
    }
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
    let held = plain::open(path).ok().filter(|file| is_abandoned(file, path));
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
        let (path, key) = (folder.path().join("keys"), Digest::of(b"key"));
        let held = try_lock(&path, &key).unwrap().unwrap();
        assert!(try_lock(&path, &key).unwrap().is_none());
        assert!(try_lock(&path, &Digest::of(b"other")).unwrap().is_some());
        let (waiting, waits) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            let waiter = scope.spawn(|| drop(lock(&path, &key, || waiting.send(()).unwrap()).unwrap()));
            waits.recv().unwrap();
            assert!(!waiter.is_finished());
            drop(held);
        });
        assert!(try_lock(&path, &key).unwrap().is_some(), "who waited has released it");
        assert_eq!(path.metadata().unwrap().len(), 0, "nothing is ever written");
    }

    #[test]
    fn one_holder_at_a_time_however_many_contend() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys");
        let (inside, entered) = (AtomicU32::new(0), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    for _ in 0..50 {
                        let _held = lock(&path, &Digest::of(b"key"), || ()).unwrap();
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
    fn any_key_has_a_byte_that_a_file_can_have() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys");
        for bytes in [[0; 32], [0xff; 32], [0x80; 32]] {
            let key = Digest::from_bytes(bytes);
            let held = try_lock(&path, &key).unwrap();
            assert!(held.is_some() && try_lock(&path, &key).unwrap().is_none(), "{key}");
        }
    }

    #[test]
    fn sweeping_spares_what_is_held() {
        let folder = tempfile::tempdir().unwrap();
        let held = folder.path().join("run-held");
        let file = File::create(&held).unwrap();
        file.lock().unwrap();
        std::fs::write(folder.path().join("run-left"), b"").unwrap();
        sweep(folder.path(), "run-").unwrap();
        let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert_eq!(left, [held]);
    }
}
