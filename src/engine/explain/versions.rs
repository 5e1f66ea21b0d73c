//! The versions of stages that results on record were made with: after an upgrade they tell why steps run again.

use std::collections::{BTreeMap, BTreeSet};

use rockface_cache::{Recipe, Store};

use crate::plan::Plan;

/// The versions on record, by stage, and by stage and parameters.
#[derive(Debug, Default)]
pub struct Versions {
    of_stages: BTreeMap<String, BTreeSet<u32>>,
    of_parameters: BTreeMap<(String, String), BTreeSet<u32>>,
}

impl Versions {
    /// Those of all records of a store.
    pub fn on_record(store: &Store) -> Self {
        let mut versions = Self::default();
        store.keys().iter().filter_map(|key| store.record(key)).for_each(|record| versions.add(&record.recipe));
        versions
    }

    /// Counts the recipe of a record.
    pub fn add(&mut self, recipe: &Recipe) {
        self.of_stages.entry(recipe.stage.clone()).or_default().insert(recipe.version);
        let parameters = (recipe.stage.clone(), recipe.params.to_string());
        self.of_parameters.entry(parameters).or_default().insert(recipe.version);
    }

    /// `register-icp 4 -> 5`: the latest version on record and that of this program, where no result of the stage of an instance has that, with
    /// its parameters if any has these.
    pub fn change(&self, plan: &Plan, instance: usize) -> Option<String> {
        let stage = &plan.step(instance).stage;
        let parameters = (stage.name().to_owned(), plan.instances[instance].params.recipe.to_string());
        let recorded = self.of_parameters.get(&parameters).or_else(|| self.of_stages.get(stage.name()))?;
        if recorded.contains(&stage.version()) {
            return None;
        }
        Some(format!("{} {} -> {}", stage.name(), recorded.last()?, stage.version()))
    }
}
