//! What a store remembers of run folders, each by its path: so a collection finds them wherever they are, and knows what one names that
//! it cannot read or find.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::Memory;
use crate::error::StoreError;
use crate::frame::Kind;
use crate::{Digest, Store};

/// Digits of a key that a note has: of the records of a store they leave one in doubt with a chance of one in 2^64.
const DIGITS: usize = 16;

/// What is remembered of a run folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunNote {
    /// The absolute path of the folder when this was noted.
    pub folder: PathBuf,
    /// When the run finished, seconds since 1970.
    pub finished_unix_s: u64,
    /// Whether the run is pinned.
    pub pinned: bool,
    /// The beginnings of the keys that the run names.
    names: HashSet<u64>,
}

impl RunNote {
    /// A note on the run folder at an absolute path that names these keys.
    pub fn new(folder: &Path, keys: impl IntoIterator<Item = Digest>, finished_unix_s: u64, pinned: bool) -> Self {
        let names = keys.into_iter().map(|key| beginning(&key)).collect();
        Self { folder: folder.to_owned(), finished_unix_s, pinned, names }
    }

    /// The same of a run that is pinned, or is not.
    #[must_use]
    pub fn with_pin(self, pinned: bool) -> Self {
        Self { pinned, ..self }
    }

    /// The keys of the records in this store that the run names.
    pub fn keys(&self, store: &Store) -> Vec<Digest> {
        store.keys().into_iter().filter(|key| self.names.contains(&beginning(key))).collect()
    }

    /// Under which name it is kept.
    pub fn name(&self) -> Digest {
        name_of(&self.folder)
    }

    /// Whether the store has a record that the run names.
    pub fn names_any(&self, store: &Store) -> bool {
        store.keys().iter().any(|key| self.names.contains(&beginning(key)))
    }

    /// Whether it is a note on the same run, wherever its folder was: one of the same name that names the same keys.
    pub fn is_of_run(&self, other: &Self) -> bool {
        self.folder.file_name() == other.folder.file_name() && self.names == other.names
    }

    /// `None` for a path that is not UTF-8, which no note can have.
    fn encode(&self) -> Option<Value> {
        let mut names: Vec<&u64> = self.names.iter().collect();
        names.sort_unstable();
        let names: String = names.into_iter().map(|name| format!("{name:016x}")).collect();
        let Self { finished_unix_s, pinned, .. } = self;
        Some(json!({"folder": self.folder.to_str()?, "finished": finished_unix_s, "pinned": pinned, "names": names}))
    }

    fn decode(note: &Value) -> Option<Self> {
        let folder = Some(PathBuf::from(note.get("folder")?.as_str()?)).filter(|folder| folder.is_absolute())?;
        let names = note.get("names")?.as_str()?.as_bytes().chunks(DIGITS);
        let names = names.map(|digits| u64::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok());
        let (finished_unix_s, pinned) = (note.get("finished")?.as_u64()?, note.get("pinned")?.as_bool()?);
        Some(Self { folder, finished_unix_s, pinned, names: names.collect::<Option<_>>()? })
    }
}

/// The first eight bytes of a key.
fn beginning(key: &Digest) -> u64 {
    let [a, b, c, d, e, f, g, h, ..] = *key.as_bytes();
    u64::from_be_bytes([a, b, c, d, e, f, g, h])
}

/// Under which name the note on a run folder is kept.
fn name_of(folder: &Path) -> Digest {
    Digest::of(&[b"rockface: run folder ", folder.as_os_str().as_encoded_bytes()].concat())
}

impl Memory<'_> {
    /// Keeps a note on a run folder; a later one on the same path replaces it. Says whether it could: no note has a path that is
    /// not UTF-8.
    pub fn note_folder(&self, note: &RunNote) -> Result<bool, StoreError> {
        let Some(told) = note.encode() else { return Ok(false) };
        self.store.append(Kind::Note, name_of(&note.folder), told.to_string().as_bytes())?;
        Ok(true)
    }

    /// The latest note on the run folder at an absolute path.
    pub fn noted_folder(&self, folder: &Path) -> Option<RunNote> {
        let note = RunNote::decode(&self.payload(Kind::Note, &name_of(folder))?)?;
        (note.folder == folder).then_some(note)
    }

    /// The latest notes on run folders, by path.
    pub fn noted_folders(&self) -> Vec<RunNote> {
        let keys = self.store.journal().with_index(|index| index.names(Kind::Note));
        let note = |key: &Digest| {
            RunNote::decode(&self.payload(Kind::Note, key)?).filter(|note| name_of(&note.folder) == *key)
        };
        let mut notes: Vec<RunNote> = keys.iter().filter_map(note).collect();
        notes.sort_by(|one, other| one.folder.cmp(&other.folder));
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_folder_has_a_note_of_its_own_that_outlasts_the_process() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        let store = Store::open(&dir).unwrap();
        let keys = [Digest::of(b"a"), Digest::of(b"b")];
        let (one, other) =
            (RunNote::new(Path::new("/r/1"), keys, 7, false), RunNote::new(Path::new("/r/2"), [], 8, true));
        for note in [&one, &other] {
            assert!(store.memory().note_folder(note).unwrap());
        }
        store.memory().remember_run(&keys[0], &json!({"folder": "/r/3"})).unwrap();
        drop(store);
        let store = Store::open(&dir).unwrap();
        assert_eq!(store.memory().noted_folders(), [one.clone(), other]);
        assert_eq!(store.memory().noted_folder(Path::new("/r/3")), None, "a note by the key of a plan is another");
        let pinned = RunNote { pinned: true, ..one.clone() };
        store.memory().note_folder(&pinned).unwrap();
        assert_eq!(store.memory().noted_folder(&one.folder), Some(pinned));
        // Versions that know only notes by the key of a plan find the folder in these too.
        let told = store.memory().recalled_runs();
        let folders: Vec<&str> = told.iter().filter_map(|(_, note)| note["folder"].as_str()).collect();
        assert!(["/r/1", "/r/2", "/r/3"].iter().all(|folder| folders.contains(folder)), "{folders:?}");
    }

    #[test]
    fn damaged_notes_and_paths_that_are_no_text_are_none() {
        let place = tempfile::tempdir().unwrap();
        let store = Store::open(&place.path().join("store")).unwrap();
        let folder: &std::ffi::OsStr = std::os::unix::ffi::OsStrExt::from_bytes(b"/r/\xff");
        assert!(!store.memory().note_folder(&RunNote::new(Path::new(folder), [], 7, true)).unwrap());
        let relative = r#"{"folder": "r", "finished": 7, "pinned": true, "names": ""}"#;
        for text in [r#"{"folder": "/r", "names": "xyz"}"#, r#"{"folder": "/r"}"#, "[]", "7", relative] {
            assert_eq!(RunNote::decode(&serde_json::from_str(text).unwrap()), None, "{text}");
        }
        let foreign = RunNote::new(Path::new("/r/1"), [], 7, true).encode().unwrap();
        store.memory().remember_run(&name_of(Path::new("/r/2")), &foreign).unwrap();
        assert_eq!((store.memory().noted_folders(), store.memory().noted_folder(Path::new("/r/2"))), (vec![], None));
    }
}
