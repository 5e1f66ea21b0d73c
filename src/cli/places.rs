//! Where the commands that take no pipeline find runs and the store: one rule for all of them.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use clap::Args;
use clap::builder::{OsStringValueParser, TypedValueParser};
use rockface_cache::Store;

use super::{CliError, beside};
use rockface_engine::diagnostic::listed;
use rockface_engine::history::{self, HistoryError, PastRun};

/// The folder beside a pipeline.
const OWN: &str = ".rockface";

/// A folder; where the variable of the environment is empty, as if it were not set.
fn folder() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(PathBuf::from)
}

/// The store and the folder of runs.
#[derive(Debug, Default, Args)]
pub struct Places {
    /// The store of results [default: the one beside the folder of runs].
    #[arg(long, value_name = "DIR", env = "ROCKFACE_STORE", value_parser = folder())]
    store: Option<PathBuf>,
    /// The folder of runs [default: `.rockface/runs` of the working folder, and of the folders in it].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
}

impl Places {
    /// The folders that runs are looked for in: the one that was given; otherwise that of the working folder, and those of
    /// pipelines in the folders below it.
    fn runs_folders(&self) -> Vec<PathBuf> {
        if let Some(runs) = &self.runs {
            return vec![runs.clone()];
        }
        let mut found: Vec<PathBuf> = own_folders().into_iter().map(|own| own.join("runs")).collect();
        found.retain(|runs| runs.is_dir());
        if found.is_empty() { vec![Path::new(OWN).join("runs")] } else { found }
    }

    /// The run that `name` means: a run folder or its `run.json`; a pipeline, by its file or its name, for its last run;
    /// `latest`; or a part of the name of a run. `~2` after a pipeline or `latest` means the second before that.
    pub fn find(&self, name: &str) -> Result<PastRun, CliError> {
        let path = Path::new(name);
        if let Some((of, back)) = back(name).filter(|_| !path.exists()) {
            return self.before(of, back);
        }
        if path.is_file() && !path.ends_with("run.json") {
            return self.last_of_pipeline(path);
        }
        let folders = self.runs_folders();
        if name == "latest" {
            let named = |runs: &PathBuf| runs.join("latest").symlink_metadata().and_then(|link| link.modified()).ok();
            let latest = folders.iter().filter_map(|runs| Some((named(runs)?, runs))).max();
            let runs = latest.map_or(&folders[0], |(_, runs)| runs);
            return Ok(history::find(runs, name)?);
        }
        let mut fault = None;
        let mut fitting = Vec::new();
        for runs in &folders {
            match history::find(runs, name) {
                Ok(run) => fitting.push(run),
                Err(error) => fault = fault.or(Some(error)),
            }
        }
        fitting.sort_by(|one, other| one.folder.cmp(&other.folder));
        fitting.dedup_by(|one, other| one.folder == other.folder);
        match (fitting.len(), fault) {
            (1, None | Some(HistoryError::Unknown { .. })) => Ok(fitting.swap_remove(0)),
            // The name of a pipeline is part of the names of all its runs.
            (_, fault) => match (self.last_of(|run| run.manifest.pipeline.name == name)?, fault) {
                (Some(run), _) => Ok(run),
                (None, Some(fault)) if fitting.is_empty() => Err(fault.into()),
                (None, _) => {
                    let folders = listed(fitting.iter().map(|run| run.folder.to_str().unwrap_or_default()));
                    Err(CliError::Usage(format!("`{name}` fits several runs: {folders}; name the folder of one")))
                }
            },
        }
    }

    /// The run so many before the last one of a pipeline, or of all.
    fn before(&self, of: &str, back: usize) -> Result<PastRun, CliError> {
        let last = self.find(of)?;
        let all = of == "latest";
        // A pipeline named by its file has its runs beside it, wherever one stands.
        let own = Self { store: None, runs: last.folder.parent().map(Path::to_path_buf) };
        let mut runs = if all { self.list()?.0 } else { own.list()?.0 };
        runs.retain(|run| all || run.manifest.pipeline.name == last.manifest.pipeline.name);
        let count = runs.len();
        // A former folder that the last run ended with is the last one.
        runs.sort_by_key(|run| run.name == last.name);
        let found = count.checked_sub(back + 1).map(|place| runs.swap_remove(place));
        found.ok_or_else(|| CliError::Usage(format!("`{of}` has {count} runs here: none is {back} before the last")))
    }

    fn last_of_pipeline(&self, file: &Path) -> Result<PastRun, CliError> {
        let same = |path: &Path| path.file_name() == file.file_name();
        let beside_it = beside(file).join("runs");
        let folders = if self.runs.is_some() { self.runs_folders() } else { vec![beside_it] };
        let last = last(&folders, |run| same(&run.manifest.pipeline.path))?;
        last.ok_or_else(|| {
            let (file, folder) = (file.display(), folders[0].display());
            CliError::Usage(format!("{file} has no run in {folder}: `rockface run {file}` makes one"))
        })
    }

    fn last_of(&self, is_meant: impl Fn(&PastRun) -> bool) -> Result<Option<PastRun>, CliError> {
        last(&self.runs_folders(), is_meant)
    }

    /// All runs, oldest first, and what is wrong with folders that cannot be read.
    pub fn list(&self) -> Result<(Vec<PastRun>, Vec<HistoryError>), CliError> {
        if let Some(runs) = self.runs.as_ref().filter(|runs| !runs.is_dir()) {
            let hint = "give the folder of runs with --runs, or go to the folder of the pipeline";
            return Err(CliError::Usage(format!("there is no folder {}: {hint}", runs.display())));
        }
        let (mut runs, mut faults) = (Vec::new(), Vec::new());
        for folder in self.runs_folders() {
            let (found, torn) = history::list(&folder)?;
            runs.extend(found);
            faults.extend(torn);
        }
        runs.sort_by(|one, other| (&one.manifest.finished, &one.name).cmp(&(&other.manifest.finished, &other.name)));
        Ok((runs, faults))
    }

    /// The store that was given, or else the one of the working folder.
    fn store_or_default(&self) -> PathBuf {
        let given = self.store.clone().filter(|folder| !folder.as_os_str().is_empty());
        given.unwrap_or_else(|| Path::new(OWN).join("store"))
    }

    /// The store that was given.
    pub fn given_store(&self) -> Option<PathBuf> {
        self.store.clone().filter(|folder| !folder.as_os_str().is_empty())
    }

    fn is_store_given(&self) -> bool {
        self.store.as_ref().is_some_and(|folder| !folder.as_os_str().is_empty())
    }

    /// Opens the store, making it if there is none.
    pub fn make_store(&self) -> Result<Store, CliError> {
        Ok(Store::open(&self.store_or_default())?)
    }

    /// Opens the store given, or the first that has something of the run: the one that the run names, that beside its folder, that
    /// of the working folder; `None` where there is none.
    pub fn store_beside(&self, run: &PastRun) -> Result<Option<Store>, CliError> {
        let beside = run.folder.parent().and_then(Path::parent).map(|folder| folder.join("store"));
        let own = self.store_or_default();
        if self.is_store_given() {
            let found = [Some(own), beside].into_iter().flatten().find(|store| may_be_store(store));
            return Ok(found.map(|store| Store::open(&store)).transpose()?);
        }
        // What a run says is only a hint: a store that cannot be opened, or would have to be made, is not that of the run.
        let named = run.manifest.store.as_ref().filter(|named| named.is_absolute() && Store::is_whole_at(named));
        let named = named.and_then(|named| Store::open(named).ok()).filter(|store| has_some_of(store, run));
        if named.is_some() {
            return Ok(named);
        }
        for store in [beside, Some(own)].into_iter().flatten().filter(|store| may_be_store(store)) {
            let store = Store::open(&store)?;
            if has_some_of(&store, run) {
                return Ok(Some(store));
            }
        }
        Ok(None)
    }

    /// The store given if it has something of the run, or else the first of the others that has; `None` where there is none.
    pub fn store_with(&self, run: &PastRun) -> Result<Option<Store>, CliError> {
        let given = self.given_store().filter(|store| may_be_store(store)).map(|store| Store::open(&store));
        let fault = match given {
            Some(Ok(store)) if has_some_of(&store, run) => return Ok(Some(store)),
            Some(Err(fault)) => Some(fault),
            _ => None,
        };
        match (Self::default().store_beside(run)?, fault) {
            (None, Some(fault)) => Err(fault.into()),
            (found, _) => Ok(found),
        }
    }

    /// As [`Places::store_beside`], which must be there.
    pub fn store_of(&self, run: &PastRun) -> Result<Store, CliError> {
        if self.is_store_given() {
            return self.open_store();
        }
        self.store_beside(run)?.map_or_else(|| self.open_store(), Ok)
    }

    /// Opens the store, which must be there: what only looks makes nothing. Where none is given, it is that of the working
    /// folder, or of the one folder in it that has one.
    pub fn open_store(&self) -> Result<Store, CliError> {
        let own = self.store_or_default();
        if may_be_store(&own) {
            return Ok(Store::open(&own)?);
        }
        let hint = "give its folder with --store, or go to the folder of the pipeline";
        if !self.is_store_given() {
            let below: Vec<PathBuf> = own_folders().into_iter().map(|own| own.join("store")).collect();
            let below: Vec<PathBuf> = below.into_iter().filter(|store| may_be_store(store)).collect();
            match below.as_slice() {
                [only] => return Ok(Store::open(only)?),
                [] => {}
                several => {
                    let names = listed(several.iter().filter_map(|store| store.to_str()));
                    return Err(CliError::Usage(format!("there are several stores here, {names}: {hint}")));
                }
            }
        }
        Err(CliError::Usage(format!("there is no store in {}: {hint}", own.display())))
    }

    /// The folders of runs that belong to a store, and those that were given.
    pub fn runs_of(&self, store: &Store) -> Vec<PathBuf> {
        let mut folders = self.runs_folders();
        folders.extend(store.dir().parent().map(|own| own.join("runs")));
        folders
    }
}

/// Whether a store has a record of a run, or the run has none.
fn has_some_of(store: &Store, run: &PastRun) -> bool {
    let mut keys =
        run.manifest.steps.iter().filter(|done| done.outputs.is_some()).filter_map(|done| done.key).peekable();
    keys.peek().is_none() || keys.any(|key| store.record(&key).is_some())
}

/// `quickstart~2`: what stands before the sign, and the number after it.
fn back(name: &str) -> Option<(&str, usize)> {
    let (of, back) = name.rsplit_once('~')?;
    Some((of, back.parse().ok()?))
}

/// The last of the runs in some folders that are meant.
fn last(folders: &[PathBuf], is_meant: impl Fn(&PastRun) -> bool) -> Result<Option<PastRun>, CliError> {
    let mut best: Option<(SystemTime, PastRun)> = None;
    for runs in folders {
        for run in history::list(runs)?.0 {
            if !is_meant(&run) {
                continue;
            }
            let asked_for = history::last_asked_for(&run);
            if best.as_ref().is_none_or(|(known, _)| asked_for >= *known) {
                best = Some((asked_for, run));
            }
        }
    }
    Ok(best.map(|(_, run)| run))
}

/// The `.rockface` folders of the working folder and of the folders in it, the former first, the others by name.
fn own_folders() -> Vec<PathBuf> {
    let mut below: Vec<PathBuf> = std::fs::read_dir(".")
        .map(|entries| entries.flatten().map(|entry| PathBuf::from(entry.file_name()).join(OWN)).collect())
        .unwrap_or_default();
    below.retain(|own| own.is_dir());
    below.sort();
    std::iter::once(PathBuf::from(OWN)).filter(|own| own.is_dir()).chain(below).collect()
}

/// Whether a folder is a store, or cannot be looked into: opening it then says why.
pub fn may_be_store(folder: &Path) -> bool {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    match std::fs::metadata(folder.join("format")) {
        Ok(meta) => meta.is_file(),
        Err(fault) => !matches!(fault.kind(), NotFound | NotADirectory),
    }
}
