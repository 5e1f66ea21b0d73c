//! Verification: every blob is read and compared with its digest, every record with the blobs it promises, and every segment
//! is read from end to end.

use std::collections::{BTreeMap, BTreeSet};

use super::{HalfWritten, SegmentFault};
use crate::error::{At, StoreError};
use crate::frame::Kind;
use crate::{Digest, Store};

/// What is wrong with a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FaultKind {
    /// Its bytes do not have its digest.
    Damaged,
    /// A record promises it and it is not there.
    Missing,
}

/// A blob that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Fault {
    /// Whether it is damaged or missing.
    pub kind: FaultKind,
    /// The digest of the blob.
    pub digest: Digest,
    /// The outputs that it is, as `kind of stage`; empty where no record names it.
    pub outputs: Vec<String>,
    /// Whether it was set aside, so that the next run that needs it recomputes it.
    pub set_aside: bool,
}

/// What a verification found.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize)]
pub struct Verified {
    /// Number of blobs that were read.
    pub blobs: u64,
    /// Size of the blobs that were read.
    pub bytes: u64,
    /// Number of whole records, whose blobs were looked for.
    pub records: u64,
    /// What is not as it should be, by digest.
    pub faults: Vec<Fault>,
    /// What is damaged inside segments.
    pub segment_faults: Vec<SegmentFault>,
    /// Whether the segments were written anew, without what is damaged in them.
    pub rewritten: bool,
    /// Segments that were to be written anew and are being written to: what is damaged in them stays for now.
    pub busy_segments: u64,
    /// What killed processes left at the ends of segments; no damage.
    pub half_written: Vec<HalfWritten>,
}

impl Store {
    /// Reads everything and compares it with its digest. With `repair`, damaged blobs are set aside, and damaged segments are
    /// written anew; without, nothing is changed.
    pub fn verify(&self, repair: bool) -> Result<Verified, StoreError> {
        let named = self.named_blobs();
        let is_whole = |key: &&Digest| self.journal().with_index(|index| index.payload(Kind::Record, key).is_some());
        let records = self.keys().iter().filter(is_whole).count() as u64;
        let (segment_faults, half_written) = self.verify_segments()?;
        let mut found = Verified { records, segment_faults, half_written, ..Verified::default() };
        for digest in self.small_blobs() {
            let (read, bytes) = self.read_small(&digest)?;
            self.verify_one(&digest, read, bytes, &named, repair, &mut found)?;
        }
        for digest in self.blobs().list()? {
            let file = match self.blobs().open(&digest) {
                // Removed since it was listed; reported below if a record names it.
                Err(StoreError::Missing { .. }) => continue,
                // No plain file: nothing to read, and set aside by the opening.
                Err(StoreError::Damaged { .. }) => {
                    found.faults.push(damaged(&digest, &named, true));
                    continue;
                }
                file => file?,
            };
            let (read, bytes) = Digest::of_reader(file).at("read", &self.blobs().path(&digest))?;
            self.verify_one(&digest, read, bytes, &named, repair, &mut found)?;
        }
        let damaged: BTreeSet<Digest> = found.faults.iter().map(|fault| fault.digest).collect();
        for (digest, outputs) in named.iter().filter(|(digest, _)| !damaged.contains(digest)) {
            if !self.is_there(digest)? {
                let (kind, outputs) = (FaultKind::Missing, outputs.clone());
                found.faults.push(Fault { kind, digest: *digest, outputs, set_aside: false });
            }
        }
        found.faults.sort_by_key(|fault| fault.digest);
        if repair && !found.segment_faults.is_empty() {
            found.busy_segments = self.rewrite_segments()?;
            found.rewritten = true;
        }
        Ok(found)
    }

    /// Whether a blob is in the store. One that cannot be looked at is an error, not missing.
    fn is_there(&self, digest: &Digest) -> Result<bool, StoreError> {
        let path = self.blobs().path(digest);
        Ok(self.is_small(digest) || path.try_exists().at("look at", &path)?)
    }

    fn read_small(&self, digest: &Digest) -> Result<(Digest, u64), StoreError> {
        let bytes = self.place(digest).map_or(Ok(Vec::new()), |place| self.journal().read(place))?;
        Ok((Digest::of(&bytes), bytes.len() as u64))
    }

    fn verify_one(
        &self,
        digest: &Digest,
        read: Digest,
        bytes: u64,
        named: &BTreeMap<Digest, Vec<String>>,
        repair: bool,
        found: &mut Verified,
    ) -> Result<(), StoreError> {
        found.blobs += 1;
        found.bytes += bytes;
        if read == *digest {
            return Ok(());
        }
        if repair {
            self.set_aside(digest)?;
        }
        found.faults.push(damaged(digest, named, repair));
        Ok(())
    }

    fn set_aside(&self, digest: &Digest) -> Result<(), StoreError> {
        match self.get(digest) {
            // Whole after all, gone meanwhile, or set aside by the reading.
            Ok(_) | Err(StoreError::Damaged { .. } | StoreError::Missing { .. }) => Ok(()),
            Err(fault) => Err(fault),
        }
    }

    /// The blobs that records promise, each with the outputs that it is.
    pub(super) fn named_blobs(&self) -> BTreeMap<Digest, Vec<String>> {
        let mut named: BTreeMap<Digest, Vec<String>> = BTreeMap::new();
        for record in self.keys().iter().filter_map(|key| self.record(key)) {
            let stage = &record.recipe.stage;
            let kept = record.outputs.values().filter(|output| output.kept);
            let outputs = kept.map(|output| (output.digest, format!("{} of {stage}", output.kind)));
            let told = [(record.log, "log"), (record.sketches, "sketches")];
            let told = told.into_iter().filter_map(|(blob, what)| Some((blob?, format!("{what} of {stage}"))));
            for (digest, what) in outputs.chain(told) {
                let outputs = named.entry(digest).or_default();
                if !outputs.contains(&what) {
                    outputs.push(what);
                }
            }
        }
        named
    }

    /// All blobs inside segments, sorted.
    pub(super) fn small_blobs(&self) -> Vec<Digest> {
        self.journal().with_index(|index| index.names(Kind::Blob))
    }
}

fn damaged(digest: &Digest, named: &BTreeMap<Digest, Vec<String>>, set_aside: bool) -> Fault {
    let outputs = named.get(digest).cloned().unwrap_or_default();
    Fault { kind: FaultKind::Damaged, digest: *digest, outputs, set_aside }
}
