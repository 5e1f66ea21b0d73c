//! Where a report takes its contents from: the manifest, the run folder, and the store.

use std::path::{Path, PathBuf};

use rockface_cache::{Digest, OutputRecord, Store};
use rockface_stages::Entry;

use crate::history::{Manifest, StepDone};

/// A run and where its files are.
pub struct Source<'a> {
    /// The run folder.
    pub folder: &'a Path,
    /// What it tells.
    pub manifest: &'a Manifest,
    /// The store, for what is not in the folder; without it such things are left out, and the page says so.
    pub store: Option<&'a Store>,
}

impl Source<'_> {
    /// The bytes of an output: from the run folder, else from the store; `None` where neither has it.
    pub(super) fn output(&self, done: &StepDone, port: &str, output: &OutputRecord) -> Option<Vec<u8>> {
        let linked = done.paths.get(port).and_then(|path| std::fs::read(self.folder.join(path)).ok());
        linked.or_else(|| self.blob(&output.digest))
    }

    fn blob(&self, digest: &Digest) -> Option<Vec<u8>> {
        self.store?.get(digest).ok()
    }

    /// What a step instance said.
    pub(super) fn entries(&self, done: &StepDone) -> Vec<Entry> {
        let log = done.log.and_then(|digest| self.blob(&digest));
        log.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
    }

    /// The path of a file of the run folder that is there.
    pub(super) fn file(&self, path: &Path) -> Option<PathBuf> {
        let full = self.folder.join(path);
        full.is_file().then_some(full)
    }
}
