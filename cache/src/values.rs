//! Values that are not kept, handed from one live process to another: who has which, who wants which, and how it gets there.
//!
//! A process announces what it has by locks, so that nothing is written as long as nobody asks, and nothing is to be cleared
//! away after a kill. Who wants a value leaves a file of its name in a folder of its own, its **room** under `scratch/`;
//! who has the value finds that and puts the bytes beside it. So what is handed over belongs to the one who asked, and goes
//! with it: when it is used up, when the process ends, or when the store is next opened after a kill.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::error::{At, StoreError};
use crate::locks::Announced;
use crate::open::SCRATCH;
use crate::remote::Claims;
use crate::scratch::Scratch;
use crate::sharing::{FILE, Sharing};
use crate::{Digest, Store, plain};

/// Starts the name of every room.
pub(crate) const ROOM: &str = "room-";
/// Starts the name of a file that says what is wanted.
const WANTED: &str = "want-";
/// Starts the name of what is being written into a room.
const HALF_WRITTEN: &str = "new-";

/// The folder through which a process gets values from others; removed with all that is in it when this is dropped.
#[derive(Debug)]
pub struct Room {
    folder: Scratch,
    /// Those that share only a remote place.
    claims: Option<Arc<Claims>>,
}

/// What another live process wants.
#[derive(Debug, Clone)]
pub struct Want {
    /// The digest of a value, or the key of the recipe that makes it.
    pub name: Digest,
    place: WantedIn,
}

/// Where a value is wanted.
#[derive(Debug, Clone)]
enum WantedIn {
    /// In the room of a process on this store.
    Room(PathBuf),
    /// By a process that shares a remote place with this one.
    Remote(Arc<Claims>),
}

impl Store {
    /// Lets other processes see that this one has these bytes at hand, until what is returned is dropped.
    pub fn announce(&self, digest: &Digest) -> Result<Announced, StoreError> {
        let announced = self.locks.announce(&announced_as(digest))?;
        Ok(announced.with(self.claims().map(|claims| claims.announce(digest))))
    }

    /// Whether a live process other than this one has these bytes at hand.
    pub fn is_at_hand_elsewhere(&self, digest: &Digest) -> Result<bool, StoreError> {
        let is_here = self.locks.is_announced_elsewhere(&announced_as(digest))?;
        Ok(is_here || self.claims().is_some_and(|claims| claims.is_elsewhere(digest)))
    }

    /// A room of its own for this process.
    pub fn room(&self) -> Result<Room, StoreError> {
        Ok(Room { folder: self.scratch_named(ROOM, false)?, claims: self.claims().cloned() })
    }

    /// Whether there are other processes with rooms, or at the remote place, and what they want.
    pub fn wanted_elsewhere(&self, own: Option<&Room>) -> Result<(bool, Vec<Want>), StoreError> {
        let (mut are_others, mut wanted) = (false, Vec::new());
        for room in self.in_scratch()? {
            let is_room = room.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with(ROOM));
            if is_room && plain::is_folder(&room) && own.is_none_or(|own| own.path() != room) {
                are_others = true;
                wanted.extend(names(&room, WANTED).map(|name| Want { name, place: WantedIn::Room(room.clone()) }));
            }
        }
        if let Some(claims) = self.claims() {
            are_others |= claims.are_others();
            let remote = |name| Want { name, place: WantedIn::Remote(Arc::clone(claims)) };
            wanted.extend(claims.wanted().into_iter().map(remote));
        }
        Ok((are_others, wanted))
    }
}

impl Store {
    /// What is in the folders of scratch of all machines.
    fn in_scratch(&self) -> Result<Vec<PathBuf>, StoreError> {
        let mut found = Vec::new();
        for root in self.machine().folders(SCRATCH) {
            for entry in fs::read_dir(&root).at("list", &root)? {
                found.push(entry.at("list", &root)?.path());
            }
        }
        Ok(found)
    }
}

/// What stands for a value among the bytes that are locked.
fn announced_as(digest: &Digest) -> Digest {
    Digest::of(&[b"rockface: at hand ".as_slice(), digest.as_bytes()].concat())
}

/// The digests that follow a prefix in the names of files; none of a room that is gone.
fn names(room: &Path, prefix: &str) -> impl Iterator<Item = Digest> {
    let entries = fs::read_dir(room).into_iter().flatten().flatten();
    entries.filter_map(move |entry| entry.file_name().to_str()?.strip_prefix(prefix)?.parse().ok())
}

impl Room {
    /// The absolute path of the folder that receives values.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Says that a value is wanted, by its digest or by the key of the recipe that makes it.
    pub fn want(&self, name: &Digest) -> Result<(), StoreError> {
        let path = self.wanted(name);
        fs::File::create(&path).map(drop).at("write", &path)?;
        self.claims.iter().for_each(|claims| claims.want(name, self.path()));
        Ok(())
    }

    /// Says that it is not wanted any more.
    pub fn unwant(&self, name: &Digest) {
        // It is not there once it was answered.
        let _ = fs::remove_file(self.wanted(name));
        self.claims.iter().for_each(|claims| claims.unwant(name));
    }

    /// The file with the bytes of this digest, unverified, if somebody has brought them. It is the caller's from now on.
    pub fn take(&self, digest: &Digest) -> Option<PathBuf> {
        let taken = tempfile::Builder::new().prefix("taken-").tempfile_in(self.path()).ok()?.into_temp_path();
        fs::rename(self.path().join(digest.to_string()), &taken).ok()?;
        // Only files are brought: a link or a pipe, put there by a stranger, is removed unread.
        fs::symlink_metadata(&taken).is_ok_and(|meta| meta.is_file()).then(|| taken.keep().ok()).flatten()
    }

    fn wanted(&self, name: &Digest) -> PathBuf {
        self.path().join(format!("{WANTED}{name}"))
    }
}

/// Puts the bytes of a digest into a room, whole or not at all.
pub(crate) fn put_into(room: &Path, digest: &Digest, bytes: &[u8]) -> io::Result<()> {
    let mut new = tempfile::Builder::new().prefix(HALF_WRITTEN).tempfile_in(room)?;
    new.write_all(bytes)?;
    // The process whose room it is may be of another user.
    Sharing::of(room).give(new.as_file(), FILE)?;
    new.persist(room.join(digest.to_string()))?;
    Ok(())
}

impl Want {
    /// Brings the bytes of a digest to who wants them: a further name of a file that has them where there is one, or else the
    /// bytes themselves.
    pub fn bring(
        &self,
        digest: &Digest,
        file: Option<&Path>,
        bytes: impl FnOnce() -> io::Result<Vec<u8>>,
    ) -> io::Result<()> {
        let room = match &self.place {
            WantedIn::Room(room) => room,
            WantedIn::Remote(claims) => {
                claims.give(&self.name, digest, bytes()?);
                return Ok(());
            }
        };
        let to = room.join(digest.to_string());
        // A file of this process that another one may be about to read.
        let lend = |file: &Path| plain::open(file).and_then(|file| Sharing::of(room).give(&file, FILE));
        let linked = file.is_some_and(|file| match lend(file).and_then(|()| fs::hard_link(file, &to)) {
            Err(fault) => fault.kind() == io::ErrorKind::AlreadyExists,
            Ok(()) => true,
        });
        if !linked {
            put_into(room, digest, &bytes()?)?;
        }
        Ok(())
    }

    /// What was wanted has been brought.
    pub fn answered(&self) {
        match &self.place {
            // It is not there any more where another was quicker, or who wanted it is gone.
            WantedIn::Room(room) => drop(fs::remove_file(room.join(format!("{WANTED}{}", self.name)))),
            WantedIn::Remote(claims) => claims.answer(&self.name),
        }
    }

    /// Whether who wanted it is gone.
    pub fn is_moot(&self) -> bool {
        match &self.place {
            WantedIn::Room(room) => !room.exists(),
            WantedIn::Remote(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_goes_from_who_has_it_to_who_wants_it_and_leaves_nothing() {
        let place = tempfile::tempdir().unwrap();
        let open = || Store::open(&place.path().join("store")).unwrap();
        let (one, other) = (open(), open());
        let (value, second) = (Digest::of(b"value"), Digest::of(b"second"));
        let has = one.announce(&value).unwrap();
        assert!(other.is_at_hand_elsewhere(&value).unwrap() && !one.is_at_hand_elsewhere(&value).unwrap());
        assert!(!other.is_at_hand_elsewhere(&second).unwrap());
        let wanted = |store: &Store, own: Option<&Room>| {
            let (are_others, wanted) = store.wanted_elsewhere(own).unwrap();
            (are_others, wanted.into_iter().map(|want| want.name).collect::<Vec<_>>())
        };
        assert_eq!(wanted(&one, None), (false, vec![]));
        let room = other.room().unwrap();
        room.want(&value).unwrap();
        assert!(room.take(&value).is_none());
        assert_eq!(wanted(&other, Some(&room)), (false, vec![]), "nobody asks itself");
        assert_eq!(wanted(&one, None), (true, vec![value]));
        let want = one.wanted_elsewhere(None).unwrap().1.remove(0);
        want.bring(&value, None, || Ok(b"value".to_vec())).unwrap();
        let file = room.path().join(value.to_string());
        want.bring(&second, Some(&file), || unreachable!("it has a file")).unwrap();
        want.answered();
        assert_eq!(wanted(&one, None), (true, vec![]));
        for digest in [value, second] {
            assert_eq!(fs::read(room.take(&digest).unwrap()).unwrap(), b"value");
            assert!(room.take(&digest).is_none(), "it is there once");
        }
        drop(has);
        assert!(!other.is_at_hand_elsewhere(&value).unwrap());
        drop(room);
        assert!(want.is_moot() && want.bring(&value, None, || Ok(Vec::new())).is_err());
        assert_eq!(fs::read_dir(one.dir().join(SCRATCH)).unwrap().count(), 0);
    }

    #[test]
    fn the_room_of_a_process_that_died_goes_when_the_store_is_next_opened() {
        let place = tempfile::tempdir().unwrap();
        let open = || Store::open(&place.path().join("store")).unwrap();
        let store = open();
        let (live, dead) = (store.room().unwrap(), store.room().unwrap());
        dead.want(&Digest::of(b"value")).unwrap();
        dead.folder.abandon();
        open();
        assert!(live.path().exists());
        let (are_others, wanted) = store.wanted_elsewhere(Some(&live)).unwrap();
        assert!(!are_others && wanted.is_empty());
    }
}
