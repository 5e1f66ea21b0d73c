//! The way around a run in which nothing is to be done: what the same command came to last time, if nothing it rests on
//! has changed since.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rockface_cache::{Digest, Grounds, SafePath, Store};
use serde::{Deserialize, Serialize};

use super::folder::{is_told_in, point_latest};
use super::{Finished, RunError, Summary};
use crate::plan::Plan;

/// How many headlines and files the end of a run names.
pub const NAMED: usize = 20;

/// What the end of a run says: the first of its headlines and files, and how many there are.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// The run folder.
    pub folder: PathBuf,
    /// The first results, a line each.
    pub headlines: Vec<String>,
    /// How many results there are.
    pub headline_count: usize,
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
    /// What is to be said of a run.
    pub fn of(finished: &Finished, summary: &Summary) -> Self {
        Self {
            folder: finished.folder.clone(),
            headlines: finished.headlines.iter().take(NAMED).cloned().collect(),
            headline_count: finished.headlines.len(),
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
    let Some(told) = told.filter(|told| absolute.is_some_and(|runs| is_told_in(&told.folder, &runs, &told.files)))
    else {
        return Ok(None);
    };
    point_latest(runs, &told.folder)?;
    Ok(Some(told))
}

/// Keeps what `question` came to, for [`recall`]; a run that failed is not kept. It rests on the included files too.
///
/// # Errors
///
/// Those of the store.
pub fn remember(
    store: &Store,
    question: &Digest,
    plan: &Plan,
    (summary, told): (&Summary, &Told),
    included: &[(PathBuf, Digest)],
) -> Result<(), RunError> {
    if summary.failed || summary.instances.iter().any(|instance| instance.outcome.is_none()) {
        return Ok(());
    }
    let mut grounds = grounds(plan, summary);
    for (path, digest) in included {
        // Makes the store know the state of the file, which must still be what was read.
        if store.hash_file(path)?.digest != *digest {
            return Ok(());
        }
        grounds.files.push((path.clone(), *digest));
    }
    if grounds.folders.iter().any(|folder| may_change_unseen(folder)) {
        return Ok(());
    }
    store.sync()?;
    store.remember_answer(question, &serde_json::json!(told), &grounds)?;
    Ok(())
}

/// Everything a plan and its outcomes rest on.
fn grounds(plan: &Plan, summary: &Summary) -> Grounds {
    let mut grounds = Grounds::default();
    let mut last = None;
    for instance in &plan.instances {
        let params = Arc::as_ptr(&instance.params);
        if instance.params.files.is_empty() || last.replace(params) == Some(params) {
            continue;
        }
        for (written, files) in &instance.params.files {
            let named = plan.graph.folder.join(written);
            let single = matches!(files.as_slice(), [only] if only.path == named);
            // A folder or a pattern: another file may come to fit it.
            grounds.folders.extend((!single).then(|| listed_folder(&named)));
            grounds.files.extend(files.iter().map(|file| (file.path.clone(), file.digest)));
        }
    }
    let outcomes = summary.instances.iter().filter_map(|instance| instance.outcome.as_ref());
    grounds.blobs = outcomes.flat_map(rockface_cache::Outcome::blobs).collect();
    grounds
}

/// A link that leads to no file may begin to lead to one, and its folder would not show it.
fn may_change_unseen(folder: &Path) -> bool {
    let leads_nowhere =
        |entry: std::fs::DirEntry| entry.file_type().is_ok_and(|kind| kind.is_symlink()) && !entry.path().is_file();
    std::fs::read_dir(folder).map_or(true, |entries| entries.flatten().any(leads_nowhere))
}

fn listed_folder(named: &Path) -> PathBuf {
    if named.is_dir() { named.to_owned() } else { named.parent().unwrap_or(Path::new(".")).to_owned() }
}
