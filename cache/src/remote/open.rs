//! Opening a remote place: its format, what it can do, and what is in it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, OnceLock, RwLock};

use super::backend::{Backend, BackendError};
use super::batch::Batch;
use super::breaker::{Breaker, Warn};
use super::claims::Claims;
use super::contents::Contents;
use super::traffic::{Counted, Traffic};
use super::upload::Uploader;
use super::{AT_ONCE, FORMAT, FORMAT_NAME, INDEX, OBJECT_LIMIT, RECORDS, batch_name, digest_of, each_at_once};
use crate::error::StoreError;
use crate::sharing::{FILE, Sharing};
use crate::{Digest, plain};

/// The folder of a store in which batches of remote places are kept, so that each is fetched once.
const REMOTES: &str = "remotes";
/// Starts the names of files that are being written there.
const HALF_WRITTEN: &str = ".new-";
/// The greatest size of the objects `format` and `index`.
const SMALL_LIMIT: u64 = 64 << 20;

/// What a remote place is opened for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    /// A layer under a store that also takes what is made here. If it cannot be reached, work goes on without it.
    Layer,
    /// A layer that is only read.
    ReadOnlyLayer,
    /// A command that writes to the place itself: if it cannot be reached, that is an error; if there is none, it is made.
    Itself,
    /// A command on what is in the place: if it cannot be reached, or if there is none, that is an error.
    Contents,
}

/// A remote place for results, opened once a process.
#[derive(Debug)]
pub struct Remote {
    pub(super) shared: Arc<Shared>,
    pub(super) uploader: Mutex<Option<Uploader>>,
    /// Who computes what; begun when the place is put under a store that also writes to it.
    pub(super) claims: OnceLock<Arc<Claims>>,
}

/// What the threads that read and write share.
#[derive(Debug)]
pub(super) struct Shared {
    pub backend: Counted,
    pub breaker: Breaker,
    pub contents: RwLock<Contents>,
    /// Batches that were fetched before; `None` where they are not kept.
    cache: Option<PathBuf>,
    pub is_read_only: bool,
    honours_create: Mutex<Option<bool>>,
    /// One at a time fetches a pack: whoever waits finds its blobs in the store.
    pub packs: Mutex<()>,
    /// Bytes of the largest blob that is fetched.
    pub largest: AtomicU64,
}

impl Remote {
    /// Opens a remote place; `store` is the folder of the local store, which keeps batches that were fetched.
    ///
    /// What a layer cannot do without credentials is an error that says so; what it cannot do because the place does not
    /// answer is a warning.
    pub fn open(
        backend: Box<dyn Backend>,
        store: Option<&Path>,
        what_for: Use,
        warn: Warn,
    ) -> Result<Self, StoreError> {
        let url = backend.url().to_owned();
        let is_layer = matches!(what_for, Use::Layer | Use::ReadOnlyLayer);
        let is_read_only = backend.is_read_only() || what_for == Use::ReadOnlyLayer;
        let shared = Shared {
            breaker: Breaker::new(url.clone(), warn),
            backend: Counted::new(backend),
            contents: RwLock::default(),
            cache: store.map(|store| cache_folder(store, &url)).transpose()?,
            is_read_only,
            honours_create: Mutex::default(),
            packs: Mutex::default(),
            largest: AtomicU64::new(u64::MAX),
        };
        let opened = shared.prepare(what_for).and_then(|()| shared.refresh().map_err(|fault| (READ, fault)));
        match opened {
            Ok(()) => {}
            Err((_, BackendError::Unavailable(why))) if is_layer => shared.breaker.turn_off(&why),
            Err((action, fault)) => return Err(fault.at(action, &shared.backend)),
        }
        Ok(Self { shared: Arc::new(shared), uploader: Mutex::default(), claims: OnceLock::new() })
    }

    /// The address of the place, such as `s3://bucket/prefix`.
    pub fn url(&self) -> &str {
        self.shared.backend.url()
    }

    /// Leaves out blobs of more bytes: how large they are is what the place says.
    pub fn limit_blobs(&self, bytes: u64) {
        self.shared.largest.store(bytes, Relaxed);
    }

    /// Requests and bytes so far.
    pub fn traffic(&self) -> Traffic {
        self.shared.backend.traffic()
    }

    /// Whether it is left alone because it failed.
    pub fn is_off(&self) -> bool {
        self.shared.breaker.is_off()
    }

    /// Whether the place refuses to write an object that is there, as conditional puts ask; some ignore that. Found out by
    /// writing one twice.
    pub fn honours_create(&self) -> Result<bool, StoreError> {
        self.shared.honours().map_err(|fault| fault.at(WRITE, &self.shared.backend))
    }
}

const READ: &str = "read from";
const WRITE: &str = "write to";

/// Where batches of a place are kept in a store.
fn cache_folder(store: &Path, url: &str) -> Result<PathBuf, StoreError> {
    let remotes = store.join(REMOTES);
    let sharing = Sharing::of(store);
    plain::folder(&remotes, sharing)?;
    let own = remotes.join(&Digest::of(url.as_bytes()).to_string()[..16]);
    plain::folder(&own, sharing)?;
    Ok(own)
}

impl Shared {
    /// Makes sure that this is a remote place of this format, making it one if it is none and that is what it is for.
    fn prepare(&self, what_for: Use) -> Result<(), (&'static str, BackendError)> {
        let found = match self.backend.get(FORMAT_NAME, SMALL_LIMIT) {
            Ok(found) => found,
            Err(BackendError::Missing) if what_for == Use::Contents => return Err((READ, BackendError::NoStore)),
            Err(BackendError::Missing) if self.is_read_only => {
                self.breaker.warn_once("holds no results yet: nothing is fetched from it");
                return Ok(());
            }
            Err(BackendError::Missing) => {
                // Of several who begin at once, all write the same.
                return self.backend.put(FORMAT_NAME, format!("{FORMAT}\n").as_bytes()).map_err(|fault| (WRITE, fault));
            }
            Err(fault) => return Err((READ, fault)),
        };
        let found = String::from_utf8_lossy(&found[..found.len().min(80)]).trim_end().to_owned();
        if found == FORMAT {
            return Ok(());
        }
        if found.starts_with("rockface store ") {
            let why =
                "it is a store, not a remote place: give it as `--store`, or copy from it with `rockface store push`"
                    .to_owned();
            return Err((READ, BackendError::Foreign(why)));
        }
        let why = format!("its format is `{}` and this version uses `{FORMAT}`", found.escape_debug());
        Err((READ, BackendError::Foreign(why)))
    }

    /// [`Remote::honours_create`].
    pub fn honours(&self) -> Result<bool, BackendError> {
        let mut known = self.honours_create.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(known) = *known {
            return Ok(known);
        }
        let found = self.probe()?;
        *known = Some(found);
        Ok(found)
    }

    /// Whether an object that is there is not written a second time.
    fn probe(&self) -> Result<bool, BackendError> {
        let clock = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let name = Digest::of(format!("{:?} {}", clock, std::process::id()).as_bytes());
        let name = format!("probe/{name}");
        let first = self.backend.create(&name, b"first")?;
        let second = self.backend.create(&name, b"second");
        let content = self.backend.get(&name, SMALL_LIMIT);
        self.backend.delete(&name)?;
        Ok(first && !second? && content? == b"first")
    }

    /// Reads the batches that others have written since the last time.
    pub fn refresh(&self) -> Result<(), BackendError> {
        let names: Vec<Digest> = match self.backend.list(RECORDS) {
            Ok(found) => found.iter().filter_map(|object| digest_of(&object.name)).collect(),
            Err(BackendError::Unsupported(_)) => self.index()?,
            Err(fault) => return Err(fault),
        };
        self.forget_cached(&names);
        let new = names.into_iter().filter(|name| !self.read(|contents| contents.has_batch(name))).collect();
        let fault = Mutex::new(None);
        each_at_once(new, AT_ONCE, |name| match self.batch(&name) {
            Ok(batch) => self.edit(|contents| contents.enter(name, batch)),
            // A collection has removed it since it was listed.
            Err(BackendError::Missing) => {}
            Err(why) => *fault.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(why),
        });
        fault.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).map_or(Ok(()), Err)
    }

    /// Reads a batch that another has just written; one that is gone or damaged counts as empty.
    pub fn read_batch(&self, name: &Digest) -> Result<(), BackendError> {
        if self.read(|contents| contents.has_batch(name)) {
            return Ok(());
        }
        match self.breaker.attempt(|| self.batch(name)) {
            Ok(batch) => self.edit(|contents| contents.enter(*name, batch)),
            Err(BackendError::Missing) => {}
            Err(fault) => return Err(fault),
        }
        Ok(())
    }

    /// The batches that the index names.
    fn index(&self) -> Result<Vec<Digest>, BackendError> {
        match self.backend.get(INDEX, SMALL_LIMIT) {
            Ok(text) => Ok(String::from_utf8_lossy(&text).lines().filter_map(|line| line.parse().ok()).collect()),
            Err(BackendError::Missing) => Ok(Vec::new()),
            Err(fault) => Err(fault),
        }
    }

    /// A batch, from the folder where it is kept or from the place. One that is damaged there is left out, with a warning.
    fn batch(&self, name: &Digest) -> Result<Batch, BackendError> {
        let path = self.cache.as_ref().map(|folder| folder.join(name.to_string()));
        let kept = path.as_ref().and_then(|path| fs::read(path).ok());
        if let Some(batch) = kept.and_then(|bytes| Batch::decode(name, &bytes)) {
            return Ok(batch);
        }
        let bytes = match self.backend.get(&batch_name(name), OBJECT_LIMIT) {
            Err(BackendError::TooLarge { .. }) => Vec::new(),
            bytes => bytes?,
        };
        let Some(batch) = Batch::decode(name, &bytes) else {
            self.breaker.warn(&format!("has damaged records ({}), which are not used", name.short()));
            return Ok(Batch::default());
        };
        self.keep(name, &bytes);
        Ok(batch)
    }

    /// Keeps a batch, so that it need not be fetched again. If that fails it is fetched again.
    pub fn keep(&self, name: &Digest, bytes: &[u8]) {
        let Some(folder) = &self.cache else { return };
        let file = tempfile::Builder::new().prefix(HALF_WRITTEN).tempfile_in(folder);
        let write = |mut file: tempfile::NamedTempFile| {
            std::io::Write::write_all(&mut file, bytes)?;
            Sharing::of(folder).give(file.as_file(), FILE)?;
            file.persist(folder.join(name.to_string())).map_err(|fault| fault.error)
        };
        drop(file.and_then(write));
    }

    /// Removes kept batches that are not in the place any more.
    fn forget_cached(&self, names: &[Digest]) {
        let Some(folder) = &self.cache else { return };
        let names: std::collections::HashSet<&Digest> = names.iter().collect();
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_str().and_then(|name| name.parse::<Digest>().ok());
            if name.is_some_and(|name| !names.contains(&name)) {
                drop(fs::remove_file(entry.path()));
            }
        }
    }

    pub fn read<T>(&self, look: impl FnOnce(&Contents) -> T) -> T {
        look(&self.contents.read().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    pub fn edit<T>(&self, edit: impl FnOnce(&mut Contents) -> T) -> T {
        edit(&mut self.contents.write().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// Writes the list of batches, for places that cannot be listed.
    pub fn write_index(&self) -> Result<(), BackendError> {
        let text: String = self.read(|contents| contents.batches().map(|name| format!("{name}\n")).collect());
        self.backend.put(INDEX, text.as_bytes())
    }
}
