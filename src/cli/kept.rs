//! What a collection keeps for the sake of runs: what their folders name, and what the store remembers of those that cannot be read or
//! found.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, GcPolicy, RunNote, Store};

use super::{CliError, complain};
use rockface_engine::history::{self, HistoryError, PastRun};

/// A policy that comes to know the runs.
pub struct Kept<'s> {
    /// What is kept so far.
    pub policy: GcPolicy,
    /// The store that is collected.
    pub store: &'s Store,
    /// Whether what runs name decides what goes: a run that nothing is known of stops the collection then.
    pub must_know: bool,
    /// What the store remembers of run folders.
    pub notes: Vec<RunNote>,
}

impl Kept<'_> {
    /// Enters what all runs name: those in these folders of runs, and those elsewhere that the store remembers.
    pub fn count_all(&mut self, places: &[PathBuf]) -> Result<(), CliError> {
        let folders = self.folders(places)?;
        for folder in &folders {
            match PastRun::open(folder) {
                Ok(run) => self.count(&run),
                Err(fault @ HistoryError::Manifest { .. }) => self.count_torn(folder, &fault)?,
                Err(fault) => self.count_unread(folder, fault)?,
            }
        }
        let gone = |note: &&RunNote| note.pinned && !folders.contains(&note.folder);
        let gone: Vec<RunNote> = self.notes.iter().filter(gone).cloned().collect();
        for note in &gone {
            self.count_gone(note, &folders);
        }
        Ok(())
    }

    /// All run folders that are there.
    fn folders(&self, places: &[PathBuf]) -> Result<BTreeSet<PathBuf>, CliError> {
        let absolute = |folder: PathBuf| std::path::absolute(&folder).unwrap_or(folder);
        let mut folders = BTreeSet::new();
        for runs in places {
            match history::folders(runs) {
                Ok(found) => folders.extend(found.into_iter().map(absolute)),
                Err(fault) if self.must_know => return Err(fault.into()),
                Err(fault) => complain(&format!("warning: {fault}")),
            }
        }
        // Those that former versions noted have no note of their own.
        for note in self.store.memory().recalled_runs() {
            let folder = note.get("folder").and_then(serde_json::Value::as_str).map(PathBuf::from);
            folders.extend(folder.filter(|folder| history::may_be_run(folder)));
        }
        Ok(folders)
    }

    fn note(&self, folder: &Path) -> Option<&RunNote> {
        self.notes.iter().find(|note| note.folder == folder)
    }

    fn count(&mut self, run: &PastRun) {
        self.use_keys(run.keys().collect(), run.finished_unix_s(), run.pinned);
    }

    /// Marks what a damaged manifest still references as used: its run may still be wanted.
    fn count_torn(&mut self, folder: &Path, fault: &HistoryError) -> Result<(), CliError> {
        let (digests, written_s) = history::digests_told(folder)?;
        let keys: Vec<Digest> = digests.into_iter().filter(|digest| self.store.has_record(digest)).collect();
        let (count, pinned) = (keys.len(), history::is_pinned(folder));
        self.use_keys(keys, written_s, pinned);
        let noted = self.note(folder).map(|note| note.keys(self.store));
        self.use_keys(noted.unwrap_or_default(), written_s, pinned);
        self.policy.torn_s = self.policy.torn_s.max(Some(written_s));
        let way = "run its pipeline again to write it anew, or remove the folder";
        let used = format!("the {count} records that can still be read in it count as used by this run");
        let rest = "any other that was made before it may be, so `--unnamed` does not remove it";
        complain(&format!("warning: {fault}; {used}; {rest}: {way}"));
        Ok(())
    }

    /// Keeps what a run names whose folder this user may not read, where the store remembers that.
    fn count_unread(&mut self, folder: &Path, fault: HistoryError) -> Result<(), CliError> {
        match self.note(folder).map(|note| (note.keys(self.store), note.finished_unix_s)) {
            Some((keys, finished_s)) => {
                let count = keys.len();
                // Whether it is pinned cannot be seen.
                self.use_keys(keys, finished_s, true);
                if self.must_know {
                    complain(&format!("warning: {fault}; the {count} records that this run names are kept"));
                }
            }
            None if self.must_know => return Err(fault.into()),
            None => complain(&format!("warning: {fault}")),
        }
        Ok(())
    }

    /// Keeps what a pinned run names whose folder is not where it was.
    fn count_gone(&mut self, note: &RunNote, folders: &BTreeSet<PathBuf>) {
        let keys = note.keys(self.store);
        let count = keys.len();
        self.use_keys(keys, note.finished_unix_s, true);
        let is_moved = |folder: &PathBuf| {
            let run = (folder.file_name() == note.folder.file_name()).then(|| PastRun::open(folder).ok()).flatten();
            run.is_some_and(|run| run.pinned && run.note(&run.folder).is_of_run(note))
        };
        if folders.iter().any(is_moved) {
            return;
        }
        let (folder, store) = (note.folder.display(), self.store.dir().display());
        let why = "it was removed or moved, or its disk is not mounted";
        let way = format!(
            "pin it again where it is now, or remove the pin with `rockface runs unpin {folder} --store {store}`"
        );
        complain(&format!(
            "warning: the folder of the pinned run {folder} is not there ({why}); the {count} records that it names are kept: {way}"
        ));
    }

    fn use_keys(&mut self, keys: Vec<Digest>, used_s: u64, pinned: bool) {
        for key in &keys {
            let known = self.policy.used.entry(*key).or_default();
            *known = used_s.max(*known);
        }
        if pinned {
            self.policy.pinned.extend(keys);
        }
    }
}
