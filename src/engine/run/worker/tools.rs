//! Programs that steps call by a name or a path: which ones made what is on record, and whether they are the same still.
//!
//! A program is no part of a recipe: which file answers to its name differs from machine to machine, and its version is
//! declared. A changed program is therefore only reported, and its results are kept.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, Seen, Store};
use serde::{Deserialize, Serialize};

use crate::plan::Plan;

/// A program as it is called.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Call {
    /// A name to be searched for, or a path.
    pub program: String,
    /// The folders it is searched for in, where the step says so itself.
    pub search: Option<String>,
}

/// What was called to make something, with the digest of each.
pub type Tools = BTreeMap<String, (Call, Digest)>;

impl Call {
    /// The program file, and the places before it where none was found.
    fn find(&self) -> (Option<PathBuf>, Vec<PathBuf>) {
        if self.program.contains('/') {
            return (Some(PathBuf::from(&self.program)), Vec::new());
        }
        let outside = std::env::var_os("PATH").unwrap_or_default();
        let search = self.search.as_ref().map_or(outside.as_os_str(), OsStr::new);
        let mut without = Vec::new();
        for folder in std::env::split_paths(search) {
            let path = folder.join(&self.program);
            if is_program(&path) {
                return (Some(path), without);
            }
            without.push(path);
        }
        (None, without)
    }
}

fn is_program(path: &Path) -> bool {
    path.metadata().is_ok_and(|meta| meta.is_file() && meta.permissions().mode() & 0o111 != 0)
}

/// The programs of calls as they are now; one that is not found or cannot be read is left out.
pub fn state(calls: impl IntoIterator<Item = Call>, store: &Store) -> Tools {
    let found = calls.into_iter().filter_map(|call| {
        let digest = store.hash_file(&call.find().0?).ok()?.digest;
        Some((call.program.clone(), (call, digest)))
    });
    found.collect()
}

/// Keeps beside the record of a recipe what was called to make it.
pub fn remember(store: &Store, key: &Digest, tools: &Tools) -> Result<(), rockface_cache::StoreError> {
    if tools.is_empty() { Ok(()) } else { store.memory().annotate(key, &serde_json::json!(tools)) }
}

/// The programs behind some results.
#[derive(Default)]
pub struct Behind {
    /// All that was looked at to find them.
    pub looks: Vec<(PathBuf, Seen)>,
    /// Warnings about those that have changed: an instance each, and the text.
    pub changed: Vec<(String, String)>,
}

/// Looks at the programs that made results: instances, each with the key of its recipe.
pub fn behind(plan: &Plan, store: &Store, results: impl Iterator<Item = (usize, Digest)>) -> Behind {
    let mut behind = Behind::default();
    let mut now: BTreeMap<Call, Option<(PathBuf, Digest)>> = BTreeMap::new();
    let mut changed: BTreeMap<Call, (String, usize)> = BTreeMap::new();
    for (instance, key) in results {
        let tools = store.memory().annotation(&key).and_then(|note| serde_json::from_value::<Tools>(note).ok());
        for (call, then) in tools.unwrap_or_default().into_values() {
            let found = now.entry(call.clone()).or_insert_with(|| behind.look(&call, store));
            if found.as_ref().is_some_and(|(_, digest)| *digest != then) {
                changed.entry(call).or_insert_with(|| (plan.label(instance), 0)).1 += 1;
            }
        }
    }
    let words = |(call, (label, count)): (Call, (String, usize))| {
        let path = now[&call].as_ref().map(|(path, _)| path.display().to_string()).unwrap_or_default();
        (label, told(&call.program, &path, count))
    };
    behind.changed = changed.into_iter().map(words).collect();
    behind
}

impl Behind {
    fn look(&mut self, call: &Call, store: &Store) -> Option<(PathBuf, Digest)> {
        let (found, without) = call.find();
        self.looks.extend(without.into_iter().map(|path| (path, Seen::NoFile)));
        let path = found?;
        let digest = store.hash_file(&path).ok().map(|file| file.digest);
        self.looks.push((path.clone(), digest.map_or(Seen::NoFile, Seen::File)));
        Some((path, digest?))
    }
}

fn told(program: &str, path: &str, count: usize) -> String {
    let place = if path == program { String::new() } else { format!(" ({path})") };
    let results = if count == 1 { "this result".to_owned() } else { format!("{count} results, this one among them") };
    format!(
        "the program `{program}`{place} has changed since it made {results}; cached results are kept. To recompute them \
         change `version` in the step; to detect changes of the program automatically, name it under `files` and call it by \
         {{file.NAME}}"
    )
}
