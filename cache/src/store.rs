//! The store: blobs by digest, records by key (signatures; the bodies follow).
#![allow(clippy::todo, unused_variables, dead_code)]

use std::path::Path;

use serde_json::Value;

use crate::{Digest, Record, StoreError};

/// The store, opened once a process and shared by reference.
#[derive(Debug)]
pub struct Store;

/// How a blob came to be under a name people can read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Materialised {
    /// Shares the blob's extents, copied on write.
    Reflink,
    /// An independent copy.
    Copy,
    /// Another name of the read-only blob itself.
    HardLink,
}

/// The digest of a file outside the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileDigest {
    /// The digest of its bytes.
    pub digest: Digest,
    /// Its size.
    pub bytes: u64,
}

/// The right to compute one key; released on drop, or by the kernel.
#[derive(Debug)]
pub struct KeyLock;

/// What is in the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StoreStat {
    /// Blobs kept inside segments.
    pub small_blobs: u64,
    /// Their bytes.
    pub small_blob_bytes: u64,
    /// Blobs with a file of their own.
    pub large_blobs: u64,
    /// Their bytes.
    pub large_blob_bytes: u64,
    /// Keys with a record.
    pub records: u64,
    /// Notes of former runs.
    pub notes: u64,
    /// Segment files.
    pub segments: u64,
    /// Their bytes.
    pub segment_bytes: u64,
    /// Damaged blobs set aside.
    pub quarantined: u64,
    /// Files outside the store that this handle had to read and hash.
    pub files_hashed: u64,
}

#[allow(missing_docs)]
impl Store {
    pub fn open(dir: &Path) -> Result<Self, StoreError> {
        todo!()
    }
    pub fn put(&self, bytes: &[u8]) -> Result<Digest, StoreError> {
        todo!()
    }
    pub fn contains(&self, digest: &Digest) -> bool {
        todo!()
    }
    pub fn size(&self, digest: &Digest) -> Option<u64> {
        todo!()
    }
    pub fn get(&self, digest: &Digest) -> Result<Vec<u8>, StoreError> {
        todo!()
    }
    pub fn materialise(&self, digest: &Digest, to: &Path) -> Result<Materialised, StoreError> {
        todo!()
    }
    pub fn record(&self, key: &Digest) -> Option<Record> {
        todo!()
    }
    pub fn is_hit(&self, key: &Digest) -> Option<Record> {
        todo!()
    }
    pub fn commit(&self, record: &Record) -> Result<Digest, StoreError> {
        todo!()
    }
    pub fn lock(&self, key: &Digest, on_wait: impl FnOnce()) -> Result<KeyLock, StoreError> {
        todo!()
    }
    pub fn try_lock(&self, key: &Digest) -> Result<Option<KeyLock>, StoreError> {
        todo!()
    }
    pub fn refresh(&self) -> Result<(), StoreError> {
        todo!()
    }
    pub fn sync(&self) -> Result<(), StoreError> {
        todo!()
    }
    pub fn remember_run(&self, plan_key: &Digest, json: &Value) -> Result<(), StoreError> {
        todo!()
    }
    pub fn recalled_run(&self, plan_key: &Digest) -> Option<Value> {
        todo!()
    }
    pub fn hash_file(&self, path: &Path) -> Result<FileDigest, StoreError> {
        todo!()
    }
    pub fn stat(&self) -> Result<StoreStat, StoreError> {
        todo!()
    }
}
