//! What can be removed from a store: which records and blobs, what each is, and why.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::Value;

use crate::error::StoreError;
use crate::frame::Kind;
use crate::memory::RunNote;
use crate::rewrite::Leaving;
use crate::{Digest, Store};

/// What is to be kept.
#[derive(Debug, Clone, Default)]
pub struct GcPolicy {
    /// Keys that are kept whatever their age: those of pinned runs.
    pub pinned: BTreeSet<Digest>,
    /// When each key was last used by a run whose folder still exists, seconds since 1970.
    pub used: BTreeMap<Digest, u64>,
    /// Remove the records that no run names.
    pub unnamed: bool,
    /// Until when runs were made whose manifest can only be read in part, seconds since 1970: what was made until then may
    /// be named in the rest, and does not count as unnamed.
    pub torn_s: Option<u64>,
    /// Remove what was not used for that long, whole seconds: 0 takes what was used in this very second too.
    pub max_age_s: Option<u64>,
    /// Remove the longest unused until the blobs of records take no more bytes.
    pub max_bytes: Option<u64>,
    /// What was made, put or used less long ago is kept, seconds: a run may be about to name it. Beside live runs, an hour
    /// at least.
    pub grace_s: u64,
    /// Notes on run folders that leave, unless they were written anew meanwhile.
    pub forgotten: Vec<RunNote>,
    /// Notes by the keys of plans that leave, unless they were written anew meanwhile.
    pub outdated: Vec<(Digest, Value)>,
}

/// A blob that would be removed.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct GcItem {
    /// The digest of the blob.
    pub digest: Digest,
    /// Its size in bytes.
    pub bytes: u64,
    /// What it is, such as `mesh of import-mesh`.
    pub what: String,
    /// When it was last used, seconds since 1970; 0 where no record tells.
    pub used_unix_s: u64,
    /// Why it is removed, for people.
    pub why: String,
}

/// What would be removed.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize)]
pub struct GcPlan {
    /// Blobs, the longest unused first.
    pub blobs: Vec<GcItem>,
    /// The keys of records.
    pub records: Vec<Digest>,
    /// Records that are kept.
    pub kept_records: u64,
    /// Bytes of the blobs of records that stay.
    pub kept_bytes: u64,
    /// What leaves the segments, as it was.
    #[serde(skip)]
    pub(super) leaving: Leaving,
    /// Blobs put after that stay, seconds since 1970.
    #[serde(skip)]
    pub(super) since_s: u64,
    /// When the latest note on a run was written.
    #[serde(skip)]
    pub(super) noted: u64,
}

/// What a collection needs to know of a record.
struct Candidate {
    key: Digest,
    used_s: u64,
    blobs: Vec<(Digest, u64)>,
    /// Why it goes; `None` while it stays.
    why: Option<String>,
    fixed: bool,
}

impl Store {
    /// What this policy removes. Nothing is touched.
    pub fn plan_gc(&self, policy: &GcPolicy) -> Result<GcPlan, StoreError> {
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
        let since_s = now_s.saturating_sub(policy.grace_s);
        let mut candidates = self.candidates(policy, now_s);
        within_budget(&mut candidates, policy.max_bytes);
        let stays = candidates.iter().filter(|candidate| candidate.why.is_none());
        let kept: BTreeMap<Digest, u64> = stays.clone().flat_map(|candidate| candidate.blobs.iter().copied()).collect();
        let mut plan = GcPlan {
            kept_records: stays.count() as u64,
            kept_bytes: kept.values().copied().fold(0, u64::saturating_add),
            records: candidates.iter().filter(|one| one.why.is_some()).map(|one| one.key).collect(),
            blobs: self.leaving(&candidates, &kept, since_s),
            leaving: Leaving::default(),
            since_s,
            noted: self.noted(),
        };
        plan.blobs.extend(self.orphans(&candidates, since_s)?);
        plan.leaving = Leaving { notes: self.stamps_of(policy), ..self.as_it_is(&plan) };
        Ok(plan)
    }

    /// When the latest note on a run was written.
    pub(super) fn noted(&self) -> u64 {
        self.journal().with_index(|index| {
            let stamps = index.names(Kind::Note).into_iter().filter_map(|key| index.stamp(Kind::Note, &key));
            stamps.max().unwrap_or(0)
        })
    }

    /// The records and small blobs of a plan with the stamps they have now.
    fn as_it_is(&self, plan: &GcPlan) -> Leaving {
        self.journal().with_index(|index| Leaving {
            records: plan.records.iter().filter_map(|key| Some((*key, index.stamp(Kind::Record, key)?))).collect(),
            blobs: plan.blobs.iter().filter_map(|item| Some((item.digest, index.blob(&item.digest)?.stamp))).collect(),
            notes: BTreeMap::new(),
        })
    }

    /// The stamps of those notes that are to leave and are still the latest under their names.
    fn stamps_of(&self, policy: &GcPolicy) -> BTreeMap<Digest, u64> {
        let memory = self.memory();
        // Before the note is read: one that is written in between is another, and stays.
        let stamp = |name: &Digest| self.journal().with_index(|index| index.stamp(Kind::Note, name));
        let of_folder = |note: &RunNote| {
            let name = note.name();
            let stamp = stamp(&name)?;
            (memory.noted_folder(&note.folder).as_ref() == Some(note)).then_some((name, stamp))
        };
        let of_plan = |(name, note): &(Digest, Value)| {
            let stamp = stamp(name)?;
            (memory.recalled_run(name).as_ref() == Some(note)).then_some((*name, stamp))
        };
        policy.forgotten.iter().filter_map(of_folder).chain(policy.outdated.iter().filter_map(of_plan)).collect()
    }

    /// Every record, the longest unused first.
    fn candidates(&self, policy: &GcPolicy, now_s: u64) -> Vec<Candidate> {
        let mut candidates: Vec<Candidate> = self
            .keys()
            .into_iter()
            .filter_map(|key| {
                let record = self.record(&key)?;
                let used = policy.used.get(&key).copied();
                let used_s = record.cost.finished_unix_s.max(used.unwrap_or(0));
                let age_s = now_s.saturating_sub(used_s);
                let blobs = record.blobs().map(|(digest, bytes)| (digest, bytes.or(self.size(&digest)).unwrap_or(0)));
                let fixed = policy.pinned.contains(&key) || age_s < policy.grace_s;
                let may_be_named =
                    used.is_some() || policy.torn_s.is_some_and(|torn_s| record.cost.finished_unix_s <= torn_s);
                let why = if fixed { None } else { why(policy, may_be_named, age_s) };
                Some(Candidate { key, used_s, blobs: blobs.collect(), why, fixed })
            })
            .collect();
        candidates.sort_by_key(|candidate| (candidate.used_s, candidate.key));
        candidates
    }

    /// The blobs that only leaving records name and that nobody has put after `since_s`.
    fn leaving(&self, candidates: &[Candidate], kept: &BTreeMap<Digest, u64>, since_s: u64) -> Vec<GcItem> {
        let is_old = |digest: &Digest| self.last_put(digest).is_some_and(|(_, put_s)| put_s <= since_s);
        let named = self.named_blobs();
        let mut seen = BTreeSet::new();
        let mut items = Vec::new();
        for candidate in candidates {
            let Some(why) = &candidate.why else { continue };
            for (digest, bytes) in &candidate.blobs {
                if !kept.contains_key(digest) && seen.insert(*digest) && is_old(digest) {
                    let what = named.get(digest).map_or_else(String::new, |outputs| outputs.join(", "));
                    let (digest, bytes, used_unix_s) = (*digest, *bytes, candidate.used_s);
                    items.push(GcItem { digest, bytes, what, used_unix_s, why: why.clone() });
                }
            }
        }
        items
    }

    /// The size of a blob and when it was last put, seconds since 1970; `None` where it is not there.
    fn last_put(&self, digest: &Digest) -> Option<(u64, u64)> {
        let large = || self.blobs().written(digest);
        self.place(digest).map_or_else(large, |place| Some((u64::from(place.length), place.put_s())))
    }

    /// Blobs that no record names and that nobody has put after `since_s`.
    fn orphans(&self, candidates: &[Candidate], since_s: u64) -> Result<Vec<GcItem>, StoreError> {
        let named: BTreeSet<Digest> =
            candidates.iter().flat_map(|one| one.blobs.iter().map(|(blob, _)| *blob)).collect();
        let all = self.small_blobs().into_iter().chain(self.blobs().list()?);
        let unnamed = all.filter(|digest| !named.contains(digest));
        let old = unnamed.filter_map(|digest| Some((digest, self.last_put(&digest)?)));
        let orphan = |(digest, (bytes, _))| GcItem {
            digest,
            bytes,
            what: "an output that was superseded or never recorded".to_owned(),
            used_unix_s: 0,
            why: "no record names it".to_owned(),
        };
        Ok(old.filter(|(_, (_, put_s))| *put_s <= since_s).map(orphan).collect())
    }
}

fn why(policy: &GcPolicy, named: bool, age_s: u64) -> Option<String> {
    if policy.max_age_s.is_some_and(|max_age_s| age_s >= max_age_s) {
        return Some(format!("not used for {} days", age_s / 86_400));
    }
    (policy.unnamed && !named).then(|| "no run names it".to_owned())
}

/// Lets the longest unused go until the blobs of the others fit.
fn within_budget(candidates: &mut [Candidate], max_bytes: Option<u64>) {
    let Some(max_bytes) = max_bytes else { return };
    // How many name a blob, and its size as the first of them tells it: records of another store may disagree.
    let mut users: BTreeMap<Digest, (u32, u64)> = BTreeMap::new();
    for (digest, size) in candidates.iter().filter(|one| one.why.is_none()).flat_map(|one| &one.blobs) {
        users.entry(*digest).or_insert((0, *size)).0 += 1;
    }
    let mut bytes: u128 = users.values().map(|(_, size)| u128::from(*size)).sum();
    for candidate in candidates.iter_mut().filter(|one| one.why.is_none() && !one.fixed) {
        if bytes <= u128::from(max_bytes) {
            return;
        }
        candidate.why = Some("the store is larger than its budget, and this was not used for longest".to_owned());
        for (digest, _) in &candidate.blobs {
            let Some((count, size)) = users.get_mut(digest) else { continue };
            *count -= 1;
            bytes -= if *count == 0 { u128::from(*size) } else { 0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_on_which_records_disagree_neither_overflow_nor_go_below_nothing() {
        let told = |key: &[u8], bytes: u64| {
            let blobs = vec![(Digest::of(b"shared"), bytes), (Digest::of(key), u64::MAX)];
            Candidate { key: Digest::of(key), used_s: 0, blobs, why: None, fixed: false }
        };
        let mut candidates = [told(b"a", 1), told(b"b", u64::MAX)];
        within_budget(&mut candidates, Some(0));
        assert!(candidates.iter().all(|candidate| candidate.why.is_some()));
    }
}
