//! Workers: the processes that run something on a store. Each has a file, locked as long as it lives, that says who it is and
//! what it last reported; on a store that several machines use it is touched every few seconds.

use std::fs::{self, File};
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use rustix::fs::{Timespec, Timestamps, UTIME_NOW, UTIME_OMIT, futimens};

use crate::error::{At, StoreError};
use crate::locks::abandoned;
use crate::open::WORKERS;
use crate::sharing::Sharing;
use crate::{Store, plain};

/// How often a worker gives a sign of life on a store that several machines use.
const BEAT: Duration = Duration::from_secs(5);
/// A worker of another machine that gave none for so long is taken for dead.
pub(crate) const EXPIRY: Duration = Duration::from_mins(1);
/// Starts every file of a worker, before its machine.
const HEAD: &str = "rockface worker ";
/// No report is longer, bytes.
const REPORT_LIMIT: u64 = 1 << 20;

/// The entry of this process among the workers; gone when it is dropped.
#[derive(Debug)]
pub(crate) struct Worker {
    file: tempfile::NamedTempFile,
    head: String,
    beat: Option<Beat>,
}

/// The thread that gives signs of life.
#[derive(Debug)]
struct Beat {
    end: Arc<(Mutex<bool>, Condvar)>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// What is known of a worker.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkerReport {
    /// The name of its file.
    pub name: String,
    /// The name of the machine it runs on.
    pub machine: String,
    /// What it last reported.
    pub text: String,
    /// Whether it lives: its file is locked, or it is one of another machine and gave a sign of life lately.
    pub is_live: bool,
    /// The time since its last sign of life or report, by the clock of this machine.
    pub silent: Duration,
}

impl Worker {
    /// Makes this process one, with signs of life if it `beats`.
    pub fn begin(root: &Path, machine: &str, beats: bool) -> Result<Self, StoreError> {
        // Made here and not when the store is opened: one of a former version that can only be read has none.
        let folder = root.join(WORKERS);
        let sharing = Sharing::of(root);
        plain::folder(&folder, sharing)?;
        let file = loop {
            let mut builder = tempfile::Builder::new();
            builder.permissions(sharing.permissions());
            let file = builder.prefix(&format!("{machine}-{}-", std::process::id())).tempfile_in(&folder);
            let file = file.at("write into", &folder)?;
            sharing.give(file.as_file(), 0o644).at("set the mode of", file.path())?;
            file.as_file().lock().at("lock a file in", &folder)?;
            // Swept up between its making and its locking? Then make another.
            if crate::segment::is_at(file.as_file(), file.path()) {
                break file;
            }
        };
        let head = format!("{HEAD}{machine}\n");
        file.as_file().write_all_at(head.as_bytes()).at("write", file.path())?;
        let beat = beats.then(|| Beat::start(file.as_file())).transpose().at("use", file.path())?;
        Ok(Self { file, head, beat })
    }

    /// Its file, of which leases are further names.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// The name of its file.
    pub fn name(&self) -> String {
        self.path().file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// The inode of its file.
    pub fn inode(&self) -> std::io::Result<u64> {
        Ok(self.file.as_file().metadata()?.ino())
    }

    /// The time now by the clock of the file system, which gives all leases their times: no other clock is compared with them.
    pub fn clock(&self) -> std::io::Result<SystemTime> {
        touch(self.file.as_file())?;
        self.file.as_file().metadata()?.modified()
    }

    /// Replaces what it reports.
    fn report(&self, text: &str) -> std::io::Result<()> {
        let whole = format!("{}{text}", self.head);
        // A reader may see half of it, and looks again a moment later.
        self.file.as_file().write_all_at(whole.as_bytes())?;
        self.file.as_file().set_len(whole.len() as u64)
    }
}

trait WriteAt {
    fn write_all_at(&self, bytes: &[u8]) -> std::io::Result<()>;
}

impl WriteAt for File {
    fn write_all_at(&self, bytes: &[u8]) -> std::io::Result<()> {
        std::os::unix::fs::FileExt::write_all_at(self, bytes, 0)
    }
}

/// Sets the time of a file to that of its file system.
fn touch(file: &File) -> std::io::Result<()> {
    let time = |nanoseconds| Timespec { tv_sec: 0, tv_nsec: nanoseconds };
    let times = Timestamps { last_access: time(UTIME_OMIT as _), last_modification: time(UTIME_NOW as _) };
    Ok(futimens(file, &times)?)
}

impl Beat {
    fn start(file: &File) -> std::io::Result<Self> {
        let end = Arc::new((Mutex::new(false), Condvar::new()));
        let (own, file) = (Arc::clone(&end), file.try_clone()?);
        let beat = move || {
            let (is_over, over) = &*own;
            let mut guard = is_over.lock().unwrap_or_else(PoisonError::into_inner);
            while !*guard {
                // Where it fails now, the next may not.
                let _ = touch(&file);
                guard = over.wait_timeout(guard, BEAT).unwrap_or_else(PoisonError::into_inner).0;
            }
        };
        let thread = std::thread::Builder::new().name("beat".to_owned()).spawn(beat)?;
        Ok(Self { end, thread: Some(thread) })
    }
}

impl Drop for Beat {
    fn drop(&mut self) {
        *self.end.0.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.end.1.notify_all();
        self.thread.take().map(std::thread::JoinHandle::join);
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.beat = None;
        // A program that is being started has a copy of the file, which would hold the lock on.
        let _ = self.file.as_file().unlock();
    }
}

impl Store {
    /// Lets whoever watches see how far this process is, in words of the caller's.
    pub fn report(&self, text: &str) -> Result<(), StoreError> {
        let worker = self.machine().worker()?;
        worker.report(text).at("write", worker.path())
    }

    /// The processes that run something on the store at `dir`, by their names. Nothing is made or changed there.
    ///
    /// # Errors
    ///
    /// When it cannot be seen who is there.
    pub fn workers(dir: &Path) -> Result<Vec<WorkerReport>, StoreError> {
        list(dir)
    }
}

/// All workers of the store at `root`; none where nothing ever ran.
pub(crate) fn list(root: &Path) -> Result<Vec<WorkerReport>, StoreError> {
    let folder = root.join(WORKERS);
    let entries = match fs::read_dir(&folder) {
        Err(fault) if fault.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.at("list", &folder)?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.at("list", &folder)?.path();
        match plain::settled(|| plain::open(&path)) {
            Err(fault) if fault.kind() == ErrorKind::PermissionDenied => {
                return Err(StoreError::io("open", &path, fault));
            }
            // Gone since it was listed, or nothing that a process made.
            Err(_) => {}
            Ok(file) => found.extend(read(file, &path)),
        }
    }
    found.sort_by(|one: &WorkerReport, other| one.name.cmp(&other.name));
    Ok(found)
}

fn read(mut file: File, path: &Path) -> Option<WorkerReport> {
    let (machine, text) = content(&mut file)?;
    let modified = file.metadata().ok()?.modified().ok()?;
    let silent = SystemTime::now().duration_since(modified).unwrap_or_default();
    // Looked at through another opening: a lock of this one would be in the way of who asks next.
    let is_locked = plain::open(path).is_ok_and(|file| abandoned(file, path).is_none());
    let name = path.file_name()?.to_str()?.to_owned();
    let is_live = is_locked || (silent < EXPIRY && machine != crate::machine::Machine::on(path).name());
    Some(WorkerReport { name, machine, text, is_live, silent })
}

/// The machine that the file of a worker, or a lease of it, names, and its report.
pub(crate) fn content(file: &mut File) -> Option<(String, String)> {
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(0)).ok()?;
    file.take(REPORT_LIMIT).read_to_end(&mut bytes).ok()?;
    let text = String::from_utf8(bytes).ok()?;
    let (machine, report) = text.strip_prefix(HEAD)?.split_once('\n')?;
    Some((machine.to_owned(), report.to_owned()))
}

/// Removes the files of workers of this machine that have died, and of those of others that died long ago.
pub(crate) fn sweep(root: &Path, machine: &str, is_shared: bool) {
    const LONG_AGO: Duration = Duration::from_hours(24);
    // What cannot be looked at now is left for another time.
    for worker in list(root).unwrap_or_default() {
        // The lock shows which workers of this machine live, and all where one machine uses the store.
        let is_ours = worker.machine == machine || !is_shared;
        if is_ours || (!worker.is_live && worker.silent > LONG_AGO) {
            let path: PathBuf = root.join(WORKERS).join(&worker.name);
            let held = plain::open(&path).ok().and_then(|file| abandoned(file, &path));
            if held.is_some() {
                let _ = fs::remove_file(&path);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_is_seen_with_its_last_report_as_long_as_it_lives() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let store = Store::open(&dir).unwrap();
        assert_eq!(Store::workers(&dir).unwrap(), []);
        store.report("a long report").unwrap();
        store.report("short").unwrap();
        let seen = Store::workers(&dir).unwrap();
        assert!(seen.len() == 1 && seen[0].is_live && seen[0].text == "short", "{seen:?}");
        drop(store);
        assert_eq!(Store::workers(&dir).unwrap(), []);
    }

    #[test]
    fn the_file_of_a_worker_that_was_killed_goes_when_the_store_is_next_opened() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let store = Store::open(&dir).unwrap();
        store.report("alive").unwrap();
        let left = dir.join(WORKERS).join("dead-1-x");
        fs::write(&left, format!("{HEAD}dead\nwas here")).unwrap();
        let seen = Store::workers(&dir).unwrap();
        assert_eq!(seen.iter().filter(|worker| worker.text == "alive" && worker.is_live).count(), 1);
        drop(Store::open(&dir).unwrap());
        assert!(!left.exists() && Store::workers(&dir).unwrap().len() == 1);
    }
}
