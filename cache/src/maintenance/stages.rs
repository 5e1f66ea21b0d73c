//! What a store holds, by the stage that made it.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Digest, Record, Store};

/// What a store holds of one stage.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize)]
pub struct StageStat {
    /// The name of the stage.
    pub stage: String,
    /// Records of steps of this stage.
    pub records: u64,
    /// Distinct outputs that are kept.
    pub blobs: u64,
    /// Size of their blobs in bytes.
    pub bytes: u64,
    /// What making them took, seconds of elapsed time.
    pub wall_s: f64,
}

impl Store {
    /// What is held of each stage, the largest first; an output that two stages made counts for both.
    pub fn stat_by_stage(&self) -> Vec<StageStat> {
        let mut stages: BTreeMap<String, (StageStat, BTreeSet<Digest>)> = BTreeMap::new();
        for record in self.keys().iter().filter_map(|key| self.record(key)) {
            let (stat, seen) = stages.entry(record.recipe.stage.clone()).or_default();
            count(stat, seen, &record);
        }
        let mut stats: Vec<StageStat> = stages.into_values().map(|(stat, _)| stat).collect();
        stats.sort_by(|one, other| other.bytes.cmp(&one.bytes).then_with(|| one.stage.cmp(&other.stage)));
        stats
    }
}

fn count(stat: &mut StageStat, seen: &mut BTreeSet<Digest>, record: &Record) {
    stat.stage.clone_from(&record.recipe.stage);
    stat.records += 1;
    stat.wall_s += record.cost.wall_s;
    for output in record.outputs.values().filter(|output| output.kept && seen.insert(output.digest)) {
        stat.blobs += 1;
        // Records of another store may tell any size.
        stat.bytes = stat.bytes.saturating_add(output.bytes);
    }
}
