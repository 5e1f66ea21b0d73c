//! Locks: no two processes do the same step at once, and nothing is removed from under its owner.
//!
//! A program that is being started has a copy of every open file of this process until it runs, and a lock belongs to the
//! open file: one that is merely closed is held on by that copy. So every lock here is released in so many words.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs::{File, TryLockError};
use std::io;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

use crate::error::{At, StoreError};
use crate::leases::Leases;
use crate::remote::{Claim, Having};
use crate::segment::is_at;
use crate::sharing::Sharing;
use crate::{Digest, plain};

/// How often a lease is asked for that another machine has.
const LEASE_POLL: Duration = Duration::from_millis(20);

/// A file that is locked until this is dropped.
#[derive(Debug)]
pub(crate) struct Locked(File);

impl Locked {
    /// Locks a file unless it is locked elsewhere.
    pub(crate) fn try_new(file: File) -> io::Result<Option<Self>> {
        match file.try_lock() {
            Ok(()) => Ok(Some(Self(file))),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(fault)) => Err(fault),
        }
    }
}

impl Deref for Locked {
    type Target = File;

    fn deref(&self) -> &File {
        &self.0
    }
}

impl Drop for Locked {
    fn drop(&mut self) {
        // Without it the lock ends with the last copy of the file, a moment later.
        let _ = self.0.unlock();
    }
}

/// The right to compute one key. Released when dropped, or by the kernel when the process ends in any way.
#[derive(Debug)]
#[must_use = "the lock is released when this is dropped"]
pub struct KeyLock {
    bytes: Arc<Bytes>,
    byte: i64,
    /// The right among those that share only a remote place.
    claim: Option<Claim>,
}

impl KeyLock {
    /// This lock together with the right among those that share a remote place.
    pub(crate) fn with(mut self, claim: Claim) -> Self {
        self.claim = Some(claim);
        self
    }
}

impl Drop for KeyLock {
    fn drop(&mut self) {
        self.claim = None;
        self.bytes.release(self.byte);
    }
}

/// What this process says that it has at hand; others see it until this is dropped, or until the process ends.
#[derive(Debug)]
#[must_use = "others do not see it any more once this is dropped"]
pub struct Announced {
    _byte: KeyLock,
    /// The same for those that share only a remote place.
    _below: Option<Having>,
}

impl Announced {
    /// Announced to those that share a remote place, too.
    pub(crate) fn with(self, below: Option<Having>) -> Self {
        Self { _below: below, ..self }
    }
}

/// The bytes of an empty file, each of which stands for what hashes to its number.
///
/// All are locked through one opening of the file: a file of its own for every step would be made and removed again, which
/// some file systems take longer for than small steps do, and an opening of its own would be one open file more for each
/// lock that is held. What is locked through one opening is locked against all others; among the threads of this process
/// `held` decides. Two keys of one number (one chance in 2^62) would wait for each other, no more.
#[derive(Debug)]
pub(crate) struct Bytes {
    path: PathBuf,
    /// On a store that several machines use: what keeps the others off.
    leases: Option<Leases>,
    /// Opened when the first lock is asked for: a store that is only read may not be writable.
    file: OnceLock<File>,
    /// Bytes that this process has.
    held: Mutex<HashMap<i64, Held>>,
    released: Condvar,
    /// How many threads wait for `released`; changed while `held` is locked.
    waiting: AtomicUsize,
}

/// What this process has a byte for.
#[derive(Debug, Clone, Copy)]
enum Held {
    /// The right to compute a key.
    Key,
    /// Values that this process has and others may ask for; how many announcements share the byte.
    Announced(u32),
}

impl Bytes {
    /// The bytes of the file `path`, which decide among the processes of this machine, and leases that decide among machines.
    pub(crate) fn new(path: PathBuf, leases: Option<Leases>) -> Arc<Self> {
        let (file, held, released, waiting) = (OnceLock::new(), Mutex::default(), Condvar::new(), AtomicUsize::new(0));
        Arc::new(Self { path, leases, file, held, released, waiting })
    }

    /// Takes the lock of `key`, calling `on_wait` once before waiting if it is held elsewhere.
    pub(crate) fn lock(self: &Arc<Self>, key: &Digest, on_wait: impl FnOnce()) -> Result<KeyLock, StoreError> {
        let byte = byte_of(key);
        let mut on_wait = Some(on_wait);
        let mut wait = || on_wait.take().map_or((), |on_wait| on_wait());
        let mut held = self.held();
        while held.contains_key(&byte) {
            drop(held);
            wait();
            held = self.held();
            if held.contains_key(&byte) {
                self.waiting.fetch_add(1, Ordering::Relaxed);
                held = self.released.wait(held).unwrap_or_else(PoisonError::into_inner);
                self.waiting.fetch_sub(1, Ordering::Relaxed);
            }
        }
        held.insert(byte, Held::Key);
        drop(held);
        // From here on the byte is this lock's within the process; if the system refuses it, dropping gives it back.
        let lock = KeyLock { bytes: Arc::clone(self), byte, claim: None };
        if !self.set(&flock(byte, libc::F_WRLCK))? {
            wait();
            self.wait_for(byte)?;
        }
        while !self.lease(byte)? {
            wait();
            std::thread::sleep(LEASE_POLL);
        }
        Ok(lock)
    }

    /// Takes the lease of a byte that is locked on this machine; where one machine uses the store there is none to take.
    fn lease(&self, byte: i64) -> Result<bool, StoreError> {
        self.leases.as_ref().map_or(Ok(true), |leases| leases.take(byte))
    }

    /// Takes the lock of `key` unless it is held elsewhere.
    pub(crate) fn try_lock(self: &Arc<Self>, key: &Digest) -> Result<Option<KeyLock>, StoreError> {
        let byte = byte_of(key);
        match self.held().entry(byte) {
            Entry::Occupied(_) => return Ok(None),
            Entry::Vacant(free) => free.insert(Held::Key),
        };
        // From here on the byte is this lock's within the process; dropping it gives the byte back.
        let lock = KeyLock { bytes: Arc::clone(self), byte, claim: None };
        Ok((self.set(&flock(byte, libc::F_WRLCK))? && self.lease(byte)?).then_some(lock))
    }

    /// Lets other processes see `name`; any number of them may announce the same.
    pub(crate) fn announce(self: &Arc<Self>, name: &Digest) -> Result<Announced, StoreError> {
        let byte = byte_of(name);
        let mut held = self.held();
        let count = if let Some(Held::Announced(count)) = held.get(&byte) {
            *count
        } else {
            // Nobody locks the byte of a name against announcements of it.
            self.set(&flock(byte, libc::F_RDLCK))?;
            self.leases.as_ref().map_or(Ok(()), |leases| leases.announce(byte))?;
            0
        };
        held.insert(byte, Held::Announced(count + 1));
        let byte = KeyLock { bytes: Arc::clone(self), byte, claim: None };
        Ok(Announced { _byte: byte, _below: None })
    }

    /// Whether another process, or another handle in this one, announces `name`.
    pub(crate) fn is_announced_elsewhere(&self, name: &Digest) -> Result<bool, StoreError> {
        let byte = byte_of(name);
        let mut asked = flock(byte, libc::F_WRLCK);
        self.fcntl(FcntlArg::F_OFD_GETLK(&mut asked))?;
        let is_here = i32::from(asked.l_type) != i32::from(libc::F_UNLCK as libc::c_short);
        let elsewhere = || self.leases.as_ref().map_or(Ok(false), |leases| leases.is_announced_elsewhere(byte));
        if is_here { Ok(true) } else { elsewhere() }
    }

    fn held(&self) -> MutexGuard<'_, HashMap<i64, Held>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn release(&self, byte: i64) {
        // It cannot fail for a byte that is locked; the end of the process releases it in any case.
        let unlock = || drop(self.set(&flock(byte, libc::F_UNLCK)));
        let mut held = self.held();
        match held.get_mut(&byte) {
            Some(Held::Announced(count)) if *count > 1 => {
                *count -= 1;
                return;
            }
            Some(Held::Announced(_)) => {
                self.leases.iter().for_each(|leases| leases.withdraw(byte));
                unlock();
            }
            _ => {
                // Others need not wait for the system: until it is unlocked the byte is held.
                drop(held);
                self.leases.iter().for_each(|leases| leases.release(byte));
                unlock();
                held = self.held();
            }
        }
        held.remove(&byte);
        if self.waiting.load(Ordering::Relaxed) > 0 {
            self.released.notify_all();
        }
    }

    /// Sets a lock; false where another process is in the way.
    fn set(&self, lock: &libc::flock) -> Result<bool, StoreError> {
        self.fcntl(FcntlArg::F_OFD_SETLK(lock))
    }

    fn wait_for(&self, byte: i64) -> Result<(), StoreError> {
        self.fcntl(FcntlArg::F_OFD_SETLKW(&flock(byte, libc::F_WRLCK))).map(|_| ())
    }

    fn fcntl(&self, mut call: FcntlArg) -> Result<bool, StoreError> {
        let file = self.file()?;
        loop {
            // Taken apart and put together: an interrupted call is repeated.
            let done = match &mut call {
                FcntlArg::F_OFD_GETLK(lock) => fcntl(file, FcntlArg::F_OFD_GETLK(lock)),
                FcntlArg::F_OFD_SETLK(lock) => fcntl(file, FcntlArg::F_OFD_SETLK(lock)),
                FcntlArg::F_OFD_SETLKW(lock) => fcntl(file, FcntlArg::F_OFD_SETLKW(lock)),
                _ => Err(Errno::EINVAL),
            };
            match done {
                Ok(_) => return Ok(true),
                Err(Errno::EAGAIN | Errno::EACCES) => return Ok(false),
                Err(Errno::EINTR) => {}
                Err(fault) => return Err(StoreError::io("lock", &self.path, fault.into())),
            }
        }
    }

    fn file(&self) -> Result<&File, StoreError> {
        if let Some(file) = self.file.get() {
            return Ok(file);
        }
        let sharing = Sharing::of(self.path.parent().unwrap_or(&self.path));
        let opened = sharing.open_or_make(&self.path).at("open", &self.path)?;
        // Another thread may have been first; then its opening counts.
        Ok(self.file.get_or_init(|| opened))
    }
}

/// The number of the byte that stands for `key`.
fn byte_of(key: &Digest) -> i64 {
    let [a, b, c, d, e, f, g, h, ..] = *key.as_bytes();
    // A file has 2^63 bytes at most.
    i64::from_le_bytes([a, b, c, d, e, f, g, h]) & (i64::MAX >> 1)
}

/// One byte and what is to be done with it.
fn flock(byte: i64, what: libc::c_int) -> libc::flock {
    libc::flock {
        l_type: what as libc::c_short,
        l_whence: libc::SEEK_SET as libc::c_short,
        l_start: byte,
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
    let held = plain::open(path).ok().and_then(|file| abandoned(file, path));
    if held.is_some() {
        let _ = std::fs::remove_file(path);
    }
}

/// This file, locked, if nobody else holds its lock and it is still at `path`.
pub(crate) fn abandoned(file: File, path: &Path) -> Option<Locked> {
    Locked::try_new(file).ok().flatten().filter(|file| is_at(file, path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;

    fn bytes(folder: &tempfile::TempDir) -> Arc<Bytes> {
        Bytes::new(folder.path().join("keys"), None)
    }

    #[test]
    fn a_held_key_is_refused_then_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other, key) = (bytes(&folder), bytes(&folder), Digest::of(b"key"));
        // In the same process through the same opening, and through another as another process would.
        for second in [&one, &other] {
            let held = one.try_lock(&key).unwrap().unwrap();
            assert!(second.try_lock(&key).unwrap().is_none());
            assert!(second.try_lock(&Digest::of(b"other")).unwrap().is_some());
            let (waiting, waits) = std::sync::mpsc::channel();
            std::thread::scope(|scope| {
                let waiter = scope.spawn(|| drop(second.lock(&key, || waiting.send(()).unwrap()).unwrap()));
                waits.recv().unwrap();
                assert!(!waiter.is_finished());
                drop(held);
            });
            assert!(second.try_lock(&key).unwrap().is_some(), "who waited has released it");
        }
        assert_eq!(one.path.metadata().unwrap().len(), 0, "nothing is ever written");
    }

    #[test]
    fn one_holder_at_a_time_however_many_contend() {
        let folder = tempfile::tempdir().unwrap();
        let shared = bytes(&folder);
        let (inside, entered) = (AtomicU32::new(0), AtomicU32::new(0));
        std::thread::scope(|scope| {
            for contender in 0..8 {
                let bytes = if contender < 4 { Arc::clone(&shared) } else { bytes(&folder) };
                let (inside, entered) = (&inside, &entered);
                scope.spawn(move || {
                    for _ in 0..50 {
                        let _held = bytes.lock(&Digest::of(b"key"), || ()).unwrap();
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
        let (one, other) = (bytes(&folder), bytes(&folder));
        for raw in [[0; 32], [0xff; 32], [0x80; 32]] {
            let key = Digest::from_bytes(raw);
            let held = one.try_lock(&key).unwrap();
            assert!(held.is_some() && other.try_lock(&key).unwrap().is_none(), "{key}");
        }
    }

    #[test]
    fn what_is_released_is_free_though_a_program_that_starts_has_a_copy_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other, key) = (bytes(&folder), bytes(&folder), Digest::of(b"key"));
        let held = one.try_lock(&key).unwrap();
        // What a child has between its fork and the program that it becomes.
        let copy = one.file().unwrap().try_clone().unwrap();
        drop((held, one));
        assert!(other.try_lock(&key).unwrap().is_some());
        drop(copy);
        let path = folder.path().join("file");
        let locked = Locked::try_new(File::create(&path).unwrap()).unwrap().unwrap();
        let copy = locked.try_clone().unwrap();
        drop(locked);
        assert!(abandoned(File::open(&path).unwrap(), &path).is_some());
        drop(copy);
    }

    #[test]
    fn an_announcement_is_seen_by_others_until_the_last_of_it_is_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other, name) = (bytes(&folder), bytes(&folder), Digest::of(b"value"));
        let seen = |by: &Bytes| by.is_announced_elsewhere(&name).unwrap();
        let (first, second) = (one.announce(&name).unwrap(), one.announce(&name).unwrap());
        assert!(seen(&other) && !seen(&one));
        let third = other.announce(&name).unwrap();
        drop(first);
        assert!(seen(&other) && seen(&one));
        drop((second, third));
        assert!(!seen(&other) && !seen(&one));
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
