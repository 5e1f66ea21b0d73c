//! Past runs: what their folders tell, which there are, and how two of them differ.

mod archive;
mod chosen;
mod compare;
mod contents;
mod file_names;
mod files;
mod inputs;
mod manifest;
mod places;
mod points;
mod provenance;
mod sources;
mod torn;

use std::path::{Path, PathBuf};

pub use archive::{ARCHIVE_MARK, Archived, Contents, archive};
pub use chosen::{Chosen, Ran, chosen, folded, headline, ranks};
pub use compare::{Comparison, Row, compare};
pub use contents::RunContents;
pub use file_names::{CRATE_FILE, LAYOUT_FILE, LOG_FILE, MANIFEST_FILE, PIPELINE_FILE, POINTS_FILE, REPORT_FILE};
pub use files::with_short_digest;
pub use inputs::find_inputs;
pub use manifest::{
    FORMAT, FileUsed, IncludedText, ItemValues, Manifest, Metric, Overridden, PartUsed, PipelineText, StepDone,
};
pub use places::{output_folder, readable_name};
pub use points::table as points_table;
pub use provenance::crate_metadata;
pub use torn::digests_told;

use rockface_cache::{Digest, RunNote};

use crate::diagnostic::nearest;

/// Marks a run whose results are kept whatever their age.
const PIN: &str = "pinned";

/// A run that has a folder.
#[derive(Debug, Clone)]
pub struct PastRun {
    /// The name of the folder.
    pub name: String,
    /// The path of the folder.
    pub folder: PathBuf,
    /// What was run, from which files, and the outputs.
    pub manifest: Manifest,
    /// Whether it is pinned.
    pub pinned: bool,
}

/// Why a past run is not available.
#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    /// Nothing of this name.
    #[error("there is no run `{name}` in {}{hint}", runs.display())]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// Where it was looked for.
        runs: PathBuf,
        /// What the user can do about it.
        hint: String,
    },
    /// More than one fits.
    #[error("`{name}` fits several runs: {}; give more of the name", fitting.join(", "))]
    Ambiguous {
        /// The name that was asked for.
        name: String,
        /// Names of the runs that fit.
        fitting: Vec<String>,
    },
    /// The manifest is not one.
    #[error("{} is not a manifest this version reads: {why}", path.display())]
    Manifest {
        /// The path of the file.
        path: PathBuf,
        /// Why it cannot be read.
        why: String,
    },
    /// A file of a run folder is not what the run made.
    #[error(
        "{} is not what the run made any more (blob {}), and the store does not have it: repeat the run with `rockface run {}`, or leave out --outputs",
        path.display(), digest.short(), manifest.display()
    )]
    Changed {
        /// The path of the file.
        path: PathBuf,
        /// The digest of what the run made.
        digest: Digest,
        /// Where the run is reported.
        manifest: PathBuf,
    },
    /// An input file is not what the run read.
    #[error(
        "{} is not what the run read any more (BLAKE3 {} then): put it back, run the pipeline again, or archive without --inputs",
        path.display(), digest.short()
    )]
    InputChanged {
        /// The path of the file.
        path: PathBuf,
        /// The digest of what the run read.
        digest: Digest,
    },
    /// An input file that no archive can have in its place.
    #[error("{} cannot be archived: {why}; rename or move it and run again, or archive without --inputs", path.display())]
    Unpackable {
        /// The path of the file.
        path: PathBuf,
        /// Why not.
        why: String,
    },
    /// The user asked to stop.
    #[error("interrupted; nothing was written")]
    Interrupted,
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] rockface_cache::StoreError),
    /// A file or folder could not be read or written.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried, a verb phrase.
        action: &'static str,
        /// The path that it was tried on.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

impl HistoryError {
    fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self + use<> {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }
}

impl PastRun {
    /// Reads the run in this folder.
    ///
    /// # Errors
    ///
    /// When its manifest is missing or not readable.
    pub fn open(folder: &Path) -> Result<Self, HistoryError> {
        let manifest = Manifest::read(&folder.join(MANIFEST_FILE))?;
        let folder = std::path::absolute(folder).map_err(HistoryError::io("find", folder))?;
        let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let pin = folder.join(PIN);
        let pinned = pin.try_exists().map_err(HistoryError::io("look at", &pin))?;
        Ok(Self { name, folder, manifest, pinned })
    }

    /// The keys of the records that it names.
    pub fn keys(&self) -> impl Iterator<Item = Digest> {
        self.manifest.steps.iter().filter_map(|done| done.key)
    }

    /// When it finished, seconds since 1970; 0 where its manifest does not tell.
    pub fn finished_unix_s(&self) -> u64 {
        let finished = humantime::parse_rfc3339(&self.manifest.finished).ok();
        let since = finished.and_then(|at| at.duration_since(std::time::UNIX_EPOCH).ok());
        since.map_or(0, |since| since.as_secs())
    }

    /// What a store is to remember of it, with its folder at this absolute path.
    pub fn note(&self, folder: &Path) -> RunNote {
        RunNote::new(folder, self.keys(), self.finished_unix_s(), self.pinned)
    }

    /// Pins the run or removes its pin: its results stay in the store while it is pinned.
    ///
    /// # Errors
    ///
    /// When the folder cannot be written to.
    pub fn pin(&self, pinned: bool) -> Result<(), HistoryError> {
        let path = self.folder.join(PIN);
        if pinned {
            let text = "What this run made is not collected. `rockface runs unpin` removes this pin.\n";
            // Written beside its place: a link there is replaced, not followed.
            let file = rockface_cache::readable_file(&self.folder);
            let mut file = file.map_err(HistoryError::io("write into", &self.folder))?;
            std::io::Write::write_all(&mut file, text.as_bytes()).map_err(HistoryError::io("write", &path))?;
            return file.persist(&path).map(drop).map_err(|fault| HistoryError::io("write", &path)(fault.error));
        }
        match std::fs::remove_file(&path) {
            Err(fault) if fault.kind() != std::io::ErrorKind::NotFound => Err(HistoryError::io("remove", &path)(fault)),
            _ => Ok(()),
        }
    }
}

/// Whether what the run of this folder made is kept whatever its age.
pub fn is_pinned(folder: &Path) -> bool {
    // What cannot be looked at is spared.
    folder.join(PIN).try_exists().unwrap_or(true)
}

/// The run folders in a folder of runs, be their manifests readable or not.
///
/// # Errors
///
/// When the folder of runs cannot be listed.
pub fn folders(runs: &Path) -> Result<Vec<PathBuf>, HistoryError> {
    Ok(names(runs)?.into_iter().map(|name| runs.join(name)).collect())
}

/// All runs in a folder of runs, oldest first, and what is wrong with the folders that cannot be read.
///
/// # Errors
///
/// When the folder of runs cannot be listed.
pub fn list(runs: &Path) -> Result<(Vec<PastRun>, Vec<HistoryError>), HistoryError> {
    let (mut found, mut faults) = (Vec::new(), Vec::new());
    for name in names(runs)? {
        match PastRun::open(&runs.join(&name)) {
            Ok(run) => found.push(run),
            Err(fault) => faults.push(fault),
        }
    }
    found.sort_by(|one, other| (&one.manifest.finished, &one.name).cmp(&(&other.manifest.finished, &other.name)));
    Ok((found, faults))
}

/// The last `most` runs of a pipeline in a folder of runs, by the name of the pipeline, the last first; those that cannot be read are left out.
pub fn runs_of(runs: &Path, pipeline: &str, most: usize) -> Vec<PastRun> {
    let link = format!("latest-{}", readable_name(pipeline));
    let names = names(runs).unwrap_or_default();
    // A run that had nothing to do points the link at a former folder, which so is the last.
    let last = std::fs::read_link(runs.join(&link)).ok().and_then(|last| last.into_os_string().into_string().ok());
    let last = last.filter(|last| names.contains(last));
    let others =
        names.iter().rev().filter(|name| latest_of(name).as_ref() == Some(&link) && Some(*name) != last.as_ref());
    last.iter().chain(others).take(most).filter_map(|name| PastRun::open(&runs.join(name)).ok()).collect()
}

/// The link that points at the last run of a pipeline, by the name of a run folder; `None` for a name that no run gave it.
pub fn latest_of(folder: &str) -> Option<String> {
    let (_, rest) = folder.split_once("Z-")?;
    let is_key = |part: &str| part.len() == 8 && part.bytes().all(|byte| byte.is_ascii_hexdigit());
    let (name, end) = rest.rsplit_once('-')?;
    let name = if is_key(end) { name } else { name.rsplit_once('-').filter(|(_, key)| is_key(key))?.0 };
    Some(format!("latest-{name}"))
}

/// When a run was last asked for: when it finished, or when the link of its pipeline was pointed at it.
pub fn last_asked_for(run: &PastRun) -> std::time::SystemTime {
    let finished = humantime::parse_rfc3339(&run.manifest.finished).unwrap_or(std::time::UNIX_EPOCH);
    let pointed = || {
        let link = run.folder.parent()?.join(latest_of(&run.name)?);
        let is_meant = std::fs::read_link(&link).ok()?.to_str()? == run.name;
        is_meant.then(|| link.symlink_metadata().ok()?.modified().ok()).flatten()
    };
    pointed().map_or(finished, |pointed| pointed.max(finished))
}

/// Whether a folder is that of a run, or cannot be looked into: opening it then says why. Taken for none, what it names
/// would be collected.
pub fn may_be_run(folder: &Path) -> bool {
    use std::io::ErrorKind::{NotADirectory, NotFound};
    match std::fs::metadata(folder.join(MANIFEST_FILE)) {
        Ok(meta) => meta.is_file(),
        Err(fault) => !matches!(fault.kind(), NotFound | NotADirectory),
    }
}

/// The names of the run folders, sorted; none where there is no folder of runs.
fn names(runs: &Path) -> Result<Vec<String>, HistoryError> {
    let entries = match std::fs::read_dir(runs) {
        Ok(entries) => entries,
        Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(fault) => return Err(HistoryError::io("list", runs)(fault)),
    };
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(HistoryError::io("list", runs))?;
        // `latest` is another name of one of them.
        let is_folder = entry.file_type().map_err(HistoryError::io("look at", &entry.path()))?.is_dir();
        if is_folder && may_be_run(&entry.path()) {
            names.extend(entry.file_name().into_string().ok());
        }
    }
    names.sort_unstable();
    Ok(names)
}

/// The run called `name`: a path, `latest`, the name of a folder, or a part of one that fits no other.
///
/// # Errors
///
/// When none or several fit, or its manifest cannot be read.
pub fn find(runs: &Path, name: &str) -> Result<PastRun, HistoryError> {
    let given = Path::new(name);
    let given = if given.file_name().is_some_and(|file| file == MANIFEST_FILE) {
        given.parent().map_or_else(|| PathBuf::from("."), Path::to_owned)
    } else {
        given.to_owned()
    };
    for folder in [runs.join(name), given] {
        if may_be_run(&folder) {
            return PastRun::open(&folder.canonicalize().map_err(HistoryError::io("find", &folder))?);
        }
    }
    let names = names(runs)?;
    let fitting: Vec<&String> = names.iter().filter(|known| known.contains(name)).collect();
    match fitting.as_slice() {
        [only] => PastRun::open(&runs.join(only)),
        [] => Err(unknown(runs, name, &names)),
        several => {
            Err(HistoryError::Ambiguous { name: name.into(), fitting: several.iter().map(|n| (*n).clone()).collect() })
        }
    }
}

fn unknown(runs: &Path, name: &str, names: &[String]) -> HistoryError {
    let known: Vec<&str> = names.iter().map(String::as_str).collect();
    let hint = match nearest(name, &known) {
        Some(near) => format!("; did you mean `{near}`?"),
        None if known.is_empty() => "; it holds no runs: give the folder of runs with --runs".to_owned(),
        None => "; `rockface runs list` names those there are".to_owned(),
    };
    HistoryError::Unknown { name: name.into(), runs: runs.into(), hint }
}
