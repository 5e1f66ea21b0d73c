//! What the engine lends a running stage: streams, opened files, a log, the wish to stop.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use rockface_cache::Store;
use rockface_core::{Entry, Host, Job, JobResult, Program, ProgramResult, SourceFile, StageError};

use super::failure::Trouble;
use super::program::{Fault, Used};
use super::standing::Standing;
use crate::plan::InputFile;

/// The host of one step instance.
pub struct StepHost<'a> {
    seed: Option<[u8; 32]>,
    files: &'a BTreeMap<String, Vec<InputFile>>,
    store: &'a Store,
    entries: Mutex<Vec<Entry>>,
    stop: &'a AtomicBool,
    deadline: Option<Instant>,
    /// What the programs that the stage started took, summed up so far.
    used: Mutex<Used>,
    /// Receives the reason if the store cannot do what a program needs; the stage sees only that it failed.
    trouble: &'a Trouble,
    /// Programs that stay alive between jobs, where the stage declares that it starts programs; others may not.
    programs: Option<&'a Standing>,
}

impl<'a> StepHost<'a> {
    /// A host; `seed` is the key of the step's seed material, if the stage draws, and `deadline` when it fails as late.
    /// Programs run in folders of the store; without `programs` the stage may start none.
    pub fn new(
        seed: Option<[u8; 32]>,
        files: &'a BTreeMap<String, Vec<InputFile>>,
        store: &'a Store,
        stop: &'a AtomicBool,
        deadline: Option<Instant>,
        trouble: &'a Trouble,
        programs: Option<&'a Standing>,
    ) -> Self {
        let (entries, used) = (Mutex::default(), Mutex::default());
        Self { seed, files, store, entries, stop, deadline, used, trouble, programs }
    }

    /// Whether the time it was given is over.
    pub fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// The log of the stage, and the cost of its programs.
    pub fn end(self) -> (Vec<Entry>, Used) {
        let entries = self.entries.into_inner().unwrap_or_else(PoisonError::into_inner);
        (entries, self.used.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    fn programs(&self) -> Result<&'a Standing, StageError> {
        self.programs.ok_or_else(|| StageError::new("no program is started here"))
    }

    /// Adds what a program took, and puts aside what is a fault of the store.
    fn count<T>(&self, ended: Result<(T, Used), Fault>) -> Result<T, StageError> {
        match ended {
            Ok((result, used)) => {
                self.add(used);
                Ok(result)
            }
            Err(Fault::Program(error)) => Err(error),
            Err(Fault::Store(error)) => {
                let told = StageError::new(error.to_string());
                *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.into());
                Err(told)
            }
        }
    }

    /// Programs of a step run one after the other or side by side; their memory is that of the largest.
    fn add(&self, used: Used) {
        let mut sum = self.used.lock().unwrap_or_else(PoisonError::into_inner);
        sum.cpu_s += used.cpu_s;
        sum.peak_bytes = sum.peak_bytes.max(used.peak_bytes);
        sum.tools.extend(used.tools);
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
        self.entries.lock().unwrap_or_else(PoisonError::into_inner).push(entry);
    }

    fn execute(&self, program: &Program) -> Result<ProgramResult, StageError> {
        self.programs()?;
        self.count(super::program::execute(program, self.files, self.store, &|| self.cancelled()))
    }

    fn employ(&self, job: &Job) -> Result<JobResult, StageError> {
        self.count(self.programs()?.employ(job, self.files, self.store, &|| self.cancelled()))
    }

    fn cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.is_late()
    }
}
