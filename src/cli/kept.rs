//! What a collection keeps for the sake of runs: what their folders name, and what the store remembers of those that cannot be read or
//! found.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, GcPolicy, RunNote, Store};
use serde_json::Value;

use super::submit::quoted;
use super::{CliError, complain};
use rockface_engine::history::{self, HistoryError, PastRun};

/// Notes on runs that finished less long ago are kept, seconds: 30 days.
const REMEMBERED_S: u64 = 30 * 86_400;

/// A policy that comes to know the runs.
pub struct Kept<'s> {
    /// What is kept so far.
    pub policy: GcPolicy,
    /// The store that is collected.
    pub store: &'s Store,
    /// Whether what runs name decides what goes: a run that nothing is known of stops the collection then.
    pub must_know: bool,
    /// Whether nothing is to be written.
    pub is_dry: bool,
    /// What the store remembers of run folders.
    pub notes: Vec<RunNote>,
}

impl Kept<'_> {
    /// Enters what all runs name: those in these folders of runs, and those elsewhere that the store remembers.
    pub fn count_all(&mut self, places: &[PathBuf]) -> Result<(), CliError> {
        let folders = self.folders(places)?;
        for folder in &folders {
            match PastRun::open(folder) {
                Ok(run) => self.count(&run)?,
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

    /// Lets the notes on run folders leave that are of no use any more: those on folders that are gone, of runs that are not pinned and
    /// finished long ago, where nothing that they name stays for their sake. Notes by the keys of plans leave with their folders: they tell
    /// where the results of a plan are, and nothing else.
    pub fn forget(&mut self, now_s: u64) {
        let is_old = |note: &RunNote| now_s.saturating_sub(note.finished_unix_s) > REMEMBERED_S;
        let is_useless = |note: &RunNote| self.policy.unnamed || !note.names_any(self.store);
        let is_past =
            |note: &&RunNote| !note.pinned && is_old(note) && !history::may_be_run(&note.folder) && is_useless(note);
        self.policy.forgotten = self.notes.iter().filter(is_past).cloned().collect();
        let of_folders: BTreeSet<Digest> = self.notes.iter().map(RunNote::name).collect();
        let is_outdated = |(key, note): &(Digest, Value)| {
            !of_folders.contains(key) && folder_of(note).is_some_and(|folder| !history::may_be_run(&folder))
        };
        self.policy.outdated = self.store.memory().recalled_runs().into_iter().filter(is_outdated).collect();
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
        let noted = self.store.memory().recalled_runs();
        let noted = noted.iter().filter_map(|(_, note)| folder_of(note));
        folders.extend(noted.filter(|folder| history::may_be_run(folder)));
        Ok(folders)
    }

    fn note(&self, folder: &Path) -> Option<&RunNote> {
        self.notes.iter().find(|note| note.folder == folder)
    }

    fn count(&mut self, run: &PastRun) -> Result<(), CliError> {
        let keys: Vec<Digest> = run.keys().collect();
        let is_noted = !run.pinned || self.note(&run.folder).is_some_and(|note| note.pinned);
        if !is_noted && !self.is_dry && keys.iter().any(|key| self.store.has_record(key)) {
            // Pinned by a version that knew no notes: the pin is to outlast the folder.
            self.store.memory().note_folder(&run.note(&run.folder))?;
            self.store.sync()?;
        }
        self.use_keys(keys, run.finished_unix_s(), run.pinned);
        Ok(())
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
        let used = format!("what can still be read in it ({}) counts as used by this run", records(count));
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
                    complain(&format!("warning: {fault}; what this run names ({}) is kept", records(count)));
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
        let why = "it was removed or moved, or its disk is not mounted";
        let named = |path: &Path| quoted(&path.to_string_lossy());
        let command = format!("rockface runs unpin {} --store {}", named(&note.folder), named(self.store.dir()));
        let (folder, records) = (note.folder.display(), records(count));
        complain(&format!(
            "warning: the folder of the pinned run {folder} is not there ({why}); what it names ({records}) is kept: pin it again where it is \
             now, or remove the pin with `{command}`"
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

fn records(count: usize) -> String {
    format!("{count} record{}", if count == 1 { "" } else { "s" })
}

/// The run folder in a note.
fn folder_of(note: &Value) -> Option<PathBuf> {
    note.get("folder")?.as_str().map(PathBuf::from)
}
