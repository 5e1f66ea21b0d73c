//! Removal of what a plan says, beside whoever is using the store.
//!
//! Segments are written anew without what leaves, then the old ones go; segments another process is writing to stay as
//! they are, and so do the records in them and the blobs those name. Whoever had read an old segment finds it gone, reads
//! the list of segments again, and goes on.
//!
//! # Runs beside it
//!
//! What a plan says is looked at again right before it leaves. A record stays if a live run references it by then, if it
//! was written again, and if a run has just begun or has come and gone since, whose references are not known;
//! runs that begin later see what is left. A blob stays if a record that stays names it, or if it was put again: a
//! [`Store::put`] of what is there marks it. A run that references a record at the moment of its removal makes
//! it again.

use std::collections::BTreeSet;

use super::GcPlan;
use crate::error::{At, StoreError};
use crate::frame::Kind;
use crate::memory::ANSWERS;
use crate::open::QUARANTINE;
use crate::rewrite::{Claimed, Leaving};
use crate::{Digest, Record, Store};

/// Number and size of what a collection removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Collected {
    /// Blobs that were removed.
    pub blobs: u64,
    /// Records that were removed.
    pub records: u64,
    /// Bytes by which the store is smaller on disk.
    pub bytes: u64,
    /// Segments that could not be written anew because a process is writing to them.
    pub busy_segments: u64,
    /// Records that were to be removed and stay, since a run may reference them or is writing to their segment.
    pub spared_records: u64,
}

impl Store {
    /// Removes what `plan` says, unless it has come to be used since, and damaged blobs that were set aside.
    pub fn collect(&self, plan: &GcPlan) -> Result<Collected, StoreError> {
        let before = self.disk_bytes()?;
        // On a full disk this makes room for the segments that are written anew.
        for folder in [QUARANTINE, ANSWERS] {
            self.empty(folder)?;
        }
        let claimed = self.journal().claim_all(|segment| self.machine().may_be_written_elsewhere(segment))?;
        let busy_segments = claimed.busy();
        let mut large = 0;
        let (left, named) = match self.leave_segments(plan, &claimed) {
            Err(StoreError::DiskFull { .. }) => {
                large = self.make_room(plan, &claimed)?;
                self.leave_segments(plan, &claimed)?
            }
            left => left?,
        };
        drop(claimed);
        // Records first: none may name a blob that has left.
        let small = left.blobs.keys().filter(|digest| !self.is_small(digest)).count() as u64;
        large += self.remove_blobs(plan, &named)?;
        let blobs = small + large;
        let records = left.records.keys().filter(|key| !self.has_record(key)).count() as u64;
        let spared_records = plan.records.len() as u64 - records;
        let bytes = before.saturating_sub(self.disk_bytes()?);
        Ok(Collected { blobs, records, bytes, busy_segments, spared_records })
    }

    /// Removes the large blobs of a plan but for those that are `named`; returns how many.
    fn remove_blobs(&self, plan: &GcPlan, named: &BTreeSet<Digest>) -> Result<u64, StoreError> {
        let mut removed = 0;
        for item in plan.blobs.iter().filter(|item| !named.contains(&item.digest)) {
            removed += u64::from(self.blobs().remove(&item.digest, plan.since_s)?);
        }
        Ok(removed)
    }

    /// Removes large blobs before the records that name them, on a disk with no room for segments that are written anew. A record whose
    /// blob is missing is recomputed where it is needed, and these are about to leave.
    fn make_room(&self, plan: &GcPlan, claimed: &Claimed) -> Result<u64, StoreError> {
        let mut leaving = self.claimed_leaving(plan, claimed)?;
        let _gate = self.gate()?;
        self.refresh()?;
        self.spare_used(plan, &mut leaving)?;
        let named = self.spare_named(&mut leaving);
        self.remove_blobs(plan, &named)
    }

    /// What is to leave of the claimed segments.
    fn claimed_leaving(&self, plan: &GcPlan, claimed: &Claimed) -> Result<Leaving, StoreError> {
        let mut leaving = plan.leaving.clone();
        let busy = self.journal().busy_names(claimed)?;
        leaving.records.retain(|key, _| !busy.contains(key));
        leaving.notes.retain(|name, _| !busy.contains(name));
        Ok(leaving)
    }

    /// Writes the claimed segments anew without what leaves; returns that, and the blobs that records which stay name.
    fn leave_segments(&self, plan: &GcPlan, claimed: &Claimed) -> Result<(Leaving, BTreeSet<Digest>), StoreError> {
        let mut leaving = self.claimed_leaving(plan, claimed)?;
        self.spare_used(plan, &mut leaving)?;
        let mut named = self.spare_named(&mut leaving);
        self.journal().copy_all(claimed, |header| !leaving.has(header))?;
        let _gate = self.gate()?;
        self.refresh()?;
        let first = leaving.clone();
        self.spare_used(plan, &mut leaving)?;
        if leaving != first {
            named = self.spare_named(&mut leaving);
            self.journal().copy_all(claimed, |header| first.has(header) && !leaving.has(header))?;
        }
        self.journal().remove(claimed)?;
        Ok((leaving, named))
    }

    /// Spares the records that runs reference by now, and all where that is not known.
    fn spare_used(&self, plan: &GcPlan, leaving: &mut Leaving) -> Result<(), StoreError> {
        let live = self.live()?;
        let is_unknown = live.is_looking || self.noted() > plan.noted;
        leaving.records.retain(|key, _| !is_unknown && !live.keys.contains(key));
        Ok(())
    }

    /// Spares the small blobs that records name which stay; returns all blobs they name.
    fn spare_named(&self, leaving: &mut Leaving) -> BTreeSet<Digest> {
        let stamp = |key: &Digest| self.journal().with_index(|index| index.stamp(Kind::Record, key));
        let keys = self.keys();
        let staying = keys.iter().filter(|key| leaving.records.get(key).copied() != stamp(key));
        let blobs = |record: Record| record.blobs().map(|(digest, _)| digest).collect::<Vec<_>>();
        let named: BTreeSet<Digest> = staying.filter_map(|key| self.record(key)).flat_map(blobs).collect();
        leaving.blobs.retain(|digest, _| !named.contains(digest));
        named
    }

    fn disk_bytes(&self) -> Result<u64, StoreError> {
        let stat = self.stat()?;
        Ok(stat.large_blob_bytes + stat.segment_bytes)
    }

    pub(super) fn empty(&self, folder: &str) -> Result<(), StoreError> {
        let folder = self.dir().join(folder);
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(fault) => return Err(StoreError::io("list", &folder, fault)),
        };
        for entry in entries {
            let path = entry.at("list", &folder)?.path();
            // Whatever stood in the place of a blob was set aside, be it a folder.
            let is_folder = crate::plain::is_folder(&path);
            match if is_folder { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) } {
                Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => {}
                removed => removed.at("remove", &path)?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GcPolicy;
    use crate::frame::Header;

    /// A store with one small blob that was put two hours ago, in a segment nobody writes to.
    fn aged() -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let two_hours_ago = std::time::UNIX_EPOCH.elapsed().unwrap().as_nanos() as u64 - 7_200_000_000_000;
        let header = Header::of(Kind::Blob, Digest::of(b"small"), two_hours_ago, b"small");
        store.journal().append_again(&header, b"small").unwrap();
        drop(store);
        let store = Store::open(folder.path()).unwrap();
        (folder, store)
    }

    #[test]
    fn a_small_blob_put_long_ago_is_put_again_and_then_stays() {
        let (folder, store) = aged();
        let run = Store::open(folder.path()).unwrap();
        let plan = store.plan_gc(&GcPolicy { grace_s: 3600, ..GcPolicy::default() }).unwrap();
        assert_eq!(plan.blobs.len(), 1);
        for _ in 0..2 {
            run.put(b"small").unwrap();
        }
        assert!(run.place(&Digest::of(b"small")).unwrap().is_recent());
        assert_eq!(store.collect(&plan).unwrap().blobs, 0);
        drop((store, run));
        assert_eq!(Store::open(folder.path()).unwrap().get(&Digest::of(b"small")).unwrap(), b"small");
    }

    #[test]
    fn a_small_blob_nobody_puts_leaves() {
        let (folder, store) = aged();
        let plan = store.plan_gc(&GcPolicy { grace_s: 3600, ..GcPolicy::default() }).unwrap();
        assert_eq!(store.collect(&plan).unwrap().blobs, 1);
        assert!(!Store::open(folder.path()).unwrap().contains(&Digest::of(b"small")));
    }
}
