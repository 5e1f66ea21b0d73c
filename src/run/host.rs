//! What the engine lends a running stage: streams, opened files, a log, the wish to stop.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use rockface_cache::Store;
use rockface_stages::{Entry, Host, Program, ProgramResult, SourceFile, StageError};

use crate::plan::InputFile;

/// The host of one step instance.
pub struct StepHost<'a> {
    seed: Option<[u8; 32]>,
    files: &'a BTreeMap<String, Vec<InputFile>>,
    store: &'a Store,
    entries: Mutex<Vec<Entry>>,
    stop: &'a AtomicBool,
    deadline: Option<Instant>,
}

impl<'a> StepHost<'a> {
    /// A host; `seed` is the key of the step's seed material, if the stage draws, and `deadline` when it is to give up.
    /// Programs run in folders of the store.
    pub fn new(
        seed: Option<[u8; 32]>,
        files: &'a BTreeMap<String, Vec<InputFile>>,
        store: &'a Store,
        stop: &'a AtomicBool,
        deadline: Option<Instant>,
    ) -> Self {
        Self { seed, files, store, entries: Mutex::new(Vec::new()), stop, deadline }
    }

    /// Whether the time it was given is over.
    pub fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// What the stage said.
    pub fn into_entries(self) -> Vec<Entry> {
        self.entries.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Host for StepHost<'_> {
    /// # Panics
    ///
    /// If a stage draws although it said it would not: its seed is then not part of the recipe, and the result would be
    /// served to runs with other seeds.
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32] {
        let seed = self.seed.expect("the stage draws random numbers although its `draws` says it does not");
        let mut hasher = blake3::Hasher::new_keyed(&seed);
        hasher.update(&(purpose.len() as u64).to_le_bytes());
        hasher.update(purpose.as_bytes());
        hasher.update(item.as_bytes());
        *hasher.finalize().as_bytes()
    }

    fn open(&self, as_written: &str) -> std::io::Result<Vec<SourceFile>> {
        let files = self.files.get(as_written);
        let files = files.ok_or_else(|| std::io::Error::other("this file is not named by a file parameter"))?;
        let open = |file: &InputFile| {
            let reader = Box::new(std::io::BufReader::new(std::fs::File::open(&file.path)?));
            Ok(SourceFile { name: file.name.clone(), reader })
        };
        files.iter().map(open).collect()
    }

    fn record(&self, entry: Entry) {
        self.entries.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(entry);
    }

    fn execute(&self, program: &Program) -> Result<ProgramResult, StageError> {
        super::program::execute(program, self.files, self.store, &|| self.cancelled())
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.is_late()
    }
}
