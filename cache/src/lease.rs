//! Leases: the records that live processes reference, which no collection removes.

use std::collections::BTreeSet;
use std::fs::Metadata;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::PoisonError;
use std::time::UNIX_EPOCH;

use crate::error::{At, StoreError};
use crate::locks::{KeyLock, abandoned};
use crate::machine::Machine;
use crate::open::LIVE;
use crate::sharing::{FILE, Sharing};
use crate::{Digest, Store, plain};

/// Bytes of a key.
const KEY_BYTES: usize = 32;
/// Stands for the lock between collections and runs that begin, among those of keys.
const GATE: &[u8] = b"rockface: who is live";

/// The records that live processes reference.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Live {
    /// How many there are.
    pub count: usize,
    /// When the first of them began, seconds since 1970: what was written since may be named soon.
    pub since_unix_s: Option<u64>,
    /// The keys of records they reference.
    pub keys: BTreeSet<Digest>,
    /// Whether what one of them references is not known: it has yet to list it, or its list cannot be read.
    pub is_looking: bool,
    /// The first list that this user may not read.
    pub unreadable: Option<PathBuf>,
}

impl Live {
    /// Enters a process whose list this is.
    fn enter(&mut self, list: &Metadata) {
        let began = list.created().or_else(|_| list.modified()).ok();
        let began = began.and_then(|at| at.duration_since(UNIX_EPOCH).ok()).map_or(0, |since| since.as_secs());
        self.count += 1;
        self.since_unix_s = Some(self.since_unix_s.map_or(began, |first| first.min(began)));
    }
}

impl Store {
    /// Notes that this process references these records until the store is dropped: no collection removes them.
    ///
    /// The first call says that the process is live, and reads what the store holds from then on: without keys, before
    /// anything is looked up, it makes collections spare all records until some keys are registered.
    pub fn count_on(&self, keys: &[Digest]) -> Result<(), StoreError> {
        let mut lease = self.lease.lock().unwrap_or_else(PoisonError::into_inner);
        let file = if let Some(file) = &mut *lease {
            file
        } else {
            let file = lease.insert(self.begin_lease().map_err(|fault| fault.or_read_only(self.dir()))?);
            self.refresh()?;
            file
        };
        let bytes: Vec<u8> = keys.iter().flat_map(|key| *key.as_bytes()).collect();
        file.write_all(&bytes).at("write", file.path())
    }

    fn begin_lease(&self) -> Result<tempfile::NamedTempFile, StoreError> {
        let _gate = self.gate()?;
        // From now on others see this process.
        self.machine().worker()?;
        begin(&self.machine().folder(LIVE), Sharing::of(self.dir()))
    }

    /// Held by a collection from its last look at who is live until what leaves has left, and for a moment by each run
    /// that begins: so it is seen, or sees what is left.
    pub(crate) fn gate(&self) -> Result<KeyLock, StoreError> {
        self.lock(&Digest::of(GATE), || ())
    }

    /// The records that other live processes, and this one, reference.
    pub fn live(&self) -> Result<Live, StoreError> {
        let mut live = Live::default();
        for folder in self.machine().folders(LIVE) {
            self.live_in(&folder, &mut live)?;
        }
        Ok(live)
    }

    fn live_in(&self, folder: &Path, live: &mut Live) -> Result<(), StoreError> {
        // The locks of another machine may not be seen here, but its signs of life are.
        let is_alive_elsewhere = Machine::of_folder(folder)
            .is_some_and(|machine| machine != self.machine().name() && self.machine().is_alive(machine));
        for entry in std::fs::read_dir(folder).at("list", folder)? {
            let path = entry.at("list", folder)?.path();
            if plain::is_folder(&path) {
                continue;
            }
            let mut file = match plain::settled(|| plain::open(&path)) {
                // Its process has ended since it was listed, or it is nothing that a process made.
                Err(fault) if fault.kind() == std::io::ErrorKind::NotFound || plain::is_foreign(&fault) => continue,
                Err(fault) if fault.kind() == std::io::ErrorKind::PermissionDenied => {
                    // Who cannot be read is not taken for dead.
                    live.enter(&std::fs::symlink_metadata(&path).at("look at", &path)?);
                    live.is_looking = true;
                    live.unreadable.get_or_insert(path);
                    continue;
                }
                file => file.at("open", &path)?,
            };
            let is_dead = plain::open(&path).map_or_else(
                |fault| fault.kind() == std::io::ErrorKind::NotFound,
                |file| abandoned(file, &path).is_some(),
            );
            if is_dead && !is_alive_elsewhere {
                continue;
            }
            live.enter(&file.metadata().at("look at", &path)?);
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).at("read", &path)?;
            live.is_looking |= bytes.is_empty();
            live.keys
                .extend(bytes.chunks_exact(KEY_BYTES).filter_map(|key| Some(Digest::from_bytes(key.try_into().ok()?))));
        }
        Ok(())
    }
}

/// A file that is locked as long as this process lives and removed with the store.
fn begin(folder: &Path, sharing: Sharing) -> Result<tempfile::NamedTempFile, StoreError> {
    loop {
        let mut builder = tempfile::Builder::new();
        let file = builder.prefix("run-").permissions(sharing.permissions()).tempfile_in(folder);
        let file = file.at("write into", folder)?;
        sharing.give(file.as_file(), FILE).at("set the mode of", file.path())?;
        file.as_file().lock().at("lock a file in", folder)?;
        // Swept up between its making and its locking? Then make another.
        if crate::segment::is_at(file.as_file(), file.path()) {
            return Ok(file);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_cannot_be_read_is_not_taken_for_dead() {
        let place = tempfile::tempdir().unwrap();
        let store = Store::open(&place.path().join("store")).unwrap();
        let path = |name: &str| store.dir().join(LIVE).join(name);
        // What is no file was put there by a stranger, and stands for nobody.
        std::os::unix::fs::symlink("run-loop", path("run-loop")).unwrap();
        assert_eq!(store.live().unwrap(), Live::default());
        std::fs::write(path("run-shut"), b"").unwrap();
        std::fs::set_permissions(path("run-shut"), std::os::unix::fs::PermissionsExt::from_mode(0o000)).unwrap();
        if plain::open(&path("run-shut")).is_ok() {
            println!("skipped: root may read everything");
            return;
        }
        let live = store.live().unwrap();
        assert!(live.count == 1 && live.is_looking && live.since_unix_s.is_some(), "{live:?}");
        assert_eq!(live.unreadable, Some(path("run-shut")));
    }

    #[test]
    fn a_live_process_says_what_it_counts_on_until_it_ends() {
        let place = tempfile::tempdir().unwrap();
        let open = || Store::open(&place.path().join("store")).unwrap();
        let (one, other) = (open(), open());
        assert_eq!(one.live().unwrap(), Live::default());
        let keys = [Digest::of(b"a"), Digest::of(b"b")];
        one.count_on(&keys[..1]).unwrap();
        one.count_on(&keys[1..]).unwrap();
        let live = other.live().unwrap();
        assert_eq!((live.count, live.keys), (1, keys.into()));
        assert!(live.since_unix_s.is_some_and(|since| since > 0));
        drop(one);
        assert_eq!(open().live().unwrap(), Live::default());
    }
}
