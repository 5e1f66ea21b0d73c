//! Leases between machines: a step that is being computed has a file, which is another name of the file of its worker.
//!
//! The name is given to one who asks for it and refused to all others, on network file systems too (`link`). All leases of a
//! worker are one file, so that one touch every five seconds keeps all of them. A lease is taken over when its worker is
//! dead: on this machine the kernel tells, since the worker would hold the lock of the key; of another machine when it gave
//! no sign of life for a minute. Both times come from the clock of the file system, so the clocks of machines do not matter.

use std::fs;
use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use crate::error::{At, StoreError};
use crate::machine::Machine;
use crate::open::LEASES;
use crate::plain;
use crate::workers::{EXPIRY, Worker, content, list};

/// Starts the names of announcements.
const HAVE: &str = "have-";
/// Ends the name of the right to take a lease over.
const TAKEOVER: &str = ".takeover";
/// Leases of workers that died so long ago are nobody's.
const LONG_AGO: Duration = Duration::from_hours(24);

/// The leases on a store that several machines use.
#[derive(Debug)]
pub(crate) struct Leases {
    machine: Arc<Machine>,
    folder: PathBuf,
}

impl Leases {
    /// Those of the store at `root`.
    pub fn new(root: &Path, machine: Arc<Machine>) -> Self {
        Self { machine, folder: root.join(LEASES) }
    }

    fn path(&self, byte: i64) -> PathBuf {
        self.folder.join(format!("{byte:016x}"))
    }

    /// Takes a lease unless a live worker has it. Whoever asks holds the lock of the key among the processes of this machine.
    pub fn take(&self, byte: i64) -> Result<bool, StoreError> {
        let (worker, lease) = (self.machine.worker()?, self.path(byte));
        for _ in 0..3 {
            match fs::hard_link(worker.path(), &lease) {
                Ok(()) => return Ok(true),
                Err(fault) if fault.kind() == ErrorKind::AlreadyExists => {}
                fault => fault.at("make a lease", &lease)?,
            }
            match self.holder(&worker, &lease).at("look at a lease", &lease)? {
                // It was released since.
                Holder::Nobody => {}
                Holder::This => return Ok(true),
                Holder::Alive => return Ok(false),
                Holder::Dead(inode) => {
                    return self.take_over(&worker, &lease, inode).at("take over a lease", &lease);
                }
            }
        }
        Ok(false)
    }

    fn holder(&self, worker: &Worker, lease: &Path) -> io::Result<Holder> {
        // Opened, and not merely looked at: network file systems ask their server only then.
        let mut file = match plain::open(lease) {
            Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(Holder::Nobody),
            file => file?,
        };
        let meta = file.metadata()?;
        if meta.ino() == worker.inode()? {
            return Ok(Holder::This);
        }
        let is_ours = content(&mut file).is_some_and(|(machine, _)| machine == self.machine.name());
        let age = worker.clock()?.duration_since(meta.modified()?).unwrap_or_default();
        Ok(if is_ours || age > EXPIRY { Holder::Dead(meta.ino()) } else { Holder::Alive })
    }

    /// Takes the lease of a dead worker over. Of several who try, one may: who has the right to looks once more and replaces
    /// the lease in one step.
    fn take_over(&self, worker: &Worker, lease: &Path, dead: u64) -> io::Result<bool> {
        let right = lease.with_extension(&TAKEOVER[1..]);
        match fs::hard_link(worker.path(), &right) {
            Err(fault) if fault.kind() == ErrorKind::AlreadyExists => {
                // Whoever took it died within a moment; it is free for the next attempt.
                if matches!(self.holder(worker, &right)?, Holder::Dead(_)) {
                    let _ = fs::remove_file(&right);
                }
                return Ok(false);
            }
            linked => linked?,
        }
        let taken = self.replace(worker, lease, dead);
        fs::remove_file(&right)?;
        taken
    }

    fn replace(&self, worker: &Worker, lease: &Path, dead: u64) -> io::Result<bool> {
        if !matches!(self.holder(worker, lease)?, Holder::Dead(inode) if inode == dead) {
            return Ok(false);
        }
        let new = lease.with_extension(format!("new-{}", worker.name()));
        fs::hard_link(worker.path(), &new)?;
        fs::rename(&new, lease)?;
        Ok(true)
    }

    /// Gives a lease back.
    pub fn release(&self, byte: i64) {
        let lease = self.path(byte);
        let is_own = || Some(fs::symlink_metadata(&lease).ok()?.ino() == self.machine.worker_if_begun()?.inode().ok()?);
        if is_own() == Some(true) {
            // It may have been taken over by somebody who thought this process dead.
            let _ = fs::remove_file(&lease);
        }
    }

    fn announcement(&self, byte: i64, worker: &str) -> PathBuf {
        self.folder.join(format!("{HAVE}{byte:016x}.{worker}"))
    }

    /// Lets other machines see that this process has the value of a byte of `keys.lock`.
    pub fn announce(&self, byte: i64) -> Result<(), StoreError> {
        let worker = self.machine.worker()?;
        let path = self.announcement(byte, &worker.name());
        match fs::hard_link(worker.path(), &path) {
            Err(fault) if fault.kind() == ErrorKind::AlreadyExists => Ok(()),
            linked => linked.at("write", &path),
        }
    }

    /// Withdraws the announcement of a byte.
    pub fn withdraw(&self, byte: i64) {
        if let Some(worker) = self.machine.worker_if_begun() {
            let _ = fs::remove_file(self.announcement(byte, &worker.name()));
        }
    }

    /// Whether a live process of another machine announces something.
    pub fn is_announced_elsewhere(&self, byte: i64) -> Result<bool, StoreError> {
        let worker = self.machine.worker()?;
        let now = worker.clock().at("use", worker.path())?;
        let root = self.folder.parent().unwrap_or(&self.folder);
        let others = list(root)?.into_iter().filter(|other| other.machine != self.machine.name());
        let is_there = |path: PathBuf| {
            let modified = plain::open(&path).ok()?.metadata().ok()?.modified().ok()?;
            Some(now.duration_since(modified).unwrap_or_default() < EXPIRY)
        };
        Ok(others.map(|other| self.announcement(byte, &other.name)).any(|path| is_there(path) == Some(true)))
    }
}

/// Who has a lease.
enum Holder {
    Nobody,
    This,
    Alive,
    /// The inode of its file.
    Dead(u64),
}

/// Removes the leases of workers of this machine that have died, and of those that died long ago.
pub(crate) fn sweep(root: &Path, machine: &str) {
    for entry in fs::read_dir(root.join(LEASES)).into_iter().flatten().flatten() {
        let path = entry.path();
        let Some(mut file) = plain::open(&path).ok() else { continue };
        let is_ours = content(&mut file).is_none_or(|(owner, _)| owner == machine);
        let silent = file.metadata().and_then(|meta| meta.modified()).ok().and_then(|at| at.elapsed().ok());
        let is_old = silent.is_some_and(|silent| silent > LONG_AGO);
        // The file of a worker that lives is locked.
        let is_free = file.try_lock().is_ok();
        if is_free && (is_ours || is_old) {
            let _ = fs::remove_file(&path);
        }
        let _ = file.unlock();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::SystemTime;

    const BYTE: i64 = 0x1234;

    /// A process of a machine on a store that several use.
    fn process(root: &Path, machine: &str) -> (Arc<Machine>, Leases) {
        let machine = Arc::new(Machine::named(root, machine));
        (Arc::clone(&machine), Leases::new(root, machine))
    }

    fn place() -> tempfile::TempDir {
        let place = tempfile::tempdir().unwrap();
        fs::create_dir(place.path().join("workers")).unwrap();
        fs::create_dir(place.path().join(LEASES)).unwrap();
        place
    }

    fn age(machine: &Machine, by: Duration) {
        let file = fs::File::options().write(true).open(machine.worker().unwrap().path()).unwrap();
        file.set_modified(SystemTime::now() - by).unwrap();
    }

    #[test]
    fn a_lease_has_one_holder_and_is_free_when_it_is_given_back() {
        let place = place();
        let (_one_machine, one) = process(place.path(), "one");
        let (_other_machine, other) = process(place.path(), "other");
        assert!(one.take(BYTE).unwrap() && !other.take(BYTE).unwrap() && other.take(BYTE + 1).unwrap());
        other.release(BYTE);
        assert!(!other.take(BYTE).unwrap(), "what is another's is not given back");
        one.release(BYTE);
        assert!(other.take(BYTE).unwrap() && !one.take(BYTE).unwrap());
    }

    #[test]
    fn the_lease_of_a_worker_that_gave_no_sign_is_taken_over_by_one() {
        let place = place();
        let (dead_machine, dead) = process(place.path(), "dead");
        assert!(dead.take(BYTE).unwrap());
        let others: Vec<_> = (0..8).map(|number| process(place.path(), &format!("m{number}"))).collect();
        assert!(others.iter().all(|(_, other)| !other.take(BYTE).unwrap()));
        age(&dead_machine, Duration::from_mins(2));
        let won = std::sync::atomic::AtomicU32::new(0);
        std::thread::scope(|scope| {
            for (_, other) in &others {
                scope.spawn(|| {
                    won.fetch_add(u32::from(other.take(BYTE).unwrap()), std::sync::atomic::Ordering::Relaxed)
                });
            }
        });
        let holders = || others.iter().filter(|(_, other)| other.take(BYTE).unwrap()).count();
        assert_eq!((won.into_inner(), holders()), (1, 1));
        dead.release(BYTE);
        assert_eq!(holders(), 1, "the dead that lives after all takes nothing back");
        let left = fs::read_dir(place.path().join(LEASES)).unwrap().count();
        assert_eq!(left, 1, "nothing else is left over");
    }

    #[test]
    fn a_lease_that_another_process_of_this_machine_left_is_free() {
        let place = place();
        let (_dead_machine, dead) = process(place.path(), "one");
        assert!(dead.take(BYTE).unwrap());
        let (_machine, next) = process(place.path(), "one");
        assert!(next.take(BYTE).unwrap(), "the lock of the key says that it is dead");
    }

    #[test]
    fn an_announcement_is_seen_by_other_machines_as_long_as_its_worker_lives() {
        let place = place();
        let (one_machine, one) = process(place.path(), "one");
        let (_other_machine, other) = process(place.path(), "other");
        one.announce(BYTE).unwrap();
        assert!(other.is_announced_elsewhere(BYTE).unwrap() && !one.is_announced_elsewhere(BYTE).unwrap());
        age(&one_machine, Duration::from_mins(2));
        assert!(!other.is_announced_elsewhere(BYTE).unwrap());
        one_machine.worker().unwrap().clock().unwrap();
        assert!(other.is_announced_elsewhere(BYTE).unwrap());
        one.withdraw(BYTE);
        assert!(!other.is_announced_elsewhere(BYTE).unwrap());
    }
}
