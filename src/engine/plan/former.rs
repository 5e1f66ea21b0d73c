//! Input files of past runs, for those that are gone.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use rockface_cache::Digest;

/// Finds the digest that the file at a path had in the last run that read it, and the name of that run.
pub type FindFormer = dyn Fn(&Path) -> Option<(Digest, String)> + Send + Sync;

/// What past runs of a pipeline know of its input files.
pub struct FormerInputs {
    find: Box<FindFormer>,
    is_used: bool,
    used: Mutex<BTreeMap<PathBuf, String>>,
}

impl FormerInputs {
    /// What `find` tells; where it `is_used`, the digests stand for files that are gone, otherwise faults name the run.
    pub fn new(is_used: bool, find: Box<FindFormer>) -> Self {
        Self { find, is_used, used: Mutex::default() }
    }

    /// The digest that stands for a file that is gone, and the run that tells it.
    pub fn in_place_of(&self, path: &Path) -> Option<(Digest, String)> {
        let is_gone = || std::fs::metadata(path).is_err_and(|why| why.kind() == std::io::ErrorKind::NotFound);
        if !self.is_used || !is_gone() {
            return None;
        }
        let (digest, run) = (self.find)(path)?;
        self.used.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned(), run.clone());
        Some((digest, run))
    }

    /// The files whose digests were taken from runs, each with the run.
    pub fn used(&self) -> BTreeMap<PathBuf, String> {
        self.used.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// What to do about a file that is gone and that a run has read.
    pub fn way(&self, path: &Path) -> Option<String> {
        let (_, run) = (self.find)(path).filter(|_| !self.is_used)?;
        let way = "with `--recorded-inputs` its results are taken from the store";
        Some(format!("run {run} read it; {way}"))
    }
}
