//! The way around a run in which nothing is to be done: the result of the same command last time, if nothing it depends on
//! has changed since.

use std::path::{Path, PathBuf};

use rockface_cache::{Digest, Grounds, SafePath, Seen, Store};
use serde::{Deserialize, Serialize};

use super::made::{self, Made};
use super::run_folder::point_latest;
use crate::history::folded;
use crate::plan::Plan;
use crate::run::{Finished, RunError, Summary, tools};
use crate::watch::Alike;

/// How many headlines and files the end of a run names.
pub const NAMED: usize = 20;

/// What the end of a run says: the first of its headlines and files, and how many there are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// The run folder of the run that this is the end of.
    pub folder: PathBuf,
    /// The first results, a line each.
    pub headlines: Vec<String>,
    /// How many results there are.
    pub headline_count: usize,
    /// The first warnings, those of cached steps too; of those that differ in their numbers only, the first two.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// How many warnings there are.
    #[serde(default)]
    pub warning_count: usize,
    /// How many of them are of steps that ran, and were printed then.
    #[serde(skip)]
    pub warnings_printed: usize,
    /// The first files of the target steps, relative to the run folder.
    pub files: Vec<SafePath>,
    /// How many files there are.
    pub file_count: usize,
    /// How many kept outputs have no file there.
    #[serde(default)]
    pub unnamed: usize,
    /// How many instances there are.
    pub instances: usize,
}

impl Told {
    /// The summary of a run.
    pub fn of(finished: &Finished, plan: &Plan, summary: &Summary) -> Self {
        let executed = summary.instances.iter().enumerate().filter(|(_, result)| result.executed);
        let headlines = folded(&finished.headlines, &executed.map(|(instance, _)| plan.label(instance)).collect());
        let mut alike = Alike::default();
        let words = |text: &str| text.split_once(": ").map_or(text, |(_, words)| words).to_owned();
        let told = finished.warnings.iter().filter(|(_, text)| alike.is_told(&words(text))).take(NAMED);
        let warnings = told.map(|(_, text)| text.clone()).collect();
        let ran = |(instance, _): &&(usize, String)| summary.instances.get(*instance).is_some_and(|it| it.executed);
        Self {
            folder: finished.folder.clone(),
            headline_count: headlines.len(),
            headlines: headlines.into_iter().take(NAMED).collect(),
            warnings,
            warning_count: finished.warnings.len(),
            warnings_printed: finished.warnings.iter().filter(ran).count(),
            files: finished.files.iter().take(NAMED).cloned().collect(),
            file_count: finished.files.len(),
            unnamed: finished.unnamed,
            instances: summary.instances.len(),
        }
    }
}

/// What the run asked for by `question` would say if nothing is to be done and its folder is still in `runs`.
///
/// # Errors
///
/// That `latest` cannot be made to point at it.
pub fn recall(store: &Path, question: &Digest, runs: &Path) -> Result<Option<Told>, RunError> {
    let answer = rockface_cache::recall(store, question);
    let told = answer.and_then(|answer| serde_json::from_value::<Told>(answer).ok());
    let absolute = std::path::absolute(runs).ok();
    let Some(told) = told.filter(|told| absolute.is_some_and(|runs| made::is_in(&told.folder, &runs))) else {
        return Ok(None);
    };
    point_latest(runs, &told.folder)?;
    Ok(Some(told))
}

/// A run that has ended.
pub struct Ended<'a> {
    /// How each instance ended.
    pub summary: &'a Summary,
    /// What the end of the run says.
    pub told: &'a Told,
    /// What it left in its folder.
    pub finished: &'a Finished,
}

/// Keeps the result of `question`, for [`recall`]; a run that failed is not kept. It depends on the files that were `included`
/// too, each of which must still be what was read.
///
/// # Errors
///
/// Those of the store.
pub fn remember(
    store: &Store,
    question: &Digest,
    plan: &Plan,
    ended: &Ended,
    included: &[(PathBuf, Seen)],
) -> Result<(), RunError> {
    let Ended { summary, told, finished } = ended;
    if summary.failed || summary.instances.iter().any(|instance| instance.outcome.is_none()) {
        return Ok(());
    }
    // Makes the store know the state of these files; one that is gone will be seen to be.
    included.iter().for_each(|(path, _)| drop(store.hash_file(path)));
    let tools = tools::behind(plan, store, summary.keys());
    if !tools.changed.is_empty() {
        return Ok(()); // Reported again by the next run.
    }
    let outcomes = summary.instances.iter().filter_map(|instance| instance.outcome.as_ref());
    let grounds = Grounds {
        looks: plan.looks.iter().chain(included).chain(&tools.looks).cloned().collect(),
        made: (finished.folder.clone(), finished.made.iter().map(Made::state).collect()),
        blobs: outcomes.flat_map(rockface_cache::Outcome::blobs).collect(),
    };
    store.sync()?;
    store.memory().remember_answer(question, &serde_json::json!(told), &grounds)?;
    Ok(())
}
