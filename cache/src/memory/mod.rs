//! What the engine remembers in a store beside blobs and records. Losing any of it costs time, never a result; but the
//! notes on run folders also tell collections what to keep.
//!
//! | what | where | written by |
//! |---|---|---|
//! | runs: a note by the key of a plan | segments | [`Memory::remember_run`] |
//! | run folders: a note by the path of each | segments | [`Memory::note_folder`] |
//! | notes beside a record, on what decides nothing of it | segments | [`Memory::annotate`] |
//! | answers: the result of a former command and the state of all it rests on | `answers/` | [`Memory::remember_answer`] |
//! | trees: long texts, parsed | `trees/` | the engine, in the folder [`trees`] |
//!
//! The store does not interpret any of this. Answers and trees decide which steps run, and a note by the key of a plan what a run that has
//! nothing to do says of itself, so these are believed only where they bear the [`mark`] of this user: whoever may write to a shared store,
//! or gives a store away, can put any file into it.

mod looks;
mod mark;
mod memo;
mod runs;

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::error::StoreError;
use crate::frame::Kind;
use crate::{Digest, Store, plain};

pub use looks::{Seen, State};
pub use mark::mark;
pub use memo::{Grounds, recall};
pub use runs::RunNote;

/// The folder of parsed texts.
pub(crate) const TREES: &str = "trees";
/// Tells marks on notes from those on anything else.
const MARKED: &[u8] = b"run note";
/// The field of a note with its mark.
const MARK: &str = "mark";
/// The folder of answers to former commands.
pub(crate) const ANSWERS: &str = "answers";

/// The memory of the engine in a store, from [`Store::memory`].
#[derive(Debug, Clone, Copy)]
pub struct Memory<'s> {
    store: &'s Store,
}

impl Store {
    /// What the engine remembers in this store.
    pub fn memory(&self) -> Memory<'_> {
        Memory { store: self }
    }
}

impl Memory<'_> {
    /// Keeps a note on a run under the key of its plan, with the mark of this user; a later note replaces it.
    pub fn remember_run(&self, plan_key: &Digest, json: &Value) -> Result<(), StoreError> {
        let text = json.to_string();
        let mut marked = json.clone();
        if let (Some(fields), Some(mark)) = (marked.as_object_mut(), mark_on(plan_key, &text)) {
            fields.insert(MARK.to_owned(), mark.to_string().into());
        }
        self.store.append(Kind::Note, *plan_key, marked.to_string().as_bytes())
    }

    /// The latest note under the key of this plan, whoever wrote it.
    pub fn recalled_run(&self, plan_key: &Digest) -> Option<Value> {
        self.payload(Kind::Note, plan_key)
    }

    /// The latest note under the key of this plan, if this user wrote it for that key.
    pub fn own_run(&self, plan_key: &Digest) -> Option<Value> {
        let mut note = self.recalled_run(plan_key)?;
        let told = note.as_object_mut()?.remove(MARK)?;
        let mark = mark_on(plan_key, &note.to_string())?;
        (told.as_str()? == mark.to_string()).then_some(note)
    }

    /// The latest notes on runs and on run folders, each under its key, in the order of these.
    pub fn recalled_runs(&self) -> Vec<(Digest, Value)> {
        let keys = self.store.journal().with_index(|index| index.names(Kind::Note));
        keys.into_iter().filter_map(|key| Some((key, self.recalled_run(&key)?))).collect()
    }

    /// Keeps a note beside the record of a recipe, on what decides nothing of it; a later note replaces it.
    pub fn annotate(&self, key: &Digest, json: &Value) -> Result<(), StoreError> {
        // The frames of file digests hold notes too: neither the names nor the payloads of the two can be confused.
        self.store.append(Kind::File, *key, json.to_string().as_bytes())
    }

    /// The latest note beside the record of a recipe.
    pub fn annotation(&self, key: &Digest) -> Option<Value> {
        self.payload(Kind::File, key)
    }

    fn payload(self, kind: Kind, name: &Digest) -> Option<Value> {
        self.store.journal().with_index(|index| serde_json::from_slice(index.payload(kind, name)?).ok())
    }
}

fn mark_on(plan_key: &Digest, note: &str) -> Option<Digest> {
    mark(&[MARKED, plan_key.as_bytes(), note.as_bytes()])
}

/// The folder of parsed texts of the store at `dir`, which need not exist.
pub fn trees(dir: &Path) -> PathBuf {
    dir.join(TREES)
}

/// The bytes of a plain file: no link is followed, and no pipe waited for.
pub fn read_plain(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut plain::open(path).ok()?, &mut bytes).ok().map(|_| bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_on_a_run_that_was_changed_or_is_of_another_plan_is_not_ones_own() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        let (memory, keys) = (store.memory(), [Digest::of(b"one"), Digest::of(b"other")]);
        let note = serde_json::json!({"folder": "/r", "headlines": ["rejected"], "share": 0.1, "made": []});
        memory.remember_run(&keys[0], &note).unwrap();
        assert_eq!(memory.own_run(&keys[0]), Some(note));
        let marked = memory.recalled_run(&keys[0]).unwrap();
        let mut changed = marked.clone();
        changed["headlines"] = serde_json::json!(["accepted"]);
        let mut bare = marked.clone();
        bare.as_object_mut().unwrap().remove(MARK);
        for (key, note) in [(&keys[0], &changed), (&keys[0], &bare), (&keys[1], &marked)] {
            store.append(Kind::Note, *key, note.to_string().as_bytes()).unwrap();
            assert_eq!((memory.own_run(key), memory.recalled_run(key).as_ref()), (None, Some(note)));
        }
    }

    #[test]
    fn a_note_beside_a_record_is_there_for_the_next_process_and_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("store");
        let key = Digest::of(b"recipe");
        let store = Store::open(&dir).unwrap();
        assert_eq!(store.memory().annotation(&key), None);
        for note in ["first", "second"] {
            store.memory().annotate(&key, &Value::from(note)).unwrap();
        }
        assert_eq!(store.memory().annotation(&key), Some("second".into()));
        drop(store);
        let store = Store::open(&dir).unwrap();
        assert_eq!((store.memory().annotation(&key), store.remembered(&key)), (Some("second".into()), None));
    }
}
