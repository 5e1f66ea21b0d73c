//! A remote place for results, as a layer under the local store: an object store such as S3, or a folder.
//!
//! # Layout
//!
//! ```text
//! format            the format version, one line
//! blobs/ab/abcd…    blobs of 64 KiB and more, one object each, named by their BLAKE3
//! packs/abcd…       small blobs one after another, named by the BLAKE3 of the whole
//! records/abcd…     batches of records, and where the blobs are that they name; named by the BLAKE3 of the whole
//! index             the names of all batches, for places that cannot be listed; written last
//! claims/000…17     who computes what, by entries in order; written on condition that there is none of the number
//! workers/…         what a live process holds of that; written again every five seconds
//! handed/abcd…      a value that is not kept, on its way from one process to another
//! ```
//!
//! # Invariants
//!
//! - **Nothing is ever edited**: every object that holds results is named by the digest of its bytes.
//! - **Blobs before records**: a batch is written after the blobs it names.
//! - **Everything is verified**: objects by their names, blobs by their digests, records by the keys of their recipes.
//! - **A place that fails costs time, never results**: what cannot be fetched is computed, and after a few failures in
//!   succession the place is left alone.

mod backend;
mod batch;
mod breaker;
mod care;
mod claims;
mod contents;
mod fetch;
mod folder;
mod layer;
mod memory;
mod open;
mod traffic;
mod upload;

pub use backend::{Backend, BackendError, Object};
pub use breaker::Warn;
pub use care::{RemoteGc, RemoteGcPolicy, RemoteStat};
pub use folder::Folder;
pub use memory::InMemory;
pub use open::{Remote, Use};
pub use traffic::Traffic;
pub use upload::Uploaded;

pub(crate) use claims::{Claim, Claims, Having};

use crate::Digest;

/// What the format object says.
pub(crate) const FORMAT: &str = "rockface remote 1";
/// The object that says so.
pub(crate) const FORMAT_NAME: &str = "format";
/// The list of batches for places that cannot be listed.
pub(crate) const INDEX: &str = "index";
/// Starts the names of batches.
pub(crate) const RECORDS: &str = "records/";
/// Starts the names of packs.
pub(crate) const PACKS: &str = "packs/";
/// Starts the names of large blobs.
pub(crate) const BLOBS: &str = "blobs/";
/// A batch or a pack that is larger was not written by this program.
pub(crate) const OBJECT_LIMIT: u64 = 256 << 20;
/// Objects that are read or written at the same time.
pub(crate) const AT_ONCE: usize = 8;

/// The name of a large blob.
pub(crate) fn blob_name(digest: &Digest) -> String {
    digest.hex(|text| format!("{BLOBS}{}/{text}", &text[..2]))
}

/// The name of a pack.
pub(crate) fn pack_name(digest: &Digest) -> String {
    format!("{PACKS}{digest}")
}

/// The name of a batch.
pub(crate) fn batch_name(digest: &Digest) -> String {
    format!("{RECORDS}{digest}")
}

/// The digest at the end of the name of an object.
pub(crate) fn digest_of(name: &str) -> Option<Digest> {
    name.rsplit('/').next()?.parse().ok()
}

/// Does `work` for each of some things, several at a time.
pub(crate) fn each_at_once<T: Send>(things: Vec<T>, at_once: usize, work: impl Fn(T) + Sync) {
    let queue = std::sync::Mutex::new(things.into_iter());
    let next = || queue.lock().unwrap_or_else(std::sync::PoisonError::into_inner).next();
    let all = || {
        while let Some(thing) = next() {
            work(thing);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..at_once {
            // Where the system gives no thread, this one does the work.
            if std::thread::Builder::new().spawn_scoped(scope, all).is_err() {
                break;
            }
        }
        all();
    });
}
