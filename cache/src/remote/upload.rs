//! Uploading in the background: large blobs, then small ones packed, then the records that name them, many at once.

use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::backend::{Backend, BackendError};
use super::batch::{Batch, Place};
use super::claims::Claims;
use super::open::Shared;
use super::{AT_ONCE, batch_name, blob_name, each_at_once, pack_name};
use crate::{Digest, Outcome};

/// Blobs of this size and more get an object of their own.
const LARGE_BYTES: u64 = 64 * 1024;
/// A pack that has grown beyond this is not continued.
const PACK_BYTES: usize = 8 << 20;
/// Records of one batch.
const BATCH_RECORDS: usize = 4096;
/// How long a batch waits for further records.
const BATCH_WAIT: Duration = Duration::from_secs(2);
/// The same while others wait for it.
const BATCH_WAIT_AWAITED: Duration = Duration::from_millis(50);
/// How often a batch is tried.
const ATTEMPTS: u32 = 2;

/// Reads a blob of the local store, verified; `None` where it is not there any more.
pub(crate) type ReadBlob = Box<dyn Fn(&Digest) -> Option<Vec<u8>> + Send + Sync>;

/// Number and size of what was uploaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Uploaded {
    /// Number of records that were uploaded.
    pub records: u64,
    /// Blobs that were not there.
    pub blobs: u64,
    /// Their total size in bytes.
    pub bytes: u64,
    /// Records that could not be uploaded, or whose blobs were gone.
    pub failed: u64,
}

/// A thread that uploads.
#[derive(Debug)]
pub(super) struct Uploader {
    queue: Arc<Queue>,
    thread: Option<std::thread::JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Queue {
    state: Mutex<State>,
    changed: Condvar,
    /// Set when nobody waits for the rest.
    is_abandoned: AtomicBool,
}

#[derive(Debug, Default)]
struct State {
    /// Records that are not uploaded yet, with their keys, in the order they were offered.
    waiting: Vec<(Digest, Box<[u8]>)>,
    /// Keys that were offered.
    offered: HashSet<Digest>,
    is_closing: bool,
    has_ended: bool,
    done: Uploaded,
}

impl Queue {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next records to upload together; `None` at the end.
    fn next(&self, claims: &Claims) -> Option<Vec<(Digest, Box<[u8]>)>> {
        let mut state = self.state();
        let mut first: Option<Instant> = None;
        loop {
            if self.is_abandoned.load(Relaxed) {
                return None;
            }
            let batch_wait = if claims.are_awaited() { BATCH_WAIT_AWAITED } else { BATCH_WAIT };
            let is_due = state.is_closing || state.waiting.len() >= BATCH_RECORDS;
            let waited = first.map(|first| first.elapsed()).unwrap_or_default();
            if !state.waiting.is_empty() && (is_due || waited >= batch_wait) {
                let count = state.waiting.len().min(BATCH_RECORDS);
                return Some(state.waiting.drain(..count).collect());
            }
            if state.is_closing {
                return None;
            }
            if !state.waiting.is_empty() {
                first.get_or_insert_with(Instant::now);
            }
            let pause = if first.is_some() { BATCH_WAIT_AWAITED } else { Duration::from_mins(1) };
            state = self.changed.wait_timeout(state, pause).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Uploader {
    /// Starts the thread; `None` where the system gives none.
    pub fn start(shared: Arc<Shared>, claims: Arc<Claims>, read: ReadBlob) -> Option<Self> {
        let queue = Arc::new(Queue::default());
        let own = Arc::clone(&queue);
        let work = move || {
            while let Some(records) = own.next(&claims) {
                let batch = upload_all(&shared, &read, &records, &own);
                let keys: Vec<Digest> = records.iter().map(|(key, _)| *key).collect();
                claims.uploaded(&keys, batch);
            }
            own.state().has_ended = true;
            own.changed.notify_all();
        };
        let thread = std::thread::Builder::new().name("upload".to_owned()).spawn(work).ok()?;
        Some(Self { queue, thread: Some(thread) })
    }

    /// Takes a record, unless it has it already; says whether it did.
    pub fn offer(&self, key: Digest, payload: &[u8]) -> bool {
        let mut state = self.queue.state();
        let is_new = state.offered.insert(key);
        if is_new {
            state.waiting.push((key, payload.into()));
            if state.waiting.len() == 1 || state.waiting.len() >= BATCH_RECORDS {
                self.queue.changed.notify_all();
            }
        }
        is_new
    }

    /// Waits until all is uploaded, or `stop` is set.
    pub fn finish(mut self, stop: &AtomicBool) -> Uploaded {
        let mut state = self.queue.state();
        state.is_closing = true;
        self.queue.changed.notify_all();
        while !state.has_ended && !stop.load(Relaxed) {
            let waited = self.queue.changed.wait_timeout(state, Duration::from_millis(50));
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
        let done = state.done;
        let has_ended = state.has_ended;
        drop(state);
        if let Some(thread) = self.thread.take().filter(|_| has_ended) {
            drop(thread.join());
        }
        done
    }
}

impl Drop for Uploader {
    fn drop(&mut self) {
        self.queue.is_abandoned.store(true, Relaxed);
        self.queue.changed.notify_all();
    }
}

/// Uploads records with their blobs, in several batches where they are many.
/// The name of the batch.
fn upload_all(shared: &Shared, read: &ReadBlob, records: &[(Digest, Box<[u8]>)], queue: &Queue) -> Option<Digest> {
    let count = records.len() as u64;
    if shared.breaker.is_off() {
        queue.state().done.failed += count;
        return None;
    }
    let mut result = Err(BackendError::Missing);
    for _ in 0..ATTEMPTS {
        if queue.is_abandoned.load(Relaxed) {
            return None;
        }
        result = upload(shared, read, records);
        if result.is_ok() || shared.breaker.is_off() {
            break;
        }
    }
    let mut state = queue.state();
    match result {
        Ok((done, batch)) => {
            state.done.records += done.records;
            state.done.blobs += done.blobs;
            state.done.bytes += done.bytes;
            state.done.failed += done.failed;
            batch
        }
        Err(fault) => {
            state.done.failed += count;
            drop(state);
            shared.breaker.warn_once(&format!("did not take all results: {fault}"));
            None
        }
    }
}

/// Blobs on their way.
#[derive(Default)]
struct Going {
    batch: Batch,
    pack: Vec<u8>,
    /// The blobs of the pack, and where they start in it.
    packed: Vec<(Digest, u64, u64)>,
    done: Uploaded,
    fault: Option<BackendError>,
}

/// Uploads the blobs of some records that are not there, and then the records; also returns the name of their batch.
fn upload(
    shared: &Shared,
    read: &ReadBlob,
    records: &[(Digest, Box<[u8]>)],
) -> Result<(Uploaded, Option<Digest>), BackendError> {
    let mut sizes: HashMap<Digest, Option<u64>> = HashMap::new();
    let mut named: Vec<(Digest, &[u8], Vec<Digest>)> = Vec::new();
    for (key, payload) in records {
        let Some(outcome) = Outcome::decode(payload) else { continue };
        named.push((*key, payload, outcome.blobs().map(|(digest, _)| digest).collect()));
        for (digest, bytes) in outcome.blobs() {
            let known = sizes.entry(digest).or_default();
            *known = known.or(bytes);
        }
    }
    let going = Mutex::new(Going::default());
    let locked = || going.lock().unwrap_or_else(PoisonError::into_inner);
    let mut absent = Vec::new();
    for digest in sizes.into_keys() {
        match shared.read(|contents| contents.place(&digest)) {
            Some(place) => {
                locked().batch.blobs.insert(digest, place);
            }
            None => absent.push(digest),
        }
    }
    absent.sort_unstable();
    each_at_once(absent, AT_ONCE / 2, |digest| {
        if locked().fault.is_some() {
            return;
        }
        // One that is gone, or damaged, takes its record with it.
        let Some(blob) = read(&digest) else { return };
        if let Err(fault) = put_blob(shared, &going, digest, blob) {
            locked().fault = Some(fault);
        }
    });
    let mut going = going.into_inner().unwrap_or_else(PoisonError::into_inner);
    if let Some(fault) = going.fault.take() {
        return Err(fault);
    }
    put_pack(shared, &mut going)?;
    let Going { mut batch, mut done, .. } = going;
    for (key, payload, blobs) in named {
        if blobs.iter().all(|digest| batch.blobs.contains_key(digest)) {
            batch.records.insert(key, payload.into());
        }
    }
    done.records = batch.records.len() as u64;
    done.failed = records.len() as u64 - done.records;
    if done.records == 0 {
        return Ok((done, None));
    }
    let (name, bytes) = batch.encode();
    shared.breaker.attempt(|| shared.backend.put(&batch_name(&name), &bytes))?;
    shared.keep(&name, &bytes);
    shared.edit(|contents| contents.enter_own(name, batch));
    Ok((done, Some(name)))
}

/// Uploads a large blob; a small one goes into the pack, which is uploaded when it is full.
fn put_blob(shared: &Shared, going: &Mutex<Going>, digest: Digest, blob: Vec<u8>) -> Result<(), BackendError> {
    let bytes = blob.len() as u64;
    let is_large = bytes >= LARGE_BYTES;
    if is_large {
        shared.breaker.attempt(|| shared.backend.put(&blob_name(&digest), &blob))?;
    }
    let mut going = going.lock().unwrap_or_else(PoisonError::into_inner);
    going.done.blobs += 1;
    going.done.bytes += bytes;
    if is_large {
        going.batch.blobs.insert(digest, Place { pack: None, at: 0, bytes });
        return Ok(());
    }
    let at = going.pack.len() as u64;
    going.pack.extend(blob);
    going.packed.push((digest, at, bytes));
    if going.pack.len() < PACK_BYTES { Ok(()) } else { put_pack(shared, &mut going) }
}

fn put_pack(shared: &Shared, going: &mut Going) -> Result<(), BackendError> {
    if going.packed.is_empty() {
        return Ok(());
    }
    let (pack, packed) = (std::mem::take(&mut going.pack), std::mem::take(&mut going.packed));
    let name = Digest::of(&pack);
    shared.breaker.attempt(|| shared.backend.put(&pack_name(&name), &pack))?;
    let placed = packed.into_iter().map(|(digest, at, bytes)| (digest, Place { pack: Some(name), at, bytes }));
    going.batch.blobs.extend(placed);
    Ok(())
}
