//! The store: blobs by digest, records by the key of their recipe.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use crate::blobs::Blobs;
use crate::error::{At, StoreError};
use crate::frame::Kind;
use crate::index::Place;
use crate::journal::Journal;
use crate::leases::Leases;
use crate::locks::{Bytes, KeyLock};
use crate::machine::Machine;
use crate::open::{self, LOCKS, QUARANTINE, SEGMENTS, TMP};
use crate::remote::Remote;
use crate::seal::Damage;
use crate::sharing::{FILE, Sharing};
use crate::syncer::Syncer;
use crate::{Digest, Outcome, Record};

/// Blobs of this size and more have a file of their own.
pub(crate) const LARGE_BYTES: usize = 64 * 1024;

/// A store, opened once a process and shared by reference.
///
/// What is put or committed survives the end of the process in any way at once, and a power cut after a second at most.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use rockface_cache::Store;
///
/// let folder = tempfile::tempdir()?;
/// let store = Store::open(&folder.path().join("store"))?;
/// let digest = store.put(b"ten cubic metres")?;
/// assert_eq!(store.get(&digest)?, b"ten cubic metres");
/// assert_eq!(store.put(b"ten cubic metres")?, digest);
/// assert_eq!(store.stat()?.small_blobs, 1);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    blobs: Blobs,
    journal: Arc<Journal>,
    syncer: Syncer,
    files_hashed: AtomicU64,
    pub(crate) locks: Arc<Bytes>,
    machine: Arc<Machine>,
    /// The file that lists the records this process references, once it runs something.
    pub(crate) lease: Mutex<Option<tempfile::NamedTempFile>>,
    /// What is not here is looked for there.
    pub(crate) remote: OnceLock<Box<Remote>>,
}

/// What is in a store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct StoreStat {
    /// Number of blobs inside segments.
    pub small_blobs: u64,
    /// Total size of the blobs inside segments.
    pub small_blob_bytes: u64,
    /// Blobs with a file of their own.
    pub large_blobs: u64,
    /// Total size of the blobs in files of their own.
    pub large_blob_bytes: u64,
    /// Keys that have a record.
    pub records: u64,
    /// Notes on former runs.
    pub notes: u64,
    /// Number of segment files.
    pub segments: u64,
    /// Total size of the segment files.
    pub segment_bytes: u64,
    /// Damaged blobs set aside.
    pub quarantined: u64,
    /// How often this handle had to read a file outside the store to know its digest.
    pub files_hashed: u64,
}

impl Store {
    /// Opens the store at `dir`, making it if there is none. Refuses another format and a folder of other things.
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        // Made absolute, so that the store stays where it is when the process changes its folder.
        let root = std::path::absolute(dir).at("find", dir)?;
        let machine = Arc::new(Machine::on(&root));
        open::prepare(dir, &machine)?;
        let journal = Arc::new(Journal::open(&root.join(SEGMENTS), machine.own_segments())?);
        let leases = machine.is_shared.then(|| Leases::new(&root, Arc::clone(&machine)));
        let locks =
            if machine.is_shared { root.join(format!("keys-{}.lock", machine.name())) } else { root.join(LOCKS) };
        Ok(Self {
            blobs: Blobs::new(&root, &machine.folder(TMP)),
            syncer: Syncer::new(Arc::clone(&journal)),
            journal,
            locks: Bytes::new(locks, leases),
            machine,
            root,
            files_hashed: AtomicU64::new(0),
            lease: Mutex::default(),
            remote: OnceLock::new(),
        })
    }

    /// Whether there is a store of this format at `dir`.
    pub fn is_at(dir: &Path) -> bool {
        open::is_current(dir)
    }

    /// Whether there is a store of this format at `dir` that opening it leaves as it is but for litter: one that somebody else
    /// names may be looked into then.
    pub fn is_whole_at(dir: &Path) -> bool {
        open::is_whole(dir)
    }

    /// The folder of the store, absolute.
    pub fn dir(&self) -> &Path {
        &self.root
    }

    /// Stores these bytes, unless they are there already, and returns their digest.
    ///
    /// What is there but was put long ago is put again: a large blob has its time set, a small one is written to the
    /// segment of this process. So a collection beside this sees that it is used, however old it is. What is there and has
    /// another size is set aside, and reported by [`Store::take_damaged`].
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StoreError> {
        let digest = Digest::of(bytes);
        if bytes.len() < LARGE_BYTES {
            // No file has its name: only large ones have.
            if !self.place(&digest).is_some_and(Place::is_recent) {
                self.append(Kind::Blob, digest, bytes)?;
            }
            return Ok(digest);
        }
        if self.renew(&digest, Some(bytes.len() as u64)) {
            return Ok(digest);
        }
        self.blobs.put(&digest, bytes)?;
        let path = self.blobs.path(&digest);
        path.ancestors().skip(1).take(2).for_each(|folder| self.journal.owe(folder));
        self.syncer.wake()?;
        Ok(digest)
    }

    /// Whether a blob is there and no collection takes it for one nobody uses; false where it has to be put again.
    pub(crate) fn renew(&self, digest: &Digest, bytes: Option<u64>) -> bool {
        self.place(digest).map_or_else(|| self.blobs.renew(digest, bytes), Place::is_recent)
    }

    /// Whether a blob is there, or in the remote place under this store.
    pub fn contains(&self, digest: &Digest) -> bool {
        self.size(digest).is_some()
    }

    /// The size of a blob, if it is there. A large one that was written to by others is verified first.
    pub fn size(&self, digest: &Digest) -> Option<u64> {
        self.size_here(digest).or_else(|| self.size_below(digest))
    }

    /// [`Store::size`] of a blob in this very store.
    pub(crate) fn size_here(&self, digest: &Digest) -> Option<u64> {
        self.size_if(digest, None)
    }

    /// The size of a blob, which should be `bytes`.
    fn size_if(&self, digest: &Digest, bytes: Option<u64>) -> Option<u64> {
        match self.place(digest) {
            Some(place) => Some(u64::from(place.length)),
            None => self.blobs.check(digest, bytes).ok(),
        }
    }

    /// The bytes of a blob, verified. A damaged one is set aside, is not there any more for any process from now on, and
    /// can be put anew.
    pub fn get(&self, digest: &Digest) -> Result<Vec<u8>, StoreError> {
        self.bring([*digest])?;
        self.get_here(digest)
    }

    fn get_here(&self, digest: &Digest) -> Result<Vec<u8>, StoreError> {
        let Some(place) = self.place(digest) else {
            return self.blobs.get(digest);
        };
        let Some(bytes) = self.journal.read_if_there(place)? else {
            // Its segment was written anew since it was looked up.
            self.refresh()?;
            return if self.place(digest) == Some(place) {
                Err(StoreError::Missing { digest: *digest })
            } else {
                self.get_here(digest)
            };
        };
        if Digest::of(&bytes) == *digest {
            return Ok(bytes);
        }
        let moved_to = self.blobs.quarantine_path(digest);
        self.write_aside(&moved_to, &bytes).at("set aside a damaged blob as", &moved_to)?;
        // Recorded, so that the next process does not rely on the blob.
        self.append(Kind::Gone, *digest, b"")?;
        Err(StoreError::Damaged { digest: *digest, moved_to })
    }

    fn write_aside(&self, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
        std::fs::write(path, bytes)?;
        Sharing::of(&self.root).give(&crate::plain::open(path)?, FILE)
    }

    /// The latest record under this key, if its recipe is the one of that key. Those of other live processes are seen after
    /// [`Store::refresh`].
    pub fn record(&self, key: &Digest) -> Option<Record> {
        // Those of a remote place were verified when they were read.
        self.record_here(key).or_else(|| Record::decode(&self.record_below(key)?))
    }

    fn record_here(&self, key: &Digest) -> Option<Record> {
        self.journal.with_index(|index| {
            let payload = index.payload(Kind::Record, key)?;
            own_recipe(payload, key).and_then(|_| Record::decode(payload))
        })
    }

    /// The text of the recipe whose key this is, if it is on record.
    pub fn recipe_text(&self, key: &Digest) -> Option<String> {
        let here =
            self.journal.with_index(|index| own_recipe(index.payload(Kind::Record, key)?, key).map(str::to_owned));
        here.or_else(|| own_recipe(&self.record_below(key)?, key).map(str::to_owned))
    }

    /// The latest record under this key, if every blob it names is there.
    pub fn is_hit(&self, key: &Digest) -> Option<Record> {
        let is_whole = |record: &Record| self.has_all(record.blobs());
        let here = self.record_here(key).filter(is_whole);
        here.or_else(|| Record::decode(&self.record_below(key)?).filter(is_whole))
    }

    /// [`Store::is_hit`] without reading the recipe, which the caller has just hashed: what planning needs.
    pub fn hit_outcome(&self, key: &Digest) -> Option<Outcome> {
        let is_whole = |outcome: &Outcome| self.has_all(outcome.blobs());
        let here = self.journal.with_index(|index| Outcome::decode(index.payload(Kind::Record, key)?));
        let Some(here) = here.filter(is_whole) else {
            return Outcome::decode(&self.record_below(key)?).filter(is_whole);
        };
        self.offer_again(key);
        Some(here)
    }

    /// Whether there is a record under this key, be its blobs there or not.
    pub fn has_record(&self, key: &Digest) -> bool {
        self.journal.with_index(|index| index.payload(Kind::Record, key).is_some()) || self.has_record_below(key)
    }

    /// The blobs that were found damaged and set aside while the store checked whether they exist; each is reported once.
    pub fn take_damaged(&self) -> Vec<Damage> {
        self.blobs.take_damaged()
    }

    fn has_all(&self, mut blobs: impl Iterator<Item = (Digest, Option<u64>)>) -> bool {
        blobs.all(|(digest, bytes)| self.has(&digest, bytes))
    }

    /// Remembers a finished step and returns its key. All blobs it names must have been put before.
    ///
    /// A record that says the same of all but the cost as the one that is there is not written again; one that says
    /// otherwise supersedes it.
    pub fn commit(&self, record: &Record) -> Result<Digest, StoreError> {
        self.commit_with(record, &[], || Ok(()))
    }

    /// [`Store::commit`] together with small blobs, see [`crate::Parcel`].
    pub(crate) fn commit_with<E: From<StoreError>>(
        &self,
        record: &Record,
        blobs: &[(Digest, Vec<u8>)],
        put_again: impl FnOnce() -> Result<(), E>,
    ) -> Result<Digest, E> {
        if self.lacking(record, blobs).is_some() {
            put_again()?;
            self.check(record, blobs)?;
        }
        Ok(self.append_record(record, blobs)?)
    }

    fn append_record(&self, record: &Record, blobs: &[(Digest, Vec<u8>)]) -> Result<Digest, StoreError> {
        if !record.cost.is_sound() {
            return Err(bad_record(record, "its cost is negative, or no finite number of seconds".to_owned()));
        }
        let text = record.recipe.text();
        let key = Digest::of(text.as_bytes());
        let old = blobs.iter().filter(|(digest, _)| !self.place(digest).is_some_and(Place::is_recent));
        let mut entries: Vec<_> = old.map(|(digest, bytes)| (Kind::Blob, *digest, bytes.as_slice())).collect();
        if self.record_here(&key).is_some_and(|first| first.same_outcome(record)) {
            self.append_all(&entries)?;
            self.offer_again(&key);
            return Ok(key);
        }
        let payload = record.encode(&text).map_err(|fault| bad_record(record, fault.to_string()))?;
        entries.push((Kind::Record, key, &payload));
        self.append_all(&entries)?;
        self.offer(&key, &payload);
        Ok(key)
    }

    /// A blob the record names that is neither here nor among these.
    fn lacking(&self, record: &Record, among: &[(Digest, Vec<u8>)]) -> Option<Digest> {
        let is_among = |digest: &Digest, size: Option<u64>| {
            among.iter().any(|(own, bytes)| own == digest && size.is_none_or(|size| size == bytes.len() as u64))
        };
        let is_lacking =
            |(digest, size): &(Digest, Option<u64>)| !is_among(digest, *size) && !self.has_here(digest, *size);
        record.blobs().find(is_lacking).map(|(digest, _)| digest)
    }

    /// Refuses a record that could never be a hit.
    fn check(&self, record: &Record, among: &[(Digest, Vec<u8>)]) -> Result<(), StoreError> {
        let Some(digest) = self.lacking(record, among) else { return Ok(()) };
        // It may be there, and the system refuses to say.
        if let Err(fault @ StoreError::Io { .. }) = self.blobs.check(&digest, None) {
            return Err(fault);
        }
        let reason = format!("blob {} of it is not in the store with that size: put it first", digest.short());
        Err(bad_record(record, reason))
    }

    /// Whether a blob is there, or in the remote place under this store, with this size if one is given.
    fn has(&self, digest: &Digest, bytes: Option<u64>) -> bool {
        let is_that = |size: u64| bytes.is_none_or(|bytes| bytes == size);
        self.has_here(digest, bytes) || self.size_below(digest).is_some_and(is_that)
    }

    /// Whether a blob is in this very store, with this size if one is given.
    pub(crate) fn has_here(&self, digest: &Digest, bytes: Option<u64>) -> bool {
        self.size_if(digest, bytes).is_some_and(|size| bytes.is_none_or(|bytes| bytes == size))
    }

    /// Takes the right to compute `key`, calling `on_wait` once before waiting if another holds it, here or in another
    /// process; so a thread must not ask again for a key it holds. After a wait, [`Store::refresh`] and look again: the
    /// other has probably done the work.
    pub fn lock(&self, key: &Digest, on_wait: impl FnOnce()) -> Result<KeyLock, StoreError> {
        self.locks.lock(key, on_wait)
    }

    /// Takes the right to compute `key` unless another holds it, of those that share this store or a remote place under it. What such
    /// another process has uploaded meanwhile is seen at once.
    pub fn try_lock(&self, key: &Digest) -> Result<Option<KeyLock>, StoreError> {
        let Some(lock) = self.locks.try_lock(key)? else { return Ok(None) };
        let Some(claims) = self.claims() else { return Ok(Some(lock)) };
        Ok(claims.take(key).map(|claim| lock.with(claim)))
    }

    /// Whether no other process is known to have the right to compute `key`; another may still be quicker.
    pub fn is_free(&self, key: &Digest) -> Result<bool, StoreError> {
        Ok(self.locks.try_lock(key)?.is_some() && self.claims().is_none_or(|claims| claims.is_free(key)))
    }

    /// Picks up what other processes have stored meanwhile.
    pub fn refresh(&self) -> Result<(), StoreError> {
        if self.machine.is_shared {
            self.machine.renew_listing(&self.root.join(SEGMENTS))?;
        }
        self.journal.refresh()
    }

    /// Makes everything stored so far durable now. Happens by itself within a second, and when the store is dropped.
    pub fn sync(&self) -> Result<(), StoreError> {
        self.syncer.sync()
    }

    /// The keys of all records, sorted.
    pub fn keys(&self) -> Vec<Digest> {
        self.journal.with_index(|index| index.names(Kind::Record))
    }

    /// Counts what is in the store.
    pub fn stat(&self) -> Result<StoreStat, StoreError> {
        let (small_blobs, small_blob_bytes, records, notes) = self.journal.with_index(crate::index::Index::counts);
        let (large_blobs, large_blob_bytes) = self.blobs.count()?;
        let (segments, segment_bytes) = count_files(&self.root.join(SEGMENTS))?;
        let (quarantined, _) = count_files(&self.root.join(QUARANTINE))?;
        let files_hashed = self.files_hashed.load(Ordering::Relaxed);
        Ok(StoreStat {
            small_blobs,
            small_blob_bytes,
            large_blobs,
            large_blob_bytes,
            records,
            notes,
            segments,
            segment_bytes,
            quarantined,
            files_hashed,
        })
    }

    /// Appends to the journal and sees to its being synced.
    pub(crate) fn append(&self, kind: Kind, name: Digest, payload: &[u8]) -> Result<(), StoreError> {
        self.append_all(&[(kind, name, payload)])
    }

    fn append_all(&self, entries: &[(Kind, Digest, &[u8])]) -> Result<(), StoreError> {
        self.journal.append_all(entries)?;
        self.syncer.wake()
    }

    pub(crate) fn journal(&self) -> &Journal {
        &self.journal
    }

    pub(crate) fn machine(&self) -> &Machine {
        &self.machine
    }

    pub(crate) fn shared_journal(&self) -> &Arc<Journal> {
        &self.journal
    }

    pub(crate) fn blobs(&self) -> &Blobs {
        &self.blobs
    }

    pub(crate) fn is_small(&self, digest: &Digest) -> bool {
        self.place(digest).is_some()
    }

    pub(crate) fn count_hashed(&self) {
        self.files_hashed.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn place(&self, digest: &Digest) -> Option<Place> {
        self.journal.with_index(|index| index.blob(digest))
    }
}

/// The text of the recipe in a record, if its key is this one.
fn own_recipe<'a>(payload: &'a [u8], key: &Digest) -> Option<&'a str> {
    Record::recipe_text(payload).filter(|text| Digest::of(text.as_bytes()) == *key)
}

fn bad_record(record: &Record, reason: String) -> StoreError {
    StoreError::BadRecord { stage: record.recipe.stage.clone(), reason }
}

/// The number of files in a folder, and their bytes.
fn count_files(folder: &Path) -> Result<(u64, u64), StoreError> {
    let (mut count, mut bytes) = (0, 0);
    for entry in std::fs::read_dir(folder).at("list", folder)? {
        match entry.at("list", folder)?.metadata() {
            // Removed since it was listed.
            Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => continue,
            meta => bytes += meta.at("list", folder)?.len(),
        }
        count += 1;
    }
    Ok((count, bytes))
}
