//! What the entries say, up to the last that was read: who holds what.

use std::collections::{BTreeMap, BTreeSet};

use super::entry::{Entry, Holdings, Member};
use crate::Digest;

/// What all workers hold.
#[derive(Debug, Default)]
pub(super) struct View {
    /// The number of the last entry that was read.
    pub read: u64,
    workers: BTreeMap<String, Known>,
    /// Workers whose later entries count no more.
    gone: BTreeSet<String>,
}

/// What is known of a worker.
#[derive(Debug, Default)]
struct Known {
    /// Entries up to this number are contained in what it holds.
    since: u64,
    holds: Holdings,
}

const NOTHING: &Holdings =
    &Holdings { all: false, waits: false, steps: BTreeSet::new(), has: BTreeSet::new(), wants: BTreeSet::new() };

impl View {
    /// The view of one who begins: what the objects of workers say, to be followed by the entries after `read`.
    pub fn of_members(members: BTreeMap<String, Member>, newest: u64) -> Self {
        let read = members.values().map(|member| member.read).min().unwrap_or(newest).min(newest);
        let known = |member: Member| Known { since: member.read, holds: member.holds };
        let workers = members.into_iter().map(|(name, member)| (name, known(member))).collect();
        Self { read, workers, gone: BTreeSet::new() }
    }

    /// Reads the entry of this number, which follows the last.
    pub fn apply(&mut self, number: u64, entry: &Entry) {
        self.read = number;
        if entry.worker.is_empty() || self.gone.contains(&entry.worker) {
            return;
        }
        let known = self.workers.entry(entry.worker.clone()).or_default();
        if number > known.since {
            let holds = &mut known.holds;
            holds.all = entry.all.unwrap_or(holds.all);
            holds.waits = entry.waits.unwrap_or(holds.waits);
            entry.ends.iter().for_each(|key| _ = holds.steps.remove(key));
            holds.steps.extend(&entry.takes);
            entry.lacks.iter().for_each(|digest| _ = holds.has.remove(digest));
            holds.has.extend(&entry.has);
            entry.unwants.iter().for_each(|name| _ = holds.wants.remove(name));
            holds.wants.extend(&entry.wants);
        }
        for (name, _) in &entry.given {
            // All who wanted it fetch it.
            let before = self.workers.values_mut().filter(|known| number > known.since);
            before.for_each(|known| _ = known.holds.wants.remove(name));
        }
        let gone = entry.dead.iter().chain(entry.leaves.then_some(&entry.worker));
        for name in gone {
            self.workers.remove(name);
            self.gone.insert(name.clone());
        }
    }

    /// What a worker holds.
    pub fn own(&self, name: &str) -> &Holdings {
        self.workers.get(name).map_or(NOTHING, |known| &known.holds)
    }

    /// Whether a worker takes part.
    pub fn has(&self, name: &str) -> bool {
        self.workers.contains_key(name)
    }

    /// Whether a worker was declared dead, or has left.
    pub fn is_gone(&self, name: &str) -> bool {
        self.gone.contains(name)
    }

    /// All workers but this one.
    pub fn others<'s>(&'s self, own: &str) -> impl Iterator<Item = (&'s str, &'s Holdings)> {
        let others = self.workers.iter().map(|(name, known)| (name.as_str(), &known.holds));
        others.filter(move |(name, _)| *name != own)
    }

    /// The worker other than this one that holds a step.
    pub fn holder(&self, key: &Digest, own: &str) -> Option<&str> {
        self.others(own).find(|(_, holds)| holds.all || holds.steps.contains(key)).map(|(name, _)| name)
    }
}
