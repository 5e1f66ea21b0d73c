//! Looks at the file system: what was seen at a path, in a form that shows later whether it has changed.

use std::fs;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use rustix::fs::{AtFlags, Mode, OFlags, open, statat};
use serde::{Deserialize, Serialize};

use crate::files::{Fingerprint, is_settled};
use crate::{Digest, Store};

/// The state of a file or folder, without its content: size, times, inode and device, condensed to 64 bits.
///
/// The time of the last change of state is one of the times, which only the system sets: a file that was edited and given
/// its former time of modification has another state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct State(u64);

impl State {
    /// The state of what a path leads to; `None` where it leads to nothing. Links are followed.
    pub fn of(path: &Path) -> Option<Self> {
        fs::metadata(path).ok().map(|meta| Self::from(&Fingerprint::of(&meta)))
    }

    /// The state of a folder that was left alone long enough for a new entry to show in it.
    fn of_settled(path: &Path) -> Option<Self> {
        let meta = fs::metadata(path).ok().filter(|meta| is_settled(meta, SystemTime::now()))?;
        Some(Self::from(&Fingerprint::of(&meta)))
    }
}

impl From<&Fingerprint> for State {
    fn from(fingerprint: &Fingerprint) -> Self {
        let mut first = [0; 8];
        first.copy_from_slice(&blake3::hash(&fingerprint.bytes()).as_bytes()[..8]);
        Self(u64::from_le_bytes(first))
    }
}

/// What was seen at a path. Links are followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Seen {
    /// A file with these bytes.
    File(Digest),
    /// A folder, in this state just before its entries were listed; `None` if it had changed so lately that a further
    /// change might not show.
    Folder(Option<State>),
    /// Nothing, or something else than a regular file, such as a folder.
    NoFile,
}

impl Seen {
    /// A folder that is going to be listed: to be called before that.
    pub fn folder(path: &Path) -> Self {
        Self::Folder(State::of_settled(path))
    }
}

/// A look that can be repeated without reading: the state that was found, or that there was no file.
pub(crate) type Repeatable = (PathBuf, Option<State>);

/// A thread is worth starting for so many files: looking at one takes a microsecond or two.
const FILES_A_THREAD: usize = 300;

/// Whether the same is seen again.
pub(crate) fn is_same((path, then): &Repeatable) -> bool {
    match then {
        Some(then) => State::of(path) == Some(*then),
        None => !path.is_file(),
    }
}

/// Whether all of these files in a folder are in these states.
///
/// There may be thousands: each is looked up from the folder, and not along all the folders above it, and several threads
/// share them.
pub(crate) fn are_same(folder: &Path, files: &[(PathBuf, State)]) -> bool {
    if files.is_empty() {
        return true;
    }
    let Ok(folder) = open(folder, OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty()) else {
        return false;
    };
    if files.len() <= FILES_A_THREAD {
        return all_same(&folder, files);
    }
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    let share = files.len().div_ceil(processors).max(FILES_A_THREAD);
    let (mine, others) = files.split_at(share);
    std::thread::scope(|scope| {
        let folder = &folder;
        let start = |files| {
            let thread = std::thread::Builder::new();
            thread.spawn_scoped(scope, move || all_same(folder, files)).map_err(|_| files)
        };
        // Where no thread can be started, this one looks at all of them.
        let started: Vec<_> = others.chunks(share).map(start).collect();
        let ended = |thread| match thread {
            Ok(thread) => std::thread::ScopedJoinHandle::join(thread).unwrap_or(false),
            Err(files) => all_same(folder, files),
        };
        all_same(folder, mine) & started.into_iter().all(ended)
    })
}

fn all_same(folder: &OwnedFd, files: &[(PathBuf, State)]) -> bool {
    let now = |file| statat(folder, file, AtFlags::empty()).map(|stat| State::from(&Fingerprint::of_stat(&stat)));
    files.iter().all(|(file, then)| now(file).is_ok_and(|now| now == *then))
}

impl Store {
    /// A look in the form that can be repeated; `None` where it is not sure that the same would be seen now, or that
    /// every later change would show.
    pub(crate) fn repeatable(&self, path: &Path, seen: &Seen) -> Option<Repeatable> {
        let state = match seen {
            Seen::File(digest) => {
                let now = Fingerprint::of(&fs::metadata(path).ok()?);
                let (then, remembered) = self.remembered_file(path)?;
                Some(State::from(&(then == now && remembered == *digest).then_some(now)?))
            }
            Seen::Folder(then) => Some(State::of(path).filter(|now| Some(*now) == *then)?),
            Seen::NoFile => (!path.is_file()).then_some(None)?,
        };
        Some((path.to_owned(), state))
    }
}
