//! Where the commands that take no pipeline find the store and the runs.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{OsStringValueParser, TypedValueParser};
use rockface_cache::Store;

use super::CliError;

/// The folder of runs that is looked at if none is given.
const RUNS: &str = ".rockface/runs";

/// The store of a pipeline in the working folder.
const STORE: &str = ".rockface/store";

/// A folder; where the variable of the environment is empty, as if it were not set.
fn store_or_default() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(|folder| PathBuf::from(if folder.is_empty() { STORE.into() } else { folder }))
}

/// The store and the folder of runs; by default those of a pipeline in the working folder.
#[derive(Debug, Args)]
pub struct Places {
    /// The store of results.
    #[arg(long, value_name = "DIR", env = "ROCKFACE_STORE", default_value = STORE, value_parser = store_or_default())]
    store: PathBuf,
    /// The folder of runs.
    #[arg(long, value_name = "DIR", default_value = RUNS)]
    pub runs: PathBuf,
}

impl Places {
    /// Whether the folder of runs is there, or is the one that the first run makes.
    pub fn are_runs_there(&self) -> bool {
        self.runs == Path::new(RUNS) || self.runs.is_dir()
    }

    /// Opens the store, making it if there is none.
    pub fn make_store(&self) -> Result<Store, CliError> {
        Ok(Store::open(&self.store)?)
    }

    /// Opens the store given, or the one beside a run folder; `None` where there is neither.
    pub fn store_beside(&self, run: &Path) -> Result<Option<Store>, CliError> {
        let beside = run.parent().and_then(Path::parent).map(|folder| folder.join("store"));
        let places = [Some(self.store.clone()), beside];
        let found = places.into_iter().flatten().find(|store| may_be_store(store));
        Ok(found.map(|store| Store::open(&store)).transpose()?)
    }

    /// Opens the store, which must be there: what only looks makes nothing.
    pub fn open_store(&self) -> Result<Store, CliError> {
        if may_be_store(&self.store) {
            return Ok(Store::open(&self.store)?);
        }
        let shown = self.store.display();
        let hint = "give its folder with --store, or go to the folder of the pipeline";
        Err(CliError::Usage(format!("there is no store in {shown}: {hint}")))
    }
}

/// Whether a folder is a store, or cannot be looked into: opening it then says why.
pub fn may_be_store(folder: &Path) -> bool {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    match std::fs::metadata(folder.join("format")) {
        Ok(meta) => meta.is_file(),
        Err(fault) => !matches!(fault.kind(), NotFound | NotADirectory),
    }
}
