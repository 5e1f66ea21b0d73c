//! Commands on a remote place: what is in it, the removal of what is old, and copies to and from a store.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::PoisonError;
use std::sync::atomic::AtomicBool;

use super::backend::{Backend, Object};
use super::batch::{Batch, Place};
use super::claims::{CLAIMS, HANDED, WORKERS, entry_number};
use super::open::{Remote, Shared};
use super::{AT_ONCE, BLOBS, PACKS, RECORDS, batch_name, digest_of, each_at_once};
use crate::error::StoreError;
use crate::frame::Kind;
use crate::maintenance::Handed;
use crate::{Digest, Outcome, Record, Store};

/// Objects younger than this are never removed, seconds: a record that names them may be on its way.
const GRACE_S: u64 = 3600;
/// Records of one batch that a collection writes.
const BATCH_RECORDS: usize = 4096;

/// What is in a remote place.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize)]
pub struct RemoteStat {
    /// Keys that have a record.
    pub records: u64,
    /// Number of objects that hold records, many in each.
    pub batches: u64,
    /// Total size of the objects with records.
    pub batch_bytes: u64,
    /// Objects with small blobs.
    pub packs: u64,
    /// Total size of the packs.
    pub pack_bytes: u64,
    /// Objects with one large blob.
    pub large_blobs: u64,
    /// Total size of the blobs in files of their own.
    pub large_blob_bytes: u64,
    /// Records that name blobs which are not there: their steps run again.
    pub incomplete: u64,
}

/// What of a remote place is kept. It has no runs and keeps no times of use, so the age of a record decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RemoteGcPolicy {
    /// Remove the records of steps that ended that long ago, whole seconds: 0 takes those of this very second too.
    pub max_age_s: Option<u64>,
    /// Remove the oldest records until the blobs of the others take no more bytes.
    pub max_bytes: Option<u64>,
    /// Only count, remove nothing.
    pub dry_run: bool,
}

/// What a collection removed, or would remove.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct RemoteGc {
    /// Number of records that were removed, or would be.
    pub records: u64,
    /// Packs and large blobs.
    pub objects: u64,
    /// Their total size in bytes.
    pub bytes: u64,
    /// Records that are kept.
    pub kept_records: u64,
    /// Batches before and after: many small ones are put together.
    pub batches: (u64, u64),
}

impl Remote {
    /// The keys of all records, sorted.
    pub fn keys(&self) -> Vec<Digest> {
        let mut keys: Vec<Digest> = self.shared.read(|contents| contents.keys().copied().collect());
        keys.sort_unstable();
        keys
    }

    /// Counts what is there.
    pub fn stat(&self) -> Result<RemoteStat, StoreError> {
        let [batches, packs, blobs] = self.listed()?;
        let there: BTreeSet<Digest> = packs.iter().chain(&blobs).filter_map(|object| digest_of(&object.name)).collect();
        let sum = |objects: &[Object]| objects.iter().map(|object| object.bytes).fold(0, u64::saturating_add);
        let incomplete = self.shared.read(|contents| {
            let has = |digest: &Digest| {
                contents.place(digest).is_some_and(|place| there.contains(&place.pack.unwrap_or(*digest)))
            };
            let outcomes = contents.keys().filter_map(|key| Outcome::decode(contents.record(key)?));
            outcomes.filter(|outcome| !outcome.blobs().all(|(digest, _)| has(&digest))).count() as u64
        });
        Ok(RemoteStat {
            records: self.keys().len() as u64,
            batches: batches.len() as u64,
            batch_bytes: sum(&batches),
            packs: packs.len() as u64,
            pack_bytes: sum(&packs),
            large_blobs: blobs.len() as u64,
            large_blob_bytes: sum(&blobs),
            incomplete,
        })
    }

    fn listed(&self) -> Result<[Vec<Object>; 3], StoreError> {
        let list = |prefix| self.shared.backend.list(prefix).map_err(|fault| fault.at("list", &self.shared.backend));
        Ok([list(RECORDS)?, list(PACKS)?, list(BLOBS)?])
    }

    /// Removes old records, and the packs and large blobs that no record names, an hour after they were written; puts small
    /// batches together. Safe beside others who read and write: what they miss afterwards is computed.
    pub fn collect(&self, policy: &RemoteGcPolicy, now_unix_s: u64) -> Result<RemoteGc, StoreError> {
        let [batches, packs, blobs] = self.listed()?;
        let kept = self.kept(policy, now_unix_s);
        let total = self.keys().len();
        let used: BTreeSet<Digest> = kept.blobs.iter().map(|(digest, place)| place.pack.unwrap_or(*digest)).collect();
        // By the clock of the place: its latest object is no younger than now.
        let clock_s =
            batches.iter().chain(&packs).chain(&blobs).map(|object| object.modified_unix_s).max().unwrap_or(0);
        let clock_s = clock_s.max(now_unix_s);
        let is_unused = |object: &&Object| {
            let is_old = clock_s.saturating_sub(object.modified_unix_s) > GRACE_S;
            is_old && digest_of(&object.name).is_some_and(|digest| !used.contains(&digest))
        };
        let unused: Vec<Object> = packs.iter().chain(&blobs).filter(is_unused).cloned().collect();
        let new = divided(&kept);
        let mut done = RemoteGc {
            records: (total - kept.records.len()) as u64,
            objects: unused.len() as u64,
            bytes: unused.iter().map(|object| object.bytes).fold(0, u64::saturating_add),
            kept_records: kept.records.len() as u64,
            batches: (batches.len() as u64, batches.len() as u64),
        };
        let is_rewritten = done.records > 0 || new.len() < batches.len();
        if is_rewritten {
            done.batches.1 = new.len() as u64;
        }
        if policy.dry_run {
            return Ok(done);
        }
        if is_rewritten {
            self.rewrite(new, &batches)?;
        }
        self.delete_all(unused.into_iter().map(|object| object.name).collect())?;
        self.delete_all(self.left_over(clock_s)?)?;
        Ok(done)
    }

    /// What processes that were killed have left: old entries of claims but the last, old objects of workers, values on their way.
    fn left_over(&self, clock_s: u64) -> Result<Vec<String>, StoreError> {
        let mut old = Vec::new();
        for prefix in [CLAIMS, WORKERS, HANDED] {
            let listed = self.shared.backend.list(prefix).map_err(|fault| fault.at("list", &self.shared.backend))?;
            let newest = listed.iter().filter_map(|object| entry_number(&object.name)).max();
            // The numbers go on from the last.
            let is_last = |object: &Object| newest.is_some() && entry_number(&object.name) == newest;
            let is_old = |object: &&Object| clock_s.saturating_sub(object.modified_unix_s) > GRACE_S;
            old.extend(
                listed.iter().filter(is_old).filter(|object| !is_last(object)).map(|object| object.name.clone()),
            );
        }
        Ok(old)
    }

    /// Writes these batches and then removes the former ones.
    fn rewrite(&self, new: Vec<Batch>, former: &[Object]) -> Result<(), StoreError> {
        let shared = &self.shared;
        let mut names = BTreeSet::new();
        for batch in new {
            let (name, bytes) = batch.encode();
            let is_there = former.iter().any(|object| digest_of(&object.name) == Some(name));
            if !is_there {
                let written = shared.backend.put(&batch_name(&name), &bytes);
                written.map_err(|fault| fault.at("write to", &shared.backend))?;
            }
            names.insert(name);
        }
        // Only what was read: a batch that was written meanwhile stays.
        let gone = |object: &&Object| {
            let name = digest_of(&object.name);
            name.is_some_and(|name| !names.contains(&name) && shared.read(|contents| contents.has_batch(&name)))
        };
        self.delete_all(former.iter().filter(gone).map(|object| object.name.clone()).collect())?;
        let index: String = names.iter().map(|name| format!("{name}\n")).collect();
        shared.backend.put(super::INDEX, index.as_bytes()).map_err(|fault| fault.at("write to", &shared.backend))
    }

    fn delete_all(&self, names: Vec<String>) -> Result<(), StoreError> {
        let fault = std::sync::Mutex::new(None);
        each_at_once(names, AT_ONCE, |name| {
            if let Err(error) = self.shared.backend.delete(&name) {
                *fault.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
            }
        });
        let fault = fault.into_inner().unwrap_or_else(PoisonError::into_inner);
        fault.map_or(Ok(()), |fault| Err(fault.at("remove objects from", &self.shared.backend)))
    }

    /// The records that stay, and where their blobs are.
    fn kept(&self, policy: &RemoteGcPolicy, now_unix_s: u64) -> Batch {
        let mut all: Vec<(u64, Digest, Outcome)> = self.shared.read(|contents| {
            let outcome = |key: &Digest| Outcome::decode(contents.record(key)?).map(|outcome| (*key, outcome));
            contents.keys().filter_map(outcome).map(|(key, one)| (one.cost.finished_unix_s, key, one)).collect()
        });
        all.sort_unstable_by_key(|(finished, key, _)| (std::cmp::Reverse(*finished), *key));
        let until_s = policy.max_age_s.map(|age_s| now_unix_s.saturating_sub(age_s));
        let mut batch = Batch::default();
        let mut sum: u64 = 0;
        self.shared.read(|contents| {
            for (finished, key, outcome) in all {
                let places: Option<HashMap<Digest, Place>> =
                    outcome.blobs().map(|(digest, _)| Some((digest, contents.place(&digest)?))).collect();
                // One whose blobs are gone is never a hit.
                let (Some(places), Some(payload)) = (places, contents.record(&key)) else { continue };
                let new = places.iter().filter(|(digest, _)| !batch.blobs.contains_key(digest));
                let more = new.map(|(_, place)| place.bytes).fold(sum, u64::saturating_add);
                if until_s.is_some_and(|until_s| finished <= until_s)
                    || policy.max_bytes.is_some_and(|most| more > most)
                {
                    continue;
                }
                sum = more;
                batch.records.insert(key, payload.into());
                batch.blobs.extend(places);
            }
        });
        batch
    }
}

/// One batch in parts of a size that is read at once.
fn divided(whole: &Batch) -> Vec<Batch> {
    let records: Vec<(&Digest, &[u8])> = whole.records.iter().map(|(key, payload)| (key, &**payload)).collect();
    let part = |records: &[(&Digest, &[u8])]| {
        let blobs = records.iter().filter_map(|(_, payload)| Outcome::decode(payload));
        let named: BTreeMap<Digest, Place> = blobs
            .flat_map(|outcome| outcome.blobs().map(|(digest, _)| digest).collect::<Vec<_>>())
            .filter_map(|digest| Some((digest, *whole.blobs.get(&digest)?)))
            .collect();
        let records = records.iter().map(|(key, payload)| (**key, Box::from(*payload))).collect();
        Batch { records, blobs: named.into_iter().collect() }
    };
    records.chunks(BATCH_RECORDS).map(part).collect()
}

impl Store {
    /// Copies these records and the blobs they name to a remote place.
    pub fn push_to(&self, remote: Remote, keys: &[Digest], stop: &AtomicBool) -> Result<Handed, StoreError> {
        let mut handed = Handed::default();
        let refused = |_| StoreError::Remote {
            action: "write to",
            url: String::new(),
            why: "this store is over a remote place already".to_owned(),
        };
        self.attach(remote).map_err(refused)?;
        for key in keys {
            if self.is_hit(key).is_none() {
                handed.missing += 1;
                continue;
            }
            let payload = self.journal().with_index(|index| index.payload(Kind::Record, key).map(Box::<[u8]>::from));
            payload.iter().for_each(|payload| self.offer(key, payload));
        }
        let done = self.finish_uploads(stop);
        (handed.records, handed.blobs, handed.bytes) = (done.records, done.blobs, done.bytes);
        handed.known = (keys.len() as u64).saturating_sub(handed.missing + done.records + done.failed);
        handed.missing += done.failed;
        let remote = self.remote();
        if let Some(remote) = remote.filter(|remote| remote.is_off()) {
            let why = "it failed before all was copied; the same command goes on from there".to_owned();
            return Err(StoreError::Remote { action: "write to", url: remote.url().to_owned(), why });
        }
        Ok(handed)
    }

    /// Copies these records and the blobs they name from a remote place.
    pub fn pull_from(&self, remote: Remote, keys: &[Digest]) -> Result<Handed, StoreError> {
        let mut handed = Handed::default();
        let mut wanted = Vec::new();
        for key in keys {
            let there = remote.shared.read(|contents| contents.record(key).and_then(Record::decode));
            let Some(there) = there else {
                handed.missing += 1;
                continue;
            };
            if self.is_hit(key).is_some_and(|own| own.same_outcome(&there) || own.keeps_more_than(&there)) {
                handed.known += 1;
            } else {
                wanted.push((*key, there));
            }
        }
        let traffic = |shared: &Shared| shared.backend.traffic();
        drop(self.remote.set(Box::new(remote)));
        let absent: BTreeMap<Digest, u64> = wanted
            .iter()
            .flat_map(|(_, record)| record.blobs().map(|(digest, _)| digest).collect::<Vec<_>>())
            .filter(|digest| self.size_here(digest).is_none())
            .filter_map(|digest| Some((digest, self.size_below(&digest)?)))
            .collect();
        self.bring(absent.keys().copied())?;
        for (_, record) in wanted {
            if record.blobs().all(|(digest, bytes)| self.has_here(&digest, bytes)) {
                self.commit(&record)?;
                handed.records += 1;
            } else {
                handed.missing += 1;
            }
        }
        for (digest, bytes) in absent {
            let came = u64::from(self.size_here(&digest).is_some());
            handed.blobs += came;
            handed.bytes += bytes * came;
        }
        self.sync()?;
        if let Some(remote) = self.remote().filter(|remote| remote.is_off()) {
            let failures = traffic(&remote.shared).failures;
            let why =
                format!("it failed before all was copied ({failures} requests); the same command goes on from there");
            return Err(StoreError::Remote { action: "read from", url: remote.url().to_owned(), why });
        }
        Ok(handed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::remote::{blob_name, pack_name};

    #[test]
    fn names_of_objects_tell_their_digests() {
        let digest = Digest::of(b"blob");
        for name in [blob_name(&digest), pack_name(&digest), batch_name(&digest)] {
            assert_eq!(digest_of(&name), Some(digest), "{name}");
        }
        assert_eq!(digest_of("records/../../etc"), None);
    }
}
