//! Removal of what a plan says, beside whoever is using the store.
//!
//! Segments are written anew without what leaves, then the old ones go; segments another process is writing to stay as
//! they are. Whoever had read an old segment finds it gone, reads the list of segments again, and goes on. A run that
//! counted on a blob that left makes it again.

use std::collections::BTreeSet;

use super::GcPlan;
use crate::error::{At, StoreError};
use crate::open::{ANSWERS, QUARANTINE};
use crate::{Digest, Store};

/// What was removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Collected {
    /// Blobs that left.
    pub blobs: u64,
    /// Records that left.
    pub records: u64,
    /// Bytes by which the store is smaller on disk.
    pub bytes: u64,
    /// Segments that could not be written anew because a process is writing to them.
    pub busy_segments: u64,
}

impl Store {
    /// Removes what `plan` says, and damaged blobs that were set aside.
    pub fn collect(&self, plan: &GcPlan) -> Result<Collected, StoreError> {
        let before = self.disk_bytes()?;
        let records: BTreeSet<Digest> = plan.records.iter().copied().collect();
        let blobs: BTreeSet<Digest> = plan.blobs.iter().map(|item| item.digest).collect();
        // Records first: none may name a blob that has left.
        let busy_segments = self.journal().rewrite(&records, &blobs)?;
        for digest in &blobs {
            self.blobs().remove(digest)?;
        }
        for folder in [QUARANTINE, ANSWERS] {
            self.empty(folder)?;
        }
        let bytes = before.saturating_sub(self.disk_bytes()?);
        Ok(Collected { blobs: blobs.len() as u64, records: records.len() as u64, bytes, busy_segments })
    }

    fn disk_bytes(&self) -> Result<u64, StoreError> {
        let stat = self.stat()?;
        Ok(stat.large_blob_bytes + stat.segment_bytes)
    }

    fn empty(&self, folder: &str) -> Result<(), StoreError> {
        let folder = self.dir().join(folder);
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(fault) => return Err(StoreError::io("list", &folder, fault)),
        };
        for entry in entries {
            let path = entry.at("list", &folder)?.path();
            std::fs::remove_file(&path).at("remove", &path)?;
        }
        Ok(())
    }
}
