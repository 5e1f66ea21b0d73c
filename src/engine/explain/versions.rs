//! The versions of stages that results on record were made with: after an upgrade they tell why steps run again.

use std::collections::{BTreeMap, BTreeSet};

use rockface_cache::{Recipe, Store};

use crate::plan::Plan;

/// The versions on record, by stage.
#[derive(Debug, Default)]
pub struct Versions(BTreeMap<String, BTreeSet<u32>>);

impl Versions {
    /// Those of all records of a store.
    pub fn on_record(store: &Store) -> Self {
        let mut versions = Self::default();
        store.keys().iter().filter_map(|key| store.record(key)).for_each(|record| versions.add(&record.recipe));
        versions
    }

    /// Counts the recipe of a record.
    pub fn add(&mut self, recipe: &Recipe) {
        if let Some(versions) = self.0.get_mut(&recipe.stage) {
            versions.insert(recipe.version);
        } else {
            self.0.insert(recipe.stage.clone(), BTreeSet::from([recipe.version]));
        }
    }

    /// `register-icp 4 -> 5`: the latest version on record and that of this program, where no result of an instance's stage has that.
    pub fn change(&self, plan: &Plan, instance: usize) -> Option<String> {
        let stage = &plan.step(instance).stage;
        let recorded = self.0.get(stage.name()).filter(|versions| !versions.contains(&stage.version()))?;
        Some(format!("{} {} -> {}", stage.name(), recorded.last()?, stage.version()))
    }
}
