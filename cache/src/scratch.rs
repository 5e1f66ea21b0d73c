//! Folders for programs to work in: gone when they are done, or when the store is next opened after the process died; and
//! with them whatever programs still run there.

use std::fs::{self, Permissions};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rustix::process::{Pid, Signal, getpid, kill_process};
use tempfile::NamedTempFile;

use crate::error::{At, StoreError};
use crate::locks::abandoned;
use crate::open::SCRATCH;
use crate::sharing::{FILE, Sharing};
use crate::values::ROOM;
use crate::{Store, plain};

/// Ends the name of the file that is locked as long as the folder beside it is used.
const LOCK: &str = ".lock";
/// Starts the names of the folders in which programs run.
const PROGRAMS: &str = "run-";

/// A folder of its own for one program, removed with all that is in it when this is dropped.
///
/// A program that has `TMPDIR` in its environment with [`Scratch::temporary`] for a value is known by that, and so are all
/// that it starts: they are ended before the folder goes, also where the process that started them was killed.
#[derive(Debug)]
pub struct Scratch {
    folder: PathBuf,
    /// Removed after the folder.
    lock: Option<NamedTempFile>,
    /// Programs may still run there when it goes.
    for_programs: bool,
}

impl Scratch {
    /// The absolute path of the folder.
    pub fn path(&self) -> &Path {
        &self.folder
    }

    /// Leaves everything as a kill would: nothing is removed, the lock ends.
    #[cfg(test)]
    pub(crate) fn abandon(self) {
        self.lock.as_ref().unwrap().as_file().unlock().unwrap();
        std::mem::forget(self);
    }

    /// Where programs are to put what is temporary, absolute; not made yet.
    pub fn temporary(&self) -> PathBuf {
        temporary(&self.folder)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        clear(&self.folder, self.for_programs);
        let lock = self.lock.take();
        if !plain::is_absent(&self.folder)
            && let Some(Ok((file, _))) = lock.map(NamedTempFile::keep)
        {
            // What cannot be removed now is swept up when the store is next opened; until then its lock tells whose it is.
            let _ = file.unlock();
        }
    }
}

impl Store {
    /// An empty folder in the store that nobody else uses, for a program to work in.
    pub fn scratch(&self) -> Result<Scratch, StoreError> {
        self.scratch_named(PROGRAMS, true)
    }

    /// An empty folder that is known by how its name begins.
    pub(crate) fn scratch_named(&self, prefix: &str, for_programs: bool) -> Result<Scratch, StoreError> {
        let (root, sharing) = (self.machine().folder(SCRATCH), Sharing::of(self.dir()));
        loop {
            let mut builder = tempfile::Builder::new();
            builder.permissions(sharing.permissions());
            let lock = builder.prefix(prefix).suffix(LOCK).tempfile_in(&root).at("write into", &root)?;
            sharing.give(lock.as_file(), FILE).at("set the mode of", lock.path())?;
            lock.as_file().lock().at("lock a file in", &root)?;
            // Swept up between its making and its locking? Then make another.
            if crate::segment::is_at(lock.as_file(), lock.path()) {
                let folder = lock.path().with_extension("");
                sharing.new_folder(&folder).at("make the folder", &folder)?;
                return Ok(Scratch { folder, lock: Some(lock), for_programs });
            }
        }
    }
}

/// Removes the folders in `root` whose process is gone, and those whose lock has gone before them.
pub(crate) fn sweep(root: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(root).at("list", root)? {
        let path = entry.at("list", root)?.path();
        let Some(name) = path.file_name().and_then(|name| name.to_str()) else { continue };
        let for_programs = name.starts_with(PROGRAMS);
        if !for_programs && !name.starts_with(ROOM) {
            continue;
        }
        if name.ends_with(LOCK) {
            sweep_locked(&path, for_programs);
        } else if plain::is_folder(&path) && plain::is_absent(&lock_of(&path)) {
            // A folder is made after its lock and removed before it: without one, it is left from a sweep that failed.
            clear(&path, for_programs);
        }
    }
    Ok(())
}

fn sweep_locked(lock: &Path, for_programs: bool) {
    let Some(_held) = plain::open(lock).ok().and_then(|file| abandoned(file, lock)) else { return };
    let folder = lock.with_extension("");
    clear(&folder, for_programs);
    // What is left of the folder would be nobody's without its lock.
    if plain::is_absent(&folder) {
        let _ = fs::remove_file(lock);
    }
}

fn lock_of(folder: &Path) -> PathBuf {
    folder.with_extension(&LOCK[1..])
}

/// Removes what can be removed of a folder, after ending its programs if it may have some.
fn clear(folder: &Path, for_programs: bool) {
    if for_programs {
        std::path::absolute(folder).iter().for_each(|folder| end_programs(folder));
    }
    // A link that somebody put there may lead anywhere: it goes, what it leads to stays.
    if !plain::is_folder(folder) {
        let _ = fs::remove_file(folder);
        return;
    }
    if fs::remove_dir_all(folder).is_err() {
        // A program may have made folders in which nothing can be removed.
        open_up(folder);
        let _ = fs::remove_dir_all(folder);
    }
}

/// Lets this user write to a folder and to all folders in it that belong to this user.
fn open_up(folder: &Path) {
    let _ = fs::set_permissions(folder, Permissions::from_mode(0o700));
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.filter(|path| plain::is_folder(path)).for_each(|path| open_up(&path));
}

fn temporary(folder: &Path) -> PathBuf {
    folder.join("tmp")
}

/// Ends the programs of this folder that still run. Those of other users, and systems that do not tell, are left alone.
fn end_programs(folder: &Path) {
    let variable = [b"TMPDIR=", temporary(folder).as_os_str().as_bytes()].concat();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        let pid = entry.file_name().to_str().and_then(|name| name.parse().ok()).and_then(Pid::from_raw);
        let Some(pid) = pid.filter(|pid| *pid != getpid()) else { continue };
        let environment = fs::read(entry.path().join("environ")).unwrap_or_default();
        if environment.split(|byte| *byte == 0).any(|one| one == variable) {
            // It may have ended meanwhile.
            let _ = kill_process(pid, Signal::KILL);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;

    #[test]
    fn programs_end_with_their_folder_and_others_do_not() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let store = Store::open(&dir).unwrap();
        let sleep = |scratch: &Scratch| {
            let mut command = std::process::Command::new("sleep");
            let started = command.arg("60").env("TMPDIR", scratch.temporary()).spawn().unwrap();
            // For a moment after its start a program has no environment that others see.
            let environment = format!("/proc/{}/environ", started.id());
            while fs::read(&environment).is_ok_and(|variables| variables.is_empty()) {
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            started
        };
        let (done, dead, used) = (store.scratch().unwrap(), store.scratch().unwrap(), store.scratch().unwrap());
        let [mut of_done, mut of_dead, mut of_used] = [&done, &dead, &used].map(sleep);
        drop(done);
        assert_eq!(of_done.wait().unwrap().signal(), Some(9));
        dead.abandon();
        drop(Store::open(&dir).unwrap());
        assert_eq!(of_dead.wait().unwrap().signal(), Some(9));
        assert!(of_used.try_wait().unwrap().is_none(), "it goes on");
        drop(used);
        of_used.wait().unwrap();
    }

    #[test]
    fn what_a_link_in_the_place_of_a_folder_leads_to_stays_as_it_is() {
        let place = tempfile::tempdir().unwrap();
        let (root, home) = (place.path().join("scratch"), place.path().join("home"));
        fs::create_dir_all(&root).unwrap();
        fs::create_dir_all(home.join("group")).unwrap();
        fs::set_permissions(home.join("group"), Permissions::from_mode(0o750)).unwrap();
        let link = root.join(format!("{PROGRAMS}a"));
        fs::write(lock_of(&link), "").unwrap();
        std::os::unix::fs::symlink(&home, &link).unwrap();
        // Also where the link cannot be removed, which root always can.
        fs::set_permissions(&root, Permissions::from_mode(0o555)).unwrap();
        sweep(&root).unwrap();
        fs::set_permissions(&root, Permissions::from_mode(0o755)).unwrap();
        sweep(&root).unwrap();
        let mode = std::os::unix::fs::MetadataExt::mode(&fs::metadata(home.join("group")).unwrap());
        assert_eq!((mode & 0o777, link.exists()), (0o750, false));
    }

    #[test]
    fn a_folder_lives_as_long_as_its_owner_and_no_longer_than_the_next_opening() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let store = Store::open(&dir).unwrap();
        let scratch = store.scratch().unwrap();
        fs::write(scratch.path().join("half"), "half").unwrap();
        let dead = store.scratch().unwrap();
        let left = dead.path().to_owned();
        let (folder, lock) = (left.clone(), left.with_extension(&LOCK[1..]));
        dead.abandon();
        drop(Store::open(&dir).unwrap());
        assert!(!folder.exists() && !lock.exists(), "what the dead left is swept up");
        assert!(scratch.path().join("half").exists(), "what is in use stays");
        let used = scratch.path().to_owned();
        drop(scratch);
        assert!(!used.exists());
        assert_eq!(fs::read_dir(dir.join(SCRATCH)).unwrap().count(), 0);
    }

    #[test]
    fn folders_without_their_locks_go_and_what_is_not_of_a_store_stays() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let used = Store::open(&dir).unwrap().scratch().unwrap();
        let at = |name: &str| dir.join(SCRATCH).join(name);
        for folder in ["run-left/out/sealed", "mine"] {
            fs::create_dir_all(at(folder)).unwrap();
        }
        fs::write(at("run-left/out/sealed/file"), "half").unwrap();
        fs::set_permissions(at("run-left/out/sealed"), Permissions::from_mode(0o500)).unwrap();
        fs::write(at("mine.lock"), "").unwrap();
        drop(Store::open(&dir).unwrap());
        assert!(!at("run-left").exists(), "nobody has it, though nothing could be removed from a folder in it");
        assert!(used.path().exists() && at("mine").exists() && at("mine.lock").exists());
    }
}
